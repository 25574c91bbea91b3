"""Enhancement of a pressed print before its minutiae are sought: short-time Fourier filtering along the ridges.

Overlapping windows are transformed; in each, what runs along the local ridges and has their local period is kept. Dry
ridges close, scratches are bridged, noise goes; what is no ridge stays white.

References
----------
S. Chikkerur, A. Cartwright and V. Govindaraju, "Fingerprint enhancement using STFT analysis", Pattern Recognition 40,
2007 (windows, filters); A. Bazen and S. Gerez, IEEE TPAMI 24, 2002 (direction from averaged squared gradients).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit.model import FloatArray

_DIRECTIONS, _PERIODS = 64, 24
_LEAST_PX, _MOST_PX = 4.5, 15.0
"""Periods of ridges at 500 ppi: 0.23 to 0.76 mm."""
_LEVEL = 8.0
"""Grey levels; contrast below that is not raised further."""


# lengths in pixels at 500 ppi
_WINDOW_PX = 32
"""Side of a window: some four ridges."""
_STEP_PX = 8
"""Between windows."""
_DIRECTION_PX = 7.0
"""Sigma over which ridge directions are averaged."""
_SPREAD_DEG = 28.0
"""Sigma of the filter across directions."""
_SPREAD_PER_PX = 0.08
"""Sigma of the filter across frequencies, cycles a pixel."""
_CONTRAST_PX = 11.0
"""Sigma over which mean and contrast are made even."""
_STEEPNESS = 1.6
"""Of the grey curve of the result."""
_MIN_CONTRAST = 18.0
"""Standard deviation in grey levels below which there is no print."""


def enhance_print(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Enhance a print.

    Parameters
    ----------
    image : (H, W) uint8
        At 500 ppi, ridges dark.

    Returns
    -------
    (H, W) uint8
        Even ridges, dark; white where there are none.
    """
    grey = image.astype(np.float32)
    grey = np.minimum(grey, np.float32(np.percentile(grey, 99)))  # paper is flat
    centred = grey - _blur(grey, _CONTRAST_PX)
    contrast = np.sqrt(_blur(centred * centred, _CONTRAST_PX))
    even = np.clip(centred / np.maximum(contrast, np.float32(_LEVEL)), -3.0, 3.0).astype(np.float32)
    kept = _filtered(even)
    kept /= np.sqrt(_blur(kept * kept, _CONTRAST_PX)) + np.float32(0.02)
    ridges = 0.5 + 0.5 * np.tanh(np.float32(_STEEPNESS) * kept)
    there = 1.0 / (1.0 + np.exp((np.float32(_MIN_CONTRAST) - contrast) / 3.0))
    return np.asarray(np.round(255.0 * (1.0 - there * (1.0 - ridges))), dtype=np.uint8)


def _filtered(even: FloatArray) -> FloatArray:
    """(H, W) what runs along the ridges, from windows added up."""
    side, step = _WINDOW_PX, _STEP_PX
    rows, columns = (int(np.ceil((size + side) / step)) for size in even.shape)
    padded = np.zeros(((rows - 1) * step + side, (columns - 1) * step + side), dtype=np.float32)
    first = side - step
    inside = slice(first, first + even.shape[0]), slice(first, first + even.shape[1])
    padded[inside] = even[: padded.shape[0] - first, : padded.shape[1] - first]
    taper = np.sqrt(np.hanning(side + 1)[:side]).astype(np.float32)
    window = np.outer(taper, taper)
    parts = np.lib.stride_tricks.sliding_window_view(padded, (side, side))[::step, ::step]
    spectra = scipy.fft.rfft2(parts * window, axes=(2, 3))

    middles = [
        np.clip(np.arange(count) * step + side // 2 - first, 0, size - 1)
        for count, size in zip((rows, columns), even.shape, strict=True)
    ]
    direction = _directions(even, _DIRECTION_PX)[np.ix_(*middles)]
    turn = np.round(direction * (_DIRECTIONS / np.pi)).astype(np.int64) % _DIRECTIONS
    along, across, frequency, marks = _bank(side)
    power = (spectra.real**2 + spectra.imag**2) * along[turn]
    total = _blur(power.sum(axis=(2, 3)), 1.5)
    mean = _blur((power * frequency).sum(axis=(2, 3)), 1.5) / np.maximum(total, np.float32(1e-9))
    pitch = np.clip(np.searchsorted(marks, mean), 0, _PERIODS - 1)
    kept = scipy.fft.irfft2(spectra * along[turn] * across[pitch], s=(side, side), axes=(2, 3)) * window
    result = np.zeros_like(padded)
    for i in range(rows):
        for j in range(columns):
            result[i * step : i * step + side, j * step : j * step + side] += kept[i, j]
    return np.asarray(result[inside], dtype=np.float32)


def _directions(even: FloatArray, sigma: float) -> FloatArray:
    """(H, W) direction across the ridges in [-pi/2, pi/2], rows downwards."""
    smooth = _blur(even, 1.0)
    right, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    twice = 2 * _blur(right * down, sigma), _blur(right * right, sigma) - _blur(down * down, sigma)
    return np.asarray(0.5 * np.arctan2(*twice), dtype=np.float32)


@lru_cache(maxsize=1)
def _bank(side: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Filters on the half spectrum: by direction, by frequency, the frequencies, and between which each holds."""
    down, right = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None]
    frequency = np.hypot(down, right)
    band = (frequency > 1 / _MOST_PX) & (frequency < 1 / _LEAST_PX)
    angle = np.arctan2(down, right) - (np.pi / _DIRECTIONS * np.arange(_DIRECTIONS))[:, None, None]
    apart = np.angle(np.exp(2j * angle)) / 2
    along = np.exp(-0.5 * (apart / np.deg2rad(_SPREAD_DEG)) ** 2) * band
    centres = np.linspace(1 / _MOST_PX, 1 / _LEAST_PX, _PERIODS)
    across = np.exp(-0.5 * ((frequency - centres[:, None, None]) / _SPREAD_PER_PX) ** 2)
    marks = 0.5 * (centres[1:] + centres[:-1])
    single = [np.asarray(table, dtype=np.float32) for table in (along, across, frequency, marks)]
    return single[0], single[1], single[2], single[3]


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=np.float32)
