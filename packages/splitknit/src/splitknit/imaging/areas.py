"""Regions of an image: fill, grow and shrink them, box them, and blank what lies outside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.view import pixels_of
from splitknit.model import Array, BoolArray, Camera, FloatArray, Mirror


def disc(radius: int) -> NDArray[np.uint8]:
    """(2 radius + 1, 2 radius + 1) round structuring element."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(kernel, dtype=np.uint8)


def blanked(image: NDArray[Any], inside: BoolArray, px_per_mm: float) -> NDArray[Any]:
    """The image whose pixels outside `inside` look like the background beside them."""
    if inside.all():
        return image
    blank = image.copy()
    ring = inside & ~shrunk(inside, max(2.0, 0.4 * px_per_mm))
    blank[~inside] = np.median(blank[ring], axis=0) if ring.any() else 0.0
    return blank


def filled(outline: Array, shape: tuple[int, int]) -> BoolArray:
    """(h, w) pixels inside an outline (n, 2) of columns and rows."""
    canvas = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(canvas, [np.round(outline * 16).astype(np.int32)], 1, shift=4)
    return np.asarray(canvas, dtype=np.bool_)


def grown(mask: BoolArray, radius: float) -> BoolArray:
    """A mask dilated by a square of `radius` pixels to each side."""
    size = 2 * max(1, round(radius)) + 1
    return np.asarray(
        cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)), dtype=np.bool_
    )


def shrunk(mask: BoolArray, radius: float) -> BoolArray:
    """A mask eroded by the same square."""
    return ~grown(~mask, radius)


def mirror_outline(mirror: Mirror, camera: Camera, binning: int = 1) -> Array:
    """(n, 2) column and row of a mirror's nominal outline in an image of blocks of `binning` pixels
    a side."""
    full = pixels_of(camera, np.asarray(mirror.corners_mm, dtype=np.float64))
    return (full - 0.5 * (binning - 1)) / binning


def without_mirrors(
    image: FloatArray, camera: Camera, mirrors: Mapping[str, Mirror], binning: int
) -> FloatArray:
    """The image (h, w) or (h, w, C) with the mirrors' nominal outlines filled with the background
    beside them."""
    shape = (image.shape[0], image.shape[1])
    outlines = [
        filled(mirror_outline(mirror, camera, binning), shape) for mirror in mirrors.values()
    ]
    return blanked(image, ~np.logical_or.reduce(outlines), camera.px_per_mm / binning)
