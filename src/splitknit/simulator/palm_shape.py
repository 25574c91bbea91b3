"""The palm without its skin relief: a gently curved sheet with the pads of thumb and little finger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PalmShape:
    """Height of the sheet: a tilted quadric and round pads."""

    tilt: tuple[float, float]
    """Slopes along x and y in the middle."""
    curvature_per_mm: tuple[float, float]
    """Along the two principal axes; positive is domed."""
    axis_rad: float
    """Of the first principal axis, counter-clockwise from x."""
    pads: tuple[tuple[float, float, float, float], ...]
    """x, y, height (negative is a hollow) and standard deviation of each, all in mm."""
    top_mm: float = 0.0
    """Subtracted from the height."""

    def on_grid(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        """Height and its slopes along x and y, (H, W) on the axes `x_mm` (W,) and `y_mm` (H,)."""
        x, y = x_mm[None, :], y_mm[:, None]
        cosine, sine = np.cos(self.axis_rad), np.sin(self.axis_rad)
        u, v = cosine * x + sine * y, cosine * y - sine * x
        first, second = self.curvature_per_mm
        height = self.tilt[0] * x + self.tilt[1] * y - 0.5 * (first * u**2 + second * v**2) - self.top_mm
        slope_x = self.tilt[0] - first * u * cosine + second * v * sine
        slope_y = self.tilt[1] - first * u * sine - second * v * cosine
        for px, py, rise, sigma in self.pads:
            bump = rise * np.exp(-0.5 * ((x - px) / sigma) ** 2) * np.exp(-0.5 * ((y - py) / sigma) ** 2)
            height = height + bump
            slope_x = slope_x - bump * (x - px) / sigma**2
            slope_y = slope_y - bump * (y - py) / sigma**2
        return height, slope_x, slope_y


def draw_shape(
    rng: np.random.Generator, half_size_mm: tuple[float, float], radius_mm: tuple[float, float]
) -> PalmShape:
    """Draw one sheet; its highest point within the patch lies on the finger plane, z = 0."""
    low, high = radius_mm
    radii = low * (high / low) ** rng.random(2)
    tilt = np.clip(0.06 * rng.standard_normal(2), -0.12, 0.12)
    pads = []
    for _ in range(int(rng.integers(2, 6))):
        sigma = float(rng.uniform(4.0, 11.0))
        # slopes of a pad stay below about 8 degrees
        rise = float(np.clip(0.1 * sigma * rng.standard_normal(), -0.2 * sigma, 0.22 * sigma))
        px, py = rng.uniform(-1.1, 1.1, 2) * half_size_mm
        pads.append((float(px), float(py), rise, sigma))
    shape = PalmShape(
        (float(tilt[0]), float(tilt[1])),
        (float(1.0 / radii[0]), float(1.0 / radii[1])),
        float(rng.uniform(0.0, np.pi)),
        tuple(pads),
    )
    grid = [np.linspace(-half, half, 201) for half in half_size_mm]
    top = float(shape.on_grid(grid[0], grid[1])[0].max())
    return PalmShape(shape.tilt, shape.curvature_per_mm, shape.axis_rad, shape.pads, top)
