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
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.finger.regions import blur, fill_holes
from splitknit.imaging.areas import disc
from splitknit.imaging.geometry import wide_blur
from splitknit.model import BoolArray, FloatArray, GreyArray
from splitknit_match.prints.ridge_field import closed_opened, overlap_added

_PRESSED_WINDOW_PX = 32
"""Side of a window at 500 ppi: some four ridges. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_TAPER = np.sqrt(np.outer(*(np.hanning(_PRESSED_WINDOW_PX + 1)[:-1],) * 2)).astype(np.float32)
"""Source: derived."""
_DIRECTIONS = 24
"""Directions that a window may have; means between them are taken. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_ANGLES = np.arange(_DIRECTIONS, dtype=np.float32) * (np.pi / _DIRECTIONS)
"""Directions across the ridges, counter-clockwise."""
_SHORTEST_PX = 4.5
"""Shortest period of ridges at 500 ppi: 0.23 mm. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_LONGEST_PX = 15.0
"""Longest period of ridges at 500 ppi: 0.76 mm. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_WINDOW_PERIODS = 10
"""Periods that a window may have. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_LOGS = np.log(np.geomspace(1 / _LONGEST_PX, 1 / _SHORTEST_PX, _WINDOW_PERIODS)).astype(np.float32)
"""Logarithms of the frequencies. Source: derived."""
_FINGER_MM2 = 60.0
"""Least area of ridges that may be another finger's. Source: real prints fall into pieces of 43 mm2
at most (validation/prints/any_print.py)."""
_TALLEST_MM = 40.0
"""Height of a rolled print. Source: boxes of ten-print cards, 1.5 and 1.6 inches."""
_SEAM_MM = 1.2
"""Width of a seam. Source: three windows; of three to six it parts prints side by side best."""
_SEAM = 0.35
"""Fraction of a seam on which ridges run on. Source: 0.47 or more on any line through one of 320
real prints, 0.36 or less on most between prints that show no two cores."""
_ARCH_DEG = 60
"""Turn of ridges at the axis of an arch, down on both sides. Source: simulated arches."""
_CORE_MM = 1.2
"""Scale of the filter for cores. Source: of 1.2 to 2.5 mm it parts sheets from real prints best."""
_CORE = 0.6
"""Least parabolic symmetry of cores, of 1. Source: two that open the same way on one of 320 real
prints have 0.47 at most, on sheets of several usually 0.8 (validation/prints/any_print.py)."""
_WHOLE = 0.97
"""Least weight of ridges under the filter for cores: 0.9 and 0.98 part 105 sheets from 280 real
prints as well, but half a delta at the edge of a coarse capture has 0.94."""
_CORES_MM = 6.0
"""Least distance of cores of two fingers. Source: judgement."""


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
    several: bool = False
    """Whether they are prints of several fingers."""


_STEP_PX = 8
"""Step from window to window at 500 ppi. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_CONTRAST_PX = 11.0
"""Sigma over which a print's mean and contrast are made even. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_WEAK = 0.03
"""Power of a window, relative to noise of the evened print's variance, below which it counts for
little. Chosen on: simulated prints (validation/match/pressed_prints.py)."""
_STEEPNESS = 1.6
"""Steepness of the grey curve of a print of even contrast. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_PURE = 0.42
"""Fraction of its power that a window of parallel ridges has near one direction and period. Chosen
on: simulated prints (validation/match/pressed_prints.py)."""
_NOISE = 0.2
"""Part of that fraction that noise has. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_CONFIDENCE_EDGE = 0.25
"""Ridges end where their confidence falls below this part of the way from noise to the clearest
ones. Chosen on: simulated prints (validation/match/pressed_prints.py)."""
_FAINT_CONTRAST = 0.4
"""Contrast, relative to that of the clear ridges, below which confidence falls (what others left on
the sensor). Chosen on: simulated prints (validation/match/pressed_prints.py)."""


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
    # weak ridges of a photograph are noise
    sigma = 20.0 if is_photo else _CONTRAST_PX
    even, contrast = _evened(image, sigma)
    spectra = _spectra(even)
    rows, columns = spectra.shape[:2]
    power = np.square(spectra.real) + np.square(spectra.imag)
    power[..., 0] *= 0.5  # the only column of the half spectrum that holds each of its waves twice
    inner, bank, _, _ = _bank()
    power = power.reshape(rows * columns, -1)[:, inner]
    weighed = (power @ bank).reshape(rows, columns, _DIRECTIONS, _WINDOW_PERIODS)
    total = (power @ np.ones(power.shape[1], dtype=np.float32)).reshape(rows, columns, 1, 1) + 1e-6
    # power of noise of variance one
    unit = 0.5 * _PRESSED_WINDOW_PX**2 * float(np.square(_TAPER).sum())
    direction, frequency, agreement, purity = _field(
        weighed / total, total / (total + _WEAK * unit), usual
    )
    wave = _filtered(spectra, direction, frequency, agreement)[: even.shape[0], : even.shape[1]]
    wave /= np.sqrt(_mean(wave * wave, 0.7 * sigma)) + 0.02
    y, x = (
        (np.arange(side, dtype=np.float32) + (_PRESSED_WINDOW_PX / 2 - _STEP_PX + 0.5)) / _STEP_PX
        for side in even.shape
    )
    sure = np.clip((blur(purity, 1.0) / _PURE - _NOISE) / (1 - _NOISE), 0, 1)
    confidence = cv2.remap(
        sure, *np.meshgrid(x, y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    clear_contrast = usual_contrast(contrast[confidence >= 0.5 * _clearest(confidence)])
    faint = (0.15 if is_photo else _FAINT_CONTRAST) * clear_contrast + 1e-6
    confidence = confidence * np.minimum(contrast / faint, 1) ** 2
    inside = _extent(confidence, 0.4 if is_photo else _CONFIDENCE_EDGE)
    soft = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
    grey = 1.0 - soft * (0.5 - 0.5 * np.tanh(_STEEPNESS * wave))
    even_ridges = np.round(255.0 * grey).astype(np.uint8)
    at = inside[_STEP_PX::_STEP_PX, _STEP_PX::_STEP_PX]
    along = direction[2 : 2 + at.shape[0], 2 : 2 + at.shape[1]]
    lacks = _lacks(along, at)
    several = not (is_photo or lacks) and _several(inside, along, at)
    return PressedRidges(even_ridges, inside, np.where(inside, confidence, 0), lacks, several)


_MIN_BEND_DEG = 1.5
"""Least median turn of the direction of ridges: 280 real prints have 2.9 to 7.8 deg a mm, squares
of 7 mm of them 1.7, in deg/mm. Chosen on: real prints (280 prints of seven sensors)."""
_BREAK_DEG = 25  # turn from a window to the next at which lines break off
_MAX_BREAKS = 0.12
"""Largest fraction of the pairs of windows between which lines break off: 280 real prints have at
most 4 %, squares of 7 mm of them 9 %. Chosen on: real prints (280 prints of seven sensors)."""


def _lacks(direction: FloatArray, at: BoolArray) -> str:
    """What lines lack to be ridges, by the turn of their direction (n, m) from window to window
    `at` (n, m)."""
    known = scipy.ndimage.binary_erosion(at, np.ones((3, 3), np.bool_))
    right = _apart(direction[:, 1:], direction[:, :-1])[known[:, 1:] & known[:, :-1]]
    down = _apart(direction[1:], direction[:-1])[known[1:] & known[:-1]]
    turn_deg = np.rad2deg(np.concatenate([right, down]))
    if len(turn_deg) < 500:  # pairs of windows: 40 mm2
        return ""
    if np.median(turn_deg) < _MIN_BEND_DEG * _STEP_PX * 25.4 / 500:
        return "no print of a finger: its lines run straight on"
    breaks = (turn_deg > _BREAK_DEG).mean() > _MAX_BREAKS
    return "no print of a finger: its lines break off in all directions" if breaks else ""


def _several(inside: BoolArray, direction: FloatArray, at: BoolArray) -> bool:
    """Whether ridges `inside` (H, W), in windows `at` (n, m) of a direction (n, m), are more than
    one fingertip's.

    They are higher than any, lie apart, break off at a line from top to bottom, or curve around two
    cores that open the same way: the second core of a whorl opens the other way.

    Source: K. Nilsson and J. Bigun, "Localization of corresponding points in fingerprints by
    complex filtering", Pattern Recognition Letters 24, 2003, section 2 (parabolic symmetry).
    """
    pixel_mm = 25.4 / 500
    _, _, stats, _ = cv2.connectedComponentsWithStats(inside.view(np.uint8))
    areas_mm2 = stats[1:, cv2.CC_STAT_AREA] * pixel_mm**2
    if areas_mm2.sum() < 2 * _FINGER_MM2:
        return False
    height_mm = inside.any(axis=1).sum() * pixel_mm
    if height_mm > _TALLEST_MM or (areas_mm2 >= _FINGER_MM2).sum() > 1:
        return True
    return _seam(direction, at) or _cores(direction, at)


def _seam(direction: FloatArray, at: BoolArray) -> bool:
    """Whether ridges break off at a line from top to bottom, with a print on either side."""
    step_mm = _STEP_PX * 25.4 / 500
    width = round(_SEAM_MM / step_mm)
    area_mm2 = np.cumsum(at.sum(axis=0)) * step_mm**2
    left, right = at[:, :-width], at[:, width:]
    enough = (area_mm2[:-width] >= _FINGER_MM2) & (
        area_mm2[-1] - area_mm2[width - 1 : -1] >= _FINGER_MM2
    )
    turn = np.mod(direction[:, width:] - direction[:, :-width] + np.pi / 2, np.pi) - np.pi / 2
    runs_on = (turn < np.deg2rad(_BREAK_DEG)) & (turn > -np.deg2rad(_ARCH_DEG))
    on = (left & right & runs_on).sum(axis=0)
    rows = np.minimum(
        np.maximum.accumulate(left, axis=1).sum(axis=0),
        np.maximum.accumulate(right[:, ::-1], axis=1)[:, ::-1].sum(axis=0),
    )
    return bool((enough & (on < _SEAM * rows)).any())


def _cores(direction: FloatArray, at: BoolArray) -> bool:
    """Whether two cores open the same way."""
    step_mm = _STEP_PX * 25.4 / 500
    reach = round(3 * _CORE_MM / step_mm)
    down, right = step_mm * np.mgrid[-reach : reach + 1, -reach : reach + 1]
    # correlate takes the conjugate of its weights
    parabola = (right - 1j * down) * np.exp(-0.5 * (right**2 + down**2) / _CORE_MM**2)
    parabola /= np.abs(parabola).sum()
    core = scipy.ndimage.correlate(
        np.where(at, np.exp(2j * direction), 0), parabola, mode="constant"
    )
    strength = np.abs(core)
    peaks = strength == scipy.ndimage.maximum_filter(strength, 2 * reach + 1)
    # beside the edge half a delta, or a fold, curves as a core does
    covered = scipy.ndimage.correlate(at.astype(float), np.abs(parabola), mode="constant")
    places = np.argwhere(peaks & (covered > _WHOLE) & (strength > _CORE))
    opening = (core / np.maximum(strength, 1e-9))[tuple(places.T)]
    apart_mm = step_mm * np.linalg.norm(places[:, None] - places, axis=2)
    same = (opening[:, None] * opening.conj()).real > 0.5
    return bool((same & (apart_mm > _CORES_MM)).any())


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


_MIN_LEVEL = 8.0
"""Contrast of fewer grey levels is not raised further, in grey levels. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_RAISED = 0.3
"""Contrast below this fraction of the print's usual one is not raised further. Chosen on: simulated
prints (validation/match/pressed_prints.py)."""


