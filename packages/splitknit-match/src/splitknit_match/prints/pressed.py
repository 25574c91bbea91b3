"""Prints that were pressed on glass or paper: their ridges, dry, wet or scratched, and how sure
these are.

Short windows are transformed. What a window's power says about direction and period is weighed with
what the windows around it say, over the whole print (relaxation labelling): where ridges are broken
or flooded, and several directions are about as strong, the one that continues the surroundings is
taken. Then each window keeps what runs along its ridges and has their period.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.finger.regions import blur, fill_holes
from splitknit.imaging.areas import disc
from splitknit.imaging.geometry import wide_blur
from splitknit.model import BoolArray, FloatArray, GreyArray
from splitknit_match.prints.ridge_field import closed_opened, overlap_added, spectra_of

# lengths in pixels at 500 ppi
_WINDOW_PX = 32
"""Side of a window: some four ridges."""
_STEP_PX = 8
"""From window to window."""
_TAPER = np.sqrt(np.outer(*(np.hanning(_WINDOW_PX + 1)[:-1],) * 2)).astype(np.float32)
_SHORTEST_PX = 4.5
"""Period of ridges: 0.23 mm."""
_LONGEST_PX = 15.0
"""0.76 mm."""
_CONTRAST_PX = 11.0
"""Sigma over which a print's mean and contrast are made even."""
_PHOTO_CONTRAST_PX = 20.0
"""The same of a photograph, whose weak ridges are noise."""
_MIN_LEVEL = 8.0
"""Grey levels; contrast below them is not raised further."""
_RAISED = 0.3
"""Nor is contrast below this part of the print's usual one."""
_DIRECTIONS = 24
"""Directions that a window may have; means between them are taken."""
_PERIODS = 10
"""Periods that it may have."""
_ANGLES = np.arange(_DIRECTIONS, dtype=np.float32) * (np.pi / _DIRECTIONS)
"""Directions across the ridges, counter-clockwise."""
_LOGS = np.log(np.geomspace(1 / _LONGEST_PX, 1 / _SHORTEST_PX, _PERIODS)).astype(np.float32)
"""Logarithms of the frequencies."""
_DIRECTION_SIGMA = np.deg2rad(9.0)
"""Of one of the directions."""
_PERIOD_SIGMA = 0.11
"""Of one of the periods, relative."""
_TURN_SIGMA = np.deg2rad(10.0)
"""Of the turn of directions from a window to those about it."""
_PERIOD_SPREAD = 0.3
"""Sigma of periods about the print's own, relative."""
_PHOTO_PERIOD_SPREAD = 0.2
_REACHES = (4.0, 3.0, 2.0, 1.5, 1.5, 1.5)
"""Sigma of the surroundings, in windows, of one pass after the other."""
_WEAK = 0.03
"""Power of a window, relative to noise of the evened print's variance, below which it counts for
little."""
_FANS = np.deg2rad([16.0, 22.0, 30.0, 42.0])
"""Sigma of the filter across directions: where they agree, to where they do not."""
_BAND_PER_PX = 0.035
"""Sigma of the filter across frequencies, cycles a pixel."""
_TURNS = 64
"""Directions of the filters."""
_STEEPNESS = 1.6
"""Of the result's grey curve."""
_PURE = 0.42
"""Part of its power that a window of parallel ridges has near one direction and period."""
_NOISE = 0.2
"""Of that, what noise has."""
_CLEAR = 0.35
"""Confidence of a print's clearest ridges below which there is no print."""
_CLEAREST_PX = 7750
"""Number of the clearest pixels that set this level: 20 mm2."""
_EDGE = 0.25
"""Ridges end where their confidence falls below this part of the way from noise to the clearest
ones."""
_PHOTO_EDGE = 0.4
_FAINT = 0.4
"""Contrast, relative to that of the clear ridges, below which confidence falls (what others left on
the sensor)."""
_PHOTO_FAINT = 0.15
_CLOSED_PX = 14
"""Radius: gaps between ridges belong to them."""
_OPENED_PX = 10
"""Radius: specks do not."""
# lines that are no ridges of a finger run straight, or break off; 280 real prints have 2.9 to 7.8
# deg a mm, at most 4 %
# of breaks, squares of 7 mm of them 1.7 deg a mm, at most 9 %
_MIN_BEND_DEG = 1.5
"""Median turn a mm."""
_BREAK_DEG = 25
"""Turn from a window to the next at which lines break off."""
_MAX_BREAKS = 0.12
"""Of the pairs of windows."""
_JUDGED_PAIRS = 500
"""From which on that is judged: 40 mm2."""
_FRAME_STEP = 20
"""Grey levels between a constant border and what is beside it, where that is the sensor's frame, no
paper."""


