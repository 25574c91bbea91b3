"""From stored pixel values to linear light.

A stored value v becomes (decode(v) - decode(black)) / exposure, less the ambient light treated the same way. Values
are relative to the full scale of the file (255 or 65535), so an unscaled image lies in [0, 1].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.types import Band, FloatArray, PixelArray

CHANNELS = {"red": 0, "green": 1, "blue": 2}
GREY_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""ITU-R BT.601 luma weights, the conversion behind the thesis's grey images."""

Window = tuple[slice, slice]


def decode_table(dtype: np.dtype[np.uint8] | np.dtype[np.uint16], encoding: str) -> FloatArray:
    """Return the table from stored integer to linear light in [0, 1].

    `encoding` is ``linear`` or ``srgb`` (IEC 61966-2-1).
    """
    require(encoding in ("linear", "srgb"), f"encoding must be 'linear' or 'srgb', but it is '{encoding}'.")
    full_scale = int(np.iinfo(dtype).max)
    values = np.arange(full_scale + 1, dtype=np.float64) / full_scale
    if encoding == "srgb":
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return values.astype(np.float32)


def linear_image(  # noqa: PLR0917
    pixels: PixelArray,
    encoding: str,
    channel: str = "grey",
    exposure: float = 1.0,
    black_level: float = 0.0,
    binning: int = 1,
) -> FloatArray:
    """Linear light of one stored image.

    Parameters
    ----------
    pixels : (H, W, C) uint8 or uint16
    encoding : ``linear`` or ``srgb``
    channel : ``grey``, ``red``, ``green`` or ``blue``; a grey file gives its one channel for all of them
    exposure : relative exposure (time times gain) by which the light is divided
    black_level : stored value of no light
    binning : average blocks of this many pixels a side; rows and columns that fill no block are dropped

    Returns
    -------
    (H // binning, W // binning) float32
    """
    planes = _planes(pixels, channel)
    table = decode_table(pixels.dtype, encoding)
    black = float(np.interp(black_level, np.arange(table.size), table))
    total: FloatArray | None = None
    for weight, plane in planes:
        light = table[_trim(plane, binning)]
        light = bin_mean(light, binning)
        total = light * np.float32(weight) if total is None else total + light * np.float32(weight)
    assert total is not None
    scale = np.float32(1.0 / exposure)
    return np.asarray((total - np.float32(black)) * scale, dtype=np.float32)


def linear_stack(
    band: Band,
    encoding: str,
    channel: str = "grey",
    window: Window | None = None,
    binning: int = 1,
) -> FloatArray:
    """Linear light (L, h, w) of a band inside `window`: black level and ambient removed, exposures made equal.

    Negative values, which noise gives where there is no light, are kept: clipping would bias dark pixels upwards.
    """
    rows, columns = window if window is not None else (slice(None), slice(None))
    ambient: FloatArray | float = 0.0
    if band.ambient is not None:
        ambient = linear_image(
            band.ambient[rows, columns], encoding, channel, band.ambient_exposure, band.ambient_black_level, binning
        )
    images = [
        linear_image(
            band.pixels[k, rows, columns],
            encoding,
            channel,
            float(band.exposure[k]),
            float(band.black_level[k]),
            binning,
        )
        - ambient
        for k in range(band.pixels.shape[0])
    ]
    return np.stack(images).astype(np.float32, copy=False)


def has_colour(band: Band) -> bool:
    """Whether the band's images carry three channels."""
    return bool(band.pixels.shape[-1] == 3)


def bin_mean(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over blocks of `factor` x `factor` pixels of the last two axes, which must be multiples of `factor`."""
    if factor == 1:
        return image
    *lead, height, width = image.shape
    blocks = image.reshape(*lead, height // factor, factor, width // factor, factor)
    return np.asarray(blocks.mean(axis=(-3, -1)), dtype=np.float32)


def _planes(pixels: PixelArray, channel: str) -> list[tuple[float, NDArray[np.uint8] | NDArray[np.uint16]]]:
    require(channel == "grey" or channel in CHANNELS, f"channel '{channel}' is not known.")
    if pixels.shape[-1] == 1:
        return [(1.0, pixels[..., 0])]
    if channel == "grey":
        return [(float(GREY_WEIGHTS[c]), pixels[..., c]) for c in range(3)]
    return [(1.0, pixels[..., CHANNELS[channel]])]


def _trim(plane: NDArray[np.uint8] | NDArray[np.uint16], factor: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    return plane[: plane.shape[0] // factor * factor, : plane.shape[1] // factor * factor]
