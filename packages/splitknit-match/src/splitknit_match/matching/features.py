"""The thesis's features: histograms of local binary patterns.

One channel (H, W) becomes a vector whose Euclidean distance to another finger's is its
dissimilarity. Sizes are the thesis's (75.7 px/mm) and scale with the image; neighbours are one
pixel away.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_image
from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray

# Codes of local binary patterns are bytes: bit k is set where the neighbour at the angle 2 pi k /
# 8, counter-clockwise from the right, is at least as large as the pixel itself.

Codes = NDArray[np.uint8]

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis's sizes in pixels hold. Source: thesis."""
_DIAGONAL = float(np.sqrt(0.5))
"""How far right and up a neighbour on the diagonal is. Source: definition."""
_STRIP = 64
"""Rows whose codes are found at once: few enough for the cache."""


def lbp_codes(image: FloatArray) -> Codes:
    """Codes (H, W) of an image (H, W); pixels beyond the border repeat its edge.

    A neighbour to the right is at least as large as the pixel where the step to the next pixel is
    not negative. One at the upper right is where that step and the step upwards, interpolated to
    the right, have no negative sum, and so on: four fields of steps serve all eight. Raises
    BadInput if the image is not finite and two-dimensional.

    Source: Ojala, Pietikainen and Maenpaa 2002, Multiresolution gray-scale and rotation invariant
    texture classification with local binary patterns, section 2.1; the thesis, section 5.2.1.

    >>> lbp_codes(np.array([[0, 0, 0], [0, 5, 9], [0, 0, 0]], np.float32))[1, 1].item()
    1
    """
    padded = np.pad(check_image(image), 1, mode="edge")
    return np.concatenate(
        [_codes(padded[top : top + _STRIP + 2]) for top in range(0, image.shape[0], _STRIP)]
    )


def _codes(padded: FloatArray) -> Codes:
    """Codes (H, W) of an image with a border (H + 2, W + 2)."""
    step = np.diff(padded[1:-1], axis=1) * (1 / (1 - _DIAGONAL))  # saves a factor below
    left, right = step[:, :-1], step[:, 1:]
    upwards = (padded[:-1] - padded[1:]).ravel()  # to each row but the last, from the one below
    near = _DIAGONAL / (1 - _DIAGONAL)
    up_left, up_right = np.empty_like(upwards), np.empty_like(upwards)
    up_left[1:] = cv2.scaleAdd(upwards[:-1], near, upwards[1:]).ravel()
    up_right[:-1] = cv2.scaleAdd(upwards[1:], near, upwards[:-1]).ravel()
    up, up_left, up_right = (
        part.reshape(-1, padded.shape[1])[:, 1:-1] for part in (upwards, up_left, up_right)
    )
    codes = np.zeros(left.shape, dtype=np.uint8)
    for reached in (  # from the highest bit to the lowest: each doubles what is there
        right >= up_right[1:], up[1:] <= 0, -left >= up_left[1:], left <= 0,
        up_left[:-1] >= left, up[:-1] >= 0, up_right[:-1] >= -right, right >= 0,
    ):  # fmt: skip
        codes += codes
        codes += reached
    return codes


@cache
def uniform_bins(neighbours: int = 8) -> Codes:
    """(2^n,) the bin of each code: those of at most two changes around the circle in rising order,
    then all others."""
    codes = np.arange(1 << neighbours, dtype=np.uint32)
    turned = (codes >> 1) | ((codes & 1) << (neighbours - 1))
    uniform = np.bitwise_count(codes ^ turned) <= 2
    return np.where(uniform, np.cumsum(uniform) - 1, np.count_nonzero(uniform)).astype(np.uint8)


def lbp_features(image: FloatArray, px_per_mm: float) -> FloatArray:
    """Feature vector of one channel (H, W): histograms of all whole cells, of unit length, with 59
    bins.

    Raises BadInput if the image is not finite and two-dimensional, or smaller than a cell.
    """
    cell, rows, columns = cells(image, px_per_mm)
    used = lbp_codes(image[: rows * cell + 1, : columns * cell + 1])[
        : rows * cell, : columns * cell
    ]
    first = 59 * (np.arange(columns * cell) // cell)
    bins = cv2.LUT(used, uniform_bins()).reshape(rows, cell, -1)
    counts = np.stack([np.bincount((first + row).ravel(), minlength=59 * columns) for row in bins])
    counts = counts.reshape(-1, 59).astype(np.float32)
    return np.asarray(counts / np.sqrt((counts * counts).sum(axis=1, keepdims=True))).ravel()


_CELL_PX = 64.0
"""Side of a cell at 75.7 px/mm. Source: thesis."""


def cells(
    image: FloatArray | BoolArray, px_per_mm: float, side_px: float = _CELL_PX
) -> tuple[int, int, int]:
    """Side of a cell (`side_px` at 75.7 px/mm), and rows and columns of whole cells of an image;
    BadInput if it holds none."""
    cell = max(4, round(side_px * px_per_mm / REFERENCE_PX_PER_MM))
    rows, columns = (side // cell for side in image.shape)
    require(
        rows > 0 and columns > 0,
        f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.",
    )
    return cell, rows, columns
