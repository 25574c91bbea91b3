"""Prints that were pressed on glass or paper: their ridges, dry, wet or scratched, and how sure these are.

Short windows are transformed. What a window's power says about direction and period is weighed with what the windows
around it say, over the whole print (relaxation labelling): where ridges are broken or flooded, and several directions
are about as strong, the one that continues the surroundings is taken. Then each window keeps what runs along its ridges
and has their period.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.finger.regions import blur, fill_holes
from splitknit.imaging.areas import disc
from splitknit.imaging.geometry import wide_blur
from splitknit.model import BoolArray, FloatArray
from splitknit_match.prints.ridge_field import overlap_added, spectra_of

# lengths in pixels at 500 ppi
_WINDOW_PX, _STEP_PX = 32, 8
"""Side of a window: some four ridges; and between windows."""
_TAPER = np.sqrt(np.outer(*(np.hanning(_WINDOW_PX + 1)[:-1],) * 2)).astype(np.float32)
_SHORTEST_PX, _LONGEST_PX = 4.5, 15.0
"""Periods of ridges: 0.23 to 0.76 mm."""
_CONTRAST_PX, _OF_PHOTO_PX = 11.0, 20.0
"""Sigma over which mean and contrast are made even: of a print; of a photograph, whose weak ridges are noise."""
_LEVEL, _RAISED = 8.0, 0.3
"""Grey levels, and part of the print's usual contrast; contrast below the larger one is not raised further."""
_DIRECTIONS, _PERIODS = 24, 10
"""Directions and periods that a window may have; means between them are taken."""
_ANGLES = np.arange(_DIRECTIONS, dtype=np.float32) * (np.pi / _DIRECTIONS)
"""Directions across the ridges, counter-clockwise."""
_LOGS = np.log(np.geomspace(1 / _LONGEST_PX, 1 / _SHORTEST_PX, _PERIODS)).astype(np.float32)
"""Logarithms of the frequencies."""
_DIRECTION_DEG, _PERIOD_WIDTH = 9.0, 0.11
"""Sigma of one of them; of periods relative."""
_TURN_DEG = 10.0
"""Sigma of the turn of directions from a window to those about it."""
_TYPICAL, _OF_PHOTO = 0.3, 0.2
"""Sigma of periods about the print's own, relative; of a photograph."""
_REACHES = (4.0, 3.0, 2.0, 1.5, 1.5, 1.5)
"""Sigma of the surroundings, in windows, of one pass after the other."""
_WEAK = 0.03
"""Power of a window, relative to noise of the evened print's variance, below which it says little."""
_FANS_DEG = (16.0, 22.0, 30.0, 42.0)
"""Sigma of the filter across directions: where they agree, to where they do not."""
_BAND_PER_PX = 0.035
"""Sigma of the filter across frequencies, cycles a pixel."""
_TURNS = 64
"""Directions of the filters."""
_STEEPNESS = 1.6
"""Steepness of the result's grey curve."""
_PURE, _NOISE = 0.42, 0.2
"""Part of its power that a window of parallel ridges has near one direction and period; of that, what noise has."""
_CLEAR = 0.35
"""Confidence of a print's clearest ridges below which there is no print."""
_CLEAREST_PX = 7750
"""Number of the clearest pixels that set this level: 20 mm2."""
_EDGE, _FAINT = (0.25, 0.4), (0.4, 0.15)
"""Of a print and of a photograph: ridges end where their confidence falls below this part of the way from noise to the
clearest ones; contrast, relative to that of the clear ridges, below which confidence falls (what others left on the
sensor)."""
_CLOSED_PX, _OPENED_PX = 14, 10
"""Radii: gaps between ridges belong to them, specks do not."""
_BENDS_DEG, _BREAKS, _JUDGED = 1.5, 0.12, 500
"""Lines that are no ridges of a finger turn less than so many degrees a mm (median), or more often than in this part of
the places by 25 deg and more from a window to the next; and pairs of windows (40 mm2) from which on that is judged.
280 real prints have 2.9 to 7.8, at most 0.04; squares of 7 mm of them 1.7, at most 0.09."""
_FRAME_STEP = 20
"""Grey levels between a constant border and what is beside it, where that is the sensor's frame, no paper."""


