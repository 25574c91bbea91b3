"""The features that the thesis tried beside local binary patterns (5.2): HOG, Gabor energies, shape
context.

    python validation/published/image_features.py hog|gabor|shape_context A B [--preset snk]
    python validation/published/image_features.py hog PEOPLE --out scores.csv

Each turns one channel (H, W) into a vector whose Euclidean distance to another finger's is its
dissimilarity; masks, boxes and the score (5.2) are those of ``--method thesis``, without its gate.
Sizes are the thesis's (75.7 px/mm) and scale with the image. The thesis names the three without
settings; these are usual.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scored import run, surface_at

from splitknit.checks import check_image
from splitknit.imaging.geometry import gaussian_mean
from splitknit.model import FloatArray
from splitknit_match.matching.features import REFERENCE_PX_PER_MM, cells
from splitknit_match.matching.score import dissimilarity
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.thesis import ATTRIBUTES, FingerImages, align_masks, to_box

HOG_BINS = 9
"""Directions of gradients, over 180 deg."""
GABOR_DIRECTIONS = 6
"""Directions of the Gabor filters, evenly over 180 deg."""
GABOR_PERIODS_PX = (24.0, 33.0, 45.0)
"""Ridge periods that the filters answer to, at 75.7 px/mm."""
CONTEXT_RADII = 5
"""Rings of a shape context, whose radii double."""
CONTEXT_ANGLES = 12
"""Sectors of a shape context, evenly over 360 deg."""
CONTEXT_REACH_PX = 192.0
"""Radius of a shape context at 75.7 px/mm."""


def hog_features(image: FloatArray, px_per_mm: float) -> NDArray[np.float32]:
    """Histograms of oriented gradients: cells, directions shared between two bins, blocks of 2 x 2
    cells.

    Source: Dalal and Triggs 2005, Histograms of oriented gradients for human detection.
    """
    image = check_image(image)
    across = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1)
    down = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1)
    size, angle = cv2.cartToPolar(across, down)
    bins, (cell, height, width) = HOG_BINS, cells(image, px_per_mm)
    cut = slice(0, height * cell), slice(0, width * cell)
    place = np.asarray(angle)[cut] * np.float32(bins / np.pi) + np.float32(bins - 0.5)
    low = place.astype(np.uint8)  # from bins - 1 to 3 bins: none is negative
    size_of = np.asarray(size)[cut]
    upper = (place - low) * size_of
    first = bins * (
        np.arange(height * cell)[:, None] // cell * width + np.arange(width * cell)[None, :] // cell
    )
    turned = (np.arange(257) % bins).astype(np.uint8)
    counts = [
        np.bincount(
            (first + cv2.LUT(low, table)).ravel(),
            weights=weight.ravel(),
            minlength=height * width * bins,
        )
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
    """Mean magnitude of Gabor responses in cells, for each period and direction, of unit length in
    a cell.

    Source: Jain, Prabhakar, Hong and Pankanti 2000, Filterbank-based fingerprint matching.
    """
    image = check_image(image)
    factor = px_per_mm / REFERENCE_PX_PER_MM
    # eight pixels a period are enough for the filters
    shrink = max(1.0, min(GABOR_PERIODS_PX) * factor / 8.0)
    size = max(1, round(image.shape[1] / shrink)), max(1, round(image.shape[0] / shrink))
    small: NDArray[Any] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    # enough for what is as smooth as this mean
    quarter = max(1, size[0] // 4), max(1, size[1] // 4)
    mean = gaussian_mean(
        cv2.resize(small, quarter, interpolation=cv2.INTER_AREA),
        0.75 * GABOR_PERIODS_PX[-1] * factor / shrink,
    )
    small = small - cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR)
    _, rows, columns = cells(image, px_per_mm)
    # a border against wrapping round
    plane = [scipy.fft.next_fast_len(side + 32) for side in small.shape]
    spectrum = scipy.fft.fft2(small, s=plane)
    parts = []
    for period_px in GABOR_PERIODS_PX:
        wave = 1.0 / max(2.5, period_px * factor / shrink)
        width = wave / np.pi  # of a window in space whose sigma is half a period
        for k in range(GABOR_DIRECTIONS):
            turn = np.pi * k / GABOR_DIRECTIONS
            down, across = (
                _passed(side, middle, width)
                for side, middle in zip(
                    plane, (wave * np.sin(turn), wave * np.cos(turn)), strict=True
                )
            )
            band = spectrum.take(down[0], 0).take(across[0], 1) * down[1][:, None]
            band *= across[1]
            # the magnitude at as many points as the filter's band needs; a band's middle turns the
            # phase alone
            answer = np.abs(scipy.fft.ifft2(band, overwrite_x=True)) * np.float32(
                band.size / (plane[0] * plane[1])
            )
            seen = [
                -(-side * of // whole)
                for side, of, whole in zip(small.shape, band.shape, plane, strict=True)
            ]
            parts.append(
                cv2.resize(
                    answer[: seen[0], : seen[1]], (columns, rows), interpolation=cv2.INTER_AREA
                )
            )
    grid = np.stack(parts, axis=-1)
    length = np.sqrt((grid * grid).sum(axis=-1, keepdims=True))
    return np.asarray(grid / np.maximum(length, 1e-12), dtype=np.float32).ravel()


@lru_cache(maxsize=256)
def _passed(
    side: int, middle: float, width: float
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Places in the spectrum of `side` values that a Gaussian filter passes (6 widths each way),
    and its gain there."""
    centre = round(middle * side)
    reach = int(np.ceil(6.0 * width * side))
    count = min(side, scipy.fft.next_fast_len(2 * reach + 1))
    number = centre - count // 2 + np.arange(count)
    gain = np.exp(-((number / side - middle) ** 2) / (2 * width * width))
    return np.mod(number, side), gain.astype(np.float32)


