"""Coloured LEDs: red, green and blue share an exposure, and the sensor's colour filters tell them apart, not quite."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import COLOURS, Band, FloatArray, Led, PixelArray, Rig
from splitknit.simulator.lighting import white_card
from splitknit.simulator.renderer import BandLight, render_band
from splitknit.simulator.rig import default_rig
from splitknit.simulator.skin import BAND_CHANNELS

if TYPE_CHECKING:
    from splitknit.simulator.twin_scene import Scene

CROSSTALK: tuple[tuple[float, float, float], ...] = (
    (1.000, 0.136, 0.045),
    (0.218, 1.000, 0.229),
    (0.071, 0.295, 1.000),
)
"""Signal of the red, green and blue pixels (rows) under a red, a green and a blue LED (columns), each row relative to
its own: the IMX219's quantum efficiency under Gaussian lines at 625, 525 and 465 nm, 20, 33 and 24 nm wide."""
CURRENTS = {"red": 1.0, "green": 1.6, "blue": 1.9}
"""Intensities by which light skin fills the three channels about alike."""


def shared_exposures(exposures: int) -> tuple[tuple[int, int, int], ...]:
    """Places on the circle, of 3 x `exposures` even ones, of the red, green and blue LED of each exposure.

    The three of an exposure lie around the finger, and so do all LEDs of a colour.

    Raises
    ------
    BadInput
        If it is not one to three exposures.
    """
    require(1 <= exposures <= 3, f"coloured LEDs take one to three exposures here, not {exposures}.")
    step = (0, 4, 8) if exposures == 3 else (0, exposures, 2 * exposures)
    count = 3 * exposures
    return tuple(
        ((3 * k + step[0]) % count, (3 * k + step[1]) % count, (3 * k + step[2]) % count) for k in range(exposures)
    )


def coloured_rig(scale: float = 1.0, seed: int | None = None, intensity_spread: float = 0.1, exposures: int = 2) -> Rig:
    """Return the thesis's rig with 3 x `exposures` coloured LEDs on the circle of its seven white ones.

    Parameters
    ----------
    scale, seed, intensity_spread : as of :func:`splitknit.simulator.rig.default_rig`; the NIR LEDs are the same
    exposures : 1 to 3

    Raises
    ------
    BadInput
        If one of them is out of range.
    """
    plain = default_rig(scale, seed, intensity_spread)
    count = 3 * exposures
    colours = {place: c for triple in shared_exposures(exposures) for place, c in zip(triple, COLOURS, strict=True)}
    spread = np.ones(count)
    if seed is not None:
        deviations = np.random.default_rng([seed, 0xC0]).standard_normal(count)
        spread = 1.0 + intensity_spread * np.clip(deviations, -2.5, 2.5)
    leds = []
    for k in range(count):
        azimuth = 2.0 * np.pi * k / count
        position = (float(52.5 * np.cos(azimuth)), float(52.5 * np.sin(azimuth)), 140.0)
        intensity = round(float(CURRENTS[colours[k]] * spread[k]), 6)
        leds.append(Led(band="white", position_mm=position, intensity=intensity, colour=colours[k]))
    camera = replace(plain.camera, crosstalk=np.array(CROSSTALK))
    invisible = tuple(led for led in plain.leds if led.band == "nir")
    return replace(plain, camera=camera, leds=(*leds, *invisible))


def exposures_of(leds: Sequence[Led]) -> list[tuple[int, ...]]:
    """Which of `leds` share an exposure: the k-th of each colour; a white one has its own."""
    groups: dict[int, list[int]] = {}
    seen = dict.fromkeys(COLOURS, 0)
    alone = []
    for k, led in enumerate(leds):
        if led.colour:
            groups.setdefault(seen[led.colour], []).append(k)
            seen[led.colour] += 1
        else:
            alone.append((k,))
    return [*(tuple(group) for group in groups.values()), *alone]


