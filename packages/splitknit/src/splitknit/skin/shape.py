"""The finger's shape on a coarse grid by analysis and synthesis, behind scattering and specular
reflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.pixels import bin_mean
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.grid import BandImages, Grid, Slopes, coarsen, refine
from splitknit.skin.light import (
    Lighting,
    factor_of,
    fine_lighting,
    glare_strength,
    lighting,
    microfacet_glare,
    predict,
    reached_by_all,
)


@dataclass(frozen=True, slots=True, eq=False)
class CoarseImages:
    """Images of all bands on the coarse grid, whose pixels are blocks of the fine grid's."""

    bands: tuple[BandImages, ...]
    grid: Grid
    white: BandImages  # on the fine grid
    fine: Grid
    factor: int  # pixels of the fine grid on a side of a coarse one
    plane_mm: float  # assumed mean height of the skin above the finger plane

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of all channels, the white band's first."""
        return tuple(name for band in self.bands for name in band.channels)


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A shape on the coarse grid, and further estimates from its images."""

    height_mm: FloatArray  # (h, w) along the line of sight; its mean is undefined
    facing: FloatArray  # (h, w) z component of the normals: weights of the integration
    # diffuse brightness of each channel over the prediction for an albedo of one
    brightness: Mapping[str, float]
    glare: Mapping[str, float]
    """Strength of the specular reflection by the last channel of each band."""


COARSE_PITCH_MM = 0.106
"""Pitch of the coarse grid. Chosen on: judgement. Range: 0.0742 to 0.106
(validation/parameters)."""


def coarse_images(bands: tuple[BandImages, ...], grid: Grid, plane_mm: float) -> CoarseImages:
    """Means of the images on the fine grid over blocks of about `COARSE_PITCH_MM`."""
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
    low = coarsen(grid, factor)
    rows, columns = low.shape
    blocks = (..., slice(rows * factor), slice(columns * factor))
    coarse = tuple(
        BandImages(b.channels, bin_mean(b.stack[blocks], factor) * low.mask, b.rig) for b in bands
    )
    return CoarseImages(coarse, low, bands[0], grid, factor, plane_mm)


def coarse_shape(images: CoarseImages, optics: Mapping[str, Diffusion], steps: int) -> Shape:
    """Analysis by synthesis: the surface whose images, behind scattering, agree with the
    photographs.

    With the slopes s added so far, the measured ones p and the predicted ones F(s), a step is s <-
    W (p - F(s) + M s). W, a regularised inverse, acts on the whole signal and not on each residual,
    so that repeating it settles. The ridges need not be known: as much light enters a ridged patch
    of skin and scatters below it as enters a smooth one, because facets that lean away from the
    light are larger as they are darker. `optics`: transfer function of each channel; `steps`:
    comparisons of prediction and images, one at least.
    """
    grid = images.grid
    start = _start_shape(images.bands[-1], grid, images.plane_mm)
    start = grid.smooth(start, grid.mask, 0.5) * grid.mask
    height = start
    for _ in range(steps):
        residual = residual_of(images.bands, grid, above_plane(height, images) * grid.mask, optics)
        added = slopes_inside(height - start, grid)
        slopes = _wiener(residual, added, optics, grid)
        facing = normals_from_gradients(*slopes_inside(height, grid))[..., 2]
        height = height + integrate(slopes[0] - added[0], slopes[1] - added[1], grid, facing)
    return Shape(height, facing, residual.brightness, residual.glare)


def above_plane(height_mm: FloatArray, images: CoarseImages) -> FloatArray:
    """The shape (h, w) at its assumed height above the finger plane."""
    mean = np.float32(height_mm[images.grid.mask].mean(dtype=np.float64))
    return height_mm - mean + images.plane_mm


def on_fine_grid(height_mm: FloatArray, images: CoarseImages) -> FloatArray:
    """(H, W) the shape at its height above the finger plane on the fine grid, continued beyond the
    mask."""
    return refine(
        above_plane(height_mm, images), images.grid.mask, images.factor, images.fine.shape
    )


def white_light_on(height_mm: FloatArray, images: CoarseImages) -> Lighting:
    """The white lights, on the fine grid, on the shape."""
    low = images.grid
    height = refine(above_plane(height_mm, images), low.mask, 1, low.shape)
    return fine_lighting(images.white.rig, low, height, images.factor, images.fine)


def _start_shape(band: BandImages, grid: Grid, plane_mm: float) -> FloatArray:
    """A first shape: near-light photometric stereo of one band with equal weights, integrated over
    the mask."""
    height = np.zeros(grid.shape, dtype=np.float32)
    stack = band.stack.sum(axis=0)
    for _ in range(2):
        g = pseudo_normals(stack, band.rig, height + plane_mm, grid.mask, view=grid.view)
        length = np.sqrt((g * g).sum(axis=-1, keepdims=True))
        normals = g / np.maximum(length, 1e-9)
        nz = np.maximum(normals[..., 2], 0.15)
        height = integrate(-normals[..., 0] / nz, -normals[..., 1] / nz, grid, nz)
    return height


def slopes_inside(height_mm: FloatArray, grid: Grid) -> Slopes:
    """dz/dx and dz/dy (h, w) of a surface on the grid's mask: no step at its edge, zero outside."""
    x, y = height_gradients(np.where(grid.mask, height_mm, np.nan), grid.pitch_mm)
    return np.nan_to_num(x), np.nan_to_num(y)


