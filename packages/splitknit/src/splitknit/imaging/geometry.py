"""Frames, poses, finite differences and resampling, with one convention: x right, y up, z towards
the camera.

Rows run downwards, so a derivative along y is minus the derivative along the rows.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.model import Array, BoolArray, FloatArray


def bounding_box(mask: BoolArray, margin: int = 0) -> tuple[slice, slice]:
    """Slices of rows and columns that bound `mask` (not empty) with `margin` pixels around it,
    clipped to the image."""
    rows, columns = (
        slice(max(0, int(inside[0]) - margin), min(int(inside[-1]) + 1 + margin, size))
        for inside, size in (
            (np.flatnonzero(mask.any(axis=1)), mask.shape[0]),
            (np.flatnonzero(mask.any(axis=0)), mask.shape[1]),
        )
    )
    return rows, columns


def gradients_from_normals(
    normals: FloatArray, mask: BoolArray | None = None, max_slope: float = 10.0
) -> tuple[FloatArray, FloatArray]:
    """dz/dx and dz/dy (y up) of normals (H, W, 3), zero outside `mask`; beyond `max_slope` cut,
    direction kept."""
    nz = np.maximum(normals[..., 2], 1e-6)
    gradient_x = -normals[..., 0] / nz
    gradient_y = -normals[..., 1] / nz
    slope = np.hypot(gradient_x, gradient_y)
    scale = np.minimum(1.0, max_slope / np.maximum(slope, 1e-6))
    if mask is not None:
        scale = np.where(mask, scale, 0.0)
    return (gradient_x * scale).astype(np.float32), (gradient_y * scale).astype(np.float32)


def normals_from_gradients(gradient_x: FloatArray, gradient_y: FloatArray) -> FloatArray:
    """Unit normals (H, W, 3) of a surface with these slopes (dimensionless, y up)."""
    normals = np.empty((*gradient_x.shape, 3), dtype=np.float32)
    length = np.sqrt(gradient_x * gradient_x + gradient_y * gradient_y + 1.0)
    normals[..., 0] = -gradient_x / length
    normals[..., 1] = -gradient_y / length
    normals[..., 2] = 1.0 / length
    return normals


def height_gradients(height: FloatArray, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Slopes dz/dx and dz/dy (y up) of `height` (H, W), NaN outside the surface, in units of
    `pitch` a pixel: central differences, one-sided beside a missing neighbour, zero without both.
    """
    return _difference(height, 1) / pitch, -_difference(height, 0) / pitch


def _difference(height: FloatArray, axis: int) -> FloatArray:
    values = np.moveaxis(height, axis, 0)
    step = np.diff(values, axis=0)  # NaN where either end is missing
    known = np.isfinite(step)
    total = np.zeros_like(values)
    count = np.zeros(values.shape, dtype=np.float32)
    for side in (slice(1, None), slice(None, -1)):
        total[side] += np.where(known, step, 0.0)
        count[side] += known
    return np.moveaxis((total / np.maximum(count, 1.0)).astype(np.float32), 0, axis)


def warp(image: FloatArray, source_from_target: Array, size: tuple[int, int]) -> FloatArray:
    """Resample `image` (H, W) or (H, W, C) to `size` (rows, columns), bicubic, zero from outside;
    `source_from_target` (3 x 3) takes (column, row, 1) of the target to the source.
    """
    if abs(float(np.linalg.det(source_from_target[:2, :2]))) < 1e-12:
        raise BadInput("the transform between two frames is singular.")
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(pixels, source_from_target[:2], (size[1], size[0]), flags=flags)
    )


def rotation_about(centre: tuple[float, float], angle_rad: float) -> Array:
    """3 x 3 matrix on (column, row, 1) that turns by `angle_rad` counter-clockwise, as seen, about
    `centre`."""
    cos = np.cos(angle_rad)
    sin = np.sin(angle_rad)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    to_origin = np.array([[1.0, 0.0, -centre[0]], [0.0, 1.0, -centre[1]], [0.0, 0.0, 1.0]])
    back = np.array([[1.0, 0.0, centre[0]], [0.0, 1.0, centre[1]], [0.0, 0.0, 1.0]])
    return np.asarray(back @ turn @ to_origin)


def gaussian_mean(image: NDArray[Any], sigma: float) -> FloatArray:
    """Gaussian mean (H, W) with zeros beyond the border; `sigma` in pixels, none below 0.2."""
    if sigma < 0.2:
        return image
    return np.asarray(
        cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    )


def smoothed(values: FloatArray, mask: BoolArray, sigma_px: float) -> FloatArray:
    """Gaussian mean (H, W) of `values` (H, W) float32 over what lies inside the mask (H, W); zero
    outside it."""
    # about the mean, so that float32 keeps what matters
    middle = values[mask].mean() if mask.any() else 0.0
    total = gaussian_mean(np.where(mask, values - middle, 0.0), sigma_px)
    fraction = np.maximum(gaussian_mean(mask, sigma_px), 1e-6)
    return np.where(mask, total / fraction + middle, 0.0)


