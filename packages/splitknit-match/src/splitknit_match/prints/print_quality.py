"""How good a print is: one score made of figures that show what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.finger.ridges import MM_PER_INCH
from splitknit.imaging.areas import disc
from splitknit.imaging.geometry import gaussian_mean
from splitknit.model import BoolArray, FloatArray
from splitknit_match.prints.enhance import node_amplitudes
from splitknit_match.prints.pressed import without_shading
from splitknit_match.prints.ridge_field import RidgeField

# Figures of a print's quality: strength, direction, period, sharpness and extent of its ridges.
#
# Everything is measured on the values that are inked (the relief in micrometres, or light), not on
# the print's grey values, whose contrast is made even. At nodes about 0.4 mm apart a plane wave is
# fitted: its height, its fraction of all that varies around it, and its second harmonic, which
# shows how sharp the ridges' edges are.


@dataclass(frozen=True, slots=True)
class QualityFigures:
    """What was measured of a print, before rating."""

    ridge_share: float
    """0 to 1: fraction of the finger's area on the print that has ridges, pure and high enough."""
    ridge_height_um: float | None
    """um, 0 or more: median height of ridges above their valleys, wherever waves were found; None
    where not in um."""
    coherence: float
    """0 to 1: median agreement of the directions, wherever waves were field."""
    plausible_share: float
    """0 to 1: fraction of the ridges whose period is near the median."""
    period_mm: float
    """mm: median ridge period."""
    sharpness: float
    """0 to about 0.5: second harmonic of the ridges, where it goes with the first, over the first.
    """
    ridge_area_mm2: float
    """mm2, 0 to the finger's area: ridges."""
    finger_area_mm2: float
    """mm2: the finger on the print."""
    ridge_length_mm: float
    """mm, 0 or more: from the tip of the finger to the last rows of ridges."""
    gap_share: float
    """0 to 1: fraction without ridges of what ridges surround."""
    centre_offset_mm: float
    """mm, 0 or more: sideways from the middle of the finger's area to the middle of the ridges."""


_WAVE_SIGMA_PERIODS = 0.75  # standard deviation of the window in which a wave is fitted
_SMOOTH_MM = 0.6  # values are taken relative to their Gaussian mean of this standard deviation


def _waves(
    values: FloatArray, weight: FloatArray, sampled: RidgeField, px: float
) -> tuple[NDArray[np.complex64], NDArray[np.complex64], FloatArray]:
    """Waves at the nodes (n, m), their second harmonics, and the fraction of the variance that a
    wave explains."""
    inside = np.clip(weight, 0.0, 1.0)
    centred = np.where(inside > 0, values, 0.0)
    centred, _ = without_shading(centred, inside, _SMOOTH_MM * px)
    twice = replace(sampled, frequency_px=2.0 * sampled.frequency_px)
    first = node_amplitudes(centred, sampled, _WAVE_SIGMA_PERIODS)
    second = node_amplitudes(centred, twice, 2.0 * _WAVE_SIGMA_PERIODS)
    width = _WAVE_SIGMA_PERIODS / float(np.median(sampled.frequency_px[sampled.mask]))
    covered = np.maximum(gaussian_mean(inside, width), 0.3)
    variance = sampled.at_nodes(gaussian_mean(centred * centred, width) / covered)
    fraction = sampled.at_nodes(covered)
    first = first / fraction
    second = second / fraction
    purity = 0.5 * np.abs(first) ** 2 / np.maximum(variance, 1e-12)
    return first, second, np.where(sampled.mask, np.clip(purity, 0.0, 1.0), 0.0)


def _sharpness(first: NDArray[np.complex64], second: NDArray[np.complex64]) -> float:
    """Second harmonic that keeps its phase against the first's, which noise does not, over the
    first."""
    if first.size == 0:
        return 0.0
    size = np.maximum(np.abs(first), 1e-12)
    return float(np.abs(np.mean(second * np.conj(first / size) ** 2)) / np.mean(size))


def _length(strong: BoolArray, finger: BoolArray, cell_mm: float) -> float:
    """From the finger's first row to the last with ridges on a third of its median breadth, mm."""
    breadth = finger[::2].sum(axis=1)
    first = int(np.flatnonzero(breadth)[0])
    enough = strong[::2].sum(axis=1) > np.median(breadth[breadth > 0]) / 3.0
    return float(np.flatnonzero(enough)[-1] - first + 1) * cell_mm if enough.any() else 0.0


_CLOSE_MM = 3.0
"""Radius by which the print is closed: gaps up to about twice as wide, with ridges around, are
distinguished from an outline that has none."""


def _gaps(strong: BoolArray, finger: BoolArray, cell_mm: float) -> float:
    """Fraction of the closed area of the ridges (cells) that has none."""
    if not strong.any():
        return 1.0
    reach = max(1, round(_CLOSE_MM / cell_mm))
    closed = cv2.morphologyEx(np.pad(strong.view(np.uint8), reach), cv2.MORPH_CLOSE, disc(reach))
    return float(1.0 - strong[finger & (closed[reach:-reach, reach:-reach] > 0)].mean())


