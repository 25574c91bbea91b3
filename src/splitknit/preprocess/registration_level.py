"""Details of one size in all shots, and what they say about shifts."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.preprocess.regions import blur
from splitknit.preprocess.registration_flow import Flow
from splitknit.types import BoolArray, FloatArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """Details of one size."""

    details: FloatArray
    """(L, h, w)"""
    weight: FloatArray
    """(h, w)"""
    px_per_mm: float
    block: int
    """Pixels a side of the squares over which light and shifts are taken as even."""

    def centres(self) -> tuple[Array, Array]:
        """x and y (B,) of the blocks in mm from the first pixel."""
        down, across = (-(-n // self.block) for n in self.weight.shape)
        rows, columns = np.mgrid[0:down, 0:across] * self.block + 0.5 * (self.block - 1)
        return columns.ravel() / self.px_per_mm, rows.ravel() / self.px_per_mm


def details_of(
    stack: FloatArray, region: BoolArray, px_per_mm: float, band_mm: tuple[float, float], scale_and_block: Array
) -> Level:
    """Band-passed copies of a stack (L, H, W), weighted by one over the square of the brightness in `region`.

    Parameters
    ----------
    stack : (L, H, W)
    region : (H, W)
    px_per_mm : of both
    band_mm : fine and coarse end (sigma)
    scale_and_block : most px/mm of the copies, and side of the blocks in mm
    """
    finest = min(px_per_mm, float(scale_and_block[0]), 1.0 / band_mm[0])
    size = tuple(max(8, round(n * finest / px_per_mm)) for n in (region.shape[1], region.shape[0]))
    px = px_per_mm * size[0] / region.shape[1]
    small = [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32) for image in stack]
    inside = cv2.resize(region.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    level = blur(np.asarray(np.mean(small, axis=0), dtype=np.float32), 1.0 * px)
    floor = 0.15 * float(np.median(level[inside])) if inside.any() else 0.0
    weight = inside / np.maximum(level, max(floor, 1e-9)) ** 2
    details = np.stack([blur(image, band_mm[0] * px) - blur(image, band_mm[1] * px) for image in small])
    return Level(details, weight.astype(np.float32), px, max(2, round(float(scale_and_block[1]) * px)))


def aligned(level: Level, flow: Flow, shots: NDArray[np.intp]) -> FloatArray:
    """(L, h, w) details with the flow of the shot `shots[l]` undone in image l."""
    window = (slice(0, level.weight.shape[0]), slice(0, level.weight.shape[1]))
    images = []
    for image, shot in zip(level.details, shots, strict=True):
        columns, rows = flow.maps(int(shot), level.px_per_mm, window)
        warped = cv2.remap(image, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        images.append(np.asarray(warped, dtype=np.float32))
    return np.stack(images)


def slopes_of(level: Level, images: FloatArray) -> FloatArray:
    """(L, 2, h, w) derivatives to the right and down the rows, a mm."""
    slopes = np.empty((len(images), 2, *images.shape[1:]), dtype=np.float32)
    for k, image in enumerate(images):
        slopes[k, 1], slopes[k, 0] = np.gradient(image)
    return slopes * np.float32(level.px_per_mm)


def robust_root(level: Level, error: FloatArray) -> FloatArray:
    """(h, w) root of the weight of every pixel, less where its weighted `error` (h, w) is beyond the usual."""
    typical = 1.4826 * float(np.median(error[level.weight > 0])) + 1e-12
    return np.asarray(np.sqrt(level.weight / np.maximum(1.0, error / np.float32(1.5 * typical))), dtype=np.float32)


def in_blocks(images: FloatArray, side: int) -> FloatArray:
    """(N, h, w) to (B, N, side * side)."""
    count, height, width = images.shape
    down, across = -(-height // side), -(-width // side)
    padded = np.pad(images, ((0, 0), (0, down * side - height), (0, across * side - width)))
    cut = padded.reshape(count, down, side, across, side).transpose(1, 3, 0, 2, 4)
    return np.ascontiguousarray(cut).reshape(down * across, count, side * side)
