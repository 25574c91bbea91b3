"""Rays of outlines, the planes that touch the finger along them, and their mirror images.

A camera sees in a mirror the reflected finger. To reflect the rays instead gives a second camera that sees the finger
itself. A point of an outline is a ray that touches the finger, and ray and outline together span a plane that touches
it: normal N out of the finger, N . X = c. Both hold for parallel and for spreading rays, and for any pose of a mirror.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Camera, Mirror

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """Rays that touch the finger, and planes that do (n of them), in the rig's frame, mm."""

    point: Array
    """(n, 3) on the ray."""
    direction: Array
    """(n, 3) of the ray, unit length, away from the camera."""
    normal: Array
    """(n, 3) out of the finger, unit length."""
    offset_mm: Array
    """(n,) normal . X on the plane."""


def touching(camera: Camera, places_mm: Array, along: Array, outward: Array) -> Touching:
    """Rays and planes of points of an outline, by their `places_mm` (n, 2) on the finger plane. `along`: (n, 2)
    direction of the outline there; `outward`: (n, 2) any direction on that plane that leaves the finger.
    """
    n = len(places_mm)
    point = np.column_stack([places_mm, np.zeros(n)])
    if camera.model == "orthographic":
        direction = np.tile([0.0, 0.0, -1.0], (n, 1))
    else:
        direction = _unit(np.column_stack([places_mm, np.full(n, -camera.height_mm)]))
    normal = _unit(np.cross(direction, np.column_stack([along, np.zeros(n)])))
    inwards = (normal[:, :2] * outward).sum(axis=1) < 0
    normal[inwards] *= -1.0
    return Touching(point, direction, normal, (normal * point).sum(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPlane:
    """Where a mirror is: normal . X = offset."""

    normal: Array
    """(3,) unit length, towards the camera."""
    offset_mm: float

    @staticmethod
    def nominal(mirror: Mirror) -> MirrorPlane:
        """As the rig file has it."""
        return MirrorPlane(mirror.normal, float(mirror.normal @ mirror.point_mm))

    def moved(self, turn_rad: float, lean_rad: float, shift_mm: float, about_mm: Array) -> MirrorPlane:
        """The mirror turned about z by `turn_rad`, leaned by `lean_rad` more towards lying flat, and shifted by
        `shift_mm` along its normal; but for the shift its point `about_mm` (3,) stays where it is.
        """
        level = self.normal[:2] / np.hypot(*self.normal[:2])
        cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
        level = np.array([cosine * level[0] - sine * level[1], sine * level[0] + cosine * level[1]])
        elevation = np.arctan2(self.normal[2], np.hypot(*self.normal[:2])) + lean_rad
        normal = np.array([*(np.cos(elevation) * level), np.sin(elevation)])
        return MirrorPlane(normal, float(normal @ about_mm) + shift_mm)

    def reflect(self, seen: Touching) -> Touching:
        """Rays and planes as the mirror turns them: those of the finger itself."""
        n, d = self.normal, self.offset_mm
        point = seen.point - 2.0 * np.outer(seen.point @ n - d, n)
        direction = seen.direction - 2.0 * np.outer(seen.direction @ n, n)
        normal = seen.normal - 2.0 * np.outer(seen.normal @ n, n)
        return Touching(point, direction, normal, (normal * point).sum(axis=1))

    def image_axis(self, axis: Array) -> Array:
        """(2,) unit direction in which a level direction (2,) of the finger runs in the mirror's picture."""
        n = self.normal
        shown = axis - 2.0 * float(axis @ n[:2]) * n[:2]
        return np.asarray(shown / np.linalg.norm(shown))

    def epipole(self, camera: Camera) -> Array | None:
        """(2,) where on the finger plane the joints of all points with their mirror images meet; None: parallel."""
        if camera.model == "orthographic":
            return None
        return np.asarray(-camera.height_mm * self.normal[:2] / self.normal[2])


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
