"""The finger's shape on a coarse upright grid: what unrolling works on.

A node every few tenths of a millimetre carries the surface point there (x to the right, y to the tip, z to the camera,
mm). Heights are local quadratic fits, weighted by a Gaussian and by the mask, so that neither ridges nor the one-sided
windows at the outline bend them. A few rings of nodes outside the mask are extrapolated, so that maps can be read and
inverted up to the outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, FloatArray

AnyArray = np.ndarray[Any, Any]
Array = NDArray[np.float64]
_POWERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
"""Exponents of x and y of the local quadratic."""

_WINDOW_MM = 0.3
"""Standard deviation of the Gaussian window of the local fits."""
_FINEST_MM, _LONGEST_MM, _FARTHEST_MM = 1e-3, 200.0, 1e6
"""Pitch and length of a surface that can be a finger's, and what can be a place of it."""
_TOO_SMALL = "the mask is too small to be unrolled: it must be some millimetres wide."
RINGS = 3
"""Nodes outside the mask that are extrapolated."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceGrid:
    """Surface points on nodes of the upright frame."""

    points_mm: Array
    """(n, m, 3) x to the right, y to the tip, z to the camera, in the upright finger's frame; NaN where unknown."""
    inside: BoolArray
    """(n, m) on the finger; elsewhere points are extrapolated or unknown."""
    input_from_grid: Array
    """(3, 3) on (column, row, 1): where a node lies in the input."""
    pitch_mm: float
    """Distance of the nodes on the finger plane."""

    @property
    def known(self) -> BoolArray:
        """(n, m) nodes with a point, measured or extrapolated."""
        return np.asarray(np.isfinite(self.points_mm).all(axis=2))


def surface_grid(
    shape_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    input_from_upright: Array,
    upright_size: tuple[int, int],
    *,
    xy_mm: tuple[FloatArray, FloatArray] | None = None,
    node_mm: float = 0.4,
) -> SurfaceGrid:
    """Return the smooth surface on a coarse upright grid.

    Raises BadInput if the mask is empty, too small for a surface, or the pitch is not positive.

    `shape_mm`: (H, W) height without ridges, ignored outside `mask`; `xy_mm`: x and y (H, W) of the surface points, for
    perspective cameras; without them pixels lie at their pitch; `node_mm`: distance of the nodes. The upright frame
    has `upright_size` rows and columns.
    """
    require(
        _FINEST_MM <= pitch_mm < _LONGEST_MM,
        f"pitch_mm must be a number from {_FINEST_MM:g} to {_LONGEST_MM:g}, not {pitch_mm}.",
    )
    mask = check_mask(mask, (shape_mm.shape[0], shape_mm.shape[1]))
    fields = [shape_mm, *(xy_mm or ())]
    for field in fields:
        mask = mask & (np.abs(field) < _FARTHEST_MM)  # nor where it is NaN
    require(bool(mask.any()), "the surface has no finite height inside its mask; reconstruct the capture again.")
    step = node_mm / pitch_mm
    upright_from_input = np.asarray(np.linalg.inv(input_from_upright), dtype=np.float64)
    left, top, right, bottom = _bounds(mask, upright_from_input, upright_size)
    longest = max(bottom - top, right - left) * pitch_mm
    require(longest < _LONGEST_MM, f"the surface is {longest:.0f} mm long, more than any finger; check its scale.")
    margin = (RINGS + 1) * step
    size = (int(np.ceil((bottom - top + 2 * margin) / step)) + 1, int(np.ceil((right - left + 2 * margin) / step)) + 1)
    upright_from_grid = np.array([[step, 0.0, left - margin], [0.0, step, top - margin], [0.0, 0.0, 1.0]])
    input_from_grid = input_from_upright @ upright_from_grid
    values, inside = _fits(fields, mask, pitch_mm, input_from_grid, size)
    require(int(inside.sum()) >= 16, _TOO_SMALL)
    if len(values) == 1:
        node = np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), axis=2)
        place = node @ input_from_grid[:2, :2].T + input_from_grid[:2, 2]
        rig_x = (place[..., 0] - 0.5 * (mask.shape[1] - 1)) * pitch_mm
        rig_y = (0.5 * (mask.shape[0] - 1) - place[..., 1]) * pitch_mm
    else:
        rig_x, rig_y = values[1:]
    turn = upright_from_input[:2, :2] / np.sqrt(abs(np.linalg.det(upright_from_input[:2, :2])))
    x = turn[0, 0] * rig_x - turn[0, 1] * rig_y  # rows run down, y runs up
    y = -turn[1, 0] * rig_x + turn[1, 1] * rig_y
    points = np.stack([x, y, values[0]], axis=2)
    points[~inside] = np.nan
    return SurfaceGrid(extrapolated(points, RINGS), inside, input_from_grid, node_mm)


def slant_cos(points: Array) -> Array:
    """(n, m) cosine of the slant at the nodes, by central differences; 1 where unknown."""
    down, right = np.gradient(points, axis=(0, 1))
    normal = np.cross(right, -down)
    cosine = np.abs(normal[..., 2]) / np.maximum(np.linalg.norm(normal, axis=2), 1e-12)
    return np.asarray(np.nan_to_num(cosine, nan=1.0))


