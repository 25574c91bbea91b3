"""Light on and off the surface: near LEDs, Fresnel entry, microfacet reflection; Lambert's law for
opaque fingers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Camera, Led
from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit_simulator.camera.lens import px_per_mm_at, slopes_of_pixels
from splitknit_simulator.light.parameters import (
    LED_RADIUS_MM,
    MAX_FACET_AREA,
    MIN_VIEW_COSINE,
    SHADOW_MAX_SINE,
)
from splitknit_simulator.light.skin import fresnel
from splitknit_simulator.surface import SimulatedSurface

UNIT = 1e4
"""Square of the distance, in mm, at which an LED of intensity one gives the irradiance one. Source:
definition of an LED's intensity."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The surface inside the window, channels apart and contiguous, zero outside the mask."""

    window: tuple[slice, slice]
    mask: NDArray[np.bool_]
    x: FloatArray  # (1, w) mm; (h, w) for a perspective camera
    y: FloatArray  # (h, 1) mm; (h, w) for a perspective camera
    z: FloatArray
    nx: FloatArray
    ny: FloatArray
    nz: FloatArray
    # (h, w) each: unit vector towards a perspective camera; None = (0, 0, 1)
    view: tuple[FloatArray, FloatArray, FloatArray] | None
    nv: FloatArray  # cosine between the normal and the direction to the camera
    px_per_mm: float  # on the surface, at its mean distance
    # (h, w) each: rise towards the camera of the skin without ridges along x and along y (up)
    slopes: tuple[FloatArray, FloatArray]
    area: FloatArray  # (h, w) area of the skin's facets over that of the same skin without ridges
    # whether lights that stand low cast shadows of it on itself: seen directly, not in a mirror
    shadows: bool = False

    @property
    def pitch_mm(self) -> float:
        """Size of one pixel on the surface."""
        return 1.0 / self.px_per_mm


def finger_window(surface: SimulatedSurface) -> tuple[slice, slice]:
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


def cut_out(surface: SimulatedSurface, *, shadows: bool = False) -> Patch:
    """Return the part of `surface` inside its window."""
    window = finger_window(surface)
    mask = np.ascontiguousarray(surface.mask[window])
    z = np.where(mask, surface.height_mm[window], 0).astype(np.float32)
    nx, ny, nz = (np.ascontiguousarray(surface.normals[window][..., axis]) for axis in range(3))
    x, y = _places(surface, window)
    view, nv, px_per_mm = None, nz, surface.camera.px_per_mm
    smooth = surface.shape_normals[window]
    seen: Any = smooth[..., 2]
    tilt: Any = (np.float32(0.0), np.float32(0.0))
    if surface.camera.model == "perspective":
        up = surface.camera.height_mm - z
        inverse = 1.0 / np.sqrt(x * x + y * y + up * up)
        view = (-x * inverse, -y * inverse, up * inverse)
        nv = nx * view[0] + ny * view[1] + nz * view[2]
        px_per_mm = px_per_mm_at(surface.camera, float(z[mask].mean(dtype=np.float64)))
        seen, tilt = sum(smooth[..., axis] * view[axis] for axis in range(3)), view[:2]
    seen = np.maximum(seen, np.float32(MIN_VIEW_COSINE))
    slopes = tuple(
        np.where(mask, tilt[axis] - smooth[..., axis] / seen, 0).astype(np.float32)
        for axis in range(2)
    )
    area = np.where(
        mask, np.minimum(seen / np.maximum(nv, np.float32(MIN_VIEW_COSINE)), MAX_FACET_AREA), 1
    ).astype(np.float32)
    return Patch(
        window,
        mask,
        x,
        y,
        z,
        nx,
        ny,
        nz,
        view,
        nv,
        px_per_mm,
        (slopes[0], slopes[1]),
        area,
        shadows,
    )


