"""A published matcher run as anybody runs an own one: two fingers, or all of a folder as a score
file.

    python validation/published/NAME.py A B  # prints the similarity
    python validation/published/NAME.py PEOPLE --out scores.csv
    splitknit evaluate --scores scores.csv

A and B are captures or results; PEOPLE is a folder of ``splitknit simulate population``, whose
later sessions are compared with its earlier ones. A finger that gives no features is a failure to
acquire: its score is blank.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splitknit.errors import BadInput
from splitknit.reconstruction import Surface
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.evaluation.scores import score_table
from splitknit_match.matching.inputs import read_side


def surface_at(finger: Path, preset: str) -> Surface:
    """Surface of a result, or of a capture as `preset` reconstructs it."""
    surface = read_side(finger, preset).surface
    if surface is None:
        raise BadInput(f"'{finger}' is neither a capture nor a result.")
    return surface


def run(
    features: Callable[[Path, str], Any],
    score: Callable[[Any, Any], float],
    preset: str,
    arguments: list[str] | None = None,
) -> int:
    """Compare what the command line names; `features` of a finger by a preset are None where there
    are too few."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("fingers", nargs="+", type=Path, metavar="FINGER")
    parser.add_argument("--preset", default=preset)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    if len(options.fingers) != (2 if options.out is None else 1):
        parser.error("name two fingers, or one folder of people and --out.")
    try:
        if options.out is not None:
            options.out.write_bytes(_scores(features, score, options.fingers[0], options.preset))
            return 0
        a, b = (features(finger, options.preset) for finger in options.fingers)
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print("failure to acquire" if a is None or b is None else f"{score(a, b):.4f}")
    return 0


def _scores(
    features: Callable[[Path, str], Any],
    score: Callable[[Any, Any], float],
    people: Path,
    preset: str,
) -> bytes:
    captures = sorted(
        file.parent.relative_to(people) for file in people.glob("*/session_*/*/capture.json")
    )
    subject, session, name = (
        list(part) for part in zip(*(capture.parts for capture in captures), strict=True)
    )
    session = [part.removeprefix("session_") for part in session]  # as `splitknit batch` says
    finger = [f"{person}/{which}" for person, which in zip(subject, name, strict=True)]
    sides = [_side(features, people / capture, preset) for capture in captures]
    pairs = comparisons(finger, session)
    a = pairs.a.tolist()
    b = pairs.b.tolist()
    scores = [
        float("nan") if sides[i] is None or sides[j] is None else score(sides[i], sides[j])
        for i, j in zip(a, b, strict=True)
    ]
    ids = {"finger": finger, "subject": subject, "session": session}
    names = {kind: ([of[i] for i in a], [of[j] for j in b]) for kind, of in ids.items()}
    return score_table(pairs.genuine.tolist(), names, {"score": scores})


def _side(features: Callable[[Path, str], Any], capture: Path, preset: str) -> Any:
    try:
        return features(capture, preset)
    except BadInput as error:
        if "nbis-py" in str(error):
            raise
        return None
