"""What every integrator does first and last: check the gradient field, and bring heights to a zero mean."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.model import BoolArray, FloatArray


def check_gradients(gradient_x: Any, gradient_y: Any, mask: Any) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return dz/dx, dz/dy (H, W) float32, zero outside the mask, and the mask (H, W).

    Raises BadInput if the shapes differ, the mask is empty, or a gradient inside the mask is NaN or infinite.
    """
    slope_x, slope_y = np.asarray(gradient_x), np.asarray(gradient_y)
    require(
        slope_x.ndim == 2 and slope_x.size > 0,
        f"gradient_x must have the shape (H, W), but it has the shape {slope_x.shape}.",
    )
    require(
        slope_y.shape == slope_x.shape,
        f"gradient_y must have the shape of gradient_x {slope_x.shape}, but it has {slope_y.shape}.",
    )
    inside = check_mask(mask, (int(slope_x.shape[0]), int(slope_x.shape[1])))
    return _inside(slope_x, inside, "gradient_x"), _inside(slope_y, inside, "gradient_y"), inside


def _inside(slope: NDArray[Any], mask: BoolArray, name: str) -> FloatArray:
    values = np.where(mask, slope, 0.0).astype(np.float32)
    require(
        bool(np.isfinite(values).all()),
        f"{name} contains NaN or infinite values inside the mask; take those pixels out of the mask.",
    )
    return values


def zero_mean(height: FloatArray, mask: BoolArray) -> FloatArray:
    """Return `height` with a zero mean over the mask, NaN outside it."""
    mean = float(np.sum(height, where=mask, dtype=np.float64)) / int(np.count_nonzero(mask))
    return np.where(mask, height - np.float32(mean), np.float32(np.nan))


def zero_mean_by_component(height: FloatArray, mask: BoolArray) -> FloatArray:
    """Return `height` with a zero mean over every 4-connected component of the mask, NaN outside it."""
    count, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    if count <= 2:
        return zero_mean(height, mask)
    flat = labels.ravel()
    size = np.bincount(flat, minlength=count)
    total = np.bincount(flat, weights=height.ravel(), minlength=count)
    mean = (total / np.maximum(size, 1)).astype(np.float32)
    return np.where(mask, height - mean[labels], np.float32(np.nan))
