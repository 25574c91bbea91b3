"""Tables for reading that hold no rates of whole systems: bins, failures, how much was compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from page_tables import Lines, Row, digits


def sensitivity_table(rows: Sequence[Row]) -> Lines:
    """GAR at the thresholds of FAR 1 % and 0.1 % in each bin, one line for each case and
    matcher."""
    if not rows:
        return []
    bins = list(dict.fromkeys((float(row["from"]), float(row["to"])) for row in rows))
    bins.sort()
    first = rows[0]
    counts = {
        (float(row["from"]), float(row["to"])): row["genuine"]
        for row in rows
        if (row["case"], row["matcher"], row["attribute"])
        == (first["case"], first["matcher"], first["attribute"])
    }
    headings = [
        f"{low:g} to {high:g} ({counts.get((low, high), '?')})" if first["factor"] != "partial"
        else f"{low + 0.5:g} ({counts.get((low, high), '?')})"
        for low, high in bins
    ]  # fmt: skip
    lines = [["matcher", "case", *headings]]
    for system in dict.fromkeys((row["matcher"], row["attribute"], row["case"]) for row in rows):
        own = {
            (float(row["from"]), float(row["to"])): row
            for row in rows
            if (row["matcher"], row["attribute"], row["case"]) == system
        }
        cells = [_bin_cell(own[key]) if key in own else "" for key in bins]
        lines.append([" ".join(system[:2]).strip(), system[2], *cells])
    return lines


def _bin_cell(row: Row) -> str:
    if not row["gar@0.01"]:
        return "-"
    low, high = (digits(100 * float(row[f"gar@0.01_{end}"])) for end in ("low", "high"))
    return f"{digits(100 * float(row['gar@0.01']))} [{low}, {high}]"


def failures_table(rows: Sequence[Row]) -> Lines:
    """Failures to acquire."""
    lines = [
        ["case", "captures", "failures to acquire", "of them partial views", "median area, mm²"]
    ]
    for row in rows:
        failed = f"{row['failures_partial']} of {row['partial']}"
        area = f"{float(row['median_area_mm2'] or 'nan'):.0f}"
        lines.append([row["case"], row["captures"], row["failures"], failed, area])
    return lines


def discarded_table(roll: Mapping[str, Any]) -> Lines:
    """What the rules of roll discard."""
    limits = sorted(roll["fingers_discarded"], key=float)
    lines = [["differ by more than", *(f"{limit} deg" for limit in limits)]]
    for words, kind, total in (
        ("fingers, between any two sessions", "fingers_discarded", roll["fingers"]),
        ("genuine pairs of captures", "pairs_discarded", roll["genuine_pairs"]),
    ):
        lines.append([words, *(f"{roll[kind][limit]} of {total}" for limit in limits)])
    return lines


def figures_table(rows: Sequence[Row]) -> Lines:
    """Means over captures, with their intervals."""
    if not rows:
        return []
    lines = [["figure", "what", "mean", "captures"]]
    for row in rows:
        mean, low, high = (f"{float(row[name]):.3g}" for name in ("mean", "low", "high"))
        lines.append([row["figure"], row["what"], f"{mean} [{low}, {high}]", row["captures"]])
    return lines


def run_table(runs: Mapping[str, Any]) -> Lines:
    """From what each table is, and from how much of it."""
    lines = [
        [
            "table",
            "genuine / impostor pairs",
            "impostors that pass",
            "fingers",
            "left out",
            "seconds",
            "population",
        ]
    ]
    parts = [(name, runs.get(name, {})) for name in ("scales", "fusion", "cases", "descriptors")]
    matchers = runs.get("matchers", {})
    parts += [(name, {**matchers, **matchers.get(name, {})}) for name in ("ridge", "minutiae")]
    for name, part in parts:
        if "genuine" in part:
            pairs = f"{part['genuine']:,} / {part['impostors']:,}"
            passing = f"{part['impostors_passing_everywhere']:,}"
            left = ", ".join(part["missing"]) or "nothing"
            seconds = str(part.get("seconds"))
            lines.append(
                [name, pairs, passing, str(part["fingers"]), left, seconds, population_words(part)]
            )
    return lines


def population_words(run: Mapping[str, Any]) -> str:
    """Of what population the figures are."""
    return (
        f"seed {run['population_seed']}, scale {run['population_scale']}, hash"
        f" {run['population_sha256'][:12]}; {run['replicates']} replicates, seed {run['seed']}"
    )
