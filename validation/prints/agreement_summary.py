"""The figures of ``agreement.json`` from the records of single captures."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from agreement_compare import agreed, by_finger, counts
from agreement_scores import between_sessions

MARGIN_PX = 13.0
"""0.66 mm, one and a half ridge periods: how far inside the print's border minutiae are judged."""
PICTURES = ("print", "enhanced", "phase")
"""mindtct on ``print.png``, mindtct on ``enhanced.png``, turns of the phase."""
FACING_DEG = 60.0
"""Skin that is steeper is judged with the rest, and the rest without it as well."""
SLANTS = (0.0, 30.0, 50.0, 60.0, 70.0)
Records = dict[tuple[str, int], dict[str, Any]]


def summary(reported: Records) -> dict[str, Any]:
    """All figures; what was not measured is left out."""
    first = {preset: rows for (preset, session), rows in reported.items() if session == 1}
    facts: dict[str, Any] = {
        "margin_px": MARGIN_PX,
        "fingers": {
            f"{preset} {session}": len(rows) for (preset, session), rows in reported.items()
        },
        "minutiae": agreement(first),
    }
    facts["reasons"] = {
        f"{preset} {method}": by_slant(first[preset], method)
        for preset in ("metric", "truth")
        if preset in first
        for method in ("relief", "unroll")
    }
    facts["held"] = {
        f"{preset} {method}": held(rows, method)
        for preset, rows in first.items()
        for method in next(iter(rows.values()))
        if all("refused" not in row[method] for row in rows.values())
    }
    if "metric" in first and "truth" in first:
        facts["nfiq2"] = quality(first["metric"], first["truth"])
    facts["bozorth3"] = {
        name: scores
        for preset in ("metric", "snk", "pr-split", "ea-split")
        for name, scores in between_sessions(reported, preset, PICTURES).items()
    }
    return facts


def agreement(first: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Recall, precision and directions, by preset, method and picture."""
    table = {}
    for preset, rows in first.items():
        for method in next(iter(rows.values())):
            whole = [row[method] for row in rows.values()]
            good = [row for row in whole if "refused" not in row]
            for picture in PICTURES:
                items = [counts(row[picture], MARGIN_PX) for row in good if picture in row]
                if items:
                    sums = {k: sum(item[k] for item in items) for k in ("true", "found")}
                    flat = [
                        counts(row[picture], MARGIN_PX, (0.0, FACING_DEG))
                        for row in good
                        if picture in row
                    ]
                    refused = {"refused": len(whole) - len(good)}
                    table[f"{preset} {method} {picture}"] = agreed(items) | sums | refused
                    table[f"{preset} {method} {picture}"]["below_60_deg"] = agreed(flat)
    return table


def by_slant(rows: dict[str, Any], method: str) -> dict[str, Any]:
    """Where recall and precision are lost."""
    prints = [row[method]["print"] for row in rows.values() if "refused" not in row[method]]
    return {
        f"slant {low:g} to {high:g} deg": agreed(
            [counts(record, MARGIN_PX, (low, high)) for record in prints]
        )
        for low, high in pairwise(SLANTS)
    }


def held(rows: dict[str, Any], method: str) -> dict[str, Any]:
    """Of the true minutiae on the prints: those that mindtct finds, those that only the phase
    shows, and the rest."""
    sums = {"found by mindtct": 0, "missed by it, shown by the phase": 0, "shown by neither": 0}
    for row in rows.values():
        by_mindtct, by_phase = row[method]["print"], row[method]["phase"]
        for met, in_phase, border in zip(
            by_mindtct["true_met"], by_phase["true_met"], by_mindtct["true_border"], strict=True
        ):
            if border >= MARGIN_PX:
                sums[list(sums)[0 if met else 1 if in_phase else 2]] += 1
    total = max(1, sum(sums.values()))
    return {name: round(count / total, 4) for name, count in sums.items()} | {"minutiae": total}


def quality(metric: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """NFIQ 2 of our prints, and minus that of the true relief's own."""
    by_method = {}
    for method in ("relief", "unroll"):
        pairs = [
            (metric[finger][method]["nfiq2"], truth[finger][method]["nfiq2"])
            for finger in metric if finger in truth and "nfiq2" in metric[finger][method]
        ]  # fmt: skip
        off = [a - b for a, b in pairs if max(a, b) <= 100]
        by_method[method] = by_finger(
            off, lambda differences: {"median_difference": float(np.median(differences))}
        ) | {
            "median": float(np.median([a for a, _ in pairs])),
            "median_of_true_relief": float(np.median([b for _, b in pairs])),
            "median_size_of_difference": float(np.median(np.abs(off))),
            "fingers": len(off),
        }
    return by_method
