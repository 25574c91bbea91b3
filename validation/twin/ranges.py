"""The ranges that the twin should draw from, as the reference shows them, and whether it does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splitknit_simulator.light.skin import SkinRanges

PLAUSIBLE_FACTORS = (0.7, 1.4)
"""People's scattering; the extremes 0.5 and 2 are measured too but do not set the range."""


def ranges_of(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Relief gain and drift over all cases with plausible scattering, weighted by their errors, and what is covered.

    A range is from the 5th to the 95th percentile of the cases; where one case's 90 % interval reaches beyond, the
    reference does not say that it is outside.
    """
    chosen = [row for row in rows if PLAUSIBLE_FACTORS[0] <= row["factor"] <= PLAUSIBLE_FACTORS[1]]
    result: dict[str, Any] = {}
    for boundary in ("diffuse", "smooth"):
        of_kind = [row for row in chosen if row["boundary"] == boundary]
        if not of_kind:
            continue
        result[boundary] = {name: _summary(of_kind, name) for name in ("relief_gain", "drift")}
    low, high = SkinRanges().relief_gain
    outside = [
        {key: row[key] for key in ("boundary", "channel", "depth_um", "factor", "relief_gain", "relief_gain_error")}
        for row in chosen
        if row["relief_gain"] + 1.645 * row["relief_gain_error"] < low
        or row["relief_gain"] - 1.645 * row["relief_gain_error"] > high
    ]
    result["relief_gain_drawn_from"] = [low, high]
    result["cases"] = len(chosen)
    result["cases_outside"] = outside
    return result


def _summary(rows: Sequence[dict[str, Any]], name: str) -> dict[str, Any]:
    values = np.array([row[name] for row in rows])
    errors = np.array([row[name + "_error"] for row in rows])
    weight = 1.0 / np.maximum(errors, 1e-3) ** 2
    low, high = np.percentile(values, [5, 95])
    return {
        "cases": len(rows),
        "weighted_mean": float((weight * values).sum() / weight.sum()),
        "error_of_mean": float(1.0 / np.sqrt(weight.sum())),
        "low": float(low),
        "high": float(high),
        "lowest": float(values.min()),
        "highest": float(values.max()),
        "median_error_of_a_case": float(np.median(errors)),
    }
