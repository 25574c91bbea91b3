"""A result against the truth of a finger whose light the fast twin did not make.

    python validation/path_traced/score.py RESULT TRUTH

RESULT is a result folder, TRUTH a ``truth.npz`` or the folder that has it.

It prints JSON: the whole surface, the ridge band below 60 degrees of slant and in classes of slant,
error over stated uncertainty, and the relief that was found where there are no ridges.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.errors import BadInput, require
from splitknit.io.npz import read_npz

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RIDGE_MM = 0.32
"""Standard deviation of the Gaussian that takes away what is slower than ridges."""
BORDER_MM = 0.33
"""Width of the skin along the outline that is not scored."""
PERIOD_MM = 0.86
"""Two ridges: side of the square in which the truth is looked at for ridges."""
CLASSES_DEG = (0, 15, 30, 45, 60)
MIN_PIXELS = 2000
"""Pixels below which a class is left out."""


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        require(len(words) == 2, "give a result folder and a truth: score.py RESULT TRUTH.")
        result = Path(words[0])
        truth = Path(words[1])
        result_arrays = read_npz(result / "height.npz")
        known = read_npz(truth / "truth.npz" if truth.is_dir() else truth)
        print(json.dumps(score(result_arrays, known), indent=1))
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def score(
    estimate: dict[str, NDArray[np.generic]], known: dict[str, NDArray[np.generic]]
) -> dict[str, float]:
    """Score a result's ``height.npz`` against a truth: ``height_mm``, ``shape_mm``, ``mask``,
    ``px_mm`` (``pitch_mm``).

    Ridges are scored where the truth's ``pattern_weight``, or its relief, says that there are some.
    """
    height, true, shape = (
        np.asarray(field, dtype=np.float64)
        for field in (estimate["height_mm"], known["height_mm"], known["shape_mm"])
    )
    require(
        height.shape == true.shape,
        f"the result has {height.shape} pixels, but the truth has {true.shape}.",
    )
    pitch_mm = float(known["px_mm" if "px_mm" in known else "pitch_mm"])
    finger = np.asarray(known["mask"], dtype=np.bool_)
    both = np.asarray(estimate["mask"], dtype=np.bool_) & finger & np.isfinite(height)
    inner = ndimage.binary_erosion(both, iterations=max(int(BORDER_MM / pitch_mm), 1))
    rows, columns = np.gradient(np.where(finger, shape, np.nan), pitch_mm)
    slant_deg = np.nan_to_num(np.degrees(np.arctan(np.hypot(rows, columns))), nan=90.0)
    error = (height - true)[inner]
    result = {"coverage": float(both.sum() / finger.sum()), "surface_rms_mm": float(np.std(error))}

    ridges, relief = (_ridge_band(field - shape, both, pitch_mm) for field in (height, true))
    if "pattern_weight" in known:
        weight = np.asarray(known["pattern_weight"])
        ridged, flat = inner & (weight > 0.5), weight < 0.1
    else:
        square = max(round(PERIOD_MM / pitch_mm), 1)
        flat = ndimage.uniform_filter(relief**2, square) < 1e-6
        ridged = inner & ~flat
    classes = {"": (0, CLASSES_DEG[-1])} | {
        f"_{low}_{high}": (low, high) for low, high in pairwise(CLASSES_DEG)
    }
    stated = (
        np.asarray(estimate["uncertainty_um"], dtype=np.float64)
        if "uncertainty_um" in estimate
        else None
    )
    for name, (low, high) in classes.items():
        where = (
            (ridged if ridged.sum() >= MIN_PIXELS else inner)
            & (slant_deg >= low)
            & (slant_deg < high)
        )
        if where.sum() < MIN_PIXELS:
            continue
        a, b = ridges[where], relief[where]
        if (where & ridged).any():
            result[f"ridge_corr{name}"] = float(np.corrcoef(a, b)[0, 1])
            result[f"ridge_gain{name}"] = float(a @ b / (b @ b))
            result[f"ridge_rms_um{name}"] = _rms_um(a - b)
        if stated is not None and np.isfinite(stated[where]).all():
            off = 1000.0 * np.abs(a - b)
            result[f"error_over_stated{name}"] = float(
                np.sqrt(np.mean(off**2) / np.mean(stated[where] ** 2))
            )
            result[f"within_one_sigma{name}"] = float(np.mean(off < stated[where]))
    where = inner & flat & (slant_deg < 45)
    if where.sum() >= MIN_PIXELS:
        result["false_relief_um"] = _rms_um((ridges - relief)[where])
    return result


def _ridge_band(height: Array, mask: Mask, pitch_mm: float) -> Array:
    """Height less its mean over a Gaussian, both within `mask`; zero outside."""
    sigma = RIDGE_MM / pitch_mm
    filled = np.where(mask, height, 0.0)
    weight = np.maximum(ndimage.gaussian_filter(mask.astype(np.float64), sigma), 1e-3)
    return np.where(mask, filled - ndimage.gaussian_filter(filled, sigma) / weight, 0.0)


def _rms_um(values: Array) -> float:
    return float(1000.0 * np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
