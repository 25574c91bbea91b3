"""Tables of ``docs/thesis-tables.md`` from the rows of this folder's CSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

FARS = ("0.01", "0.001", "0.0001")
PERCENT = {"0.01": "1 %", "0.001": "0.1 %", "0.0001": "0.01 %"}
JUDGED = {
    ("gate", "averaged", "all"): "as the thesis: gate, averaged",
    ("gate", "averaged", "whole"): "gate, averaged, whole views",
    ("gate", "averaged", "fingers"): "gate, averaged, like rolls",
    ("none", "averaged", "all"): "no gate, averaged",
    ("gate", "single", "all"): "gate, single",
    ("none", "single", "all"): "no gate, single",
    ("none", "single", "whole"): "no gate, single, whole views",
    ("none", "single", "pairs"): "no gate, single, like rolls",
    ("passing", "single", "all"): "impostors that pass, single",
    ("passing", "single", "whole"): "impostors that pass, single, whole views",
}
THESIS, PLAIN, PASSING = ("gate", "averaged", "all"), ("none", "single", "all"), ("passing", "single", "all")
THESIS_WHOLE, WHOLE = ("gate", "averaged", "whole"), ("none", "single", "whole")
SHORT = (THESIS, THESIS_WHOLE, PLAIN, WHOLE, PASSING)
ROUGH_BELOW = 10
"""False accepts behind a FAR below which a figure is marked."""
CASES = ("snk", "ea", "pr", "metric")
Row = dict[str, str]
Pick = Callable[[Row], bool]

THE_THESIS: tuple[tuple[str, str, str, str, str], ...] = (
    ("3.21", "relief, n = 3", "0.001", "90.5", "scales:snk3:relief"),
    ("5.3", "normals, relief and shape joined (SnK)", "0.01", "95.3", "fusion:snk:all three, mean"),
    ("5.4", "normals, SnK", "0.01", "92", "cases:snk:normals"),
    ("5.4", "normals, PR", "0.01", "90 (read off the plot)", "cases:pr:normals"),
    ("5.4", "normals, EA", "0.01", "86 (read off the plot)", "cases:ea:normals"),
    ("5.5", "relief, SnK", "0.01", "95", "cases:snk:relief"),
    ("5.5", "relief, SnK", "0.001", "90.5", "cases:snk:relief"),
    ("5.5", "relief, EA", "0.01", "93", "cases:ea:relief"),
    ("5.5", "relief, EA", "0.001", "78.8", "cases:ea:relief"),
)
"""Figure, what, FAR, the thesis's GAR in percent, and our row."""


def rate_table(
    rows: Sequence[Row], head: str, name: Callable[[Row], str], judged: Sequence[tuple[str, ...]] = SHORT
) -> str:
    """Rates of several trials, each judged in some ways."""
    if not rows:
        return "Not measured."
    lines = [
        f"| judged | {head} | " + " | ".join(f"GAR at FAR {PERCENT[far]}" for far in FARS) + " | EER | d' | pairs |",
        "| --- " * (len(FARS) + 5) + "|",
    ]
    for key in judged:
        for row in rows:
            if variant(row) == key and row["genuine"] not in ("", "0"):
                cells = [gar_cell(row, far) for far in FARS]
                pairs = f"{int(row['genuine']):,} / {int(row['impostors']):,}"
                lines.append(
                    f"| {JUDGED[key]} | {name(row)} | {' | '.join(cells)} | {cell(row, 'eer', 100)} | "
                    f"{cell(row, 'd_prime', 1)} | {pairs} |"
                )
    return "\n".join(lines)


def difference_table(rows: Sequence[Row], judged: Sequence[tuple[str, ...]] = SHORT) -> str:
    """First minus second in points."""
    if not rows:
        return "Not measured."
    lines = [
        "| judged | difference | " + " | ".join(f"GAR at FAR {PERCENT[far]}" for far in FARS) + " | EER |",
        "| --- " * (len(FARS) + 3) + "|",
    ]
    for key in judged:
        for row in rows:
            if variant(row) == key and row["genuine"] not in ("", "0"):
                cells = [cell(row, f"gar@{far}", 100, signed=True) for far in FARS]
                lines.append(
                    f"| {JUDGED[key]} | {row['first']} - {row['second']} | {' | '.join(cells)} | "
                    f"{cell(row, 'eer', 100, signed=True)} |"
                )
    return "\n".join(lines)


def thesis_table(tables: Mapping[str, Sequence[Row]]) -> str:
    """Beside the thesis's own numbers."""
    judged = (THESIS, THESIS_WHOLE, ("gate", "averaged", "fingers"), PLAIN, WHOLE, PASSING)
    lines = [
        "| figure | what | FAR | thesis | " + " | ".join(JUDGED[key] for key in judged) + " |",
        "| --- " * (4 + len(judged)) + "|",
    ]
    for figure, words, far, said, place in THE_THESIS:
        table, case, attribute = place.split(":")
        own = [row for row in tables[table] if (row["case"], row["attribute"]) == (case, attribute)]
        cells = [next((gar_cell(row, far) for row in own if variant(row) == key), "not measured") for key in judged]
        lines.append(f"| {figure} | {words} | {PERCENT[far]} | {said} | {' | '.join(cells)} |")
    return "\n".join(lines)


