"""Pieces of a surface at several strides: the page shows coarse ones first and finer ones where one looks closely.

A tile of stride s holds `TILE` + 1 by `TILE` + 1 values of the grid, every s-th of them, and one more on each side for
its slopes. Values are taken, not averaged: each point on the page is a value of the result, and the points of a coarse
tile are points of the finer ones below it.

A tile's bytes, little-endian: int32 bytes of this tile, stride, row and column of the tile, rows, columns (with the
rim), row and column in the input of the first value; then float32 x, y, z, relief, each rows x columns, NaN where there
is no surface.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.viewer.surface import Surface
from splitknit.errors import require

TILE = 96
_FIRST_VIEW = 70_000
"""Points of the first view."""
_HEAD = struct.Struct("<8i")


def root_stride(surface: Surface) -> int:
    """Stride of the first view, a power of two."""
    stride = 1
    while surface.count / stride**2 > _FIRST_VIEW:
        stride *= 2
    return stride


def strides(surface: Surface) -> list[int]:
    """Strides of all levels, the coarsest first."""
    stride = root_stride(surface)
    return [stride >> k for k in range(stride.bit_length())]


def filled_tiles(surface: Surface, stride: int) -> list[tuple[int, int]]:
    """Row and column of each tile of a level that holds a piece of the surface."""
    mask = surface.mask[::stride, ::stride]
    pad = [(0, -side % TILE) for side in mask.shape]
    blocks = np.pad(mask, pad)
    blocks = blocks.reshape(blocks.shape[0] // TILE, TILE, -1, TILE)
    return [(int(row), int(column)) for row, column in np.argwhere(blocks.any(axis=(1, 3)))]


def tile_bytes(surface: Surface, stride: int, row: int, column: int) -> bytes:
    """Return one tile.

    Raises
    ------
    BadInput
        If there is no such stride or tile.
    """
    require(stride in strides(surface), f"there is no level of stride {stride}.")
    height, width = surface.mask.shape
    high, wide = math.ceil(height / stride), math.ceil(width / stride)
    require(0 <= row * TILE < high and 0 <= column * TILE < wide, f"there is no tile {row}, {column}.")
    # one value before the tile, and TILE, one shared with the next tile, one behind it
    rows = np.arange(row * TILE - 1, min(row * TILE + TILE + 2, high + 1)) * stride
    columns = np.arange(column * TILE - 1, min(column * TILE + TILE + 2, wide + 1)) * stride
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    place = np.ix_(np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))
    values = np.stack([_taken(field[place], inside) for field in _fields(surface)]).astype("<f4")
    first = (int(rows[0]) + surface.corner[0], int(columns[0]) + surface.corner[1])
    total = _HEAD.size + values.nbytes
    return _HEAD.pack(total, stride, row, column, len(rows), len(columns), *first) + values.tobytes()


def first_view(surface: Surface) -> Iterator[bytes]:
    """Tiles of the coarsest level, one after the other."""
    stride = root_stride(surface)
    for row, column in filled_tiles(surface, stride):
        yield tile_bytes(surface, stride, row, column)


def _fields(surface: Surface) -> tuple[NDArray[np.float32], ...]:
    return surface.x_mm, surface.y_mm, surface.height_mm, surface.ridge_mm


def _taken(values: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    return np.where(inside, values, np.float32(np.nan))
