"""Write the table and the summary of docs/experiments/claims.md from
validation/thesis/tables/claims.csv.

    python tools/make_claims_page.py            # writes
    python tools/make_claims_page.py --check    # exit code 1 if the page is out of date

A row of the CSV file has a criterion in words and as a rule, what was measured with its interval,
more that stands on the page, the same at FAR 0.1 %, a qualifier of the verdict, figures beside
them and a command that do not, a sentence why the criterion follows from the thesis, and a short
form that stands there if nothing is decided. The verdict follows from the rule alone: ``> 0`` is
confirmed where the whole interval lies above 0, refuted where all of it lies below, and not decided
otherwise. ``= 95`` is refuted where the interval excludes 95, ``= 19 21`` is confirmed where the
interval lies within 19 to 21. With two bounds, ``> 1.4 2.5`` compares with a figure that has an
interval itself. No rule: no figure decides.
"""

from __future__ import annotations

import argparse
import csv
import html
import itertools
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "experiments" / "claims.md"
TABLE = ROOT / "validation" / "thesis" / "tables" / "claims.csv"
FIGURE = ROOT / "validation" / "thesis" / "claims.svg"
AXIS_PX = 440.0
"""Where 0 lies in the figure. Source: room for the words beside it."""
PX_PER_POINT = 3.0
"""Scale of the figure. Source: 100 points fit the page."""
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
    counts = (f"{sum(row['verdict'] == word for row in rows)} {word}" for word in VERDICTS)
    return f"Of {len(rows)} criteria: {', '.join(counts)}."


def table(rows: Sequence[Mapping[str, str]]) -> str:
    """One row a claim in Markdown, its criteria below each other, with one interval each, the
    widest."""
    lines = ["| claim: criterion | measured | verdict |", "| --- " * 3 + "|"]
    for _, criteria in itertools.groupby(rows, lambda row: row["number"].rstrip("abcde")):
        cells = zip(*map(criterion_cells, criteria), strict=True)
        lines.append(f"| {' | '.join(map('<br>'.join, cells))} |")
    return "\n".join(lines)


def criterion_cells(row: Mapping[str, str]) -> tuple[str, str, str]:
    """A criterion in words, what was measured, and the verdict; in short where nothing is
    decided."""
    words = ": ".join(filter(None, (row["claim"], row["criterion"])))
    measured = [row["measured"].removesuffix(" exactly"), row["more"]]
    at_01 = f"FAR 0.1 % {row['at_far_01']}" if row["at_far_01"] else ""
    if row["verdict"] == UNDECIDED:
        words, measured, page = row["short"], measured[:1], ""
    else:
        page = row["page"]
    figures = "; ".join(filter(None, (*measured, at_01)))
    verdict_shown = "undecided" if row["verdict"] == UNDECIDED else row["verdict"]
    qualified = f"{verdict_shown}, {row['qualifier']}" if row["qualifier"] else verdict_shown
    return f"{row['number']} {words}", ", ".join(filter(None, (joined(figures), page))), qualified


def figure(rows: Sequence[Mapping[str, str]]) -> str:
    """Published figures (rules ``= x``) against measured ones with their intervals, as SVG."""
    compared = [row for row in rows if re.fullmatch(r"= [\d.]+", row["rule"])]
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 {24 * len(compared) + 50}"'
        ' font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>'
    ]
    for k, row in enumerate(compared):
        y = 24 * k + 20
        low, high = (AXIS_PX + PX_PER_POINT * end for end in interval(row["measured"]))
        published = AXIS_PX + PX_PER_POINT * float(row["rule"].split()[1])
        measured = AXIS_PX + PX_PER_POINT * float(row["measured"].split()[0])
        words = html.escape(row["short"] or row["claim"].removeprefix("... "))
        lines += [
            f'<text x="8" y="{y + 4}">{row["number"]} {words}</text>',
            f'<line x1="{low:.0f}" x2="{high:.0f}" y1="{y}" y2="{y}" stroke="#0072B2"'
            ' stroke-width="3"/>',
            f'<circle cx="{measured:.0f}" cy="{y}" r="5" fill="#0072B2"/>',
            f'<path d="M{published:.0f} {y - 8}v16" stroke="#D55E00" stroke-width="3"/>',
        ]
    y = 24 * len(compared) + 20
    for points in range(0, 101, 20):
        x = AXIS_PX + PX_PER_POINT * points
        lines.append(f'<text x="{x:.0f}" y="{y + 4}" text-anchor="middle">{points}</text>')
    legend = "percent, or points of a gain; bar: published, dot and line: measured, 95 %"
    lines.append(f'<text x="8" y="{y + 22}">{legend}</text></svg>')
    return "\n".join(lines) + "\n"


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
    parts = {"summary": summary(rows), "claims": table(rows)}
    for name, content in parts.items():
        first, last = f"<!-- begin {name} -->\n\n", f"\n\n<!-- end {name} -->"
        before, rest = text.split(first)
        text = f"{before}{first}{content}{last}{rest.split(last)[1]}"
    return text


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--check", action="store_true")
    texts = {PAGE: page(), FIGURE: figure(read())}
    if parser.parse_args().check:
        sys.exit(any(text != file.read_text(encoding="utf-8") for file, text in texts.items()))
    for file, text in texts.items():
        file.write_text(text, encoding="utf-8")
