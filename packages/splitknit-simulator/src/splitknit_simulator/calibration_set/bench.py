"""The bench: things under the rig to calibrate it, as the simulated camera sees and photographs
them.

A scene has a `camera`, its `leds`, and `light(lit)`: what reaches the sensor with those LEDs on.
See docs/explain/simulator.md, "The bench".
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import cv2
import numpy as np
from scipy.special import ndtr

from splitknit import Camera, Led
from splitknit.errors import require
from splitknit.model import Array, FloatArray, PixelArray
from splitknit.settings import Checked, Limits
from splitknit_simulator.camera.device import LitScene
from splitknit_simulator.camera.lens import (
    SightLines,
    blur_sigma_px,
    defocus,
    fall_off,
    pixels_of_points,
    px_per_mm_at,
    sight_lines,
)
from splitknit_simulator.camera.sensor import SensorSettings, binning_scale, record
from splitknit_simulator.light.lighting import irradiance
from splitknit_simulator.surface import Window


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFrame:
    """A flat thing: its middle, and its own axes u (right), v (up) and n (towards the viewer) in
    the rig's frame."""

    middle: Array  # (3,) mm
    axes: Array  # (3, 3): the columns are u, v and n

    def hit(self, sight: SightLines) -> tuple[Array, Array, Array]:
        """u and v at which the lines of sight meet the plane, and the height z there, (h, w)
        each."""
        normal = self.axes[:, 2]
        steepness = sight.along(*normal)
        require(
            float(steepness.min()) > 0.05,
            "the camera sees the plane edge-on or from behind; tilt it less than 80 deg.",
        )
        z = (float(normal @ self.middle) - normal[0] * sight.x - normal[1] * sight.y) / steepness
        u, v, _ = np.moveaxis(self.own(np.stack(sight.at(z), axis=-1)), -1, 0)
        return u, v, z

    def points(self, u: Any, v: Any, w: Any = 0.0) -> Array:
        """Points (..., 3) of the rig's frame at u, v and w above the plane, all in mm."""
        own = np.stack(
            np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (u, v, w))), axis=-1
        )
        return own @ self.axes.T + self.middle

    def own(self, points: Any) -> Array:
        """Points (..., 3) of the rig's frame in the plane's own u, v and height above it: inverse
        of :meth:`points`."""
        return (np.asarray(points, dtype=np.float64) - self.middle) @ self.axes


def facing_plane(rotation_vector: Any, middle_mm: Any) -> PlaneFrame:
    """Return a plane that faces the camera, turned by `rotation_vector` (rad, right-handed) about
    `middle_mm`."""
    rotation, middle = (
        np.asarray(vector, dtype=np.float64) for vector in (rotation_vector, middle_mm)
    )
    return PlaneFrame(middle, np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64))


def base_plane(tilt_deg: tuple[float, float], height_mm: float = 0.0) -> PlaneFrame:
    """Return the rig's base at `height_mm`, turned by two small angles about x and y."""
    return facing_plane((*np.deg2rad(tilt_deg), 0.0), (0.0, 0.0, height_mm))


def steps(length: Array) -> tuple[Array, Array]:
    """How far a length (h, w) on the ground moves from row to row and from column to column."""
    row, column = np.gradient(length)
    return np.asarray(row), np.asarray(column)


def edge_coverage(
    distance: Array, step: tuple[Array, Array] | None = None, blur: float = 0.0
) -> Array:
    """Fraction of each pixel that lies inside a straight edge, whose `distance` (h, w) inwards from
    the pixel's middle is given, with its :func:`steps` where it was measured, and the standard
    deviation `blur` of the edge itself in its unit.

    The edge is averaged over the square pixel: the longer of the pixel's two steps exactly and the
    shorter one as a Gaussian of the same variance, so that edges along rows or columns are exact.
    """
    row, column = np.abs(step or steps(distance))
    half = np.maximum(np.maximum(column, row), 1e-9) / 2.0
    spread = np.sqrt(np.minimum(column, row) ** 2 / 12.0 + blur * blur + (1e-4 * half) ** 2)
    fraction = np.asarray(distance > 0.0, dtype=np.float64)
    near = np.abs(distance) < half + 6.0 * spread
    distance, half, spread = distance[near], half[near], spread[near]
    fraction[near] = (_ramp(distance + half, spread) - _ramp(distance - half, spread)) / (
        2.0 * half
    )
    return fraction


def _ramp(distance: Array, spread: Array) -> Array:
    """Integral of the normal distribution function."""
    along = distance / spread
    return np.asarray(
        distance * ndtr(along) + spread * np.exp(-0.5 * along * along) / np.sqrt(2.0 * np.pi)
    )


def seen_at(camera: Camera, points: Array) -> Array:
    """Column and row (..., 2) at which points (..., 3) of the rig's frame appear, in the picture or
    outside it."""
    return np.stack(pixels_of_points(camera, *np.moveaxis(points, -1, 0)), axis=-1)


# What all scenes share: LEDs, ambient light, focus, and a flat ground that they light.


