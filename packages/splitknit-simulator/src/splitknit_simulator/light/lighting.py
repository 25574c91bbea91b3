"""Light on and off the surface: near LEDs, Fresnel entry, microfacet reflection; Lambert's law for
opaque fingers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Camera, Led
from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit_simulator.camera.lens import px_per_mm_at, sight_lines
from splitknit_simulator.light.skin import REFRACTIVE_INDEX, fresnel
from splitknit_simulator.surface import SimulatedSurface, Window

UNIT = 1e4
"""Square of the distance, in mm, at which an LED of intensity one gives the irradiance one. Source:
definition of an LED's intensity."""


Vectors = Any
"""x, y and z: arrays or numbers that broadcast together."""


def dot(a: Vectors, b: Vectors) -> Any:
    """Inner products of vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The surface inside the window, channels apart and contiguous, zero outside the mask."""

    window: Window
    mask: BoolArray
    x: FloatArray  # (h, w) mm
    y: FloatArray
    z: FloatArray
    normal: Vectors  # (h, w) each
    view: Vectors  # (h, w) each: unit vector towards the camera
    nv: FloatArray  # cosine between the normal and the direction to the camera
    px_per_mm: float  # on the surface, at its mean distance
    # (h, w) each: rise towards the camera of the skin without ridges along x and along y (up)
    slopes: tuple[FloatArray, FloatArray]
    area: FloatArray  # (h, w) area of the skin's facets over that of the same skin without ridges
    # whether lights that stand low cast shadows of it on itself: seen directly, not in a mirror
    shadows: bool = False

    @property
    def points(self) -> Vectors:
        """x, y and z (mm)."""
        return self.x, self.y, self.z

    @property
    def pitch_mm(self) -> float:
        """Size of one pixel on the surface."""
        return 1.0 / self.px_per_mm


def finger_window(surface: SimulatedSurface) -> Window:
    """Rows and columns of the finger's bounding box, eight pixels wider each way inside the
    frame."""
    lines = [np.flatnonzero(surface.mask.any(axis=axis)) for axis in (1, 0)]
    require(
        lines[0].size > 0, "the simulated finger is outside the picture; move it into the frame."
    )
    rows, columns = (
        slice(max(int(line[0]) - 8, 0), min(int(line[-1]) + 9, length))
        for line, length in zip(lines, surface.mask.shape, strict=True)
    )
    return rows, columns


_MIN_VIEW_COSINE = 0.12
"""Between a facet and the direction to the camera: pixels do not resolve facets that lean away
further."""


def cut_out(surface: SimulatedSurface, *, shadows: bool = False) -> Patch:
    """Return the part of `surface` inside its window."""
    window = finger_window(surface)
    mask = np.ascontiguousarray(surface.mask[window])
    z = np.where(mask, surface.height_mm[window], 0).astype(np.float32)
    normal: Vectors = tuple(np.moveaxis(surface.normals[window], -1, 0).copy())
    sight = surface.sight(window)
    x, y = (np.asarray(place, dtype=np.float32) for place in sight.at(z)[:2])
    view: Vectors = tuple(np.moveaxis(sight.towards_camera.astype(np.float32), -1, 0).copy())
    nv = dot(normal, view)
    px_per_mm = px_per_mm_at(surface.camera, float(z[mask].mean(dtype=np.float64)))
    smooth: Vectors = tuple(np.moveaxis(surface.shape_normals[window], -1, 0))
    seen = np.maximum(dot(smooth, view), np.float32(_MIN_VIEW_COSINE))
    slopes = tuple(
        np.where(mask, view[axis] - smooth[axis] / seen, 0).astype(np.float32) for axis in range(2)
    )
    # facets larger than three times the smooth skin are walls of pores, a small part of their pixel
    area = np.where(
        mask, np.minimum(seen / np.maximum(nv, np.float32(_MIN_VIEW_COSINE)), 3.0), 1
    ).astype(np.float32)
    return Patch(
        window,
        mask,
        x,
        y,
        z,
        normal,
        view,
        nv,
        px_per_mm,
        (slopes[0], slopes[1]),
        area,
        shadows,
    )


