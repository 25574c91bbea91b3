"""The relief by a network that has seen what skin does to light, and the glare that goes with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splitknit.model import FloatArray
from splitknit.skin.bands import BandImages
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.estimate import ReliefEstimate
from splitknit.skin.facets import Facets
from splitknit.skin.features import LEAST_LIGHTS, RIDGE_BAND_MM, azimuth_waves, features
from splitknit.skin.grid import Grid
from splitknit.skin.light import FineLight, slant_of, trust_of
from splitknit.skin.shape_features import shape_features

Network = Callable[[FloatArray], FloatArray]
"""From (32, h, w) features to (9, h, w): relief, seven waves of the glare, logarithm of the relief's variance."""

SHAPE_SLOPE = np.float32(0.1)
"""Unit of the slopes that the network of the shape adds."""
RELIEF_MM = np.float32(0.02)
"""Unit of the network's relief."""
GLARE = np.float32(0.05)
"""Unit of the network's glare, over the green channel's brightness."""


@dataclass(frozen=True, slots=True)
class Networks:
    """What has been learned."""

    relief: Network
    shape: Network | None = None
    """From (32, h, w) of :func:`splitknit.skin.shape_features.shape_features` to two slopes."""


MOST_UNEVEN = 10.0
"""Condition of the waves up to the second at the lights' azimuths; one for a regular ring."""
PITCH_MM = (0.017, 0.041)
"""Pixels that the networks have learned to read, about."""


def can_learn(band: BandImages, pitch_mm: float) -> bool:
    """Whether a band shows what the networks need: three colours, enough lights all around, and fine pixels."""
    if len(band.channels) != 3 or band.stack.shape[1] < LEAST_LIGHTS:
        return False
    around = np.linalg.cond(azimuth_waves(band.rig, 2)) < MOST_UNEVEN
    return bool(around) and PITCH_MM[0] <= pitch_mm <= PITCH_MM[1]


def relief_by_network(  # noqa: PLR0917
    white: BandImages,
    grid: Grid,
    smooth_mm: FloatArray,
    light: FineLight,
    network: Network,
    found: FloatArray | None = None,
) -> ReliefEstimate:
    """Relief and glare as the network draws them.

    Parameters
    ----------
    white : three channels, six lights at least, see :func:`can_learn`
    grid : fine grid
    smooth_mm : (h, w) the shape without the relief
    light : lights on that shape
    network : see :data:`Network`
    found : see :func:`splitknit.skin.features.features`
    """
    seen = features(white, grid, smooth_mm, light, found)
    drawn = network(seen.fields)
    trust = trust_of(slant_of(smooth_mm, grid.pitch_mm), grid)
    relief = drawn[0] * RELIEF_MM
    relief = (relief - grid.smooth(relief, grid.mask, RIDGE_BAND_MM)) * trust
    variance = np.exp(np.clip(drawn[8], -8, 4)) * RELIEF_MM * RELIEF_MM
    # where nothing is drawn, the relief is as high as elsewhere
    inner = trust > np.float32(0.9)
    typical = np.float32(np.sqrt((relief[inner] ** 2).mean())) if inner.any() else RELIEF_MM
    deviation = np.hypot(np.sqrt(variance) * trust, typical * (1 - trust)) * grid.mask
    power, error = float((relief[inner] ** 2).mean()), float(variance[inner].mean())
    size = np.sqrt((light.vectors * light.vectors).sum(axis=1))
    waves = azimuth_waves(white.rig, 3)
    glare = np.tensordot(waves, drawn[1:8] * GLARE, 1) * seen.level[1] * size
    return ReliefEstimate(
        relief_mm=relief.astype(np.float32),
        deviation_mm=deviation.astype(np.float32),
        spread=float(np.sqrt(1 + error / max(power, 1e-12))),
        trust=trust,
        albedo=seen.level[0] * grid.mask,
        glare=(np.maximum(glare, 0) * grid.mask).astype(np.float32),
        facts={"relief_by": "network"},
    )


def slopes_by_network(  # noqa: PLR0917
    bands: tuple[BandImages, ...],
    grid: Grid,
    height_mm: FloatArray,
    skin: dict[str, Diffusion],
    facets: Facets,
    network: Network,
) -> tuple[FloatArray, FloatArray]:
    """Slopes (h, w) along x and y that the shape lacks. Parameters as for :func:`shape_features`."""
    drawn = network(shape_features(bands, grid, height_mm, skin, facets)) * SHAPE_SLOPE * grid.mask
    return drawn[0], drawn[1]
