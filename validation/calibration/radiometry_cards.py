"""White cards for ``radiometry.py``, and how they are photographed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from splitknit.capture import Ambient, Band, Capture
from splitknit.model import Rig
from splitknit_simulator.calibration_set.bench import BenchSettings, photograph_bench, well_exposed
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.camera.sensor import SensorSettings


@dataclass(frozen=True)
class Case:
    """What is different from the ideal."""

    name: str
    error_mm: float = 0.0
    """Of the LEDs' calibrated places: rms of the length."""
    base_tilt: str = "none"
    """The card lies on the built rig's base, whose tilt is ``known`` or ``unknown``; ``none``: on
    the finger plane."""
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
)


def card_of(rig: Rig, case: Case, height_mm: float = 0.0, even: bool = False) -> CardScene:
    """The twin's card under a rig, as a case has it; `even`: level and without ambient light."""
    tilt = (
        (0.0, 0.0)
        if even or case.base_tilt == "none"
        else tuple(map(float, rig.provenance["base_tilt_deg"]))
    )
    bench = BenchSettings(ambient=0.0 if even else case.ambient)
    return CardScene(
        camera=rig.camera, leds=rig.leds, bench=bench, height_mm=height_mm, tilt_deg=tilt
    )


def as_placed(rig: Rig, error_mm: float, seed: int) -> Rig:
    """The rig as calibrations of camera and lights leave it: places known so far, light not at
    all."""
    rng = np.random.default_rng([seed, 3])
    leds = []
    for led in rig.leds:
        x, y, z = np.asarray(led.position_mm) + rng.normal(0.0, error_mm / np.sqrt(3), 3)
        place = (float(x), float(y), float(z))
        leds.append(replace(led, position_mm=place, intensity=1.0, lobe_exponent=0.0, aim=None))
    return Rig(replace(rig.camera, shading=()), tuple(leds))


def photograph(scene: CardScene, stored: Rig, case: Case, seed: int) -> Capture:
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
            ambient=Ambient(shots[-1], exposure),
        )
    return Capture(rig=stored, bands=bands, encoding=case.sensor.encoding, material="opaque")
