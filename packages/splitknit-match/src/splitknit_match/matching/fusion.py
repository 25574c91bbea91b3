"""Ridges and minutiae of two prints as one score: a log-likelihood ratio.

Its constants come of simulated presses; those of small prints, of windows of real ones. Both
propose how one print lies on the other; the best alignment is bent until the ridges agree, smoothly
as skin stretches, and what agrees is counted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter, mul

import numpy as np

from splitknit.findings import Finding
from splitknit.model import FloatArray
from splitknit_match.matching.coarse import every_pose, inverse, likely_alignments
from splitknit_match.matching.elastic import (
    Affine,
    Agreement,
    PatchGrid,
    Positions,
    bent,
    compare_patches,
    overlap_correlation,
    shown_in_a,
)
from splitknit_match.matching.minutia_pairs import (
    Pairing,
    agreeing,
    drifted,
    on_ridges,
    pair_minutiae,
)
from splitknit_match.matching.ridge import (
    Prepared,
    RidgeMatch,
    placed,
    prepared,
    refined,
    ridge_match,
    scored,
    turn_of,
)
from splitknit_match.matching.template import Template, scaled
from splitknit_match.records.minutiae_record import pack_minutiae


@dataclass(frozen=True, slots=True)
class _FusedMatch:
    """How similar two prints are."""

    similarity: float
    """Natural logarithm of the likelihood ratio; that of the lowest scores where neither method
    could compare."""
    minutiae: float | None
    """About how many pairs of minutiae support each other; None where a side has fewer than ten."""
    ridge: RidgeMatch
    evidence: tuple[float, float, float, float]
    """What the score is made of: agreeing minutiae over the root of those that could agree and nine
    more, correlation of the bent ridges, `minutiae`; of a small print or one without minutiae also
    the area, mm2, on which the ridges that overlap would lie two in a millimetre; NaN where there
    is none."""

    @property
    def compared(self) -> bool:
        """False where neither method could compare."""
        return self.ridge.compared or self.minutiae is not None


def can_fuse(*templates: Template) -> bool:
    """Whether all hold minutiae of a print, surfaces those of theirs."""
    return all(template.printed.minutiae is not None for template in templates)


def by_ridges(a: Template, b: Template) -> bool:
    """Whether two templates are compared by their ridges alone: two surfaces, or without
    minutiae."""
    return a.kind == b.kind == "surface" or not can_fuse(a, b)


def with_fusion(templates: Iterable[Template]) -> tuple[bool, tuple[Finding, ...]]:
    """Whether templates are compared with each other by :func:`fused_match`, and findings.

    They are if one of them is a print with minutiae. What holds none is compared by its ridges, on
    the same scale; a finding counts such templates.
    """
    each = list(templates)
    held = [can_fuse(template) for template in each]
    fused = any(template.minutiae is not None for template in each)
    if not fused or all(held):
        return fused, ()
    words = (
        f"{held.count(False)} of {len(held)} templates hold no minutiae; they"
        " were compared by their ridges alone, on the same scale."
    )
    return True, (Finding("no-minutiae", words),)


SMALL_MM2 = 100.0
"""A print that shows less is small: tried in every pose, and rated by what overlaps."""
SURE = 9.0
"""Support of an alignment by minutiae from which ridges propose none: 429 of 549 matching pairs of
real prints have it, none of the 14,000 pairs of other fingers that are most similar by minutiae.
Chosen on: real prints (validation/gallery/index.py)."""
_FEW = 9.0
"""Minutiae that are added to those that could agree, so that few of few count little."""


def fused_match(
    a: Template | Prepared, b: Template | Prepared, *, quick: bool = False
) -> _FusedMatch:
    """Compare two prints by their ridges and their minutiae; surfaces by their prints.

    Raises BadInput as :func:`splitknit_match.matching.ridge.ridge_match`.

    `a`, `b`: with minutiae, as :func:`splitknit_match.matching.inputs.print_template` makes them;
    `quick`: ridges propose no alignment, and what minutiae and ridges hardly confirm is not looked
    at closely; nothing else where the support by minutiae is :data:`SURE`.
    """
    a, b = prepared(a).printed, prepared(b).printed
    areas_mm2 = a.template.area_mm2, b.template.area_mm2
    small = 0 < min(areas_mm2) < SMALL_MM2
    by_area = small and areas_mm2[0] != areas_mm2[1]
    swapped = areas_mm2[0] < areas_mm2[1] if by_area else _order(a) > _order(b)
    left, right = (b, a) if swapped else (a, b)
    many = all(
        side.template.minutiae is not None and side.template.minutiae.acquired for side in (a, b)
    )
    pairings = []
    minutiae = None
    if (many or small) and left.cylinders is not None and right.cylinders is not None:
        pairings = pair_minutiae(left.cylinders, right.cylinders)
        minutiae = pairings[0].support if pairings else 0.0
    fraction = correlation = overlap_mm2 = math.nan
    support = math.nan if minutiae is None else minutiae
    if a.template.empty or b.template.empty:
        ridge = ridge_match(left, right)
    else:
        if small:
            best = _best_pose(left, right, pairings)
            overlap_mm2 = best.ridge.overlap_mm2
        else:
            best = _best_alignment(left, right, pairings, drift=minutiae is not None, quick=quick)
        correlation = best.correlation
        if minutiae is not None:
            count, possible = _agreeing_minutiae(left, right, best.patches, best.affine, best.bend)
            fraction = count / math.sqrt(possible + _FEW)
        elif not small:
            assert best.bend is not None
            correlation, overlap_mm2 = overlap_correlation(
                best.patches, left.band, right.band, best.affine, best.bend
            )
        ridge = placed(best.ridge, inverse(best.affine) if swapped else best.affine, a, b)
    evidence = fraction, correlation, support, _at_usual_period(overlap_mm2, a, b)
    return _FusedMatch(fused_score(*evidence), minutiae, ridge, evidence)


def _at_usual_period(overlap_mm2: float, a: Prepared, b: Prepared) -> float:
    """Area with as many ridges as the overlap, where two lie in a millimetre; NaN of NaN."""
    if math.isnan(overlap_mm2):
        return math.nan
    per_mm2 = math.exp(_log_frequency(a.template) + _log_frequency(b.template))
    return overlap_mm2 * per_mm2 / 4


_SCALES = (1.0, 0.94, 1.06, 0.88, 1.12)
"""Scales at which a photograph is tried, relative to that at which its ridges lie as far apart as
the other side's do, which is wrong by 7 % (standard deviation)."""
_MAX_LOG_SCALE = 0.15
"""Natural logarithm of the largest change of a photograph's scale that its ridges are believed."""


