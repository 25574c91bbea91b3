"""What the network of the shape sees: how images and prediction differ on the coarse grid, all bands together.

The finished comparison leaves errors of one kind: where the finger turns away, towards its tip and its outline, ridges
that nobody resolves, light that is lost at the rim and glare at grazing angles bend the shape. They show in what all
bands have in common, which a network that has seen many fingers reads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.imaging.geometry import height_gradients
from splitknit.model import FloatArray
from splitknit.photometric import pseudo_normals
from splitknit.skin.bands import BandImages
from splitknit.skin.coarse import lacking_coarse, unit
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.facets import Facets, facet_normals
from splitknit.skin.features import beyond_matt
from splitknit.skin.grid import Grid
from splitknit.skin.light import lighting, predict, reached_by_all

SHAPE_COUNT = 32
"""Fields of :func:`shape_features`."""
CHANNELS = ("red", "green", "blue", "nir")
WITH_WAVES = ("green", "nir")
"""Channels whose second and third waves are given."""


def shape_features(
    bands: tuple[BandImages, ...],
    grid: Grid,
    height_mm: FloatArray,
    skin: dict[str, Diffusion],
    facets: Facets,
) -> FloatArray:
    """Describe how the images differ from what the shape predicts.

    Parameters
    ----------
    bands : images on `grid`; what a missing channel would show is zero
    grid : coarse grid
    height_mm : (h, w) the shape at its height above the finger plane, zero outside the mask
    skin : transfer function of each channel
    facets : of the ridges

    Returns
    -------
    (32, h, w) float32, zero outside the mask
    """
    slope_x, slope_y = height_gradients(height_mm, grid.pitch_mm)
    normals = facet_normals(slope_x, slope_y, facets)
    fields: dict[str, FloatArray] = {}
    brightness: dict[str, float] = {}
    trusted = np.zeros(grid.shape, dtype=np.float32)
    for band in bands:
        light = lighting(band.rig, grid, height_mm, unit(normals))
        trusted = light.trust.mean(axis=0)
        reached = reached_by_all(light, grid)
        predicted_all = predict(light, grid, normals, [grid.sampled(skin[name]) for name in band.channels])
        waves = beyond_matt(band.rig)
        size = np.sqrt((light.vectors * light.vectors).sum(axis=1))
        for c, name in enumerate(band.channels):
            expected = predicted_all[c]
            ratio = band.stack[c][:, reached] / np.maximum(expected[:, reached], np.float32(1e-4))
            brightness[name] = float(np.median(ratio))
            expected *= np.float32(brightness[name])
            both = np.stack([band.stack[c], expected]).astype(np.float32)
            seen, predicted = pseudo_normals(both, band.rig, height_mm, grid.mask, light.trust, view=grid.view)
            x, y = lacking_coarse(seen, predicted, grid)
            level = np.maximum(predicted[..., 2], np.float32(0.05 * brightness[name]))
            fields[f"{name} x"], fields[f"{name} y"] = 4 * x, 4 * y
            fields[f"{name} level"] = np.log(np.clip(seen[..., 2] / level, 0.2, 5.0))
            if name in WITH_WAVES:
                matt = np.einsum("lihw,hwi->lhw", light.vectors, seen)
                left = (band.stack[c] - matt) * light.trust / (level * size + np.float32(1e-9))
                for n, wave in enumerate(np.clip(np.tensordot(waves, left, 1), -0.5, 0.5)):
                    fields[f"{name} {n}"] = 10 * wave
    nothing = np.zeros(grid.shape, dtype=np.float32)
    names = [f"{name} {axis}" for name in CHANNELS for axis in "xy"] + [f"{name} level" for name in CHANNELS]
    names += [f"{name} {n}" for name in WITH_WAVES for n in range(4)]
    steepness = np.float32(np.sqrt(np.mean(facets.slopes**2)))
    reference = max(brightness.get("red", next(iter(brightness.values()))), 1e-9)
    tints = [np.log(max(brightness.get(name, reference), 1e-9) / reference) / 2 for name in CHANNELS[1:]]
    known: list[FloatArray] = [
        _f32(np.clip(slope_x, -4, 4) / 2),
        _f32(np.clip(slope_y, -4, 4) / 2),
        _f32(np.minimum(grid.depth_mm, 3) / 2),
        trusted,
        (facets.across_x**2 - facets.across_y**2) * steepness,
        2 * facets.across_x * facets.across_y * steepness,
        nothing + steepness,
        *(nothing + np.float32(t) for t in tints),
        nothing + np.float32("nir" in brightness),
        nothing + np.float32(grid.pitch_mm / 0.106 - 1),
    ]
    stacked = np.stack([*(fields.get(name, nothing) for name in names), *known]).astype(np.float32)
    return np.asarray(np.nan_to_num(stacked) * grid.mask, dtype=np.float32)


def _f32(field: Any) -> FloatArray:
    return np.asarray(field, dtype=np.float32)
