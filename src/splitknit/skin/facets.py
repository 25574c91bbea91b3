"""What ridges do to the shading of the shape below them.

A pixel of the coarse grid sees many facets of ridge and valley. The mean of their normals, weighted by how much of each
the camera sees, is flatter than the shape: on a slope, the flank that leans away is foreshortened or hidden. Where the
ridges are resolved they account for this by themselves. Towards the outline they are resolved less and less, although
they are as high there as elsewhere; there the distribution of facets is taken from the middle of the finger and carried
along the ridges' direction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import BoolArray, FloatArray
from splitknit.skin.colour import SpectralFit
from splitknit.skin.glare import microfacet_glare
from splitknit.skin.grid import Grid, smooth_step

RIDGES_PER_MM = (8.0, 64.0)
"""Angular frequencies (rad/mm) whose slopes belong to ridges."""
RESOLVED_DEG = (15.0, 30.0)
"""Up to the first slant ridges are taken as resolved, beyond the second as unresolved."""


@dataclass(frozen=True, slots=True, eq=False)
class Facets:
    """Slopes of the skin across its ridges, and where across is."""

    slopes: NDArray[np.float64]
    """(K,) equally likely slopes of facets against the shape, in the middle of the finger."""
    across_x: FloatArray
    """(h, w) direction across the ridges in the image, on the coarse grid; unit length, sign free."""
    across_y: FloatArray


def measure_facets(  # noqa: PLR0917
    relief_mm: FloatArray,
    shape_mm: FloatArray,
    grid: Grid,
    low: Grid,
    factor: int,
    spread: float = 1.0,
    count: int = 12,
) -> Facets:
    """Distribution and direction of the ridges' slopes.

    The distribution is that of the recovered relief where the finger faces the camera, `spread` times as wide: for what
    is known to be missing in the relief.
    """
    x, y = height_gradients(relief_mm, grid.pitch_mm)
    doubled = [grid.smooth(p, grid.mask, 0.6) for p in (x * x - y * y, 2 * x * y)]
    angle = np.float32(0.5) * np.arctan2(doubled[1], doubled[0])
    across_x, across_y = np.cos(angle), np.sin(angle)
    gx, gy = height_gradients(shape_mm, grid.pitch_mm)
    steep = 1 + gx * gx + gy * gy
    # slopes against the surface, of a relief measured along the line of sight
    tilted = (x * across_x + y * across_y) / np.sqrt(steep * (1 + (gx * across_x + gy * across_y) ** 2))
    facing = (steep < 1.25) & grid.mask & (grid.depth_mm > 1.0)
    if not facing.any():
        facing = grid.mask & (grid.depth_mm > 0.5 * grid.depth_mm.max())
    slope = tilted[facing] - tilted[facing].mean(dtype=np.float64)
    quantiles = np.quantile(slope, (np.arange(count) + 0.5) / count)
    rows, columns = low.shape
    small = [
        cv2.resize(np.ascontiguousarray(p[: rows * factor, : columns * factor]), (columns, rows), interpolation=3)
        for p in doubled
    ]
    coarse = 0.5 * np.arctan2(small[1], small[0])
    return Facets(
        np.asarray(quantiles * spread),
        np.cos(coarse).astype(np.float32),
        np.sin(coarse).astype(np.float32),
    )


MOST_SPREAD = 1.5
"""Slopes are not believed to be steeper than this many times what was recovered."""


def spread_of(relief_mm: FloatArray, grid: Grid, fit: SpectralFit, region: FloatArray) -> float:
    """How much steeper the ridges are on `region` by the relief's spectrum than in the relief itself.

    Noise is taken off the spectrum and nothing in it is shrunk.
    """
    x, y = height_gradients(relief_mm, grid.pitch_mm)
    weight = region * region
    recovered = float((weight * (x * x + y * y)).sum(dtype=np.float64)) / float(weight.sum(dtype=np.float64))
    scale = np.sqrt(max(_ridge_power(fit, grid.pitch_mm), 0.0) / max(recovered, 1e-9))
    return min(float(scale), MOST_SPREAD)


def _ridge_power(fit: SpectralFit, pitch_mm: float) -> float:
    """Mean square slope of the ridges, from the spectrum of the relief."""
    omega = fit.omega_per_mm
    ratio = float(omega[1] / omega[0])
    modes = np.pi * omega**2 * (ratio - 1 / ratio) * (pitch_mm / (2 * np.pi)) ** 2
    used = (omega >= RIDGES_PER_MM[0]) & (omega < RIDGES_PER_MM[1])
    return float((fit.signal * modes)[used].sum())


def ridged_normals(resolved: FloatArray, shape_mm: FloatArray, low: Grid, facets: Facets | None) -> FloatArray:
    """Mean normals (h, w, 3) that the camera sees on the coarse grid.

    Parameters
    ----------
    resolved : (h, w, 3)
        Block means of the normals of shape and relief together.
    shape_mm : (h, w)
        The shape alone.
    low : the coarse grid
    facets : None before there is a relief
    """
    if facets is None:
        return resolved
    x, y = height_gradients(shape_mm, low.pitch_mm)
    slant = np.rad2deg(np.arctan(np.hypot(x, y))).astype(np.float32)
    first, second = RESOLVED_DEG
    unresolved = smooth_step((slant - np.float32(first)) / np.float32(second - first))[..., None]
    expected = facet_normals(x, y, facets)
    return np.asarray((resolved + unresolved * (expected - resolved)) * low.mask[..., None], dtype=np.float32)


def facet_normals(x: FloatArray, y: FloatArray, facets: Facets) -> FloatArray:
    """Mean normals (h, w, 3) of the visible facets on a shape with the slopes `x` and `y` (y up)."""
    total = np.zeros((*x.shape, 3), dtype=np.float32)
    weight = np.zeros_like(x)
    for normal, seen in _each_facet(normals_from_gradients(x, y), facets):
        total += normal * seen[..., None]
        weight += seen
    return np.asarray(total / np.maximum(weight, np.float32(1e-6))[..., None], dtype=np.float32)


def _each_facet(normals: FloatArray, facets: Facets, step: int = 1) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield unit normals (h, w, 3) of every `step`-th facet on a shape with these normals, and what is seen of it."""
    nx, ny, nz = normals[..., 0], normals[..., 1], normals[..., 2]
    # along the ridge in the image, lifted to the surface; across it in the surface
    tx, ty = -facets.across_y, facets.across_x
    tz = np.asarray(-(nx * tx + ny * ty) / np.maximum(nz, np.float32(0.05)), dtype=np.float32)
    length = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = (np.asarray(t / length, dtype=np.float32) for t in (tx, ty, tz))
    across = np.stack([ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx], axis=-1)
    for slope in facets.slopes.astype(np.float32)[step // 2 :: step]:
        leaning = np.asarray(
            normals - slope * across, dtype=np.float32
        )  # as long as the facet's area: its z is what the camera sees of it
        yield leaning / np.sqrt(1 + slope * slope), np.maximum(leaning[..., 2], np.float32(0.0))


def mean_glare(normals: FloatArray, facets: Facets | None, lights: FloatArray, roughness: float) -> FloatArray:
    """Glare images (L, h, w) of strength one: of the shape, or the mean over its visible facets.

    Ridges spread a highlight across their direction and hardly along it.
    """
    if facets is None:
        return microfacet_glare(normals, lights, roughness)
    total = np.zeros((lights.shape[0], *normals.shape[:-1]), dtype=np.float32)
    weight = np.zeros(normals.shape[:-1], dtype=np.float32)
    for normal, seen in _each_facet(normals, facets, step=2):
        total += microfacet_glare(normal, lights, roughness) * seen
        weight += seen
    return np.asarray(total / np.maximum(weight, np.float32(1e-6)), dtype=np.float32)


def at(facets: Facets | None, region: BoolArray) -> Facets | None:
    """Facets at the pixels of `region` only, as one row."""
    if facets is None:
        return None
    return Facets(facets.slopes, facets.across_x[region][None], facets.across_y[region][None])