@dataclass(frozen=True, slots=True, eq=False)
class PressedRidges:
    """Ridges of a pressed print."""

    image: NDArray[np.uint8]
    """(H, W) even ridges, dark; white where there are none."""
    inside: BoolArray
    """(H, W) where there are ridges."""
    confidence: FloatArray
    """(H, W) 0 (noise) to 1 (parallel ridges and nothing else)."""
    lacks: str = ""
    """Why they are no print of a finger; empty for prints."""


def pressed_ridges(image: NDArray[np.uint8], usual: tuple[float, float] | None = None) -> PressedRidges:
    """Enhance a print (H, W) uint8 of 500 ppi, ridges dark, that was pressed on glass or paper; white without ridges.

    `usual`: of a photograph, the expected distance of its ridges, pixels, and its relative standard deviation: noise
    that JPEG and smoothing leave is strong at longer distances.

    Source: S. Chikkerur, A. Cartwright and V. Govindaraju, "Fingerprint enhancement using STFT analysis", Pattern
    Recognition 40, 2007 (windows, filters); A. Rosenfeld, R. Hummel and S. Zucker, "Scene labeling by relaxation
    operations", IEEE Trans. SMC 6, 1976, equation 10 (directions that support each other).

    >>> waves = 127 + 90 * np.sin(np.arange(160) * 2 * np.pi / 9)[None] * np.ones((160, 1))
    >>> bool(pressed_ridges(waves.astype(np.uint8)).inside[80, 80])
    True
    """
    kind, reach = int(usual is not None), _CONTRAST_PX if usual is None else _OF_PHOTO_PX
    even, contrast = _evened(image, reach)
    spectra = _spectra(even)
    rows, columns = spectra.shape[:2]
    power = np.square(spectra.real) + np.square(spectra.imag)
    power[..., 0] *= 0.5  # the only column of the half spectrum that holds each of its waves twice
    inner, bank, _, _ = _bank()
    power = power.reshape(rows * columns, -1)[:, inner]
    weighed = (power @ bank).reshape(rows, columns, _DIRECTIONS, _PERIODS)
    total = (power @ np.ones(power.shape[1], dtype=np.float32)).reshape(rows, columns, 1, 1) + (1e-6)
    unit = 0.5 * _WINDOW_PX**2 * float(np.square(_TAPER).sum())  # power of noise of variance one
    direction, frequency, agreement, part = _field(weighed / total, total / (total + _WEAK * unit), usual)
    wave = _filtered(spectra, direction, frequency, agreement)[: even.shape[0], : even.shape[1]]
    wave /= np.sqrt(_mean(wave * wave, 0.7 * reach)) + 0.02
    places = [(np.arange(side, dtype=np.float32) + (_WINDOW_PX / 2 - _STEP_PX + 0.5)) / _STEP_PX for side in even.shape]
    sure = np.clip((blur(part, 1.0) / _PURE - _NOISE) / (1 - _NOISE), 0, 1)
    confidence: FloatArray = np.asarray(
        cv2.remap(sure, *np.meshgrid(places[1], places[0]), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )
    strong = contrast[confidence >= 0.5 * _clearest(confidence)]
    confidence *= np.minimum(contrast / (_FAINT[kind] * _usual(strong) + 1e-6), 1) ** 2
    inside = _extent(confidence, _EDGE[kind])
    soft = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
    grey = 1.0 - soft * (0.5 - 0.5 * np.tanh(_STEEPNESS * wave))
    even_ridges = np.round(255.0 * grey).astype(np.uint8)
    return PressedRidges(even_ridges, inside, np.where(inside, confidence, 0), _lacks(direction, inside))


def _lacks(direction: FloatArray, inside: BoolArray) -> str:
    """What lines lack to be ridges, by the turn of their direction (n, m) from window to window `inside` (H, W)."""
    at = inside[_STEP_PX::_STEP_PX, _STEP_PX::_STEP_PX].astype(np.uint8)
    known = cv2.erode(at, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    here = direction[2 : 2 + known.shape[0], 2 : 2 + known.shape[1]]
    turns = np.rad2deg(
        np.concatenate(
            [
                _apart(here[:, 1:], here[:, :-1])[known[:, 1:] & known[:, :-1]],
                _apart(here[1:], here[:-1])[known[1:] & known[:-1]],
            ]
        )
    )
    if len(turns) < _JUDGED:
        return ""
    if np.median(turns) < _BENDS_DEG * _STEP_PX * 25.4 / 500:
        return "no print of a finger: its lines run straight on"
    breaks = float((turns > 25).mean()) > _BREAKS
    return "no print of a finger: its lines break off in all directions" if breaks else ""


def _mean(image: FloatArray, reach: float) -> FloatArray:
    """(H, W) mean in a Gaussian window of sigma `reach`, px; wide ones, of photographs, on a smaller copy."""
    return blur(image, reach) if reach < 1.1 * _CONTRAST_PX else wide_blur(image, reach)


def without_shading(values: FloatArray, known: FloatArray, reach: float) -> tuple[FloatArray, FloatArray]:
    """(H, W) values less their mean in a Gaussian window of sigma `reach` (px) where `known` is 1, else 0; and the
    window's weight, above 0.
    """
    weight = np.maximum(_mean(known, reach), 1e-3)
    for _ in range(2):  # the second pass takes out what a one-sided window leaves at the edge
        values = (values - _mean(values * known, reach) / weight) * known
    return values, weight


def _evened(image: NDArray[np.uint8], reach: float) -> tuple[FloatArray, FloatArray]:
    """(H, W) the print with even mean and contrast, and its contrast; the sensor's frame does not count."""
    known = (~frame(image)).astype(np.float32)
    grey = image.astype(np.float32)
    grey = np.minimum(grey, np.float32(np.percentile(grey[known > 0], 99)))  # paper is flat
    centred, weight = without_shading(grey, known, reach)
    contrast = np.sqrt(_mean(centred * centred, reach) / weight)
    level = np.maximum(_LEVEL, _RAISED * _usual(contrast))
    return np.clip(centred / np.maximum(contrast, level), -3.0, 3.0).astype(np.float32), contrast


def _usual(contrast: FloatArray) -> np.float32:
    """Mean contrast, weighted by itself: of the strong places, however few."""
    return np.float32((contrast * contrast).sum() / np.maximum(contrast.sum(), 1e-6))


def frame(image: NDArray[np.uint8]) -> BoolArray:
    """(H, W) areas of one grey level at the picture's border that end in a step: beside the sensor's window."""
    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    level = int(np.bincount(border).argmax())
    padded = cv2.copyMakeBorder((image == level).astype(np.uint8), 9, 9, 9, 9, cv2.BORDER_REPLICATE)
    found = np.zeros(image.shape, dtype=bool)
    if not padded.any() or padded.all():
        return found
    flat = np.ascontiguousarray(cv2.morphologyEx(padded, cv2.MORPH_OPEN, disc(4))[9:-9, 9:-9])
    count, labels, stats, _ = cv2.connectedComponentsWithStats(flat)
    for k in range(1, count):
        if stats[k, cv2.CC_STAT_AREA] < 400:
            continue
        left, top, wide, high = stats[k, :4].tolist()
        box = slice(max(0, top - 6), top + high + 6), slice(max(0, left - 6), left + wide + 6)
        area = (labels[box] == k).astype(np.uint8)
        near, beside = (cv2.dilate(area, np.ones((side, side), np.uint8)) > 0 for side in (5, 11))
        ring = beside & ~near
        levels = image[box][ring].astype(np.float32)
        if int(ring.sum()) > 20 and np.percentile(np.abs(levels - level), 20) > _FRAME_STEP:
            found[box] |= near
    return found


def _spectra(even: FloatArray) -> NDArray[np.complex64]:
    """(n, m, window, window // 2 + 1) of overlapping windows, of which the first begins before the print."""
    side, step = _WINDOW_PX, _STEP_PX
    below, right = ((-size // step + 1) * step + 2 * side for size in (-even.shape[0], -even.shape[1]))
    first = side - step
    padded = cv2.copyMakeBorder(even, first, below - first - step, first, right - first - step, cv2.BORDER_CONSTANT)
    windows = sliding_window_view(padded, (side, side))[::step, ::step]
    n, m = (-(-size // step) + side // step - 1 for size in even.shape)
    spectra = np.empty((n, m, side, side // 2 + 1), dtype=np.complex64)
    for k in range(n):  # one line after the other: they stay in the cache
        spectra[k] = spectra_of(windows[k, :m] * _TAPER)
    return spectra


@lru_cache(maxsize=1)
def _bank() -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Which frequencies count (flat), their part in each direction and period, and both filters on the half spectrum.

    The filters are (fans, directions, window, half window) and (periods, window, half window).
    """
    side = _WINDOW_PX
    down, right = np.meshgrid(np.fft.fftfreq(side), np.fft.rfftfreq(side), indexing="ij")
    frequency, angle = np.hypot(down, right), np.arctan2(-down, right)
    inner = (frequency > 0.8 / _LONGEST_PX) & (frequency < 1.15 / _SHORTEST_PX)
    apart = _apart(angle[inner][:, None], _ANGLES)
    octaves = np.log(frequency[inner])[:, None] - _LOGS
    along = np.exp(-0.5 * (apart / np.deg2rad(_DIRECTION_DEG)) ** 2)[:, :, None]
    bank = (along * np.exp(-0.5 * (octaves / _PERIOD_WIDTH) ** 2)[:, None]).reshape(int(inner.sum()), -1)
    bank /= np.median(bank.sum(axis=1))
    turns = np.pi / _TURNS * np.arange(_TURNS)[:, None, None]
    passed = (frequency > 1 / _LONGEST_PX) & (frequency < 1 / _SHORTEST_PX)
    fans = [np.exp(-0.5 * (_apart(angle, turns) / np.deg2rad(width)) ** 2) * passed for width in _FANS_DEG]
    periods = np.geomspace(1 / _LONGEST_PX, 1 / _SHORTEST_PX, 3 * _PERIODS)
    bands = np.exp(-0.5 * ((frequency - periods[:, None, None]) / _BAND_PER_PX) ** 2)
    tables = [np.asarray(table, dtype=np.float32) for table in (bank, np.stack(fans), bands)]
    return inner.ravel(), tables[0], tables[1], tables[2]


def _apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between two directions, up to a quarter turn."""
    return np.abs(np.mod(a - b + np.pi / 2, np.pi) - np.pi / 2)


def _field(
    weighed: FloatArray, trust: FloatArray, expected: tuple[float, float] | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Direction across the ridges, frequency, how well the directions agree, and the part of the power that has both.

    `weighed` (n, m, directions, periods): parts of each window's own power; `trust` (n, m, 1, 1): little where a window
    has little power, so that the edge of a sheet says nothing about ridges.
    """
    n, m = weighed.shape[:2]
    said = weighed * trust
    clear = said.reshape(n, m, -1).max(axis=2)
    votes = np.einsum("nmf,nm->f", said.max(axis=2), clear**3)
    if expected is not None:
        votes *= np.exp(-0.5 * ((_LOGS + np.log(expected[0])) / expected[1]) ** 2)
    own = float((votes**4 * _LOGS).sum() / max(float((votes**4).sum()), 1e-30))  # logarithm of the print's frequency
    typical = _TYPICAL if expected is None else _OF_PHOTO
    usual = (np.exp(-0.5 * ((_LOGS - own) / typical) ** 2) + 0.05).astype(np.float32)
    said = said @ usual
    strength = said.sum(axis=2, keepdims=True) + 1e-12
    turn = np.exp(-0.5 * (_apart(_ANGLES[:, None], _ANGLES) / np.deg2rad(_TURN_DEG)) ** 2).astype(np.float32)
    belief = said
    for reach in _REACHES:
        around = blur(belief, reach) @ turn
        around /= around.sum(axis=2, keepdims=True) + 1e-12
        belief = said * around
        belief *= strength / (belief.sum(axis=2, keepdims=True) + 1e-12)
    belief = (said + 0.02 * said.max()) * around
    belief /= belief.sum(axis=2, keepdims=True) + 1e-12
    number = (belief.argmax(axis=2)[..., None] + np.arange(-3, 4)) % _DIRECTIONS
    peak = np.take_along_axis(belief, number, axis=2)
    direction = 0.5 * np.angle((peak * np.exp(2j * _ANGLES[number])).sum(axis=2)).astype(np.float32)
    agreement = np.abs((belief * np.exp(2j * _ANGLES)).sum(axis=2)).astype(np.float32)
    near = np.exp(-0.5 * (_apart(direction[..., None], _ANGLES) / np.deg2rad(1.5 * _DIRECTION_DEG)) ** 2)
    along = np.matmul(near.astype(np.float32)[:, :, None], weighed)[:, :, 0]
    period = blur(along * usual * trust[..., 0], 1.5) ** 2
    frequency = (period @ _LOGS) / (period.sum(axis=2) + 1e-20)
    of_period = np.exp(-0.5 * ((frequency[..., None] - _LOGS) / (2 * _PERIOD_WIDTH)) ** 2)
    return direction, frequency, agreement, (along * of_period).sum(axis=2).astype(np.float32)


def _filtered(
    spectra: NDArray[np.complex64], direction: FloatArray, frequency: FloatArray, agreement: FloatArray
) -> FloatArray:
    """What runs along the ridges and has their period, from windows added up."""
    _, _, fans, bands = _bank()
    side, step = _WINDOW_PX, _STEP_PX
    turn = np.rint(direction * (_TURNS / np.pi)).astype(np.intp) % _TURNS
    fan = np.clip((0.95 - agreement) / 0.6 * len(_FANS_DEG), 0, len(_FANS_DEG) - 1).astype(np.intp)
    lowest, highest = np.log([1 / _LONGEST_PX, 1 / _SHORTEST_PX])
    band = np.clip(np.rint((frequency - lowest) / (highest - lowest) * (len(bands) - 1)), 0, len(bands) - 1).astype(
        np.intp
    )
    parts = np.empty((*spectra.shape[:2], side, side), dtype=np.float32)
    for k, line in enumerate(spectra):
        kept = line * fans[fan[k], turn[k]]
        kept *= bands[band[k]]
        parts[k] = np.fft.irfft2(kept, s=(side, side)) * _TAPER
    return overlap_added(parts, step)[side - step :, side - step :]


def _clearest(confidence: FloatArray) -> float:
    """Confidence that the clearest ridges have at least, on a twentieth of the picture, at most 20 mm2."""
    last = confidence.size - 1 - min(confidence.size // 20, _CLEAREST_PX)
    return float(np.partition(confidence, last, axis=None)[last])


def _extent(confidence: FloatArray, edge: float) -> BoolArray:
    """(H, W) where there are ridges: clear ones and what hangs on them, holes filled."""
    clearest = _clearest(confidence)
    if clearest < _CLEAR:
        return np.zeros(confidence.shape, dtype=bool)
    raw, pad = (confidence > edge * clearest).astype(np.uint8), 2 * _CLOSED_PX
    closed = cv2.copyMakeBorder(raw, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    for kind, radius in ((cv2.MORPH_CLOSE, _CLOSED_PX), (cv2.MORPH_OPEN, _OPENED_PX)):
        closed = cv2.morphologyEx(closed, kind, disc(radius))
    closed = np.ascontiguousarray(closed[pad:-pad, pad:-pad])
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed)
    sizes = stats[:, cv2.CC_STAT_AREA].copy()
    sizes[0] = 0
    return fill_holes((sizes > 0.1 * sizes.max())[labels])
