"""Which of an LED's images reach the skin: shadows that a finger throws on itself, and the outlines of mirrors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.rolled.reflection import Plane, reflect_points
from splitknit.model import FloatArray, Led

Array = NDArray[np.float64]

GRAZING = 0.04
"""Cosine of incidence up to which a light fades in: the ridges of skin catch it here and there."""
EDGE_MM = 0.4
"""Width over which light by way of a mirror fades out at the mirror's edge."""


def facing_share(points_mm: Array, normals: Array, led: Led) -> FloatArray:
    """Share (...) in [0, 1] of a light that the skin is not turned away from.

    Parameters
    ----------
    points_mm, normals : (..., 3) of the skin; a finger is convex, so that it is its only obstacle
    led : alone
    """
    if led.position_mm is None:
        towards = np.broadcast_to(np.asarray(led.direction, dtype=np.float64), points_mm.shape)
    else:
        towards = np.asarray(led.position_mm, dtype=np.float64) - points_mm
    length = np.maximum(np.linalg.norm(towards, axis=-1), 1e-12)
    cosine = np.einsum("...i,...i->...", towards, normals) / length
    return np.asarray(np.clip(cosine / GRAZING, 0.0, 1.0), dtype=np.float32)


def mirrored_share(points_mm: Array, image: Led, plane: Plane, corners_mm: Array) -> FloatArray:
    """Share (...) in [0, 1] of an LED's image that points (..., 3) see within the mirror's outline.

    Parameters
    ----------
    points_mm : (..., 3) in front of the mirror
    image : of the LED in this mirror
    plane : of the mirror
    corners_mm : (K, 3) its outline, in order, convex
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


def reflected_corners(corners_mm: Array, plane: Plane) -> Array:
    """Outline (K, 3) of another mirror as this one shows it."""
    return reflect_points(np.asarray(corners_mm, dtype=np.float64), plane)
