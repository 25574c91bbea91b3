"""Minutiae found in simulated presses, dry, wet, scratched and noisy, against those of the same press without faults.

    python validation/prints/pressed_minutiae.py [--fingers 9] [--presses 3]

prints recall and precision of both extractors on presses of the usual ranges (``validation/match/pressed_prints.py``)
and of harder ones, and writes ``pressed_minutiae.json`` beside this file. A press without faults has the same place,
turn, stretch and outline; its minutiae are read off its own wave, without the enhancement of pressed prints. Found is
what lies within 8 pixels (0.4 mm) and 30 deg, one to one; judged is what lies a millimetre or more inside the outline.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from splitknit_match.evaluation.intervals import BootstrapSettings
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import Minutiae
from splitknit_match.prints.enhance import gabor_enhance
from splitknit_match.prints.from_file import print_minutiae
from splitknit_match.prints.phase_minutiae import by_phase

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "match"))
from pressed_prints import PressRanges, finger, press

OUT = Path(__file__).with_suffix(".json")
FIRST = 90_100
WITHOUT = PressRanges(moisture=(0.6, 0.6), patches=0.0, dropouts=(0.0, 0.0), noise_grey=(0.0, 0.0), scratches=0)
RANGES = {
    "usual": PressRanges(),
    "hard": PressRanges(patches=0.25, dropouts=(0.2, 0.7), noise_grey=(8.0, 24.0), scratches=5),
}
NEAR_PX, TURN_DEG, MARGIN_PX = 8.0, 30.0, 20.0


def counted(truth: Minutiae, found: Minutiae, inside: NDArray[np.float32]) -> NDArray[np.int64]:
    """True ones, of these found; found ones, of these true."""
    sides = [np.stack([one.x_px, one.y_px], axis=1).astype(float) for one in (truth, found)]
    apart = np.hypot(*(sides[0][:, None] - sides[1][None]).transpose(2, 0, 1))
    turn = np.abs(np.angle(np.exp(1j * (truth.direction_rad[:, None] - found.direction_rad[None]))))
    cost = np.where((apart < NEAR_PX) & (turn < np.deg2rad(TURN_DEG)), apart, 1e3)
    pairs = [k[cost[linear_sum_assignment(cost)] < 1e3] for k in linear_sum_assignment(cost)]
    judged = [inside[one.y_px, one.x_px] >= MARGIN_PX for one in (truth, found)]
    return np.array([part for k in (0, 1) for part in (judged[k].sum(), judged[k][pairs[k]].sum())])


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fingers", type=int, default=9)
    parser.add_argument("--presses", type=int, default=3)
    options = parser.parse_args()
    counts: dict[tuple[str, str], list[NDArray[np.int64]]] = {}
    for k in range(options.fingers):
        master = finger(FIRST + k)
        sums: dict[tuple[str, str], NDArray[np.int64]] = {}
        for number in range(options.presses):
            plain = press(master, number, WITHOUT)
            enhanced = gabor_enhance(plain)
            truth = by_phase(plain, enhanced)
            inside = cv2.distanceTransform(np.pad(enhanced.mask.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
            for name, ranges in RANGES.items():
                image = press(master, number, ranges)
                for how, found in (("phase", print_minutiae(image)), ("mindtct", extract(image, enhance=True))):
                    sums[name, how] = sums.get((name, how), 0) + counted(truth, found, inside)
        for key, value in sums.items():
            counts.setdefault(key, []).append(value)
    facts: dict[str, Any] = {"fingers": options.fingers, "presses": options.presses, "first_seed": FIRST}
    rng = np.random.default_rng(BootstrapSettings().seed)
    for (name, how), values in counts.items():
        table = np.array(values)
        drawn = table[rng.integers(0, len(table), (1000, len(table)))].sum(axis=1)
        row = {}
        for figure, (of, part) in {"recall": (0, 1), "precision": (2, 3)}.items():
            low, high = np.percentile(drawn[:, part] / np.maximum(drawn[:, of], 1), [2.5, 97.5])
            row[figure] = [round(float(x), 3) for x in (table[:, part].sum() / table[:, of].sum(), low, high)]
        facts[f"{name} {how}"] = row
        print(name, how, row)
    OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
