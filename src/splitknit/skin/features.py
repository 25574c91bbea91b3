"""What the network of the relief sees: the white band's light in a form that no particular rig, finger or exposure has.

Every pixel's images are taken apart by what the light's azimuth does to them. What does not depend on it is the
brightness; what turns once is the slope, as photometric stereo finds it; what turns twice or three times no matt
surface does, it is glare. All are relative to their neighbourhood, so that neither exposure nor pigment nor the
finger's shape is seen in them, and they turn with the image as scalars and vectors do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric import pseudo_normals
from splitknit.skin.bands import BandImages
from splitknit.skin.grid import Grid
from splitknit.skin.light import FineLight

RIDGE_BAND_MM = 0.3
"""Standard deviation of the Gaussian mean that the relief is free of."""
LEVEL_MM = 0.6
"""Standard deviation of the Gaussian mean that brightness is relative to."""
LEAST_LIGHTS = 6
"""Fewer lights leave too little beside the slopes to tell glare."""
COUNT = 32
"""Fields of :func:`features`."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Input of the network, and what its output is relative to."""

    fields: FloatArray
    """(32, h, w), zero outside the mask."""
    level: FloatArray
    """(C, h, w) local diffuse brightness of each channel, glare included."""


def features(
    band: BandImages, grid: Grid, surface_mm: FloatArray, light: FineLight, found: FloatArray | None = None
) -> Features:
    """Rig-independent description of the white band's light on a smooth surface.

    Parameters
    ----------
    band : three channels, six lights at least
    grid : fine grid
    surface_mm : (h, w) the smooth shape, finite
    light : of `band.rig` on that surface
    found : (C, h, w, 3) brightness times normal of ``band.stack / light.entering``, optional
        Least squares over the lights where it is not given.
    """
    weights = light.trust * light.entering * light.entering
    stack = band.stack / light.entering
    g = pseudo_normals(stack, band.rig, surface_mm, grid.mask, weights, view=grid.view) if found is None else found
    slope_x, slope_y = (grid.smooth(s, grid.mask, RIDGE_BAND_MM) for s in height_gradients(surface_mm, grid.pitch_mm))
    normals = normals_from_gradients(slope_x, slope_y)
    nz = normals[..., 2]
    mask = grid.mask.astype(np.float32)
    to_harmonics = beyond_matt(band.rig)
    size = np.sqrt((light.vectors * light.vectors).sum(axis=1))  # (L, h, w)
    bright: list[FloatArray] = []
    slopes: list[FloatArray] = []
    beyond: list[FloatArray] = []
    levels: list[FloatArray] = []
    for c in range(len(band.channels)):
        along = np.einsum("hwi,hwi->hw", g[c], normals)
        level = np.maximum(grid.smooth(along, grid.mask, LEVEL_MM), np.float32(1e-6))
        levels.append(level)
        bright.append(np.clip(along / level - 1, -1, 1))
        for axis, slope in ((0, slope_x), (1, slope_y)):
            lacking = -(g[c, ..., axis] + slope * g[c, ..., 2]) / (level * nz)
            limited: FloatArray = np.clip(lacking, -2, 2).astype(np.float32)
            slopes.append(limited - grid.smooth(limited, grid.mask, RIDGE_BAND_MM))
        left = np.empty_like(size)
        for k in range(len(size)):
            v = light.vectors[k]
            matt = v[0] * g[c, ..., 0] + v[1] * g[c, ..., 1] + v[2] * g[c, ..., 2]
            left[k] = (stack[c, k] - matt) * light.trust[k] / (level * size[k] + np.float32(1e-9))
        beyond.extend(np.clip(np.tensordot(to_harmonics, left, 1), -1, 1))
    tints = [np.log(level / levels[0]) for level in levels[1:]]
    towards = band.rig.light_vectors()
    tangent = float(np.mean(np.hypot(towards[:, 0], towards[:, 1]) / np.maximum(towards[:, 2], 1e-6)))
    geometry = [
        np.clip(slope_x, -2, 2) / 2,
        np.clip(slope_y, -2, 2) / 2,
        np.minimum(grid.depth_mm, 1),
        light.trust.mean(axis=0),
        *(np.clip(t, -3, 3) / 2 for t in tints),
        np.float32(grid.pitch_mm / 0.0264 - 1),
        np.float32(tangent * 2),
    ]
    whole = _statistics(slopes, beyond, light.trust.min(axis=0) > 0.9)
    fields = np.zeros((COUNT, *grid.shape), dtype=np.float32)
    for room, field in zip(fields, [*bright, *slopes, *beyond, *geometry, *whole], strict=True):
        np.multiply(field, mask, out=room, casting="same_kind")
    return Features(np.nan_to_num(fields, copy=False), np.stack(levels))


def _statistics(slopes: list[FloatArray], beyond: list[FloatArray], lit: BoolArray) -> list[np.float32]:
    """What tells the scattering and the glare of the whole finger.

    Logarithms of the rms slope in every channel but the last over that in the last (more scattering takes more from red
    than from blue), and of the rms of what no matt surface explains over the rms slope.
    """
    region = lit if lit.any() else np.ones_like(lit)

    def power(fields: list[FloatArray]) -> float:
        return float(np.mean([(f[region] ** 2).mean(dtype=np.float64) for f in fields])) + 1e-9

    channels = len(slopes) // 2
    of_slopes = [power(slopes[2 * c : 2 * c + 2]) for c in range(channels)]
    ratios = [*(p / of_slopes[-1] for p in of_slopes[:-1]), power(beyond) / of_slopes[-1]]
    return [np.float32(np.clip(np.log(ratio), -8, 8) / 2) for ratio in ratios]


def azimuth_waves(rig: Rig, most: int) -> FloatArray:
    """(L, 1 + 2 most) the waves 1, cos n a, sin n a at the azimuths a of the rig's lights."""
    towards = rig.light_vectors()
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    waves = [np.ones_like(azimuth), *(f(n * azimuth) for n in range(1, most + 1) for f in (np.cos, np.sin))]
    return np.stack(waves, axis=1).astype(np.float32)


def beyond_matt(rig: Rig) -> FloatArray:
    """(4, L) what turns an image's remainders into the second and third waves of the light's azimuth."""
    return np.asarray(np.linalg.pinv(azimuth_waves(rig, 3)[:, 3:], rcond=0.2), dtype=np.float32)
