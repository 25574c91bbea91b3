"""The features that the thesis tried beside local binary patterns: HOG, Gabor energies, shape context.

Each turns one channel (H, W) into a vector whose Euclidean distance to another finger's is its dissimilarity. Sizes are
the thesis's (75.7 px/mm) and scale with the image. Section 5.2 names the three without settings; these are usual.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit import BoolArray, Checked, FloatArray, Limits, check_image, gaussian_mean, require

# Codes of local binary patterns are bytes: bit k is set where the neighbour at the angle 2 pi k / 8, counter-clockwise
# from the right, is at least as large as the pixel itself.

Codes = NDArray[np.uint8]

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis's sizes in pixels hold."""
_STRIP = 256
"""Rows whose codes are found at once, about: in smaller strips, threads wait for each other between operations."""


@dataclass(frozen=True, slots=True)
class LbpSettings(Checked):
    """Patterns and cells; sizes hold at 75.7 px/mm and scale with the image."""

    radius_px: Annotated[float, Limits(0, above=True)] = 1.0
    """Radius of the circle of neighbours; on coarser images at least one of their pixels."""
    uniform: bool = True
    """Whether patterns with more than two changes around the circle share one bin (59 bins instead of 256)."""
    normalisation: Literal["l2", "l1", "none"] = "l2"
    """How each cell's histogram is normalised: ``l2`` (unit length), ``l1`` (unit sum) or ``none`` (counts)."""
    interpolation: Literal["linear", "nearest"] = "linear"
    """``linear`` takes diagonal neighbours on the circle, ``nearest`` the nearest pixels."""

    def radius(self, px_per_mm: float) -> float:
        """Radius in pixels of an image."""
        return max(1.0, self.radius_px * px_per_mm / REFERENCE_PX_PER_MM)


def lbp_codes(image: FloatArray, radius: float = 1.0, interpolation: str = "linear") -> Codes:
    """Codes (H, W) of an image (H, W); pixels beyond the border repeat its edge.

    Raises BadInput if the image is not finite and two-dimensional, or the radius is not positive.

    Source: Ojala, Pietikainen and Maenpaa 2002, Multiresolution gray-scale and rotation invariant texture
    classification with local binary patterns, section 2.1; the thesis, section 5.2.1.

    >>> lbp_codes(np.array([[0, 0, 0], [0, 5, 9], [0, 0, 0]], np.float32))[1, 1].item()
    1
    """
    image = check_image(image)
    return np.concatenate([strip.copy() for strip in _code_strips(image, radius, interpolation, _STRIP)])


def _code_strips(image: FloatArray, radius: float, interpolation: str, rows: int) -> Iterator[Codes]:
    """Codes of `rows` rows after the other: few enough for the cache. Each lies where the one before lay."""
    require(np.isfinite(radius) and 0 < radius < 1000, f"the radius must be positive, but it is {radius}.")
    diagonal = radius * float(np.sqrt(0.5))
    close = radius <= 1 and interpolation == "linear"
    if interpolation == "nearest":
        diagonal, radius = float(np.round(diagonal)), float(np.round(radius))
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


def _histograms(counts: NDArray[np.float32], settings: LbpSettings) -> NDArray[np.float32]:
    """Counts of codes (rows, columns, 256), normalised: the last axis has 59 or 256 bins."""
    if settings.uniform:
        every = counts[0, 0].sum()
        counts = counts[..., _UNIFORM_CODES]
        counts = np.concatenate([counts, every - counts.sum(axis=2, keepdims=True)], axis=2)
    if settings.normalisation == "none":
        return counts
    squared = settings.normalisation == "l2"
    length = (counts * counts if squared else counts).sum(axis=2, keepdims=True)
    return np.asarray(counts / (np.sqrt(length) if squared else length))


