"""The data set: photographs of simulated palms and fingers, and what of their light is direct.

As the thesis made its own: every palm is photographed under 25 shifted checkerboards, which the separation code turns
into the direct image. The optics of the skin, the light's place, the size of a pixel and the camera's noise are drawn
anew for every photograph, so that the network is of more than one palm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging import GREY_WEIGHTS
from splitknit.model import BoolArray, Camera, FloatArray, Led, default_rig
from splitknit.separation.checkerboard import checkerboard
from splitknit.separation.direct import exposure_level, local_level
from splitknit.separation.stacks import StackSettings
from splitknit.simulator.camera.sensor import SensorSettings, record
from splitknit.simulator.finger.finger import PoseRanges, draw_finger, finger_surface
from splitknit.simulator.finger.palm import draw_palm, palm_surface
from splitknit.simulator.light.separation import Checkerboard, Separated, checkerboard_stack, separate_truth
from splitknit.simulator.light.skin import SkinSettings
from splitknit.simulator.surface import Surface
from splitknit.training.settings import DataSettings

FULL_PX_PER_MM = 75.7
FINGER_PITCH_UM = 20.0
CHANNELS = 8
"""Of a stored photograph: image red, green, blue; direct red, green, blue; enhanced image, enhanced direct."""

Enhance = Callable[[FloatArray, float, BoolArray], FloatArray]
"""CLAHE: grey image (h, w), pixels per mm, mask -> (h, w) in [0, 1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """One photograph of one palm or finger, with its truth."""

    pixels: NDArray[np.float16]
    """(h, w, 8): see :data:`CHANNELS`; image and direct light in units of the image's exposure level, zero outside."""
    corners: NDArray[np.int32]
    """(n, 2) row and column of the patches' upper left corners."""
    facts: Mapping[str, Any]
    """Kind, seed, pixel size, light, optics."""


def photographs(kind: str, index: int, seed: int, settings: DataSettings, enhance: Enhance) -> list[Photograph]:
    """Take all views of one palm or finger.

    Parameters
    ----------
    kind : ``palm`` or ``finger``
    index : of the palm; everything follows from it and `seed`
    seed : of the data set
    settings : of the data set
    enhance : the contrast enhancement of the thesis's presets

    Returns
    -------
    list of Photograph, `settings.views` long
    """
    surface = surface_of(kind, index, seed, settings)
    view_seeds = _root(kind, index, seed).spawn(1 + settings.views)[1:]
    return [_photograph(surface, (kind, index), view, settings, enhance) for view in view_seeds]


def surface_of(kind: str, index: int, seed: int, settings: DataSettings) -> Surface:
    """The palm or finger itself, before its camera: what :func:`photographs` takes pictures of."""
    require(kind in ("palm", "finger"), f"kind must be palm or finger, not '{kind}'.")
    rng = np.random.default_rng(_root(kind, index, seed).spawn(1)[0])
    return _finger(rng, settings) if kind == "finger" else _palm(rng, settings)


def _root(kind: str, index: int, seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence([seed, 0x7A, kind == "finger", index])


def _palm(rng: np.random.Generator, settings: DataSettings) -> Surface:
    camera = Camera(px_per_mm=1000.0 / _pitch_um(rng, settings.pitch_um), image_size=settings.image_size)
    return palm_surface(draw_palm(int(rng.integers(2**31))), camera)


def _finger(rng: np.random.Generator, settings: DataSettings) -> Surface:
    low, high = (max(pitch, FINGER_PITCH_UM) for pitch in settings.pitch_um)
    camera = default_rig(1000.0 / _pitch_um(rng, (low, high)) / FULL_PX_PER_MM).camera
    finger = draw_finger(int(rng.integers(2**31)))
    return finger_surface(finger, PoseRanges().draw(rng, camera), camera, workers=1)


def _pitch_um(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(limits[0] * (limits[1] / limits[0]) ** rng.random())


def _photograph(
    surface: Surface, name: tuple[str, int], seed: np.random.SeedSequence, settings: DataSettings, enhance: Enhance
) -> Photograph:
    draw_seed, noise_seed, corner_seed = seed.spawn(3)
    rng = np.random.default_rng(draw_seed)
    skin = settings.skin.draw(rng)
    led = _light(rng, settings, surface.camera)
    sensor = SensorSettings(exposure=float(rng.uniform(0.4, 0.9)), bits=8 if rng.random() < 0.5 else 16)
    light = separate_truth(surface, led, skin, check_mm=settings.check_mm, phases="centred")
    if settings.labels == "stack":
        light = replace(light, direct=_through_patterns(surface, led, skin, light))
    pixels = _record(light, surface, sensor, noise_seed, enhance)
    corners = patch_corners(surface.mask[light.window], settings, np.random.default_rng(corner_seed))
    facts = {
        "kind": name[0],
        "index": name[1],
        "pitch_um": 1000.0 * surface.camera.pitch_mm,
        "led_mm": list(led.position_mm or ()),
        "skin": {field: getattr(skin, field) for field in skin.__dataclass_fields__},
        "exposure": sensor.exposure,
        "bits": sensor.bits,
    }
    return Photograph(pixels, corners, facts)


def _light(rng: np.random.Generator, settings: DataSettings, camera: Camera) -> Led:
    low, high = settings.led_radius_mm
    radius, azimuth = low + (high - low) * rng.random(), 2.0 * np.pi * rng.random()
    position = (float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), camera.height_mm)
    return Led("white", position_mm=position)


def _through_patterns(surface: Surface, led: Led, skin: SkinSettings, light: Separated) -> FloatArray:
    """Direct light (3, h, w) from 25 shifted checkerboards, L_max - L_min of the noise-free images."""
    pattern = Checkerboard(light.check_mm, steps=5, alpha=0.5, dark=0.0)
    stack = checkerboard_stack(surface, led, skin, pattern).transpose(0, 2, 3, 1)
    # radiance in the rig's units knows no clipping; the black outside the mask is no fault
    unbounded = StackSettings(clip_level=None)
    mask = surface.mask[light.window]
    made = checkerboard(stack, alpha=0.5, dark=0.0, mask=mask, settings=unbounded)
    direct = np.where(mask, made.direct.transpose(2, 0, 1), np.float32(0.0))
    return np.asarray(np.minimum(direct, light.white), dtype=np.float32)


def _record(
    light: Separated, surface: Surface, sensor: SensorSettings, seed: np.random.SeedSequence, enhance: Enhance
) -> NDArray[np.float16]:
    """Photograph the white light, noise and clipping included, and bring image and direct light to one scale."""
    mask, px_per_mm = surface.mask[light.window], surface.camera.px_per_mm
    brightest = np.percentile((light.white - light.glare)[:, mask].max(axis=0), 99.9)
    exposure = np.float32(sensor.exposure / max(float(brightest), 1e-12))
    clean = (light.white * exposure * mask).transpose(1, 2, 0)
    full = np.float32(2**sensor.bits - 1)
    stored = record(clean, "white", seed, sensor, px_per_mm / FULL_PX_PER_MM)
    image = stored.astype(np.float32) / full * mask[..., None]
    # what clips is direct light: the truth of the clipped photograph is the clipped light less the global light
    clipped = np.minimum(clean, np.float32(1.0))
    kept = np.maximum((light.direct * exposure * mask).transpose(1, 2, 0) - (clean - clipped), np.float32(0.0))
    grey, grey_clean, grey_kept = (np.asarray(part @ GREY_WEIGHTS) for part in (image, clipped, kept))
    enhanced = enhance(grey, px_per_mm, mask)
    share = np.clip(grey_kept / np.maximum(grey_clean, np.float32(1e-6)), 0.0, 1.0)
    level = np.float32(exposure_level(image.transpose(2, 0, 1)))
    enhanced_level = np.float32(exposure_level(enhanced))
    parts = [image / level, kept / level]
    parts += [(part / enhanced_level)[..., None] for part in (enhanced, enhanced * share)]
    return np.concatenate(parts, axis=2).astype(np.float16)


def levelled(photograph: Photograph) -> Photograph:
    """The photograph divided by its local level, as the network is given it."""
    pixels = photograph.pixels.astype(np.float32)
    level = local_level(np.ascontiguousarray(pixels[..., :3].transpose(2, 0, 1)))[..., None]
    enhanced_level = local_level(np.ascontiguousarray(pixels[..., 6]))[..., None]
    divided = np.concatenate([pixels[..., :6] / level, pixels[..., 6:] / enhanced_level], axis=2)
    return replace(photograph, pixels=divided.astype(np.float16))


def patch_corners(mask: BoolArray, settings: DataSettings, rng: np.random.Generator) -> NDArray[np.int32]:
    """Draw the upper left corners (n, 2) of patches that hold skin.

    Raises
    ------
    BadInput
        If the image is smaller than a patch, or no patch holds enough skin.
    """
    side = settings.patch_px
    require(
        min(mask.shape) >= side,
        f"a photograph of {mask.shape[0]} x {mask.shape[1]} pixels is smaller than a patch of {side}.",
    )
    summed = np.pad(np.cumsum(np.cumsum(mask, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    inside = summed[side:, side:] - summed[:-side, side:] - summed[side:, :-side] + summed[:-side, :-side]
    usable = np.flatnonzero(inside > settings.least_skin * side * side)
    if usable.size == 0:
        raise BadInput(f"no patch of {side} pixels holds enough skin; take smaller patches or larger images.")
    chosen = rng.choice(usable, settings.patches)
    return np.stack(np.divmod(chosen, inside.shape[1]), axis=1).astype(np.int32)
