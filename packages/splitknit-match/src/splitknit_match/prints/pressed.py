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
from splitknit_match.prints.parameters import (
    BAND_PER_PX,
    BREAK_DEG,
    CLEAREST,
    CLEAREST_PX,
    CLOSED_PX,
    CONFIDENCE_EDGE,
    CONTRAST_PX,
    DIRECTION_SIGMA,
    DIRECTIONS,
    FAINT_CONTRAST,
    FANS,
    FILTER_TURNS,
    FRAME_STEP,
    JUDGED_PAIRS,
    LONGEST_PX,
    MAX_BREAKS,
    MIN_BEND_DEG,
    MIN_LEVEL,
    NOISE,
    OPENED_PX,
    PERIOD_SIGMA,
    PERIOD_SPREAD,
    PHOTO_CONTRAST_PX,
    PHOTO_EDGE,
    PHOTO_FAINT,
    PHOTO_PERIOD_SPREAD,
    PRESSED_WINDOW_PX,
    PURE,
    RAISED,
    REACHES,
    SHORTEST_PX,
    STEEPNESS,
    STEP_PX,
    TURN_SIGMA,
    WEAK,
    WINDOW_PERIODS,
)
from splitknit_match.prints.ridge_field import closed_opened, overlap_added, spectra_of

