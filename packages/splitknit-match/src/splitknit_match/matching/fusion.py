"""Ridges and minutiae of two prints as one score: a log-likelihood ratio.

Its constants come of simulated presses; those of small prints, of windows of real ones. Both propose how one print lies
on the other; the best alignment is bent until the ridges agree, smoothly as skin stretches, and what agrees is counted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray
from splitknit_match.matching.elastic import (
    Affine,
    Agreement,
    PatchGrid,
    bent,
    bent_by,
    compare_patches,
    overlap_correlation,
    rigid,
    shown_in_a,
)
from splitknit_match.matching.minutia_pairs import Laid, Places, agreeing, on_ridges, pair_minutiae
from splitknit_match.matching.ridge import (
    Prepared,
    RidgeMatch,
    every_pose,
    placed,
    prepared,
    refined,
    ridge_match,
    scored,
    starts_by_ridges,
)
from splitknit_match.matching.template import Template, scaled
from splitknit_match.prints.minutiae_record import pack_minutiae

_BENDS = 2
"""Times that the shifts of patches are smoothed and followed."""
_OF_MINUTIAE = 0.1
"""What an agreeing minutia counts when alignments are compared, beside correlation times the root of the patches."""
# Slopes and offsets of logistic regressions, both classes of equal weight, on simulated presses alone: `fitted` in
# validation/match/fvc.json, made by validation/match/fvc.py --fit.
_BY_BOTH = (3.7198, 18.8171, -9.6266)
"""Weights of `evidence`: agreeing minutiae, correlation, offset."""
_BY_SUPPORT = (0.9498, -4.6929)
_LOWEST = _BY_BOTH[2]
"""Where nothing was compared."""
_BY_OVERLAP = (8.4813, 0.5001, -5.6423)
"""Correlation, that times the root of the area, offset."""
_BY_OVERLAP_AND_MINUTIAE = (4.8715, 8.1117, 0.5104, -6.1373)
"""Agreeing minutiae, and the same. Both on windows of real prints: `fitted` in validation/match/windows.json."""
SMALL_MM2 = 100.0
"""A print that shows less is small: tried in every pose, and rated by what overlaps."""
_POSES_BENT = 3
"""Poses of a small print that are bent."""
SURE = 9.0
"""Support of an alignment from which ridges propose none: 429 of 544 matching pairs of real prints have it, none of the
14,000 pairs of other fingers that are most similar by minutiae (``validation/gallery/index.py``)."""
SCALES = (1.0, 0.94, 1.06, 0.88, 1.12)
"""Of a photograph, relative to that at which its ridges lie as far apart as the other side's do, which is wrong by 7 %
(standard deviation)."""
_MOST_SCALED = 0.15
"""Natural logarithm of what is believed of that scale, at most."""
_ONE_SCALE = 0.06
"""Natural logarithm of a difference in the distance of ridges that says nothing: pairs of one finger have 0.03."""
_LOGS = np.linspace(np.log(1 / 0.9), np.log(1 / 0.28), 41)
"""Logarithms of the ridges that lie in a millimetre."""
_FEW = 9.0
"""Minutiae that are added to those that could agree, so that few of few count little."""


@dataclass(frozen=True, slots=True)
class _FusedMatch:
    """How similar two prints are."""

    similarity: float
    """Natural logarithm of the likelihood ratio; that of the lowest scores where neither method could compare."""
    minutiae: float | None
    """About how many pairs of minutiae support each other; None where a side has fewer than ten."""
    ridge: RidgeMatch
    evidence: tuple[float, float, float, float]
    """What the score is made of: agreeing minutiae over the root of those that could agree and nine more, correlation
    of the bent ridges, `minutiae`; of a small print or one without minutiae also the area that overlaps, mm2; NaN where
    there is none."""

    @property
    def compared(self) -> bool:
        """False where neither method could compare."""
        return self.ridge.compared or self.minutiae is not None


def can_fuse(*templates: Template) -> bool:
    """Whether all hold minutiae of a print."""
    return all(one.minutiae is not None for one in templates)


def with_fusion(templates: Iterable[Template], probe: Template | None = None) -> tuple[bool, str | None]:
    """Whether some templates (with each other, or with a probe) are compared by :func:`fused_match`, and a note.

    They are if one of them (and the probe) holds minutiae. What holds none is compared by its ridges, on the same
    scale; the note counts such templates.
    """
    held = [can_fuse(one) for one in templates]
    fused = any(held) and (probe is None or can_fuse(probe))
    if not fused or all(held):
        return fused, None
    return True, (
        f"{held.count(False)} of {len(held)} templates hold no minutiae of this version; they were compared by their "
        "ridges alone, on the same scale."
    )


_Start = tuple[Affine, Laid | None]
"""One alignment that is tried, from B's places to A's, and by which minutiae."""


def fused_match(a: Template | Prepared, b: Template | Prepared, sure: float | None = None) -> _FusedMatch:
    """Compare two prints by their ridges and their minutiae.

    Raises BadInput as :func:`splitknit_match.matching.ridge.ridge_match`.

    `a`, `b`: with minutiae, as :func:`splitknit_match.matching.inputs.print_template` makes them; `sure`: support of an
    alignment by minutiae from which ridges propose none (default: SURE).
    """
    left, right = prepared(a), prepared(b)
    areas = left.template.area_mm2, right.template.area_mm2
    small = 0 < min(areas) < SMALL_MM2
    swapped = areas[0] < areas[1] if small and areas[0] != areas[1] else _order(left) > _order(right)
    if swapped:
        left, right = right, left
    laid: list[Laid] = []
    score = None
    many = all(one.template.minutiae is not None and one.template.minutiae.acquired for one in (left, right))
    if (many or small) and left.cylinders is not None and right.cylinders is not None:
        laid = pair_minutiae(left.cylinders, right.cylinders)
        score = max((one.support for one in laid), default=0.0)
    support, none = math.nan if score is None else score, math.nan
    if left.template.empty or right.template.empty:
        evidence = none, none, support, none
        return _FusedMatch(_score(*evidence), score, ridge_match(left, right), evidence)
    if small:
        grid = right.close
        found, affine, bend = _best_pose(left, right, laid)
        correlation, overlap_mm2 = found.correlation, found.overlap_mm2
    else:
        grid, overlap_mm2, by_minutiae = right.patches, none, None
        (affine, by), first = _best_start(left, right, laid, SURE if sure is None else sure)
        if by is None:
            affine = refined(left, right, affine, first)
        else:
            by_minutiae = _bend(left, right, grid, by)
        agreement = compare_patches(grid, left.value, left.template.valid, affine, by_minutiae)
        found = scored(left, right, agreement)
        agreement, bend = _bent(left, right, grid, (affine, by_minutiae), agreement)
        correlation = agreement.mean
    fraction = none
    if score is not None:
        there = shown_in_a(grid, affine, bend, _pixels(right, _of(right)[0]))
        count, possible = _minutiae_on(left, right, affine, there)
        fraction = count / math.sqrt(possible + _FEW)
    elif not small:
        correlation, overlap_mm2 = overlap_correlation(grid, left.shown, right.shown, affine, bend)
    if swapped:
        left, right = right, left
    evidence = fraction, correlation, support, overlap_mm2
    return _FusedMatch(_score(*evidence), score, placed(found, affine, left, right, swapped), evidence)


def fused_photo(a: Prepared, b: Prepared, photos: Sequence[bool]) -> tuple[_FusedMatch, float, int]:
    """Compare a photograph of assumed scale at several, about that at which both have the same distance of ridges; the
    best match, its scale, and which side (0, 1) has it.

    `photos`: which sides are photographs; of two, one is scaled.
    """
    number = int(_order(a) > _order(b)) if all(photos) else int(photos[1])
    one, other = (a, b)[number], (b, a)[number]
    apart = _log_frequency(one.template) - _log_frequency(other.template)
    middle = math.exp(min(max(apart, -_MOST_SCALED), _MOST_SCALED))
    scales = [middle * scale for scale in SCALES]
    tried = [Prepared(scaled(one.template, scale)) for scale in scales]
    found = [fused_match(a, each) if number else fused_match(each, b) for each in tried]
    best = max(range(len(found)), key=lambda k: found[k].similarity)
    return found[best], scales[best], number


def at_one_scale(a: Template, b: Template) -> tuple[Template, Template, float] | None:
    """Two prints, the one with the finer ridges enlarged until those of both lie equally far apart, and by how much;
    None where they do as they are, within 6 %."""
    finer = _log_frequency(a) - _log_frequency(b)
    if abs(finer) < _ONE_SCALE:
        return None
    scale = math.exp(abs(finer))
    return (scaled(a, scale), b, scale) if finer > 0 else (a, scaled(b, scale), scale)


def _log_frequency(template: Template) -> float:
    """Logarithm of the usual number of ridges in a millimetre, by the power spectrum; 0 of an empty template."""
    if template.empty:
        return 0.0
    value = template.value()
    side = 1 << (max(value.shape) - 1).bit_length()
    power = np.square(np.abs(np.fft.rfft2(value - value.mean(), (side, side))))
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)) / template.pitch_mm
    found = np.histogram(np.log(np.maximum(frequency, 1e-9)), _LOGS, weights=power)[0]
    peak = np.convolve(found, (0.25, 0.5, 0.25), "same") ** 3
    return float(peak @ (0.5 * (_LOGS[1:] + _LOGS[:-1])) / max(float(peak.sum()), 1e-30))


def _score(agreeing_minutiae: float, correlation: float, support: float, overlap_mm2: float) -> float:
    """Log-likelihood ratio by both kinds of evidence, or by what there is."""
    if math.isnan(correlation):
        return _BY_SUPPORT[0] * support + _BY_SUPPORT[1] if support > 0 else _LOWEST
    if math.isnan(overlap_mm2):
        return _BY_BOTH[0] * agreeing_minutiae + _BY_BOTH[1] * correlation + _BY_BOTH[2]
    grown = correlation * math.sqrt(min(overlap_mm2, SMALL_MM2))
    if math.isnan(agreeing_minutiae):
        return _BY_OVERLAP[0] * correlation + _BY_OVERLAP[1] * grown + _BY_OVERLAP[2]
    weights = _BY_OVERLAP_AND_MINUTIAE
    return weights[0] * agreeing_minutiae + weights[1] * correlation + weights[2] * grown + weights[3]


def _bent(
    a: Prepared, b: Prepared, grid: PatchGrid, start: tuple[Affine, FloatArray | None], found: Agreement
) -> tuple[Agreement, FloatArray]:
    """Patches after their shifts were smoothed and followed, and these shifts."""
    affine, bend = start
    for _ in range(_BENDS):
        bend = bent(grid, found, bend)
        found = compare_patches(grid, a.value, a.template.valid, affine, bend)
    assert bend is not None
    return found, bend


def _best_pose(a: Prepared, b: Prepared, laid: list[Laid]) -> tuple[RidgeMatch, Affine, FloatArray]:
    """How a small B lies on A: the bent pose whose ridges agree best, for the area that they cover."""
    grid = b.close
    starts = every_pose(a, b) + [_rigid(a, b, one) for one in laid]
    found = [(compare_patches(grid, a.value, a.template.valid, one), one) for one in starts]
    tried = []
    for agreement, affine in sorted(found, key=lambda one: -one[0].evidence)[:_POSES_BENT]:
        bend = _bent(a, b, grid, (affine, None), agreement)[1]
        correlation, overlap_mm2 = overlap_correlation(grid, a.shown, b.shown, affine, bend)
        tried.append((correlation * math.sqrt(overlap_mm2), correlation, overlap_mm2, affine, bend))
    _, correlation, overlap_mm2, affine, bend = max(tried, key=lambda one: one[0])
    ridge = RidgeMatch(correlation, correlation, overlap_mm2, 0.0, 0.0, 0.0, compared=overlap_mm2 > 0)
    return ridge, affine, bend


def _rigid(a: Prepared, b: Prepared, laid: Laid) -> Affine:
    pitch, shapes = a.template.pitch_mm, (a.template.valid.shape, b.template.valid.shape)
    return rigid(*shapes, laid.angle_rad, (laid.right_mm / pitch, -laid.up_mm / pitch))


def _best_start(a: Prepared, b: Prepared, laid: list[Laid], sure: float) -> tuple[_Start, Agreement]:
    """The alignment that ridges and minutiae agree on best, and its patches."""
    proposed = bool(laid) and laid[0].support >= sure
    starts: list[_Start] = [] if proposed else [(one, None) for one in starts_by_ridges(a, b)]
    starts += [(_rigid(a, b, one), one) for one in laid]
    places = _pixels(b, _of(b)[0]) if laid else np.zeros((0, 2))
    tried = []
    for affine, by in starts:
        bend = None if by is None else _bend(a, b, b.first, by)
        found = compare_patches(b.first, a.value, a.template.valid, affine, bend)
        count = 0.0
        if laid:
            if bend is None:
                there = places @ affine[:, :2].T + affine[:, 2]
            else:
                there = shown_in_a(b.first, affine, bend, places)
            count = _minutiae_on(a, b, affine, there)[0]
        tried.append((found.evidence + _OF_MINUTIAE * count, (affine, by), found))
    _, start, found = max(tried, key=lambda one: one[0])
    return start, found


def _bend(a: Prepared, b: Prepared, grid: PatchGrid, laid: Laid) -> FloatArray:
    """Shifts that bring paired minutiae onto each other."""
    miss = (laid.b - laid.moved(laid.a)) / a.template.pitch_mm
    return bent_by(grid, _pixels(b, laid.b), np.stack([miss.real, -miss.imag], axis=1))


def _order(side: Prepared) -> tuple[bytes, bytes]:
    minutiae = side.template.minutiae
    return side.key, b"" if minutiae is None else pack_minutiae(minutiae)


def _of(side: Prepared) -> tuple[Places, NDArray[np.float64]]:
    """Places and directions of its minutiae."""
    assert side.cylinders is not None
    return side.cylinders.place, side.cylinders.turn


def _minutiae_on(a: Prepared, b: Prepared, affine: Affine, there: NDArray[np.float64]) -> tuple[float, float]:
    """How many minutiae agree where those of B lie at `there` in A, and of how many (geometric mean of both sides)."""
    turn = math.atan2(affine[1, 0] - affine[0, 1], affine[0, 0] + affine[1, 1])
    seen_b = on_ridges(a.template.valid, there)
    back = (_pixels(a, _of(a)[0]) - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T
    seen_a = on_ridges(b.template.valid, back)
    middle = (np.array(a.template.valid.shape[::-1]) - 1) / 2
    laid = (there - middle) * a.template.pitch_mm
    count = agreeing(((laid[:, 0] - 1j * laid[:, 1])[seen_b], (_of(b)[1] - turn)[seen_b]), _of(a))
    return count, math.sqrt(float(seen_a.sum()) * float(seen_b.sum()))


def _pixels(side: Prepared, place: Places) -> NDArray[np.float64]:
    """(N, 2) column and row in a template of places, mm from its middle."""
    rows, columns = side.template.valid.shape
    pitch = side.template.pitch_mm
    return np.stack([(columns - 1) / 2 + place.real / pitch, (rows - 1) / 2 - place.imag / pitch], axis=1)
