"""The light that reaches every point of the current surface from near LEDs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.geometry import sampled_at
from splitknit.model import Array, BoolArray, FloatArray, Led, Rig, Shade

_UNIT_MM2 = 1e4
"""Irradiance of an LED is relative to a distance of 100 mm; the square cancels in the
normalisation. Source: definition."""


def light_vectors_at(rig: Rig, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Light vectors (L, 3, ...) at points in mm: direction towards the light times its relative
    irradiance.

    Near LEDs follow the inverse square of the distance and the cosine lobe about their axes. LEDs
    that share an exposure add. As in :meth:`splitknit.model.Rig.light_vectors`, the mean length at
    the origin is one.

    Parameters
    ----------
    rig : Rig
        Its L lights.
    x, y, z : arrays of one shape (...), mm
        Points in the rig's frame.

    Returns
    -------
    (L, 3, ...) float32
        Without a unit.
    """
    origin = np.zeros(1, dtype=np.float32)
    at_origin = np.stack([_sum(_alone(led), origin, origin, origin) for led in rig.leds]).astype(
        np.float64
    )
    scale = np.float32(1 / np.sqrt((at_origin**2).sum(axis=1)).mean())
    field = np.empty((len(rig.leds), 3, *z.shape), dtype=np.float32)
    for k, led in enumerate(rig.leds):
        np.multiply(_sum(led, x, y, z), scale, out=field[k])
    return field


_SIDE_DEG = (30.0, 45.0)
"""Bounds of the angle off the camera's axis beyond which a light stands to the side of a finger.
One more light at 38 deg beside a ring at 20 took the surface error of two fingers from 0.06 and
0.07 to 0.10 mm. Chosen on: simulated fingers (two)."""


_SIDE_RATIO = 1.5
"""Ratio of that angle to the sixth smallest angle, above which a light stands to the side. Chosen
on: simulated fingers (two)."""


def lights_in_front(rig: Rig) -> BoolArray:
    """(L,) whether each of the rig's lights stands in front of the finger, not to its side."""
    towards = rig.light_vectors()
    off_deg = np.degrees(
        np.arccos(np.clip(towards[:, 2] / np.linalg.norm(towards, axis=1), -1.0, 1.0))
    )
    # six lights stand all around
    limit = _SIDE_RATIO * np.sort(off_deg)[5] if len(off_deg) >= 6 else _SIDE_DEG[1]
    return np.asarray(off_deg <= np.clip(limit, *_SIDE_DEG))


def flat_promised(rig: Rig, shape: tuple[int, ...]) -> FloatArray:
    """(L, h, w) light that the rig casts on a flat matt surface in the finger plane: flat-field
    photographs are scaled to it."""
    _, rows, columns = shape
    step = rig.camera.image_size[1] / columns / rig.camera.px_per_mm
    x, y = np.meshgrid(np.arange(columns) - 0.5 * (columns - 1), 0.5 * (rows - 1) - np.arange(rows))
    x = (step * x).astype(np.float32)
    y = (step * y).astype(np.float32)
    return np.maximum(light_vectors_at(rig, x, y, np.zeros_like(x))[:, 2], 1e-3)


def _alone(led: Led) -> Led:
    """The LED without its images in mirrors, reaching everything."""
    companions = tuple(_alone(companion) for companion in led.also if not companion.reflected)
    return replace(led, shade=None, also=companions)


def _sum(led: Led, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Light vectors (3, ...) of all LEDs of an exposure."""
    total = _vectors(led, x, y, z)
    for companion in led.also:
        total = total + _sum(companion, x, y, z)
    return total


def _vectors(led: Led, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    result = np.empty((3, *z.shape), dtype=np.float32)
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        unit = (led.intensity * direction / np.linalg.norm(direction)).astype(np.float32)
        result[:] = unit.reshape(3, *(1,) * z.ndim)
        return result
    position = np.asarray(led.position_mm, dtype=np.float32)
    for axis, coordinate in enumerate((x, y, z)):
        np.subtract(position[axis], coordinate, out=result[axis])
    square = result[0] * result[0] + result[1] * result[1] + result[2] * result[2]
    distance = np.sqrt(square)
    strength = np.float32(led.intensity) * _UNIT_MM2 / (square * distance)
    if led.lobe_exponent > 0:
        axis_unit = -led.axis.astype(np.float32)
        cosine = (
            result[0] * axis_unit[0] + result[1] * axis_unit[1] + result[2] * axis_unit[2]
        ) / distance
        strength *= np.maximum(cosine, 0.0) ** np.float32(led.lobe_exponent)
    result *= strength if led.shade is None else strength * _fraction(led.shade, x, y, z)
    return result


def _fraction(shade: Shade, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Fraction of the light that reaches the places (x, y, z), of any shape."""
    if shade.apex_mm is not None:
        nearer = 1.0 - z / shade.apex_mm
        x = x / nearer
        y = y / nearer
    rows, columns = shade.fraction.shape

    def pixel(values: FloatArray, ends: tuple[float, float], count: int) -> FloatArray:
        first, last = ends
        return ((values - first) * ((count - 1) / (last - first))).astype(np.float32)

    column, row = np.broadcast_arrays(pixel(x, shade.x_mm, columns), pixel(y, shade.y_mm, rows))
    return sampled_at(shade.fraction, column, row)


def surface_array(surface_mm: Any, shape: tuple[int, int]) -> FloatArray:
    """`surface_mm` as (H, W) float32, a number spread over the image."""
    array = np.asarray(surface_mm, dtype=np.float32)
    require(
        array.ndim == 0 or array.shape == shape,
        f"surface_mm must be a number or have the shape {shape}, but it has the shape"
        f" {array.shape}.",
    )
    return np.broadcast_to(array, shape)


def few_lights(vectors: Array) -> list[Finding]:
    """A warning where three or four lights leave little redundancy, with the angle error that noise
    then causes: from the covariance s^2 (L'L)^-1 of normal times albedo, for a surface facing the
    camera. `vectors`: (L, 3), mean length one.
    """
    if len(vectors) > 4:
        return []
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    spread = np.linalg.inv(units.T @ units)
    tilt_deg = float(np.rad2deg(0.01 * np.sqrt(spread[0, 0] + spread[1, 1])))
    spare = (
        "one is spare, so that one shadow or highlight at a pixel shows, but not which light it"
        " is of"
    )
    if len(vectors) == 3:
        spare = "none is spare, so that shadows and highlights bend the surface unnoticed"
    return [
        Finding(
            "few-lights",
            f"{len(vectors)} lights, of which {spare}; "
            f"noise of 1 % in the images tilts normals by {tilt_deg:.1f} deg (rms, least squares)"
            ". Seven lights are a good number.",
        )
    ]
