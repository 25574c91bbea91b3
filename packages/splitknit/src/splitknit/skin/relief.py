"""The relief from the colours of the white band, behind scattering and specular reflection, on the
fine grid.

In the slopes that photometric stereo finds in channel c, the true slope d of the relief arrives
through the skin's transfer function M_c, and the glare's apparent slope s with a weight g_c, the
same light divided by the channel's diffuse brightness:

    p_c(w) = M_c(w) d(w) + g_c s(w) + noise.

M falls with the frequency in a way of its own in every channel while g does not depend on the
frequency, so that two channels or more separate d from s. The estimate of least mean-square error
given the powers of d, s and the noise is linear; with a generous power for s it is blind to the
glare and shrinks d by little.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import Array, FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.grid import BandImages, Grid, Slopes, smooth_step
from splitknit.skin.light import Lighting, slant_of, trust_of


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


def cross_spectra(
    slopes: list[Slopes], region: FloatArray, pitch_mm: float, bands: int = 28
) -> tuple[Array, Array, Array]:
    """Radially averaged cross-spectra between the slope fields (dz/dx, dz/dy), y up, of C channels.

    `region` (H, W): smooth window, zero outside the reliable surface; `bands`: equal on a
    logarithmic scale from a period of 1.25 mm to the finest. Returns omega_per_mm (n,), (n, C, C)
    of the slope along the wave vector: what a surface has, and (n, C) the power across it: a
    surface has none, so this is noise (and glare).
    """
    highest = 0.95 * np.pi / pitch_mm
    edges = np.geomspace(min(5.0, highest / 4), highest, bands + 1)
    size = [scipy.fft.next_fast_len(n, True) for n in region.shape]
    wy = -2 * np.pi * np.fft.fftfreq(size[0])[:, None] / pitch_mm
    wx = 2 * np.pi * np.fft.rfftfreq(size[1])[None, :] / pitch_mm
    omega = np.hypot(wx, wy)
    band = np.digitize(omega, edges) - 1
    used = (band >= 0) & (band < bands)
    index = band[used]
    count = np.maximum(np.bincount(index, minlength=bands), 1)
    ux, uy = wx / np.maximum(omega, 1e-9), wy / np.maximum(omega, 1e-9)
    longitudinal = []
    transverse = []
    for channel in slopes:
        fx, fy = (
            scipy.fft.rfft2((slope * region).astype(np.float32), size, workers=2)
            for slope in channel
        )
        longitudinal.append((ux * fx + uy * fy)[used])
        transverse.append((ux * fy - uy * fx)[used])
    scale = count * float((region.astype(np.float64) ** 2).sum())

    def mean(power: Array) -> Array:
        return np.bincount(index, power, bands) / scale

    along = [[mean((a * b.conj()).real) for b in longitudinal] for a in longitudinal]
    across = [mean(np.abs(wave) ** 2) for wave in transverse]
    return np.sqrt(edges[1:] * edges[:-1]), np.transpose(along), np.transpose(across)


def fit_spectra(
    along: Array, across: Array, transfer: Any, glare: Any
) -> tuple[Array, Array, Array]:
    """Powers (n,) of relief and glare (correlated with it or not) per mode, not negative, and (C,)
    of the noise, from measured :func:`cross_spectra`.

    Per band, along = S M M^T + T g g^T + X (M g^T + g M^T) + noise in least squares over S, T and
    X, with the `transfer` M (C, n) and the `glare` g (C,); the noise is white and taken from the
    finest bands of `across`. In a single channel they are indistinguishable: all is relief.
    """
    noise = np.median(across[-2:], axis=0)
    g = np.asarray(glare, dtype=np.float64)
    finite = all(bool(np.isfinite(values).all()) for values in (along, across, transfer, g))
    require(finite, NOT_SKIN)
    channels = len(g)
    excess = along - np.diag(noise)
    if channels == 1:
        signal = np.maximum(excess[:, 0, 0], 0.0) / np.maximum(transfer[0] ** 2, 1e-12)
        return signal, np.zeros_like(signal), np.maximum(noise, 1e-12)
    first, second = np.triu_indices(channels)
    powers = []
    for measured, total, m in zip(excess, along, transfer.T, strict=True):
        level = np.sqrt(np.maximum(np.diag(total), 1e-20))
        scale = 1.0 / (level[first] * level[second])
        mixed = m[first] * g[second] + g[first] * m[second]
        columns = [m[first] * m[second], g[first] * g[second], mixed]
        design = np.stack(columns, axis=1)[:, : 3 if channels > 2 else 2] * scale[:, None]
        solution = np.linalg.lstsq(design, measured[first, second] * scale, rcond=None)[0]
        powers.append(np.maximum(solution[:2], 0.0))
    signal, specular = np.transpose(powers)
    return signal, specular, np.maximum(noise, 1e-12)


# Removing noise of a known spectrum from the relief, patch by patch.
#
# Ridges are a local wave: in a small window nearly all their power lies in a few frequencies, while
# noise fills all of them. Each window's own spectrum, less the noise's, says what to keep (an
# empirical Wiener filter); the gain never exceeds one, so that nothing is added that was not
# measured.


def _window_power(image: FloatArray, side: int) -> FloatArray:
    """Mean power spectrum (side, side // 2 + 1) of windows of `image` (H, W): what pure noise
    gives."""
    parts = sliding_window_view(image, (side, side))[:: side // 2, :: side // 2] * _window(side)
    power = np.mean(np.abs(scipy.fft.rfft2(parts)) ** 2, axis=(0, 1), dtype=np.float64)
    return np.asarray(power, dtype=np.float32)


_WINDOW_OVERLAP = 4
"""Windows advance by their side over this number. Chosen on: speed. Range: 2 to 8
(validation/parameters)."""


def _local_wiener(relief: FloatArray, noise_power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Denoise `relief` (H, W), and estimate the error that remains (J. S. Lim, "Two-Dimensional
    Signal and Image Processing", 1990, 9.2). `noise_power`: (side, side // 2 + 1),
    :func:`_window_power` of pure noise in windows of that side.
    """
    side = len(noise_power)
    hop = side // _WINDOW_OVERLAP
    rows, columns = relief.shape
    margins = [(side, side + (-(n + 2 * side)) % hop) for n in relief.shape]
    padded = np.pad(relief, margins, mode="reflect").astype(np.float32)
    window = _window(side)
    total, variance, norm = np.zeros((3, *padded.shape), dtype=np.float32)
    double = np.full(side // 2 + 1, 2.0, dtype=np.float32)
    double[0] = double[-1] = 1.0
    for row, strip in enumerate(sliding_window_view(padded, (side, side))[::hop, ::hop]):
        spectrum = scipy.fft.rfft2(strip * window, workers=2)
        raw = (spectrum.real**2 + spectrum.imag**2).astype(np.float32)
        power = scipy.ndimage.uniform_filter(raw, (1, 3, 3), mode=("wrap", "wrap", "nearest"))
        excess = np.maximum(power - 1.5 * noise_power, 0.0)
        gain = excess / (excess + noise_power + 1e-30)
        kept = scipy.fft.irfft2(spectrum * gain, (side, side), workers=2) * window
        # the error's power in each window: g^2 N + (1 - g)^2 S = g N for the Wiener gain
        error = (
            (gain * noise_power * double).sum(axis=(1, 2)) / (side**4) * (1 / (window**2).mean())
        )
        for column, (denoised, residual) in enumerate(zip(kept, error, strict=True)):
            place = tuple(slice(k * hop, k * hop + side) for k in (row, column))
            total[place] += denoised
            variance[place] += residual * window * window
            norm[place] += window * window
    norm = np.maximum(norm, 1e-6)
    inner = np.s_[side : side + rows, side : side + columns]
    return (total / norm)[inner], np.sqrt(variance / norm)[inner]


def _window(side: int) -> FloatArray:
    sine = np.sin(np.pi * (np.arange(side) + 0.5) / side).astype(np.float32)
    return np.outer(sine, sine)


NOT_SKIN = (
    "the images cannot be of skin under these lights: the brightness that follows from them is"
    " zero, negative or not finite; check the images (values that wrapped round, a wrong order) and"
    " the lights."
)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The white band's photometric stereo on the fine grid."""

    channels: tuple[str, ...]
    # (C, h, w, 3) brightness times normal, blurred by the skin, with specular reflection
    pseudo_normals: FloatArray
    transfer: FloatArray  # (C, rows, columns) of the skin on the grid's frequencies
    brightness: FloatArray  # (C,) diffuse brightness over the prediction for an albedo of one
    trust: FloatArray  # (h, w) in [0, 1]: fades out towards grazing slopes and the outline
    region: FloatArray  # (h, w) smooth window on the part that faces the camera, for spectra


@dataclass(frozen=True, slots=True, eq=False)
class Unmixing:
    """How the channels' slopes are summed."""

    weights: list[FloatArray]  # one for each channel, on the grid's frequencies
    noise: Array  # (C,) power of the noise in each channel's slopes


def measure(  # noqa: PLR0917
    band: BandImages,
    grid: Grid,
    surface_mm: FloatArray,
    light: Lighting,
    skin: Mapping[str, Diffusion],
    brightness: Mapping[str, float],
) -> Measured:
    """Photometric stereo of every channel with shared weights on the smooth surface."""
    # light that is reflected at the boundary does not enter
    g = pseudo_normals(
        band.stack,
        band.rig,
        surface_mm,
        grid.mask,
        light.trust,
        view=grid.view,
        entering=light.entering,
    )
    slant_deg = slant_of(surface_mm, grid.pitch_mm)
    trust = trust_of(slant_deg, grid)
    inner = (grid.mask & (grid.depth_mm > 0.5) & (slant_deg < 50)).astype(np.float32)
    if not inner.any():
        inner = (grid.mask & (grid.depth_mm > 0.5 * grid.depth_mm.max())).astype(np.float32)
    region = cv2.GaussianBlur(inner, (0, 0), 0.2 / grid.pitch_mm) * inner
    transfer = np.stack([grid.sampled(skin[name]) for name in band.channels])
    levels = np.array([brightness[name] for name in band.channels], dtype=np.float32)
    return Measured(band.channels, g, transfer, levels, trust, region)


def _relief_residual(
    measured: Measured, grid: Grid, surface_mm: FloatArray
) -> tuple[list[Slopes], FloatArray]:
    """Slopes that the measurement has beyond the current surface's, by channel, and (C,) weight of
    the specular reflection in them, one in the first. Predicted are the normals blurred by the
    skin; the local albedo, and with it the darkening of valleys (1 + k h), drops out; the specular
    part of the brightness is estimated by colour.
    """
    own = (
        normals_from_gradients(*height_gradients(surface_mm, grid.pitch_mm)) * grid.mask[..., None]
    )
    normals = grid.forward(np.moveaxis(own, -1, 0), extend=True)
    predicted = [
        np.moveaxis(grid.inverse(normals * measured.transfer[c]) * measured.brightness[c], 0, -1)
        for c in range(len(measured.channels))
    ]
    level = [grid.smooth(e[..., 2], grid.mask, 0.4) for e in predicted]
    albedo = _diffuse_scale(
        level, [grid.smooth(g[..., 2], grid.mask, 0.4) for g in measured.pseudo_normals]
    )
    inner = measured.region > 0
    middle = np.median(albedo[inner])
    require(0.0 < middle < np.inf, NOT_SKIN)
    albedo = grid.smooth(np.clip(albedo, 0.6 * middle, 1.6 * middle), grid.mask, 0.8)
    glare = np.array([1.0 / max(float(np.median((albedo * z)[inner])), 1e-9) for z in level])
    slopes: list[Slopes] = []
    for c, e in enumerate(predicted):
        length = np.sqrt((e * e).sum(axis=-1))
        z = np.maximum(e[..., 2], 0.05 * length + 1e-6)
        diffuse = np.maximum(albedo, 0.1 * middle) * np.maximum(z, 0.1 * measured.brightness[c])
        g = measured.pseudo_normals[c]
        x, y = (-(g[..., axis] - e[..., axis] / z * g[..., 2]) / diffuse for axis in range(2))
        slopes.append(
            (_ridge_band(x, grid) * measured.trust, _ridge_band(y, grid) * measured.trust)
        )
    return slopes, (glare / glare[0]).astype(np.float32)


CROSSOVER_MM = 0.3
"""Standard deviation of the Gaussian that leaves the shape's frequencies to the coarse grid. Chosen
on: judgement. Range: 0.3 to 0.42 (validation/parameters)."""


def _ridge_band(slope: FloatArray, grid: Grid, sigma_mm: float = CROSSOVER_MM) -> FloatArray:
    """A slope less its local mean, so that what belongs to the coarse grid does not ring at the
    outline."""
    return slope - grid.smooth(slope, grid.mask, sigma_mm)


def _diffuse_scale(predicted: list[FloatArray], measured: list[FloatArray]) -> FloatArray:
    """Local scale a of measured = a predicted + specular, equal in all channels; a single one has
    no such part."""
    if len(predicted) == 1:
        return measured[0] / np.maximum(predicted[0], 1e-6)
    of_predicted = np.stack(predicted) - np.mean(predicted, axis=0)
    of_measured = np.stack(measured) - np.mean(measured, axis=0)
    covariance = (of_predicted * of_measured).sum(axis=0)
    return np.asarray(covariance / np.maximum((of_predicted**2).sum(axis=0), 1e-9))


def unmixing(measured: Measured, grid: Grid, slopes: list[Slopes], glare: FloatArray) -> Unmixing:
    """Weights of the channels from the powers of relief, specular reflection and noise in this
    capture."""
    centres, along, across = cross_spectra(slopes, measured.region, grid.pitch_mm)
    omega = np.linspace(0, float(grid.omega[2].max()), 512)
    wx = np.asarray(grid.omega[0][0], dtype=np.float64)
    rows = [np.asarray(t[0], dtype=np.float64) for t in measured.transfer]
    transfer = np.stack([np.interp(centres, wx, row) for row in rows])
    signal, specular, noise = fit_spectra(along, across, transfer, glare)
    # foreshortened ridges (slant up to 60 deg) have up to twice the frequency; a floor keeps smooth
    # features
    signal = np.array([signal[(centres >= w / 2) & (centres <= w * 1.0001)].max() for w in centres])
    signal = np.maximum(signal, (0.4 * np.minimum(1, 12 / centres) ** 2) ** 2)
    # ridges are unmixed with little shrinkage, as if they were 4 times as strong (4 to 5.6 do):
    # steep flanks shade less than linearly, and noise is removed later
    signal = signal * (1 + 3 * smooth_step(((centres - 7) / 4).astype(np.float32)))
    specular = np.maximum(4 * specular, 1e-5)
    log_omega = np.log(np.maximum(omega, 1e-3))
    fine_signal = np.exp(np.interp(log_omega, np.log(centres), np.log(signal)))
    fine_glare = np.exp(np.interp(log_omega, np.log(centres), np.log(specular)))
    fine_transfer = np.stack([np.interp(omega, wx, row) for row in rows])
    colours = len(measured.channels) > 1
    weights = unmixing_weights(fine_transfer, glare, fine_signal, fine_glare * colours, noise)
    return Unmixing([grid.radial(omega, w) for w in weights], noise)


def high_pass(grid: Grid, sigma_mm: float = CROSSOVER_MM) -> FloatArray:
    """Fraction of the fine grid at each frequency; the coarse grid has the rest."""
    return np.asarray(1 - np.exp(-0.5 * (grid.omega[2] * sigma_mm) ** 2))


def update(
    measured: Measured, grid: Grid, slopes: list[Slopes], mix: Unmixing, relief_mm: FloatArray
) -> FloatArray:
    """Relief (h, w) in mm that explains the residual slopes beside the current relief.

    One step of z <- W (p - F(z) + M z): the regularised inverse W acts on everything that was
    measured, so that repeating it settles and does not amplify noise.
    """
    total = _integrated(grid, slopes, mix.weights)
    kept = sum(w * t for w, t in zip(mix.weights, measured.transfer, strict=True))
    total = total + kept * grid.forward(relief_mm * measured.trust)
    return grid.inverse(total * high_pass(grid)) * grid.mask


def _integrated(
    grid: Grid, slopes: list[Slopes], weights: list[FloatArray]
) -> NDArray[np.complex64]:
    wx, wy, omega = grid.omega
    total = np.zeros(omega.shape, dtype=np.complex64)
    for w, (x, y) in zip(weights, slopes, strict=True):
        total += w * (wx * grid.forward(x) + wy * grid.forward(y))
    square = omega * omega
    square[0, 0] = 1.0
    return total * (-1j / square)


KNIT_MM = 0.5
"""Standard deviation of the Gaussian that separates relief and shape in the result. Chosen on:
judgement. Range: 0.35 to 0.5 (validation/parameters)."""


def detail_of(shape_mm: FloatArray, trust: FloatArray, grid: Grid) -> FloatArray:
    """The ridge band (h, w) of the coarse shape: creases and what else is finer than the crossover.
    Taken from the slopes less their local mean, so that the curvature at the outline is not taken
    for a ridge.
    """
    x, y = (
        _ridge_band(s, grid, KNIT_MM) * trust for s in height_gradients(shape_mm, grid.pitch_mm)
    )
    whole = _integrated(grid, [(x, y)], [np.ones(1, dtype=np.float32)])
    return grid.inverse(whole * high_pass(grid, KNIT_MM)) * grid.mask


_DENOISE_WINDOW_MM = 1.7
"""Side of a window: about four ridges. Chosen on: judgement. Range: 1.19 to 3.4
(validation/parameters)."""


def denoise(
    relief_mm: FloatArray, grid: Grid, mix: Unmixing, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Relief without the noise that the unmixing let through, and the standard deviation of what is
    left, mm. The noise's spectrum is that of white noise (seeded) sent through the same unmixing
    and integration.
    """
    rng = np.random.default_rng(seed)

    noise = [
        (rng.standard_normal((2, *grid.shape)) * np.sqrt(power)).astype(np.float32)
        for power in mix.noise
    ]
    pure = grid.inverse(_integrated(grid, noise, mix.weights) * high_pass(grid))
    # a multiple of the overlap
    side = max(16, _WINDOW_OVERLAP * round(_DENOISE_WINDOW_MM / grid.pitch_mm / _WINDOW_OVERLAP))
    if min(grid.shape) <= side:
        return relief_mm, np.full(grid.shape, float(pure.std()), dtype=np.float32)
    clean, deviation = _local_wiener(relief_mm, _window_power(pure, side))
    return clean * grid.mask, deviation


# Result of both methods: by network, and by colour.


@dataclass(frozen=True, slots=True, eq=False)
class ReliefEstimate:
    """Ridges on the fine grid, beside a smooth shape."""

    # (h, w) along the line of sight, free of its local mean, zero outside the mask
    relief_mm: FloatArray
    deviation_mm: FloatArray  # (h, w) its standard deviation
    trust: FloatArray  # (h, w) in [0, 1]: fades out towards grazing slopes and the outline
    albedo: FloatArray  # (h, w) diffuse brightness of the first channel, relative
    level: FloatArray | None = None
    """(h, w) brightness of the second channel, specular reflection included, where a network
    estimated the relief."""
    output: FloatArray | None = None
    """(9, h, w) output of that network."""
    facts: Mapping[str, Any] = field(default_factory=dict)


# The relief by colour: a linear estimate, refined by prediction and comparison.

_SEED = 0
"""Seed of the noise that is filtered to measure its spectrum. Source: definition."""
_COLOUR_MODEL_ERROR = 0.5
"""Error of the relief that is not noise (specular reflection taken for relief, flanks too steep to
be resolved, skin that scatters otherwise), over the relief's local rms height. Chosen on: simulated
fingers (validation/accuracy). Range: none within 0.7 to 1.4 (validation/parameters)."""


def relief_by_colour(
    measured: Measured,
    grid: Grid,
    smooth_mm: FloatArray,
    rounds: int,
) -> ReliefEstimate:
    """Relief that explains the slopes of all channels behind scattering and specular reflection.

    `measured`: of the white band on the fine grid; `smooth_mm`: (h, w) the shape without the
    relief.
    """
    relief = np.zeros(grid.shape, dtype=np.float32)
    for _ in range(rounds * 2):
        slopes, glare = _relief_residual(measured, grid, smooth_mm + relief)
        mix = unmixing(measured, grid, _with_relief(slopes, measured, grid, relief), glare)
        relief = update(measured, grid, slopes, mix, relief)
        relief, noise = denoise(relief, grid, mix, _SEED)
    height = np.sqrt(np.maximum(grid.smooth(relief * relief, grid.mask, 0.6), 0.0))
    model = np.float32(_COLOUR_MODEL_ERROR) * height
    return ReliefEstimate(
        relief_mm=relief,
        deviation_mm=np.sqrt(noise**2 + model**2).astype(np.float32),
        trust=measured.trust,
        albedo=np.sqrt((measured.pseudo_normals[0] ** 2).sum(axis=-1)),
        facts={"relief_by": "colour"},
    )


def _with_relief(
    slopes: list[Slopes], measured: Measured, grid: Grid, relief: FloatArray
) -> list[Slopes]:
    """The residual slopes of the channels if there were no current relief."""
    if not relief.any():
        return slopes
    spectrum = grid.forward(relief)
    wx, wy, _ = grid.omega
    return [
        (x + grid.inverse(spectrum * (1j * wx) * t), y + grid.inverse(spectrum * (1j * wy) * t))
        for (x, y), t in zip(slopes, measured.transfer, strict=True)
    ]
