"""Rates by their definitions, one threshold after the other: slow, and nothing to get wrong."""

from __future__ import annotations

import math
from fractions import Fraction


def points(genuine: list[float], impostor: list[float]) -> list[tuple[float, Fraction, Fraction]]:
    """(t, FAR, FRR) for every score and infinity, rising; NaN is never accepted."""
    every = [*sorted({s for s in [*genuine, *impostor] if not math.isnan(s)}), math.inf]
    return [
        (
            t,
            Fraction(sum(s >= t for s in impostor), len(impostor)),
            1 - Fraction(sum(s >= t for s in genuine), len(genuine)),
        )
        for t in every
    ]


def gar_at_far(genuine: list[float], impostor: list[float], target: float) -> tuple[float, float]:
    """GAR and FAR where the FAR is the largest not above the target."""
    allowed = [(far, 1 - frr) for _, far, frr in points(genuine, impostor) if float(far) <= target]
    far, gar = max(allowed)
    return float(gar), float(far)


def equal_error(genuine: list[float], impostor: list[float]) -> float:
    """(FAR + FRR) / 2 at the better of the last point with FRR <= FAR and the first with FRR >=
    FAR."""
    every = points(genuine, impostor)
    before = [(far + frr) / 2 for _, far, frr in every if frr <= far]
    after = [(far + frr) / 2 for _, far, frr in every if frr >= far]
    return float(min([*before[-1:], after[0]]))


def auc(genuine: list[float], impostor: list[float]) -> float:
    """How often a genuine score wins against an impostor's, a tie being half a win."""
    wins = sum((g > i) + Fraction(g == i, 2) for g in genuine for i in impostor)
    return float(wins / (len(genuine) * len(impostor)))
