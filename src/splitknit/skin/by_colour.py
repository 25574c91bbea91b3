"""The relief by the colours of the white band alone: a linear estimate, refined by prediction and comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.skin import relief as fine
from splitknit.skin.bands import BandImages
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.estimate import ReliefEstimate
from splitknit.skin.facets import spread_of
from splitknit.skin.grid import Grid
from splitknit.skin.light import FineLight
from splitknit.skin.local_wiener import LocalWienerSettings


@dataclass(frozen=True, slots=True)
class ColourSettings:
    """Relief and glare told apart by their colours."""

    steps: int = 2
    """Corrections of the relief in each round."""
    model_error: float = 0.5
    """Error of the relief that is not noise (glare taken for relief, flanks too steep to be resolved), as a part of the
    relief's local rms height; measured on simulated fingers, see docs/accuracy.md."""
    seed: int = 0
    """Seed of the noise that is sent through the filters to learn its spectrum."""
    denoise: LocalWienerSettings = field(default_factory=LocalWienerSettings)
    """Removal of the noise from the relief."""

    def __post_init__(self) -> None:
        require(self.steps >= 1, "metric.by_colour.steps must be positive.")
        require(self.model_error >= 0, "metric.by_colour.model_error must not be negative.")


def relief_by_colour(  # noqa: PLR0917
    white: BandImages,
    grid: Grid,
    smooth_mm: FloatArray,
    light: FineLight,
    optics: Mapping[str, Diffusion],
    other: Mapping[str, Diffusion],
    brightness: Mapping[str, float],
    before_mm: FloatArray,
    settings: ColourSettings,
) -> ReliefEstimate:
    """Relief that explains the slopes of all channels behind blur and glare.

    Parameters
    ----------
    white : the white band
    grid : fine grid
    smooth_mm : (h, w) the shape without the relief
    light : lights on that shape
    optics : assumed transfer function of each channel
    other : the same one standard deviation of the scattering away
    brightness : diffuse brightness of each channel over the prediction for an albedo of one
    before_mm : (h, w) the relief so far
    settings : ColourSettings
    """
    relief = before_mm
    measured = fine.measure(white, grid, smooth_mm, light, optics, brightness)
    for _ in range(settings.steps):
        lacking = fine.lacking_slopes(measured, grid, smooth_mm + relief)
        mix = fine.unmixing(measured, grid, with_relief(lacking.slopes, measured, grid, relief), lacking.glare)
        raw = fine.update(measured, grid, lacking.slopes, mix, relief)
        relief, noise = fine.denoise(raw, grid, mix, settings.denoise, settings.seed)
    sensitivity = abs(fine.scattering_sensitivity(measured, grid, mix, other, relief))
    height = np.sqrt(np.maximum(grid.smooth(relief * relief, grid.mask, 0.6), np.float32(0.0)))
    model = np.float32(np.hypot(sensitivity, settings.model_error)) * height
    return ReliefEstimate(
        relief_mm=relief,
        deviation_mm=np.sqrt(noise**2 + model**2).astype(np.float32),
        spread=spread_of(relief, grid, mix.fit, measured.region),
        trust=measured.trust,
        albedo=np.sqrt((measured.pseudo_normals[0] ** 2).sum(axis=-1)),
        facts={"relief_by": "colour", "gain_sensitivity": sensitivity},
    )


def with_relief(
    slopes: list[tuple[FloatArray, FloatArray]], measured: fine.Measured, grid: Grid, relief: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """The slopes that the channels would lack without the current relief."""
    if not relief.any():
        return slopes
    spectrum = grid.forward(relief)
    wx, wy, _ = grid.omega
    return [
        (x + grid.inverse(spectrum * (1j * wx) * t), y + grid.inverse(spectrum * (1j * wy) * t))
        for (x, y), t in zip(slopes, measured.transfer, strict=True)
    ]
