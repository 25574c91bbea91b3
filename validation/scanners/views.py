"""Calibrated pinhole views, of cameras and of projectors alike, and where their rays meet planes of
light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A pinhole as OpenCV has it: x right, y down, z away from it; pixel = matrix @ (rotation @ X +
    shift_mm)."""

    matrix: Array  # (3, 3) of the camera, pixels
    rotation: Array  # (3, 3) from the scene's frame to the view's
    shift_mm: Array  # (3,)

    @property
    def centre_mm(self) -> Array:
        """(3,) centre of projection in the scene's frame."""
        return np.asarray(-self.rotation.T @ self.shift_mm)

    def pixels(self, points_mm: NDArray[np.floating]) -> tuple[Array, Array]:
        """Columns and rows (...) of points (..., 3)."""
        seen = (points_mm @ self.rotation.T + self.shift_mm) @ self.matrix.T
        return np.asarray(seen[..., 0] / seen[..., 2]), np.asarray(seen[..., 1] / seen[..., 2])

    def directions(self, shape: tuple[int, int]) -> Array:
        """(H, W, 3) of the rays of all pixels, in the scene's frame; one long along the view's
        axis."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        pixels = np.stack([columns, rows, np.ones(shape)], axis=-1)
        return np.asarray(pixels @ (self.rotation.T @ np.linalg.inv(self.matrix)).T)


def on_planes(camera: View, projector: View, row: NDArray[np.floating]) -> tuple[Array, Array]:
    """Where a camera's rays meet the planes of light of a projector's rows.

    `row`: (H, W) the projector's row, in its pixels, that lights each pixel of the camera; NaN
    where unknown. Returns the points (H, W, 3), mm, NaN where unknown, and the mm along the ray a
    row (H, W): times the uncertainty of `row` it is that of the point. Source: Hartley and
    Zisserman, Multiple View Geometry, 2004, result 8.2 (a line's plane is P^T l).
    """
    rays = camera.directions((row.shape[0], row.shape[1]))
    centre = camera.centre_mm
    _, second, third = projector.matrix @ np.column_stack([projector.rotation, projector.shift_mm])
    plane = second - row[..., None].astype(np.float64) * third
    across = np.sum(plane[..., :3] * rays, axis=-1)
    across = np.where(np.abs(across) < 1e-12, np.nan, across)
    offset = plane[..., :3] @ centre + plane[..., 3]
    far = -offset / across
    turn = (third[:3] @ centre + third[3]) / across + far * (rays @ third[:3]) / across
    return centre + far[..., None] * rays, np.abs(turn) * np.linalg.norm(rays, axis=-1)


def between_neighbours(before: FloatArray, at: FloatArray, after: FloatArray) -> FloatArray:
    """Where the parabola through three values is highest, in steps from the middle one; NaN where
    it is not bent."""
    bend = before - 2.0 * at + after
    out = np.full_like(bend, np.nan)
    return np.asarray(np.divide(0.5 * (before - after), bend, out=out, where=bend < -1e-6))


def cloud_of(points_mm: NDArray[np.floating]) -> FloatArray:
    """The known ones (N, 3) of points (..., 3). Raises BadInput if none is known."""
    flat: FloatArray = np.asarray(points_mm, dtype=np.float32).reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    require(
        len(flat) > 0, "nothing of the finger was measured; check light, exposure and calibration."
    )
    return flat
