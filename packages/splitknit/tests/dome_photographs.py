"""The rough dome as the methods see it: photographs in which the object was found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rough_dome import scene
from splitknit.methods.photographs import FingerBand, FingerPhotographs, photographs_of
from splitknit.model import Camera
from splitknit.observation.plain import capture_of_arrays
from splitknit.presets import PRESETS

PX_PER_MM = 10.0
COLOUR = (0.9, 0.6, 0.3)
"""Red, green and blue of a thing that has a colour."""


def dome(
    preset: str = "ea",
    *,
    side: int = 60,
    px_per_mm: float = PX_PER_MM,
    colour: Any = None,
    pixels: np.ndarray | None = None,
    **capture: Any,
) -> FingerPhotographs:
    """Photographs (8, side, side) of 16 bits, with a `colour` in red, green and blue, or given as
    `pixels`; `capture`: fields of the capture that differ."""
    stack, lights, mask = scene(0, side)
    if pixels is None:
        stack = np.clip(0.6 * stack, 0, 1)
        if colour is not None:
            stack = stack[..., None] * np.asarray(colour)
        pixels = np.rint(stack * 65535).astype(np.uint16)
    photographed, _ = capture_of_arrays(pixels, lights, mask, px_per_mm, np.ones(len(lights)))
    photographs = photographs_of(photographed, PRESETS[preset].finding())
    observation = replace(photographs.observation, **capture)
    return replace(photographs, observation=observation)


def stored_as(band: FingerBand, **changes: Any) -> FingerBand:
    """The band's light as if its photographs had been stored otherwise."""
    light = replace(band.light, stored=replace(band.light.stored, **changes))
    return replace(band, light=light)


def under(band: FingerBand, **changes: Any) -> FingerBand:
    """The band's light under another rig."""
    return replace(band, light=replace(band.light, built=replace(band.light.built, **changes)))


def with_nir(photographs: FingerPhotographs, shift: int = 0) -> FingerPhotographs:
    """The same photographs, also as a near-infrared band, each under the light `shift` before."""
    observation = photographs.observation
    leds = observation.rig.leds
    rig = replace(observation.rig, leds=(*leds, *(replace(led, band="nir") for led in leds)))
    white = replace(observation.white, built=rig)
    own = tuple((len(leds) + light,) for light in range(len(leds)))
    pixels = np.roll(white.stored.pixels, shift, axis=0)
    nir = replace(white, stored=replace(white.stored, name="nir", leds=own, pixels=pixels))
    both = replace(observation, rig=rig, bands={"white": white, "nir": nir})
    return replace(photographs, observation=both)


def from_40_mm(camera: Camera) -> Camera:
    """The camera as a perspective one, 40 mm above the plane."""
    rows, columns = camera.image_size
    focal_px = 40.0 * camera.px_per_mm
    matrix = np.array(
        [[focal_px, 0, (columns - 1) / 2], [0, focal_px, (rows - 1) / 2], [0, 0, 1]], dtype=float
    )
    return replace(camera, model="perspective", height_mm=40.0, matrix=matrix)