def shape_context_features(image: FloatArray, px_per_mm: float) -> NDArray[np.float32]:
    """Shape contexts of the ridges' flanks: around each cell's middle, where they lie in rings and
    sectors.

    Flanks are where the channel, freed from its mean over two cells, changes its sign. Fixed places
    instead of matched points make vectors of one length, as the thesis's distance needs them.

    Source: Belongie, Malik and Puzicha 2002, Shape matching and object recognition using shape
    contexts.
    """
    image = check_image(image)
    cell, rows, columns = cells(image, px_per_mm)
    positive = (image - _means_down(_means_down(image, cell).T, cell).T) > 0
    flank = np.pad(positive[:, 1:] != positive[:, :-1], ((0, 0), (1, 0)))
    flank[1:] |= positive[1:] != positive[:-1]
    # where flanks lie to a twentieth of the reach is enough
    factor = max(1, int(CONTEXT_REACH_PX * px_per_mm / REFERENCE_PX_PER_MM / 20))
    down, across = image.shape[0] // factor, image.shape[1] // factor
    blocks = (
        flank[: down * factor, : across * factor]
        .reshape(down, factor, -1)
        .sum(axis=1, dtype=np.float32)
    )
    reach = CONTEXT_REACH_PX * px_per_mm / REFERENCE_PX_PER_MM / factor
    half = max(2, int(np.ceil(reach)))
    padded = np.pad(blocks.reshape(down, across, factor).sum(axis=2), half)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    # rings whose radii double, the outermost ends at the reach
    ring = CONTEXT_RADII + np.floor(np.log2(np.maximum(np.hypot(x, y), 1e-9) / reach)).astype(
        np.int64
    )
    sector = np.floor(np.mod(np.arctan2(-y, x) / (2 * np.pi), 1.0) * CONTEXT_ANGLES).astype(
        np.int64
    )
    number = np.clip(ring, 0, CONTEXT_RADII - 1) * CONTEXT_ANGLES + sector % CONTEXT_ANGLES
    bins = (
        np.eye(CONTEXT_RADII * CONTEXT_ANGLES, dtype=np.float32)[number]
        * (ring < CONTEXT_RADII)[..., None]
    )
    top, left = ((np.arange(count) * cell + cell // 2) // factor for count in (rows, columns))
    around = sliding_window_view(padded, ring.shape)[np.ix_(top, left)]
    # whole numbers: the same in any order
    result = around.reshape(rows * columns, -1) @ bins.reshape(ring.size, -1)
    counted = np.maximum(result.sum(axis=1, keepdims=True), np.float32(factor * factor))
    return np.asarray(result / counted, dtype=np.float32).ravel()


def _means_down(image: FloatArray, sigma: int) -> FloatArray:
    """Gaussian means of the columns, zeros beyond them: products of matrices take a third of a wide
    filter's time."""
    rows = len(image)
    step = 2 * sigma
    reach = 4 * sigma
    weights = np.pad(cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F)[:, 0], step)
    band = np.ascontiguousarray(sliding_window_view(weights, step + 2 * reach)[step:0:-1])
    padded = np.pad(image, ((reach, reach - rows % -step), (0, 0)))
    around = sliding_window_view(padded, (step + 2 * reach, image.shape[1]))[::step, 0]
    return np.asarray((band @ around).reshape(-1, image.shape[1])[:rows])


FEATURES: dict[str, Callable[[FloatArray, float], NDArray[np.float32]]] = {
    "hog": hog_features,
    "gabor": gabor_features,
    "shape_context": shape_context_features,
}


def similarity(name: str, a: FingerImages, b: FingerImages) -> float:
    """1 - the mean over normals and relief of (5.2), of features of that name."""
    extract, box = FEATURES[name], (a.mask.shape[0], a.mask.shape[1])
    _, ratio = align_masks(a.mask, b.mask)

    def distance(channel: str) -> float:
        known = extract(a.channels[channel], a.px_per_mm)
        return float(np.linalg.norm(known - extract(to_box(b.channels[channel], box), a.px_per_mm)))

    scores = [
        dissimilarity(ratio, [distance(attribute) for attribute in ATTRIBUTES[of]])
        for of in ("normals", "relief")
    ]
    return 1.0 - float(np.mean(scores))


if __name__ == "__main__":
    name, *arguments = sys.argv[1:] or [""]
    if name not in FEATURES:
        raise SystemExit(f"name one of {', '.join(FEATURES)}, then the fingers.")
    raise SystemExit(
        run(
            lambda finger, preset: surface_images(surface_at(finger, preset)),
            lambda a, b: similarity(name, a, b),
            "snk",
            arguments,
        )
    )
