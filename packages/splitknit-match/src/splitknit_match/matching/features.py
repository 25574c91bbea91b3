"""The thesis's features: histograms of local binary patterns.

One channel (H, W) becomes a vector whose Euclidean distance to another finger's is its dissimilarity. Sizes are the
thesis's (75.7 px/mm) and scale with the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_image, require
from splitknit.model import BoolArray, FloatArray

# Codes of local binary patterns are bytes: bit k is set where the neighbour at the angle 2 pi k / 8, counter-clockwise
# from the right, is at least as large as the pixel itself.

Codes = NDArray[np.uint8]

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis's sizes in pixels hold."""
_STRIP = 256
"""Rows whose codes are found at once, about: in smaller strips, threads wait for each other between operations."""


def lbp_codes(image: FloatArray, radius: float = 1.0) -> Codes:
    """Codes (H, W) of an image (H, W); pixels beyond the border repeat its edge.

    Raises BadInput if the image is not finite and two-dimensional, or the radius is not positive.

    Source: Ojala, Pietikainen and Maenpaa 2002, Multiresolution gray-scale and rotation invariant texture
    classification with local binary patterns, section 2.1; the thesis, section 5.2.1.

    >>> lbp_codes(np.array([[0, 0, 0], [0, 5, 9], [0, 0, 0]], np.float32))[1, 1].item()
    1
    """
    image = check_image(image)
    return np.concatenate([strip.copy() for strip in _code_strips(image, radius, _STRIP)])


def _code_strips(image: FloatArray, radius: float, rows: int) -> Iterator[Codes]:
    """Codes of `rows` rows after the other: few enough for the cache. Each lies where the one before lay."""
    require(np.isfinite(radius) and 0 < radius < 1000, f"the radius must be positive, but it is {radius}.")
    diagonal = radius * float(np.sqrt(0.5))
    close = radius <= 1
    border = 1 if close else int(np.ceil(radius)) + 1
    height, width = image.shape[0], image.shape[1] + 2 * border
    rows = min(rows, height)
    values = np.empty((4, (rows + 2 * border) * width), dtype=np.float32)
    bits = np.empty((4, rows * width), dtype=np.bool_)
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        above, below = max(border - top, 0), max(bottom + border - height, 0)
        strip = values[0, : (bottom - top + 2 * border) * width].reshape(-1, width)
        part = image[top - border + above : bottom + border - below]
        cv2.copyMakeBorder(part, above, below, border, border, cv2.BORDER_REPLICATE, dst=strip)
        yield _close_codes(strip, diagonal, values[1:], bits) if close else _far_codes(strip, border, diagonal, radius)


def _close_codes(strip: FloatArray, diagonal: float, values: FloatArray, bits: BoolArray) -> Codes:
    """Codes (H, W) of a strip (H + 2, W + 2), for neighbours within a pixel: the circle's radius is at most 1.

    A neighbour to the right is at least as large as the pixel where the step to the next pixel is not negative. One at
    the upper right is where that step and the step upwards, interpolated to the right, have no negative sum, and so on:
    four fields of steps serve all eight. The steps to the right are divided by 1 - `diagonal`, which saves a factor.
    The fields take `values` (4, at least (H + 1)(W + 2)) and `bits` (4, as many): memory that the cache has already.
    """
    width, flat = strip.shape[1], strip.reshape(-1)
    size = len(flat) - 2 * width
    right = values[0, : size + 1]  # from the pixel before the first one on
    # the last row of each are the steps from below; the last one lies where the strip lay
    up, up_left, up_right = *values[1:, : size + width], flat[: size + width]
    lower = slice(width, None)
    codes, bit, upper_right, lower_left = bits[:, :size]
    np.subtract(flat[width : width + size + 1], flat[width - 1 : width + size], out=right)
    np.subtract(flat[:-width], flat[width:], out=up)
    right *= np.float32(-1 / (1 - diagonal))
    cv2.scaleAdd(up[:-1], diagonal / (1 - diagonal), up[1:], dst=up_left[1:])
    cv2.scaleAdd(up[1:], diagonal / (1 - diagonal), up[:-1], dst=up_right[:-1])
    np.greater_equal(up_right[:size], right[1:], out=upper_right)
    np.greater_equal(right[:-1], up_left[lower], out=lower_left)
    np.negative(right, out=right)
    # from the highest bit to the lowest: each doubles what is there
    code: Codes = codes.view(np.uint8)
    none = np.float32(0)
    np.greater_equal(right[1:], up_right[lower], out=codes)
    others: tuple[Callable[[], BoolArray], ...] = (
        lambda: np.less_equal(up[lower], none, out=bit),
        lambda: lower_left,
        lambda: np.less_equal(right[:-1], none, out=bit),
        lambda: np.greater_equal(up_left[:size], right[:-1], out=bit),
        lambda: np.greater_equal(up[:size], none, out=bit),
        lambda: upper_right,
        lambda: np.greater_equal(right[1:], none, out=bit),
    )
    for reached in others:
        np.add(code, code, out=code)
        np.add(code, reached().view(np.uint8), out=code)
    return np.asarray(code.reshape(-1, width)[:, 1:-1])


