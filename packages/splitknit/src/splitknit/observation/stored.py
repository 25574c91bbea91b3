"""One stored image made linear light, and photographs of a flat surface."""

from __future__ import annotations

from functools import lru_cache
from math import ceil
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band
from splitknit.errors import require
from splitknit.imaging.pixels import block_means, coarse_grid, srgb_code, srgb_light
from splitknit.model import FloatArray, PixelArray

_ROWS_AT_ONCE = 64


@lru_cache(maxsize=4)
def decode_table(dtype: np.dtype[Any], encoding: str) -> FloatArray:
    """Read-only table from stored integer to linear light in [0, 1]: ``linear`` or ``srgb`` (IEC
    61966-2-1)."""
    require(
        encoding in ("linear", "srgb"),
        f"encoding must be 'linear' or 'srgb', but it is '{encoding}'.",
    )
    full_scale = int(np.iinfo(dtype).max)
    values = np.arange(full_scale + 1, dtype=np.float64) / full_scale
    table = (srgb_light(values) if encoding == "srgb" else values).astype(np.float32)
    table.setflags(write=False)
    return table


def linear_image(
    pixels: PixelArray,
    encoding: str,
    exposure: float = 1.0,
    black_level: float = 0.0,
    binning: float = 1,
) -> FloatArray:
    """Linear light (H // binning, W // binning, C) float32 of one stored image (H, W, C) uint8 or
    uint16.

    `exposure`: relative (time times gain), by which the light is divided; `black_level`: stored
    value of no light; `binning`: average blocks of this many pixels a side, a multiple of 1/8 from
    1 upwards; rows and columns that fill no block are dropped.
    """
    height, width = (int(n // binning) for n in pixels.shape[:2])
    table = decode_table(pixels.dtype, encoding)
    light = np.empty((height, width, pixels.shape[2]), dtype=np.float32)
    columns = ceil(width * binning)
    # in strips: what lies between stored values and means stays small
    for top in range(0, height, _ROWS_AT_ONCE):
        part = slice(top, min(top + _ROWS_AT_ONCE, height))
        stored = pixels[int(part.start * binning) : ceil(part.stop * binning), :columns]
        decoded = _decoded(np.ascontiguousarray(stored), table, encoding)
        if binning > 1:
            decoded = block_means(decoded, (part.stop - part.start, width), binning)
        light[part] = decoded.reshape(light[part].shape)
    light -= np.float32(np.interp(black_level, np.arange(table.size), table))
    light *= 1.0 / exposure
    return light


def stored_values(light: FloatArray, encoding: str) -> NDArray[np.uint16]:
    """Linear light in [0, 1] as files of 16 bits store it, clipped: the inverse of
    :func:`decode_table`."""
    light = np.clip(light, 0.0, 1.0)
    code = srgb_code(light) if encoding == "srgb" else light
    return np.asarray(np.rint(code * 65535.0), dtype=np.uint16)


def _decoded(stored: NDArray[Any], table: FloatArray, encoding: str) -> FloatArray:
    """Linear light of contiguous stored values, by `table` of :func:`decode_table`."""
    if encoding == "linear":
        light = stored.astype(np.float32)
        light *= table[1]
        return light
    if stored.dtype == np.uint8:
        return np.asarray(cv2.LUT(stored.view(np.uint8), table).reshape(stored.shape))
    return np.asarray(table[stored])


def flat_light(band: Band, encoding: str) -> FloatArray:
    """(L, h, w) linear light of a band's flat images. Raises BadInput if they are black in
    places."""
    assert band.flat is not None
    scale = float(np.iinfo(band.flat.dtype).max) / float(np.iinfo(band.pixels.dtype).max)
    return np.stack(
        [
            lit_everywhere(
                linear_image(image[..., None], encoding, float(exposure), scale * float(black))[
                    ..., 0
                ]
            )
            for image, exposure, black in zip(
                band.flat, band.exposure, band.black_level, strict=True
            )
        ]
    )


def coarse_flat(image: FloatArray) -> FloatArray:
    """A flat surface's image (H, W) on a coarse grid, smoothed over its pixels; BadInput if it is
    black in places."""
    return lit_everywhere(np.asarray(coarse_grid(image), dtype=np.float32))


def lit_everywhere(flat: FloatArray) -> FloatArray:
    """The image (..., h, w) of a flat surface. Raises BadInput if it is black in places."""
    require(
        float(flat.min()) > 1e-4 * float(flat.max()) > 0.0,
        "the flat photographs are black in places; light the whole field, and check their black"
        " level.",
    )
    return flat


def flat_at(
    flat: FloatArray,
    size: tuple[int, ...],
    corner: tuple[int, ...],
    binning: float,
    shape: tuple[int, ...],
) -> FloatArray:
    """A coarse flat image (h, w) of images of `size` on the pixels of a window that begins at
    `corner`."""
    y_step, x_step = np.array(flat.shape) / size
    x = (corner[1] + 0.5 * binning) * x_step - 0.5
    y = (corner[0] + 0.5 * binning) * y_step - 0.5
    matrix = np.array([[binning * x_step, 0.0, x], [0.0, binning * y_step, y]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(flat, matrix, shape[1::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    )
