"""Tables for reading, from the rows of this folder's CSV files: report.py writes them to
``tables/``.

Each function returns the lines of one table, its head first; no lines where nothing was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

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
    ("none", "single", "printed"): "no gate, single, real prints",
    ("none", "single", "drawn"): "no gate, single, drawn prints",
    ("passing", "single", "all"): "impostors that pass, single",
    ("passing", "single", "whole"): "impostors that pass, single, whole views",
}
THESIS = ("gate", "averaged", "all")
PLAIN = ("none", "single", "all")
PASSING = ("passing", "single", "all")
THESIS_WHOLE = ("gate", "averaged", "whole")
WHOLE = ("none", "single", "whole")
LIKE_ROLLS = ("gate", "averaged", "fingers")
GATED = ("gate", "single", "all")
UNDILUTED = (THESIS, LIKE_ROLLS, GATED, PLAIN, PASSING)
"""How the population without partial views is judged."""
BY_PRINT = (THESIS, PLAIN, *(("none", "single", kept) for kept in ("printed", "drawn")))
"""How ``ridge`` and minutiae are judged: fingers with ridges of real prints and of drawn ones
apart, too."""
ROUGH_BELOW = 10
"""False accepts behind a FAR below which a figure is marked."""
Row = dict[str, str]
Lines = list[list[str]]
"""Cells of a table, its head first."""
Pick = Callable[[Row], bool]

THE_THESIS: tuple[tuple[str, str, str, str, str], ...] = (
    ("3.21", "relief, SnK, n = 3 (thesis: two sessions)", "0.001", "90.5", "scales:n = 3:relief"),
    ("5.3", "normals, relief and shape joined (SnK)", "0.01", "95.3", "fusion:snk:all three, mean"),
    ("5.4", "normals, SnK", "0.01", "92", "cases:snk:normals"),
    ("5.4", "normals, PR", "0.01", "90 (plot)", "cases:pr:normals"),
    ("5.4", "normals, EA", "0.01", "86 (plot)", "cases:ea:normals"),
    ("5.4", "normals, metric", "0.01", "-", "cases:metric:normals"),
    ("5.5", "relief, SnK", "0.01", "95", "cases:snk:relief"),
    ("5.5", "relief, SnK", "0.001", "90.5", "cases:snk:relief"),
    ("5.5", "height, PR", "0.01", "-", "cases:pr:relief"),
    ("5.5", "height, PR", "0.001", "-", "cases:pr:relief"),
    ("5.5", "height, EA", "0.01", "93", "cases:ea:relief"),
    ("5.5", "height, EA", "0.001", "78.8", "cases:ea:relief"),
    ("5.5", "relief, EA split by shapelets", "0.01", "-", "cases:ea-split:relief"),
    ("5.5", "relief, EA split by shapelets", "0.001", "-", "cases:ea-split:relief"),
    ("5.5", "relief, metric", "0.01", "-", "cases:metric:relief"),
)
"""Figure, what, FAR, the thesis's GAR in percent, and our row."""


def rate_table(
    rows: Sequence[Row], head: str, name: Callable[[Row], str], judged: Sequence[tuple[str, ...]]
) -> Lines:
    """Rates of several trials, each judged in some ways."""
    if not rows:
        return []
    lines = [
        ["judged", head, *(f"GAR at FAR {PERCENT[far]}" for far in FARS), "EER", "d'", "pairs"]
    ]
    for key in judged:
        for row in compared(rows, key):
            cells = [gar_cell(row, far) for far in FARS]
            pairs = f"{int(row['genuine']):,} / {int(row['impostors']):,}"
            lines.append(
                [
                    JUDGED[key],
                    name(row),
                    *cells,
                    cell(row, "eer", 100),
                    cell(row, "d_prime", 1),
                    pairs,
                ]
            )
    return lines


def difference_table(rows: Sequence[Row], judged: Sequence[tuple[str, ...]]) -> Lines:
    """First minus second in points."""
    if not rows:
        return []
    lines = [["judged", "difference", *(f"GAR at FAR {PERCENT[far]}" for far in FARS), "EER", "d'"]]
    for key in judged:
        for row in compared(rows, key):
            cells = [cell(row, f"gar@{far}", 100, signed=True) for far in FARS]
            cells += [cell(row, "eer", 100, signed=True), cell(row, "d_prime", 1, signed=True)]
            lines.append([JUDGED[key], f"{row['first']} - {row['second']}", *cells])
    return lines


def thesis_table(
    tables: Mapping[str, Sequence[Row]], judged: Sequence[tuple[str, ...]] = UNDILUTED
) -> Lines:
    """Beside the thesis's own numbers."""
    lines = [
        ["figure", "what", "FAR", "thesis", "impostor pairs", *(JUDGED[key] for key in judged)]
    ]
    for figure, words, far, published, place in THE_THESIS:
        table, case, attribute = place.split(":")
        own = [row for row in tables[table] if (row["case"], row["attribute"]) == (case, attribute)]
        cells = [
            next((gar_cell(row, far) for row in own if variant(row) == key), "not measured")
            for key in judged
        ]
        counts = [
            f"{int(row['impostors']):,}"
            for key in (GATED, PLAIN)
            for row in own
            if variant(row) == key
        ]
        pairs = " / ".join(dict.fromkeys(counts)) or "none"
        lines.append([figure, words, PERCENT[far], published, pairs, *cells])
    return lines


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
    text = digits(factor * float(row[figure]), sign)
    for way, (opening, closing) in {"finger": "[]", "subject": "()"}.items():
        limits = [row.get(f"{figure}_{end}_{way}") for end in ("low", "high")]
        if all(limits):
            ends = ", ".join(digits(factor * float(limit or 0), sign) for limit in limits)
            text += f" {opening}{ends}{closing}"
    return text


def variant(row: Row) -> tuple[str, str, str]:
    """How a row was judged."""
    return row["gate"], row["sessions"], row["kept"]


def compared(rows: Sequence[Row], key: tuple[str, ...]) -> list[Row]:
    """Rows judged in one way, without those that had no pairs to judge."""
    return [row for row in rows if variant(row) == key and row["genuine"] not in ("", "0")]


def digits(value: float, sign: str = "") -> str:
    return f"{value:{sign}.1f}".replace("-0.0", "0.0").replace("+0.0", "0.0")


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


def figures_table(rows: Sequence[Row]) -> Lines:
    """Means over captures, with their intervals."""
    if not rows:
        return []
    lines = [["figure", "what", "mean", "captures"]]
    for row in rows:
        mean, low, high = (f"{float(row[name]):.3g}" for name in ("mean", "low", "high"))
        lines.append([row["figure"], row["what"], f"{mean} [{low}, {high}]", row["captures"]])
    return lines
