"""The relief from the colours of the white band, behind scattering and specular reflection, on the fine grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.settings import Checked, Limits
from splitknit.skin.colour import SpectralFit, cross_spectra, fit_spectra, unmixing_weights
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.grid import BandImages, Grid, smooth_step
from splitknit.skin.light import Lighting, slant_of, trust_of

# Removing noise of a known spectrum from the relief, patch by patch.
#
# Ridges are a local wave: in a small window nearly all their power lies in a few frequencies, while noise fills all of
# them. Each window's own spectrum, less the noise's, says what to keep (an empirical Wiener filter); the gain never
# exceeds one, so that nothing is added that was not measured.


_OVERLAP = 4
"""Windows advance by their side over this number."""


@dataclass(frozen=True, slots=True)
class LocalWienerSettings(Checked):
    """The windows."""

    _group = "denoise"
    window_mm: Annotated[float, Limits(0, above=True)] = 1.7
    """Side of a window: about four ridges."""
    caution: Annotated[float, Limits(0)] = 1.5
    """Factor on the noise's power where a window's own power is estimated."""

    def window_px(self, pitch_mm: float) -> int:
        """Side of a window in pixels: a multiple of `overlap`, at least 16."""
        return max(16, _OVERLAP * round(self.window_mm / pitch_mm / _OVERLAP))


def _window_power(image: FloatArray, side: int) -> FloatArray:
    """Mean power spectrum (side, side // 2 + 1) of windows of `image` (H, W): what pure noise gives."""
    window = _window(side)
    rows = range(0, image.shape[0] - side + 1, side // 2)
    columns = range(0, image.shape[1] - side + 1, side // 2)
    require(len(rows) > 0 and len(columns) > 0, f"the image must be at least {side} pixels wide and high.")
    total = np.zeros((side, side // 2 + 1), dtype=np.float64)
    for row in rows:
        for column in columns:
            part = image[row : row + side, column : column + side] * window
            total += np.abs(scipy.fft.rfft2(part)) ** 2
    return np.asarray(total / (len(rows) * len(columns)), dtype=np.float32)


def _local_wiener(
    relief: FloatArray, noise_power: FloatArray, settings: LocalWienerSettings, pitch_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Denoise `relief` (H, W); state what is left (J. S. Lim, "Two-Dimensional Signal and Image Processing", 1990,
    9.2). `noise_power`: of :func:`_window_power` for pure noise.
    """
    side = settings.window_px(pitch_mm)
    require(
        noise_power.shape == (side, side // 2 + 1),
        f"noise_power must have the shape {(side, side // 2 + 1)}, but it has {noise_power.shape}.",
    )
    hop = side // _OVERLAP
    rows, columns = relief.shape
    extra = [(-(n + 2 * side)) % hop for n in (rows, columns)]
    margins = ((side, side + extra[0]), (side, side + extra[1]))
    padded = np.pad(relief, margins, mode="reflect" if min(rows, columns) > side else "edge").astype(np.float32)
    window = _window(side)
    total = np.zeros_like(padded)
    variance = np.zeros_like(padded)
    norm = np.zeros_like(padded)
    starts = range(0, padded.shape[1] - side + 1, hop)
    double = np.full(side // 2 + 1, 2.0, dtype=np.float32)
    double[0] = double[-1] = 1.0
    for row in range(0, padded.shape[0] - side + 1, hop):
        strip = np.stack([padded[row : row + side, column : column + side] for column in starts]) * window
        spectrum = scipy.fft.rfft2(strip, workers=2)
        raw = (spectrum.real**2 + spectrum.imag**2).astype(np.float32)
        power = scipy.ndimage.uniform_filter(raw, (1, 3, 3), mode=("wrap", "wrap", "nearest"))
        excess = np.maximum(power - np.float32(settings.caution) * noise_power, np.float32(0.0))
        gain = excess / (excess + noise_power + np.float32(1e-30))
        kept = scipy.fft.irfft2(spectrum * gain, (side, side), workers=2) * window
        # the error's power in each window: g^2 N + (1 - g)^2 S = g N for the Wiener gain
        error = (
            (gain * noise_power * double).sum(axis=(1, 2)) / np.float32(side**4) * np.float32(1 / (window**2).mean())
        )
        for column, part, left in zip(starts, kept, error, strict=True):
            place = np.s_[row : row + side, column : column + side]
            total[place] += part
            variance[place] += left * window * window
            norm[place] += window * window
    norm = np.maximum(norm, np.float32(1e-6))
    inner = np.s_[side : side + rows, side : side + columns]
    return (total / norm)[inner], np.sqrt(variance / norm)[inner]


def _window(side: int) -> FloatArray:
    hann = np.sin(np.pi * (np.arange(side) + 0.5) / side).astype(np.float32)
    return np.asarray(np.outer(hann, hann), dtype=np.float32)


CROSSOVER_MM = 0.3
"""Standard deviation of the Gaussian that leaves the shape's frequencies to the coarse grid."""


RIDGE_PER_MM = (9.0, 24.0)
"""Angular frequencies (rad/mm) of ridges: periods of 0.70 to 0.26 mm, as seen from above."""
KNIT_MM = 0.5
"""Standard deviation of the Gaussian that parts relief and shape in the result."""
RIDGE_TRUST = 4.0
"""Factor on the expected power of the ridges, so that the unmixing shrinks them less than the least-squares optimum."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The white band's photometric stereo on the fine grid."""

    channels: tuple[str, ...]
    pseudo_normals: FloatArray
    """(C, h, w, 3) brightness times normal, blurred by the skin, with specular reflection."""
    transfer: FloatArray
    """(C, rows, columns) of the skin on the grid's frequencies."""
    brightness: FloatArray
    """(C,) diffuse brightness over the prediction for an albedo of one."""
    trust: FloatArray
    """(h, w) in [0, 1]: fades out towards grazing slopes and the outline."""
    region: FloatArray
    """(h, w) smooth window on the part that faces the camera, for spectra."""


@dataclass(frozen=True, slots=True, eq=False)
class Unmixing:
    """How the channels' slopes are summed."""

    weights: list[FloatArray]
    """One for each channel, on the grid's frequencies."""
    fit: SpectralFit
    glare: FloatArray
    """(C,) weight of the specular reflection in each channel, one in the first."""


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
        band.stack, band.rig, surface_mm, grid.mask, light.trust, view=grid.view, entering=light.entering
    )
    slant_deg = slant_of(surface_mm, grid.pitch_mm)
    trust = trust_of(slant_deg, grid)
    inner = (grid.mask & (grid.depth_mm > 0.5) & (slant_deg < 50)).astype(np.float32)
    if not inner.any():
        inner = (grid.mask & (grid.depth_mm > 0.5 * grid.depth_mm.max())).astype(np.float32)
    region = cv2.GaussianBlur(inner, (0, 0), 0.2 / grid.pitch_mm) * inner
    transfer = np.stack([grid.sampled(skin[name]) for name in band.channels])
    levels = np.array([brightness[name] for name in band.channels], dtype=np.float32)
    return Measured(band.channels, g, transfer, levels, trust, np.asarray(region, dtype=np.float32))


def _mean_normals(surface_mm: FloatArray, grid: Grid) -> FloatArray:
    """Unit normals (h, w, 3) of a surface that is finite everywhere, zero outside the mask."""
    slope_x, slope_y = height_gradients(surface_mm, grid.pitch_mm)
    return normals_from_gradients(slope_x, slope_y) * grid.mask[..., None]


@dataclass(frozen=True, slots=True, eq=False)
class _ReliefResidual:
    """What the measurement has beyond the prediction from the current surface."""

    slopes: list[tuple[FloatArray, FloatArray]]
    """C pairs (h, w)."""
    glare: FloatArray
    """(C,) weight of the specular reflection in each channel's slopes, one in the first."""
    predicted: FloatArray
    """(h, w, 3) predicted pseudo-normals of the first channel."""
    diffuse: FloatArray
    """(h, w) diffuse brightness of the first channel."""


def _relief_residual(measured: Measured, grid: Grid, surface_mm: FloatArray) -> _ReliefResidual:
    """Slopes that the measurement has beyond the current surface's. Predicted are the normals blurred by the skin; the
    local albedo, and with it the darkening of valleys (1 + k h), drops out; the specular part of the brightness is
    estimated by colour.
    """
    normals = grid.forward(np.moveaxis(_mean_normals(surface_mm, grid), -1, 0), extend=True)
    predicted = [
        np.moveaxis(grid.inverse(normals * measured.transfer[c]) * measured.brightness[c], 0, -1)
        for c in range(len(measured.channels))
    ]
    level = [grid.smooth(e[..., 2], grid.mask, 0.4) for e in predicted]
    albedo = _diffuse_scale(level, [grid.smooth(g[..., 2], grid.mask, 0.4) for g in measured.pseudo_normals])
    inner = measured.region > 0
    middle = np.float32(np.median(albedo[inner]))
    albedo = grid.smooth(np.clip(albedo, 0.6 * middle, 1.6 * middle), grid.mask, 0.8)
    glare = np.array([1.0 / max(float(np.median((albedo * z)[inner])), 1e-9) for z in level])
    slopes, scales = [], []
    for c, e in enumerate(predicted):
        length = np.sqrt((e * e).sum(axis=-1))
        z = np.maximum(e[..., 2], 0.05 * length + np.float32(1e-6))
        diffuse = np.maximum(albedo, np.float32(0.1) * middle) * np.maximum(z, np.float32(0.1) * measured.brightness[c])
        scales.append(diffuse)
        e[..., 2] = z
        g = measured.pseudo_normals[c]
        slopes.append(tuple(-(g[..., axis] - e[..., axis] / z * g[..., 2]) / diffuse for axis in range(2)))
    trusted = [tuple(_ridge_band(s, grid) * measured.trust for s in pair) for pair in slopes]
    return _ReliefResidual([(x, y) for x, y in trusted], (glare / glare[0]).astype(np.float32), predicted[0], scales[0])


def _ridge_band(slope: FloatArray, grid: Grid, sigma_mm: float = CROSSOVER_MM) -> FloatArray:
    """A slope less its local mean, so that what belongs to the coarse grid does not ring at the outline."""
    return slope - grid.smooth(slope, grid.mask, sigma_mm)


def _diffuse_scale(predicted: list[FloatArray], measured: list[FloatArray]) -> FloatArray:
    """Local scale a of measured = a predicted + specular, equal in all channels; a single one has no such part."""
    if len(predicted) == 1:
        return np.asarray(measured[0] / np.maximum(predicted[0], np.float32(1e-6)), dtype=np.float32)
    n = np.float32(len(predicted))
    mean_p, mean_m = sum(predicted) / n, sum(measured) / n
    above = sum((p - mean_p) * (m - mean_m) for p, m in zip(predicted, measured, strict=True))
    below = sum((p - mean_p) ** 2 for p in predicted)
    return np.asarray(above / np.maximum(below, np.float32(1e-9)), dtype=np.float32)


def unmixing(
    measured: Measured, grid: Grid, slopes: list[tuple[FloatArray, FloatArray]], glare: FloatArray
) -> Unmixing:
    """Weights of the channels from the powers of relief, specular reflection and noise in this capture."""
    centres, along, across = cross_spectra(slopes, measured.region, grid.pitch_mm)
    omega = np.linspace(0, float(grid.omega[2].max()), 512)
    wx = np.asarray(grid.omega[0][0], dtype=np.float64)
    rows = [np.asarray(t[0], dtype=np.float64) for t in measured.transfer]
    transfer = np.stack([np.interp(centres, wx, row) for row in rows])
    fit = _plausible(fit_spectra(centres, along, across, transfer, glare))
    # foreshortened ridges (slant up to 60 deg) have up to twice the frequency; a floor keeps smooth features
    signal = np.array([fit.signal[(centres >= w / 2) & (centres <= w * 1.0001)].max() for w in centres])
    signal = np.maximum(signal, (0.4 * np.minimum(1, 12 / centres) ** 2) ** 2)
    # ridges are unmixed with little shrinkage: steep flanks shade less than linearly, and noise is removed later
    signal = signal * (1 + (RIDGE_TRUST - 1) * smooth_step(((centres - 7) / 4).astype(np.float32)))
    specular = np.maximum(4 * fit.glare, 1e-5)
    log_omega = np.log(np.maximum(omega, 1e-3))
    fine_signal = np.exp(np.interp(log_omega, np.log(centres), np.log(signal)))
    fine_glare = np.exp(np.interp(log_omega, np.log(centres), np.log(specular)))
    fine_transfer = np.stack([np.interp(omega, wx, row) for row in rows])
    colours = len(measured.channels) > 1
    weights = unmixing_weights(fine_transfer, glare, fine_signal, fine_glare * colours, fit.noise)
    return Unmixing([grid.radial(omega, w) for w in weights], fit, glare)


def _plausible(fit: SpectralFit) -> SpectralFit:
    """The fit with the relief's power above the ridges' own frequency limited to the fall of a ridge's harmonics. Where
    skin passes next to nothing, errors in the glare's colour look like relief. Slopes of flat ridges with narrow, steep
    valleys fall off about as one over the frequency; nothing rougher is believed.
    """
    omega = fit.omega_per_mm
    ridges = np.flatnonzero((omega >= RIDGE_PER_MM[0]) & (omega <= RIDGE_PER_MM[1]))
    peak = int(ridges[np.argmax(fit.signal[ridges])])
    limit = fit.signal[peak] * (omega[peak] / omega) ** 2
    return replace(fit, signal=np.where(omega > omega[peak], np.minimum(fit.signal, limit), fit.signal))


def high_pass(grid: Grid, sigma_mm: float = CROSSOVER_MM) -> FloatArray:
    """Fraction of the fine grid at each frequency; the coarse grid has the rest."""
    return np.asarray(1 - np.exp(-0.5 * (grid.omega[2] * np.float32(sigma_mm)) ** 2), dtype=np.float32)


def update(
    measured: Measured, grid: Grid, slopes: list[tuple[FloatArray, FloatArray]], mix: Unmixing, relief_mm: FloatArray
) -> FloatArray:
    """Relief (h, w) in mm that explains the residual slopes beside the current relief.

    One step of z <- W (p - F(z) + M z): the regularised inverse W acts on everything that was measured, so that
    repeating it settles and does not amplify noise.
    """
    total = _integrated(grid, slopes, mix.weights)
    kept = sum(w * t for w, t in zip(mix.weights, measured.transfer, strict=True))
    total = total + kept * grid.forward(relief_mm * measured.trust)
    return grid.inverse(total * high_pass(grid)) * grid.mask


def _integrated(
    grid: Grid, slopes: list[tuple[FloatArray, FloatArray]], weights: list[FloatArray]
) -> NDArray[np.complex64]:
    wx, wy, omega = grid.omega
    total = np.zeros(omega.shape, dtype=np.complex64)
    for w, (x, y) in zip(weights, slopes, strict=True):
        total += w * (wx * grid.forward(x) + wy * grid.forward(y))
    square = omega * omega
    square[0, 0] = 1.0
    return np.asarray(total * (-1j / square), dtype=np.complex64)


def detail_of(shape_mm: FloatArray, trust: FloatArray, grid: Grid) -> FloatArray:
    """The ridge band (h, w) of the coarse shape: creases and what else is finer than the crossover. Taken from the
    slopes less their local mean, so that the curvature at the outline is not taken for a ridge.
    """
    x, y = (_ridge_band(s, grid, KNIT_MM) * trust for s in height_gradients(shape_mm, grid.pitch_mm))
    whole = _integrated(grid, [(x, y)], [np.ones(1, dtype=np.float32)])
    return grid.inverse(whole * high_pass(grid, KNIT_MM)) * grid.mask


def denoise(
    relief_mm: FloatArray, grid: Grid, mix: Unmixing, settings: LocalWienerSettings, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Relief without the noise that the unmixing let through, and the standard deviation of what is left, mm. The
    noise's spectrum is that of white noise (seeded) sent through the same unmixing and integration.
    """
    rng = np.random.default_rng(seed)
    noise = [
        tuple((rng.standard_normal(grid.shape) * np.sqrt(power)).astype(np.float32) for _ in range(2))
        for power in mix.fit.noise
    ]
    pure = grid.inverse(_integrated(grid, [(x, y) for x, y in noise], mix.weights) * high_pass(grid))
    side = settings.window_px(grid.pitch_mm)
    if min(grid.shape) < side:
        return relief_mm, np.full(grid.shape, float(pure.std()), dtype=np.float32)
    clean, deviation = _local_wiener(relief_mm, _window_power(pure, side), settings, grid.pitch_mm)
    return clean * grid.mask, deviation


def _scattering_sensitivity(
    measured: Measured, grid: Grid, mix: Unmixing, other: Mapping[str, Diffusion], relief_mm: FloatArray
) -> float:
    """Relative change of the relief's gain if the skin scattered as `other` does and the unmixing did not know."""
    gain = sum(
        w * (grid.sampled(other[name]) - t)
        for w, t, name in zip(mix.weights, measured.transfer, measured.channels, strict=True)
    )
    power = np.abs(grid.forward(relief_mm * measured.region)) ** 2
    return float((gain * power).sum(dtype=np.float64) / max(float(power.sum(dtype=np.float64)), 1e-30))


# Result of both methods: by network, and by colour.


@dataclass(frozen=True, slots=True, eq=False)
class ReliefEstimate:
    """Ridges on the fine grid, beside a smooth shape."""

    relief_mm: FloatArray
    """(h, w) along the line of sight, free of its local mean, zero outside the mask."""
    deviation_mm: FloatArray
    """(h, w) its standard deviation."""
    trust: FloatArray
    """(h, w) in [0, 1]: fades out towards grazing slopes and the outline."""
    albedo: FloatArray
    """(h, w) diffuse brightness of the first channel, relative."""
    level: FloatArray | None = None
    """(h, w) brightness of the second channel, specular reflection included, where a network estimated the relief."""
    output: FloatArray | None = None
    """(9, h, w) output of that network."""
    facts: Mapping[str, Any] = field(default_factory=dict)


# The relief by colour: a linear estimate, refined by prediction and comparison.


_SEED = 0
"""Seed of the noise that is filtered to measure its spectrum."""


@dataclass(frozen=True, slots=True)
class ColourSettings(Checked):
    """Relief and specular reflection separated by their colours."""

    _group = "metric.by_colour"
    steps: Annotated[int, Limits(1)] = 2
    """Corrections of the relief in each round."""
    model_error: Annotated[float, Limits(0)] = 0.5
    """Error of the relief that is not noise (glare taken for relief, flanks too steep to be resolved), as a part of the
    relief's local rms height; measured on simulated fingers, see docs/experiments/accuracy.md."""
    denoise: LocalWienerSettings = field(default_factory=LocalWienerSettings)
    """Removal of the noise from the relief."""


def relief_by_colour(
    measured: Measured, grid: Grid, smooth_mm: FloatArray, other: Mapping[str, Diffusion], settings: ColourSettings
) -> ReliefEstimate:
    """Relief that explains the slopes of all channels behind scattering and specular reflection.

    `measured`: of the white band on the fine grid; `smooth_mm`: (h, w) the shape without the relief; `other`: transfer
    function of each channel one standard deviation of the scattering away.
    """
    relief = np.zeros(grid.shape, dtype=np.float32)
    for _ in range(settings.steps):
        residual = _relief_residual(measured, grid, smooth_mm + relief)
        mix = unmixing(measured, grid, _with_relief(residual.slopes, measured, grid, relief), residual.glare)
        relief = update(measured, grid, residual.slopes, mix, relief)
        relief, noise = denoise(relief, grid, mix, settings.denoise, _SEED)
    sensitivity = abs(_scattering_sensitivity(measured, grid, mix, other, relief))
    height = np.sqrt(np.maximum(grid.smooth(relief * relief, grid.mask, 0.6), np.float32(0.0)))
    model = np.float32(np.hypot(sensitivity, settings.model_error)) * height
    return ReliefEstimate(
        relief_mm=relief,
        deviation_mm=np.sqrt(noise**2 + model**2).astype(np.float32),
        trust=measured.trust,
        albedo=np.sqrt((measured.pseudo_normals[0] ** 2).sum(axis=-1)),
        facts={"relief_by": "colour", "gain_sensitivity": sensitivity},
    )


def _with_relief(
    slopes: list[tuple[FloatArray, FloatArray]], measured: Measured, grid: Grid, relief: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """The residual slopes of the channels if there were no current relief."""
    if not relief.any():
        return slopes
    spectrum = grid.forward(relief)
    wx, wy, _ = grid.omega
    return [
        (x + grid.inverse(spectrum * (1j * wx) * t), y + grid.inverse(spectrum * (1j * wy) * t))
        for (x, y), t in zip(slopes, measured.transfer, strict=True)
    ]
