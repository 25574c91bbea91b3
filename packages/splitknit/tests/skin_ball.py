"""A ball of two-layer skin under a ring of lights."""

from __future__ import annotations

import numpy as np

from splitknit.photometric.hanrahan_krueger_fit import HanrahanKruegerSettings, SkinLayers, reflected

EQUAL = HanrahanKruegerSettings(weights="equal")
THIN = SkinLayers(epidermis_thickness_mm=0.02)
"""Layers that images say something of."""


def ring(count=7, elevation_deg=69.0):
    azimuth, elevation = 2 * np.pi * np.arange(count) / count, np.deg2rad(elevation_deg)
    return np.column_stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.full(count, np.sin(elevation))]
    )


def ball(lights, *, base=0.5, layers=THIN, reflectance=0.45, noise=0.0, edge=0.8, size=64, fraction=None, depth=None):
    """Images of a ball of two-layer skin, its normals and its mask."""
    i, j = np.mgrid[0:size, 0:size]
    x, y = (2 * j - size + 1) / size, (size - 1 - 2 * i) / size
    mask = x**2 + y**2 < edge
    normals = np.dstack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 1e-3, 1))])
    normals[~mask] = [0, 0, 1]
    flat = normals.reshape(-1, 3)
    one = np.ones(len(flat))
    exposure = np.pi * base / (reflectance * layers.refractive_index**2)
    strength = np.linalg.norm(lights, axis=1, keepdims=True)
    unit = lights / strength
    stack = strength * reflected(
        unit @ flat.T, flat[:, 2], unit[:, 2:], base * one,
        (layers.epidermis_fraction if fraction is None else fraction) * one,
        (layers.epidermis_depth if depth is None else depth) * one, exposure, layers,
    ).value  # fmt: skip
    stack += np.random.default_rng(0).normal(0, noise, stack.shape)
    return np.clip(stack, 0, None).reshape(-1, size, size).astype(np.float32), normals, mask
