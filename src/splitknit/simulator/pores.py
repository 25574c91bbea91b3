"""Sweat pores: small dips along the crests of the ridges."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]


def scatter_pores(
    rng: np.random.Generator,
    wave: Array32,
    *,
    pitch_mm: float,
    period_mm: float,
    spacing_mm: float,
    diameter_mm: float,
) -> Array32:
    """Return (H, W) pore depth in [0, 1] on the grid of `wave`.

    Candidates lie on a jittered grid, climb onto the nearest crest of `wave`, and are thinned so that neighbours keep
    more than half of `spacing_mm`. Sizes vary by a quarter.

    References
    ----------
    Roddy and Stosz 1997, Fingerprint features: 9 to 18 pores per centimetre of ridge, 60 to 250 um across.
    """
    rows, columns = wave.shape
    cell = float(np.sqrt(0.4 * spacing_mm * period_mm)) / pitch_mm
    grid_x, grid_y = np.meshgrid(np.arange(0.5 * cell, columns, cell), np.arange(0.5 * cell, rows, cell))
    jitter = rng.uniform(-0.5, 0.5, (2, *grid_x.shape)) * cell
    x = np.clip((grid_x + jitter[0]).ravel(), 2, columns - 3)
    y = np.clip((grid_y + jitter[1]).ravel(), 2, rows - 3)
    smooth = np.asarray(cv2.GaussianBlur(wave, (0, 0), 0.12 * period_mm / pitch_mm), dtype=np.float32)
    slope_x = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125), dtype=np.float32)
    slope_y = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125), dtype=np.float32)
    gain = (period_mm / pitch_mm / (2 * np.pi)) ** 2  # one Newton step on a cosine's crest
    for _ in range(12):
        x = np.clip(x + gain * _sample(slope_x, x, y), 2, columns - 3)
        y = np.clip(y + gain * _sample(slope_y, x, y), 2, rows - 3)
    keep = _thin(np.stack([x, y], 1), rng.permutation(x.size), 0.55 * spacing_mm / pitch_mm)
    keep &= _sample(smooth, x, y) > 0.5
    x, y = x[keep], y[keep]
    sideways = rng.normal(0.0, 0.05 * period_mm / pitch_mm, (2, x.size))
    sigma = diameter_mm / 2.355 / pitch_mm * np.exp(0.25 * rng.standard_normal(x.size)).clip(0.7, 1.6)
    depth = rng.uniform(0.4, 1.0, x.size)
    return _stamp((rows, columns), x + sideways[0], y + sideways[1], sigma, depth)


def _sample(image: Array32, x: Array, y: Array) -> Array:
    return np.asarray(image[np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)], dtype=np.float64)


def _thin(points: Array, order: NDArray[np.intp], distance: float) -> NDArray[np.bool_]:
    """Greedy thinning: in a random order, a point survives if no survivor lies within `distance`."""
    rank = np.empty(len(points), dtype=np.intp)
    rank[order] = np.arange(len(points))
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    first = np.where(rank[pairs[:, 0]] < rank[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    second = pairs.sum(axis=1) - first
    keep = np.ones(len(points), dtype=np.bool_)
    for k in np.lexsort((second, rank[first])):
        if keep[first[k]]:
            keep[second[k]] = False
    return keep


def _stamp(shape: tuple[int, int], x: Array, y: Array, sigma: Array, depth: Array) -> Array32:
    reach = 6
    image = np.zeros((shape[0] + 2 * reach + 2, shape[1] + 2 * reach + 2), dtype=np.float64)
    column, row = np.rint(x).astype(np.intp), np.rint(y).astype(np.intp)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            distance = (column + dx - x) ** 2 + (row + dy - y) ** 2
            value = depth * np.exp(-0.5 * distance / sigma**2)
            np.maximum.at(image, (row + dy + reach, column + dx + reach), value)
    return np.asarray(image[reach : reach + shape[0], reach : reach + shape[1]], dtype=np.float32)
