"""What the twin's camera sees of a bench: lines of sight of its pixels, flat ground under them, edges in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from splitknit.errors import require
from splitknit.model import Camera
from splitknit.simulator import lens

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Lines of sight: at the height z a pixel looks at (x - z slope_x, y - z slope_y)."""

    x: Array
    """(h, w) mm, where the line meets z = 0."""
    y: Array
    slope_x: Array
    """(h, w) mm sideways per mm downwards; zero for parallel rays."""
    slope_y: Array


def sight(camera: Camera) -> Sight:
    """Return the lines of sight of all pixels' centres."""
    height, width = camera.image_size
    columns = np.arange(width, dtype=np.float64)[None, :]
    rows = np.arange(height, dtype=np.float64)[:, None]
    if camera.model == "orthographic":
        x = np.broadcast_to((columns - (width - 1) / 2) / camera.px_per_mm, (height, width))
        y = np.broadcast_to(((height - 1) / 2 - rows) / camera.px_per_mm, (height, width))
        return Sight(x, y, np.zeros((height, width)), np.zeros((height, width)))
    slope_x, slope_y = lens.slopes_of_pixels(camera, columns, rows)
    return Sight(slope_x * camera.height_mm, slope_y * camera.height_mm, slope_x, slope_y)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A flat thing: its middle, and its own axes u (right), v (up) and n (towards the viewer) in the rig's frame."""

    middle: Array
    """(3,) mm."""
    axes: Array
    """(3, 3): the columns are u, v and n."""

    def hit(self, sight: Sight) -> tuple[Array, Array, Array]:
        """u and v at which the lines of sight meet the plane, and the height z there, (h, w) each."""
        normal = self.axes[:, 2]
        steepness = normal[2] - normal[0] * sight.slope_x - normal[1] * sight.slope_y
        require(
            float(steepness.min()) > 0.05, "the camera sees the plane edge-on or from behind; tilt it less than 80 deg."
        )
        z = (float(normal @ self.middle) - normal[0] * sight.x - normal[1] * sight.y) / steepness
        x, y = sight.x - sight.slope_x * z - self.middle[0], sight.y - sight.slope_y * z - self.middle[1]
        lift = z - self.middle[2]
        u, v = (x * axis[0] + y * axis[1] + lift * axis[2] for axis in (self.axes[:, 0], self.axes[:, 1]))
        return u, v, z

    def points(self, u: Any, v: Any, w: Any = 0.0) -> Array:
        """Points (..., 3) of the rig's frame at u, v and w above the plane, all in mm."""
        own = np.stack(np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (u, v, w))), axis=-1)
        return np.asarray(own @ self.axes.T + self.middle)

    def own(self, points: Any) -> Array:
        """Points (..., 3) of the rig's frame in the plane's own u, v and height above it: inverse of :meth:`points`."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.middle) @ self.axes)


def plane_of(rotation_vector: Any, middle_mm: Any) -> Plane:
    """Return a plane that faces the camera, turned by `rotation_vector` (rad, right-handed) about `middle_mm`."""
    rotation = np.asarray(rotation_vector, dtype=np.float64)
    middle = np.asarray(middle_mm, dtype=np.float64)
    require(
        rotation.shape == (3,) and middle.shape == (3,) and bool(np.isfinite([rotation, middle]).all()),
        "a pose needs a rotation vector and a translation of three finite numbers each.",
    )
    return Plane(middle, np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64))


def base_plane(tilt_deg: tuple[float, float], height_mm: float = 0.0) -> Plane:
    """Return the rig's base at `height_mm`, turned by two small angles about x and y."""
    require(
        bool(np.isfinite(tilt_deg).all()) and max(abs(t) for t in tilt_deg) <= 45.0,
        f"tilt_deg must be two angles of at most 45 deg, but it is {tuple(tilt_deg)}.",
    )
    return plane_of((*np.deg2rad(tilt_deg), 0.0), (0.0, 0.0, height_mm))


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """How far a length on the ground moves from one pixel to the next, (h, w) each."""

    column: Array
    row: Array


def steps(length: Array) -> Steps:
    """Return the steps of `length` (h, w)."""
    row, column = np.gradient(length)
    return Steps(np.asarray(column), np.asarray(row))


def inside(distance: Array, step: Steps | None = None, blur: float = 0.0) -> Array:
    """Share of each pixel that lies inside a straight edge, whose distance inwards from the pixel's middle is given.

    Parameters
    ----------
    distance : (h, w), positive inside
    step : of `distance`; by default it is measured
    blur : standard deviation of the edge itself, in the unit of `distance`

    Returns
    -------
    (h, w) in [0, 1]: the edge averaged over the square pixel. The longer of the pixel's two steps is averaged exactly
    and the shorter one as a Gaussian of the same variance, so that edges along rows or columns are exact.
    """
    step = step or steps(distance)
    column, row = np.abs(step.column), np.abs(step.row)
    half = np.maximum(np.maximum(column, row), 1e-9) / 2.0
    spread = np.sqrt(np.minimum(column, row) ** 2 / 12.0 + blur * blur + (1e-4 * half) ** 2)
    share = np.asarray(distance > 0.0, dtype=np.float64)
    near = np.abs(distance) < half + 6.0 * spread
    distance, half, spread = distance[near], half[near], spread[near]
    share[near] = (_ramp(distance + half, spread) - _ramp(distance - half, spread)) / (2.0 * half)
    return share


def _ramp(distance: Array, spread: Array) -> Array:
    """Integral of the normal distribution function."""
    along = distance / spread
    return np.asarray(distance * ndtr(along) + spread * np.exp(-0.5 * along * along) / np.sqrt(2.0 * np.pi))


def seen_at(camera: Camera, points: Array) -> Array:
    """Column and row (..., 2) at which points (..., 3) of the rig's frame appear, in the picture or outside it."""
    column, row = lens.pixels_of_points(camera, points[..., 0], points[..., 1], points[..., 2])
    return np.stack([column, row], axis=-1)
