"""Dust on the skin: how many grains of what size, and where they and their shadows lie in the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, Camera, FloatArray
from splitknit.simulator.coat import Grains

MOST_MG_PER_CM2 = 0.64
"""Most outdoor dust that adheres to the skin of young adults (Changchun, China; indoor dust: 0.35)."""
MEDIAN_UM = 20.0
"""Median diameter of the grains, by number; with the spread below the mean by area is 47 um. Dust under 100 um sticks
to skin, above 250 um it does not (Cao et al. 2012)."""
SPREAD = 1.8
"""Geometric standard deviation of the diameters."""
LARGEST_UM = 250.0
DENSITY_MG_PER_MM3 = 2.0
"""Of soil and house dust: 1.5 to 2.6."""
ALBEDO = (0.08, 0.6)
"""Of single grains, even between them: soot and soil to flour and skin scales."""


def draw_grains(rng: np.random.Generator, mask: BoolArray, nz: FloatArray, camera: Camera, severity: float) -> Grains:
    """Strew grains evenly over the skin that the camera sees.

    Parameters
    ----------
    mask, nz : (H, W)
        The finger, and the z component of its shape's normals: a pixel on a slant shows more skin.
    severity : 0 to 1
        Share of `MOST_MG_PER_CM2`.
    """
    spread = float(np.log(SPREAD))
    volume = np.pi / 6.0 * (1e-3 * MEDIAN_UM) ** 3 * float(np.exp(4.5 * spread**2))
    per_mm2 = severity * MOST_MG_PER_CM2 / 100.0 / (volume * DENSITY_MG_PER_MM3)
    rows, columns = mask.shape
    # drawn over the whole frame in mm and then thinned, so that every scale of the picture shows the same dust
    width, height = columns / camera.px_per_mm, rows / camera.px_per_mm
    steep = 4.0
    count = int(rng.poisson(steep * per_mm2 * width * height))
    place = rng.random((2, count))
    column, row = place[0] * columns - 0.5, place[1] * rows - 0.5
    diameter = 1e-3 * MEDIAN_UM * np.exp(spread * rng.standard_normal(count))
    albedo = rng.uniform(*ALBEDO, count)
    chance = rng.random(count)
    i = np.clip(np.rint(row).astype(np.intp), 0, rows - 1)
    j = np.clip(np.rint(column).astype(np.intp), 0, columns - 1)
    skin = mask[i, j] & (chance < 1.0 / (steep * np.maximum(nz[i, j], 1.0 / steep)))
    keep = skin & (diameter < 1e-3 * LARGEST_UM)
    return Grains(column[keep], row[keep], 0.5 * diameter[keep] * camera.px_per_mm, albedo[keep])


def stamp(
    shape: tuple[int, int],
    column: NDArray[np.float64],
    row: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    value: NDArray[np.float64] | float = 1.0,
) -> NDArray[np.float64]:
    """(h, w) sum of discs times their values, each with its own area; may exceed 1 where many overlap."""
    reach = np.ceil(radius_px + 0.5).astype(np.intp)
    values = np.broadcast_to(np.asarray(value, dtype=np.float64), radius_px.shape)
    pad = int(reach.max()) + 1 if reach.size else 1
    canvas = np.zeros((shape[0] + 2 * pad, shape[1] + 2 * pad))
    flat = canvas.ravel()
    for size in np.unique(reach):
        some = reach == size
        x, y, r, v = column[some], row[some], radius_px[some], values[some]
        ix, iy = np.rint(x).astype(np.intp), np.rint(y).astype(np.intp)
        near = (ix >= -pad + size) & (ix < shape[1] + pad - size) & (iy >= -pad + size) & (iy < shape[0] + pad - size)
        x, y, r, v, ix, iy = x[near], y[near], r[near], v[near], ix[near], iy[near]
        steps = [(dy, dx) for dy in range(-size, size + 1) for dx in range(-size, size + 1)]
        parts = [np.clip(0.5 + np.maximum(r, 0.5) - np.hypot(ix + dx - x, iy + dy - y), 0.0, 1.0) for dy, dx in steps]
        scale = v * np.pi * r * r / np.maximum(np.sum(parts, axis=0), 1e-9)
        for (dy, dx), part in zip(steps, parts, strict=True):
            at = (iy + dy + pad) * canvas.shape[1] + ix + dx + pad
            flat += np.bincount(at, weights=part * scale, minlength=flat.size)
    return canvas[pad : pad + shape[0], pad : pad + shape[1]]


def sphere_brightness(phase_rad: FloatArray) -> FloatArray:
    """Mean radiance of a matt sphere of albedo one, over that of a white card that faces the light.

    References
    ----------
    Schoenberg 1929, in Handbuch der Astrophysik 2: the phase function of a Lambertian sphere.
    """
    cosine = np.cos(phase_rad)
    return np.asarray(2.0 / 3.0 * (np.sin(phase_rad) + (np.pi - phase_rad) * cosine) / np.pi, dtype=np.float32)
