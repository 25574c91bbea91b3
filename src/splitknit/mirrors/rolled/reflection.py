"""A plane mirror shows the camera the reflected finger, in the same frame of the rig, lit by the reflected lights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray, Led

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Where a mirror lies."""

    point_mm: Array
    """(3,) on the reflecting face."""
    normal: Array
    """(3,) unit length, towards the camera (z > 0)."""

    def __post_init__(self) -> None:
        shapes = np.shape(self.point_mm), np.shape(self.normal)
        require(shapes == ((3,), (3,)), f"a mirror's point and normal are three numbers each, not {shapes}.")
        length = float(np.linalg.norm(self.normal))
        require(abs(length - 1.0) < 1e-6, f"a mirror's normal must have unit length, but it has {length:.6g}.")

    @property
    def offset_mm(self) -> float:
        """Distance of the plane from the rig's origin, along the normal."""
        return float(np.dot(self.point_mm, self.normal))

    def moved(self, turn_rad: tuple[float, float], shift_mm: float) -> Plane:
        """The plane turned about its point by two small angles (about :meth:`axes`), and shifted along its normal."""
        first, second = self.axes()
        normal = self.normal + turn_rad[0] * second - turn_rad[1] * first
        normal = normal / np.linalg.norm(normal)
        return Plane(self.point_mm + shift_mm * normal, normal)

    def axes(self) -> tuple[Array, Array]:
        """Two unit vectors in the plane, at right angles: the first lies as nearly along y as it can."""
        other = np.array([0.0, 1.0, 0.0]) if abs(self.normal[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
        first = other - np.dot(other, self.normal) * self.normal
        first = first / np.linalg.norm(first)
        return first, np.cross(self.normal, first)


def reflect_vectors(vectors: Array, plane: Plane) -> Array:
    """Directions (..., 3) reflected in the mirror."""
    return np.asarray(vectors - 2.0 * (vectors @ plane.normal)[..., None] * plane.normal)


def reflect_points(points_mm: Array, plane: Plane) -> Array:
    """Points (..., 3) reflected in the mirror: the same function takes them back."""
    beyond = points_mm @ plane.normal - plane.offset_mm
    return np.asarray(points_mm - 2.0 * beyond[..., None] * plane.normal)


def led_image(led: Led, plane: Plane, strength: float = 1.0) -> Led:
    """Image of one LED in a mirror that reflects the fraction `strength` of its light, without those of its `also`."""
    intensity = led.intensity * strength
    if led.position_mm is None:
        direction = reflect_vectors(np.asarray(led.direction, dtype=np.float64), plane)
        return replace(led, direction=_triple(direction), intensity=intensity, also=(), reflected=True, shade=None)
    position = reflect_points(np.asarray(led.position_mm, dtype=np.float64), plane)
    return replace(
        led, position_mm=_triple(position), aim=_triple(reflect_vectors(led.axis, plane)), intensity=intensity,
        also=(), reflected=True, shade=None,
    )  # fmt: skip


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


# Which of an LED's images reach the skin: shadows that a finger throws on itself, and the outlines of mirrors.

GRAZING = 0.04
"""Cosine of incidence up to which a light fades in: the ridges of skin catch it here and there."""
EDGE_MM = 0.4
"""Width over which light by way of a mirror fades out at the mirror's edge."""


def facing_fraction(points_mm: Array, normals: Array, led: Led) -> FloatArray:
    """Fraction (...) in [0, 1] of a light that skin at `points_mm` with `normals`, (..., 3), is not turned away from: a
    finger is convex, so that it is its only obstacle.
    """
    if led.position_mm is None:
        towards = np.broadcast_to(np.asarray(led.direction, dtype=np.float64), points_mm.shape)
    else:
        towards = np.asarray(led.position_mm, dtype=np.float64) - points_mm
    length = np.maximum(np.linalg.norm(towards, axis=-1), 1e-12)
    cosine = np.einsum("...i,...i->...", towards, normals) / length
    return np.asarray(np.clip(cosine / GRAZING, 0.0, 1.0), dtype=np.float32)


def mirrored_fraction(points_mm: Array, image: Led, plane: Plane, corners_mm: Array) -> FloatArray:
    """Fraction (...) in [0, 1] of an LED's `image` in a mirror that points (..., 3) before it see within its outline
    `corners_mm` (K, 3), in order, convex.
    """
    if image.position_mm is None:
        towards = np.broadcast_to(np.asarray(image.direction, dtype=np.float64), points_mm.shape)
    else:
        towards = np.asarray(image.position_mm, dtype=np.float64) - points_mm
    above = points_mm @ plane.normal - plane.offset_mm
    falling = towards @ plane.normal
    there = (above > 0) & (falling < -1e-9)
    way = np.where(there, above / np.where(there, -falling, 1.0), 0.0)
    met = points_mm + way[..., None] * towards
    axes = np.stack(plane.axes(), axis=1)
    flat, outline = (met - plane.point_mm) @ axes, (np.asarray(corners_mm) - plane.point_mm) @ axes
    following = np.roll(outline, -1, axis=0)
    turning = float(np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]))
    within = np.full(flat.shape[:-1], np.inf)
    for start, stop in zip(outline, following, strict=True):
        edge = (stop - start) / max(float(np.linalg.norm(stop - start)), 1e-12)
        inner = np.array([-edge[1], edge[0]]) * np.sign(turning)
        within = np.minimum(within, (flat - start) @ inner)
    return np.asarray(np.clip(0.5 + within / EDGE_MM, 0.0, 1.0) * there, dtype=np.float32)
