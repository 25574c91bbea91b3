"""What a sensor adds by itself: black level, read noise, hot pixels, fixed pattern, and how noise grows with light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import PixelArray

Array = NDArray[np.float64]

_CURVATURE = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], dtype=np.float32)
"""Zero on planes, and of variance 36 on white noise of variance one (Immerkaer 1996)."""


@dataclass(frozen=True, slots=True)
class DarkSettings:
    """How a dark frame is judged."""

    hot_sigmas: float = 8.0
    """A pixel is hot if it lies this many deviations above the black level ..."""
    hot_percent: float = 1.0
    """... and this many per cent of full scale."""
    light_percent: float = 2.0
    """A frame whose corners and middle differ by more than this many per cent of full scale is not dark."""
    highest_percent: float = 25.0
    """A black level above this is none: the lens was not covered."""


@dataclass(frozen=True, slots=True)
class Dark:
    """What dark frames say, values as parts of full scale."""

    black_level: tuple[float, ...]
    """Of each channel."""
    read_noise: tuple[float, ...] | None
    """Standard deviation of each channel; None where values are cut off at zero, so that it cannot be seen."""
    hot_pixels: int
    hot_share: float
    row_noise: float
    """Standard deviation of the rows' means beyond what the pixels' noise explains: stripes."""
    column_noise: float
    fixed_pattern: float | None
    """Standard deviation from pixel to pixel of what is the same in all frames; None for one frame."""
    frames: int


def dark_frames(frames: Sequence[PixelArray], settings: DarkSettings | None = None, *, name: str = "dark") -> Dark:
    """Measure frames that were taken with the lens covered.

    Parameters
    ----------
    frames : (H, W, C) integers each, of one size and depth
    settings : DarkSettings, optional
    name : of the frames, for messages

    Returns
    -------
    Dark

    Raises
    ------
    BadInput
        If there is none, they differ in size, or light fell on them.
    """
    chosen = settings or DarkSettings()
    require(len(frames) > 0, "there is no dark frame.")
    require(
        all(frame.shape == frames[0].shape and frame.dtype == frames[0].dtype for frame in frames),
        f"{name}: the dark frames differ in size, colour or depth; take them like all other images.",
    )
    full = float(np.iinfo(frames[0].dtype).max)
    stack = np.stack([frame.astype(np.float32) / np.float32(full) for frame in frames])
    mean = stack.mean(axis=0)  # (H, W, C)
    black = np.array([_clipped_mean(mean[..., c]) for c in range(mean.shape[2])])
    _check_dark(mean, black, chosen, name)
    sigma = np.array([_deviation(stack[..., c]) for c in range(mean.shape[2])])
    away = mean - black.astype(np.float32)
    hot = (away > np.maximum(chosen.hot_sigmas * sigma / np.sqrt(len(frames)), 0.01 * chosen.hot_percent)).any(axis=2)
    calm = np.where(hot, np.float32(0.0), away.mean(axis=2))
    cut = float((stack == 0).mean()) > 0.2
    return Dark(
        black_level=tuple(float(value) for value in black),
        read_noise=None if cut else tuple(float(value) for value in sigma),
        hot_pixels=int(hot.sum()),
        hot_share=float(hot.mean()),
        row_noise=_stripes(calm, 1),
        column_noise=_stripes(calm, 0),
        fixed_pattern=_fixed_pattern(stack, sigma) if len(frames) > 1 and not cut else None,
        frames=len(frames),
    )


def _check_dark(mean: Array, black: Array, settings: DarkSettings, name: str) -> None:
    height, width = mean.shape[:2]
    parts = mean[: height // 3 * 3, : width // 3 * 3].reshape(3, height // 3, 3, width // 3, -1)
    uneven = np.ptp(np.median(parts.mean(axis=-1), axis=(1, 3)))
    level = float(black.max())
    require(
        level <= 0.01 * settings.highest_percent and float(uneven) <= 0.01 * settings.light_percent,
        f"{name} is not dark: its level is {100 * level:.1f} % of full scale and differs by {100 * float(uneven):.1f} "
        f"% across the picture; cover the lens, switch off all LEDs and take it again.",
    )


def _clipped_mean(values: Any) -> float:
    """Mean without what lies far off: hot pixels do not count, and fractions of a level do, unlike in a median."""
    middle = float(np.median(values))
    spread = max(float(np.percentile(values, 84) - np.percentile(values, 16)) / 2, 1e-4)
    return float(values[np.abs(values - middle) < 6 * spread].mean())


def _deviation(frames: Any) -> float:
    """Standard deviation (N, H, W) over time: of differences between frames, or within the one there is."""
    if len(frames) > 1:
        change = np.diff(frames, axis=0) / np.sqrt(2)
        return _clipped_deviation(change)
    return _clipped_deviation(frames[0] - np.median(frames[0]))


def _clipped_deviation(values: Any) -> float:
    spread = max(float(np.percentile(values, 84) - np.percentile(values, 16)) / 2, 1e-4)
    return float(np.std(values[np.abs(values) < 6 * spread]))


def _stripes(calm: Any, axis: int) -> float:
    """Deviation of the means along `axis` beyond that of independent pixels."""
    means = calm.mean(axis=axis)
    expected = float(calm.var()) / calm.shape[axis]
    return float(np.sqrt(max(float(means.var()) - expected, 0.0)))


def _fixed_pattern(stack: Any, sigma: Array) -> float:
    """Deviation of the mean over frames, less what noise leaves in it."""
    mean = stack.mean(axis=0)
    own = [_clipped_deviation(mean[..., c] - np.median(mean[..., c])) ** 2 for c in range(mean.shape[2])]
    return float(np.sqrt(max(float(np.mean(np.array(own) - sigma**2 / len(stack))), 0.0)))


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """variance = read_noise^2 + light / electrons, light and deviations as parts of full scale."""

    electrons: float
    """That fill a pixel to full scale, as the noise tells: with white balance, of this channel after it."""
    read_noise: float
    span: tuple[float, float]
    """Least and greatest light that was seen."""


def noise_samples(frame: PixelArray, channel: int, black_level: float = 0.0, side: int = 24) -> tuple[Array, Array]:
    """Mean and variance (n,) of squares of one photograph, parts of full scale: fine noise over whatever is smooth.

    Parameters
    ----------
    frame : (H, W, C) linear integers
    channel : which of C
    black_level : part of full scale
    side : of a square in pixels
    """
    full = float(np.iinfo(frame.dtype).max)
    values = np.ascontiguousarray(frame[..., channel], dtype=np.float32) / np.float32(full)
    rough = cv2.filter2D(values, cv2.CV_32F, _CURVATURE)
    rows, columns = (n // side for n in values.shape)

    def squares(image: Any) -> Any:
        cut = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
        return cut.transpose(0, 2, 1, 3).reshape(rows * columns, -1)

    own = squares(values)
    unclipped = own.max(axis=1) < 0.98
    variance = (squares(rough) ** 2).mean(axis=1) / 36.0 - (1.0 / full) ** 2 / 12.0
    return (own.mean(axis=1) - black_level)[unclipped].astype(np.float64), variance[unclipped].astype(np.float64)


def noise_model(light: Any, variance: Any, bins: int = 12) -> NoiseModel | None:
    """Line through variances over light, by medians of bins; None where the light hardly varies or the slope is none.

    Parameters
    ----------
    light, variance : (n,) of :func:`noise_samples`, of several photographs together
    bins : of equal numbers of squares

    References
    ----------
    EMVA Standard 1288 (2021), section 6: the photon transfer method.
    """
    x, y = np.asarray(light, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    if len(x) < 4 * bins:
        return None
    groups = np.array_split(np.argsort(x, kind="stable"), bins)
    middle = np.array([np.median(x[group]) for group in groups])
    typical = np.array([np.median(y[group]) for group in groups])
    if middle[-1] < 1.5 * max(middle[0], 0.02):
        return None
    weight = 1.0 / np.maximum(typical, 0.05 * float(np.median(typical)) + 1e-12)
    slope, offset = np.polyfit(middle, typical, 1, w=weight)
    if slope <= 0:
        return None
    return NoiseModel(
        electrons=float(1.0 / slope),
        read_noise=float(np.sqrt(max(offset, 0.0))),
        span=(float(middle[0]), float(middle[-1])),
    )
