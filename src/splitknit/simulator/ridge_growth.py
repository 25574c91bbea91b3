"""Ridges grown from noise: repeated filtering along a field of directions and periods.

Minutiae are not placed; they remain where the ridges of the noise could not join.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array32 = NDArray[np.float32]


def grow_ridges(
    noise: Array32,
    angle_rad: NDArray[np.float64],
    period_px: NDArray[np.float64],
    *,
    iterations: int = 5,
    bandwidth: float = 0.2,
    reach: float = 1.1,
) -> Array32:
    """Grow a ridge pattern from `noise` by an iterated, spatially varying Gabor-like filter.

    Every pass smooths along the ridges (a kernel bent along the streamlines of `angle_rad`), keeps the local
    frequency (a bank of ring filters, blended by `period_px`) and limits the amplitude.

    Parameters
    ----------
    noise
        (H, W) starting values; any seeded noise.
    angle_rad
        (H, W) ridge direction, counter-clockwise from the columns' direction, rows pointing down.
    period_px
        (H, W) ridge period.
    iterations
        Number of passes; fewer leave more defects (minutiae).
    bandwidth
        Standard deviation of a ring filter over its frequency.
    reach
        Standard deviation of the smoothing along ridges, in periods.

    Returns
    -------
    (H, W) float32, a wave of about unit amplitude without harmonics, positive on ridges.

    References
    ----------
    Cappelli, Maio and Maltoni 2000, Synthetic fingerprint-database generation (iterated contextual filtering).
    Cabral and Leedom 1993, Imaging vector fields using line integral convolution.
    """
    mean_period = float(np.median(period_px))
    # Passes of (3, 4, 3) / 10 at distances d, 2 d and 4 d make a bell along the streamline; d is too short to alias.
    distances = [factor * reach * mean_period for factor in (0.26, 0.52, 1.04)]
    maps = [_streamline_maps(angle_rad, distance, 2 + k) for k, distance in enumerate(distances)]
    bank, weights = _ring_bank(noise.shape, period_px, bandwidth)
    ridges = wave = noise.astype(np.float32)
    for _ in range(iterations):
        for pair in maps:
            ridges = _along(ridges, pair)
        spectrum = scipy.fft.rfft2(ridges)
        out = np.zeros_like(ridges)
        for ring, weight in zip(bank, weights, strict=True):
            out += weight * scipy.fft.irfft2(spectrum * ring, s=noise.shape)
        power = cv2.GaussianBlur(out * out, (0, 0), 1.6 * mean_period, borderType=cv2.BORDER_REFLECT)
        wave = out / np.sqrt(2.0 * power + 1e-12)
        ridges = np.tanh(1.84 * wave)
    return np.asarray(wave, dtype=np.float32)


def _streamline_maps(angle_rad: NDArray[np.float64], distance_px: float, steps: int) -> list[tuple[Array32, Array32]]:
    """Sampling positions (x, y) at `distance_px` forwards and backwards along the field."""
    cosine = np.cos(2.0 * angle_rad).astype(np.float32)
    sine = np.sin(2.0 * angle_rad).astype(np.float32)
    rows, columns = angle_rad.shape
    grid_x, grid_y = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
    start = (np.cos(angle_rad).astype(np.float32), -np.sin(angle_rad).astype(np.float32))
    maps = []
    for sign in (1.0, -1.0):
        x, y = grid_x, grid_y
        heading_x, heading_y = sign * start[0], sign * start[1]
        for _ in range(steps):
            x = x + heading_x * (distance_px / steps)
            y = y + heading_y * (distance_px / steps)
            c = cv2.remap(cosine, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            s = cv2.remap(sine, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            half = 0.5 * np.arctan2(s, c)
            new_x, new_y = np.cos(half), -np.sin(half)
            turn = np.where(new_x * heading_x + new_y * heading_y < 0, -1.0, 1.0).astype(np.float32)
            heading_x, heading_y = turn * new_x, turn * new_y
        maps.append((x.astype(np.float32), y.astype(np.float32)))
    return maps


def _along(image: Array32, maps: list[tuple[Array32, Array32]]) -> Array32:
    total = 2.0 * image
    for x, y in maps:
        total = total + 1.5 * cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(total * np.float32(0.2), dtype=np.float32)


def _ring_bank(
    shape: tuple[int, ...], period_px: NDArray[np.float64], bandwidth: float, ratio: float = 1.16
) -> tuple[list[Array32], list[Array32]]:
    """Ring filters at geometrically spaced frequencies and the (H, W) weights that blend neighbours."""
    low, high = float(np.log(period_px.min())), float(np.log(period_px.max()))
    count = max(2, int(np.ceil((high - low) / np.log(ratio))) + 1)
    centers = np.linspace(low, high, count)
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
    position = (np.log(period_px) - low) / max(high - low, 1e-9) * (count - 1)
    bank, weights = [], []
    for k, center in enumerate(centers):
        f0 = float(np.exp(-center))
        bank.append(np.exp(-0.5 * ((frequency - f0) / (bandwidth * f0)) ** 2).astype(np.float32))
        weights.append(np.clip(1.0 - np.abs(position - k), 0.0, 1.0).astype(np.float32))
    return bank, weights


def phase_singularities(wave: Array32, angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find the minutiae of a ridge pattern: the points about which its phase turns by 2 pi.

    Parameters
    ----------
    wave
        (H, W) ridges, zero mean.
    angle_rad
        (H, W) ridge direction, counter-clockwise from the columns' direction, rows pointing down.

    Returns
    -------
    (N, 3): column, row, and the direction (rad, counter-clockwise, rows down) towards the side with one more ridge.

    References
    ----------
    Larkin, Bone and Oldfield 2001, Natural demodulation of two-dimensional fringe patterns (spiral phase quadrature).
    Larkin and Fletcher 2007, A coherent framework for fingerprint analysis: are fingerprints holograms?
    """
    frequency_x = np.fft.fftfreq(wave.shape[1])[None, :]
    frequency_up = -np.fft.fftfreq(wave.shape[0])[:, None]
    spiral = (frequency_x + 1j * frequency_up) / np.maximum(np.hypot(frequency_x, frequency_up), 1e-12)
    vortex = scipy.fft.ifft2(scipy.fft.fft2(wave) * spiral)
    across = np.exp(1j * (angle_rad + 0.5 * np.pi))
    signal = wave + 1j * np.real(-1j * np.conj(across) * vortex)
    corners = (np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:], np.s_[:-1, :-1])  # counter-clockwise, rows down
    reference = across[corners[0]]
    loop = []
    for corner in corners:
        same = np.real(np.conj(reference) * across[corner]) >= 0
        loop.append(np.where(same, signal[corner], np.conj(signal[corner])))
    turns = sum(np.angle(loop[(k + 1) % 4] * np.conj(loop[k])) for k in range(4)) / (2 * np.pi)
    rows, columns = np.nonzero(np.abs(turns) > 0.5)
    towards = np.angle(reference[rows, columns] * -1j * np.sign(turns[rows, columns]))
    return np.stack([columns + 0.5, rows + 0.5, towards], axis=1)
