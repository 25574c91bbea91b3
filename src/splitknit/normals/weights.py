"""Which lights to trust at a pixel: shadows are left out, highlights lose weight.

A light counts as shadowed where its image is darker than a part of what the brightest light gives; the rest is fitted by
least squares, and each residual, relative to the albedo, sets a new weight (iteratively reweighted least squares, Cauchy
weights). Glare and interreflection only ever add light, and shadow has been left out already: a residual below the fit is
mostly the fit's own tilt towards a highlight and is forgiven more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.check import require
from splitknit.normals.equations import shading, solve
from splitknit.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class RobustSettings:
    """How shadowed and glossy lights are found."""

    shadow: float = 0.1
    """A light is in shadow where its image, divided by its strength, is below this part of the brightest one's."""
    tolerance: float = 0.05
    """Residual, relative to the albedo, at which a light's weight has fallen to one half."""
    forgiveness: float = 2.0
    """Residuals below the fit get this many times the tolerance: light adds, it does not subtract."""
    iterations: int = 10
    """Rounds of reweighting; 0 leaves out shadows only."""

    def __post_init__(self) -> None:
        require(0 <= self.shadow < 1, f"robust.shadow must be at least 0 and below 1, but it is {self.shadow}.")
        require(
            bool(np.isfinite(self.tolerance)) and self.tolerance > 0,
            f"robust.tolerance must be a positive number, but it is {self.tolerance}.",
        )
        require(
            bool(np.isfinite(self.forgiveness)) and self.forgiveness >= 1,
            f"robust.forgiveness must be at least 1, but it is {self.forgiveness}.",
        )
        require(self.iterations >= 0, f"robust.iterations must not be negative, but it is {self.iterations}.")


def strengths(lights: FloatArray) -> FloatArray:
    """Length of every light vector: (L, 1) of (L, 3), (L, n) of (L, 3, n)."""
    length = np.sqrt(lights[:, 0] ** 2 + lights[:, 1] ** 2 + lights[:, 2] ** 2)
    return length[:, None] if lights.ndim == 2 else length


def lit_weights(images: FloatArray, lights: FloatArray, shadow: float) -> tuple[FloatArray, BoolArray]:
    """One where a light reaches the pixel and zero in shadow, (L, n), and the pixels with any shadow, (n,).

    A pixel that fewer than three lights reach keeps them all, weighted by the square of what they give: the brightest
    decide, and the system stays solvable.
    """
    strength = strengths(lights)
    relative = images / strength
    peak = np.maximum(relative.max(axis=0), np.float32(1e-20))
    lit = relative > np.float32(shadow) * peak
    count = np.count_nonzero(lit, axis=0)
    weights = lit.astype(np.float32)
    few = np.flatnonzero(count < 3)
    if few.size:
        soft = np.maximum(relative[:, few] / peak[few], np.float32(1e-3))
        weights[:, few] = soft * soft
    return weights, count < images.shape[0]


def robust_fit(images: FloatArray, lights: FloatArray, settings: RobustSettings) -> tuple[FloatArray, FloatArray]:
    """Albedo-scaled normals (3, n) and the weights (L, n) behind them, from images (L, n).

    `lights` is (L, 3), or (L, 3, n) where they differ from pixel to pixel.
    """
    usable, _ = lit_weights(images, lights, settings.shadow)
    g = solve(images, lights, usable)
    weights = usable
    if settings.iterations == 0:
        return g, weights
    strength = strengths(lights)
    doubtful = np.flatnonzero(_misfit(images, lights, strength, usable, g, settings).max(axis=0) > 0.25)
    if doubtful.size:
        part = images[:, doubtful]
        part_lights = lights if lights.ndim == 2 else lights[:, :, doubtful]
        part_strength = strength if lights.ndim == 2 else strength[:, doubtful]
        part_usable = usable[:, doubtful]
        part_g = g[:, doubtful]
        part_weights = part_usable
        for _ in range(settings.iterations):
            misfit = _misfit(part, part_lights, part_strength, part_usable, part_g, settings)
            part_weights = part_usable / (1 + misfit * misfit)
            part_g = solve(part, part_lights, part_weights)
        g[:, doubtful] = part_g
        weights[:, doubtful] = part_weights
    return g, weights


def _misfit(  # noqa: PLR0917
    images: FloatArray,
    lights: FloatArray,
    strength: FloatArray,
    usable: FloatArray,
    g: FloatArray,
    settings: RobustSettings,
) -> FloatArray:
    """Size of every residual in units of its tolerance, (L, n); zero where a light is not used."""
    albedo = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    residual = images - shading(g, lights)
    residual /= strength * np.maximum(albedo, np.float32(1e-20)) * np.float32(settings.tolerance)
    above = np.maximum(residual, np.float32(0.0))
    below = np.minimum(residual, np.float32(0.0))
    return (above - below * np.float32(1 / settings.forgiveness)) * (usable > 0)
