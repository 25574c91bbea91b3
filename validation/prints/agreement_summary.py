"""The figures of ``agreement.json`` from the records of single captures."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from agreement_compare import agreed, by_finger, counts, recall_precision
from agreement_scores import between_sessions, told_apart

MARGIN_PX = 13.0
"""0.66 mm, one and a half ridge periods: how far inside the print's border minutiae are judged."""
PICTURES = ("print", "enhanced", "phase")
"""mindtct on ``print.png``, mindtct on ``enhanced.png``, turns of the phase."""
FACING_DEG = 60.0
"""Skin that is steeper is judged with the rest, and the rest without it as well."""
SLANTS = (0.0, 30.0, 50.0, 60.0, 70.0)
MARGINS = (13.0, 20.0, 30.0)
QUALITIES = tuple(range(0, 100, 5))
Records = dict[tuple[str, int], dict[str, Any]]


def summary(reported: Records, choosing: Records) -> dict[str, Any]:
    """All figures; what was not measured is left out."""
    facts: dict[str, Any] = {
        "margin_px": MARGIN_PX,
        "fingers": {f"{preset} {session}": len(rows) for (preset, session), rows in reported.items()},
        "minutiae": agreement(reported),
    }
    facts["reasons"] = {
        f"{preset} {method}": reasons(rows, method)
        for (preset, session), rows in reported.items()
        if session == 1 and preset in ("metric", "truth")
        for method in ("relief", "unroll")
    }
    facts["held"] = {
        f"{preset} {method}": held(rows, method)
        for (preset, session), rows in reported.items()
        if session == 1 and preset != "pressed"
        for method in next(iter(rows.values()))
        if all("refused" not in row[method] for row in rows.values())
    }
    if ("metric", 1) in reported and ("truth", 1) in reported:
        facts["lost"] = {m: lost(reported["metric", 1], reported["truth", 1], m) for m in ("relief", "unroll")}
        facts["nfiq2"] = quality(reported["metric", 1], reported["truth", 1])
    if ("metric", 1) in choosing:
        facts["threshold"] = thresholds(choosing["metric", 1], reported.get(("metric", 1), {}))
    facts["bozorth3"] = {
        name: found
        for preset in ("metric", "snk", "pr-split", "ea-split")
        for name, found in between_sessions(reported, preset, PICTURES).items()
    }
    if ("pressed", 1) in reported and ("metric", 1) in reported:
        facts["cross_modal"] = {
            f"{method} {picture} against pressed": found
            for method in ("relief", "unroll", "curvature", "photo")
            for picture in PICTURES
            if (found := told_apart(reported["metric", 1], reported["pressed", 1], (method, picture), (None, "print")))
        }
        rows = list(reported["pressed", 1].values())
        facts["pressed"] = {
            "area_mm2_median": round(float(np.median([row["area_mm2"] for row in rows])), 1),
            "nfiq2_median": float(np.median([row["nfiq2"] for row in rows])),
        }
    return facts


def agreement(reported: Records) -> dict[str, Any]:
    """Recall, precision and directions, by preset, method and picture, session 1."""
    table = {}
    for (preset, session), rows in reported.items():
        if session != 1:
            continue
        methods = [""] if preset == "pressed" else list(next(iter(rows.values())))
        for method in methods:
            whole = [row[method] if method else row for row in rows.values()]
            good = [row for row in whole if "refused" not in row]
            for picture in PICTURES:
                items = [counts(row[picture], MARGIN_PX) for row in good if picture in row]
                if items:
                    name = " ".join(filter(None, [preset, method, picture]))
                    sums = {k: sum(item[k] for item in items) for k in ("true", "found")}
                    flat = [counts(row[picture], MARGIN_PX, (0.0, FACING_DEG)) for row in good if picture in row]
                    table[name] = agreed(items) | sums | {"refused": len(whole) - len(good)}
                    table[name]["below_60_deg"] = agreed(flat)
    return table


def reasons(rows: dict[str, Any], method: str) -> dict[str, Any]:
    """Where recall and precision are lost: by slant, by margin, by company, by what lies near a false one."""
    prints = [row[method]["print"] for row in rows.values() if "refused" not in row[method]]
    found: dict[str, Any] = {}
    for low, high in pairwise(SLANTS):
        items = [counts(one, MARGIN_PX, (low, high)) for one in prints]
        found[f"slant {low:g} to {high:g} deg"] = agreed(items)
    for margin in MARGINS:
        items = [counts(one, margin, (0.0, 60.0)) for one in prints]
        found[f"slant below 60 deg, {margin:g} px inside"] = agreed(items)
    true, wrong = _inside(prints, "true"), _inside(prints, "found")
    met, gap, height = (true[name] for name in ("met", "gap", "crease"))
    for name, where in (
        ("with another true one within 1 period", gap < 1.0),
        ("within 1 to 2 periods", (gap >= 1.0) & (gap < 2.0)),
        ("alone for 2 periods", gap >= 2.0),
        ("within 2 mm of the crease", np.abs(height) < 2.0),
        ("beyond 2 mm of it", np.abs(height) >= 2.0),
    ):
        found[f"true ones {name}"] = {
            "share": _fraction(where), "recall": _fraction(met[where] > 0), "count": int(where.sum()),
        }  # fmt: skip
    false = wrong["hit"] == 0
    near, away = wrong["near"][false], wrong["away"][false]
    found["false ones"] = {
        "count": int(false.sum()),
        "half to one period from a true one": _fraction(near < 1.0),
        "one to two periods from a true one": _fraction((near >= 1.0) & (near < 2.0)),
        "within one period of another found one": _fraction(away < 1.0),
        "within 2 mm of the crease": _fraction(np.abs(wrong["crease"][false]) < 2.0),
        "steeper than 60 deg": _fraction(wrong["slant"][false] >= 60.0),
    }
    return found


