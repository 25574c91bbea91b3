"""Lines of sight: parallel ones of an orthographic camera, spreading ones of a perspective camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Camera
from splitknit.simulator.lens import slopes_of_pixels

Array = NDArray[np.float64]
Triple = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Lines of sight, told by their height: at z a ray passes (x - z slope_x, y - z slope_y, z), in mm."""

    x: Array
    """(N,) where they meet the finger plane."""
    y: Array
    slopes: tuple[Array, Array] | None = None
    """(N,) each: how far they move along x and y per mm downwards; None: they are parallel to z."""

    def some(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Rays:
        """The rays with these indices."""
        slopes = None if self.slopes is None else (self.slopes[0][which], self.slopes[1][which])
        return Rays(self.x[which], self.y[which], slopes)

    def at(self, z: Array) -> Triple:
        """(N,) x, y and z of the points at heights `z`."""
        if self.slopes is None:
            return self.x, self.y, z
        return self.x - self.slopes[0] * z, self.y - self.slopes[1] * z, z

    def rise(self, rotation: Array, gx: Array, gy: Array, gz: Array) -> Array:
        """(N,) change of a function per mm of height along the rays, from its gradient in the finger's frame.

        `rotation` (3, 3) takes that frame to the camera's.
        """
        up = gx * rotation[2, 0] + gy * rotation[2, 1] + gz * rotation[2, 2]
        if self.slopes is None:
            return np.asarray(up)
        along_x, along_y = (gx * r[0] + gy * r[1] + gz * r[2] for r in rotation[:2])
        return np.asarray(up - self.slopes[0] * along_x - self.slopes[1] * along_y)

    def along(self, vectors: Array) -> Array:
        """(N,) change per mm of height along the rays, from the gradient (N, 3) in the camera's frame."""
        if self.slopes is None:
            return vectors[:, 2]
        return np.asarray(vectors[:, 2] - self.slopes[0] * vectors[:, 0] - self.slopes[1] * vectors[:, 1])

    def length(self) -> Array | float:
        """(N,) mm of the rays per mm of height."""
        return 1.0 if self.slopes is None else np.sqrt(1.0 + self.slopes[0] ** 2 + self.slopes[1] ** 2)

    def turn_to_view(self, normals: Array, least: float = 1e-3) -> None:
        """Turn unit vectors (N, 3) whose cosine with the direction to the viewer is below `least`, in place."""
        cosine = self.along(normals) / self.length()
        away = cosine < least
        if self.slopes is None:
            normals[away, 2] = least
        else:
            some = self.some(away)
            assert some.slopes is not None
            view = np.stack([-some.slopes[0], -some.slopes[1], np.ones_like(some.x)], axis=1)
            view /= np.linalg.norm(view, axis=1, keepdims=True)
            normals[away] += (least - cosine[away])[:, None] * view
        normals[away] /= np.sqrt((normals[away] ** 2).sum(axis=1, keepdims=True))


def rays_of(camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Rays:
    """The rays of all pixels in these rows and columns, row by row."""
    if camera.model == "perspective":
        across, up = slopes_of_pixels(camera, columns[None, :], rows[:, None])
        across, up = across.ravel(), up.ravel()
        return Rays(across * camera.height_mm, up * camera.height_mm, (across, up))
    x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
    y = ((camera.image_size[0] - 1) / 2 - rows) / camera.px_per_mm
    grid_x, grid_y = np.meshgrid(x, y)
    return Rays(grid_x.ravel(), grid_y.ravel())
