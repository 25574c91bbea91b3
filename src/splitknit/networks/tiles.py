"""Cutting an image into tiles that a convolutional network takes one at a time, with the same result as in one piece.

A network that halves its images three times works on a grid of 8 pixels (its *stride*), and what it makes of a pixel
depends on the image up to some distance away (its *reach*). Tiles begin and end on that grid and carry a margin of at
least the reach on every side where the image goes on; the margin's result is thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class Tile:
    """One piece of work, in pixels of the padded image."""

    source: tuple[slice, slice]
    """Rows and columns that the network sees."""
    inner: tuple[slice, slice]
    """Rows and columns of the network's result that count."""
    target: tuple[slice, slice]
    """Where these go."""


def padded_index(length: int, stride: int) -> NDArray[np.intp]:
    """Index of every row (or column) of an image that reflection lengthens to the next multiple of `stride`.

    Raises
    ------
    BadInput
        If `length` is below `stride`: there is too little to reflect.
    """
    require(length >= stride, f"an image side of {length} pixels is shorter than the network's stride of {stride}.")
    return np.pad(np.arange(length, dtype=np.intp), (0, -length % stride), mode="reflect")


def plan_tiles(shape: tuple[int, int], tile: int, *, reach: int, stride: int) -> list[Tile]:
    """Cut a padded image into tiles of nearly one size, whose sides are at most `tile` without their margins.

    Parameters
    ----------
    shape : rows, columns; both multiples of `stride`
    tile : longest side in pixels; rounded up to a multiple of `stride`
    reach : distance in pixels over which the network looks
    stride : grid of the network in pixels

    Returns
    -------
    list of Tile
        Row by row. The targets cover the image without overlap.
    """
    require(tile >= 1, f"tile must be at least 1 pixel, but it is {tile}.")
    rows, columns = (_spans(length, tile, reach, stride) for length in shape)
    return [
        Tile(source=(r[0], c[0]), inner=(r[1], c[1]), target=(r[2], c[2]))
        for r in rows
        for c in columns
    ]  # fmt: skip


def _spans(length: int, tile: int, reach: int, stride: int) -> list[tuple[slice, slice, slice]]:
    """Source, inner and target along one axis."""
    margin = -(-reach // stride) * stride
    pieces = -(-length // (-(-tile // stride) * stride))
    edges = [round(k * (length // stride) / pieces) * stride for k in range(pieces + 1)]
    spans = []
    for first, last in pairwise(edges):
        low, high = max(first - margin, 0), min(last + margin, length)
        spans.append((slice(low, high), slice(first - low, last - low), slice(first, last)))
    return spans
