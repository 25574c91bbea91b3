"""Smoothing of a surface inside its mask."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.model import BoolArray, FloatArray


def smoothed(values: FloatArray, mask: BoolArray, sigma_px: float) -> FloatArray:
    """Gaussian mean (H, W) over what lies inside the mask; zero outside it.

    Parameters
    ----------
    values : (H, W) float32, ignored outside `mask`
    mask : (H, W) bool
    sigma_px : float, positive
    """

    def blurred(image: FloatArray) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)

    # about the mean, so that float32 keeps what matters
    middle = np.float32(values[mask].mean()) if bool(mask.any()) else np.float32(0.0)
    inside = mask.astype(np.float32)
    total = blurred(np.where(mask, values - middle, np.float32(0.0)).astype(np.float32))
    share = np.maximum(blurred(inside), np.float32(1e-6))
    return np.asarray(np.where(mask, total / share + middle, np.float32(0.0)), dtype=np.float32)
