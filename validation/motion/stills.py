"""Whether still fingers are taken for moving ones: what the two tests of motion report of captures in which none moved.

    python validation/motion/stills.py POPULATION [--count 80]     # a folder of `splitknit simulate population`

Captures are drawn at random (seed 11). Of each: the largest motion that the measurement between the shots believes,
and, registered all the same, the largest shift and what no surface explains after over before. An image is moved where
the first is at least 0.02 mm, the second too, and the third below 0.95; writes ``stills.json`` beside this file.
"""

from __future__ import annotations

import argparse
import json
import random
from collections.abc import Sequence
from pathlib import Path

from splitknit import read_capture
from splitknit.finger.locate import find_finger
from splitknit.finger.motion import CORRECT_MM
from splitknit.finger.steady import HELPS, register, seen_motion_mm
from splitknit.presets import preset_settings

RESULTS = Path(__file__).resolve().parent / "stills.json"


def measured(folder: Path) -> dict[str, float]:
    """One capture."""
    settings = preset_settings("metric")
    capture = read_capture(folder)
    finger = find_finger(capture, settings)
    found = register(capture, finger)
    motion = {"seen_mm": seen_motion_mm(finger), "registered_mm": found.most_mm}
    return {name: round(value, 4) for name, value in {**motion, "left_over_before": found.after / found.before}.items()}


def summary(captures: dict[str, dict[str, float]]) -> dict[str, float]:
    """The worst of each figure, and how many captures would be touched."""
    rows = list(captures.values())
    min_mm = CORRECT_MM
    touched = [
        row["seen_mm"] >= min_mm and row["registered_mm"] >= min_mm and row["left_over_before"] < HELPS for row in rows
    ]
    return {
        "captures": len(rows),
        "touched": sum(touched),
        "most_seen_mm": max(row["seen_mm"] for row in rows),
        "most_registered_mm": max(row["registered_mm"] for row in rows),
        "least_left_over_before": min(row["left_over_before"] for row in rows),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("population", type=Path)
    parser.add_argument("--count", type=int, default=80)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    folders = sorted(file.parent for file in options.population.glob("S*/session_*/*/capture.json"))
    random.Random(11).shuffle(folders)
    captures = {}
    for folder in folders[: options.count]:
        captures[str(folder.relative_to(options.population))] = measured(folder)
        document = {"summary": summary(captures), "captures": captures}
        options.out.write_text(json.dumps(document, indent=1) + "\n")
    print(json.dumps(summary(captures), indent=1))


if __name__ == "__main__":
    main()
