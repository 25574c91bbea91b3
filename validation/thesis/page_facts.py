"""Tables of ``docs/experiments/thesis-tables.md`` that hold no rates of whole systems: bins, failures, how much was
compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from page_tables import Row, digits


def sensitivity_table(rows: Sequence[Row]) -> str:
    """GAR at the thresholds of FAR 1 % and 0.1 % in each bin, one line for each case and matcher."""
    if not rows:
        return "Not measured."
    bins = list(dict.fromkeys((float(row["from"]), float(row["to"])) for row in rows))
    bins.sort()
    first = rows[0]
    counts = {
        (float(row["from"]), float(row["to"])): row["genuine"]
        for row in rows
        if (row["case"], row["matcher"], row["attribute"]) == (first["case"], first["matcher"], first["attribute"])
    }
    shown = [
        f"{low:g} to {high:g} ({counts.get((low, high), '?')})" if first["factor"] != "partial"
        else f"{low + 0.5:g} ({counts.get((low, high), '?')})"
        for low, high in bins
    ]  # fmt: skip
    lines = ["| matcher | case | " + " | ".join(shown) + " |", "| --- " * (2 + len(bins)) + "|"]
    for system in dict.fromkeys((row["matcher"], row["attribute"], row["case"]) for row in rows):
        own = {
            (float(row["from"]), float(row["to"])): row
            for row in rows
            if (row["matcher"], row["attribute"], row["case"]) == system
        }
        cells = [_bin_cell(own[key]) if key in own else "" for key in bins]
        lines.append(f"| {' '.join(system[:2]).strip()} | {system[2]} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _bin_cell(row: Row) -> str:
    if not row["gar@0.01"]:
        return "-"
    low, high = (digits(100 * float(row[f"gar@0.01_{end}"])) for end in ("low", "high"))
    return f"{digits(100 * float(row['gar@0.01']))} [{low}, {high}]"


def failures_table(rows: Sequence[Row], roll: Mapping[str, Any]) -> str:
    """Failures to acquire, and what the rules of roll discard."""
    lines = ["| case | captures | failures to acquire | of them partial views | median area, mm² |", "| --- " * 5 + "|"]
    lines += [
        f"| {row['case']} | {row['captures']} | {row['failures']} | {row['failures_partial']} of {row['partial']} | "
        f"{float(row['median_area_mm2'] or 'nan'):.0f} |"
        for row in rows
    ]
    limits = sorted(roll["fingers_discarded"], key=float)
    lines += ["", "| differ by more than | " + " | ".join(f"{limit} deg" for limit in limits) + " |"]
    lines += ["| --- " * (1 + len(limits)) + "|"]
    for words, kind, total in (
        ("fingers, between any two sessions", "fingers_discarded", roll["fingers"]),
        ("genuine pairs of captures", "pairs_discarded", roll["genuine_pairs"]),
    ):
        cells = [f"{roll[kind][limit]} of {total}" for limit in limits]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    return "\n".join(lines)


def figures_table(rows: Sequence[Row]) -> str:
    """Means over captures, with their intervals."""
    if not rows:
        return "Not measured."
    lines = ["| figure | what | mean | captures |", "| --- " * 4 + "|"]
    for row in rows:
        mean, low, high = (f"{float(row[name]):.3g}" for name in ("mean", "low", "high"))
        lines.append(f"| {row['figure']} | {row['what']} | {mean} [{low}, {high}] | {row['captures']} |")
    return "\n".join(lines)


def run_words(runs: Mapping[str, Any]) -> str:
    """From what, and how much of it."""
    lines = ["| table | genuine / impostor pairs | impostors that pass | fingers | left out | seconds |"]
    lines.append("| --- " * 6 + "|")
    parts = [(name, runs.get(name, {})) for name in ("scales", "fusion", "cases", "descriptors", "neighbours")]
    parts += [(name, runs.get("matchers", {}).get(name, {})) for name in ("ridge", "minutiae")]
    for name, part in parts:
        if "genuine" in part:
            seconds = part.get("seconds", runs.get("matchers", {}).get("seconds"))
            lines.append(
                f"| {name} | {part['genuine']:,} / {part['impostors']:,} | {part['impostors_passing_everywhere']:,} | "
                f"{part['fingers']} | {', '.join(part['missing']) or 'nothing'} | {seconds} |"
            )
    populations = dict.fromkeys(population_words(runs[name]) for name in ("cases", "failures") if name in runs)
    return "\n".join([*lines, "", *populations])


def population_words(run: Mapping[str, Any]) -> str:
    """Of what population the figures are."""
    return (
        f"Population of seed {run['population_seed']}, scale {run['population_scale']}, hash "
        f"`{run['population_sha256'][:12]}`; {run['replicates']} replicates, seed {run['seed']}."
    )