def _far_codes(strip: FloatArray, border: int, diagonal: float, radius: float) -> Codes:
    """Codes (H, W) of a strip (H + 2 border, W + 2 border), for neighbours at any distance below `border`."""

    def seen(source: FloatArray, shift: float, axis: int) -> FloatArray:
        """`source` as seen from `shift` pixels further along an axis, without the border there; linear."""
        first = int(np.floor(shift + 1e-9))
        part, length = shift - first, source.shape[axis] - 2 * border

        def cut(start: int) -> FloatArray:
            inside = slice(border + start, border + start + length)
            return source[inside] if axis == 0 else source[:, inside]

        if part <= 1e-9:
            return np.ascontiguousarray(cut(first))
        return np.asarray(cv2.addWeighted(cut(first), 1.0 - part, cut(first + 1), part, 0.0))

    middle, right, left = (seen(strip, shift, 1) for shift in (0.0, diagonal, -diagonal))
    beside, pixel = seen(strip, 0.0, 0), seen(middle, 0.0, 0)
    codes = np.zeros(pixel.shape, dtype=np.uint8)
    for source, shift, axis in (
        (right, diagonal, 0), (middle, radius, 0), (left, diagonal, 0), (beside, -radius, 1),
        (left, -diagonal, 0), (middle, -radius, 0), (right, -diagonal, 0), (beside, radius, 1),
    ):  # fmt: skip
        codes += codes  # from the highest bit to the lowest: each doubles what is there
        codes += (seen(source, shift, axis) >= pixel).view(np.uint8)
    return codes


def uniform_bins() -> Codes:
    """(256,) the bin of each code: 0 to 57 for the uniform ones in rising order, 58 for all others."""
    codes = np.arange(256, dtype=np.uint32)
    turned = (codes >> 1) | ((codes & 1) << 7)
    changes = np.array([int(value).bit_count() for value in codes ^ turned])
    return np.where(changes <= 2, np.cumsum(changes <= 2) - 1, 58).astype(np.uint8)


_UNIFORM_CODES = np.flatnonzero(uniform_bins() < 58)


@lru_cache(maxsize=4)
def _cell_numbers(down: int, across: int, cell: int) -> Codes:
    """Where each pixel of some cells is counted: two places for a cell."""
    column = np.arange(across * cell)
    row = np.arange(down).repeat(cell)[:, None]
    return (row * 2 * across + column // cell * 2 + column % 2).astype(np.uint8)


def _cell_counts(codes: Codes, cell: int) -> NDArray[np.float32]:
    """How often each code occurs in whole cells of codes (H, W): shape (rows, columns, 256)."""
    rows, columns = codes.shape[0] // cell, codes.shape[1] // cell
    result = np.empty((rows, columns, 256), dtype=np.float32)
    # even and odd columns are counted apart: codes beside each other are often equal, and no count waits for the last
    across = min(columns, 128)
    down = min(rows, 128 // across)
    number = _cell_numbers(down, across, cell)
    for i in range(0, rows, max(down, 1)):
        for j in range(0, columns, across):
            block = result[i : i + down, j : j + across]
            part = codes[i * cell : (i + block.shape[0]) * cell, j * cell : (j + block.shape[1]) * cell]
            cells = number[: part.shape[0], : part.shape[1]]
            bins = [2 * down * across, 256]
            counts = cv2.calcHist([cells, part], [0, 1], None, bins, [0, bins[0], 0, 256])
            pairs = counts.reshape(down, across, 2, 256)[: block.shape[0], : block.shape[1]]
            np.add(pairs[:, :, 0], pairs[:, :, 1], out=block)
    return result


def lbp_features(image: FloatArray, px_per_mm: float) -> NDArray[np.float32]:
    """Feature vector of one channel (H, W): histograms of all whole cells, of unit length, with 59 bins.

    Raises BadInput if the image is not finite and two-dimensional, or smaller than a cell.
    """
    image = check_image(image)
    radius, (cell, rows, columns) = max(1.0, px_per_mm / REFERENCE_PX_PER_MM), cells(image, px_per_mm)
    used = image[: rows * cell + int(radius) + 2, : columns * cell + int(radius) + 2]
    strips = _code_strips(used, radius, max(1, _STRIP // cell) * cell)
    counts = np.concatenate([_cell_counts(strip, cell) for strip in strips])
    every = counts[0, 0].sum()
    counts = counts[..., _UNIFORM_CODES]  # patterns with more than two changes around the circle share one bin
    counts = np.concatenate([counts, every - counts.sum(axis=2, keepdims=True)], axis=2)
    return np.asarray(counts / np.sqrt((counts * counts).sum(axis=2, keepdims=True))).ravel()


_CELL_PX = 64.0
"""Side of a cell at 75.7 px/mm."""


def cell_px(px_per_mm: float) -> int:
    """Side of a cell in pixels of an image."""
    return max(4, round(_CELL_PX * px_per_mm / REFERENCE_PX_PER_MM))


def cells(image: FloatArray, px_per_mm: float) -> tuple[int, int, int]:
    """Side of a cell, and rows and columns of whole cells of an image; BadInput if it holds none."""
    cell = cell_px(px_per_mm)
    rows, columns = (side // cell for side in image.shape)
    require(rows > 0 and columns > 0, f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.")
    return cell, rows, columns
