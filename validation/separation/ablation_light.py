"""One finger of the twin, the parts of its light, and captures from which a part has been taken."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band, Capture
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.model import FloatArray
from splitknit.nominal import default_rig
from splitknit.observation.observe import observe
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, finger_surface
from splitknit_simulator.light.skin import SkinOptics, SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import photograph

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from projector import separate_truth

BLACK = 0.1
"""Black level of the changed light in 16 bits, over full scale: noise may fall below zero."""
GAIN = 0.85
"""Fraction of full scale that light of one takes, above the black level."""


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """A capture with all that the twin knows of it."""

    capture: Capture
    truth: Mapping[str, NDArray[Any]]
    surface: SimulatedSurface
    skin: SkinOptics


def twin_of(seed: int, scale: float) -> Twin:
    """The first capture of a person: the same as :func:`splitknit_simulator.twin.simulate_capture`
    takes."""
    settings = TwinSettings(scale=scale)
    assert isinstance(settings.skin, SkinRanges) and isinstance(settings.pose, PoseRanges)
    rig = default_rig(scale, settings.rig_seed)
    skin = settings.skin.draw(np.random.default_rng(np.random.SeedSequence([seed, 0x51])))
    pose_seed, photo_seed = np.random.SeedSequence([seed, 0, 0x52]).spawn(2)
    pose = settings.pose.draw(np.random.default_rng(pose_seed), rig.camera)
    surface = finger_surface(
        draw_finger(seed, None), pose, rig.camera, workers=settings.render.workers
    )
    capture, truth = photograph(surface, rig, skin, photo_seed, settings=settings)
    return Twin(capture, truth, surface, skin)


def true_shares(twin: Twin, check_mm: float) -> dict[str, FloatArray]:
    """(L, H, W) what fraction of each white image's grey light a part of it is, as the twin knows
    it.

    ``direct`` through checks of `check_mm`, glare included; ``direct without glare``; ``all but
    glare``. One where there is no light.
    """
    band = twin.capture.bands["white"]
    shape = (len(band.leds), *twin.capture.shape)
    names = ("direct", "direct without glare", "all but glare")
    fractions = {name: np.ones(shape, dtype=np.float32) for name in names}
    for k, (index,) in enumerate(band.leds):
        led = twin.capture.rig.leds[index]
        light = separate_truth(twin.surface, led, twin.skin, check_mm=check_mm, phases="centred")
        direct, white = (
            np.tensordot(GREY_WEIGHTS, part, 1) for part in (light.direct, light.white)
        )
        lit = white > 1e-6 * white.max()
        for name, part in zip(
            names, (direct, direct - light.glare, white - light.glare), strict=True
        ):
            fraction = np.divide(part, white, out=np.ones_like(white), where=lit)
            fractions[name][k][light.window] = np.clip(fraction, 0.0, 1.0)
    return fractions


def without_glare(capture: Capture, name: str, glare: FloatArray) -> Capture:
    """`glare` (L, H, W), in linear light, subtracted from all channels of a band's images."""
    light = observe(capture).bands[name].stack - glare
    return _with_band(capture, name, np.moveaxis(light, 0, -1))


def in_grey(capture: Capture) -> Capture:
    """The white images without their colours."""
    light = observe(capture).white.grey
    return _with_band(capture, "white", light[..., None])


def _with_band(capture: Capture, name: str, light: FloatArray) -> Capture:
    """A band's images become the linear light (L, H, W, C), in 16 bits."""
    assert capture.encoding == "linear", "both bands have one encoding"
    old = capture.bands[name]
    count = len(light)
    stored = np.empty(light.shape, dtype=np.uint16)
    for image, values in zip(stored, light, strict=True):
        image[...] = np.clip(np.rint(65535.0 * (BLACK + GAIN * values)), 0, 65535)
    new = Band(name, stored, old.leds, np.full(count, GAIN), np.full(count, 65535.0 * BLACK))
    return replace(capture, bands={**capture.bands, name: new})
