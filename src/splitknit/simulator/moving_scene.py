"""Photographs of a moving finger: every shot shows a surface of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import Band, Capture, FloatArray, Led, PixelArray, Rig
from splitknit.simulator.coloured import brightest_of, exposed, exposures_of
from splitknit.simulator.diffusion import WalkTable, load_walks
from splitknit.simulator.moving import MovingFinger
from splitknit.simulator.renderer import BandLight, render_band
from splitknit.simulator.skin import BAND_CHANNELS, SkinSettings
from splitknit.simulator.truth import optics_truth, surface_truth
from splitknit.simulator.twin_scene import Scene, brightest

if TYPE_CHECKING:
    from splitknit.simulator.twin import TwinSettings


def photograph_moving(
    moving: MovingFinger, rig: Rig, skin: SkinSettings, seed: np.random.SeedSequence, settings: TwinSettings
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Photograph a finger that moves from shot to shot, the white band first.

    Arguments and results as those of :func:`splitknit.simulator.twin.photograph`. The truth is that of the reference
    shot, ``motion_reference``; ``motion_*`` tell the motion, and ``glare_*`` lie where each shot shows the finger.
    The ambient frame of a band shows the finger where its first shot does. Coloured LEDs of one exposure show the
    finger at one place.
    """
    walks = load_walks()
    background_seed, noise_seed = seed.spawn(2)
    shots = shots_of(rig)
    names = list(dict.fromkeys(name for name, _ in shots))
    lit: dict[str, list[Shot]] = {name: [] for name in names}
    truth: dict[str, NDArray[Any]] = {}
    for number, ((name, leds), surface) in enumerate(zip(shots, moving.surfaces(), strict=True)):
        # the same dust in every shot
        scene = Scene((surface, rig, skin), settings, np.random.default_rng(background_seed), walks)
        if number == moving.path.reference:
            truth = surface_truth(surface) | moving.truth(surface)
        lit[name].append(Shot(scene, _light(scene, name, leds, walks), leds))
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


def shots_of(rig: Rig) -> list[tuple[str, tuple[int, ...]]]:
    """Band and LEDs of every shot, in the order in which they are taken: the white band first."""
    found = []
    for name in BAND_CHANNELS:
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        groups = exposures_of([rig.leds[k] for k in members])
        found += [(name, tuple(members[k] for k in group)) for group in groups]
    return found


def reference_of(rig: Rig) -> int:
    """Number of the reference shot: the middle one of the first band."""
    shots = shots_of(rig)
    return sum(name == shots[0][0] for name, _ in shots) // 2


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """The finger at one place under one exposure's LEDs."""

    scene: Scene
    light: BandLight
    """Of every LED of the exposure."""
    leds: tuple[int, ...]
    """Their numbers in the rig."""

    @property
    def members(self) -> list[Led]:
        """The exposure's LEDs."""
        return [self.scene.rig.leds[k] for k in self.leds]

    @property
    def whole(self) -> tuple[int, ...]:
        """Their numbers in `light`."""
        return tuple(range(len(self.leds)))


def _light(scene: Scene, name: str, leds: Sequence[int], walks: WalkTable) -> BandLight:
    optics = [scene.skin.channel(channel) for channel in BAND_CHANNELS[name]]
    return render_band(
        scene.surface,
        [scene.rig.leds[k] for k in leds],
        optics,
        roughness=scene.skin.roughness,
        glare=scene.skin.glare,
        walks=walks,
        settings=scene.settings.render,
    )


def _band(
    name: str, lit: Sequence[Shot], seed: np.random.SeedSequence, smears: Sequence[FloatArray]
) -> tuple[Band, NDArray[np.float16], NDArray[Any]]:
    """Images of one band, the glare of each of its LEDs, and their exposure, as :meth:`Scene.photograph` gives them."""
    first = lit[0].scene
    rig, settings = first.rig, first.settings
    used = [k for shot in lit for k in shot.leds]
    colours = rig.colours_of(tuple(shot.leds for shot in lit))
    seen_by = "coloured" if colours else name
    bright = max(_brightest(shot) for shot in lit)
    exposure = np.float32(settings.sensor.exposure / bright)
    seeds = seed.spawn(len(lit) + 1)
    ambient = first.ambient(name, [rig.leds[k] for k in used])
    height, width = rig.camera.image_size
    glare = np.zeros((len(used), height, width), dtype=np.float16)
    images: list[PixelArray] = []
    place = {led: number for number, led in enumerate(sorted(used))}
    for number, shot in enumerate(lit):
        frame = exposed(shot.scene, shot.light, shot.whole, shot.members, ambient) * exposure
        images.append(shot.scene.record(_smeared(frame, smears[number]), seen_by, seeds[number]))
        shade = shot.scene.shade[shot.light.window[0]]
        for k, led in enumerate(shot.leds):
            glare[place[led]][shot.light.window] = shot.light.glare[k] * shade * exposure
    dark = first.record(np.broadcast_to(ambient, (height, width, 3)) * exposure, seen_by, seeds[-1])
    band = Band(
        name=name,
        pixels=np.stack(images),  # type: ignore[arg-type]
        leds=tuple(shot.leds for shot in lit),
        exposure=np.ones(len(lit)),
        black_level=np.zeros(len(lit)),
        ambient=dark,
        shading=rig.camera.shading,
        colours=colours,
        crosstalk=rig.camera.crosstalk if colours else None,
    )
    return band, glare, np.array(float(exposure))


def _brightest(shot: Shot) -> float:
    if any(led.colour for led in shot.members):
        return brightest_of(shot.scene, shot.light, shot.whole, shot.members)
    fallen = shot.scene.fall_off
    return brightest(shot.light.diffuse, None if fallen is None else fallen[shot.light.window])


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
