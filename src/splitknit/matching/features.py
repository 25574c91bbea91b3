"""The features that the thesis tried beside local binary patterns: HOG, Gabor energies, shape context.

Each turns one channel (H, W) into a vector whose Euclidean distance to another finger's is its dissimilarity. Sizes are
the thesis's (75.7 px/mm) and scale with the image. Section 5.2 names the three and gives no settings; these are usual
ones.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit.errors import check_image, require
from splitknit.matching.lbp import REFERENCE_PX_PER_MM
from splitknit.matching.ridge_band import AnyArray, blur
from splitknit.model import FloatArray

Vector = NDArray[np.float32]


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


def _cell(px_per_mm: float) -> int:
    """Side of a cell in pixels of an image."""
    return max(4, round(_CELL_PX * px_per_mm / REFERENCE_PX_PER_MM))


def hog_features(image: FloatArray, px_per_mm: float) -> Vector:
    """Histograms of oriented gradients: cells, directions shared between two bins, blocks of 2 x 2 cells.

    References
    ----------
    Dalal and Triggs 2005, Histograms of oriented gradients for human detection.
    """
    image = check_image(image)
    across = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1)
    down = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1)
    size, angle = cv2.cartToPolar(across, down)
    cell, bins = _cell(px_per_mm), _HOG_BINS
    height, width = image.shape[0] // cell, image.shape[1] // cell
    require(height > 0 and width > 0, f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.")
    cut = slice(0, height * cell), slice(0, width * cell)
    place = np.asarray(angle)[cut] * np.float32(bins / np.pi) - np.float32(0.5)
    low = np.floor(place)
    share, size_of = place - low, np.asarray(size)[cut]
    number = np.arange(height * cell)[:, None] // cell * width + np.arange(width * cell)[None, :] // cell
    low_bin = np.mod(low.astype(np.int64), bins)
    counts = [
        np.bincount((number * bins + which).ravel(), weights=weight.ravel(), minlength=height * width * bins)
        for which, weight in ((low_bin, (1 - share) * size_of), (np.mod(low_bin + 1, bins), share * size_of))
    ]
    grid = (counts[0] + counts[1]).reshape(height, width, bins)
    rows, columns = max(1, grid.shape[0] - 1), max(1, grid.shape[1] - 1)
    blocks = np.concatenate(
        [
            grid[i : i + rows, j : j + columns]
            for i in range(min(2, grid.shape[0]))
            for j in range(min(2, grid.shape[1]))
        ],
        axis=-1,
    )
    length = np.sqrt((blocks * blocks).sum(axis=-1, keepdims=True))
    clipped = np.minimum(blocks / np.maximum(length, 1e-12), 0.2)
    length = np.sqrt((clipped * clipped).sum(axis=-1, keepdims=True))
    return np.asarray(clipped / np.maximum(length, 1e-12), dtype=np.float32).ravel()


def gabor_features(image: FloatArray, px_per_mm: float) -> Vector:
    """Mean magnitude of Gabor responses in cells, for each period and direction, of unit length in a cell.

    References
    ----------
    Jain, Prabhakar, Hong and Pankanti 2000, Filterbank-based fingerprint matching.
    """
    image = check_image(image)
    factor = px_per_mm / REFERENCE_PX_PER_MM
    # eight pixels a period are enough for the filters
    shrink = max(1.0, min(_GABOR_PERIODS_PX) * factor / 8.0)
    size = max(1, round(image.shape[1] / shrink)), max(1, round(image.shape[0] / shrink))
    small: AnyArray = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    small = small - blur(small, 3 * _GABOR_PERIODS_PX[-1] * factor / shrink)
    cell = _cell(px_per_mm)
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    require(rows > 0 and columns > 0, f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.")
    plane = [scipy.fft.next_fast_len(side + 32) for side in small.shape]  # a border against wrapping round
    spectrum = scipy.fft.fft2(small, s=plane)
    v, u = np.fft.fftfreq(plane[0])[:, None], np.fft.fftfreq(plane[1])[None, :]
    parts = []
    for period_px in _GABOR_PERIODS_PX:
        wave = 1.0 / max(2.5, period_px * factor / shrink)
        width = wave / np.pi  # of a window in space whose sigma is half a period
        for k in range(_GABOR_DIRECTIONS):
            turn = np.pi * k / _GABOR_DIRECTIONS
            passed = np.exp(-((u - wave * np.cos(turn)) ** 2 + (v - wave * np.sin(turn)) ** 2) / (2 * width * width))
            answer = np.abs(scipy.fft.ifft2(spectrum * passed.astype(np.float32)))
            parts.append(
                cv2.resize(answer[: small.shape[0], : small.shape[1]], (columns, rows), interpolation=cv2.INTER_AREA)
            )
    grid = np.stack(parts, axis=-1)
    length = np.sqrt((grid * grid).sum(axis=-1, keepdims=True))
    return np.asarray(grid / np.maximum(length, 1e-12), dtype=np.float32).ravel()


def shape_context_features(image: FloatArray, px_per_mm: float) -> Vector:
    """Shape contexts of the ridges' flanks: around each cell's middle, where they lie in rings and sectors.

    Flanks are where the channel, freed from its mean over two cells, changes its sign. Fixed places instead of matched
    points make vectors of one length, as the thesis's distance needs them.

    References
    ----------
    Belongie, Malik and Puzicha 2002, Shape matching and object recognition using shape contexts.
    """
    image = check_image(image)
    cell = _cell(px_per_mm)
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    require(rows > 0 and columns > 0, f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.")
    positive = (image - blur(image, float(cell))) > 0
    flank = np.zeros(image.shape, dtype=np.float32)
    flank[:, 1:] += positive[:, 1:] != positive[:, :-1]
    flank[1:] += positive[1:] != positive[:-1]
    flank = np.minimum(flank, np.float32(1.0))
    # where flanks lie to a twentieth of the reach is enough
    factor = max(1, int(_CONTEXT_REACH_PX * px_per_mm / REFERENCE_PX_PER_MM / 20))
    small = image.shape[1] // factor, image.shape[0] // factor
    flank = np.asarray(cv2.resize(flank[: small[1] * factor, : small[0] * factor], small, interpolation=cv2.INTER_AREA))
    reach = _CONTEXT_REACH_PX * px_per_mm / REFERENCE_PX_PER_MM / factor
    half = max(2, int(np.ceil(reach)))
    padded = cv2.copyMakeBorder(flank, half, half, half, half, cv2.BORDER_CONSTANT, value=0.0)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    distance = np.hypot(x, y)
    # rings whose radii double, the outermost ends at the reach
    ring = _CONTEXT_RADII - 1 + np.floor(np.log2(np.maximum(distance, 1e-9) / reach)).astype(np.int64) + 1
    ring = np.clip(ring, 0, _CONTEXT_RADII)  # the last one lies outside
    sector = np.floor(np.mod(np.arctan2(-y, x) / (2 * np.pi), 1.0) * _CONTEXT_ANGLES).astype(np.int64)
    count = _CONTEXT_RADII * _CONTEXT_ANGLES
    number = np.where(ring < _CONTEXT_RADII, ring * _CONTEXT_ANGLES + sector % _CONTEXT_ANGLES, count)
    result = np.empty((rows, columns, count), dtype=np.float32)
    for i in range(rows):
        for j in range(columns):
            top, left = (i * cell + cell // 2) // factor, (j * cell + cell // 2) // factor
            part = padded[top : top + 2 * half + 1, left : left + 2 * half + 1]
            result[i, j] = np.bincount(number.ravel(), weights=part.ravel(), minlength=count + 1)[:count]
    total = result.sum(axis=2, keepdims=True)
    return np.asarray(result / np.maximum(total, np.float32(1.0)), dtype=np.float32).ravel()
