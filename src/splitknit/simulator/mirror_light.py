"""Light on a finger between mirrors: the LEDs, and their images through the mirrors' faces."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray, Led
from splitknit.simulator.diffusion import WalkTable, diffuse_transmittance
from splitknit.simulator.lighting import UNIT, Patch, cut_out, light_on
from splitknit.simulator.mirrors import Light
from splitknit.simulator.renderer import BandLight, Diffusion, RenderSettings, relief_gains
from splitknit.simulator.skin import ChannelOptics, SkinSettings
from splitknit.simulator.surface import Surface

Array = NDArray[np.float64]


def render_between_mirrors(
    surface: Surface,
    lights: Sequence[Sequence[Light]],
    optics: Sequence[ChannelOptics],
    skin: SkinSettings,
    *,
    walks: WalkTable,
    settings: RenderSettings,
) -> BandLight:
    """Render a finger, or its reflection, in as many images as there are groups of `lights`.

    As :func:`splitknit.simulator.renderer.render_band`, whose terms it is made from; with one light without a gate in
    each group the result is the same.
    """
    patch = cut_out(surface)
    blur = _diffusion(patch, optics, skin, walks, settings)
    gains = list(relief_gains(surface, patch, optics, settings))
    shape = patch.mask.shape
    diffuse = np.empty((len(lights), len(optics), *shape), dtype=np.float32)
    gloss = np.empty((len(lights), *shape), dtype=np.float32)

    def one(k: int) -> None:
        entering, gloss[k] = light_through(patch, lights[k], skin.roughness, settings.led_radius_mm)
        gloss[k] *= np.float32(skin.glare)
        for c, light in enumerate(blur(entering)):
            np.multiply(light, gains[c], out=diffuse[k, c])

    with ThreadPoolExecutor(settings.workers) as pool:
        list(pool.map(one, range(len(lights))))
    return BandLight(window=patch.window, diffuse=diffuse, glare=gloss)


def light_through(
    patch: Patch, lights: Sequence[Light], roughness: float, led_radius_mm: float
) -> tuple[FloatArray, FloatArray]:
    """(h, w) irradiance that enters the skin and radiance that its surface reflects, of all `lights` together."""
    entering = np.zeros(patch.mask.shape, dtype=np.float32)
    gloss = np.zeros(patch.mask.shape, dtype=np.float32)
    for light in lights:
        with np.errstate(divide="ignore", invalid="ignore"):  # light from straight behind, where nothing is lit
            enters, shines = light_on(patch, light.led, roughness, led_radius_mm)
        if light.gate is not None:
            share = light.gate.share(patch.x, patch.y, patch.z, light.led, led_radius_mm)
            enters, shines = enters * share, shines * share
        entering += enters
        gloss += shines
    return entering, gloss


def render_room(
    surface: Surface,
    level: float,
    optics: Sequence[ChannelOptics],
    skin: SkinSettings,
    *,
    walks: WalkTable,
    settings: RenderSettings,
    up: Array,
) -> FloatArray:
    """(C, h, w) radiance of a reflected finger under a room that gives a white card `level`.

    `up` (3,) is where the reflected room's light comes from: the middle of its hemisphere.
    """
    patch = cut_out(surface)
    blur = _diffusion(patch, optics, skin, walks, settings)
    facing = patch.nx * np.float32(up[0]) + patch.ny * np.float32(up[1]) + patch.nz * np.float32(up[2])
    entering = np.where(patch.mask, np.float32(0.5 * np.pi * level * diffuse_transmittance()) * (1 + facing), 0)
    gains = relief_gains(surface, patch, optics, settings)
    return np.stack([light * gain for light, gain in zip(blur(entering.astype(np.float32)), gains, strict=True)])


def _diffusion(
    patch: Patch,
    optics: Sequence[ChannelOptics],
    skin: SkinSettings,
    walks: WalkTable,
    settings: RenderSettings,
) -> Diffusion:
    return Diffusion(
        patch, patch.pitch_mm, optics, walks,
        reach_mm=settings.reach_mm, roughness=skin.roughness, rim=settings.rim_exponent,
    )  # fmt: skip


def irradiance(led: Led, point: Array, normal: Array) -> float:
    """Light of one LED on a facet at `point` (3,) that faces `normal` (3,)."""
    total = 0.0
    for one in (led, *led.also):
        if one.position_mm is None:
            towards = np.asarray(one.direction, dtype=np.float64)
            total += one.intensity * max(float(towards @ normal) / float(np.linalg.norm(towards)), 0.0)
            continue
        way = np.asarray(one.position_mm) - point
        distance = float(np.linalg.norm(way))
        along = max(-float(way @ one.axis) / distance, 0.0) ** one.lobe_exponent if one.lobe_exponent > 0 else 1.0
        total += one.intensity * UNIT * along * max(float(way @ normal), 0.0) / distance**3
    return total