EROSION_MM = 0.33
"""Distance from the edge of a surface from which on its accuracy is measured. Source: definition of
the figures (docs/experiments/accuracy.md)."""
BAND_SIGMA_MM = 0.32
"""Standard deviation of the Gaussian whose complement is the ridge band. Source: definition of the
figures (docs/experiments/accuracy.md)."""


def high_passed(values: FloatArray, mask: BoolArray, sigma_px: float) -> FloatArray:
    """Values (H, W) minus their Gaussian mean over the mask; zero outside it."""
    return np.where(mask, values - smoothed(values, mask, sigma_px), 0.0)


def eroded(mask: BoolArray, distance_px: float) -> BoolArray:
    """Pixels of `mask` (H, W) further than a distance from its edge; the image's border is one."""
    padded = np.pad(mask, 1).astype(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return distance > distance_px


def wide_blur(image: FloatArray, sigma: float) -> FloatArray:
    """Gaussian blur for large `sigma`, done on a copy on which it is about four pixels."""
    factor = int(sigma / 4.0)
    if factor < 2:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), max(sigma, 0.3)))
    size = (image.shape[1], image.shape[0])
    reduced = (-(-size[0] // factor), -(-size[1] // factor))
    small = cv2.resize(image, reduced, interpolation=cv2.INTER_AREA)
    return np.asarray(
        cv2.resize(
            cv2.GaussianBlur(small, (0, 0), sigma / factor), size, interpolation=cv2.INTER_LINEAR
        )
    )


def local_mean(
    values: FloatArray, where: BoolArray | FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Gaussian mean at every pixel over the values inside a region, and the weight of the region
    there; for large `sigma`, as :func:`wide_blur`."""
    weight = where.astype(np.float32)
    cover = wide_blur(weight, sigma)
    return wide_blur(values * weight, sigma) / np.maximum(cover, 1e-3), cover


_PLACES_IN_LINE = 128  # places in one row of what OpenCV reads, which takes no long ones


def sampled_at(
    field: FloatArray,
    columns: NDArray[Any],
    rows: NDArray[Any],
    how: int = cv2.INTER_LINEAR,
    outside: float | None = None,
) -> FloatArray:
    """Values (...) or (..., C) of a field (H, W) or (H, W, C) at places (...) between its pixels,
    by OpenCV's interpolation `how`; `outside`: value beside the field, by default the nearest
    pixel's.
    """
    missing = -columns.size % _PLACES_IN_LINE
    shape = (*columns.shape, *field.shape[2:])
    padded = (np.append(part, np.zeros(missing)).astype(np.float32) for part in (columns, rows))
    x, y = (part.reshape(-1, _PLACES_IN_LINE) for part in padded)
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    taken = (
        cv2.remap(field, x, y, how, borderMode=border, borderValue=(outside or 0.0,) * 4)
        if x.size
        else np.zeros(0)
    )
    return taken.reshape(-1, *field.shape[2:])[: columns.size].reshape(shape)


def enlarged(field: FloatArray, factor: int, shape: tuple[int, ...]) -> FloatArray:
    """A field of blocks of `factor` pixels a side, interpolated at the pixels of an image of
    `shape`."""
    size = (field.shape[1] * factor, field.shape[0] * factor)
    large = cv2.resize(field, size, interpolation=cv2.INTER_LINEAR)
    return np.pad(
        large, [(0, side - own) for side, own in zip(shape, large.shape, strict=True)], mode="edge"
    )


def nearest_known(values: FloatArray, known: BoolArray) -> FloatArray:
    """`values` (h, w), each unknown one replaced by the nearest `known` value."""
    away = (~known).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(
        away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(int(labels.max()) + 1, dtype=np.float32)
    table[labels[known]] = values[known]
    return np.asarray(table[labels])


Floats = NDArray[np.floating[Any]]


def pixels_above(
    point: tuple[Floats, Floats], known: BoolArray, columns: Floats, rows: Floats
) -> tuple[Floats, Floats]:
    """Columns and rows (...) of a perspective picture whose points lie straight above places of its
    plane, the pixels at `columns` and `rows` (...) under parallel rays.

    `point`: columns and rows (H, W) above which the point of each pixel lies, where it is `known`.
    """
    row, column = np.indices(known.shape)
    beside = [
        nearest_known(place - pixel, known)
        for place, pixel in zip(point, (column, row), strict=True)
    ]
    x, y = columns, rows
    for _ in range(4):  # a contraction, by the depth over the distance
        right, down = (sampled_at(part, x, y) for part in beside)
        x, y = columns - right, rows - down
    return x, y


def refined_peak(values: FloatArray, index: int) -> float:
    """Position of a maximum at sub-sample accuracy, by a parabola through three samples; unrefined
    at the ends."""
    if index == 0 or index == len(values) - 1:
        return float(index)
    before, here, after = (float(value) for value in values[index - 1 : index + 2])
    bend = before - 2.0 * here + after
    return float(index) if bend >= 0.0 else index + 0.5 * (before - after) / bend
