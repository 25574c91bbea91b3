"""What all scenes of the bench share: LEDs, room light, focus, and a flat ground that they light."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Camera, FloatArray, Led
from splitknit.simulator.bench_sight import Array, Plane, Sight, sight
from splitknit.simulator.defocus import blur_sigma_px, defocus
from splitknit.simulator.lens import fall_off, px_per_mm_at
from splitknit.simulator.lighting import towards

Window = tuple[slice, slice]
"""Rows and columns."""


@dataclass(frozen=True, slots=True)
class BenchSettings:
    """What surrounds the things that are photographed."""

    ambient: float = 0.002
    """Room light: radiance of a white card relative to the same card at the origin under one LED (mean of all)."""
    led_radius_mm: float = 1.5
    """Radius of the LEDs' bright faces: a 5 mm LED's die and cup fill about 3 mm of its lens."""
    aperture_mm: float = 0.0
    """Diameter of the camera's pupil; 0 is a pinhole, sharp at every depth."""
    focus_mm: float = 0.0
    """z of the plane in focus."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("ambient", 0.0, 1.0),
            ("led_radius_mm", 0.0, 10.0),
            ("aperture_mm", 0.0, 20.0),
            ("focus_mm", -50.0, 50.0),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"bench.{name} must lie between {low} and {high}, but it is {value}.",
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundScene(ABC):
    """A flat ground in front of the camera; its kinds say where it lies and how bright it is."""

    camera: Camera
    leds: tuple[Led, ...]
    bench: BenchSettings = field(default_factory=BenchSettings)

    def __post_init__(self) -> None:
        require(len(self.leds) > 0, "a scene needs at least one LED.")

    @property
    @abstractmethod
    def plane(self) -> Plane:
        """Where the ground lies."""

    @abstractmethod
    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w) at u and v (mm on the plane), averaged over a pixel."""

    def share_lit(self, led: Led) -> Array | float:
        """Share (H, W) of the LED that the ground sees past what stands on it."""
        return 1.0

    def light(self, lit: Sequence[int]) -> FloatArray:
        """Noise-free linear light at the sensor with some LEDs on.

        Parameters
        ----------
        lit : indices of LEDs; none gives the room light alone

        Returns
        -------
        (H, W, 3) float32, white-balanced, in the rig's units (a facing white card 100 mm from an LED of intensity one
        is 1/pi), the lens's fall-off included

        Raises
        ------
        BadInput
            If `lit` names an LED that the rig does not have.
        """
        grey = self._grey(tuple(switched_on(self.leds, lit)))
        image = np.repeat(grey.astype(np.float32)[..., None], 3, axis=2)
        if self.bench.aperture_mm > 0.0:
            image = defocus(image, self._blur)
        return np.asarray(image * self._fall_off[..., None], dtype=np.float32)

    def _grey(self, leds: tuple[Led, ...]) -> Array:
        """(H, W) radiance before lens and sensor."""
        received = np.zeros(self.camera.image_size)
        x, y, z = self._points
        for led in leds:
            received += irradiance(led, (x, y, z), self.plane.axes[:, 2]) * self.share_lit(led)
        return np.asarray(self._albedo * (received / np.pi + self.room_light))

    @property
    def room_light(self) -> float:
        """Radiance of a white surface with all LEDs off."""
        return self.bench.ambient * float(np.mean([card_radiance(led) for led in self.leds]))

    def pixels_between(self, low: Array, high: Array) -> Window | None:
        """Rows and columns that see the ground between two (u, v), with six pixels to spare; None if none do."""
        spare = 6.0 / self.camera.px_per_mm
        u, v, _ = self._hit
        near = (u > low[0] - spare) & (u < high[0] + spare) & (v > low[1] - spare) & (v < high[1] + spare)
        rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        if rows.size < 2 or columns.size < 2:
            return None
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)

    @cached_property
    def _sight(self) -> Sight:
        return sight(self.camera)

    @cached_property
    def _hit(self) -> tuple[Array, Array, Array]:
        return self.plane.hit(self._sight)

    @cached_property
    def _points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        z = self._hit[2]
        lines = self._sight
        x, y = lines.x - lines.slope_x * z, lines.y - lines.slope_y * z
        return x.astype(np.float32), y.astype(np.float32), z.astype(np.float32)

    @cached_property
    def _albedo(self) -> Array:
        return self.albedo(self._hit[0], self._hit[1])

    @cached_property
    def _fall_off(self) -> FloatArray:
        return fall_off(self.camera)

    @cached_property
    def _blur(self) -> FloatArray:
        camera, bench = self.camera, self.bench
        pitch = px_per_mm_at(camera, bench.focus_mm)
        return blur_sigma_px(self._depth.astype(np.float32), bench.focus_mm, camera.height_mm, bench.aperture_mm, pitch)

    @property
    def _depth(self) -> Array:
        """(H, W) height z of what each pixel sees."""
        return self._hit[2]


def switched_on(leds: Sequence[Led], lit: Sequence[int]) -> Iterator[Led]:
    """Every single LED that the indices `lit` switch on."""
    for index in lit:
        require(
            0 <= index < len(leds), f"LED {index} is not in the rig, which has {len(leds)} LEDs (0 to {len(leds) - 1})."
        )
        yield leds[index]
        yield from leds[index].also


def irradiance(led: Led, points: Sequence[Array | FloatArray] | Array, normal: Sequence[Array] | Array) -> Array:
    """Irradiance (h, w) of a surface at x, y, z (h, w) in mm with the unit normal (or normals: x, y, z), unshadowed."""
    x, y, z = (np.asarray(axis, dtype=np.float32) for axis in points)
    lx, ly, lz, strength = towards(led, x, y, z)
    cosine = lx * normal[0] + ly * normal[1] + lz * normal[2]
    return np.asarray(strength * np.maximum(cosine, 0.0), dtype=np.float64)


def card_radiance(led: Led) -> float:
    """Radiance of a white card at the origin that faces the camera."""
    origin = (np.zeros(1, np.float32),) * 3
    return float(irradiance(led, origin, np.array([0.0, 0.0, 1.0]))[0]) / np.pi


def positions_of(leds: Sequence[Led], what: str) -> NDArray[np.float64]:
    """(L, 3) positions in mm of LEDs that all have one, or BadInput: `what` needs them."""
    for index, led in enumerate(leds):
        require(led.position_mm is not None, f"{what} needs LEDs with positions, but LED {index} is distant light.")
    return np.array([led.position_mm for led in leds], dtype=np.float64)


def disc_points(led: Led, radius_mm: float) -> NDArray[np.float64]:
    """(N, 3) points in mm that stand for equal parts of an LED's bright face: its middle and rings of 6 and of 12.

    Each ring has the mean squared radius of its part of the disc, so that the points have the disc's own spread.
    """
    middle = np.asarray(led.position_mm, dtype=np.float64)
    if radius_mm == 0.0:
        return middle[None]
    axis = led.axis
    across = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    points = [middle]
    for count, share, turn in ((6, 4.0 / 19.0, 0.1), (12, 13.0 / 19.0, 0.36)):
        angle = turn + 2.0 * np.pi * np.arange(count) / count
        ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
        points.extend(middle + radius_mm * np.sqrt(share) * ring)
    return np.array(points)
