"""The first crease by a valley of the logarithm (``cut_at_crease=true``) and as the thesis finds it (``equalised``).

python validation/thesis/crease.py POPULATION      # of splitknit simulate population; 2 s a capture

A crease is in view if the simulator drew it across half of the finger at least; found wrongly is one that is cut more
than 1 mm beside it, or where none is in view. Intervals of 95 % (Wilson) take captures as independent.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.finger.locate import FingerSettings, find_finger
from splitknit.io.capture import read_capture
from splitknit.presets import preset_settings

WAYS: tuple[Any, ...] = (True, "equalised")
MIN_POINTS = 40
"""Of the drawn crease's line, which has about 75 across a finger."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("population", type=Path)
    folders = sorted(file.parent for file in parser.parse_args().population.glob("*/session_*/*/impression.json"))
    settings = preset_settings("snk").finding()
    found = [[measure(folder, replace(settings, cut_at_crease=way)) for way in WAYS] for folder in folders]
    for k, way in enumerate(WAYS):
        rows = [pair[k] for pair in found]
        near = [row for row in rows if row is not None and row[0]]
        errors = np.array([abs(row[1]) for row in near if row[1] is not None])
        none = [row for row in rows if row is not None and not row[0]]
        print(
            f"{way}: in view {len(near)}, found within 1 mm {ratio(int((errors < 1.0).sum()), len(near))}, beside it "
            f"{int((errors >= 1.0).sum())}, median error {np.median(errors) if errors.size else np.nan:.2f} mm; not in "
            f"view {len(none)}, cut nevertheless {sum(row[1] is not None for row in none)}"
        )


def measure(folder: Path, settings: FingerSettings) -> tuple[bool, float | None] | None:
    """Whether a crease is in view, and how far below it (mm) it was found; None for a failure to acquire."""
    capture = read_capture(folder)
    with np.load(folder / "truth.npz") as truth:
        line, pitch_mm = truth["landmark_crease_px_0"], float(truth["pitch_mm"])
    try:
        facts = find_finger(capture, settings).facts
    except ValueError:
        return None
    seen = len(line) >= MIN_POINTS
    if not facts["crease_found"]:
        return seen, None
    column, row = np.mean(facts["crease_line"], axis=0)
    true_row = np.interp(column, *line[np.argsort(line[:, 0])].T) if len(line) else np.nan
    return seen, float((row - true_row) * pitch_mm)


def ratio(count: int, total: int) -> str:
    """Percent with Wilson's interval."""
    if total == 0:
        return "-"
    z, p = 1.96, count / total
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z * np.sqrt(p * (1 - p) / total + z * z / (4 * total**2)) / (1 + z * z / total)
    return f"{100 * p:.0f} [{100 * (middle - half):.0f}, {100 * (middle + half):.0f}] %"


if __name__ == "__main__":
    main()
