"""Where the camera sees points of the finger, itself or in a mirror, and the sheet on which these
views are fused: angle around the finger, and length along it.

Rays leave the finger's axis at right angles, in a fan at the tip: each meets the skin once. A
surface is the distance along them. So the sheet reaches around the finger and over its tip, where a
height above one plane cannot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from splitknit.imaging.view import View, pixels_of
from splitknit.mirrors.reflection import Plane, reflect_points, reflect_vectors
from splitknit.model import Array, BoolArray, Camera, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One view of the finger: from the front, or in a mirror."""

    name: str
    """``front``, or the mirror's name."""
    camera: Camera
    plane: Plane | None = None
    """Plane of the mirror; None: the camera sees the finger itself."""

    def to_view(self, points_mm: Array) -> Array:
        """Points (..., 3) of the rig's frame where the camera seems to see them; the same function
        takes them back."""
        return points_mm if self.plane is None else reflect_points(points_mm, self.plane)

    def turned(self, vectors: Array) -> Array:
        """Directions (..., 3) likewise."""
        return vectors if self.plane is None else reflect_vectors(vectors, self.plane)

    def pixels(self, points_mm: Array) -> tuple[FloatArray, FloatArray]:
        """Columns and rows (...) of points (..., 3) of the rig's frame."""
        seen = pixels_of(self.camera, self.to_view(points_mm).reshape(-1, 3)).astype(np.float32)
        column, row = (part.reshape(points_mm.shape[:-1]) for part in seen.T)
        return column, row

    def cosine(self, normals: Array, points_mm: Array) -> Array:
        """Cosine (...) of the angle between normals (..., 3) at points (..., 3) of the rig's frame
        and the line of sight."""
        if self.camera.model == "orthographic":
            return normals @ self.turned(np.array([0.0, 0.0, 1.0]))
        towards = np.array([0.0, 0.0, self.camera.height_mm]) - self.to_view(points_mm)
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        return np.asarray((normals * self.turned(towards)).sum(axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Rays around a finger."""

    centre_mm: Array  # (3,) on the axis, where the fan of the tip starts; rig's frame
    # (3, 3) rows: to the right, towards the tip, to the camera; unit length, right-handed
    axes: Array
    angle_rad: Array  # (m,) two at least, ascending; 0 faces the camera, positive to the right
    # (n,) falling, two at least: negative below the centre, above it the fan's angle times `cap_mm`
    length_mm: Array
    cap_mm: float  # typical distance of the skin from the centre at the tip

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (lengths), columns (angles)."""
        return self.length_mm.size, self.angle_rad.size

    @property
    def pitch_mm(self) -> float:
        """Along the finger."""
        return float(self.length_mm[0] - self.length_mm[-1]) / (self.length_mm.size - 1)

    def rays(self) -> tuple[Array, Array]:
        """Starts (n, 3) and directions (n, m, 3) of the rays, rig's frame."""
        start = self.centre_mm + np.minimum(self.length_mm, 0.0)[:, None] * self.axes[1]
        fan = np.maximum(self.length_mm, 0.0) / self.cap_mm
        right, front = np.sin(self.angle_rad), np.cos(self.angle_rad)
        beside, over = np.cos(fan)[:, None], np.broadcast_to(np.sin(fan)[:, None], self.shape)
        return start, np.stack([beside * right, over, beside * front], axis=-1) @ self.axes

    def points(self, radius_mm: Any) -> Array:
        """(n, m, 3) points at distances (n, m) along the rays."""
        start, directions = self.rays()
        return np.asarray(
            start[:, None] + np.asarray(radius_mm, dtype=float)[..., None] * directions
        )

    def locate(self, points_mm: Array) -> tuple[Array, Array, Array]:
        """Angle, length and distance (...) of points (..., 3)."""
        right, along, front = np.moveaxis((points_mm - self.centre_mm) @ self.axes.T, -1, 0)
        beside = np.hypot(right, front)
        over = np.maximum(along, 0.0)
        length = np.where(along > 0, self.cap_mm * np.arctan2(over, beside), along)
        return np.arctan2(right, front), length, np.hypot(beside, over)

    def places(self, angle_rad: Array, length_mm: Array) -> tuple[FloatArray, FloatArray]:
        """Columns and rows (...) of angles and lengths (...)."""
        columns = (
            (angle_rad - self.angle_rad[0])
            / (self.angle_rad[-1] - self.angle_rad[0])
            * (self.shape[1] - 1)
        )
        rows = (self.length_mm[0] - length_mm) / self.pitch_mm
        return columns.astype(np.float32), rows.astype(np.float32)


def surface_normals(points_mm: Array) -> Array:
    """(n, m, 3) unit normals, outwards, of points (n, m, 3) on a chart; zero where they are not
    known."""
    down, right = np.gradient(points_mm, axis=(0, 1))
    normal = np.cross(right, -down)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(np.nan_to_num(normal / np.maximum(length, 1e-12)))


# A surface on a chart as a view sees it: heights on the view's pixels, and where on the chart they
# lie.


def heights(sight: Sight, chart: Chart, radius_mm: Array, view: View) -> FloatArray:
    """(h, w) z, in the view's frame, of the surface `radius_mm` (n, m) on the chart at the pixels
    of `view`, or NaN."""
    surface = radius_mm.astype(np.float32)
    middle = sight.to_view(
        chart.centre_mm + 0.5 * min(float(chart.length_mm[-1]), 0.0) * chart.axes[1]
    )
    x = view.x_mm
    y = view.y_mm if view.y_mm.ndim == 2 else view.y_mm[:, None]
    shape = y.shape[0], x.shape[-1]

    def lifted(height: Any) -> Array:
        nearer = 1.0 if view.apex_mm is None else 1.0 - height / view.apex_mm
        return np.stack(np.broadcast_arrays(x * nearer, y * nearer, height), axis=-1)

    def above(height: Array) -> tuple[Array, BoolArray]:
        """Distance to the surface, and whether the chart reaches there."""
        angle, length, distance = chart.locate(sight.to_view(lifted(height)))
        column, row = chart.places(angle, length)
        on_chart = (column >= 0) & (column <= chart.shape[1] - 1) & (row <= chart.shape[0] - 1)
        radius = scipy.ndimage.map_coordinates(surface, [row, column], order=1, mode="nearest")
        return np.nan_to_num(distance - radius, nan=1e3), on_chart

    # the rays are followed from the finger's axis
    plane = lifted(np.full(shape, middle[2]))
    axis = sight.turned(chart.axes[1])
    beside = np.hypot(axis[0], axis[1])
    along = ((plane[..., 0] - middle[0]) * axis[0] + (plane[..., 1] - middle[1]) * axis[1]) / max(
        beside, 1e-6
    ) ** 2
    low = np.broadcast_to(middle[2] + (along * axis[2] if beside > 0.5 else 0.0), shape)
    # the camera's rays are followed from this far above the finger's axis
    height = crossing(lambda height: above(height)[0] > 0, low, low + 16.0, 20)
    met = (above(low)[0] < 0) & above(height)[1]
    return np.where(met, height, np.nan).astype(np.float32)


def crossing(outside: Callable[[Array], BoolArray], low: Array, high: Array, rounds: int) -> Array:
    """Where rays that are inside at `low` and outside at `high` (n, m) leave a body, by
    bisection."""
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        out = outside(middle)
        high = np.where(out, middle, high)
        low = np.where(out, low, middle)
    return 0.5 * (low + high)