def fused_photo(
    a: Prepared, b: Prepared, photos: Sequence[bool], *, quick: bool = False
) -> tuple[_FusedMatch, float, int]:
    """Compare a photograph of assumed scale at several, about that at which both have the same
    distance of ridges; the best match, its scale, and which side (0, 1) has it.

    `photos`: which sides are photographs; of two, one is scaled; `quick` as of :func:`fused_match`.
    """
    a, b = a.printed, b.printed
    number = int(_order(a) > _order(b)) if all(photos) else int(photos[1])
    photo, fixed = ((a, b), (b, a))[number]
    log_scale = _log_frequency(photo.template) - _log_frequency(fixed.template)
    middle = math.exp(min(max(log_scale, -_MAX_LOG_SCALE), _MAX_LOG_SCALE))
    tried = []
    for scale in _SCALES:
        larger = Prepared(scaled(photo.template, middle * scale))
        pair = (fixed, larger) if number else (larger, fixed)
        tried.append((fused_match(*pair, quick=quick), middle * scale, number))
    return max(tried, key=lambda attempt: attempt[0].similarity)


_ONE_LOG_SCALE = 0.06
"""Natural logarithm of a difference in the distance of ridges that says nothing: pairs of one
finger have 0.03."""


def at_one_scale(a: Template, b: Template) -> tuple[Template, Template, float] | None:
    """Two prints, the one with the finer ridges enlarged until those of both lie equally far apart,
    and by how much; None where they do as they are, within 6 %."""
    finer = _log_frequency(a) - _log_frequency(b)
    if abs(finer) < _ONE_LOG_SCALE:
        return None
    scale = math.exp(abs(finer))
    return (scaled(a, scale), b, scale) if finer > 0 else (a, scaled(b, scale), scale)


_LOG_FREQUENCIES = float(np.log(1 / 0.9)), float(np.log(1 / 0.28))
"""Natural logarithms of the numbers of ridges in a millimetre between which a print's usual one is
sought."""


@lru_cache(64)
def _log_frequency(template: Template) -> float:
    """Logarithm of the usual number of ridges in a millimetre, by the power spectrum; 0 of an empty
    template."""
    if template.empty:
        return 0.0
    value = template.value()
    side = 1 << (max(value.shape) - 1).bit_length()
    power = np.square(np.abs(np.fft.rfft2(value - value.mean(), (side, side))))
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)) / template.pitch_mm
    log_frequency = np.log(np.maximum(frequency, 1e-9))
    spectrum, ends = np.histogram(log_frequency, 40, _LOG_FREQUENCIES, weights=power)
    peak = np.convolve(spectrum, (0.25, 0.5, 0.25), "same") ** 3
    middles = 0.5 * (ends[1:] + ends[:-1])
    return float(peak @ middles / max(float(peak.sum()), 1e-30))