def white_card(camera: Camera, led: Led, z_mm: float = 0.0, step: int = 16) -> FloatArray:
    """(H, W) radiance of a white Lambertian card at height `z_mm`, facing upwards, evaluated every
    `step` pixels."""
    height, width = camera.image_size
    rows = np.linspace(0, height - 1, max(height // step, 2))
    columns = np.linspace(0, width - 1, max(width // step, 2))
    points = sight_lines(camera, columns[None, :], rows[:, None]).at(z_mm)
    up = (0.0, 0.0, 1.0)
    total = np.sum([irradiance(lamp, points, up) for lamp in (led, *led.also)], axis=0)
    # bilinear between the centres of the coarse grid, which include the frame's corners
    at = np.linspace(0, rows.size - 1, height)[:, None], np.linspace(0, columns.size - 1, width)
    low_row, low_column = (
        np.minimum(a.astype(np.intp), n - 2) for a, n in zip(at, total.shape, strict=True)
    )
    down, right = at[0] - low_row, at[1] - low_column
    tall = (total[low_row[:, 0]] * (1.0 - down) + total[low_row[:, 0] + 1] * down) / np.pi
    return np.asarray(
        tall[:, low_column] * (1.0 - right) + tall[:, low_column + 1] * right, dtype=np.float32
    )


def light_on(patch: Patch, led: Led, roughness: float) -> tuple[FloatArray, FloatArray]:
    """Return the irradiance that enters the skin, and the radiance that its surface reflects to the
    camera, (h, w)."""
    entering, gloss = np.zeros((2, *patch.mask.shape), dtype=np.float32)
    for lamp in (led, *led.also):
        light, strength = arriving(patch, lamp)
        cosine = np.maximum(dot(light, patch.normal), 0.0)
        entering += strength * cosine * (1.0 - fresnel(cosine))
        alpha = roughness if lamp.position_mm is None else min(roughness + angular_size(lamp), 1.0)
        gloss += strength * reflected(patch.normal, light, patch.view, alpha)
    return entering, gloss


_NOTHING_MM = -1e3
"""Height beside the finger, far below every light's path. Source: definition."""
LED_RADIUS_MM = 1.5  # of the emitting face, which widens the specular reflection


def arriving(patch: Patch, led: Led) -> tuple[Vectors, FloatArray]:
    """As :func:`towards` for the points of a patch, what shadows take of the light taken away.

    The way to a light that stands low is followed over the surface: where it is below it, the light
    is hidden, softly, as its face has a radius.
    """
    light, strength = towards(led, patch.points)
    lx, ly, lz = light
    # the ring's lights stand higher and would cast shadows only in creases
    if not patch.shadows or led.position_mm is None or float(np.mean(lz[patch.mask])) > 0.7:
        return light, strength
    flat = np.maximum(np.hypot(lx, ly), 1e-6)
    rows, columns = (np.asarray(axis, dtype=np.float32) for axis in np.indices(patch.z.shape))
    soft = LED_RADIUS_MM / float(np.linalg.norm(led.position_mm))
    most = (float(patch.z.max()) - float(patch.z[patch.mask].min())) / max(
        float((lz / flat)[patch.mask].min()), 0.05
    )
    seen, far = np.ones(patch.z.shape, dtype=np.float32), 1.0
    # beside the finger nothing stands in the way
    solid = np.where(patch.mask, patch.z, np.float32(_NOTHING_MM))
    while far < min(most * patch.px_per_mm, max(patch.z.shape)):
        at = (
            (columns + far * lx / flat).astype(np.float32),
            (rows - far * ly / flat).astype(np.float32),
        )
        higher = cv2.remap(
            solid, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_NOTHING_MM
        )
        away_mm = far * patch.pitch_mm
        np.minimum(
            seen, 0.5 - (higher - patch.z - away_mm * lz / flat) / (2.0 * soft * away_mm), out=seen
        )
        far += max(1.0, 0.08 * far)
    return light, strength * np.clip(seen, 0.0, 1.0)


def angular_size(led: Led) -> float:
    """By how much the face of a near LED widens its specular reflection, as a roughness."""
    return (
        0.0
        if led.position_mm is None
        else LED_RADIUS_MM / (2.0 * float(np.linalg.norm(led.position_mm)))
    )


# Light that a surface with two roughnesses reflects: GGX microfacets, anisotropic, pixel by pixel.


def reflected(
    normal: Vectors,
    light: Vectors,
    view: Vectors,
    across: FloatArray | float,
    *,
    index: float = REFRACTIVE_INDEX,
    along: Vectors | None = None,
    roughness_along: FloatArray | float | None = None,
) -> FloatArray:
    """(h, w) radiance towards `view` per unit of irradiance that a surface facing the light
    receives: D G F / (4 n.v).

    Vectors are three (h, w) arrays, unit, out of the surface; the GGX alpha is `across` across
    `along` and everywhere where there is no direction, and `roughness_along` along it. Walter et
    al. 2007, equations (20), (33), (34); Burley 2012 and Heitz 2014, equations (85) and (86), for
    two roughnesses.
    """
    nl, nv = dot(normal, light), np.clip(dot(normal, view), 1e-3, 1.0)
    lv = dot(light, view)
    inverse = 1.0 / np.sqrt(np.maximum(2.0 + 2.0 * lv, 1e-6))
    half = tuple(
        (to_light + to_view) * inverse for to_light, to_view in zip(light, view, strict=True)
    )
    nh = np.clip(dot(normal, half), 0.0, 1.0)
    lit = nl > 0.0
    nl = np.maximum(nl, 1e-4)
    first = across if along is None or roughness_along is None else roughness_along

    def squashed(direction: Vectors, cosine: FloatArray, power: int) -> FloatArray:
        """Sum of the squared tangential parts of a direction, times (or over) the squared
        roughnesses."""
        sine = np.maximum(1.0 - cosine * cosine, 0.0)
        part = (
            np.zeros_like(sine) if along is None else np.minimum(dot(along, direction) ** 2, sine)
        )
        first2, across2 = np.square(first), np.square(across)
        rest = sine - part
        return np.asarray(
            part * first2 + rest * across2 if power > 0 else part / first2 + rest / across2
        )

    below = squashed(half, nh, -1) + nh * nh
    distribution = 1.0 / (np.pi * first * across * below * below)

    def unshadowed(direction: Vectors, cosine: FloatArray) -> FloatArray:
        return 2.0 / (1.0 + np.sqrt(1.0 + squashed(direction, cosine, 1) / (cosine * cosine)))

    shadowing = unshadowed(light, nl) * unshadowed(view, nv)
    mirror = fresnel((lv + 1.0) * inverse, index)
    return np.where(lit, distribution * shadowing * mirror / (4.0 * nv), 0.0)


def towards(led: Led, points: Vectors) -> tuple[Vectors, FloatArray]:
    """Unit vector from each point (mm) to the light, and the irradiance of a surface that faces
    it."""
    x, y, z = points
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        dx, dy, dz = (np.full_like(z, v) for v in direction / np.linalg.norm(direction))
        return (dx, dy, dz), np.full_like(z, led.intensity)
    px, py, pz = led.position_mm
    lx, ly, lz = px - x, py - y, pz - z
    inverse = 1.0 / np.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
    strength = (led.intensity * UNIT) * inverse * inverse
    if led.lobe_exponent > 0.0:
        ax, ay, az = (-px, -py, -pz) if led.aim is None else led.aim
        length = float(np.sqrt(ax * ax + ay * ay + az * az))
        along = np.maximum(-dot((lx, ly, lz), (ax, ay, az)) / length, 0.0)
        strength = strength * along**led.lobe_exponent
    return (lx, ly, lz), strength


def irradiance(led: Led, points: Any, normal: Any) -> NDArray[Any]:
    """Irradiance of a surface at x, y, z in mm (any shape) with the unit normal x, y, z,
    unshadowed."""
    light, strength = towards(led, points)
    return np.asarray(strength * np.maximum(dot(light, normal), 0.0))