def _places(
    surface: SimulatedSurface, window: tuple[slice, slice]
) -> tuple[FloatArray, FloatArray]:
    """x and y (mm) of the points that the pixels of the window show, zero beside the finger of a
    perspective camera."""
    if surface.x_mm is not None and surface.y_mm is not None:
        inside = surface.mask[window]
        x, y = (
            np.where(inside, place[window], 0).astype(np.float32)
            for place in (surface.x_mm, surface.y_mm)
        )
        return x, y
    height, width = surface.mask.shape
    pitch = surface.camera.pitch_mm
    rows, columns = (np.arange(part.start, part.stop, dtype=np.float64) for part in window)
    x, y = (columns - (width - 1) / 2) * pitch, ((height - 1) / 2 - rows) * pitch
    return x.astype(np.float32)[None, :], y.astype(np.float32)[:, None]


def white_card(camera: Camera, led: Led, z_mm: float = 0.0, step: int = 16) -> FloatArray:
    """(H, W) radiance of a white Lambertian card at height `z_mm`, facing upwards, evaluated every
    `step` pixels."""
    height, width = camera.image_size
    rows = np.linspace(0, height - 1, max(height // step, 2))
    columns = np.linspace(0, width - 1, max(width // step, 2))
    if camera.model == "perspective":
        x, y = (
            (camera.height_mm - z_mm) * s
            for s in slopes_of_pixels(camera, columns[None, :], rows[:, None])
        )
    else:
        x = ((columns - (width - 1) / 2) / camera.px_per_mm)[None, :]
        y = (((height - 1) / 2 - rows) / camera.px_per_mm)[:, None]
    points, up = (x, y, np.full((rows.size, columns.size), z_mm)), (0.0, 0.0, 1.0)
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


def light_on(
    patch: Patch, led: Led, roughness: float, led_radius_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Return the irradiance that enters the skin, and the radiance that its surface reflects to the
    camera, (h, w)."""
    entering, gloss = np.zeros((2, *patch.mask.shape), dtype=np.float32)
    for lamp in (led, *led.also):
        lx, ly, lz, strength = arriving(patch, lamp, led_radius_mm)
        cosine = np.maximum(lx * patch.nx + ly * patch.ny + lz * patch.nz, 0.0)
        entering += strength * cosine * (1.0 - fresnel(cosine))
        alpha = (
            roughness
            if lamp.position_mm is None
            else min(roughness + angular_size(lamp, led_radius_mm), 1.0)
        )
        gloss += strength * _ggx(patch, (lx, ly, lz), cosine, alpha)
    return entering, gloss


_NOTHING_MM = -1e3
"""Height beside the finger, far below every light's path. Source: definition."""


def arriving(
    patch: Patch, led: Led, radius_mm: float = LED_RADIUS_MM
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    """As :func:`towards` for the points of a patch, what shadows take of the light taken away.

    The way to a light that stands low is followed over the surface: where it is below it, the light
    is hidden, softly, as its face has a `radius_mm`.
    """
    lx, ly, lz, strength = towards(led, patch.x, patch.y, patch.z)
    if (
        not patch.shadows
        or led.position_mm is None
        or float(np.mean(lz[patch.mask])) > SHADOW_MAX_SINE
    ):
        return lx, ly, lz, strength
    flat = np.maximum(np.hypot(lx, ly), 1e-6)
    rows, columns = (np.asarray(axis, dtype=np.float32) for axis in np.indices(patch.z.shape))
    soft = radius_mm / float(np.linalg.norm(led.position_mm))
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
    return lx, ly, lz, strength * np.clip(seen, 0.0, 1.0)


def angular_size(led: Led, radius_mm: float) -> float:
    """By how much the face of a near LED widens its specular reflection, as a roughness."""
    return (
        0.0
        if led.position_mm is None
        else radius_mm / (2.0 * float(np.linalg.norm(led.position_mm)))
    )


def _ggx(
    patch: Patch,
    light: tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]],
    cosine: NDArray[np.floating],
    alpha: float,
) -> NDArray[np.floating]:
    """D G F / (4 n.v) towards the viewer; zero in the attached shadow."""
    lx, ly, lz = light
    # half vector between the light and the viewer: |l + v| = sqrt(2 + 2 l.v)
    vx, vy, vz = (np.float32(0), np.float32(0), np.float32(1)) if patch.view is None else patch.view
    lv = lz if patch.view is None else lx * vx + ly * vy + lz * vz
    inverse = 1.0 / np.sqrt(2.0 + 2.0 * lv)
    nh = np.clip(
        ((lx + vx) * patch.nx + (ly + vy) * patch.ny + (lz + vz) * patch.nz) * inverse, 0.0, 1.0
    )
    vh = (lv + 1.0) * inverse
    nv = np.clip(patch.nv, 1e-3, 1.0)
    squared = alpha * alpha
    below = nh * nh * (squared - 1.0) + 1.0
    distribution = squared / (np.pi * below * below)

    def unshadowed(c: NDArray[np.floating]) -> NDArray[np.floating]:
        return 2.0 * c / (c + np.sqrt(squared + (1.0 - squared) * c * c))

    shadowing = unshadowed(np.maximum(cosine, 1e-4)) * unshadowed(nv)
    lit = (cosine > 0.0) & patch.mask
    return np.where(lit, distribution * shadowing * fresnel(vh) / (4.0 * nv), 0.0)


def towards(
    led: Led, x: NDArray[np.floating], y: NDArray[np.floating], z: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    """Unit vector from each point to the light, and the irradiance of a surface that faces it."""
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        dx, dy, dz = (float(v) for v in direction / np.linalg.norm(direction))
        return (
            np.full_like(z, dx),
            np.full_like(z, dy),
            np.full_like(z, dz),
            np.full_like(z, led.intensity),
        )
    px, py, pz = led.position_mm
    lx, ly, lz = px - x, py - y, pz - z
    inverse = 1.0 / np.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
    strength = (led.intensity * UNIT) * inverse * inverse
    if led.lobe_exponent > 0.0:
        ax, ay, az = (-px, -py, -pz) if led.aim is None else led.aim
        length = float(np.sqrt(ax * ax + ay * ay + az * az))
        along = np.maximum(-(lx * ax + ly * ay + lz * az) / length, 0.0)
        strength = strength * along**led.lobe_exponent
    return lx, ly, lz, strength


def irradiance(
    led: Led, points: Sequence[Any] | NDArray[Any], normal: Sequence[Any] | NDArray[Any]
) -> NDArray[Any]:
    """Irradiance of a surface at x, y, z in mm (any shape) with the unit normal x, y, z,
    unshadowed."""
    x, y, z = points
    lx, ly, lz, strength = towards(led, x, y, z)
    return np.asarray(strength * np.maximum(lx * normal[0] + ly * normal[1] + lz * normal[2], 0.0))


# An opaque finger: matt as painted plaster, no light below the surface, no gloss.


def render_opaque(
    surface: SimulatedSurface, leds: Sequence[Led], albedo: float = 0.5
) -> tuple[tuple[slice, slice], FloatArray]:
    """Photograph a Lambertian finger of an albedo under each of L `leds`, without noise; what
    shares an exposure (`also`) adds.

    Returns the rows and columns of the finger in the frame, and (L, h, w) radiance in them, in the
    units of the rig's intensities; zero outside the finger. Attached shadows are black; cast
    shadows are not modelled (a finger pad casts none on itself but in its creases). J. H. Lambert,
    Photometria, 1760.
    """
    require(0.0 < albedo <= 1.0, f"the albedo must lie in (0, 1], but it is {albedo}.")
    patch = cut_out(surface)
    points, normals = (patch.x, patch.y, patch.z), (patch.nx, patch.ny, patch.nz)
    light = np.stack(
        [sum(irradiance(lamp, points, normals) for lamp in (led, *led.also)) for led in leds]
    )
    return patch.window, np.where(patch.mask, light * np.float32(albedo / np.pi), 0.0).astype(
        np.float32
    )
