"""Where the camera sees points of the finger: itself, or in a mirror."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.imaging.view import pixels_of
from splitknit.mirrors.reflection import Plane, reflect_points, reflect_vectors
from splitknit.model import Array, Camera, FloatArray


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
