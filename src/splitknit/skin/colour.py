"""Relief and specular reflection separated by colour, frequency by frequency.

In the slopes that photometric stereo finds in channel c, the true slope d of the relief arrives through the skin's
transfer function M_c, and the glare's apparent slope s with a weight g_c, the same light divided by the channel's
diffuse brightness:

    p_c(w) = M_c(w) d(w) + g_c s(w) + noise.

M falls with the frequency in a way of its own in every channel while g does not depend on the frequency, so that two
channels or more separate d from s. The estimate of least mean-square error given the powers of d, s and the noise is
linear; with a generous power for s it is blind to the glare and shrinks d by little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.model import FloatArray

Float64Array = NDArray[np.float64]


def unmixing_weights(transfer: Any, glare: Any, signal: Any, glare_power: Any, noise: Any) -> Float64Array:
    """Weights (C, n) by which the channels' slopes are summed to estimate the true slope at n frequencies.

    signal M^T (signal M M^T + sum glare_power g g^T + noise)^-1 (N. Wiener 1949, "Extrapolation, Interpolation, and
    Smoothing of Stationary Time Series", for several channels), of the `transfer` function M (C, n) of each channel,
    the weights `glare` (C, G) of G independent glares in each channel, the expected powers `signal` (n,) of the true
    slope and `glare_power` (n,) or (n, G), and the `noise` (C,).
    """
    m = np.asarray(transfer, dtype=np.float64).T  # (n, C)
    g = np.asarray(glare, dtype=np.float64).reshape(m.shape[1], -1)
    power = np.asarray(glare_power, dtype=np.float64)
    power = power[:, None] if power.ndim == 1 else power
    covariance = (
        np.asarray(signal)[:, None, None] * m[:, :, None] * m[:, None, :]
        + np.einsum("ng,cg,dg->ncd", np.broadcast_to(power, (m.shape[0], g.shape[1])), g, g)
        + np.diag(np.asarray(noise, dtype=np.float64))
    )
    weights = np.linalg.solve(covariance, (np.asarray(signal)[:, None] * m)[..., None])[..., 0]
    return np.asarray(weights.T)


@dataclass(frozen=True, slots=True, eq=False)
class SpectralFit:
    """Powers of relief, glare and noise in the slopes of one capture."""

    omega_per_mm: Float64Array
    """(n,) centres of the bands, rad/mm."""
    signal: Float64Array
    """(n,) power of the true slope per mode, not negative."""
    glare: Float64Array
    """(n,) power of the glare's apparent slope, not negative."""
    noise: Float64Array
    """(C,) power of the noise."""


def cross_spectra(
    slopes: list[tuple[FloatArray, FloatArray]], region: FloatArray, pitch_mm: float, bands: int = 28
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Radially averaged cross-spectra between the slope fields (dz/dx, dz/dy), y up, of C channels.

    `region` (H, W): smooth window, zero outside the reliable surface; `bands`: equal on a logarithmic scale from a
    period of 1.25 mm to the finest. Returns omega_per_mm (n,), (n, C, C) of the slope along the wave vector: what a
    surface has, and (n, C) the power across it: a surface has none, so this is noise (and glare).
    """
    highest = 0.95 * np.pi / pitch_mm
    edges = np.geomspace(min(5.0, highest / 4), highest, bands + 1)
    rows, columns = region.shape
    size = (scipy.fft.next_fast_len(rows, True), scipy.fft.next_fast_len(columns, True))
    wy = -2 * np.pi * np.fft.fftfreq(size[0])[:, None] / pitch_mm
    wx = 2 * np.pi * np.fft.rfftfreq(size[1])[None, :] / pitch_mm
    omega = np.hypot(wx, wy)
    band = np.digitize(omega, edges) - 1
    used = (band >= 0) & (band < bands)
    index = band[used]
    count = np.maximum(np.bincount(index, minlength=bands), 1)
    ux, uy = wx / np.maximum(omega, 1e-9), wy / np.maximum(omega, 1e-9)
    longitudinal, transverse = [], []
    for slope_x, slope_y in slopes:
        fx = scipy.fft.rfft2((slope_x * region).astype(np.float32), size, workers=2)
        fy = scipy.fft.rfft2((slope_y * region).astype(np.float32), size, workers=2)
        longitudinal.append((ux * fx + uy * fy)[used])
        transverse.append((ux * fy - uy * fx)[used])
    scale = count * float((region.astype(np.float64) ** 2).sum())
    along = np.empty((bands, len(slopes), len(slopes)))
    for i, first in enumerate(longitudinal):
        for j, second in enumerate(longitudinal):
            along[:, i, j] = np.bincount(index, (first * second.conj()).real, bands) / scale
    across = np.stack([np.bincount(index, np.abs(t) ** 2, bands) / scale for t in transverse], axis=1)
    centres = np.sqrt(edges[1:] * edges[:-1])
    return np.asarray(centres), along, np.asarray(across)


def fit_spectra(
    omega_per_mm: Float64Array, along: Float64Array, across: Float64Array, transfer: Any, glare: Any
) -> SpectralFit:
    """Split measured :func:`cross_spectra` into relief, glare (correlated with it or not) and noise.

    Per band, along = S M M^T + T g g^T + X (M g^T + g M^T) + noise in least squares over S, T and X, with the
    `transfer` M (C, n) and the `glare` g (C,); the noise is white and taken from the finest bands of `across`. In a
    single channel they are indistinguishable: all is relief.
    """
    noise = np.median(across[-2:], axis=0)
    m = np.asarray(transfer, dtype=np.float64)
    g = np.asarray(glare, dtype=np.float64)
    channels = len(g)
    signal, specular = np.zeros(len(omega_per_mm)), np.zeros(len(omega_per_mm))
    first, second = np.triu_indices(channels)
    for n in range(len(omega_per_mm)):
        excess = along[n] - np.diag(noise)
        if channels == 1:
            signal[n] = max(excess[0, 0], 0.0) / max(m[0, n] ** 2, 1e-12)
            continue
        level = np.sqrt(np.maximum(np.diag(along[n]), 1e-20))
        scale = 1.0 / (level[first] * level[second])
        a, b = m[:, n], g
        columns = [a[first] * a[second], b[first] * b[second], a[first] * b[second] + b[first] * a[second]]
        design = np.stack(columns, axis=1)[:, : 3 if channels > 2 else 2] * scale[:, None]
        solution = np.linalg.lstsq(design, excess[first, second] * scale, rcond=None)[0]
        signal[n], specular[n] = max(solution[0], 0.0), max(solution[1], 0.0)
    return SpectralFit(omega_per_mm, signal, specular, np.maximum(noise, 1e-12))