BY_BOTH = (3.5044, 19.9267, -10.2292)
"""Logistic regression of prints that both show minutiae: weights of agreeing minutiae and of
correlation, and offset, which is also the score where nothing was compared. Both classes have equal
weight. Chosen on: simulated prints (validation/match/fvc.py --fit)."""
BY_MINUTIAE = (0.8927, -3.947)
"""Logistic regression of prints of which only minutiae could be compared: weight of the support of
their alignment, and offset. Both classes have equal weight. Chosen on: simulated prints
(validation/match/fvc.py --fit)."""
BY_OVERLAP = (6.835, 1.125, -6.028)
"""Logistic regression of prints without minutiae: weights of the correlation and of that times the
root of the area that overlaps, and offset. Both classes have equal weight. Chosen on: real prints
(windows of them, validation/match/windows.json)."""
BY_OVERLAP_AND_MINUTIAE = (4.7409, 7.7644, 0.6298, -6.2356)
"""Logistic regression of small prints: weights of agreeing minutiae, of the correlation, and of
that times the root of the area that overlaps, and offset. Both classes have equal weight. Chosen
on: real prints (windows of them, validation/match/windows.json)."""


def fused_score(
    agreeing_minutiae: float, correlation: float, support: float, overlap_mm2: float
) -> float:
    """Log-likelihood ratio by both kinds of evidence, or by what is not NaN; `overlap_mm2`: at the
    usual period."""
    if math.isnan(correlation):
        return _logit(BY_MINUTIAE, support) if support > 0 else BY_BOTH[2]
    if math.isnan(overlap_mm2):
        return _logit(BY_BOTH, agreeing_minutiae, correlation)
    over_area = correlation * math.sqrt(min(overlap_mm2, SMALL_MM2))
    if math.isnan(agreeing_minutiae):
        return _logit(BY_OVERLAP, correlation, over_area)
    return _logit(BY_OVERLAP_AND_MINUTIAE, agreeing_minutiae, correlation, over_area)


def _logit(weights: Sequence[float], *evidence: float) -> float:
    """Weighted sum and offset of a logistic regression."""
    return float(sum(map(mul, weights, evidence))) + weights[-1]


@dataclass(frozen=True, slots=True, eq=False)
class _Alignment:
    """How B lies on A, bent."""

    patches: PatchGrid
    affine: Affine
    bend: FloatArray | None
    """None where a quick comparison excludes that it is one finger."""
    correlation: float
    """Of the bent ridges."""
    ridge: RidgeMatch


_BENDS = 2
"""Times that the shifts of patches are smoothed and followed; up to 8 do as well (photographs
against simulated presses; docs/explain/tried.md)."""
_PER_MINUTIA = 0.2
"""What an agreeing minutia counts when alignments are compared, beside correlation times the root
of the patches. Chosen on: simulated presses with pulls. Range: 0.1 to 0.3."""
_MIN_EVIDENCE = 1.9
"""Of a search: prints whose alignment by minutiae has less before skin may slip are of two fingers:
of real prints 85 % of the pairs of two fingers, and of 954 matching pairs ten, of which minutiae
align two. Chosen on: real prints (the seven sets of validation/match/fvc.py)."""


def _best_alignment(
    a: Prepared, b: Prepared, pairings: list[Pairing], *, drift: bool, quick: bool
) -> _Alignment:
    """The alignment that ridges and, where they `drift`, minutiae agree on best."""

    def tried(affine: Affine, bend: FloatArray | None = None) -> tuple[float, Agreement]:
        agreement = compare_patches(b.first, a.band, affine, bend)
        count = _agreeing_minutiae(a, b, b.first, affine, bend)[0] if drift else 0.0
        return agreement.evidence + _PER_MINUTIA * count, agreement

    sure = bool(pairings) and pairings[0].support >= SURE
    quick = quick and drift and not sure
    if quick:  # where minutiae propose nothing, one lies straight on the other
        pairings = pairings[:1] or [Pairing(0.0, 0j, 0.0)]
    starts = [pairing.affine(a.band, b.band) for pairing in pairings]
    if quick:
        evidence, agreement = tried(starts[0])
        if evidence < _MIN_EVIDENCE:
            ridge = scored(a, b, b.first, agreement)
            return _Alignment(b.first, starts[0], None, agreement.mean, ridge)
    elif not sure:
        by_ridges_alone = likely_alignments(a.views, b.views)
        starts = [by_ridges_alone[0], *starts] if starts else by_ridges_alone
    laid = []
    for affine in starts:
        first, bend = _bends(a, b, affine) if drift else (None, None)
        laid.append((*tried(affine, first), affine, bend))
    _, agreement, affine, bend = max(laid, key=itemgetter(0))
    if not drift:
        affine = refined(a, b, affine, agreement)
    agreement = compare_patches(b.patches, a.band, affine, bend)
    ridge = scored(a, b, b.patches, agreement)
    agreement, bend = _followed(a, b.patches, affine, agreement, bend, times=1 if drift else _BENDS)
    return _Alignment(b.patches, affine, bend, agreement.mean, ridge)


