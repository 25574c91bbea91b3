"""A surface on a chart as a view sees it: heights on the view's pixels, and where on the chart they lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.mirrors.rolled.chart import Chart
from splitknit.mirrors.rolled.reflection import Plane, reflect_points, reflect_vectors
from splitknit.model import Camera, FloatArray

Array = NDArray[np.float64]

BEYOND_MM = 16.0
"""The camera's rays are followed from this far above the finger's axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One view of the finger under parallel rays: from the front, or in a mirror."""

    name: str
    """``front``, or the mirror's name."""
    camera: Camera
    plane: Plane | None = None
    """Of the mirror; None: the camera sees the finger itself."""

    def to_view(self, points_mm: Array) -> Array:
        """Points (..., 3) of the rig's frame where the camera seems to see them; the same function takes them back."""
        return points_mm if self.plane is None else reflect_points(points_mm, self.plane)

    def turned(self, vectors: Array) -> Array:
        """Directions (..., 3) likewise."""
        return vectors if self.plane is None else reflect_vectors(vectors, self.plane)

    def pixels(self, points_mm: Array) -> tuple[FloatArray, FloatArray]:
        """Columns and rows (...) of points (..., 3) of the rig's frame."""
        seen = self.to_view(points_mm)
        rows, columns = self.camera.image_size
        scale = self.camera.px_per_mm
        column = seen[..., 0] * scale + (columns - 1) / 2
        return column.astype(np.float32), ((rows - 1) / 2 - seen[..., 1] * scale).astype(np.float32)

    def cosine(self, normals: Array) -> Array:
        """Cosine (...) of the angle between normals (..., 3) of the rig's frame and the line of sight."""
        towards = self.turned(np.array([0.0, 0.0, 1.0]))
        return np.asarray(normals @ towards)


def heights(sight: Sight, chart: Chart, radius_mm: Any, x_mm: Array, y_mm: Array) -> FloatArray:
    """(h, w) height, in the view's frame, of the surface over pixels at x (w,) and y (h,); NaN beside it.

    Parameters
    ----------
    radius_mm : (n, m) surface on the chart
    """
    surface = np.asarray(radius_mm, dtype=np.float32)
    middle = sight.to_view(chart.centre_mm + 0.5 * min(float(chart.length_mm[-1]), 0.0) * chart.axes[1])
    place = np.empty((y_mm.size, x_mm.size, 3))
    place[..., 0], place[..., 1] = x_mm[None, :], y_mm[:, None]
    axis = sight.turned(chart.axes[1])
    beside = np.hypot(axis[0], axis[1])
    along = ((place[..., 0] - middle[0]) * axis[0] + (place[..., 1] - middle[1]) * axis[1]) / max(beside, 1e-6) ** 2
    level = middle[2] + (along * axis[2] if beside > 0.5 else 0.0)

    def outside(height: Array) -> tuple[Array, NDArray[np.bool_]]:
        place[..., 2] = height
        angle, length, distance = chart.locate(sight.to_view(place))
        column, row = chart.places(angle, length)
        last_row, last_column = chart.shape[0] - 1, chart.shape[1] - 1
        there = (column >= 0) & (column <= last_column) & (row <= last_row)
        met = ndimage.map_coordinates(surface, [row, column], order=1, mode="nearest")
        return np.nan_to_num(distance - met, nan=1e3), there

    low, high = (
        np.broadcast_to(level, place.shape[:2]).copy(),
        np.broadcast_to(level + BEYOND_MM, place.shape[:2]).copy(),
    )
    hit = outside(low)[0] < 0
    for _ in range(20):
        middle_height = 0.5 * (low + high)
        out = outside(middle_height)[0] > 0
        high, low = np.where(out, middle_height, high), np.where(out, low, middle_height)
    found = 0.5 * (low + high)
    _, there = outside(found)
    return np.where(hit & there, found, np.nan).astype(np.float32)