def integrate(
    slope_x: FloatArray, slope_y: FloatArray, grid: Grid, weights: FloatArray
) -> FloatArray:
    """Height in mm (zero outside the mask, mean zero on it) by weighted masked least squares."""
    height = poisson(slope_x, slope_y, grid.mask, weights=np.clip(weights, 0, 1)) * grid.pitch_mm
    return np.asarray(np.nan_to_num(height, nan=0.0))


# One comparison: predicted images, specular fit, residual slopes, and the Wiener estimate from
# them.


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Slopes that the images have beyond the prediction."""

    slopes: Mapping[str, Slopes]  # by channel, behind the skin's blur
    brightness: Mapping[str, float]
    glare: Mapping[str, float]
    bands: tuple[tuple[str, ...], ...]  # channels of each band


_MAX_SPECULAR = 1.0
"""Largest specular reflection that is predicted, over that of a clean boundary with the skin's
refractive index. What is left over is separated by its colour; what is predicted in excess becomes
relief that is not there. Chosen on: judgement. Range: none within 0.7 to 1.4
(validation/parameters)."""


def residual_of(
    bands: Sequence[BandImages], grid: Grid, height_mm: FloatArray, optics: Mapping[str, Diffusion]
) -> Residual:
    """Predict the images of all bands, the white one first, from a finite surface (h, w) on the
    coarse grid and the transfer function of each channel; fit the specular reflection; measure the
    slopes left over.
    """
    normals = normals_from_gradients(*slopes_inside(height_mm, grid))
    slopes: dict[str, Slopes] = {}
    brightness: dict[str, float] = {}
    glare: dict[str, float] = {}
    first: tuple[float, float] | None = None  # strength and exposure of the first band
    for band in bands:
        light = lighting(band.rig, grid, height_mm, normals)
        # predicted: I_c = a_c M_c * (T(n.l) max(s.n, 0)), its brightness a_c measured where the
        # lobe is weakest
        predicted = predict(
            light, grid, normals, [grid.sampled(optics[name]) for name in band.channels]
        )
        lobe = microfacet_glare(normals, light.vectors)
        reached = reached_by_all(light, grid)
        # the third of lights and pixels with the weakest lobe, whatever its exact strength
        matt = (lobe <= np.quantile(lobe[:, reached], 1 / 3)) & reached
        level = _scaled_to(band.stack, predicted, matt)
        exposure = level[0] / optics[band.channels[0]].albedo
        # specular: one surface reflects in all bands; their exposures differ, as their diffuse
        # light shows
        if first is None:
            if len(band.channels) > 1:
                white = _white_part(band.stack - predicted, level)
                strength = factor_of(lobe[:, reached], white[:, reached])
            else:
                lit = (light.vectors * light.entering[:, None])[:, :, reached]
                strength = glare_strength(band.stack[0][:, reached], lit, lobe[:, reached])
            first = min(strength, _MAX_SPECULAR * float(np.pi) * exposure), exposure
        strength = first[0] * exposure / first[1]
        glare[band.channels[-1]] = strength
        diffuse = band.stack - lobe * strength * grid.mask
        correction = _scaled_to(diffuse, predicted, matt)
        # residual: slopes that the measured pseudo-normals have beyond the predicted ones
        both = np.concatenate([diffuse, predicted]).astype(np.float32)
        g = pseudo_normals(both, band.rig, height_mm, grid.mask, light.trust, view=grid.view)
        for c, name in enumerate(band.channels):
            brightness[name] = level[c] * correction[c]
            slopes[name] = residual_slopes(g[c], g[c + len(band.channels)], grid)
    return Residual(slopes, brightness, glare, tuple(band.channels for band in bands))


def residual_slopes(measured: FloatArray, predicted: FloatArray, grid: Grid) -> Slopes:
    """Slopes that `measured` (h, w, 3) has beyond `predicted`, to first order and whatever the
    local albedo.

    With p the predicted slope, -(G_x + p G_z) / D vanishes where G is parallel to the prediction; D
    is the predicted z component times the smooth ratio of the two.
    """
    z = np.maximum(predicted[..., 2], 0.1 * np.sqrt((predicted * predicted).sum(axis=-1)) + 1e-6)
    inside = grid.mask & (z > 0.05 * np.median(z[grid.mask]))
    albedo = grid.smooth(np.maximum(measured[..., 2], 0) / z, inside, 0.8)
    p = -predicted[..., :2] / z[..., None]
    slopes = -(measured[..., :2] + p * measured[..., 2:]) / np.maximum(albedo * z, 1e-4)[..., None]
    slopes = np.clip(slopes, -0.6, 0.6).astype(np.float32) * grid.mask[..., None]
    return slopes[..., 0], slopes[..., 1]


def unmixing_weights(transfer: Any, glare: Any, signal: Any, glare_power: Any, noise: Any) -> Array:
    """Weights (C, n) by which the channels' slopes are summed to estimate the true slope at n
    frequencies.

    signal M^T (signal M M^T + sum glare_power g g^T + noise)^-1 (N. Wiener 1949, "Extrapolation,
    Interpolation, and Smoothing of Stationary Time Series", for several channels), of the
    `transfer` function M (C, n) of each channel, the weights `glare` (C, G) of G independent glares
    in each channel, the expected powers `signal` (n,) of the true slope and `glare_power` (n,) of
    each, and the `noise` (C,).
    """
    m = transfer.T  # (n, C)
    g = np.asarray(glare, dtype=np.float64).reshape(m.shape[1], -1)
    power = np.broadcast_to(glare_power[:, None], (m.shape[0], g.shape[1]))
    covariance = (
        signal[:, None, None] * m[:, :, None] * m[:, None, :]
        + np.einsum("ng,cg,dg->ncd", power, g, g)
        + np.diag(noise)
    )
    weights = np.linalg.solve(covariance, (signal[:, None] * m)[..., None])[..., 0]
    return weights.T


def _wiener(
    residual: Residual, added: Slopes, optics: Mapping[str, Diffusion], grid: Grid
) -> Slopes:
    """Slopes (h, w) of the surface beyond its start: W (residual + M added), with the
    minimum-mean-square-error W. `added`: slopes put in by earlier comparisons; `optics`: M of each
    channel.
    """
    names = list(residual.slopes)
    omega = np.linspace(0, float(grid.omega[2].max()), 512)
    reference = residual.brightness[names[0]]
    glare = np.zeros((len(names), len(residual.bands)))  # a specular reflection for each band
    for g, members in enumerate(residual.bands):
        for name in members:
            glare[names.index(name), g] = reference / max(residual.brightness[name], 1e-6)
    weights = unmixing_weights(
        np.stack([optics[name](omega) for name in names]),
        glare,
        1
        # slopes of a shape fall off from 5 rad/mm (3.5 to 10 do as well)
        / (1 + (omega / 5.0) ** 2) ** 2,
        np.full(omega.shape, 0.16**2),  # apparent slopes of specular reflection over the shape's
        np.full(len(names), 0.1**2),  # noise over the shape's slopes (0.1 to 0.14 do as well)
    )
    # slopes beyond 8 rad/mm are left to the fine grid (5.6 to 16 do as well)
    weights = weights * np.exp(-0.5 * (omega / 8.0) ** 2)
    gains = {name: grid.radial(omega, w) for name, w in zip(names, weights, strict=True)}
    kept = sum(gain * grid.sampled(optics[name]) for name, gain in gains.items())

    def estimated(axis: int) -> FloatArray:
        slopes = {name: grid.forward(residual.slopes[name][axis]) for name in names}
        of_images = sum(gain * slopes[name] for name, gain in gains.items())
        return grid.inverse(kept * grid.forward(added[axis]) + of_images) * grid.mask

    return estimated(0), estimated(1)


def _scaled_to(measured: FloatArray, predicted: FloatArray, where: BoolArray) -> list[float]:
    """Bring each channel of the prediction (C, L, h, w), in place, to the images' median; return
    the factors."""
    factors = []
    for c, image in enumerate(measured):
        factors.append(float(np.median(image[where] / np.maximum(predicted[c][where], 1e-4))))
        predicted[c] *= factors[-1]
    return factors


def _white_part(excess: FloatArray, brightness: Sequence[float]) -> FloatArray:
    """(L, h, w) the part of the `excess` (C, L, h, w) over the prediction that is equal in all
    channels: by least squares it is a white part and one of the skin's colour, as the shape is not
    right yet."""
    skin = np.array(brightness, dtype=np.float32)
    total, power = skin.sum(), skin @ skin
    white = power * excess.sum(axis=0) - total * np.tensordot(skin, excess, 1)
    return np.asarray(white / max(float(len(skin) * power - total * total), 1e-9))
