"""False match rates of the matchers: all pairs of many simulated fingers, one impression each.

    python validation/match/impostors.py ridge minutiae_of_prints --fingers 150

writes the tables that ``splitknit match`` reads,
``packages/splitknit-match/src/splitknit_match/matching/match_fmr*.json``: scores alone. Surfaces
are the true ones, in poses drawn from the twin's ranges: impostor scores depend on the ridges'
flow, not on how well they were reconstructed.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pressed_prints import finger, press

from splitknit.finger.orientation import find_upright
from splitknit.nominal import default_rig
from splitknit.reconstruction import Surface
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.methods import TABLES
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.score import calibrate_scores
from splitknit_match.matching.surface import surface_template
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, finger_surface

FOLDER = (
    Path(__file__).resolve().parents[2]
    / "packages"
    / "splitknit-match"
    / "src"
    / "splitknit_match"
    / "matching"
)


@dataclass(frozen=True, slots=True)
class Route:
    """From a finger's number to the score of two."""

    source: Callable[[int], Any]
    prepare: Callable[[Any], Any]
    score: Callable[[Any, Any], float]
    what: str


PHALANGE_MM = 20.0
"""Of each finger so much is used, from the tip on: what a reconstruction keeps."""


def drawn_surface(seed: int, scale: float) -> Surface:
    """Finger `seed`, seen by a camera of `scale`."""
    camera = default_rig(scale).camera
    pose = PoseRanges().draw(np.random.default_rng([seed, 7]), camera)
    seen = finger_surface(draw_finger(seed), pose, camera)
    first = int(np.argmax(seen.mask.any(axis=1)))
    mask = seen.mask.copy()
    mask[first + round(PHALANGE_MM * camera.px_per_mm) :] = False
    upright = find_upright(mask)
    return Surface(
        seen.height_mm - seen.shape_mm,
        seen.shape_mm,
        seen.normals,
        mask,
        camera.pitch_mm,
        upright.input_from_upright,
        upright.size,
    )


def pressed(seed: int) -> Any:
    """One finger, pressed once."""
    return press(finger(seed), 0)


COARSE = partial(drawn_surface, scale=0.15)
FINE = partial(drawn_surface, scale=0.27)
"""20 pixels a millimetre, the resolution of a print."""
ROUTES = {
    "ridge": Route(
        COARSE,
        lambda surface: Prepared(surface_template(surface)),
        lambda a, b: ridge_match(a, b).similarity,
        "true surfaces",
    ),
    "minutiae_of_prints": Route(
        pressed, lambda press: print_template(press).minutiae, minutiae_match, "presses"
    ),
}


def table_of(impostors: Sequence[float], what: str, by: str, **more: float) -> dict[str, Any]:
    """What the matcher reads: rates of the scores of `impostors`."""
    table = calibrate_scores(np.asarray(impostors))
    return {
        "what": what,
        "by": by,
        "impostors": table.impostors,
        **more,
        "similarity": (np.ceil(table.similarity * 1e5) / 1e5).tolist(),
        "fmr": [float(f"{rate:.3g}") for rate in table.fmr],
        "impostor_median": round(float(np.median(impostors)), 4),
    }


AT_LEAST = {
    "contactless alone": "fusion",
    "contactless and prints": "fusion",
    "minutiae_of_prints": "minutiae_of_records",
}
"""Whose rates are stated where they are larger: real prints have impostors that simulated ones
lack."""


def at_least(table: dict[str, Any], real: dict[str, Any]) -> dict[str, Any]:
    """A table that states the larger rate of two at every similarity."""
    both = np.union1d(table["similarity"], real["similarity"])
    rates = []
    for each in (table, real):
        place = np.searchsorted(each["similarity"], both, side="right")
        rates.append(np.append(1.0, each["fmr"])[place])
    words = f"of them {table['impostors']:,} {table['what']}; {real['what']}"
    return {
        "what": words,
        "impostors": table["impostors"] + real["impostors"],
        "similarity": both.tolist(),
        "fmr": np.maximum(*rates).tolist(),
        "measured": table,
    }


def ship(name: str, table: dict[str, Any]) -> None:
    """Write a table beside the matcher, and those that follow from it; print its ends."""
    known = {
        each: json.loads((FOLDER / TABLES[each]).read_text(encoding="utf-8"))
        for pair in AT_LEAST.items()
        for each in pair
    }
    stated = at_least(table, known[AT_LEAST[name]]) if name in AT_LEAST else table
    (FOLDER / TABLES[name]).write_text(json.dumps(stated, indent=1) + "\n", encoding="utf-8")
    print(name, stated["impostors"], stated["similarity"][-1], flush=True)
    for other, real in AT_LEAST.items():
        if real == name:
            ship(other, known[other]["measured"])


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("methods", nargs="+", choices=list(ROUTES), metavar="METHOD")
    parser.add_argument("--fingers", type=int, default=150)
    parser.add_argument("--seed", type=int, default=50_000)
    options = parser.parse_args()
    sides: dict[str, list[Any]] = {name: [] for name in options.methods}
    for number in range(options.fingers):
        sources: dict[Any, Any] = {}  # what several methods begin with
        for name, kept in sides.items():
            source = ROUTES[name].source
            if source not in sources:
                sources[source] = source(options.seed + number)
            kept.append(ROUTES[name].prepare(sources[source]))
        if number % 20 == 19:
            print(f"{number + 1} fingers", flush=True)
    for name, kept in sides.items():
        scores = [ROUTES[name].score(a, b) for a, b in itertools.combinations(kept, 2)]
        what = f"{ROUTES[name].what} of {options.fingers} simulated fingers"
        by = "validation/match/impostors.py, all pairs"
        ship(name, table_of(scores, what, by, seed=options.seed))


if __name__ == "__main__":
    main()
