"""Structured light: phase shifting at several periods, unwrapped in time.

References
----------
Wang et al., "Data acquisition and processing of 3-D fingerprints", IEEE TIFS 5(4), 2010; Huang et
al., "3D fingerprint imaging system based on full-field fringe projection profilometry", Optics and
Lasers in Engineering 52, 2014; C. Zuo et al., "Temporal phase unwrapping algorithms for fringe
projection profilometry", Optics and Lasers in Engineering 85, 2016.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from views import View, cloud_of, on_planes

from splitknit.errors import require
from splitknit.model import FloatArray

_NOISE_PX = 7  # side of the square over which the residuals of the sinusoids are averaged


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """Which row of the projector lights each pixel."""

    row: FloatArray  # (H, W) in the projector's pixels; NaN where the fringes are too faint
    sigma: FloatArray  # (H, W) its standard deviation, from the residuals of the sinusoids
    modulation: FloatArray  # (F, H, W) amplitude of the fringes over the mean light


def fringes(row: NDArray[np.floating], period: float, step: int, steps: int) -> FloatArray:
    """Light (0 to 1) of a projector's rows in exposure `step` of `steps`: 0.5 + 0.5 cos(2 pi (row /
    period - k / n)).

    Examples
    --------
    >>> fringes(np.array([0.0, 5.0]), 10.0, 0, 4).tolist()
    [1.0, 0.0]
    """
    wave = np.cos(2.0 * np.pi * (np.asarray(row, dtype=np.float64) / period - step / steps))
    return np.asarray(0.5 + 0.5 * wave, dtype=np.float32)


def decode(images: NDArray[np.floating], periods: Sequence[float], least: float = 0.03) -> Decoded:
    """Find the projector's row of every pixel from phase-shifted fringes.

    `images`: (F, N, H, W) linear light without ambient light, NaN where a pixel is saturated: F
    periods, N equal steps, three at least, as :func:`fringes` has them. Three-colour fringes are N
    = 3 channels, each over that of an evenly lit exposure. `periods`: F in projector rows,
    descending; the first spans the whole field, from row 0; `least`: smallest modulation that
    counts. Raises BadInput if the numbers do not fit, or there are fewer than three steps.
    """
    require(
        images.ndim == 4 and images.shape[1] >= 3,
        "phase shifting needs at least three steps a period.",
    )
    require(
        len(periods) == images.shape[0] and all(a > b > 0 for a, b in itertools.pairwise(periods)),
        "the periods must be as many as the series of images, positive and descending.",
    )
    steps = images.shape[1]
    angle = 2.0 * np.pi * np.arange(steps) / steps
    row: NDArray[np.float64] | None = None
    sigma = np.zeros(images.shape[2:], np.float32)
    modulations = []
    for series, period in zip(images, periods, strict=True):
        mean = series.mean(axis=0)
        c, s = (
            np.tensordot(wave, series, axes=1) * (2.0 / steps)
            for wave in (np.cos(angle), np.sin(angle))
        )
        amplitude = np.hypot(c, s)
        modulations.append(np.divide(amplitude, mean, out=np.zeros_like(mean), where=mean > 0))
        fraction = (np.arctan2(s, c) / (2.0 * np.pi)) % 1.0
        row = period * (fraction if row is None else fraction + np.rint(row / period - fraction))
        if steps > 3:
            waves = np.cos(angle)[:, None, None] * c + np.sin(angle)[:, None, None] * s
            power = ((series - mean - waves) ** 2).sum(axis=0) / (steps - 3)
            noise = np.sqrt(np.maximum(cv2.blur(power, (_NOISE_PX, _NOISE_PX)), 0.0))
            sigma = (
                period * np.sqrt(2.0 / steps) * noise / (2.0 * np.pi * np.maximum(amplitude, 1e-9))
            )
    assert row is not None
    modulation = np.stack(modulations)
    known = (modulation >= least).all(axis=0)
    row, sigma = np.where(known, row, np.nan), np.where(known, sigma, np.nan)
    return Decoded(row.astype(np.float32), sigma.astype(np.float32), modulation)


def scan(
    camera: View, projector: View, decoded: Decoded, largest_mm: float = 0.1
) -> tuple[FloatArray, FloatArray]:
    """Triangulate decoded rows: points whose standard deviation is below `largest_mm`, and the
    standard deviation (H, W) of each pixel's point along its ray, mm, by noise alone.
    """
    points, slope = on_planes(camera, projector, decoded.row)
    sigma = (slope * decoded.sigma).astype(np.float32)
    points[~(sigma <= largest_mm)] = np.nan
    return cloud_of(points), sigma