def extrapolated(values: Array, rings: int) -> Array:
    """Continue (n, m, C) straight on into its NaN nodes, `rings` nodes far: the mean over the directions that can."""
    result = values.copy()
    directions = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]
    for _ in range(rings):
        total = np.zeros_like(result)
        count = np.zeros((*result.shape[:2], 1))
        wide = np.pad(result, ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
        n, m = result.shape[:2]
        for dy, dx in directions:
            near = wide[2 + dy : 2 + dy + n, 2 + dx : 2 + dx + m]
            far = wide[2 + 2 * dy : 2 + 2 * dy + n, 2 + 2 * dx : 2 + 2 * dx + m]
            guess = 2.0 * near - far
            usable = np.isfinite(guess).all(axis=2, keepdims=True)
            weight = 1.0 if dy == 0 or dx == 0 else 0.5
            total += np.where(usable, weight * guess, 0.0)
            count += weight * usable
        new = ~np.isfinite(result).all(axis=2) & (count[..., 0] > 0)
        result[new] = total[new] / count[new]
    return result


def _bounds(mask: BoolArray, upright_from_input: Array, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the mask in the upright frame, from every fourth pixel; clipped to the frame."""
    rows, columns = np.nonzero(mask[::4, ::4])
    require(rows.size > 0, _TOO_SMALL)
    places = upright_from_input[:2] @ np.stack([columns * 4.0, rows * 4.0, np.ones(rows.size)])
    low, high = places.min(axis=1) - 4.0, places.max(axis=1) + 4.0
    margin = 0.1 * max(size)
    low = np.maximum(low, -margin)
    high = np.minimum(high, [size[1] - 1 + margin, size[0] - 1 + margin])
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _fits(
    fields: list[FloatArray], mask: BoolArray, pitch_mm: float, input_from_grid: Array, size: tuple[int, int]
) -> tuple[list[Array], BoolArray]:
    """Local quadratic fits of the fields at the nodes, and where they are supported by the mask."""
    factor = max(1, int(0.1 / pitch_mm))
    rows, columns = (  # its sides multiples of the factor where the image allows
        slice(box.start, min(side, box.start + -(-(box.stop - box.start) // factor) * factor))
        for box, side in zip(bounding_box(mask), mask.shape, strict=True)
    )
    inside = mask[rows, columns]
    height, width = (n // factor for n in inside.shape)
    require(min(height, width) > 0, _TOO_SMALL)
    weight = _binned(inside.astype(np.float32), (height, width), factor) > 0.99  # whole blocks only: no shifted means
    sigma = _WINDOW_MM / (pitch_mm * factor)
    reach = int(np.ceil(3.0 * sigma))
    offset = np.arange(-reach, reach + 1) / sigma
    window = np.exp(-0.5 * offset**2)
    taps = [(window * offset**k).astype(np.float32) for k in range(5)]
    # places of the nodes in the reduced image
    grid = np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), axis=2).reshape(-1, 2)
    place = grid @ input_from_grid[:2, :2].T + input_from_grid[:2, 2]
    small = (place - [columns.start, rows.start] + 0.5) / factor - 0.5
    nearest = np.rint(small).astype(np.intp)
    there = ((nearest >= 0) & (nearest < [width, height])).all(axis=1)
    there[there] = weight[nearest[there, 1], nearest[there, 0]]
    at = nearest[there, 1], nearest[there, 0]
    rest = (small[there] - nearest[there]) / sigma
    one = weight.astype(np.float32)
    moments = {(i, j): _separable(one, taps[i], taps[j])[at] for i in range(5) for j in range(5 - i)}
    normal = np.empty((len(at[0]), 6, 6))
    for a, (i, j) in enumerate(_POWERS):
        for b, (k, m) in enumerate(_POWERS):
            normal[:, a, b] = moments[i + k, j + m]
    support = normal[:, 0, 0] / float(window.sum()) ** 2
    normal += 1e-6 * normal[:, :1, :1] * np.eye(6)
    monomials = np.stack([rest[:, 0] ** i * rest[:, 1] ** j for i, j in _POWERS], axis=1)
    results = []
    for field in fields:
        filled = np.where(inside, field[rows, columns], 0.0).astype(np.float32)
        values = np.where(weight, _binned(filled, (height, width), factor), 0.0)
        middle = float(values[weight].mean()) if bool(weight.any()) else 0.0
        values = np.where(weight, values - np.float32(middle), 0.0)
        right = np.stack([_separable(values, taps[i], taps[j])[at] for i, j in _POWERS], axis=1)
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        flat = np.full(size[0] * size[1], np.nan)
        flat[there] = (solved * monomials).sum(axis=1) + middle
        results.append(flat.reshape(size))
    supported = np.zeros(size[0] * size[1], dtype=np.bool_)
    supported[there] = support > 0.25
    for result in results:
        result[~supported.reshape(size)] = np.nan
    return results, supported.reshape(size)


def _separable(image: FloatArray, across: AnyArray, down: AnyArray) -> Array:
    filtered = cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(filtered, dtype=np.float64)


def _binned(image: FloatArray, size: tuple[int, int], factor: int) -> FloatArray:
    if factor == 1:
        return image
    cut = np.ascontiguousarray(image[: size[0] * factor, : size[1] * factor])
    return np.asarray(cv2.resize(cut, (size[1], size[0]), interpolation=cv2.INTER_AREA), dtype=np.float32)