@dataclass(frozen=True, slots=True)
class BenchSettings(Checked):
    """What surrounds the things that are photographed."""

    ambient: Annotated[float, Limits(0.0, 1.0)] = 0.002
    """Ambient light: radiance of a white card relative to the same card at the origin under one LED
    (mean of all)."""
    led_radius_mm: Annotated[float, Limits(0.0, 10.0)] = 1.5
    """Radius of the LEDs' bright faces: a 5 mm LED's die and cup fill about 3 mm of its lens."""
    aperture_mm: Annotated[float, Limits(0.0, 20.0)] = 0.0
    """Diameter of the camera's pupil; 0 is a pinhole, sharp at every depth."""
    focus_mm: Annotated[float, Limits(-50.0, 50.0)] = 0.0
    """Height above the finger plane that is in focus."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundScene(ABC):
    """A flat ground in front of the camera; its kinds define where it lies and how bright it is."""

    camera: Camera
    leds: tuple[Led, ...]
    bench: BenchSettings = field(default_factory=BenchSettings)

    @property
    @abstractmethod
    def plane(self) -> PlaneFrame:
        """Where the ground lies."""

    @abstractmethod
    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w) at u and v (mm on the plane), averaged over a pixel."""

    def fraction_lit(self, led: Led) -> Array | float:
        """Fraction (H, W) of the LED that the ground sees past what stands on it."""
        return 1.0

    def light(self, lit: Sequence[int]) -> FloatArray:
        """Noise-free linear light (H, W, 3) at the sensor with the LEDs `lit` on, the lens's
        fall-off included.

        White-balanced, in the rig's units: a facing white card 100 mm from an LED of intensity one
        is 1/pi. Raises BadInput if `lit` names an LED that the rig does not have.
        """
        grey = self._grey(tuple(_switched_on(self.leds, lit)))
        image = np.repeat(grey.astype(np.float32)[..., None], 3, axis=2)
        if self.bench.aperture_mm > 0.0:
            image = defocus(image, self._blur)
        return np.asarray(image * self._fall_off[..., None], dtype=np.float32)

    def _grey(self, leds: tuple[Led, ...]) -> Array:
        """(H, W) radiance before lens and sensor."""
        received = np.zeros(self.camera.image_size)
        for led in leds:
            received += irradiance(led, self._points, self.plane.axes[:, 2]) * self.fraction_lit(
                led
            )
        return self.albedo(*self._hit[:2]) * (received / np.pi + self.ambient_light)

    @property
    def ambient_light(self) -> float:
        """Radiance of a white surface with all LEDs off."""
        return self.bench.ambient * float(np.mean([card_radiance(led) for led in self.leds]))

    def pixels_between(self, low: Array, high: Array) -> Window | None:
        """Rows and columns that see the ground between two (u, v), with six pixels to spare; None
        if none do."""
        spare = 6.0 / self.camera.px_per_mm
        u, v, _ = self._hit
        near = (
            (u > low[0] - spare)
            & (u < high[0] + spare)
            & (v > low[1] - spare)
            & (v < high[1] + spare)
        )
        rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        if rows.size < 2 or columns.size < 2:
            return None
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)

    @cached_property
    def _sight(self) -> SightLines:
        rows, columns = map(np.arange, self.camera.image_size)
        return sight_lines(self.camera, columns[None, :], rows[:, None])

    @cached_property
    def _hit(self) -> tuple[Array, Array, Array]:
        return self.plane.hit(self._sight)

    @cached_property
    def _points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, z = (axis.astype(np.float32) for axis in self._sight.at(self._hit[2]))
        return x, y, z

    @cached_property
    def _fall_off(self) -> FloatArray:
        return fall_off(self.camera)

    @cached_property
    def _blur(self) -> FloatArray:
        camera, depth, focus = self.camera, self._depth.astype(np.float32), self.bench.focus_mm
        return blur_sigma_px(
            depth, focus, camera.height_mm, self.bench.aperture_mm, px_per_mm_at(camera, focus)
        )

    @property
    def _depth(self) -> Array:
        """(H, W) height z of what each pixel sees: of the ground, or of what stands on it."""
        return self._hit[2]


@dataclass(frozen=True, eq=False, kw_only=True)
class BaseScene(GroundScene):
    """The rig's base and what lies or stands on it."""

    # tilt of the base against the camera, about x, then y
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def plane(self) -> PlaneFrame:
        """Where the base lies."""
        return base_plane(self.tilt_deg)


def _switched_on(leds: Sequence[Led], lit: Sequence[int]) -> Iterator[Led]:
    for index in lit:
        require(
            0 <= index < len(leds),
            f"LED {index} is not in the rig, which has {len(leds)} LEDs (0 to {len(leds) - 1}).",
        )
        yield leds[index]
        yield from leds[index].also


def card_radiance(led: Led) -> float:
    """Radiance of a white card at the origin that faces the camera."""
    origin = (np.zeros(1, np.float32),) * 3
    return float(irradiance(led, origin, np.array([0.0, 0.0, 1.0]))[0]) / np.pi


def well_exposed(scene: LitScene, lit: Sequence[Sequence[int]], level: float = 0.7) -> float:
    """Exposure at which the 99.9th percentile of the brightest of some images is at `level` of full
    scale."""
    brightest = max(float(np.percentile(scene.light(leds)[::4, ::4], 99.9)) for leds in lit)
    require(brightest > 0.0, "exposing needs some light, but all images are black.")
    return level / brightest


def photograph_bench(
    scene: LitScene,
    lit: Sequence[int],
    seed: int | np.random.SeedSequence,
    *,
    exposure: float,
    sensor: SensorSettings | None = None,
    band: str = "white",
) -> PixelArray:
    """Photograph a scene, (H, W, 3) uint8 or uint16, with the LEDs `lit` on; `sensor.exposure` is
    not used.

    `exposure`: full scales per unit of light, see :func:`well_exposed`; `band`: how the sensor
    responds. Raises BadInput if `exposure`, `band` or `lit` cannot be.
    """
    seeds = (
        seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence([seed, 0xB2])
    )
    light = scene.light(lit) * np.float32(exposure)
    return record(light, band, seeds, sensor, binning_scale(scene.camera))