def photograph_coloured(
    scene: Scene, name: str, seed: np.random.SeedSequence
) -> tuple[Band, NDArray[np.float16], NDArray[Any]]:
    """Images of a band with coloured LEDs, the glare of each LED, and the exposure: as :meth:`Scene.photograph`.

    An LED of a colour is a narrow line: all pixels that see it see the skin at its wavelength, blurred as light of this
    colour is; how strongly they see it is the camera's crosstalk.
    """
    rig, settings, skin = scene.rig, scene.settings, scene.skin
    members = [k for k, led in enumerate(rig.leds) if led.band == name]
    leds = [rig.leds[k] for k in members]
    optics = [skin.channel(channel) for channel in BAND_CHANNELS[name]]
    light = render_band(
        scene.surface, leds, optics, roughness=skin.roughness, glare=skin.glare, walks=scene.walks,
        settings=settings.render,
    )  # fmt: skip
    groups = exposures_of(leds)
    bright = max(brightest_of(scene, light, group, leds) for group in groups)
    exposure = np.float32(settings.sensor.exposure / bright)
    ambient = scene.ambient(name, leds)
    seeds = seed.spawn(len(groups) + 1)
    height, width = rig.camera.image_size
    glare = np.zeros((len(leds), height, width), dtype=np.float16)

    def shoot(e: int) -> PixelArray:
        for k in groups[e]:
            glare[k][light.window] = light.glare[k] * scene.shade[light.window[0]] * exposure
        return scene.record(exposed(scene, light, groups[e], leds, ambient) * exposure, "coloured", seeds[e])

    with ThreadPoolExecutor(settings.render.workers) as pool:
        images = list(pool.map(shoot, range(len(groups))))
    dark = scene.record(np.broadcast_to(ambient, (height, width, 3)) * exposure, "coloured", seeds[-1])
    named = tuple(tuple(members[k] for k in group) for group in groups)
    band = Band(
        name=name,
        pixels=np.stack(images),  # type: ignore[arg-type]
        leds=named,
        exposure=np.ones(len(groups)),
        black_level=np.zeros(len(groups)),
        ambient=dark,
        shading=rig.camera.shading,
        colours=rig.colours_of(named),
        crosstalk=rig.camera.crosstalk,
    )
    return band, glare, np.array(float(exposure))


def exposed(
    scene: Scene, light: BandLight, group: tuple[int, ...], leds: Sequence[Led], ambient: FloatArray
) -> FloatArray:
    """(H, W, 3) what the sensor's pixels see while the LEDs of a group are lit together, and the room's light.

    Parameters
    ----------
    scene : what is photographed
    light : of every one of `leds`
    group : which of them share the exposure
    leds : white or coloured
    ambient : (H, W, 3) or what broadcasts to it
    """
    camera = scene.rig.camera
    mixing = _mixing(scene.rig)
    frame = ambient.copy()
    for k in group:
        lit = scene.frame(light, k, white_card(camera, leds[k], -scene.settings.background.depth_mm))
        if leds[k].colour:
            c = COLOURS.index(leds[k].colour)
            frame += lit[..., c : c + 1] * mixing[:, c].astype(np.float32)
        else:
            frame += lit
    return frame


def _mixing(rig: Rig) -> NDArray[np.float64]:
    return np.eye(3) if rig.camera.crosstalk is None else np.asarray(rig.camera.crosstalk)


def brightest_of(scene: Scene, light: BandLight, group: tuple[int, ...], leds: Sequence[Led]) -> float:
    """99.9th percentile of the diffuse light of an exposure, in the channel where it is highest."""
    mixing = _mixing(scene.rig)
    fallen = 1.0 if scene.fall_off is None else scene.fall_off[light.window][::4, ::4]
    total = np.zeros((3, *light.diffuse[0, 0, ::4, ::4].shape))
    for k in group:
        sample = light.diffuse[k, :, ::4, ::4] * fallen
        if leds[k].colour:
            c = COLOURS.index(leds[k].colour)
            total += mixing[:, c, None, None] * sample[c]
        else:
            total += sample
    return float(max(np.percentile(channel[channel > 0], 99.9) for channel in total))