def order_table(tables: Mapping[str, Sequence[Row]], differ: Mapping[str, Sequence[Row]]) -> str:
    """Cases from the highest GAR down; ``>`` where the paired interval of the two neighbours leaves out zero."""
    systems = (
        ("thesis, normals", "cases", "thesis", "normals"),
        ("thesis, relief", "cases", "thesis", "relief"),
        ("ridge", "matchers", "ridge", ""),
        ("minutiae", "matchers", "minutiae", ""),
    )
    lines = [
        "| matcher | judged | " + " | ".join(f"FAR {PERCENT[far]}" for far in FARS) + " |",
        "| --- " * (2 + len(FARS)) + "|",
    ]
    for words, table, matcher, attribute in systems:
        for key in SHORT:

            def mine(row: Row, key: tuple[str, ...] = key, own: tuple[str, str] = (matcher, attribute)) -> bool:
                return variant(row) == key and (row["matcher"], row["attribute"]) == own

            rows, two = ([row for row in part[table] if mine(row)] for part in (tables, differ))
            if rows:
                lines.append(f"| {words} | {JUDGED[key]} | " + " | ".join(order(rows, two, far) for far in FARS) + " |")
    return "\n".join(lines) if len(lines) > 2 else "Not measured."


def order(rows: Sequence[Row], two: Sequence[Row], far: str) -> str:
    """One order, such as ``snk 95 > ea 88 = pr 88``."""
    known = sorted((row for row in rows if row.get(f"gar@{far}")), key=lambda row: -float(row[f"gar@{far}"]))
    if not known:
        return "too few impostors"
    text = f"{known[0]['case']} {_digits(100 * float(known[0][f'gar@{far}']))}"
    for better, worse in pairwise(known):
        sure = beyond_chance(two, better["case"], worse["case"], f"gar@{far}")
        text += f" {'>' if sure else '~'} {worse['case']} {_digits(100 * float(worse[f'gar@{far}']))}"
    return text + (" †" if int(known[0][f"accepts@{far}"]) < ROUGH_BELOW else "")


def beyond_chance(two: Sequence[Row], first: str, second: str, figure: str) -> bool:
    """Whether the intervals of a difference leave out zero, drawn by finger and by subject."""
    row = next(row for row in two if {row["first"], row["second"]} == {first, second})
    limits = [
        (float(row[f"{figure}_low_{way}"]), float(row[f"{figure}_high_{way}"]))
        for way in ("finger", "subject")
        if row.get(f"{figure}_low_{way}")
    ]
    return bool(limits) and all(low > 0 or high < 0 for low, high in limits)


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
    low, high = (_digits(100 * float(row[f"gar@0.01_{end}"])) for end in ("low", "high"))
    return f"{_digits(100 * float(row['gar@0.01']))} [{low}, {high}]"


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


def run_words(runs: Mapping[str, Any]) -> str:
    """From what, and how much of it."""
    lines = ["| table | genuine / impostor pairs | impostors that pass | fingers | left out | seconds |"]
    lines.append("| --- " * 6 + "|")
    parts = [(name, runs.get(name, {})) for name in ("scales", "fusion", "cases")]
    parts += [(name, runs.get("matchers", {}).get(name, {})) for name in ("ridge", "minutiae")]
    for name, part in parts:
        if "genuine" in part:
            seconds = part.get("seconds", runs.get("matchers", {}).get("seconds"))
            lines.append(
                f"| {name} | {part['genuine']:,} / {part['impostors']:,} | {part['impostors_passing_everywhere']:,} | "
                f"{part['fingers']} | {', '.join(part['missing']) or 'nothing'} | {seconds} |"
            )
    one = next(part for part in runs.values() if "population_sha256" in part)
    lines.append("")
    lines.append(
        f"Population of seed {one['population_seed']}, scale {one['population_scale']}, hash "
        f"`{one['population_sha256'][:12]}`; {one['replicates']} replicates, seed {one['seed']}."
    )
    return "\n".join(lines)


def gar_cell(row: Row, far: str) -> str:
    """A GAR with its intervals; a FAR that the impostors do not support is named, not printed."""
    accepts = int(row.get(f"accepts@{far}") or 0)
    if accepts < 1 or not row.get(f"gar@{far}"):
        return f"too few impostors ({int(row['impostors'] or 0):,})"
    return cell(row, f"gar@{far}", 100) + (" †" if accepts < ROUGH_BELOW else "")


def cell(row: Row, figure: str, factor: float, *, signed: bool = False) -> str:
    """``value [low, high] (low, high)``: drawn by finger and by subject."""
    if not row.get(figure):
        return "-"
    sign = "+" if signed else ""
    text = _digits(factor * float(row[figure]), sign)
    for way, (opening, closing) in {"finger": "[]", "subject": "()"}.items():
        limits = [row.get(f"{figure}_{end}_{way}") for end in ("low", "high")]
        if all(limits):
            text += f" {opening}{', '.join(_digits(factor * float(limit or 0), sign) for limit in limits)}{closing}"
    return text


def variant(row: Row) -> tuple[str, str, str]:
    """How a row was judged."""
    return row["gate"], row["sessions"], row["kept"]


def _digits(value: float, sign: str = "") -> str:
    return f"{value:{sign}.1f}".replace("-0.0", "0.0").replace("+0.0", "0.0")
