"""The relief from the shading of one channel, behind scattering, on the fine grid: where the relief
network does not run.

The slopes that photometric stereo finds beyond the shape's are those of the relief through the
skin's transfer function M, and noise. The Wiener filter M / (M^2 + n) inverts M where it passes
light. A filter over all channels, which separated specular reflection and noise by their spectra,
was worse: ridge errors of 20 to 169 um on ten captures, of 13 to 30 um by one channel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.grid import BandImages, Grid, Slopes
from splitknit.skin.light import Lighting, slant_of, trust_of
from splitknit.skin.shape import residual_slopes

CROSSOVER_MM = 0.3
"""Standard deviation of the Gaussian that leaves the shape's frequencies to the coarse grid. Chosen
on: judgement. Range: 0.3 to 0.42 (validation/parameters)."""


def high_pass(grid: Grid, sigma_mm: float = CROSSOVER_MM) -> FloatArray:
    """Fraction of the fine grid at each frequency; the coarse grid has the rest."""
    return np.asarray(1 - np.exp(-0.5 * (grid.omega[2] * sigma_mm) ** 2))


KNIT_MM = 0.5
"""Standard deviation of the Gaussian that separates relief and shape in the result. Chosen on:
judgement. Range: 0.35 to 0.5 (validation/parameters)."""


def detail_of(shape_mm: FloatArray, trust: FloatArray, grid: Grid) -> FloatArray:
    """The ridge band (h, w) of the coarse shape: creases and what else is finer than `KNIT_MM`.
    Taken from the slopes less their local mean, so that the curvature at the outline is not taken
    for a ridge.
    """
    slopes = height_gradients(shape_mm, grid.pitch_mm)
    whole = _integrated(grid, slopes, trust, KNIT_MM)
    return grid.inverse(whole * high_pass(grid, KNIT_MM)) * grid.mask


def _integrated(
    grid: Grid, slopes: Slopes, trust: FloatArray, sigma_mm: float
) -> NDArray[np.complex64]:
    """Spectrum of the height whose slopes are these, less their local mean, so that what belongs to
    the coarse grid does not ring at the outline."""
    x, y = (
        grid.forward((slope - grid.smooth(slope, grid.mask, sigma_mm)) * trust) for slope in slopes
    )
    wx, wy, omega = grid.omega
    square = omega * omega
    square[0, 0] = 1.0
    return np.asarray((wx * x + wy * y) * (-1j / square), dtype=np.complex64)


@dataclass(frozen=True, slots=True, eq=False)
class ReliefEstimate:
    """Ridges on the fine grid, beside a smooth shape."""

    # (h, w) along the line of sight, free of its local mean, zero outside the mask
    relief_mm: FloatArray
    deviation_mm: FloatArray  # (h, w) its standard deviation
    trust: FloatArray  # (h, w) in [0, 1]: fades out towards grazing slopes and the outline
    albedo: FloatArray  # (h, w) brightness of one channel of the white band, relative
    level: FloatArray | None = None
    """(h, w) brightness of the second channel, specular reflection included, where a network
    estimated the relief."""
    output: FloatArray | None = None
    """(9, h, w) output of that network."""
    facts: Mapping[str, Any] = field(default_factory=dict)


_NOISE = 0.04
"""Power of noise and model error over the slopes'. Chosen on: simulated fingers (five), path-traced
ones (two). Range: 0.02 to 0.1."""
_MODEL_ERROR = 0.85
"""Error of the relief over its own local rms height. Chosen on: the same fingers."""


def relief_by_shading(
    band: BandImages, grid: Grid, smooth_mm: FloatArray, light: Lighting, skin: Diffusion
) -> ReliefEstimate:
    """Relief that explains the slopes of the band's last channel, blue, which scatters least.

    `smooth_mm`: (h, w) the shape without the relief; `light`: on it; `skin`: the channel's transfer
    function.
    """
    trust = trust_of(slant_of(smooth_mm, grid.pitch_mm), grid)
    (measured,) = pseudo_normals(
        band.stack[-1:],
        band.rig,
        smooth_mm,
        grid.mask,
        light.trust,
        view=grid.view,
        entering=light.entering,
    )
    normals = normals_from_gradients(*height_gradients(smooth_mm, grid.pitch_mm))
    transfer = grid.sampled(skin)
    spectrum = grid.forward(np.moveaxis(normals * grid.mask[..., None], -1, 0), extend=True)
    predicted = np.moveaxis(grid.inverse(spectrum * transfer), 0, -1)
    slopes = residual_slopes(measured, predicted, grid)
    kept = high_pass(grid) * transfer / (transfer * transfer + np.float32(_NOISE))
    relief = grid.inverse(_integrated(grid, slopes, trust, CROSSOVER_MM) * kept) * grid.mask
    rms = np.sqrt(np.maximum(grid.smooth(relief * relief, grid.mask, 0.6), 0.0))
    return ReliefEstimate(
        relief_mm=relief,
        deviation_mm=(np.float32(_MODEL_ERROR) * rms).astype(np.float32),
        trust=trust,
        albedo=np.sqrt((measured**2).sum(axis=-1)),
        facts={"relief_by": "shading"},
    )
