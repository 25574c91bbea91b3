"""Linear light of one stored image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray, PixelArray

CHANNELS = {"red": 0, "green": 1, "blue": 2}
GREY_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""ITU-R BT.601 luma weights, the conversion behind the thesis's grey images."""

CHUNK_ROWS = 64
"""Rows of an image that are made at a time."""


def decode_table(dtype: np.dtype[Any], encoding: str) -> FloatArray:
    """Return the table from stored integer to linear light in [0, 1].

    `encoding` is ``linear`` or ``srgb`` (IEC 61966-2-1).
    """
    require(encoding in ("linear", "srgb"), f"encoding must be 'linear' or 'srgb', but it is '{encoding}'.")
    full_scale = int(np.iinfo(dtype).max)
    values = np.arange(full_scale + 1, dtype=np.float64) / full_scale
    if encoding == "srgb":
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return values.astype(np.float32)


def linear_image(
    pixels: PixelArray, encoding: str, exposure: float = 1.0, black_level: float = 0.0, binning: int = 1
) -> FloatArray:
    """Linear light of one stored image, all its channels.

    Parameters
    ----------
    pixels : (H, W, C) uint8 or uint16
    encoding : ``linear`` or ``srgb``
    exposure : relative exposure (time times gain) by which the light is divided
    black_level : stored value of no light
    binning : average blocks of this many pixels a side; rows and columns that fill no block are dropped

    Returns
    -------
    (H // binning, W // binning, C) float32
    """
    height, width = (n // binning for n in pixels.shape[:2])
    table = decode_table(pixels.dtype, encoding)
    light = np.empty((height, width, pixels.shape[2]), dtype=np.float32)
    for top in range(0, height, CHUNK_ROWS):  # what is between stored values and means stays small
        part = slice(top, min(top + CHUNK_ROWS, height))
        stored = pixels[part.start * binning : part.stop * binning, : width * binning]
        decoded = _decoded(np.ascontiguousarray(stored), table, encoding)
        if binning > 1:
            size = (width, part.stop - part.start)
            decoded = np.asarray(cv2.resize(decoded, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        light[part] = decoded.reshape(light[part].shape)
    light -= np.float32(np.interp(black_level, np.arange(table.size), table))
    light *= np.float32(1.0 / exposure)
    return light


def _decoded(stored: NDArray[Any], table: FloatArray, encoding: str) -> FloatArray:
    """Linear light of contiguous stored values, by `table` of :func:`decode_table`."""
    if encoding == "linear":
        light = stored.astype(np.float32)
        light *= table[1]
        return light
    if stored.dtype == np.uint8:
        return np.asarray(cv2.LUT(stored.view(np.uint8), table), dtype=np.float32).reshape(stored.shape)
    return np.asarray(table[stored])


def pick_channel(light: FloatArray, channel: str) -> FloatArray:
    """One channel (h, w) of linear light (h, w, C)."""
    if light.shape[-1] == 1:
        return np.asarray(light[..., 0])
    if channel == "grey":
        return np.asarray(cv2.transform(light, GREY_WEIGHTS[None]), dtype=np.float32).reshape(light.shape[:2])
    return np.asarray(light[..., CHANNELS[channel]])


def bin_mean(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over blocks of `factor` x `factor` pixels of the last two axes; what fills no block is dropped."""
    if factor == 1:
        return image
    height, width = (n // factor for n in image.shape[-2:])
    trimmed = image[..., : height * factor, : width * factor]
    flat = trimmed.reshape(-1, *trimmed.shape[-2:])
    small = [cv2.resize(plane, (width, height), interpolation=cv2.INTER_AREA) for plane in np.ascontiguousarray(flat)]
    return np.asarray(np.stack(small).reshape(*image.shape[:-2], height, width), dtype=np.float32)
