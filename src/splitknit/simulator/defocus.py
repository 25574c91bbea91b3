"""Depth of field of a thin lens, as blur that grows with the distance from the plane in focus."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.model import FloatArray

LEVELS_PER_DOUBLING = 2


def blur_sigma_px(
    depth_mm: FloatArray, focus_mm: float, camera_height_mm: float, aperture_mm: float, px_per_mm: float
) -> FloatArray:
    """Standard deviation, per axis, of the disc that a point at height `depth_mm` becomes on the plane in focus.

    A point d below the plane in focus, which is D from the pupil, becomes a disc of the diameter aperture d / (D + d)
    there (similar triangles); a disc of diameter c has the standard deviation c / 4 per axis.
    """
    distance = camera_height_mm - focus_mm
    below = focus_mm - depth_mm
    disc_mm = aperture_mm * np.abs(below) / (distance + below)
    return np.asarray(0.25 * px_per_mm * disc_mm, dtype=np.float32)


def defocus(image: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """Blur (H, W, C) `image` by a Gaussian whose width `sigma_px` (H, W) changes from pixel to pixel.

    Each pixel interpolates, linearly in the variance, between the two nearest of a ladder of evenly blurred images.
    """
    largest = float(sigma_px.max())
    if largest < 0.1:
        return image
    steps = max(int(np.ceil(LEVELS_PER_DOUBLING * np.log2(max(largest / 0.5, 1.0)))), 1)
    ladder = np.concatenate([[0.0], largest * 2.0 ** (np.arange(-steps, 1) / LEVELS_PER_DOUBLING)])
    variance = sigma_px * sigma_px
    result = np.zeros_like(image)
    lower, low = image, 0.0
    for sigma in ladder[1:]:
        blurred = cv2.GaussianBlur(image, (0, 0), float(sigma), borderType=cv2.BORDER_REPLICATE)
        upper = np.asarray(blurred, dtype=np.float32).reshape(image.shape)
        high = float(sigma) ** 2
        inside = (variance >= low) & ((variance < high) | (sigma == ladder[-1]))
        share = np.clip((variance - low) / (high - low), 0.0, 1.0).astype(np.float32)[..., None]
        result = np.where(inside[..., None], lower + share * (upper - lower), result)
        lower, low = upper, high
    return np.asarray(result, dtype=np.float32)
