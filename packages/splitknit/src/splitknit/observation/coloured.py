"""Captures under coloured LEDs: where they come from, and how their colours are brought to one
brightness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band, Capture
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.view import lens_shading
from splitknit.model import COLOURS, Array, BoolArray, FloatArray, Rig
from splitknit.observation.light import Light
from splitknit.observation.stored import stored_values
from splitknit.settings import Checked, Limits


@dataclass(frozen=True, slots=True)
class LightsSettings(Checked):
    """What is assumed of the lights."""

    compose: Annotated[int, Limits(0, 3)] = 0
    """Number of coloured exposures to compose (Lin's case), each of up to three white images; 0:
    images as they are."""
    balance: bool = False
    """Divide the images of each colour by the finger's mean brightness in that colour."""
    places: Literal["auto", "stated"] = "auto"
    """``auto``: lights of a thing that are stated as directions get places where the ground beside
    it shows that they are near; ``stated``: they are taken as distant."""


def as_lit(capture: Capture, settings: LightsSettings) -> tuple[Capture, tuple[Finding, ...]]:
    """The capture under the lights that the settings require, and notes; BadInput as
    :func:`composed`."""
    white = capture.bands["white"]
    if settings.compose == 0 or capture.rig.colours_of(white.leds):
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


def balanced(stack: FloatArray, rig: Rig, mask: BoolArray) -> FloatArray:
    """Images (L, h, w) of coloured LEDs divided by how bright the finger is in each colour;
    `rig.leds[k]` lights image k.

    One factor a colour: the skin's colour is taken to be the same everywhere, its brightness and
    shape are not. Factors and Lambertian surface are fitted to each other in turns, and the
    geometric mean of the factors is one.
    """
    return stack / colour_factors(stack, rig, mask).astype(np.float32)[:, None, None]


def colour_factors(stack: FloatArray, rig: Rig, mask: BoolArray) -> Array:
    """(L,) brightness of the finger in the colour of each image of a `stack` (L, h, w), by least
    squares; `rig.leds[k]` lights image k."""
    lights = rig.light_vectors()
    colour = np.array([led.colour for led in rig.leds])
    pixels = stack.reshape(len(stack), -1)[:, mask.ravel()].astype(np.float64)
    pixels = pixels[:, :: max(1, pixels.shape[1] // 40_000)]
    names = np.unique(colour)
    factors = np.ones(len(lights))
    for name in names:
        own = colour == name
        factors[own] = pixels[own].mean() / max(float(lights[own, 2].mean()), 1e-6)
    for _ in range(200):  # with LEDs of each colour all around the finger a handful is enough
        factors /= np.exp(np.mean(np.log(np.maximum(factors, 1e-6))))
        before = factors.copy()
        shading = lights @ (np.linalg.pinv(factors[:, None] * lights) @ pixels)
        for name in names:
            own = colour == name
            factors[own] = float(
                (pixels[own] * shading[own]).sum() / max((shading[own] ** 2).sum(), 1e-12)
            )
        if float(np.abs(factors / before - 1.0).max()) < 1e-6:
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
_BLACK = 0.02
"""Stored level of no light in composed exposures, so that noise below it is kept."""


def composed(capture: Capture, exposures: int = 2) -> Capture:
    """Put a capture under coloured LEDs together from one of at least 3 x `exposures` (1 to 3)
    white images in colour.

    The red channel of image i, the green one of image j and the blue one of image k become one
    exposure (16 bits), mixed as the IMX219's pixels mix coloured LEDs
    (:data:`splitknit.nominal.CROSSTALK`). Three things are not as they would be: a channel under a
    white LED sees a broad band where a coloured LED is a line; what a finger moved between the
    white shots is within an exposure; and each channel has the noise of its own shot. Raises
    BadInput if the white images are grey or too few.
    """
    from splitknit.nominal import CROSSTALK, shared_exposures

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
        images.append(_exposure(white, capture, shots, mixing))
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
        black_level=np.full(exposures, float(stored_values(np.array(_BLACK), capture.encoding))),
    )
    return replace(capture, rig=rig, bands={**capture.bands, "white": band})


def _exposure(white: Band, capture: Capture, shots: list[int], mixing: Array) -> NDArray[np.uint16]:
    """(H, W, 3) stored values of one exposure, clipped where one of its channels was."""
    camera = capture.rig.camera
    part = Light(white, capture.rig, capture.encoding).of_images(shots)
    light = part.stack
    shortest = np.float32(white.exposure.min())
    own = np.stack([light[c, c] for c in range(3)]) * shortest
    levels = part.clips_at * shortest
    mixed = np.moveaxis(np.tensordot(mixing.astype(np.float32), own, axes=1), 0, 2)
    if camera.shading:
        mixed *= lens_shading(camera.shading, camera.image_size)[..., None]
    mixed += _BLACK
    for c in range(3):
        mixed[own[c] >= levels[c], c] = 1.0
    return stored_values(mixed, capture.encoding)