def _best_pose(a: Prepared, b: Prepared, pairings: list[Pairing]) -> _Alignment:
    """How a small B lies on A: the bent pose whose ridges agree best, for the area that they
    cover."""
    starts = every_pose(a.views, b.views) + [pairing.affine(a.band, b.band) for pairing in pairings]
    agreements = [(compare_patches(b.close, a.band, start), start) for start in starts]
    agreements.sort(key=lambda pose: -pose[0].evidence)
    poses = []
    for agreement, affine in agreements[:3]:  # poses of a small print that are bent
        bend = _followed(a, b.close, affine, agreement)[1]
        correlation, overlap_mm2 = overlap_correlation(b.close, a.band, b.band, affine, bend)
        ridge = RidgeMatch(correlation, correlation, overlap_mm2, compared=overlap_mm2 > 0)
        poses.append(_Alignment(b.close, affine, bend, correlation, ridge))
    return max(poses, key=lambda pose: pose.correlation * math.sqrt(pose.ridge.overlap_mm2))


def _followed(
    a: Prepared,
    patches: PatchGrid,
    affine: Affine,
    agreement: Agreement,
    bend: FloatArray | None = None,
    *,
    times: int = _BENDS,
) -> tuple[Agreement, FloatArray]:
    """Patches after their shifts were smoothed and followed, and these shifts."""
    for _ in range(times):
        bend = bent(patches, agreement, bend)
        agreement = compare_patches(patches, a.band, affine, bend)
    assert bend is not None
    return agreement, bend


def _bends(a: Prepared, b: Prepared, affine: Affine) -> list[FloatArray]:
    """Smooth shifts (rows, columns, 2) of the first patches and of those for the score that bring
    minutiae onto each other where B lies so on A."""
    assert a.cylinders is not None
    assert b.cylinders is not None
    grids = b.first, b.patches
    pitch_mm = b.template.pitch_mm
    in_b, own, *centres = (
        pitch_mm * (position @ np.array([1, 1j]))
        for position in (
            _laid(a, affine),
            b.pixels(b.cylinders.place),
            *(grid.every_centre for grid in grids),
        )
    )
    turn = a.cylinders.turn + turn_of(affine)
    shifts = drifted((in_b, turn), (own, b.cylinders.turn), centres)
    return [
        (shift / pitch_mm).astype(np.float32).reshape(*grid.grid, 2)
        for grid, shift in zip(grids, shifts, strict=True)
    ]


def _laid(a: Prepared, affine: Affine) -> Positions:
    """(N, 2) columns and rows in B of A's minutiae."""
    assert a.cylinders is not None
    place = a.pixels(a.cylinders.place) - affine[:, 2]
    return place @ np.linalg.inv(affine[:, :2]).T


def _order(side: Prepared) -> tuple[bytes, bytes]:
    minutiae = side.template.minutiae
    return side.key, b"" if minutiae is None else pack_minutiae(minutiae)


def _agreeing_minutiae(
    a: Prepared, b: Prepared, patches: PatchGrid, affine: Affine, bend: FloatArray | None
) -> tuple[float, float]:
    """How many minutiae agree where B lies so on A, and of how many (geometric mean of both
    sides)."""
    assert a.cylinders is not None
    assert b.cylinders is not None
    in_a = shown_in_a(patches, affine, bend, b.pixels(b.cylinders.place))
    shown_by_a = on_ridges(a.template.valid, in_a)
    shown_by_b = on_ridges(b.template.valid, _laid(a, affine))
    offset_mm = (in_a - (np.array(a.template.valid.shape[::-1]) - 1) / 2) * a.template.pitch_mm
    place = (offset_mm[:, 0] - 1j * offset_mm[:, 1])[shown_by_a]
    count = agreeing(
        (place, (b.cylinders.turn - turn_of(affine))[shown_by_a]),
        (a.cylinders.place, a.cylinders.turn),
    )
    return count, math.sqrt(float(shown_by_a.sum()) * float(shown_by_b.sum()))