@dataclass(frozen=True, slots=True, eq=False)
class PressedRidges:
    """Ridges of a pressed print."""

    image: GreyArray
    """(H, W) even ridges, dark; white where there are none."""
    inside: BoolArray
    """(H, W) where there are ridges."""
    confidence: FloatArray
    """(H, W) 0 (noise) to 1 (parallel ridges and nothing else)."""
    lacks: str = ""
    """Why they are no print of a finger; empty for prints."""


def pressed_ridges(image: GreyArray, usual: tuple[float, float] | None = None) -> PressedRidges:
    """Enhance a print (H, W) uint8 of 500 ppi, ridges dark, that was pressed on glass or paper;
    white without ridges.

    `usual`: of a photograph, the expected distance of its ridges, pixels, and its relative standard
    deviation: noise that JPEG and smoothing leave is strong at longer distances.

    Source: S. Chikkerur, A. Cartwright and V. Govindaraju, "Fingerprint enhancement using STFT
    analysis", Pattern Recognition 40, 2007 (windows, filters); A. Rosenfeld, R. Hummel and S.
    Zucker, "Scene labeling by relaxation operations", IEEE Trans. SMC 6, 1976, equation 10
    (directions that support each other).

    >>> waves = 127 + 90 * np.sin(np.arange(160) * 2 * np.pi / 9)[None] * np.ones((160, 1))
    >>> bool(pressed_ridges(waves.astype(np.uint8)).inside[80, 80])
    True
    """
    is_photo = usual is not None
    sigma = _PHOTO_CONTRAST_PX if is_photo else _CONTRAST_PX
    even, contrast = _evened(image, sigma)
    spectra = _spectra(even)
    rows, columns = spectra.shape[:2]
    power = np.square(spectra.real) + np.square(spectra.imag)
    power[..., 0] *= 0.5  # the only column of the half spectrum that holds each of its waves twice
    inner, bank, _, _ = _bank()
    power = power.reshape(rows * columns, -1)[:, inner]
    weighed = (power @ bank).reshape(rows, columns, _DIRECTIONS, _PERIODS)
    total = (power @ np.ones(power.shape[1], dtype=np.float32)).reshape(rows, columns, 1, 1) + 1e-6
    unit = 0.5 * _WINDOW_PX**2 * float(np.square(_TAPER).sum())  # power of noise of variance one
    direction, frequency, agreement, purity = _field(
        weighed / total, total / (total + _WEAK * unit), usual
    )
    wave = _filtered(spectra, direction, frequency, agreement)[: even.shape[0], : even.shape[1]]
    wave /= np.sqrt(_mean(wave * wave, 0.7 * sigma)) + 0.02
    y, x = (
        (np.arange(side, dtype=np.float32) + (_WINDOW_PX / 2 - _STEP_PX + 0.5)) / _STEP_PX
        for side in even.shape
    )
    sure = np.clip((blur(purity, 1.0) / _PURE - _NOISE) / (1 - _NOISE), 0, 1)
    confidence = cv2.remap(
        sure, *np.meshgrid(x, y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    clear_contrast = usual_contrast(contrast[confidence >= 0.5 * _clearest(confidence)])
    faint = (_PHOTO_FAINT if is_photo else _FAINT) * clear_contrast + 1e-6
    confidence = confidence * np.minimum(contrast / faint, 1) ** 2
    inside = _extent(confidence, _PHOTO_EDGE if is_photo else _EDGE)
    soft = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
    grey = 1.0 - soft * (0.5 - 0.5 * np.tanh(_STEEPNESS * wave))
    even_ridges = np.round(255.0 * grey).astype(np.uint8)
    return PressedRidges(
        even_ridges, inside, np.where(inside, confidence, 0), _lacks(direction, inside)
    )


def _lacks(direction: FloatArray, inside: BoolArray) -> str:
    """What lines lack to be ridges, by the turn of their direction (n, m) from window to window
    `inside` (H, W)."""
    at = inside[_STEP_PX::_STEP_PX, _STEP_PX::_STEP_PX].astype(np.uint8)
    known = (
        cv2.erode(at, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    )
    here = direction[2 : 2 + known.shape[0], 2 : 2 + known.shape[1]]
    right = _apart(here[:, 1:], here[:, :-1])[known[:, 1:] & known[:, :-1]]
    down = _apart(here[1:], here[:-1])[known[1:] & known[:-1]]
    turn_deg = np.rad2deg(np.concatenate([right, down]))
    if len(turn_deg) < _JUDGED_PAIRS:
        return ""
    if np.median(turn_deg) < _MIN_BEND_DEG * _STEP_PX * 25.4 / 500:
        return "no print of a finger: its lines run straight on"
    breaks = (turn_deg > _BREAK_DEG).mean() > _MAX_BREAKS
    return "no print of a finger: its lines break off in all directions" if breaks else ""


def _mean(image: FloatArray, sigma: float) -> FloatArray:
    """(H, W) mean in a Gaussian window of `sigma` px; wide ones, of photographs, on a smaller
    copy."""
    return blur(image, sigma) if sigma < 1.1 * _CONTRAST_PX else wide_blur(image, sigma)


def without_shading(
    values: FloatArray, known: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """(H, W) values less their mean in a Gaussian window of `sigma` px where `known` is 1, else 0;
    and the window's weight, above 0.
    """
    weight = np.maximum(_mean(known, sigma), 1e-3)
    for _ in range(2):  # the second pass takes out what a one-sided window leaves at the edge
        values = (values - _mean(values * known, sigma) / weight) * known
    return values, weight


def _evened(image: GreyArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """(H, W) the print with even mean and contrast, and its contrast; the sensor's frame does not
    count."""
    known = (~frame(image)).astype(np.float32)
    grey = image.astype(np.float32)
    grey = np.minimum(grey, np.float32(np.percentile(grey[known > 0], 99)))  # paper is flat
    centred, weight = without_shading(grey, known, sigma)
    contrast = np.sqrt(_mean(centred * centred, sigma) / weight)
    level = np.maximum(_MIN_LEVEL, _RAISED * usual_contrast(contrast))
    return np.clip(centred / np.maximum(contrast, level), -3.0, 3.0).astype(np.float32), contrast


def usual_contrast(contrast: FloatArray) -> np.float32:
    """Mean contrast, weighted by itself: of the strong places, however few."""
    return np.float32((contrast * contrast).sum() / np.maximum(contrast.sum(), 1e-6))


def frame(image: GreyArray) -> BoolArray:
    """(H, W) areas of one grey level at the picture's border that end in a step: beside the
    sensor's window."""
    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    level = int(np.bincount(border).argmax())
    padded = cv2.copyMakeBorder((image == level).astype(np.uint8), 9, 9, 9, 9, cv2.BORDER_REPLICATE)
    framed = np.zeros(image.shape, dtype=bool)
    if not padded.any() or padded.all():
        return framed
    flat = np.ascontiguousarray(cv2.morphologyEx(padded, cv2.MORPH_OPEN, disc(4))[9:-9, 9:-9])
    _, labels, stats, _ = cv2.connectedComponentsWithStats(flat)
    for label, (left, top, width, height, size) in enumerate(stats):
        if label == 0 or size < 400:
            continue
        box = slice(max(0, top - 6), top + height + 6), slice(max(0, left - 6), left + width + 6)
        area = (labels[box] == label).astype(np.uint8)
        near, beside = (cv2.dilate(area, np.ones((side, side), np.uint8)) > 0 for side in (5, 11))
        steps = np.abs(image[box][beside & ~near].astype(np.float32) - level)
        if steps.size > 20 and np.percentile(steps, 20) > _FRAME_STEP:
            framed[box] |= near
    return framed


def _spectra(even: FloatArray) -> NDArray[np.complex64]:
    """(n, m, window, window // 2 + 1) of overlapping windows, of which the first begins before the
    print."""
    rows, columns = (-(-size // _STEP_PX) + _WINDOW_PX // _STEP_PX - 1 for size in even.shape)
    before = _WINDOW_PX - _STEP_PX
    below, right = (_STEP_PX - size % _STEP_PX + _WINDOW_PX for size in even.shape)
    padded = cv2.copyMakeBorder(even, before, below, before, right, cv2.BORDER_CONSTANT)
    windows = sliding_window_view(padded, (_WINDOW_PX, _WINDOW_PX))[::_STEP_PX, ::_STEP_PX]
    return np.stack([spectra_of(line * _TAPER) for line in windows[:rows, :columns]])


@lru_cache(maxsize=1)
def _bank() -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Which frequencies count (flat), their part in each direction and period, and both filters on
    the half spectrum.

    The filters are (fans, directions, window, half window) and (periods, window, half window).
    """
    down, right = np.meshgrid(
        np.fft.fftfreq(_WINDOW_PX), np.fft.rfftfreq(_WINDOW_PX), indexing="ij"
    )
    frequency = np.hypot(down, right)
    angle = np.arctan2(-down, right)
    inner = (frequency > 0.8 / _LONGEST_PX) & (frequency < 1.15 / _SHORTEST_PX)
    along = np.exp(-0.5 * (_apart(angle[inner][:, None], _ANGLES) / _DIRECTION_SIGMA) ** 2)
    octaves = np.log(frequency[inner])[:, None] - _LOGS
    bank = along[:, :, None] * np.exp(-0.5 * (octaves / _PERIOD_SIGMA) ** 2)[:, None]
    bank = bank.reshape(len(along), -1)
    bank /= np.median(bank.sum(axis=1))
    turns = np.pi / _TURNS * np.arange(_TURNS)[:, None, None]
    passed = (frequency > 1 / _LONGEST_PX) & (frequency < 1 / _SHORTEST_PX)
    fans = np.exp(-0.5 * (_apart(angle, turns) / _FANS[:, None, None, None]) ** 2) * passed
    centres = np.geomspace(1 / _LONGEST_PX, 1 / _SHORTEST_PX, 3 * _PERIODS)
    bands = np.exp(-0.5 * ((frequency - centres[:, None, None]) / _BAND_PER_PX) ** 2)
    return inner.ravel(), bank.astype(np.float32), fans.astype(np.float32), bands.astype(np.float32)


def _apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between two directions, up to a quarter turn."""
    return np.abs(np.mod(a - b + np.pi / 2, np.pi) - np.pi / 2)


def _field(
    weighed: FloatArray, trust: FloatArray, expected: tuple[float, float] | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Direction across the ridges, frequency, how well the directions agree, and the part of the
    power that has both.

    `weighed` (n, m, directions, periods): parts of each window's own power; `trust` (n, m, 1, 1):
    little where a window has little power, so that the edge of a sheet says nothing about ridges.
    """
    evidence = weighed * trust
    clear = evidence.max(axis=(2, 3))
    votes = np.einsum("nmf,nm->f", evidence.max(axis=2), clear**3)
    if expected is not None:
        votes *= np.exp(-0.5 * ((_LOGS + np.log(expected[0])) / expected[1]) ** 2)
    # logarithm of the print's frequency
    own = float((votes**4 * _LOGS).sum() / max(float((votes**4).sum()), 1e-30))
    spread = _PERIOD_SPREAD if expected is None else _PHOTO_PERIOD_SPREAD
    usual = (np.exp(-0.5 * ((_LOGS - own) / spread) ** 2) + 0.05).astype(np.float32)
    evidence = evidence @ usual
    strength = evidence.sum(axis=2, keepdims=True) + 1e-12
    turn = np.exp(-0.5 * (_apart(_ANGLES[:, None], _ANGLES) / _TURN_SIGMA) ** 2).astype(np.float32)
    belief = evidence
    for reach in _REACHES:
        around = blur(belief, reach) @ turn
        around /= around.sum(axis=2, keepdims=True) + 1e-12
        belief = evidence * around
        belief *= strength / (belief.sum(axis=2, keepdims=True) + 1e-12)
    belief = (evidence + 0.02 * evidence.max()) * around
    belief /= belief.sum(axis=2, keepdims=True) + 1e-12
    number = (belief.argmax(axis=2)[..., None] + np.arange(-3, 4)) % _DIRECTIONS
    peak = np.take_along_axis(belief, number, axis=2)
    direction = 0.5 * np.angle((peak * np.exp(2j * _ANGLES[number])).sum(axis=2)).astype(np.float32)
    agreement = np.abs((belief * np.exp(2j * _ANGLES)).sum(axis=2)).astype(np.float32)
    near = np.exp(-0.5 * (_apart(direction[..., None], _ANGLES) / (1.5 * _DIRECTION_SIGMA)) ** 2)
    along = np.matmul(near.astype(np.float32)[:, :, None], weighed)[:, :, 0]
    period = blur(along * usual * trust[..., 0], 1.5) ** 2
    frequency = (period @ _LOGS) / (period.sum(axis=2) + 1e-20)
    near_period = np.exp(-0.5 * ((frequency[..., None] - _LOGS) / (2 * _PERIOD_SIGMA)) ** 2)
    return direction, frequency, agreement, (along * near_period).sum(axis=2).astype(np.float32)


def _filtered(
    spectra: NDArray[np.complex64],
    direction: FloatArray,
    frequency: FloatArray,
    agreement: FloatArray,
) -> FloatArray:
    """What runs along the ridges and has their period, from windows added up."""
    _, _, fans, bands = _bank()
    turn = np.rint(direction * (_TURNS / np.pi)).astype(np.intp) % _TURNS
    fan = np.clip((0.95 - agreement) / 0.6 * len(fans), 0, len(fans) - 1).astype(np.intp)
    lowest, highest = np.log([1 / _LONGEST_PX, 1 / _SHORTEST_PX])
    place = np.rint((frequency - lowest) / (highest - lowest) * (len(bands) - 1))
    band = np.clip(place, 0, len(bands) - 1).astype(np.intp)
    # one after the other: they stay in the cache
    lines = zip(spectra, fan, turn, band, strict=True)
    waves = [
        np.fft.irfft2(line * fans[f, t] * bands[b], s=(_WINDOW_PX, _WINDOW_PX)) * _TAPER
        for line, f, t, b in lines
    ]
    return overlap_added(np.stack(waves), _STEP_PX)[
        _WINDOW_PX - _STEP_PX :, _WINDOW_PX - _STEP_PX :
    ]


def _clearest(confidence: NDArray[Any]) -> float:
    """Confidence that the clearest ridges have at least, on a twentieth of the picture, at most 20
    mm2."""
    last = confidence.size - 1 - min(confidence.size // 20, _CLEAREST_PX)
    return float(np.partition(confidence, last, axis=None)[last])


def _extent(confidence: FloatArray, edge: float) -> BoolArray:
    """(H, W) where there are ridges: clear ones and what hangs on them, holes filled."""
    clearest = _clearest(confidence)
    if clearest < _CLEAR:
        return np.zeros(confidence.shape, dtype=bool)
    closed = closed_opened(confidence > edge * clearest, _CLOSED_PX, _OPENED_PX, 2 * _CLOSED_PX)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed)
    sizes = stats[:, cv2.CC_STAT_AREA]
    sizes[0] = 0
    return fill_holes((sizes > 0.1 * sizes.max())[labels])
