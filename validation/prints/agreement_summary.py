"""The figures of ``agreement.json`` from the records of single captures."""

from __future__ import annotations

from typing import Any

from agreement_compare import agreed, counts
from agreement_scores import between_sessions

MARGIN_PX = 13.0
"""0.66 mm, one and a half ridge periods: how far inside the print's border minutiae are judged."""
PICTURES = ("print", "enhanced", "phase")
"""mindtct on ``print.png``, mindtct on ``enhanced.png``, turns of the phase."""
FACING_DEG = 60.0
"""Skin that is steeper is judged with the rest, and the rest without it as well."""
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