_TAPER = np.sqrt(np.outer(*(np.hanning(PRESSED_WINDOW_PX + 1)[:-1],) * 2)).astype(np.float32)
"""Source: derived."""
_ANGLES = np.arange(DIRECTIONS, dtype=np.float32) * (np.pi / DIRECTIONS)
"""Directions across the ridges, counter-clockwise."""
_LOGS = np.log(np.geomspace(1 / LONGEST_PX, 1 / SHORTEST_PX, WINDOW_PERIODS)).astype(np.float32)
"""Logarithms of the frequencies. Source: derived."""


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
    sigma = PHOTO_CONTRAST_PX if is_photo else CONTRAST_PX
    even, contrast = _evened(image, sigma)
    spectra = _spectra(even)
    rows, columns = spectra.shape[:2]
    power = np.square(spectra.real) + np.square(spectra.imag)
    power[..., 0] *= 0.5  # the only column of the half spectrum that holds each of its waves twice
    inner, bank, _, _ = _bank()
    power = power.reshape(rows * columns, -1)[:, inner]
    weighed = (power @ bank).reshape(rows, columns, DIRECTIONS, WINDOW_PERIODS)
    total = (power @ np.ones(power.shape[1], dtype=np.float32)).reshape(rows, columns, 1, 1) + 1e-6
    unit = (
        0.5 * PRESSED_WINDOW_PX**2 * float(np.square(_TAPER).sum())
    )  # power of noise of variance one
    direction, frequency, agreement, purity = _field(
        weighed / total, total / (total + WEAK * unit), usual
    )
    wave = _filtered(spectra, direction, frequency, agreement)[: even.shape[0], : even.shape[1]]
    wave /= np.sqrt(_mean(wave * wave, 0.7 * sigma)) + 0.02
    y, x = (
        (np.arange(side, dtype=np.float32) + (PRESSED_WINDOW_PX / 2 - STEP_PX + 0.5)) / STEP_PX
        for side in even.shape
    )
    sure = np.clip((blur(purity, 1.0) / PURE - NOISE) / (1 - NOISE), 0, 1)
    confidence = cv2.remap(
        sure, *np.meshgrid(x, y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    clear_contrast = usual_contrast(contrast[confidence >= 0.5 * _clearest(confidence)])
    faint = (PHOTO_FAINT if is_photo else FAINT_CONTRAST) * clear_contrast + 1e-6
    confidence = confidence * np.minimum(contrast / faint, 1) ** 2
    inside = _extent(confidence, PHOTO_EDGE if is_photo else CONFIDENCE_EDGE)
    soft = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
    grey = 1.0 - soft * (0.5 - 0.5 * np.tanh(STEEPNESS * wave))
    even_ridges = np.round(255.0 * grey).astype(np.uint8)
    return PressedRidges(
        even_ridges, inside, np.where(inside, confidence, 0), _lacks(direction, inside)
    )


def _lacks(direction: FloatArray, inside: BoolArray) -> str:
    """What lines lack to be ridges, by the turn of their direction (n, m) from window to window
    `inside` (H, W)."""
    at = inside[STEP_PX::STEP_PX, STEP_PX::STEP_PX].astype(np.uint8)
    known = (
        cv2.erode(at, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    )
    here = direction[2 : 2 + known.shape[0], 2 : 2 + known.shape[1]]
    right = _apart(here[:, 1:], here[:, :-1])[known[:, 1:] & known[:, :-1]]
    down = _apart(here[1:], here[:-1])[known[1:] & known[:-1]]
    turn_deg = np.rad2deg(np.concatenate([right, down]))
    if len(turn_deg) < JUDGED_PAIRS:
        return ""
    if np.median(turn_deg) < MIN_BEND_DEG * STEP_PX * 25.4 / 500:
        return "no print of a finger: its lines run straight on"
    breaks = (turn_deg > BREAK_DEG).mean() > MAX_BREAKS
    return "no print of a finger: its lines break off in all directions" if breaks else ""


def _mean(image: FloatArray, sigma: float) -> FloatArray:
    """(H, W) mean in a Gaussian window of `sigma` px; wide ones, of photographs, on a smaller
    copy."""
    return blur(image, sigma) if sigma < 1.1 * CONTRAST_PX else wide_blur(image, sigma)


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
    level = np.maximum(MIN_LEVEL, RAISED * usual_contrast(contrast))
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
        if steps.size > 20 and np.percentile(steps, 20) > FRAME_STEP:
            framed[box] |= near
    return framed


def _spectra(even: FloatArray) -> NDArray[np.complex64]:
    """(n, m, window, window // 2 + 1) of overlapping windows, of which the first begins before the
    print."""
    rows, columns = (-(-size // STEP_PX) + PRESSED_WINDOW_PX // STEP_PX - 1 for size in even.shape)
    before = PRESSED_WINDOW_PX - STEP_PX
    below, right = (STEP_PX - size % STEP_PX + PRESSED_WINDOW_PX for size in even.shape)
    padded = cv2.copyMakeBorder(even, before, below, before, right, cv2.BORDER_CONSTANT)
    windows = sliding_window_view(padded, (PRESSED_WINDOW_PX, PRESSED_WINDOW_PX))[
        ::STEP_PX, ::STEP_PX
    ]
    return np.stack([spectra_of(line * _TAPER) for line in windows[:rows, :columns]])


@lru_cache(maxsize=1)
def _bank() -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Which frequencies count (flat), their part in each direction and period, and both filters on
    the half spectrum.

    The filters are (fans, directions, window, half window) and (periods, window, half window).
    """
    down, right = np.meshgrid(
        np.fft.fftfreq(PRESSED_WINDOW_PX), np.fft.rfftfreq(PRESSED_WINDOW_PX), indexing="ij"
    )
    frequency = np.hypot(down, right)
    angle = np.arctan2(-down, right)
    inner = (frequency > 0.8 / LONGEST_PX) & (frequency < 1.15 / SHORTEST_PX)
    along = np.exp(-0.5 * (_apart(angle[inner][:, None], _ANGLES) / DIRECTION_SIGMA) ** 2)
    octaves = np.log(frequency[inner])[:, None] - _LOGS
    bank = along[:, :, None] * np.exp(-0.5 * (octaves / PERIOD_SIGMA) ** 2)[:, None]
    bank = bank.reshape(len(along), -1)
    bank /= np.median(bank.sum(axis=1))
    turns = np.pi / FILTER_TURNS * np.arange(FILTER_TURNS)[:, None, None]
    passed = (frequency > 1 / LONGEST_PX) & (frequency < 1 / SHORTEST_PX)
    fans = np.exp(-0.5 * (_apart(angle, turns) / FANS[:, None, None, None]) ** 2) * passed
    centres = np.geomspace(1 / LONGEST_PX, 1 / SHORTEST_PX, 3 * WINDOW_PERIODS)
    bands = np.exp(-0.5 * ((frequency - centres[:, None, None]) / BAND_PER_PX) ** 2)
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
    spread = PERIOD_SPREAD if expected is None else PHOTO_PERIOD_SPREAD
    usual = (np.exp(-0.5 * ((_LOGS - own) / spread) ** 2) + 0.05).astype(np.float32)
    evidence = evidence @ usual
    strength = evidence.sum(axis=2, keepdims=True) + 1e-12
    turn = np.exp(-0.5 * (_apart(_ANGLES[:, None], _ANGLES) / TURN_SIGMA) ** 2).astype(np.float32)
    belief = evidence
    for reach in REACHES:
        around = blur(belief, reach) @ turn
        around /= around.sum(axis=2, keepdims=True) + 1e-12
        belief = evidence * around
        belief *= strength / (belief.sum(axis=2, keepdims=True) + 1e-12)
    belief = (evidence + 0.02 * evidence.max()) * around
    belief /= belief.sum(axis=2, keepdims=True) + 1e-12
    number = (belief.argmax(axis=2)[..., None] + np.arange(-3, 4)) % DIRECTIONS
    peak = np.take_along_axis(belief, number, axis=2)
    direction = 0.5 * np.angle((peak * np.exp(2j * _ANGLES[number])).sum(axis=2)).astype(np.float32)
    agreement = np.abs((belief * np.exp(2j * _ANGLES)).sum(axis=2)).astype(np.float32)
    near = np.exp(-0.5 * (_apart(direction[..., None], _ANGLES) / (1.5 * DIRECTION_SIGMA)) ** 2)
    along = np.matmul(near.astype(np.float32)[:, :, None], weighed)[:, :, 0]
    period = blur(along * usual * trust[..., 0], 1.5) ** 2
    frequency = (period @ _LOGS) / (period.sum(axis=2) + 1e-20)
    near_period = np.exp(-0.5 * ((frequency[..., None] - _LOGS) / (2 * PERIOD_SIGMA)) ** 2)
    return direction, frequency, agreement, (along * near_period).sum(axis=2).astype(np.float32)


def _filtered(
    spectra: NDArray[np.complex64],
    direction: FloatArray,
    frequency: FloatArray,
    agreement: FloatArray,
) -> FloatArray:
    """What runs along the ridges and has their period, from windows added up."""
    _, _, fans, bands = _bank()
    turn = np.rint(direction * (FILTER_TURNS / np.pi)).astype(np.intp) % FILTER_TURNS
    fan = np.clip((0.95 - agreement) / 0.6 * len(fans), 0, len(fans) - 1).astype(np.intp)
    lowest, highest = np.log([1 / LONGEST_PX, 1 / SHORTEST_PX])
    place = np.rint((frequency - lowest) / (highest - lowest) * (len(bands) - 1))
    band = np.clip(place, 0, len(bands) - 1).astype(np.intp)
    # one after the other: they stay in the cache
    lines = zip(spectra, fan, turn, band, strict=True)
    waves = [
        np.fft.irfft2(line * fans[f, t] * bands[b], s=(PRESSED_WINDOW_PX, PRESSED_WINDOW_PX))
        * _TAPER
        for line, f, t, b in lines
    ]
    return overlap_added(np.stack(waves), STEP_PX)[
        PRESSED_WINDOW_PX - STEP_PX :, PRESSED_WINDOW_PX - STEP_PX :
    ]


def _clearest(confidence: NDArray[Any]) -> float:
    """Confidence that the clearest ridges have at least, on a twentieth of the picture, at most 20
    mm2."""
    last = confidence.size - 1 - min(confidence.size // 20, CLEAREST_PX)
    return float(np.partition(confidence, last, axis=None)[last])


def _extent(confidence: FloatArray, edge: float) -> BoolArray:
    """(H, W) where there are ridges: clear ones and what hangs on them, holes filled."""
    clearest = _clearest(confidence)
    if clearest < CLEAREST:
        return np.zeros(confidence.shape, dtype=bool)
    closed = closed_opened(confidence > edge * clearest, CLOSED_PX, OPENED_PX, 2 * CLOSED_PX)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed)
    sizes = stats[:, cv2.CC_STAT_AREA]
    sizes[0] = 0
    return fill_holes((sizes > 0.1 * sizes.max())[labels])
