"""The claims of ``docs/experiments/claims.md`` that the tables of a folder can answer, beside what
that page has.

python validation/thesis/claims.py FOLDER      # of run.py's tables; reproduce.py makes them
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from report import read
from tables import Row

KNOWN = Path(__file__).with_name("tables") / "claims.csv"
"""Every claim, its criteria, and what was measured: the page is made of it."""
AVERAGED = {"gate": "gate", "sessions": "averaged", "kept": "whole"}
SINGLE = {"gate": "none", "sessions": "single", "kept": "whole"}
Part = tuple[str, str, Mapping[str, str], str]
"""Words, table, what its row must have, and the figure."""


def _rate(words: str, table: str, case: str, attribute: str, far: str = "0.01") -> Part:
    return words, table, {"case": case, "matcher": "thesis", "attribute": attribute}, f"gar@{far}"


def _gain(first: str, second: str, attribute: str, far: str = "0.01") -> Part:
    wanted = {"first": first, "second": second, "attribute": attribute}
    return f"{first} - {second}", "cases_differences", wanted, f"gar@{far}"


def _figure(words: str, figure: str, what: str) -> Part:
    return words, "figures", {"figure": figure, "what": what}, "mean"


CLAIMS: Mapping[int, Sequence[Part]] = {
    1: [_rate("snk", "cases", "snk", "relief")],
    2: [_rate("snk", "cases", "snk", "relief", "0.001")],
    3: [_rate("ea", "cases", "ea", "relief"), _gain("snk", "ea", "relief")],
    4: [_gain("snk", "ea", "relief", "0.001")],
    5: [_gain("snk", "pr", "relief"), _gain("pr", "ea", "relief")],
    6: [_gain("snk", "ea-split", "relief")],
    7: [_rate(case, "cases", case, "normals") for case in ("snk", "pr", "ea")],
    8: [_gain("snk", "ea", "normals")],
    9: [_gain("pr", "ea", "normals")],
    10: [_gain("snk", "pr", "normals")],
    11: [
        _rate(words, "fusion", "snk", f"all three, {words}")
        for words in ("linear", "mean", "trained")
    ],
    12: [_rate("snk", "fusion", "snk", "shape_normals")],
    15: [_figure(f"n = {n}, %", "3.20", f"n = {n} power beside the ridges, %") for n in (3, 5)],
    18: [
        _figure(words, "3.1", f"true {words}: peak, cycles per cm") for words in ("relief", "shape")
    ],
    25: [_figure(case, "5.9", f"{case}: error between, um") for case in ("pr", "snk", "ea")],
    26: [_figure(case, "5.9", f"{case}: ridge correlation") for case in ("ea", "pr", "snk")],
    28: [_figure("NIR, um", "3.22", "NIR: shape error, um")],
    29: [
        _figure(f"{words}, um", "3.22", f"{words}: shape error, um")
        for words in ("NIR", "white", "white, enhanced")
    ],
    30: [
        _figure(words, "3.1", f"{words} images: power above 10 cycles per cm, %")
        for words in ("nir", "white")
    ],
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    names = sorted({part[1] for parts in CLAIMS.values() for part in parts})
    print(table({name: read(folder / f"{name}.csv") for name in names}, read(KNOWN)))
    return 0


def table(tables: Mapping[str, Sequence[Row]], known: Sequence[Row]) -> str:
    """Markdown: each claim, what the page has, and what these tables have in both ways of
    judging."""
    lines = [
        "| # | claim | the page | here, gate and averages | here, single comparisons |",
        "| --- " * 5 + "|",
    ]
    for number, parts in CLAIMS.items():
        rows = [row for row in known if row["number"].rstrip("abcdef") == str(number)]
        claim, measured = (
            rows[0]["claim"],
            "; ".join(dict.fromkeys(row["measured"] for row in rows)),
        )
        columns = [
            "; ".join(
                f"{words}"
                f" {cell(tables[name], wanted | (judged if name != 'figures' else {}), figure)}"
                for words, name, wanted, figure in parts
                if name != "figures" or judged is AVERAGED
            )
            for judged in (AVERAGED, SINGLE)
        ]
        lines.append(f"| {number} | {claim} | {measured} | {columns[0]} | {columns[1]} |")
    return "\n".join(lines)


def cell(rows: Sequence[Row], wanted: Mapping[str, str], figure: str) -> str:
    """The value, drawn by finger in square brackets and by subject in round ones; or why there is
    none."""
    row = next(
        (row for row in rows if all(row[key] == value for key, value in wanted.items())), None
    )
    if row is None:
        return "not measured"
    if not row[figure]:
        return "too few impostors"
    rate = figure.startswith("gar")
    ends = [
        [row.get(f"{figure}_{end}_{way}") for end in ("low", "high")]
        for way in ("finger", "subject")
    ]
    ends = ends if rate else [[row["low"], row["high"]], [None, None]]
    words = [_digits(row[figure], rate)]
    for bounds, (left, right) in zip(ends, ("[]", "()"), strict=True):
        if all(bounds):
            words.append(left + ", ".join(_digits(end, rate) for end in bounds) + right)
    return " ".join(words)


def _digits(value: str, rate: bool) -> str:
    return f"{100.0 * float(value):.1f}" if rate else f"{float(value):.3g}"


if __name__ == "__main__":
    sys.exit(main())
