"""Captures under coloured LEDs: where they come from, and how their colours are brought to one brightness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.model import COLOURS, Band, BoolArray, Capture, FloatArray, Rig
from splitknit.recipe.compose import COMPOSED, composed
from splitknit.recipe.presets import PipelineSettings

_ROUNDS = 200
"""At most: with LEDs of each colour all around the finger a handful is enough."""
_SETTLED = 1e-6
_SAMPLE = 40_000


def as_lit(capture: Capture, settings: PipelineSettings) -> tuple[Capture, tuple[str, ...]]:
    """The capture under the lights that the settings ask for, and what is to be said about it.

    Raises
    ------
    BadInput
        If coloured exposures are to be put together from white images that are grey or too few.
    """
    white = capture.bands["white"]
    if settings.lights.compose == 0 or white.colours:
        return capture, ()
    exposures = max(1, min(settings.lights.compose, len(white.leds) // len(COLOURS)))
    words = "one coloured exposure was" if exposures == 1 else f"{exposures} coloured exposures were"
    return composed(capture, exposures), (f"{words} {COMPOSED}",)


def balanced(stack: FloatArray, rig: Rig, band: Band, mask: BoolArray) -> FloatArray:
    """Images (L, h, w) of coloured LEDs divided by how bright the finger is in each colour.

    One factor a colour: the skin's colour is taken to be the same everywhere, its brightness and shape are not. Factors
    and Lambertian surface are fitted to each other in turns, and the geometric mean of the factors is one.
    """
    return stack / colour_factors_of(stack, rig, band, mask).astype(np.float32)[:, None, None]


def colour_factors_of(stack: FloatArray, rig: Rig, band: Band, mask: BoolArray) -> NDArray[np.float64]:
    """(L,) brightness of the finger in the colour of each image of a `stack` (L, h, w)."""
    lights = rig.select(band.lights).light_vectors()
    colour = np.array([rig.leds[group[0]].colour for group in band.lights])
    seen = stack.reshape(len(stack), -1)[:, mask.ravel()].astype(np.float64)
    return colour_factors(seen[:, :: max(1, seen.shape[1] // _SAMPLE)], lights, colour)


def colour_factors(
    seen: NDArray[np.float64], lights: NDArray[np.float64], colour: NDArray[np.str_]
) -> NDArray[np.float64]:
    """(L,) brightness of the skin in the colour of each light, by alternating least squares.

    Parameters
    ----------
    seen : (L, n) light of n pixels
    lights : (L, 3)
    colour : (L,) names
    """
    names = np.unique(colour)
    factors = np.ones(len(lights))
    for name in names:
        own = colour == name
        factors[own] = seen[own].mean() / max(float(lights[own, 2].mean()), 1e-6)
    for _ in range(_ROUNDS):
        factors /= np.exp(np.mean(np.log(np.maximum(factors, 1e-6))))
        model, before = factors[:, None] * lights, factors.copy()
        shading = lights @ (np.linalg.pinv(model) @ seen)
        for name in names:
            own = colour == name
            factors[own] = float((seen[own] * shading[own]).sum() / max((shading[own] ** 2).sum(), 1e-12))
        if float(np.abs(factors / before - 1.0).max()) < _SETTLED:
            break
    factors = np.maximum(factors, 1e-6)
    return np.asarray(factors / np.exp(np.mean(np.log(factors))))
