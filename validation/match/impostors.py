"""False match rates of the matchers: all pairs of many simulated fingers, one impression each.

    python validation/match/impostors.py ridge fusion minutiae_of_prints --fingers 150
    python validation/match/impostors.py minutiae --fingers 250 --seed 60000

writes the tables that ``splitknit match`` reads,
``packages/splitknit-match/src/splitknit_match/matching/match_fmr*.json``: scores alone. Surfaces are the true ones, in
poses drawn from the twin's ranges: impostor scores depend on the ridges' flow, not on how well they were reconstructed.
Real prints (FVC2002 DB1_B) are added to ``ridge`` for comparison where the independent data is present.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from drawn import drawn_surface
from pressed_prints import finger, press

from splitknit.finger.ridges import surface_print
from splitknit.io.prints import read_print_png
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.methods import TABLES
from splitknit_match.matching.minutiae import extract, minutiae_match
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import print_band
from splitknit_match.matching.score import calibrate_scores
from splitknit_match.matching.surface import surface_template
from splitknit_match.matching.template import make_template
from splitknit_match.prints.from_file import print_minutiae

FOLDER = Path(__file__).resolve().parents[2] / "packages" / "splitknit-match" / "src" / "splitknit_match" / "matching"


@dataclass(frozen=True, slots=True)
class Route:
    """From a finger's number to the score of two."""

    source: Callable[[int], Any]
    prepare: Callable[[Any], Any]
    score: Callable[[Any, Any], float]
    what: str


def pressed(seed: int) -> Any:
    """One finger, pressed once."""
    return press(finger(seed), 0)


COARSE, FINE = partial(drawn_surface, scale=0.15), partial(drawn_surface, scale=0.27)
"""Of the camera: the second has 20 pixels a millimetre, the resolution of a print."""
ROUTES = {
    "ridge": Route(
        COARSE, lambda one: Prepared(surface_template(one)), lambda a, b: ridge_match(a, b).similarity,
        "true surfaces",
    ),
    "fusion": Route(
        pressed, lambda one: Prepared(print_template(one)), lambda a, b: fused_match(a, b).similarity, "presses"
    ),
    "minutiae": Route(FINE, lambda one: extract(surface_print(one)), minutiae_match, "relief prints"),
    "minutiae_of_prints": Route(pressed, print_minutiae, minutiae_match, "presses"),
}  # fmt: skip


def real_prints() -> dict[str, Any]:
    """Scores of ``ridge`` on real prints, where they are present."""
    folder = os.environ.get("SPLITKNIT_DATA", str(Path(__file__).resolve().parents[3] / "shared" / "data"))
    files = sorted((Path(folder) / "fvc2002_db1b").glob("*.png"))
    if not files:
        return {}
    prints = [Prepared(make_template(print_band(read_print_png(file).image))) for file in files]
    owners = [file.stem.split("_")[0] for file in files]
    real: dict[bool, list[float]] = {True: [], False: []}
    for (a, owner), (b, other) in itertools.combinations(zip(prints, owners, strict=True), 2):
        real[owner == other].append(ridge_match(a, b).similarity)
    largest = max(real[False])
    found = {
        "genuine": len(real[True]),
        "impostors": len(real[False]),
        "impostor_median": round(float(np.median(real[False])), 4),
        "impostor_largest": round(largest, 4),
        "gar_at_far_0": round(float(np.mean(np.array(real[True]) > largest)), 4),
    }
    return {"real_prints": found}


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("methods", nargs="+", choices=list(ROUTES), metavar="METHOD")
    parser.add_argument("--fingers", type=int, default=150)
    parser.add_argument("--seed", type=int, default=50_000)
    options = parser.parse_args()
    sides: dict[str, list[Any]] = {name: [] for name in options.methods}
    for number in range(options.fingers):
        made: dict[Any, Any] = {}  # what several methods begin with
        for name, kept in sides.items():
            source = ROUTES[name].source
            if source not in made:
                made[source] = source(options.seed + number)
            kept.append(ROUTES[name].prepare(made[source]))
        if number % 20 == 19:
            print(f"{number + 1} fingers", flush=True)
    for name, kept in sides.items():
        scores = np.array([ROUTES[name].score(a, b) for a, b in itertools.combinations(kept, 2)])
        table = calibrate_scores(scores)
        facts = {
            "what": f"{ROUTES[name].what} of {options.fingers} simulated fingers",
            "by": "validation/match/impostors.py, all pairs",
            "seed": options.seed,
            "impostors": table.impostors,
            "similarity": (np.ceil(table.similarity * 1e5) / 1e5).tolist(),
            "fmr": [float(f"{rate:.3g}") for rate in table.fmr],
            **(real_prints() if name == "ridge" else {}),
            "impostor_median": round(float(np.median(scores)), 4),
            "impostor_largest": round(float(scores.max()), 4),
        }
        (FOLDER / TABLES[name]).write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        print({key: value for key, value in facts.items() if key not in ("similarity", "fmr")}, flush=True)


if __name__ == "__main__":
    main()