PARTS = {
    "ridge_share": (0.2, 1.0, 0.3),
    "ridge_height_um": (5.0, 50.0, 0.3),
    "coherence": (0.5, 1.0, 0.15),
    "plausible_share": (0.5, 1.0, 0.15),
    "sharpness": (0.02, 0.11, 0.15),
    "ridge_area_mm2": (20.0, 300.0, 0.15),
    "ridge_length_mm": (6.0, 20.0, 0.3),
    "gap_share": (0.4, 0.0, 0.15),
    "centre_offset_mm": (8.0, 1.0, 0.1),
}
"""Parts of the score, by figure: value rated lowest, value rated 1 (linear in between), and
exponent."""


@dataclass(frozen=True, slots=True)
class PrintQuality:
    """Quality of a print."""

    score: float
    """0 to 100, the higher the better."""
    worth: dict[str, float]
    """Rating of each figure, 0.01 to 1, by its name."""
    figures: QualityFigures


_WAVE_PURITY = 0.3
"""Fraction of what varies around a place that one wave must explain, or there are no ridges. Chosen
on: simulated fingers (with and without a fault, scale 0.4)."""
_MIN_HEIGHT_UM = 10.0
"""Ridges that rise less above their valleys count as none (prints of the relief). Chosen on:
simulated fingers (with and without a fault, scale 0.4)."""
_PERIOD_TOLERANCE = 0.35
"""A ridge period further from the finger's median than this, relative, is not plausible. Chosen on:
simulated fingers (with and without a fault, scale 0.4)."""


def print_quality(
    values: FloatArray,
    weight: FloatArray,
    field: RidgeField,
    ppi: float = 500.0,
    *,
    in_um: bool = True,
) -> PrintQuality:
    """Measure how good a print is. Raises BadInput if the shapes disagree or nothing lies on the
    finger.

    `values`: (h, w) float32, what is inked: the relief in um, or anything else that is high on
    ridges (`in_um` false: no heights then); `weight`: (h, w) float32, fraction of the pixel that
    lies on the finger, the tip at row 0; `field`: ridges of the print.

    Source: ISO/IEC 29794-4:2017, Biometric sample quality, part 4, sections on orientation
    certainty and ridge-valley uniformity; M. Lim, X. Jiang and W. Yau 2002, Fingerprint quality and
    validity analysis, section 2 (coherence, periods, ridge strength). Second harmonic against the
    first: the idea of the bispectrum (D. Brillinger 1965).
    """
    px = ppi / MM_PER_INCH
    finger = field.at_nodes(weight) > 0.5
    require(finger.any(), "nothing of the finger lies on the print.")
    finger[1::2] = False  # every second node, each way, is enough
    finger[:, 1::2] = False
    sampled = replace(field, mask=field.mask & finger)
    step_mm = field.step_px / px
    cell_mm = 2.0 * step_mm
    area_mm2 = float(finger.sum()) * cell_mm**2
    if not sampled.mask.any():
        nothing = QualityFigures(0, 0.0 if in_um else None, 0, 0, 0, 0, 0, area_mm2, 0, 1, 0)
        return PrintQuality(*score_of(nothing), nothing)
    first, second, purity = _waves(values, weight, sampled, px)
    height = 2.0 * np.abs(first)
    strong = sampled.mask & (purity > _WAVE_PURITY)
    if in_um:
        strong &= height > _MIN_HEIGHT_UM
    period = 1.0 / (field.frequency_px * px)
    typical = float(np.median(period[sampled.mask]))
    near = (period > typical * (1.0 - _PERIOD_TOLERANCE)) & (
        period < typical * (1.0 + _PERIOD_TOLERANCE)
    )
    middle = float(np.nonzero(finger)[1].mean())
    figures = QualityFigures(
        ridge_share=float(strong.sum() / finger.sum()),
        ridge_height_um=float(np.median(height[sampled.mask])) if in_um else None,
        coherence=float(np.median(field.coherence[sampled.mask])),
        plausible_share=float(near[strong].mean()) if strong.any() else 0.0,
        period_mm=typical,
        sharpness=_sharpness(first[strong], second[strong]),
        ridge_area_mm2=float(strong.sum()) * cell_mm**2,
        finger_area_mm2=area_mm2,
        ridge_length_mm=_length(strong, finger, cell_mm),
        gap_share=_gaps(strong[::2, ::2], finger[::2, ::2], cell_mm),
        centre_offset_mm=abs(float(np.nonzero(strong)[1].mean()) - middle) * step_mm
        if strong.any()
        else 0.0,
    )
    return PrintQuality(*score_of(figures), figures)


def score_of(figures: QualityFigures) -> tuple[float, dict[str, float]]:
    """Score of figures, 0 to 100, and the rating of each, 0.01 to 1.

    100 times the product of the ratings, each to the power of its weight: it never falls when a
    figure gets better, and many good figures do not make up for a bad one. 0 where there are no
    ridges. Figures that are None are left out.
    """
    # least rating of the worst figure: no single one makes the score 0
    ratings = {
        name: float(np.clip((figure - useless) / (good - useless), 0.01, 1.0))
        for name, (useless, good, _) in PARTS.items()
        if (figure := getattr(figures, name)) is not None
    }
    if figures.ridge_area_mm2 <= 0.0:
        return 0.0, ratings
    return 100.0 * float(
        np.prod([rating ** PARTS[name][2] for name, rating in ratings.items()])
    ), ratings
