"""A white card under a built rig, photographed by the twin: as a capture, and as a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.capture import Ambient, Band, Capture
from splitknit.io.capture import write_capture
from splitknit.io.images import write_image
from splitknit.model import Rig
from splitknit_simulator.calibration_set.bench import BenchSettings, photograph_bench, well_exposed
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.rigs import built_rig

SENSOR = SensorSettings(bits=16)


def as_placed(rig: Rig, error_mm: float = 0.0, seed: int = 0) -> Rig:
    """The rig after calibration of camera and places, `error_mm` off (rms of the length), light not
    yet known."""
    rng = np.random.default_rng(seed)
    leds = []
    for led in rig.leds:
        x, y, z = np.asarray(led.position_mm) + rng.normal(0, error_mm / np.sqrt(3), 3)
        place = (float(x), float(y), float(z))
        leds.append(replace(led, position_mm=place, intensity=1.0, lobe_exponent=0.0, aim=None))
    return Rig(replace(rig.camera, shading=()), tuple(leds), {})


def scene_of(rig: Rig, ambient: float = 0.002, **card: Any) -> CardScene:
    return CardScene(camera=rig.camera, leds=rig.leds, bench=BenchSettings(ambient=ambient), **card)


def photograph(  # noqa: PLR0917
    rig: Rig,
    stored: Rig,
    seed: int = 0,
    scene: Any = None,
    level: float = 0.7,
    sensor: SensorSettings = SENSOR,
    gains: Mapping[int, float] | None = None,
    exposures: Sequence[float] | None = None,
) -> Capture:
    """The card under every LED of `rig` as a capture whose rig is `stored`.

    `gains` change single LEDs' brightness; `exposures` of the white and the NIR band are full
    scales per unit of light and found where not given.
    """
    dimmed = Rig(
        rig.camera,
        tuple(
            replace(led, intensity=led.intensity * (gains or {}).get(k, 1.0))
            for k, led in enumerate(rig.leds)
        ),
    )
    card = scene_of(dimmed) if scene is None else scene(dimmed)
    bands = {}
    for b, name in enumerate(("white", "nir")):
        own = [k for k, led in enumerate(rig.leds) if led.band == name]
        lit = [(k,) for k in own]
        exposure = well_exposed(card, lit, level) if exposures is None else exposures[b]
        seeds = np.random.SeedSequence([seed, b]).spawn(len(own) + 1)
        shots = [
            photograph_bench(card, leds, s, exposure=exposure, sensor=sensor, band=name)
            for leds, s in zip([*lit, ()], seeds, strict=True)
        ]
        bands[name] = Band(
            name=name,
            pixels=np.stack(shots[:-1]),
            leds=tuple(lit),
            exposure=np.full(len(own), exposure),
            black_level=np.zeros(len(own)),
            ambient=Ambient(shots[-1], exposure),
        )
    return Capture(rig=stored, bands=bands, encoding=sensor.encoding, material="opaque")


def card_folder(
    folder: Path,
    seed: int = 1,
    scale: float = 0.1,
    series: Sequence[float] = (0.2, 0.4, 0.8, 1.2),
    **how: Any,
) -> tuple[Rig, Rig]:
    """Write a folder as `calibrate radiometry` reads it; return the built rig and what is known of
    it."""
    rig = built_rig(seed, scale=scale)
    stored = as_placed(rig)
    capture = photograph(rig, stored, seed, **how)
    write_capture(capture, folder)
    sensor = how.get("sensor", SENSOR)
    card = scene_of(rig)
    base = well_exposed(card, [(0,)], 0.75)
    entries = []
    for k, fraction in enumerate(series):
        shot = photograph_bench(card, (0,), 40 + k, exposure=base * fraction, sensor=sensor)
        write_image(folder / f"step_{k}.png", shot)
        entries.append({"file": f"step_{k}.png", "exposure_s": 0.001 * fraction})
    document = {"format": "splitknit-radiometry", "version": 1, "exposures": entries}
    (folder / "radiometry.json").write_text(json.dumps(document))
    return rig, stored
