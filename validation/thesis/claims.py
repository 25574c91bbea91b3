"""The claims of ``docs/experiments/claims.md`` that the tables of a run can answer: reproduce.py
shows them beside what that page has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tables import Row

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
