"""A plane mirror shows the camera the reflected finger, in the same frame of the rig, lit by the
reflected lights.

To reflect the camera's rays instead gives a second camera that sees the finger itself. A point of
an outline is a ray that touches the finger, and ray and outline together span a plane that touches
it: normal N out of the finger, N . X = c. Both hold for parallel and for spreading rays, and for
any pose of a mirror.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from splitknit.imaging.geometry import sampled_at
from splitknit.imaging.view import View
from splitknit.model import Array, Camera, FloatArray, Led, Mirror, Shade


class Touching(NamedTuple):
    """Rays that touch the finger, and planes that do (n of them), in the rig's frame, mm."""

    point: Array  # (n, 3) on the ray
    direction: Array  # (n, 3) of the ray, unit length, away from the camera
    normal: Array  # (n, 3) out of the finger, unit length

    @property
    def offset_mm(self) -> Array:
        """(n,) normal . X on the plane."""
        return np.asarray((self.normal * self.point).sum(axis=1))


def touching(camera: Camera, places_mm: Array, along: Array, outward: Array) -> Touching:
    """Rays and planes of points of an outline, by their `places_mm` (n, 2) on the finger plane.
    `along`: (n, 2) direction of the outline there; `outward`: (n, 2) any direction on that plane
    that leaves the finger.
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
    return Touching(point, direction, normal)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


class Pose(NamedTuple):
    """How a mirror differs from its nominal pose, see :meth:`Plane.posed`."""

    turn_rad: float = 0.0
    lean_rad: float = 0.0
    shift_mm: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Where a mirror lies."""

    point_mm: Array  # (3,) on the reflecting face
    normal: Array  # (3,) unit length, towards the camera (z > 0)

    @property
    def offset_mm(self) -> float:
        """Distance of the plane from the rig's origin, along the normal."""
        return float(np.dot(self.point_mm, self.normal))

    def moved(self, turn_rad: tuple[float, float], shift_mm: float) -> Plane:
        """The plane turned about its point by two small angles (about :meth:`axes`), and shifted
        along its normal."""
        first, second = self.axes()
        normal = self.normal + turn_rad[0] * second - turn_rad[1] * first
        normal = normal / np.linalg.norm(normal)
        return Plane(self.point_mm + shift_mm * normal, normal)

    def posed(self, turn_rad: float, lean_rad: float, shift_mm: float) -> Plane:
        """The plane turned about z, leaned towards lying flat, both about its point, and shifted
        along its normal."""
        x, y = self.normal[:2] / np.hypot(*self.normal[:2])
        cosine = np.cos(turn_rad)
        sine = np.sin(turn_rad)
        level = np.array([cosine * x - sine * y, sine * x + cosine * y])
        elevation = np.arctan2(self.normal[2], np.hypot(*self.normal[:2])) + lean_rad
        normal = np.array([*(np.cos(elevation) * level), np.sin(elevation)])
        return Plane(self.point_mm + shift_mm * normal, normal)

    def reflect(self, touching: Touching) -> Touching:
        """Rays and planes that the camera sees in the mirror, as they touch the finger itself."""
        return Touching(
            reflect_points(touching.point, self),
            reflect_vectors(touching.direction, self),
            reflect_vectors(touching.normal, self),
        )

    def axes(self) -> tuple[Array, Array]:
        """Two unit vectors in the plane, at right angles: the first lies as nearly along y as it
        can."""
        start = np.eye(3)[1 if abs(self.normal[1]) < 0.9 else 0]
        first = start - np.dot(start, self.normal) * self.normal
        first = first / np.linalg.norm(first)
        return first, np.cross(self.normal, first)

    def image_axis(self, axis: Array) -> Array:
        """(2,) unit direction in which a level direction (2,) of the finger runs in the mirror's
        picture."""
        level = self.normal[:2]
        reflected = axis - 2.0 * float(axis @ level) * level
        return reflected / np.linalg.norm(reflected)

    def epipole(self, camera: Camera) -> Array | None:
        """(2,) where on the finger plane the joints of all points with their mirror images meet;
        None: parallel."""
        if camera.model == "orthographic":
            return None
        return np.asarray(-camera.height_mm * self.normal[:2] / self.normal[2])


def reflect_vectors(vectors: Array, plane: Plane) -> Array:
    """Directions (..., 3) reflected in the mirror."""
    return vectors - 2.0 * (vectors @ plane.normal)[..., None] * plane.normal


def reflect_points(points_mm: Array, plane: Plane) -> Array:
    """Points (..., 3) reflected in the mirror: the same function takes them back."""
    beyond = points_mm @ plane.normal - plane.offset_mm
    return points_mm - 2.0 * beyond[..., None] * plane.normal


