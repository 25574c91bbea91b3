"""How far noise on a surface changes the shape index, by quadratic and by cubic fits of its
curvature, of ``over_fingers.py``: rms changes in the middle and at the edge of the mask.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from splitknit.io.npz import read_npz
from splitknit_match.prints.curvature import curvature, window_side


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
