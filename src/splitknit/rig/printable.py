"""What hangs in the air while a part is printed: steep faces, and what each layer has to bridge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.rig.stl import Triangles, unit_normals


@dataclass(frozen=True, slots=True)
class Overhang:
    """What hangs over, with z upwards as printed and the lowest point on the bed."""

    steep_mm2: float
    """Area of faces that look down and lean further than the limit from the vertical, not on the bed."""
    share: float
    """Of the whole surface."""
    bridge_mm: float
    """Longest way over air in any layer: twice the distance from a printed point to what lies below it."""
    bridge_z_mm: float
    """Height above the bed of that layer; 0 where nothing is bridged."""


def overhang(triangles: Triangles, limit_deg: float = 45.0, layer_mm: float = 0.2, pitch_mm: float = 0.25) -> Overhang:
    """Measure steep faces and bridges of a closed mesh.

    Bridges are found layer by layer, where there are steep faces: a layer is drawn on a grid, and each of its points
    has a distance to the layer below. A ceiling that is held on both sides spans twice the largest distance; one that
    is held on one side only counts twice, too, which is on the safe side.

    Parameters
    ----------
    triangles : (N, 3, 3), mm
    limit_deg : lean from the vertical up to which nothing is needed; one degree is forgiven, for facets
    layer_mm : height of a layer
    pitch_mm : of the grid
    """
    corners = np.asarray(triangles, dtype=np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    down = -unit_normals(triangles)[:, 2]
    bed = float(corners[..., 2].min())
    on_bed = corners[..., 2].max(axis=1) < bed + 0.01
    steep = (down > np.sin(np.deg2rad(limit_deg + 1.0))) & ~on_bed
    area = float(areas[steep].sum())
    best, height = 0.0, 0.0
    for layer in _layers_over(corners[steep][..., 2] - bed, layer_mm):
        middle = (layer + 0.5) * layer_mm
        width = _bridge(corners, bed + middle, layer_mm, pitch_mm)
        if width > best:
            best, height = width, layer * layer_mm
    return Overhang(area, area / float(areas.sum()), best, height)


def _layers_over(heights: NDArray[np.float64], layer_mm: float) -> list[int]:
    """Numbers of the layers that lie on steep faces, whose corners have these heights (N, 3) over the bed."""
    layers: set[int] = set()
    for low, high in zip(heights.min(axis=1), heights.max(axis=1), strict=True):
        layers.update(range(int(low // layer_mm), int(high // layer_mm) + 2))
    return sorted(layer for layer in layers if layer > 0)


def _bridge(corners: NDArray[np.float64], z: float, layer_mm: float, pitch_mm: float) -> float:
    low = corners[..., :2].reshape(-1, 2).min(axis=0) - 2 * pitch_mm
    high = corners[..., :2].reshape(-1, 2).max(axis=0) + 2 * pitch_mm
    columns, rows = np.ceil((high - low) / pitch_mm).astype(int)
    grid = (low, (int(rows), int(columns)), pitch_mm)
    layer = slice_mask(corners, z, *grid)
    below = slice_mask(corners, z - layer_mm, *grid)
    if not bool(layer.any()):
        return 0.0
    if not bool(below.any()):
        return float("inf")
    away = np.asarray(ndimage.distance_transform_edt(~below))
    reach = float(away[layer].max()) * pitch_mm
    return 2.0 * reach if reach > layer_mm + pitch_mm else 0.0


def slice_mask(
    corners: NDArray[np.float64], z: float, low: NDArray[np.float64], shape: tuple[int, int], pitch_mm: float
) -> NDArray[np.bool_]:
    """Return which points of a grid lie inside a closed mesh at the height `z`.

    Parameters
    ----------
    corners : (N, 3, 3)
    z : height of the cut, mm; it should not meet a corner
    low : (2,) x and y of the grid's first point
    shape : rows (along y) and columns (along x)
    pitch_mm : of the grid

    Returns
    -------
    (rows, columns) bool
    """
    heights = corners[..., 2] - z
    above = heights > 0
    cut = above.any(axis=1) & ~above.all(axis=1)
    points, heights, above = corners[cut], heights[cut], above[cut]
    count = above.sum(axis=1)
    alone = np.where(count == 1, above.argmax(axis=1), above.argmin(axis=1))  # the corner on its own side
    rows = np.arange(len(points))
    ends = []
    for step in (1, 2):
        other = (alone + step) % 3
        share = heights[rows, alone] / (heights[rows, alone] - heights[rows, other])
        ends.append(points[rows, alone, :2] + share[:, None] * (points[rows, other, :2] - points[rows, alone, :2]))
    start, end = ((np.asarray(point) - low) / pitch_mm for point in ends)  # in columns and rows
    parity = np.zeros((shape[0], shape[1] + 1), dtype=np.int64)
    first = np.ceil(np.minimum(start[:, 1], end[:, 1])).astype(np.int64)
    last = np.ceil(np.maximum(start[:, 1], end[:, 1])).astype(np.int64)  # rows first .. last - 1 are crossed
    lengths = np.maximum(last - first, 0)
    segment = np.repeat(np.arange(len(lengths)), lengths)
    row = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths) + first[segment]
    slope = (row - start[segment, 1]) / (end[segment, 1] - start[segment, 1])
    column = start[segment, 0] + slope * (end[segment, 0] - start[segment, 0])
    inside = (row >= 0) & (row < shape[0])
    place = np.clip(np.ceil(column), 0, shape[1]).astype(np.int64)
    np.add.at(parity, (row[inside], place[inside]), 1)
    return np.asarray(np.cumsum(parity, axis=1)[:, :-1] % 2 == 1)
