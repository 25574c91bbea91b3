"""Small operations on binary regions and on reduced copies that the preprocessing steps share."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, FloatArray


def border(image: NDArray[Any]) -> NDArray[Any]:
    """Pixels along the image's border; those of the corners twice."""
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])


def reduction(
    shape: tuple[int, int], px_per_mm: float, working_px_per_mm: float, longest: int
) -> float:
    """Scale (at most one) of a working copy with `working_px_per_mm` and no side above `longest`
    pixels."""
    return float(min(1.0, working_px_per_mm / px_per_mm, longest / max(shape)))


def reduce_image(image: FloatArray, scale: float) -> FloatArray:
    """Area-averaged copy of an image (H, W) or (H, W, C), float32, sides times `scale`."""
    if scale >= 1.0:
        return np.ascontiguousarray(image, dtype=np.float32)
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def reduce_mask(mask: BoolArray, scale: float) -> FloatArray:
    """Fraction of every reduced pixel that `mask` covers, float32 in [0, 1]."""
    if scale >= 1.0:
        return mask.astype(np.float32)
    size = (max(1, round(mask.shape[1] * scale)), max(1, round(mask.shape[0] * scale)))
    fraction = cv2.resize(mask.astype(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA)
    return np.asarray(fraction, dtype=np.float32) / 255.0


def blur(image: FloatArray, sigma: float) -> FloatArray:
    """Gaussian blur, `sigma` in pixels, borders mirrored."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(sigma, 0.3)))


def quantile(values: FloatArray, fraction: float = 0.5) -> float:
    """Quantile that is one of the values; faster than `numpy.quantile`, which averages two."""
    place = int(fraction * values.size)
    return float(np.partition(values, place, axis=None)[place])


def dilate(mask: BoolArray, radius: float) -> BoolArray:
    """Grow `mask` by `radius` pixels; by the distance transform, so large radii cost no more than
    small ones."""
    if radius < 1.0 or not mask.any():
        return mask
    return distance_outside(mask, radius) <= radius


def erode(mask: BoolArray, radius: float) -> BoolArray:
    """Shrink `mask` by `radius` pixels; beyond the image's border the mask is taken to go on."""
    if radius < 1.0 or mask.all():
        return mask
    return depth_inside(mask) > radius


def depth_inside(mask: BoolArray) -> FloatArray:
    """Distance of every pixel of `mask` to the nearest pixel outside; the image's border does not
    count as outside."""
    if mask.all():
        return np.full(mask.shape, float(max(mask.shape)), dtype=np.float32)
    depth = np.zeros(mask.shape, dtype=np.float32)
    if mask.any():
        box = bounding_box(mask, 1)
        depth[box] = _distance_to(~mask[box])
    return depth


def distance_outside(mask: BoolArray, reach: float) -> FloatArray:
    """Distance of every pixel outside `mask` to the nearest one inside; infinite well beyond
    `reach`."""
    away = np.full(mask.shape, np.inf, dtype=np.float32)
    if mask.any():
        box = bounding_box(mask, int(reach) + 1)
        away[box] = _distance_to(mask[box])
    return away


def _distance_to(mask: BoolArray) -> FloatArray:
    source = np.logical_not(mask).view(np.uint8)
    return np.asarray(cv2.distanceTransform(source, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def largest_component(mask: BoolArray) -> BoolArray:
    """The largest 4-connected component of `mask` (empty stays empty)."""
    if not mask.any():
        return mask
    box = bounding_box(mask)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask[box].astype(np.uint8), connectivity=4
    )
    if count <= 2:
        return mask
    best = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    result = np.zeros_like(mask)
    result[box] = labels == best
    return result


def fill_holes(mask: BoolArray, largest_area: float = np.inf) -> BoolArray:
    """Fill holes of `mask` up to `largest_area` pixels; a gap open to the image's border is not a
    hole."""
    if not mask.any():
        return mask
    box = bounding_box(mask, 1)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        np.logical_not(mask[box]).view(np.uint8), connectivity=4
    )
    hole = stats[:, cv2.CC_STAT_AREA] <= largest_area
    hole[[0, *border(labels)]] = False
    filled = mask.copy()
    filled[box] |= hole[labels]
    return filled


def remove_spurs(mask: BoolArray, fraction: float) -> BoolArray:
    """Cut away what is thinner than `fraction` of the region's own width, keep the largest rest: an
    opening with a disc, the region going on beyond the image's border; what it shaves off the
    outline itself is put back.
    """
    depth = depth_inside(mask)
    radius = fraction * float(depth.max())
    if radius < 1.0:
        return largest_component(mask)
    core = largest_component(depth > radius)
    if not core.any():
        return largest_component(mask)
    opened = dilate(core, radius)
    return largest_component(mask & dilate(opened, 1.0 + 0.15 * radius))


def remove_specks(mask: BoolArray, radius: float) -> BoolArray:
    """Opening of `mask` with a disc of `radius` pixels, largest part kept."""
    core = erode(mask, radius)
    return largest_component(mask & dilate(core, radius)) if core.any() else mask
