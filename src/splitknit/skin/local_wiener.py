"""Removing noise of a known spectrum from the relief, patch by patch.

Ridges are a local wave: in a small window nearly all their power lies in a few frequencies, while noise fills all of
them. Each window's own spectrum, less the noise's, says what to keep (an empirical Wiener filter); the gain never
exceeds one, so that nothing is drawn that was not measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.settings import Checked, Limits

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


def window_power(image: FloatArray, side: int) -> FloatArray:
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


def local_wiener(
    relief: FloatArray, noise_power: FloatArray, settings: LocalWienerSettings, pitch_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Denoise `relief`.

    Parameters
    ----------
    relief : (H, W), finite everywhere
    noise_power : (side, side // 2 + 1)
        Of :func:`window_power` for pure noise, in the relief's units squared; side = `settings.window_px(pitch_mm)`.
    settings : LocalWienerSettings
    pitch_mm : float

    Returns
    -------
    denoised : (H, W) float32
    deviation : (H, W) float32
        Standard deviation of the error that is left: noise kept plus relief lost, in the relief's units.

    References
    ----------
    J. S. Lim, "Two-Dimensional Signal and Image Processing" (1990), section 9.2.
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
        power = _smooth((spectrum.real**2 + spectrum.imag**2).astype(np.float32))
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


def _smooth(power: NDArray[np.float32]) -> NDArray[np.float32]:
    along = ndimage.uniform_filter1d(power, 3, axis=1, mode="wrap")
    return np.asarray(ndimage.uniform_filter1d(along, 3, axis=2, mode="nearest"), dtype=np.float32)
