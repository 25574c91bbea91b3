"""Captures under coloured LEDs: where they come from, and how their colours are brought to one
brightness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.band import linear_channels, saturation_levels, srgb_code
from splitknit.imaging.parameters import (
    BALANCE_PIXELS,
    BALANCE_ROUNDS,
    BALANCE_SETTLED,
    COMPOSED_BLACK,
)
from splitknit.model import COLOURS, Array, Band, BoolArray, Capture, FloatArray, Rig
from splitknit.settings import Checked, Limits


@dataclass(frozen=True, slots=True)
class LightsSettings(Checked):
    """Coloured LEDs: Lin's case only."""

    compose: Annotated[int, Limits(0, 3)] = 0
    """Number of coloured exposures to compose, each of up to three white images; 0: images as they
    are."""
    balance: bool = False
    """Divide the images of each colour by the finger's mean brightness in that colour."""


def as_lit(capture: Capture, settings: LightsSettings) -> tuple[Capture, tuple[Finding, ...]]:
    """The capture under the lights that the settings require, and notes; BadInput as
    :func:`composed`."""
    white = capture.bands["white"]
    if settings.compose == 0 or white.colours:
        return capture, ()
    require(
        not white.polarisation,
        "coloured exposures are put together from images without polarising films; this capture is"
        " polarised; choose another preset, or `settings` lights.compose=0.",
    )
    exposures = max(1, min(settings.compose, len(white.leds) // len(COLOURS)))
    words = (
        "one coloured exposure was" if exposures == 1 else f"{exposures} coloured exposures were"
    )
    return composed(capture, exposures), (Finding("composed-colours", f"{words} {COMPOSED}"),)


def balanced(stack: FloatArray, rig: Rig, band: Band, mask: BoolArray) -> FloatArray:
    """Images (L, h, w) of coloured LEDs divided by how bright the finger is in each colour.

    One factor a colour: the skin's colour is taken to be the same everywhere, its brightness and
    shape are not. Factors and Lambertian surface are fitted to each other in turns, and the
    geometric mean of the factors is one.
    """
    return stack / colour_factors_of(stack, rig, band, mask).astype(np.float32)[:, None, None]


def colour_factors_of(stack: FloatArray, rig: Rig, band: Band, mask: BoolArray) -> Array:
    """(L,) brightness of the finger in the colour of each image of a `stack` (L, h, w), by least
    squares."""
    lights = rig.select(band.lights).light_vectors()
    colour = np.array([rig.leds[group[0]].colour for group in band.lights])
    seen = stack.reshape(len(stack), -1)[:, mask.ravel()].astype(np.float64)
    seen = seen[:, :: max(1, seen.shape[1] // BALANCE_PIXELS)]
    names = np.unique(colour)
    factors = np.ones(len(lights))
    for name in names:
        own = colour == name
        factors[own] = seen[own].mean() / max(float(lights[own, 2].mean()), 1e-6)
    for _ in range(BALANCE_ROUNDS):
        factors /= np.exp(np.mean(np.log(np.maximum(factors, 1e-6))))
        before = factors.copy()
        shading = lights @ (np.linalg.pinv(factors[:, None] * lights) @ seen)
        for name in names:
            own = colour == name
            factors[own] = float(
                (seen[own] * shading[own]).sum() / max((shading[own] ** 2).sum(), 1e-12)
            )
        if float(np.abs(factors / before - 1.0).max()) < BALANCE_SETTLED:
            break
    factors = np.maximum(factors, 1e-6)
    return np.asarray(factors / np.exp(np.mean(np.log(factors))))


# A coloured capture put together from a white one: what three coloured LEDs in one exposure would
# about have given.

COMPOSED = (
    "put together from images under white LEDs: broad bands instead of lines, and shots that were"
    " taken one after the other share an exposure."
)
"""Note of every result that does not come from coloured LEDs."""


def composed(capture: Capture, exposures: int = 2) -> Capture:
    """Put a capture under coloured LEDs together from one of at least 3 x `exposures` (1 to 3)
    white images in colour.

    The red channel of image i, the green one of image j and the blue one of image k become one
    exposure (16 bits), mixed as the IMX219's pixels mix coloured LEDs
    (:data:`splitknit.model.CROSSTALK`). Three things are not as they would be: a channel under a
    white LED sees a broad band where a coloured LED is a line; what a finger moved between the
    white shots is within an exposure; and each channel has the noise of its own shot. Raises
    BadInput if the white images are grey or too few.
    """
    from splitknit.model import CROSSTALK, shared_exposures  # the twin's sensor

    white = capture.bands["white"]
    require(
        white.pixels.shape[3] == 3,
        "coloured exposures are put together from colour images only, but the white band is grey;"
        " capture in colour.",
    )
    count = 3 * exposures
    x, y, _ = capture.rig.select(white.leds).light_vectors().T
    around = np.argsort(np.arctan2(y, x) % (2 * np.pi), kind="stable").tolist()
    require(
        len(around) >= count,
        f"{exposures} exposures of three colours need {count} white images, but there are"
        f" {len(around)}.",
    )
    chosen = [around[round(k * len(around) / count)] for k in range(count)]
    mixing = np.asarray(CROSSTALK)
    leds = list(capture.rig.leds)
    images = []
    groups = []
    for places in shared_exposures(exposures):
        shots = [chosen[place] for place in places]
        images.append(_exposure(white, capture.encoding, shots, mixing))
        first = len(leds)
        for k, colour in zip(shots, COLOURS, strict=True):
            leds.extend(replace(leds[index], colour=colour) for index in white.leds[k])
        groups.append(tuple(range(first, len(leds))))
    camera = replace(capture.rig.camera, crosstalk=mixing)
    rig = Rig(camera, tuple(leds), capture.rig.provenance, capture.rig.mirrors)
    band = Band(
        name="white",
        pixels=np.stack(images),
        leds=tuple(groups),
        exposure=np.full(exposures, float(white.exposure.min())),
        black_level=np.full(exposures, float(_stored(np.array(COMPOSED_BLACK), capture.encoding))),
        shading=(),
        colours=rig.colours_of(groups),
        crosstalk=mixing,
    )
    return replace(capture, rig=rig, bands={**capture.bands, "white": band})


def _exposure(white: Band, encoding: str, shots: list[int], mixing: Array) -> NDArray[np.uint16]:
    """(H, W, 3) stored values of one exposure, clipped where one of its channels was."""
    chosen: dict[str, Any] = {
        name: getattr(white, name)[shots] for name in ("pixels", "exposure", "black_level")
    }
    part = replace(white, leds=tuple(white.leds[k] for k in shots), files=(), **chosen)
    light = linear_channels(part, encoding, COLOURS)
    shortest = np.float32(white.exposure.min())
    own = np.stack([light[c, c] for c in range(3)]) * shortest
    levels = saturation_levels(part, encoding) * shortest
    mixed = np.moveaxis(np.tensordot(mixing.astype(np.float32), own, axes=1), 0, 2)
    mixed += COMPOSED_BLACK
    for c in range(3):
        mixed[own[c] >= levels[c], c] = 1.0
    return _stored(mixed, encoding)


def _stored(light: FloatArray, encoding: str) -> NDArray[np.uint16]:
    light = np.clip(light, 0.0, 1.0)
    code = srgb_code(light) if encoding == "srgb" else light
    return np.asarray(np.rint(code * 65535.0), dtype=np.uint16)
