"""False match rates of the ridge matcher, and of its fusion with minutiae: all pairs of many simulated fingers.

    python validation/match/impostors.py --fingers 150
    python validation/match/impostors.py --fingers 150 --prints

writes the table that ``splitknit match`` reads, ``src/splitknit/matching/match_fmr.json``, or, of one simulated press
of each finger, that of prints, ``match_fmr_prints.json``. The fingers' surfaces are
the true ones, one impression each, in poses drawn from the twin's ranges: impostor scores depend on the ridges' flow,
not on how well they were reconstructed. Real prints (FVC2002 DB1_B) are added for comparison where the independent data
is present.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from pathlib import Path

import numpy as np
from drawn import drawn_surface
from pressed_prints import finger, press

from splitknit.io.prints import read_print_png
from splitknit.matching.fusion import fused_match
from splitknit.matching.inputs import print_template
from splitknit.matching.ridge import Prepared, ridge_match
from splitknit.matching.ridge_band import print_band
from splitknit.matching.score import calibrate_scores
from splitknit.matching.surface import MatchingSettings, surface_template
from splitknit.matching.template import make_template

TABLE = Path(__file__).resolve().parents[2] / "src" / "splitknit" / "matching" / "match_fmr.json"
SCALE = 0.15


PRINTS_TABLE = TABLE.with_name("match_fmr_prints.json")


def pressed(seed: int) -> Prepared:
    """One finger, pressed once."""
    return Prepared(print_template(press(finger(seed), 0)))


def drawn(seed: int) -> Prepared:
    """One finger, laid down once."""
    return Prepared(surface_template(drawn_surface(seed, SCALE), MatchingSettings()))


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=150)
    parser.add_argument("--seed", type=int, default=50_000)
    parser.add_argument("--prints", action="store_true", help="presses, by ridges and minutiae")
    options = parser.parse_args()
    sides = []
    for number in range(options.fingers):
        sides.append((pressed if options.prints else drawn)(options.seed + number))
        if number % 20 == 19:
            print(f"{number + 1} fingers", flush=True)
    match = fused_match if options.prints else ridge_match
    scores = np.array([match(a, b).similarity for a, b in itertools.combinations(sides, 2)])
    table = calibrate_scores(scores)
    what = "presses" if options.prints else "true surfaces"
    facts = {
        "what": f"{what} of {options.fingers} simulated fingers, all pairs, validation/match/impostors.py",
        "seed": options.seed,
        "impostors": table.impostors,
        "similarity": np.round(table.similarity, 5).tolist(),
        "fmr": [float(f"{rate:.3g}") for rate in table.fmr],
    }
    folder = os.environ.get("SPLITKNIT_DATA", str(Path(__file__).resolve().parents[3] / "shared" / "data"))
    files = sorted((Path(folder) / "fvc2002_db1b").glob("*.png"))
    if files and not options.prints:
        prints = [Prepared(make_template(print_band(read_print_png(file).image))) for file in files]
        owners = [file.stem.split("_")[0] for file in files]
        real: dict[bool, list[float]] = {True: [], False: []}
        for (a, owner), (b, other) in itertools.combinations(zip(prints, owners, strict=True), 2):
            real[owner == other].append(ridge_match(a, b).similarity)
        largest = max(real[False])
        facts["real_prints"] = {
            "genuine": len(real[True]),
            "impostors": len(real[False]),
            "impostor_median": round(float(np.median(real[False])), 4),
            "impostor_largest": round(largest, 4),
            "gar_at_far_0": round(float(np.mean(np.array(real[True]) > largest)), 4),
        }
    facts["impostor_median"] = round(float(np.median(scores)), 4)
    facts["impostor_largest"] = round(float(scores.max()), 4)
    (PRINTS_TABLE if options.prints else TABLE).write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print({key: value for key, value in facts.items() if key not in ("similarity", "fmr")})


if __name__ == "__main__":
    main()
