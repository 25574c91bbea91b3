"""Depth from focus: where in a stack of pictures each place is sharpest, and one picture that is
sharp everywhere.

References
----------
S. Nayar and Y. Nakagawa, "Shape from focus", IEEE TPAMI 16(8), 1994 (modified Laplacian, Gaussian
interpolation).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from views import View, between_neighbours, cloud_of

from splitknit.errors import require
from splitknit.model import FloatArray

# by which the peak of sharpness rises over its mean through the stack, as a fraction of the peak
_MIN_RISE = 0.2


def depth(stack: NDArray[np.floating], window_px: float) -> tuple[FloatArray, FloatArray]:
    """Find the sharpest picture of each pixel.

    `stack`: (N, H, W) linear light, focused at N equally spaced depths, three at least, all at one
    magnification; `window_px`: standard deviation of the window in which sharpness is summed, about
    a ridge period. Returns the number of the picture, with its fraction, (H, W), NaN where the peak
    of sharpness rises over its mean through the stack by less than a fifth of the peak; and the
    light of the sharpest picture (H, W). Raises BadInput if the stack has fewer than three
    pictures.
    """
    require(stack.ndim == 3 and len(stack) >= 3, "a stack of focus needs three pictures at least.")
    kernel = np.array([[-1.0, 2.0, -1.0]], dtype=np.float32)
    sharpness = np.empty(stack.shape, np.float32)
    for k, picture in enumerate(stack):
        even = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
        bend = np.abs(cv2.filter2D(even, -1, kernel)) + np.abs(cv2.filter2D(even, -1, kernel.T))
        light = cv2.GaussianBlur(even, (0, 0), window_px)
        sharpness[k] = cv2.GaussianBlur(bend, (0, 0), window_px) / np.maximum(light, 1e-3)
    best = sharpness.argmax(axis=0)
    middle = np.clip(best, 1, len(stack) - 2)
    three = (
        np.log(np.take_along_axis(sharpness, (middle + k)[None], 0)[0] + 1e-9) for k in (-1, 0, 1)
    )
    fraction = between_neighbours(*three)
    peak = sharpness.max(axis=0)
    known = (
        (best == middle)
        & (np.abs(fraction) <= 1.0)
        & (peak - sharpness.mean(axis=0) > _MIN_RISE * peak)
    )
    sharp = np.take_along_axis(stack, best[None], 0)[0]
    return np.where(known, middle + fraction, np.nan).astype(np.float32), sharp.astype(np.float32)


def scan(camera: View, number: FloatArray, heights_mm: tuple[float, float]) -> FloatArray:
    """Points of a stack whose picture k is focused on the plane z = heights_mm[0] + k
    heights_mm[1]."""
    rays = camera.directions((number.shape[0], number.shape[1]))
    centre = camera.centre_mm
    z = heights_mm[0] + heights_mm[1] * number.astype(np.float64)
    return cloud_of(centre + ((z - centre[2]) / rays[..., 2])[..., None] * rays)