def _inside(prints: list[dict[str, Any]], side: str) -> dict[str, np.ndarray]:
    names = [name for name in prints[0] if name.startswith(f"{side}_")] if prints else []
    names = [name for name in names if name != "true_index"]
    columns = {
        name.removeprefix(f"{side}_"): np.concatenate([np.array(one[name], dtype=np.float64) for one in prints])
        for name in names
    }
    there = columns["border"] >= MARGIN_PX
    return {name: values[there] for name, values in columns.items()}


def _fraction(where: np.ndarray) -> float | None:
    return round(float(np.mean(where)), 4) if len(where) else None


def lost(metric: dict[str, Any], truth: dict[str, Any], method: str) -> dict[str, Any]:
    """Of the true minutiae on both prints: found on which. What the extractor misses on the true relief is its own."""
    both = {"both": 0, "print's loss": 0, "extractor's loss": 0, "only on ours": 0}
    for finger in metric.keys() & truth.keys():
        sides = [
            {k: m for k, m, b in zip(one["true_index"], one["true_met"], one["true_border"], strict=True)
             if b >= MARGIN_PX}
            for one in (metric[finger][method]["print"], truth[finger][method]["print"])
        ]  # fmt: skip
        for k in sides[0].keys() & sides[1].keys():
            name = {(1, 1): "both", (0, 1): "print's loss", (0, 0): "extractor's loss", (1, 0): "only on ours"}
            both[name[int(sides[0][k]), int(sides[1][k])]] += 1
    total = max(1, sum(both.values()))
    return {name: round(count / total, 4) for name, count in both.items()} | {"minutiae": total}


def held(rows: dict[str, Any], method: str) -> dict[str, Any]:
    """Of the true minutiae on the prints: those that mindtct finds, those that only the phase shows, and the rest."""
    sums = {"found by mindtct": 0, "missed by it, shown by the phase": 0, "shown by neither": 0}
    for row in rows.values():
        one, other = row[method]["print"], row[method]["phase"]
        for met, shown, border in zip(one["true_met"], other["true_met"], one["true_border"], strict=True):
            if border >= MARGIN_PX:
                sums[list(sums)[0 if met else 1 if shown else 2]] += 1
    total = max(1, sum(sums.values()))
    return {name: round(count / total, 4) for name, count in sums.items()} | {"minutiae": total}


def quality(metric: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """NFIQ 2 of our prints, and minus that of the true relief's own."""
    found = {}
    for method in ("relief", "unroll"):
        pairs = [
            (metric[finger][method]["nfiq2"], truth[finger][method]["nfiq2"])
            for finger in metric if finger in truth and "nfiq2" in metric[finger][method]
        ]  # fmt: skip
        off = [a - b for a, b in pairs if max(a, b) <= 100]
        found[method] = by_finger(off, lambda some: {"median_difference": float(np.median(some))}) | {
            "median": float(np.median([a for a, _ in pairs])),
            "median_of_true_relief": float(np.median([b for _, b in pairs])),
            "median_size_of_difference": float(np.median(np.abs(off))),
            "fingers": len(off),
        }
    return found


def thresholds(choosing: dict[str, Any], reported: dict[str, Any]) -> dict[str, Any]:
    """Least quality of a minutia that makes the smaller of recall and precision largest, chosen and then reported."""
    result = {}
    for method in ("relief", "unroll"):
        for picture in PICTURES:

            def at(rows: dict[str, Any], least: float, method: str = method, picture: str = picture) -> list[Any]:
                return [counts(row[method][picture], MARGIN_PX, quality=least) for row in rows.values()]

            def worth(least: float, at: Callable[..., list[Any]] = at) -> float:
                figures = recall_precision(at(choosing, least))
                return min(figures["recall"], figures["precision"])

            best = max(QUALITIES, key=worth)
            result[f"{method} {picture}"] = {
                "quality": best,
                "on those it was chosen on": round(worth(best), 4),
                "without it": round(worth(0), 4),
            } | (agreed(at(reported, best)) if reported else {})
    return result
