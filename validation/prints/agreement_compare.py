"""Minutiae that were found against true ones: who is whose, and figures over fingers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]


def paired(detected: Array, true: Array, reach: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (found, true) of points (N, 2) and (M, 2), each once, no further apart than `reach`; as
    many as can be, and of these the nearest."""
    if not len(detected) or not len(true):
        empty = np.zeros(0, dtype=np.intp)
        return empty, empty
    apart = np.linalg.norm(detected[:, None] - true[None], axis=2)
    i, j = linear_sum_assignment(np.where(apart <= reach, apart, 1e3 * reach))
    good = apart[i, j] <= reach
    return i[good], j[good]


def turned(angle_a: Array, angle_b: Array) -> Array:
    """(N,) angle between directions, degrees, 0 to 180."""
    return np.abs(np.rad2deg(np.angle(np.exp(1j * (angle_a - angle_b)))))


def table(detected: dict[str, Array], true: dict[str, Array], reach: float) -> dict[str, Any]:
    """One print's record. Both sides hold ``place`` (N, 2), ``direction``, ``border`` and ``slant``
    (N,). Whoever lies outside the evaluated region may still be another's partner."""
    i, j = paired(detected["place"], true["place"], reach)
    hit = np.zeros(len(detected["place"]), int)
    met = np.zeros(len(true["place"]), int)
    hit[i], met[j] = 1, 1
    angle = np.full(len(met), np.nan)
    angle[j] = turned(detected["direction"][i], true["direction"][j])
    columns = {
        "true_met": met,
        "true_border": true["border"],
        "true_slant": true["slant"],
        "true_angle": angle,
        "found_hit": hit,
        "found_border": detected["border"],
        "found_slant": detected["slant"],
    }
    return {
        name: [None if not np.isfinite(v) else round(float(v), 3) for v in values]
        for name, values in columns.items()
    }


def counts(
    record: dict[str, Any], margin_px: float, slant: tuple[float, float] = (0.0, 90.0)
) -> dict[str, Any]:
    """True ones, those found, found ones, those that are true, and angles, inside a region."""
    col = {
        name: np.array(record[name], dtype=np.float64)
        for name in record
        if name.startswith(("true_", "found_"))
    }

    def region(side: str) -> NDArray[np.bool_]:
        where = (col[f"{side}_border"] >= margin_px) & (col[f"{side}_slant"] >= slant[0])
        return where & (col[f"{side}_slant"] < slant[1])

    true = region("true")
    detected = region("found")
    met = col["true_met"] > 0
    angles = col["true_angle"][true & met]
    return {
        "true": int(true.sum()),
        "met": int((true & met).sum()),
        "found": int(detected.sum()),
        "hit": int((detected & (col["found_hit"] > 0)).sum()),
        "angles": angles[np.isfinite(angles)],
    }


def recall_precision(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Over all minutiae of several prints."""
    angles = np.concatenate([row["angles"] for row in rows]) if rows else np.zeros(0)
    sums = {name: sum(row[name] for row in rows) for name in ("true", "met", "found", "hit")}
    median, p90 = np.percentile(angles, [50, 90]) if len(angles) else (np.nan, np.nan)
    return {
        "recall": sums["met"] / sums["true"] if sums["true"] else np.nan,
        "precision": sums["hit"] / sums["found"] if sums["found"] else np.nan,
        "direction_median_deg": float(median),
        "direction_p90_deg": float(p90),
    }


def agreed(rows: Sequence[dict[str, Any]], replicates: int = 1000, seed: int = 1) -> dict[str, Any]:
    """:func:`recall_precision` with 95 % intervals of the two fractions when fingers are drawn with
    replacement."""
    whole = recall_precision(rows)
    sums = {
        name: np.array([row[name] for row in rows], dtype=np.float64)
        for name in ("true", "met", "found", "hit")
    }
    drawn = np.random.default_rng(seed).multinomial(
        len(rows), np.full(len(rows), 1 / len(rows)), size=replicates
    )
    result: dict[str, Any] = {}
    for name, value in whole.items():
        limits: tuple[float, ...] = (np.nan, np.nan)
        if name in ("recall", "precision"):
            of, out_of = ("met", "true") if name == "recall" else ("hit", "found")
            total = drawn @ sums[out_of]
            if np.any(total > 0):
                limits = tuple(
                    np.percentile((drawn @ sums[of])[total > 0] / total[total > 0], [2.5, 97.5])
                )
        result[name] = [
            None if not np.isfinite(v) else round(float(v), 4) for v in (value, *limits)
        ]
    return result
