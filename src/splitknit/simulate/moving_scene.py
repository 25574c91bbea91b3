"""Photographs of a moving finger: every shot shows a surface of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.simulate.diffusion import WalkTable, load_walks
from splitknit.simulate.lighting import white_card
from splitknit.simulate.moving import MovingFinger
from splitknit.simulate.renderer import BandLight, render_band
from splitknit.simulate.skin import BAND_CHANNELS, SkinSettings
from splitknit.simulate.truth import optics_truth, surface_truth
from splitknit.simulate.twin_scene import Scene, brightest
from splitknit.types import Band, Capture, FloatArray, PixelArray, Rig

if TYPE_CHECKING:
    from splitknit.simulate.twin import TwinSettings


def photograph_moving(
    moving: MovingFinger, rig: Rig, skin: SkinSettings, seed: np.random.SeedSequence, settings: TwinSettings
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Photograph a finger that moves from shot to shot, the white band first.

    Arguments and results as those of :func:`splitknit.simulate.twin.photograph`. The truth is that of the reference
    shot, ``motion_reference``; ``motion_*`` tell the motion, and ``glare_*`` lie where each shot shows the finger.
    The ambient frame of a band shows the finger where its first shot does.
    """
    require(
        not any(led.colour for led in rig.leds),
        "a moving finger is photographed with one LED an exposure in the twin; leave out motion or the coloured LEDs.",
    )
    walks = load_walks()
    background_seed, noise_seed = seed.spawn(2)
    names = [name for name in BAND_CHANNELS if any(led.band == name for led in rig.leds)]
    shots = [(name, k) for name in names for k, led in enumerate(rig.leds) if led.band == name]
    lit: dict[str, list[tuple[Scene, BandLight, int]]] = {name: [] for name in names}
    truth: dict[str, NDArray[Any]] = {}
    for number, ((name, k), surface) in enumerate(zip(shots, moving.surfaces(), strict=True)):
        # the same dust in every shot
        scene = Scene((surface, rig, skin), settings, np.random.default_rng(background_seed), walks)
        if number == moving.path.reference:
            truth = surface_truth(surface) | moving.truth(surface)
        lit[name].append((scene, _light(scene, name, k, walks), k))
    bands = {}
    start = 0
    for name, band_seed in zip(names, noise_seed.spawn(len(names)), strict=True):
        count = len(lit[name])
        smears = _smears(moving, settings, start, count)
        bands[name], truth[f"glare_{name}"], truth[f"exposure_{name}"] = _band(name, lit[name], band_seed, smears)
        start += count
    truth |= optics_truth(skin)
    truth["led_intensity"] = np.array([led.intensity for led in rig.leds])
    capture = Capture(
        rig=rig, bands=bands, encoding=settings.sensor.encoding, material="skin", subject={"id": "anonymous"}
    )
    return capture, truth


def _light(scene: Scene, name: str, led: int, walks: WalkTable) -> BandLight:
    optics = [scene.skin.channel(channel) for channel in BAND_CHANNELS[name]]
    return render_band(
        scene.surface,
        [scene.rig.leds[led]],
        optics,
        roughness=scene.skin.roughness,
        glare=scene.skin.glare,
        walks=walks,
        settings=scene.settings.render,
    )


def _band(
    name: str, lit: Sequence[tuple[Scene, BandLight, int]], seed: np.random.SeedSequence, smears: Sequence[FloatArray]
) -> tuple[Band, NDArray[np.float16], NDArray[Any]]:
    """Images of one band, their glare, and their exposure, as :meth:`Scene.photograph` gives them."""
    first = lit[0][0]
    rig, settings = first.rig, first.settings
    fallen = first.fall_off
    bright = max(brightest(light.diffuse, None if fallen is None else fallen[light.window]) for _, light, _ in lit)
    exposure = np.float32(settings.sensor.exposure / bright)
    seeds = seed.spawn(len(lit) + 1)
    leds = [rig.leds[k] for _, _, k in lit]
    ambient = first.ambient(name, leds)
    height, width = rig.camera.image_size
    glare = np.zeros((len(lit), height, width), dtype=np.float16)
    images: list[PixelArray] = []
    for number, (scene, light, k) in enumerate(lit):
        card = white_card(rig.camera, rig.leds[k], -settings.background.depth_mm)
        frame = (ambient + scene.frame(light, 0, card)) * exposure
        images.append(scene.record(_smeared(frame, smears[number]), name, seeds[number]))
        glare[number][light.window] = light.glare[0] * scene.shade[light.window[0]] * exposure
    dark = first.record(np.broadcast_to(ambient, (height, width, 3)) * exposure, name, seeds[-1])
    band = Band(
        name=name,
        pixels=np.stack(images),  # type: ignore[arg-type]
        leds=tuple((k,) for _, _, k in lit),
        exposure=np.ones(len(lit)),
        black_level=np.zeros(len(lit)),
        ambient=dark,
        shading=rig.camera.shading,
    )
    return band, glare, np.array(float(exposure))


def _smears(moving: MovingFinger, settings: TwinSettings, start: int, count: int) -> list[FloatArray]:
    """Kernels of the blur within each exposure."""
    scale = settings.motion.exposure_s * moving.camera.px_per_mm
    return [smear_kernel(moving.path.speed_mm_per_s[k] * scale * [1.0, -1.0]) for k in range(start, start + count)]


def smear_kernel(length_px: NDArray[np.float64]) -> FloatArray:
    """(n, n) kernel of a straight path of `length_px` (columns, rows), its middle in the middle."""
    reach = int(np.ceil(np.abs(length_px).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for share in np.linspace(-0.5, 0.5, 65):
        column, row = reach + share * length_px
        left, top = int(np.floor(column)), int(np.floor(row))
        across, down = column - left, row - top
        kernel[top : top + 2, left : left + 2] += np.outer([1 - down, down], [1 - across, across])
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def _smeared(frame: FloatArray, kernel: FloatArray) -> FloatArray:
    return np.asarray(cv2.filter2D(frame, -1, kernel, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
