"""Pixels of images: their channels, means over blocks, and the sRGB code that files of pictures
hold."""

from __future__ import annotations

from math import ceil
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray

Window = tuple[slice, slice]
"""Rows and columns of an image."""
CHANNELS = {"red": 0, "green": 1, "blue": 2}
GREY_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Weights of red, green and blue in luma, the conversion behind the thesis's grey images. Source:
ITU-R BT.601."""


def srgb_code(light: FloatArray) -> FloatArray:
    """Linear light in [0, 1] as sRGB stores it (IEC 61966-2-1), in [0, 1]."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def srgb_light(code: FloatArray) -> FloatArray:
    """Stored sRGB values in [0, 1] as linear light in [0, 1] (IEC 61966-2-1)."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def pick_channel(light: FloatArray, channel: str) -> FloatArray:
    """One channel (h, w) of light (h, w, C): ``red``, ``green``, ``blue`` or ``grey``."""
    if light.shape[-1] == 1:
        return light[..., 0]
    if channel == "grey":
        return np.asarray(cv2.transform(light, GREY_WEIGHTS[None]).reshape(light.shape[:2]))
    return light[..., CHANNELS[channel]]


def block_means(image: NDArray[Any], shape: tuple[int, int], side: float) -> FloatArray:
    """Means (h, w) or (h, w, C) over blocks of `side` pixels, fractions of pixels by their area."""
    if side == int(side):
        means = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)
    else:
        means = cv2.resize(image, None, fx=1 / side, fy=1 / side, interpolation=cv2.INTER_AREA)
    return np.asarray(means[: shape[0], : shape[1]])


def bin_mean(image: FloatArray, factor: float) -> FloatArray:
    """Mean over blocks of `factor` x `factor` pixels of the last two axes; what fills no block is
    dropped."""
    if factor == 1:
        return image
    height, width = (int(n // factor) for n in image.shape[-2:])
    trimmed = image[..., : ceil(height * factor), : ceil(width * factor)]
    flat = trimmed.reshape(-1, *trimmed.shape[-2:])
    small = [block_means(plane, (height, width), factor) for plane in flat]
    return np.stack(small).reshape(*image.shape[:-2], height, width)


def coarse_grid(image: FloatArray) -> FloatArray:
    """A flat-field image (H, W) on a coarse grid, smoothed, so that dust and grain on the flat
    target do not enter it."""
    scale = min(1.0, 300 / max(image.shape))
    size = (max(2, round(image.shape[1] * scale)), max(2, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small if scale == 1.0 else cv2.GaussianBlur(small, (0, 0), 1.0))