def led_image(led: Led, plane: Plane, strength: float = 1.0) -> Led:
    """Image of one LED in a mirror that reflects the fraction `strength` of its light, without
    those of its `also`."""
    image = replace(led, intensity=led.intensity * strength, also=(), reflected=True, shade=None)
    if led.position_mm is None:
        x, y, z = reflect_vectors(np.asarray(led.direction, dtype=np.float64), plane).tolist()
        return replace(image, direction=(x, y, z))
    x, y, z = reflect_points(np.asarray(led.position_mm, dtype=np.float64), plane).tolist()
    aim_x, aim_y, aim_z = reflect_vectors(led.axis, plane).tolist()
    return replace(image, position_mm=(x, y, z), aim=(aim_x, aim_y, aim_z))


# Which of an LED's images reach the skin: shadows that a finger throws on itself, and the outlines
# of mirrors.


def _towards(points_mm: Array, led: Led) -> Array:
    """Vectors (..., 3) from points to a near LED, or the direction of a distant one."""
    if led.position_mm is None:
        return np.broadcast_to(np.asarray(led.direction, dtype=np.float64), points_mm.shape)
    return np.asarray(led.position_mm, dtype=np.float64) - points_mm


def facing_fraction(points_mm: Array, normals: Array, led: Led) -> FloatArray:
    """Fraction (...) of a light that skin (..., 3) faces: a finger, being convex, is the only
    obstacle."""
    towards = _towards(points_mm, led)
    length = np.maximum(np.linalg.norm(towards, axis=-1), 1e-12)
    cosine = np.einsum("...i,...i->...", towards, normals) / length
    # fades in up to this cosine: ridges catch light here and there
    return np.asarray(np.clip(cosine / 0.04, 0.0, 1.0), dtype=np.float32)


def mirrored_fraction(points_mm: Array, image: Led, plane: Plane, corners_mm: Array) -> FloatArray:
    """Fraction (...) of an LED's `image` that points (..., 3) see within a mirror's convex outline
    (K, 3)."""
    towards = _towards(points_mm, image)
    above = points_mm @ plane.normal - plane.offset_mm
    falling = towards @ plane.normal
    meets = (above > 0) & (falling < -1e-9)
    way = np.where(meets, above / np.where(meets, -falling, 1.0), 0.0)
    on_plane = points_mm + way[..., None] * towards
    axes = np.stack(plane.axes(), axis=1)
    flat = (on_plane - plane.point_mm) @ axes
    outline = (corners_mm - plane.point_mm) @ axes
    following = np.roll(outline, -1, axis=0)
    turning = float(np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]))
    within = np.full(flat.shape[:-1], np.inf)
    for start, stop in zip(outline, following, strict=True):
        edge = (stop - start) / max(float(np.linalg.norm(stop - start)), 1e-12)
        inner = np.array([-edge[1], edge[0]]) * np.sign(turning)
        within = np.minimum(within, (flat - start) @ inner)
    # mm over which it fades out
    return np.asarray(np.clip(0.5 + within / 0.4, 0.0, 1.0) * meets, dtype=np.float32)


def shade_of(fraction: FloatArray, view: View) -> Shade:
    """The shade map of a light at the places that the pixels of a view see: `fraction` (h, w), on
    even steps over the finger plane."""
    x, y = view.x_mm, view.y_mm
    if x.ndim == 2:
        h, w = x.shape
        ends = (float(x.min()), float(x.max())), (float(y.max()), float(y.min()))
        wanted = np.meshgrid(np.linspace(*ends[0], w), np.linspace(*ends[1], h))
        column, row = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
        for _ in range(4):  # a lens with distortion
            here = [sampled_at(axis.astype(np.float32), column, row) for axis in (x, y)]
            column = column + (wanted[0] - here[0]) * (w - 1) / (ends[0][1] - ends[0][0])
            row = row + (wanted[1] - here[1]) * (h - 1) / (ends[1][1] - ends[1][0])
        return Shade(*ends, sampled_at(fraction, column, row), view.apex_mm)
    ends = (float(x[0]), float(x[-1])), (float(y[0]), float(y[-1]))
    return Shade(*ends, np.ascontiguousarray(fraction, dtype=np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class Glass:
    """A mirror as used for reflected light: its plane and outline."""

    name: str
    plane: Plane
    corners_mm: Array
    """(K, 3) outline of its face."""
    reflectance: float


def glass_in(mirror: Mirror, plane: Plane) -> Glass:
    """A mirror in its fitted plane, with its nominal outline projected into that plane."""
    corners = np.asarray(mirror.corners_mm, dtype=np.float64)
    corners = corners - (corners @ plane.normal - plane.offset_mm)[:, None] * plane.normal
    return Glass(
        mirror.name, Plane(corners.mean(axis=0), plane.normal), corners, mirror.reflectance
    )
