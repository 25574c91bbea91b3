"""From slopes to heights: three integrators on a bump with ridges that the image's border cuts.

    python examples/plot_integrators.py [--noise 0.02]

Frankot-Chellappa on a zero-filled rectangle bends the surface; with mirror padding it does not;
masked least squares uses only what is inside the mask. Shapelets give the ridges alone, with unit
gain in their pass band.
"""

from __future__ import annotations

import argparse

import numpy as np

from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelets

Array = np.ndarray


def ridged_bump(
    size: int = 256, period_px: float = 16.0
) -> tuple[Array, Array, Array, Array, Array]:
    """Height, its ridges, slopes dz/dx and dz/dy (y up), and mask; heights in pixels."""
    rows, columns = np.mgrid[:size, :size].astype(np.float64)
    x, y = columns - 0.5 * size, 0.7 * size - rows  # y up; the lower border cuts the bump
    width = 0.42 * size
    dome = 0.5 * width * np.exp(-0.5 * (x**2 + (0.6 * y) ** 2) / (0.6 * width) ** 2)
    wave = 2 * np.pi / period_px
    ridge = 1.2 * np.sin(wave * y)
    slope_x = -x / (0.6 * width) ** 2 * dome
    slope_y = -0.36 * y / (0.6 * width) ** 2 * dome + 1.2 * wave * np.cos(wave * y)
    mask = x**2 + (0.6 * y) ** 2 < width**2
    return dome + ridge, ridge, slope_x, slope_y, mask


def rms(error: Array, mask: Array) -> float:
    """Root mean square inside the mask, mean removed."""
    return float(np.std(error[mask]))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--noise", type=float, default=0.0, help="standard deviation of noise on the slopes"
    )
    options = parser.parse_args(arguments)
    height, ridge, slope_x, slope_y, mask = ridged_bump()
    rng = np.random.default_rng(0)
    p, q = (
        (s + options.noise * rng.standard_normal(s.shape)).astype(np.float32)
        for s in (slope_x, slope_y)
    )
    p, q = np.where(mask, p, 0), np.where(mask, q, 0)
    print(
        f"{height.shape[0]} x {height.shape[1]} pixels, height {np.ptp(height[mask]):.0f} px; rms"
        " error in pixels:"
    )
    print(
        "  Frankot-Chellappa, zero-filled  "
        f" {rms(frankot_chellappa(p, q, mask) - height, mask):.3f}"
    )
    mirrored = frankot_chellappa(p, q, mask, padding="mirror")
    print(f"  Frankot-Chellappa, mirrored      {rms(mirrored - height, mask):.3f}")
    print(f"  Poisson, masked least squares    {rms(poisson(p, q, mask) - height, mask):.3f}")
    inner = (
        mask
        & np.roll(mask, 24, 0)
        & np.roll(mask, -24, 0)
        & np.roll(mask, 24, 1)
        & np.roll(mask, -24, 1)
    )
    for scales in (3, 4, 5):
        estimate = shapelets(p, q, mask, ShapeletSettings(scales=scales))
        e = estimate[inner] - estimate[inner].mean()
        t = ridge[inner] - ridge[inner].mean()
        print(
            f"  shapelets, {scales} scales: gain at the ridges {np.sum(e * t) / np.sum(t * t):.2f}"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
