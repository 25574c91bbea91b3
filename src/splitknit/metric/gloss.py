"""The glare that the ridges themselves cause, predicted from the current surface.

Colour alone tells glare from relief at the price of noise. But glare follows from the normals: once the ridges are
known roughly, most of it can be predicted, and colour has to tell only the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit.metric.coarse import BandImages, Lighting
from splitknit.metric.grid import WORKERS, Grid
from splitknit.normals import pseudo_normals
from splitknit.separate import SpectralFit, microfacet_glare
from splitknit.types import FloatArray

ROUGHNESSES = (0.12, 0.16, 0.20, 0.25, 0.30, 0.36, 0.42, 0.50)
PATCH_PX = 320
"""Side of the patch on which roughness and strength are fitted."""


@dataclass(frozen=True, slots=True)
class Gloss:
    """Glare of the skin's own surface, ridges resolved."""

    roughness: float
    strength: float
    explained: float
    """Part of the glare-coloured power that it explains."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the surface lacks, as the fine grid found it."""

    slopes: list[tuple[FloatArray, FloatArray]]
    """C pairs (h, w)."""
    expected: FloatArray
    """(h, w, 3) expected pseudo-normals of the first channel; z positive."""
    diffuse: FloatArray
    """(h, w) diffuse brightness of the first channel."""
    region: FloatArray
    """(h, w) well-seen part."""
    fit: SpectralFit
    transfer: FloatArray
    """(C, n) of the skin at `fit.omega_per_mm`."""
    glare: FloatArray
    """(C,) weight of the glare in each channel."""
    crossover_mm: float


def glare_stack(surface_normals: FloatArray, light: Lighting, roughness: float) -> FloatArray:
    """Images (L, h, w) of a glare of strength one on a surface with these unit normals (h, w, 3)."""
    return microfacet_glare(surface_normals, light.vectors, roughness)


def glare_normals(
    band: BandImages, grid: Grid, surface_mm: FloatArray, light: Lighting, stack: FloatArray
) -> FloatArray:
    """What photometric stereo makes of glare images (L, h, w): pseudo-normals (h, w, 3)."""
    entering = np.maximum(light.entering, np.float32(0.2))
    weights = light.trust * entering * entering
    return pseudo_normals(stack / entering, band.rig, surface_mm, grid.mask, weights, grid.x_mm, grid.y_mm)


def fit_gloss(  # noqa: PLR0917
    band: BandImages, grid: Grid, surface_mm: FloatArray, normals: FloatArray, light: Lighting, seen: Seen
) -> Gloss:
    """Roughness and strength of the glare, on a patch in the middle of the finger.

    Parameters
    ----------
    band : white images on `grid`
    surface_mm : (h, w) current surface
    normals : (h, w, 3) its unit normals, ridges and all
    light : lights on `grid`
    seen : what the surface lacks, and how it was found
    """
    rows, columns = patch_of(seen.region)
    part = (rows, columns)
    patch = Grid(grid.mask[part], grid.x_mm[columns], grid.y_mm[rows], grid.pitch_mm, (False,) * 4)
    there = Lighting(*(field[..., rows, columns] for field in (light.vectors, light.entering, light.trust)))
    window = seen.region[part] * np.outer(np.hanning(patch.shape[0]), np.hanning(patch.shape[1])).astype(np.float32)
    slopes = [(x[part] * window, y[part] * window) for x, y in seen.slopes]
    wy = 2 * np.pi / grid.pitch_mm * np.fft.fftfreq(patch.shape[0])[:, None]
    wx = 2 * np.pi / grid.pitch_mm * np.fft.rfftfreq(patch.shape[1])[None, :]
    omega = np.hypot(wx, wy).astype(np.float32)
    best = Gloss(ROUGHNESSES[0], 0.0, 0.0)
    images = BandImages(band.channels, band.stack[:, :, rows, columns], band.rig)
    for roughness in ROUGHNESSES:
        stack = glare_stack(normals[part], there, roughness)
        glare = glare_normals(images, patch, surface_mm[part], there, stack)
        z = seen.expected[part][..., 2]
        trial = []
        for axis in range(2):
            slope = -(glare[..., axis] - seen.expected[part][..., axis] / z * glare[..., 2]) / seen.diffuse[part]
            trial.append((slope - patch.smooth(slope, patch.mask, seen.crossover_mm)) * window)
        strength, explained = strength_of(slopes, (trial[0], trial[1]), seen.fit, seen.transfer, seen.glare, omega)
        if explained > best.explained:
            best = Gloss(roughness, strength, explained)
    return best


def strength_of(  # noqa: PLR0917
    slopes: list[tuple[FloatArray, FloatArray]],
    trial: tuple[FloatArray, FloatArray],
    fit: SpectralFit,
    transfer: FloatArray,
    weights: FloatArray,
    omega: FloatArray,
) -> tuple[float, float]:
    """Least-squares strength of `trial` in the channels' slopes, blind to the relief, and the power it explains.

    Generalised least squares with the covariance of relief and noise: what has the relief's colour at a frequency does
    not count.

    Parameters
    ----------
    slopes : C pairs of (p, q)
        On a patch, windowed.
    trial : pair (p, q)
        Apparent slopes of a glare of strength one in the first channel, windowed alike.
    fit : powers of relief and noise
    transfer : (C, n) of the skin at `fit.omega_per_mm`
    weights : (C,) of the glare in each channel, one in the first
    omega : (p, q // 2 + 1) angular frequencies of the patch's transform
    """
    centres = fit.omega_per_mm
    signal = np.maximum(fit.signal, 1e-3) * 4
    covariance = signal[:, None, None] * transfer.T[:, :, None] * transfer.T[:, None, :] + np.diag(fit.noise)
    rows = np.linalg.solve(covariance, np.broadcast_to(weights.astype(np.float64), transfer.T.shape)[..., None])[..., 0]
    gains = [np.interp(omega, centres, row, left=0.0, right=0.0).astype(np.float32) for row in rows.T]
    norm = np.interp(omega, centres, rows @ weights.astype(np.float64), left=0.0, right=0.0).astype(np.float32)
    double = np.full(omega.shape[1], 2.0)
    double[0] = 1.0
    product, power = 0.0, 0.0
    for axis in range(2):
        model = _transform(trial[axis])
        seen = sum(g * _transform(pair[axis]) for g, pair in zip(gains, slopes, strict=True))
        product += float(((seen * model.conj()).real * double).sum(dtype=np.float64))
        power += float((norm * np.abs(model) ** 2 * double).sum(dtype=np.float64))
    if power <= 0:
        return 0.0, 0.0
    strength = max(product / power, 0.0)
    return strength, strength * product


def _transform(field: FloatArray) -> NDArray[np.complex64]:
    return np.asarray(scipy.fft.rfft2(field.astype(np.float32), workers=WORKERS))


def patch_of(region: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of a patch in the middle of the well-seen part."""
    rows, columns = np.nonzero(region > 0.5 * region.max())
    limits = []
    for places, size in ((rows, region.shape[0]), (columns, region.shape[1])):
        middle = int(np.median(places))
        low = min(max(0, middle - PATCH_PX // 2), max(0, size - PATCH_PX))
        limits.append(slice(low, min(size, low + PATCH_PX)))
    return limits[0], limits[1]
