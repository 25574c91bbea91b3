"""Scores of bozorth3 between prints of fingers: genuine ones against every impostor's."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.prints.minutiae import EDGE_MM
from splitknit_match.records.minutiae_record import Minutiae, unpack_minutiae

sys.path.append(str(Path(__file__).resolve().parents[1] / "match"))
from bozorth3 import bozorth3

FAR_0 = 1e-9
"""Rate that no impostor reaches."""
Records = dict[tuple[str, int], dict[str, Any]]


def between_sessions(reported: Records, preset: str, pictures: Sequence[str]) -> dict[str, Any]:
    """Genuine and impostor scores of bozorth3 between session 1 and session 2."""
    first = reported.get((preset, 1), {})
    second = reported.get((preset, 2), {})
    if not first or not second:
        return {}
    methods = list(next(iter(first.values())))
    by_picture = {
        f"{preset} {method} {picture}": told_apart(first, second, method, picture)
        for method in methods
        for picture in pictures
    }
    return {name: scores for name, scores in by_picture.items() if scores}


def told_apart(
    first: dict[str, Any], second: dict[str, Any], method: str, picture: str
) -> dict[str, Any]:
    """Fraction of genuine scores above every impostor's; all of one side against all of the
    other."""
    names = [name for name in first if name in second]
    sides = [[_minutiae(side[name][method], picture) for name in names] for side in (first, second)]
    scores = np.array([[bozorth3(a, b) for b in sides[1]] for a in sides[0]])
    if len(names) < 3:
        return {}
    same = np.eye(len(names), dtype=bool)
    largest = float(scores[~same].max())
    ids = ids_of(np.repeat(names, len(names)), names * len(names))
    pairs = Scores(ids.same, scores.ravel(), finger=ids, name=f"{method} {picture}")
    settings = BootstrapSettings(targets=(FAR_0,), curve_points=0)
    above = bootstrap(pairs, "finger", settings).figures[f"gar@{FAR_0:g}"]
    return {
        "above_all_impostors": [above.value, above.low, above.high],
        "fingers": len(names), "impostors": int((~same).sum()), "impostor_largest": largest,
        "impostor_p99": round(float(np.percentile(scores[~same], 99)), 1),
        "genuine_median": float(np.median(scores[same])),
        "genuine_smallest": float(scores[same].min()),
        "below": [n for n, own in zip(names, scores[same], strict=True) if own <= largest],
    }  # fmt: skip


def _minutiae(row: dict[str, Any], picture: str) -> Minutiae:
    """Those of the print's inside; by the phase there are others, too."""
    record = row.get(picture, {})
    minutiae = _unpacked(record.get("minutiae", ""))
    inside = np.asarray(record.get("found_border", []), dtype=np.float64) >= EDGE_MM * 500.0 / 25.4
    if picture == "phase" and minutiae.count:
        return minutiae.taken(np.flatnonzero(inside))
    return minutiae


@lru_cache(maxsize=4096)
def _unpacked(data: str) -> Minutiae:
    return unpack_minutiae(bytes.fromhex(data))
