"""How far noise on a surface changes the shape index, by quadratic and by cubic fits of its
curvature.

    python validation/prints/curvature_noise.py CAPTURE RESULT

The result is a reconstruction of the capture, which is a simulated one (its ``truth.npz`` is used).
Prints one JSON object: rms changes in the middle and at the edge of the mask.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from splitknit.io.npz import read_npz
from splitknit_match.prints.curvature import curvature, window_side
from splitknit_match.prints.sources import read_source


def fits(capture: Path, surface) -> dict[str, dict[str, float]]:
    """Quadratic against cubic under noise on the true surface."""
    pitch = surface.pitch_mm
    truth = read_npz(capture / "truth.npz")
    height = truth["height_mm"]
    mask = surface.mask & np.isfinite(truth["height_mm"])
    half = window_side(1 / pitch) // 2
    deep = cv2.erode(np.pad(mask.astype(np.uint8), 1), np.ones((2 * half + 1,) * 2))[1:-1, 1:-1] > 0
    rim = mask & ~deep
    rng = np.random.default_rng(1)
    facts = {}
    for degree, word in ((2, "quadratic"), (3, "cubic")):
        clean = curvature(height, mask, pitch, degree=degree).shape_index
        for sigma_um in (0.5, 2.0, 5.0):
            noise = rng.standard_normal(height.shape).astype(np.float32) * np.float32(
                sigma_um / 1000
            )
            noisy = curvature(
                np.where(mask, height + noise, height), mask, pitch, degree=degree
            ).shape_index
            row = {}
            for zone, where in (("full_windows", deep), ("cut_windows", rim)):
                both = where & np.isfinite(clean) & np.isfinite(noisy)
                row[zone] = round(float(np.sqrt(np.mean((noisy - clean)[both] ** 2))), 4)
            facts[f"{word}, noise {sigma_um} um"] = row
    return facts


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("result", type=Path)
    options = parser.parse_args()
    print(
        json.dumps(
            fits(options.capture, read_source(options.result, photo=False, surface=True)), indent=1
        )
    )
