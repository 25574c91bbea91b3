"""Ridges and minutiae of two prints as one score: a log-likelihood ratio, with constants from simulated presses.

Both propose how one print lies on the other; the best alignment is bent until the ridges agree, smoothly as skin
stretches, and what agrees there is counted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.matching.elastic import Affine, Agreement, PatchGrid, bent, bent_by, compare_patches, rigid, shown_in_a
from splitknit.matching.minutia_pairs import Laid, Places, agreeing, pair_minutiae
from splitknit.matching.minutiae_record import pack_minutiae
from splitknit.matching.ridge import Prepared, RidgeMatch, placed, refined, ridge_match, scored, starts_by_ridges
from splitknit.matching.score import prepared_sides
from splitknit.matching.template import Template
from splitknit.model import BoolArray, FloatArray

_BENDS = 2
"""Times that the shifts of patches are smoothed and followed."""
_OF_MINUTIAE = 0.1
"""What an agreeing minutia counts when alignments are compared, beside correlation times the root of the patches."""
# Slopes and offsets of logistic regressions, both classes of equal weight, on simulated presses alone: `fitted` in
# validation/match/fvc.json, made by validation/match/fvc.py --fit.
_BY_BOTH = (3.7198, 18.8171, -9.6266)
"""Of `evidence`: agreeing minutiae, correlation, offset."""
_BY_CORRELATION = (33.4765, -9.4246)
_BY_SUPPORT = (0.9498, -4.6929)
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
    evidence: tuple[float, float, float]
    """What the score is made of: agreeing minutiae over the root of those that could agree and nine more, correlation
    of the bent ridges, `minutiae`; NaN where there is none."""

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


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """One alignment that is tried."""

    affine: Affine
    """From B's places to A's."""
    laid: Laid | None = None
    """By which minutiae."""


def fused_match(a: Template | Prepared, b: Template | Prepared) -> _FusedMatch:
    """Compare two prints by their ridges and their minutiae.

    Raises BadInput as :func:`splitknit.matching.ridge.ridge_match`.

    `a`, `b`: with minutiae, as :func:`splitknit.matching.inputs.print_template` makes them.
    """
    left, right = prepared_sides(a, b, Prepared, None)
    swapped = _order(left) > _order(right)
    if swapped:
        left, right = right, left
    laid: list[Laid] = []
    score = None
    if left.cylinders is not None and right.cylinders is not None:
        laid = pair_minutiae(left.cylinders, right.cylinders)
        score = max((one.support for one in laid), default=0.0)
    support, none = math.nan if score is None else score, math.nan
    if left.template.empty or right.template.empty:
        evidence = none, none, support
        lowest = _score(0.0, 0.0, 0.0)
        return _FusedMatch(lowest if score is None else _score(*evidence), score, ridge_match(left, right), evidence)
    start, first = _best_start(left, right, laid)
    if start.laid is None:
        affine, bend = refined(left, right, start.affine, first), None
    else:
        affine, bend = start.affine, _bend(left, right, right.patches, start.laid)
    grid, value, valid = right.patches, left.value, left.template.valid
    agreement = compare_patches(grid, value, valid, affine, bend)
    found = scored(left, right, agreement)
    for _ in range(_BENDS):
        bend = bent(grid, agreement, bend)
        agreement = compare_patches(grid, value, valid, affine, bend)
    assert bend is not None
    fraction = none
    if score is not None:
        there = shown_in_a(grid, affine, bend, _pixels(right, _of(right)[0]))
        count, possible = _minutiae_on(left, right, affine, there)
        fraction = count / math.sqrt(possible + _FEW)
    if swapped:
        left, right = right, left
    evidence = fraction, agreement.mean, support
    return _FusedMatch(_score(*evidence), score, placed(found, affine, left, right, swapped), evidence)


def _score(agreeing_minutiae: float, correlation: float, support: float) -> float:
    """Log-likelihood ratio by both kinds of evidence, or by what there is."""
    if math.isnan(correlation):
        return _BY_SUPPORT[0] * support + _BY_SUPPORT[1]
    if math.isnan(agreeing_minutiae):
        return _BY_CORRELATION[0] * correlation + _BY_CORRELATION[1]
    return _BY_BOTH[0] * agreeing_minutiae + _BY_BOTH[1] * correlation + _BY_BOTH[2]


def _best_start(a: Prepared, b: Prepared, laid: list[Laid]) -> tuple[_Start, Agreement]:
    """The alignment that ridges and minutiae agree on best, and its patches."""
    starts = [_Start(one) for one in starts_by_ridges(a, b)]
    pitch, shapes = a.template.pitch_mm, (a.template.valid.shape, b.template.valid.shape)
    starts += [_Start(rigid(*shapes, one.angle_rad, (one.right_mm / pitch, -one.up_mm / pitch)), one) for one in laid]
    places = _pixels(b, _of(b)[0]) if laid else np.zeros((0, 2))
    tried = []
    for start in starts:
        bend = None if start.laid is None else _bend(a, b, b.first, start.laid)
        found = compare_patches(b.first, a.value, a.template.valid, start.affine, bend)
        count = 0.0
        if laid:
            if bend is None:
                there = places @ start.affine[:, :2].T + start.affine[:, 2]
            else:
                there = shown_in_a(b.first, start.affine, bend, places)
            count = _minutiae_on(a, b, start.affine, there)[0]
        tried.append((found.evidence + _OF_MINUTIAE * count, start, found))
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


def on_ridges(valid: BoolArray, place: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether columns and rows lie on a template's ridges."""
    columns, rows = np.rint(place).astype(np.int64).T
    inside = (rows >= 0) & (columns >= 0) & (rows < valid.shape[0]) & (columns < valid.shape[1])
    result = np.zeros(len(place), dtype=np.bool_)
    result[inside] = valid[rows[inside], columns[inside]]
    return result
