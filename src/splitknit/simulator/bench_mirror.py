"""LEDs in a mirror: where lines of sight go after it, and whether they end on an LED's bright face."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Led
from splitknit.simulator.bench_sight import Array, Sight, steps
from splitknit.simulator.lighting import UNIT

FINER = 12
"""A pixel near a mirrored LED's rim is this many samples wide."""
Lines = tuple[Array, Array]
"""Points (..., 3) and unit vectors (..., 3): normals of a mirror, or directions of rays."""


def unit(vectors: NDArray[np.float64]) -> Array:
    """Vectors (..., 3) of length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def directions(sight: Sight) -> Array:
    """Unit vectors (..., 3) from the camera."""
    return unit(np.stack([sight.slope_x, sight.slope_y, np.full_like(sight.x, -1.0)], axis=-1))


def mirrored(sight: Sight, mirror: Lines) -> Lines:
    """Where lines of sight leave a mirror (points and normals) and which way they go then."""
    points, normals = mirror
    down = directions(sight)
    return points, down - 2.0 * np.sum(down * normals, axis=-1, keepdims=True) * normals


def led_face(led: Led, radius_mm: float, rays: Lines) -> tuple[Array, Array]:
    """By how much (mm) rays pass inside the rim of the LED's face, and the radiance of that face towards them.

    A face of radius r that sends the intensity I straight ahead has the radiance I / (pi r^2) there; seen from beside
    its axis, its lobe's share over the cosine of its own foreshortening.
    """
    start, way = rays
    middle = np.asarray(led.position_mm, dtype=np.float64)
    cosine = -(way @ led.axis)
    meets = cosine > 1e-3
    reach = ((middle - start) @ led.axis) / np.where(meets, -cosine, -1.0)
    offset = start + reach[..., None] * way - middle
    inwards = np.where(meets & (reach > 0.0), radius_mm - np.linalg.norm(offset, axis=-1), -1e3)
    ahead = led.intensity * UNIT / (np.pi * max(radius_mm, 1e-6) ** 2)
    return inwards, np.asarray(ahead * np.maximum(cosine, 1e-3) ** (led.lobe_exponent - 1.0))


def finer_lines(sight: Sight, at: tuple[NDArray[Any], ...]) -> Iterator[Sight]:
    """Lines of sight of a square grid of points within the pixels `at`, one point of all pixels after the other."""
    values = (sight.x, sight.y, sight.slope_x, sight.slope_y)
    slopes = [steps(value) for value in values]
    places = (np.arange(FINER) + 0.5) / FINER - 0.5
    for row in places:
        for column in places:
            moved = (
                value[at] + row * step.row[at] + column * step.column[at]
                for value, step in zip(values, slopes, strict=True)
            )
            yield Sight(*moved)