def lbp_features(image: FloatArray, px_per_mm: float, settings: LbpSettings | None = None) -> NDArray[np.float32]:
    """Feature vector of one channel (H, W): the normalised histograms of all whole cells.

    Raises BadInput if the image is not finite and two-dimensional, or smaller than a cell.
    """
    settings, image = settings or LbpSettings(), check_image(image)
    radius, (cell, rows, columns) = settings.radius(px_per_mm), _cells(image, px_per_mm)
    used = image[: rows * cell + int(radius) + 2, : columns * cell + int(radius) + 2]
    strips = _code_strips(used, radius, settings.interpolation, max(1, _STRIP // cell) * cell)
    return _histograms(np.concatenate([_cell_counts(strip, cell) for strip in strips]), settings).ravel()


_CELL_PX = 64.0
"""Side of a cell at 75.7 px/mm."""
_HOG_BINS = 9
"""Directions of gradients, over 180 deg."""
_GABOR_DIRECTIONS = 6
"""Directions of the Gabor filters, evenly over 180 deg."""
_GABOR_PERIODS_PX = (24.0, 33.0, 45.0)
"""Ridge periods that the filters answer to, at 75.7 px/mm."""
_CONTEXT_RADII = 5
"""Rings of a shape context, whose radii double."""
_CONTEXT_ANGLES = 12
"""Sectors of a shape context, evenly over 360 deg."""
_CONTEXT_REACH_PX = 192.0
"""Radius of a shape context at 75.7 px/mm."""


def cell_px(px_per_mm: float) -> int:
    """Side of a cell in pixels of an image."""
    return max(4, round(_CELL_PX * px_per_mm / REFERENCE_PX_PER_MM))


def _cells(image: FloatArray, px_per_mm: float) -> tuple[int, int, int]:
    """Side of a cell, and rows and columns of whole cells of an image; BadInput if it holds none."""
    cell = cell_px(px_per_mm)
    rows, columns = (side // cell for side in image.shape)
    require(rows > 0 and columns > 0, f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.")
    return cell, rows, columns


def hog_features(image: FloatArray, px_per_mm: float) -> NDArray[np.float32]:
    """Histograms of oriented gradients: cells, directions shared between two bins, blocks of 2 x 2 cells.

    Source: Dalal and Triggs 2005, Histograms of oriented gradients for human detection.
    """
    image = check_image(image)
    across = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1)
    down = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1)
    size, angle = cv2.cartToPolar(across, down)
    bins, (cell, height, width) = _HOG_BINS, _cells(image, px_per_mm)
    cut = slice(0, height * cell), slice(0, width * cell)
    place = np.asarray(angle)[cut] * np.float32(bins / np.pi) + np.float32(bins - 0.5)
    low = place.astype(np.uint8)  # from bins - 1 to 3 bins: none is negative
    size_of = np.asarray(size)[cut]
    upper = (place - low) * size_of
    first = bins * (np.arange(height * cell)[:, None] // cell * width + np.arange(width * cell)[None, :] // cell)
    turned = (np.arange(257) % bins).astype(np.uint8)
    counts = [
        np.bincount((first + cv2.LUT(low, table)).ravel(), weights=weight.ravel(), minlength=height * width * bins)
        for table, weight in ((turned[:-1], size_of - upper), (turned[1:], upper))
    ]
    grid = (counts[0] + counts[1]).reshape(height, width, bins)
    blocks = np.moveaxis(sliding_window_view(grid, (min(2, height), min(2, width)), (0, 1)), 2, -1)
    blocks = blocks.reshape(*blocks.shape[:2], -1)
    length = np.sqrt((blocks * blocks).sum(axis=-1, keepdims=True))
    clipped = np.minimum(blocks / np.maximum(length, 1e-12), 0.2)
    length = np.sqrt((clipped * clipped).sum(axis=-1, keepdims=True))
    return np.asarray(clipped / np.maximum(length, 1e-12), dtype=np.float32).ravel()


def gabor_features(image: FloatArray, px_per_mm: float) -> NDArray[np.float32]:
    """Mean magnitude of Gabor responses in cells, for each period and direction, of unit length in a cell.

    Source: Jain, Prabhakar, Hong and Pankanti 2000, Filterbank-based fingerprint matching.
    """
    import scipy.fft  # a comparison of templates needs none of it

    image = check_image(image)
    factor = px_per_mm / REFERENCE_PX_PER_MM
    # eight pixels a period are enough for the filters
    shrink = max(1.0, min(_GABOR_PERIODS_PX) * factor / 8.0)
    size = max(1, round(image.shape[1] / shrink)), max(1, round(image.shape[0] / shrink))
    small: NDArray[Any] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    quarter = max(1, size[0] // 4), max(1, size[1] // 4)  # enough for what is as smooth as this mean
    mean = gaussian_mean(
        cv2.resize(small, quarter, interpolation=cv2.INTER_AREA), 0.75 * _GABOR_PERIODS_PX[-1] * factor / shrink
    )
    small = small - cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR)
    _, rows, columns = _cells(image, px_per_mm)
    plane = [scipy.fft.next_fast_len(side + 32) for side in small.shape]  # a border against wrapping round
    spectrum = scipy.fft.fft2(small, s=plane)
    parts = []
    for period_px in _GABOR_PERIODS_PX:
        wave = 1.0 / max(2.5, period_px * factor / shrink)
        width = wave / np.pi  # of a window in space whose sigma is half a period
        for k in range(_GABOR_DIRECTIONS):
            turn = np.pi * k / _GABOR_DIRECTIONS
            down, across = (
                _passed(side, middle, width)
                for side, middle in zip(plane, (wave * np.sin(turn), wave * np.cos(turn)), strict=True)
            )
            band = spectrum.take(down[0], 0).take(across[0], 1) * down[1][:, None]
            band *= across[1]
            # the magnitude at as many points as the filter's band needs; a band's middle turns the phase alone
            answer = np.abs(scipy.fft.ifft2(band, overwrite_x=True)) * np.float32(band.size / (plane[0] * plane[1]))
            seen = [-(-side * of // whole) for side, of, whole in zip(small.shape, band.shape, plane, strict=True)]
            parts.append(cv2.resize(answer[: seen[0], : seen[1]], (columns, rows), interpolation=cv2.INTER_AREA))
    grid = np.stack(parts, axis=-1)
    length = np.sqrt((grid * grid).sum(axis=-1, keepdims=True))
    return np.asarray(grid / np.maximum(length, 1e-12), dtype=np.float32).ravel()


@lru_cache(maxsize=256)
def _passed(side: int, middle: float, width: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Places in the spectrum of `side` values that a Gaussian filter passes (6 widths each way), and its gain there."""
    import scipy.fft  # a comparison of templates needs none of it

    centre, reach = round(middle * side), int(np.ceil(6.0 * width * side))
    count = min(side, scipy.fft.next_fast_len(2 * reach + 1))
    number = centre - count // 2 + np.arange(count)
    gain = np.exp(-((number / side - middle) ** 2) / (2 * width * width))
    return np.mod(number, side), gain.astype(np.float32)


def shape_context_features(image: FloatArray, px_per_mm: float) -> NDArray[np.float32]:
    """Shape contexts of the ridges' flanks: around each cell's middle, where they lie in rings and sectors.

    Flanks are where the channel, freed from its mean over two cells, changes its sign. Fixed places instead of matched
    points make vectors of one length, as the thesis's distance needs them.

    Source: Belongie, Malik and Puzicha 2002, Shape matching and object recognition using shape contexts.
    """
    image = check_image(image)
    cell, rows, columns = _cells(image, px_per_mm)
    positive = (image - _means_down(_means_down(image, cell).T, cell).T) > 0
    flank = np.pad(positive[:, 1:] != positive[:, :-1], ((0, 0), (1, 0)))
    flank[1:] |= positive[1:] != positive[:-1]
    # where flanks lie to a twentieth of the reach is enough
    factor = max(1, int(_CONTEXT_REACH_PX * px_per_mm / REFERENCE_PX_PER_MM / 20))
    down, across = image.shape[0] // factor, image.shape[1] // factor
    blocks = flank[: down * factor, : across * factor].reshape(down, factor, -1).sum(axis=1, dtype=np.float32)
    reach = _CONTEXT_REACH_PX * px_per_mm / REFERENCE_PX_PER_MM / factor
    half = max(2, int(np.ceil(reach)))
    padded = np.pad(blocks.reshape(down, across, factor).sum(axis=2), half)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    # rings whose radii double, the outermost ends at the reach
    ring = _CONTEXT_RADII + np.floor(np.log2(np.maximum(np.hypot(x, y), 1e-9) / reach)).astype(np.int64)
    sector = np.floor(np.mod(np.arctan2(-y, x) / (2 * np.pi), 1.0) * _CONTEXT_ANGLES).astype(np.int64)
    number = np.clip(ring, 0, _CONTEXT_RADII - 1) * _CONTEXT_ANGLES + sector % _CONTEXT_ANGLES
    bins = np.eye(_CONTEXT_RADII * _CONTEXT_ANGLES, dtype=np.float32)[number] * (ring < _CONTEXT_RADII)[..., None]
    top, left = ((np.arange(count) * cell + cell // 2) // factor for count in (rows, columns))
    around = sliding_window_view(padded, ring.shape)[np.ix_(top, left)]
    result = around.reshape(rows * columns, -1) @ bins.reshape(ring.size, -1)  # whole numbers: the same in any order
    counted = np.maximum(result.sum(axis=1, keepdims=True), np.float32(factor * factor))
    return np.asarray(result / counted, dtype=np.float32).ravel()


def _means_down(image: FloatArray, sigma: int) -> FloatArray:
    """Gaussian means of the columns, zeros beyond them: products of matrices take a third of a wide filter's time."""
    rows, step, reach = len(image), 2 * sigma, 4 * sigma
    weights = np.pad(cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F)[:, 0], step)
    band = np.ascontiguousarray(sliding_window_view(weights, step + 2 * reach)[step:0:-1])
    padded = np.pad(image, ((reach, reach - rows % -step), (0, 0)))
    around = sliding_window_view(padded, (step + 2 * reach, image.shape[1]))[::step, 0]
    return np.asarray((band @ around).reshape(-1, image.shape[1])[:rows])
