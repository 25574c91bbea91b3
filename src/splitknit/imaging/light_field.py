"""The light that reaches every point of the current surface from near LEDs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import sampled_at
from splitknit.imaging.view import View, view_of
from splitknit.model import Camera, FloatArray, Led, Rig, Shade

_UNIT_MM2 = np.float32(1e4)
"""Irradiance of an LED is relative to a distance of 100 mm (it cancels in the normalisation)."""
FEW_LIGHTS = 4
"""So many lights, or fewer, are warned of."""


def seen_from(camera: Camera, shape: tuple[int, int], x_mm: Any, y_mm: Any, view: View | None = None) -> View:
    """View of an image of `shape`: as given, by the axes given, else by the camera."""
    if view is not None:
        pixels = np.broadcast_shapes(*(axis.shape for axis in view.on_plane()))
        require(pixels == shape, f"the view is of {pixels} pixels, but the images have {shape}.")
        return view
    apex = camera.height_mm if camera.model == "perspective" else None
    require((x_mm is None) == (y_mm is None), "x_mm and y_mm must be given together.")
    if x_mm is not None:
        x, y = np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64)
        require(
            x.shape == (shape[1],) and y.shape == (shape[0],),
            f"x_mm and y_mm must have the lengths {shape[1]} and {shape[0]}, but they have {x.shape} and {y.shape}.",
        )
        require(bool(np.isfinite(x).all() and np.isfinite(y).all()), "x_mm or y_mm contains NaN or infinite values.")
        return View(x, y, apex)
    require(
        tuple(camera.image_size) == shape,
        f"the rig's camera takes images of {tuple(camera.image_size)} pixels, but the stack's have {shape}; "
        "give x_mm and y_mm for a part of the image.",
    )
    return view_of(camera)


def light_vectors_at(rig: Rig, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Light vectors (L, 3, ...) at points in mm: direction towards the light times its relative irradiance.

    Near LEDs follow the inverse square of the distance and the cosine lobe about their axes. LEDs
    that share an exposure add. As in :meth:`splitknit.model.Rig.light_vectors`, the mean length at the origin is one.

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
    at_origin = np.stack([_sum(_alone(led), origin, origin, origin) for led in rig.leds]).astype(np.float64)
    scale = np.float32(1 / np.sqrt((at_origin**2).sum(axis=1)).mean())
    field = np.empty((len(rig.leds), 3, *z.shape), dtype=np.float32)
    for k, led in enumerate(rig.leds):
        np.multiply(_sum(led, x, y, z), scale, out=field[k])
    return field


def flat_promised(rig: Rig, shape: tuple[int, ...]) -> FloatArray:
    """(L, h, w) light of a flat matt surface in the finger plane by the rig's lights, on a grid over the image.

    Images over flat photographs over this are those that the rig's lights would give.
    """
    _, rows, columns = shape
    step = rig.camera.image_size[1] / columns / rig.camera.px_per_mm
    x, y = np.meshgrid(np.arange(columns) - 0.5 * (columns - 1), 0.5 * (rows - 1) - np.arange(rows))
    x, y = (step * x).astype(np.float32), (step * y).astype(np.float32)
    return np.maximum(light_vectors_at(rig, x, y, np.zeros_like(x))[:, 2], np.float32(1e-3))


def _alone(led: Led) -> Led:
    """An exposure's light without images in mirrors and without shadows."""
    if led.shade is None and not any(other.reflected for other in led.also):
        return led
    return replace(led, shade=None, also=tuple(_alone(other) for other in led.also if not other.reflected))


def _sum(led: Led, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    total = _one(led, x, y, z)
    for other in led.also:
        total = total + _sum(other, x, y, z)
    return total


def _one(led: Led, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    result = np.empty((3, *z.shape), dtype=np.float32)
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        unit = (led.intensity * direction / np.linalg.norm(direction)).astype(np.float32)
        for axis in range(3):
            result[axis] = unit[axis]
        return result
    position = np.asarray(led.position_mm, dtype=np.float32)
    for axis, coordinate in enumerate((x, y, z)):
        np.subtract(position[axis], coordinate, out=result[axis])
    square = result[0] * result[0] + result[1] * result[1] + result[2] * result[2]
    distance = np.sqrt(square)
    strength = np.float32(led.intensity) * _UNIT_MM2 / (square * distance)
    if led.lobe_exponent > 0:
        axis_unit = -led.axis.astype(np.float32)
        cosine = (result[0] * axis_unit[0] + result[1] * axis_unit[1] + result[2] * axis_unit[2]) / distance
        strength *= np.maximum(cosine, np.float32(0.0)) ** np.float32(led.lobe_exponent)
    result *= strength if led.shade is None else strength * _fraction(led.shade, x, y)
    return result


def _fraction(shade: Shade, x: FloatArray, y: FloatArray) -> FloatArray:
    """Fraction of the light that reaches the places (x, y), of any shape."""
    rows, columns = shade.fraction.shape
    places = []
    for values, (first, last), count in ((x, shade.x_mm, columns), (y, shade.y_mm, rows)):
        places.append(((np.asarray(values) - first) * ((count - 1) / (last - first))).astype(np.float32))
    column, row = np.broadcast_arrays(*places)
    return sampled_at(shade.fraction, column, row)


def surface_array(surface_mm: Any, shape: tuple[int, int]) -> FloatArray:
    """`surface_mm` as (H, W) float32, a number spread over the image."""
    array = np.asarray(surface_mm, dtype=np.float32)
    require(
        array.ndim == 0 or array.shape == shape,
        f"surface_mm must be a number or have the shape {shape}, but it has the shape {array.shape}.",
    )
    return np.broadcast_to(array, shape)


def few_lights(vectors: NDArray[np.float64]) -> list[str]:
    """A warning where three or four lights leave little to check, with the error that noise then causes.

    Least squares give the normal times the albedo with the covariance s^2 (L'L)^-1 of noise s in the images: for a
    surface that faces the camera, its x and y parts are the normal's tilt. `vectors`: (L, 3) light vectors, the mean
    length one.
    """
    if len(vectors) > FEW_LIGHTS:
        return []
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    spread = np.linalg.inv(units.T @ units)
    tilt_deg = float(np.rad2deg(0.01 * np.sqrt(spread[0, 0] + spread[1, 1])))
    lack = (
        "none is spare, so that shadows and highlights bend the surface unnoticed"
        if len(vectors) == 3
        else ("one is spare, so that one shadow or highlight at a pixel shows, but not which light it is of")
    )
    return [
        f"{len(vectors)} lights, of which {lack}; noise of 1 % in the images tilts "
        f"normals by {tilt_deg:.1f} deg (rms, least squares). Seven lights are a good number."
    ]
