"""Intervals of fractions."""

from __future__ import annotations

from scipy.stats import binomtest


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Interval of 95 % of a fraction of independent trials, by Wilson's score."""
    found = binomtest(hits, count).proportion_ci(method="wilson")
    return float(found.low), float(found.high)