def _evened(image: GreyArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """(H, W) the print with even mean and contrast, and its contrast; the sensor's frame does not
    count."""
    known = (~frame(image)).astype(np.float32)
    grey = image.astype(np.float32)
    grey = np.minimum(grey, np.float32(np.percentile(grey[known > 0], 99)))  # paper is flat
    centred, weight = without_shading(grey, known, sigma)
    contrast = np.sqrt(_mean(centred * centred, sigma) / weight)
    level = np.maximum(_MIN_LEVEL, _RAISED * usual_contrast(contrast))
    return np.clip(centred / np.maximum(contrast, level), -3.0, 3.0), contrast


def usual_contrast(contrast: FloatArray) -> np.float32:
    """Mean contrast, weighted by itself: of the strong places, however few."""
    return np.float32((contrast * contrast).sum() / np.maximum(contrast.sum(), 1e-6))


_FRAME_STEP = 20
"""Step between a constant border and what is beside it, where that is the sensor's frame and no
paper."""


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
    before = _PRESSED_WINDOW_PX - _STEP_PX
    below, right = (before + -size % _STEP_PX for size in even.shape)
    padded = cv2.copyMakeBorder(even, before, below, before, right, cv2.BORDER_CONSTANT)
    windows = sliding_window_view(padded, (_PRESSED_WINDOW_PX, _PRESSED_WINDOW_PX))
    windows = windows[::_STEP_PX, ::_STEP_PX]
    return np.stack([np.fft.rfft2(line * _TAPER) for line in windows])


_DIRECTION_SIGMA = np.deg2rad(9.0)
"""Sigma of one of a window's directions, in rad. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_PERIOD_SIGMA = 0.11
"""Relative sigma of one of a window's periods. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_FANS = np.deg2rad([16.0, 22.0, 30.0, 42.0])
"""Sigmas of the filter across directions, from where the windows agree to where they do not, in
rad. Chosen on: simulated prints (validation/match/pressed_prints.py)."""
_BAND_PER_PX = 0.035
"""Sigma of the filter across frequencies, in 1/px. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_FILTER_TURNS = 64
"""Directions of the filters. Chosen on: simulated prints (validation/match/pressed_prints.py)."""


@lru_cache(maxsize=1)
def _bank() -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Which frequencies count (flat), their part in each direction and period, and both filters on
    the half spectrum.

    The filters are (fans, directions, window, half window) and (periods, window, half window).
    """
    down, right = np.meshgrid(
        np.fft.fftfreq(_PRESSED_WINDOW_PX), np.fft.rfftfreq(_PRESSED_WINDOW_PX), indexing="ij"
    )
    frequency = np.hypot(down, right)
    angle = np.arctan2(-down, right)
    inner = (frequency > 0.8 / _LONGEST_PX) & (frequency < 1.15 / _SHORTEST_PX)
    along = np.exp(-0.5 * (_apart(angle[inner][:, None], _ANGLES) / _DIRECTION_SIGMA) ** 2)
    octaves = np.log(frequency[inner])[:, None] - _LOGS
    bank = along[:, :, None] * np.exp(-0.5 * (octaves / _PERIOD_SIGMA) ** 2)[:, None]
    bank = bank.reshape(len(along), -1)
    bank /= np.median(bank.sum(axis=1))
    turns = np.pi / _FILTER_TURNS * np.arange(_FILTER_TURNS)[:, None, None]
    passed = (frequency > 1 / _LONGEST_PX) & (frequency < 1 / _SHORTEST_PX)
    fans = np.exp(-0.5 * (_apart(angle, turns) / _FANS[:, None, None, None]) ** 2) * passed
    centres = np.geomspace(1 / _LONGEST_PX, 1 / _SHORTEST_PX, 3 * _WINDOW_PERIODS)
    bands = np.exp(-0.5 * ((frequency - centres[:, None, None]) / _BAND_PER_PX) ** 2)
    return inner.ravel(), bank.astype(np.float32), fans.astype(np.float32), bands.astype(np.float32)


def _apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between two directions, up to a quarter turn."""
    return np.abs(np.mod(a - b + np.pi / 2, np.pi) - np.pi / 2)


_TURN_SIGMA = np.deg2rad(10.0)
"""Sigma of the turn of directions from a window to those about it, in rad. Chosen on: simulated
prints (validation/match/pressed_prints.py)."""
_PERIOD_SPREAD = 0.3
"""Relative sigma of periods about the print's own. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_REACHES = (4.0, 3.0, 2.0, 1.5, 1.5, 1.5)
"""Sigma of the surroundings, one pass after the other, in windows. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""


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
    spread = _PERIOD_SPREAD if expected is None else 0.2
    usual = np.exp(-0.5 * ((_LOGS - own) / spread) ** 2) + 0.05
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
    direction = 0.5 * np.angle((peak * np.exp(2j * _ANGLES[number])).sum(axis=2))
    agreement = np.abs((belief * np.exp(2j * _ANGLES)).sum(axis=2))
    near = np.exp(-0.5 * (_apart(direction[..., None], _ANGLES) / (1.5 * _DIRECTION_SIGMA)) ** 2)
    along = np.matmul(near.astype(np.float32)[:, :, None], weighed)[:, :, 0]
    period = blur(along * usual * trust[..., 0], 1.5) ** 2
    frequency = (period @ _LOGS) / (period.sum(axis=2) + 1e-20)
    near_period = np.exp(-0.5 * ((frequency[..., None] - _LOGS) / (2 * _PERIOD_SIGMA)) ** 2)
    return direction, frequency, agreement, (along * near_period).sum(axis=2)


def _filtered(
    spectra: NDArray[np.complex64],
    direction: FloatArray,
    frequency: FloatArray,
    agreement: FloatArray,
) -> FloatArray:
    """What runs along the ridges and has their period, from windows added up."""
    _, _, fans, bands = _bank()
    turn = np.rint(direction * (_FILTER_TURNS / np.pi)).astype(np.intp) % _FILTER_TURNS
    fan = np.clip((0.95 - agreement) / 0.6 * len(fans), 0, len(fans) - 1).astype(np.intp)
    lowest, highest = np.log([1 / _LONGEST_PX, 1 / _SHORTEST_PX])
    place = np.rint((frequency - lowest) / (highest - lowest) * (len(bands) - 1))
    band = np.clip(place, 0, len(bands) - 1).astype(np.intp)
    # one after the other: they stay in the cache
    lines = zip(spectra, fan, turn, band, strict=True)
    waves = [
        np.fft.irfft2(line * fans[f, t] * bands[b], s=(_PRESSED_WINDOW_PX, _PRESSED_WINDOW_PX))
        * _TAPER
        for line, f, t, b in lines
    ]
    return overlap_added(np.stack(waves), _STEP_PX)[
        _PRESSED_WINDOW_PX - _STEP_PX :, _PRESSED_WINDOW_PX - _STEP_PX :
    ]


_CLEAREST_PX = 7750
"""Number of the clearest pixels that set this level: 20 mm2. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""


def _clearest(confidence: NDArray[Any]) -> float:
    """Confidence that the clearest ridges have at least, on a twentieth of the picture, at most 20
    mm2."""
    last = confidence.size - 1 - min(confidence.size // 20, _CLEAREST_PX)
    return float(np.partition(confidence, last, axis=None)[last])


_CLEAREST = 0.35
"""Confidence of a print's clearest ridges below which there is no print. Chosen on: simulated
prints (validation/match/pressed_prints.py)."""
_CLOSED_PX = 14
"""Radius by which ridges are closed: gaps between them belong to them. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""
_OPENED_PX = 10
"""Radius by which ridges are opened: specks do not belong to them. Chosen on: simulated prints
(validation/match/pressed_prints.py)."""


def _extent(confidence: FloatArray, edge: float) -> BoolArray:
    """(H, W) where there are ridges: clear ones and what hangs on them, holes filled."""
    clearest = _clearest(confidence)
    if clearest < _CLEAREST:
        return np.zeros(confidence.shape, dtype=bool)
    closed = closed_opened(confidence > edge * clearest, _CLOSED_PX, _OPENED_PX, 2 * _CLOSED_PX)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed.view(np.uint8))
    sizes = stats[:, cv2.CC_STAT_AREA]
    sizes[0] = 0
    return fill_holes((sizes > 0.1 * sizes.max())[labels])
