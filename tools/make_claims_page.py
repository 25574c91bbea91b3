"""Write the table and the summary of docs/experiments/claims.md from
validation/thesis/tables/claims.csv.

    python tools/make_claims_page.py            # writes
    python tools/make_claims_page.py --check    # exit code 1 if the page is out of date

A row of the CSV file has a criterion in words and as a rule, what was measured with its interval,
more that stands on the page, figures beside them and a command that do not, and a short form that
stands there if nothing is decided. The verdict follows from the rule alone: ``> 0`` is confirmed
where the whole interval lies above 0, refuted where all of it lies below, and not decided
otherwise. ``= 95`` is refuted where the interval excludes 95, ``= 19 21`` is confirmed where the
interval lies within 19 to 21. With two bounds, ``> 1.4 2.5`` compares with a figure that has an
interval itself. No rule: no figure decides.
"""

from __future__ import annotations

import argparse
import csv
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "experiments" / "claims.md"
TABLE = ROOT / "validation" / "thesis" / "tables" / "claims.csv"
UNDECIDED = "not decided"
VERDICTS = ("confirmed", "refuted", UNDECIDED)
NUMBER = r"[+-]?[\d.]+"


def interval(measured: str) -> tuple[float, float]:
    """The widest interval that `measured` states: drawn by finger, by subject, a range, or one
    exact figure."""
    bounds = [
        float(end)
        for pair in re.findall(rf"[\[(]({NUMBER})(?:, | to |-)({NUMBER})[\])]", measured)
        for end in pair
    ]
    if bounds:
        return min(bounds), max(bounds)
    exact = re.fullmatch(rf"({NUMBER}) (exactly|or more|or less)", measured)
    assert exact is not None, f"no interval: {measured}"
    value = float(exact[1])
    return (
        value if exact[2] != "or less" else -float("inf"),
        value if exact[2] != "or more" else float("inf"),
    )


def verdict(rule: str, measured: str) -> str:
    """Confirmed, refuted or not decided, by `rule` and the interval of `measured`."""
    if not rule:
        return "not decided"
    sign, *ends = rule.split()
    bounds = [float(end) for end in ends]
    low, high = interval(measured)
    if sign == "<":
        low, high, bounds, sign = -high, -low, [-end for end in bounds], ">"
    if sign == ">":
        return (
            "confirmed" if low > max(bounds) else "refuted" if high < min(bounds) else "not decided"
        )
    if len(bounds) == 2 and min(bounds) <= low and high <= max(bounds):
        return "confirmed"
    return "refuted" if high < min(bounds) or low > max(bounds) else "not decided"


def read() -> list[dict[str, str]]:
    """Rows of the table, each with its verdict."""
    with TABLE.open(encoding="utf-8", newline="") as stream:
        return [
            {**row, "verdict": verdict(row["rule"], row["measured"])}
            for row in csv.DictReader(stream)
        ]


def summary(rows: Sequence[Mapping[str, str]]) -> str:
    """How many criteria have each verdict."""
    counts = ", ".join(
        f"{sum(row['verdict'] == verdict for row in rows)} {verdict}" for verdict in VERDICTS
    )
    return f"Of {len(rows)} criteria: {counts}."


def table(rows: Sequence[Mapping[str, str]]) -> str:
    """What is decided, in Markdown: with one interval each, the widest."""
    lines = ["| claim: criterion | measured | verdict |", "| --- " * 3 + "|"]
    for row in rows:
        if row["verdict"] == UNDECIDED:
            continue
        claim = ": ".join(filter(None, (row["claim"], row["criterion"])))
        measured = "; ".join(filter(None, (row["measured"].removesuffix(" exactly"), row["more"])))
        cells = (f"{row['number']} {claim}", f"{joined(measured)}, {row['page']}", row["verdict"])
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def undecided(rows: Sequence[Mapping[str, str]]) -> str:
    """What is not decided, in short, as a list in Markdown."""
    return "\n".join(
        f"- {row['number']} {row['short']}: {joined(row['measured'])}"
        for row in rows
        if row["verdict"] == UNDECIDED
    )


def joined(measured: str) -> str:
    """Intervals drawn by finger and by subject, ``[1, 3] (2, 4)``, as one that holds both."""

    def both(intervals: re.Match[str]) -> str:
        ends = intervals.groups()
        return f"[{min(ends[::2], key=float)}, {max(ends[1::2], key=float)}]"

    return re.sub(
        rf"\[({NUMBER}), ({NUMBER})\] \(({NUMBER}), ({NUMBER})\)",
        both,
        measured,
    )


def page() -> str:
    """The page with its table and summary written anew."""
    rows, text = read(), PAGE.read_text(encoding="utf-8")
    parts = {"summary": summary(rows), "claims": table(rows), "undecided": undecided(rows)}
    for name, content in parts.items():
        first, last = f"<!-- begin {name} -->\n\n", f"\n\n<!-- end {name} -->"
        before, rest = text.split(first)
        text = f"{before}{first}{content}{last}{rest.split(last)[1]}"
    return text


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--check", action="store_true")
    text = page()
    if parser.parse_args().check:
        sys.exit(text != PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(text, encoding="utf-8")
