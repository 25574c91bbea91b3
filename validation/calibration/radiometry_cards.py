"""White cards for ``radiometry.py``: even and not, under LEDs as data sheets have them and not."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import Band, Camera, Capture, FloatArray, Rig
from splitknit_simulator.calibration_set.bench import BenchSettings, photograph_bench, well_exposed
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.camera.sensor import SensorSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """What is different from the ideal."""

    name: str
    error_mm: float = 0.0
    """Of the LEDs' calibrated places: rms of the length."""
    base_tilt: str = "none"
    """The card lies on the built rig's base, whose tilt is ``known`` or ``unknown``; ``none``: on the finger plane."""
    mottle: float = 0.0
    """Deviation of the card's brightness, in spots of two millimetres, and specks of dust on 0.3 % of it."""
    ring: float = 0.0
    """A ring in the LEDs' beams at 10 deg, that bright relative to the beam."""
    gloss: float = 0.0
    """Of the card where a mirror would show the LEDs (deviation of the half angle 6 deg)."""
    ambient: float = 0.002
    sensor: SensorSettings = field(default_factory=lambda: SensorSettings(bits=16))


CASES = (
    Case("places exact"),
    Case("LEDs 0.5 mm off", error_mm=0.5),
    Case("LEDs 1 mm off", error_mm=1.0),
    Case("8-bit files", error_mm=0.5, sensor=SensorSettings()),
    Case("8-bit sRGB files", error_mm=0.5, sensor=SensorSettings(encoding="srgb")),
    Case("ambient light of 5 %", error_mm=0.5, ambient=0.05),
    Case("base tilted, known", error_mm=0.5, base_tilt="known"),
    Case("base tilted, unknown", error_mm=0.5, base_tilt="unknown"),
    Case("card mottled by 1 %, dust", error_mm=0.5, mottle=0.01),
    Case("beams with a ring of 5 %", error_mm=0.5, ring=0.05),
    Case("card that shines by 1 %", error_mm=0.5, gloss=0.01),
)


class Card:
    """A scene of the bench: the twin's card, and what a case does to it."""

    def __init__(self, rig: Rig, case: Case, height_mm: float = 0.0, even: bool = False, seed: int = 0) -> None:
        tilt = (0.0, 0.0)
        if case.base_tilt != "none" and not even:
            x, y = rig.provenance["base_tilt_deg"]
            tilt = (float(x), float(y))
        bench = BenchSettings(ambient=0.0 if even else case.ambient)
        self._card = CardScene(camera=rig.camera, leds=rig.leds, bench=bench, height_mm=height_mm, tilt_deg=tilt)
        self._case, self._even, self._height = case, even, height_mm
        self._spots = None if even or not case.mottle else _spots(rig.camera, case.mottle, seed)

    @property
    def camera(self) -> Camera:
        return self._card.camera

    @property
    def leds(self) -> tuple[Any, ...]:
        return self._card.leds

    def light(self, lit: Any) -> FloatArray:
        light = self._card.light(lit).astype(np.float64)
        if self._spots is not None:
            light *= self._spots[..., None]
        for index in lit:
            light *= self._of_led(index)[..., None]
        return light.astype(np.float32)

    def _of_led(self, index: int) -> Array:
        """(H, W) what beam and gloss of one LED do."""
        factor = np.ones(self.camera.image_size)
        x, y, z = (np.asarray(part, dtype=np.float64) for part in self._card._points)
        away = np.asarray(self.leds[index].position_mm) - np.stack(np.broadcast_arrays(x, y, z), axis=-1)
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        if self._case.ring:
            angle = np.rad2deg(np.arccos(np.clip(-(away @ self.leds[index].axis), -1, 1)))
            factor += self._case.ring * np.exp(-0.5 * ((angle - 10) / 3) ** 2)
        if self._case.gloss and not self._even:
            sight = np.array([0, 0, self.camera.height_mm]) - np.stack(np.broadcast_arrays(x, y, z), axis=-1)
            half = away + sight / np.linalg.norm(sight, axis=-1, keepdims=True)
            angle = np.rad2deg(np.arccos(np.clip(half[..., 2] / np.linalg.norm(half, axis=-1), -1, 1)))
            factor += self._case.gloss * np.exp(-0.5 * (angle / 6) ** 2)
        return factor


def _spots(camera: Camera, deviation: float, seed: int) -> Array:
    rng = np.random.default_rng([seed, 7])
    rough = rng.standard_normal(camera.image_size)
    smooth = cv2.GaussianBlur(rough, (0, 0), max(2.0 * camera.px_per_mm / 2.0, 0.5))
    spots = 1 + deviation * smooth / smooth.std()
    specks = rng.random(camera.image_size) < 0.003 / 9
    dust = cv2.dilate(specks.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.asarray(np.where(dust, 0.6 * spots, spots))


def as_placed(rig: Rig, error_mm: float, seed: int) -> Rig:
    """The rig as calibrations of camera and lights leave it: places known so far, light not at all."""
    rng = np.random.default_rng([seed, 3])
    leds = []
    for led in rig.leds:
        x, y, z = np.asarray(led.position_mm) + rng.normal(0.0, error_mm / np.sqrt(3), 3)
        place = (float(x), float(y), float(z))
        leds.append(replace(led, position_mm=place, intensity=1.0, lobe_exponent=0.0, aim=None))
    return Rig(replace(rig.camera, shading=()), tuple(leds))


def photograph(scene: Card, stored: Rig, case: Case, seed: int) -> Capture:
    """The card under every LED, and with all off."""
    bands = {}
    for number, name in enumerate(("white", "nir")):
        lit = [(k,) for k, led in enumerate(scene.leds) if led.band == name]
        exposure = well_exposed(scene, lit)
        seeds = np.random.SeedSequence([seed, number, 0xCA]).spawn(len(lit) + 1)
        shots = [
            photograph_bench(scene, leds, s, exposure=exposure, sensor=case.sensor, band=name)
            for leds, s in zip([*lit, ()], seeds, strict=True)
        ]
        bands[name] = Band(
            name=name,
            pixels=np.stack(shots[:-1]),
            leds=tuple(lit),
            exposure=np.full(len(lit), exposure),
            black_level=np.zeros(len(lit)),
            ambient=shots[-1],
            ambient_exposure=exposure,
        )
    return Capture(rig=stored, bands=bands, encoding=case.sensor.encoding, material="opaque")
