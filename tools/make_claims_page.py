"""Write the tables and the summary of docs/experiments/claims.md from
validation/thesis/tables/claims.csv.

    python tools/make_claims_page.py            # writes
    python tools/make_claims_page.py --check    # exit code 1 if the page is out of date

A row of the CSV file is one criterion: the thesis's section, his sentence in our words, the
criterion in words and as a rule, what was measured with its interval and on how many simulated
fingers or what else (`on`), a note that stands beside it,
a qualifier of the verdict, where the figures stand (the first place is linked), figures beside them
and a command that do not stand on the page, and a sentence why the criterion follows from the
thesis. The verdict follows from the rule alone:

- ``> 0`` is confirmed where the whole interval lies above 0, refuted where all of it lies below;
  with a margin, ``> 0 ~ 2``, it is equal where the interval lies within 2 of 0; else undecided;
- ``> 1.4 2.5`` compares with a figure that has an interval itself;
- ``= 95`` is consistent where the interval holds 95, else refuted;
- ``= 19 21`` is confirmed where the interval lies within 19 to 21, refuted where it lies outside;
- no rule: no figure decides.

An interval without width, of `fingers` of which none changed, is the rule of three's: 3 of
`fingers` may change unseen. Without fingers it is half of the last digit.
"""

from __future__ import annotations

import argparse
import csv
import html
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "experiments" / "claims.md"
TABLE = ROOT / "validation" / "thesis" / "tables" / "claims.csv"
FIGURE = ROOT / "validation" / "thesis" / "claims.svg"
SECTIONS = {
    1: "Recognition by ridges",
    7: "Recognition by normals",
    11: "Combinations, scales, features",
    18: "Light and ridges",
    24: "Surface",
    33: "Rig",
    43: "Prints",
    47: "Other techniques and skin",
}
"""Number of the first claim of each table of the page, and its heading."""
AXIS_PX = 480.0
"""Where 0 lies in the figure. Source: room for the words beside it."""
PX_PER_POINT = 2.6
"""Scale of the figure. Source: 100 points fit the page."""
UNDECIDED = "undecided"
VERDICTS = ("confirmed", "refuted", "consistent", "equal", UNDECIDED)
NUMBER = r"[+-]?[\d.]+"
Row = Mapping[str, str]


def interval(measured: str, fingers: str = "") -> tuple[float, float]:
    """The widest interval that `measured` states: drawn by finger, by subject, a range, or one
    exact figure."""
    bounds = [
        float(end)
        for pair in re.findall(rf"[\[(]({NUMBER})(?:, | to |-)({NUMBER})[\])]", measured)
        for end in pair
    ]
    if bounds:
        reach = without_width(measured, fingers) if min(bounds) == max(bounds) else 0.0
        return min(bounds) - reach, max(bounds) + reach
    exact = re.fullmatch(rf"({NUMBER}) exactly", measured)
    assert exact is not None, f"no interval: {measured}"
    return float(exact[1]), float(exact[1])


def without_width(measured: str, fingers: str) -> float:
    """How far an interval of one point reaches: the rule of three, or half of the last digit."""
    if fingers:
        return round(300.0 / int(fingers), 1)
    return 0.5 * 10.0 ** -len(measured.partition(" ")[0].partition(".")[2])


def verdict(rule: str, measured: str, fingers: str = "") -> str:
    """One of :data:`VERDICTS`, by `rule` and the interval of `measured`; ``equal within 1.8`` says
    how far apart the two may be."""
    if not rule:
        return UNDECIDED
    criterion, _, margin = rule.partition(" ~ ")
    sign, *ends = criterion.split()
    bounds = [float(end) for end in ends]
    low, high = interval(measured, fingers)
    if sign == "=":
        inside = min(bounds) <= low and high <= max(bounds)
        outside = high < min(bounds) or low > max(bounds)
        if len(bounds) == 1:
            return "refuted" if outside else "consistent"
        return "confirmed" if inside else "refuted" if outside else UNDECIDED
    if sign == "<":
        low, high, bounds = -high, -low, [-end for end in bounds]
    if low > max(bounds):
        return "confirmed"
    if high < min(bounds):
        return "refuted"
    farthest = max(abs(low - bounds[0]), abs(high - bounds[0]))
    return f"equal within {farthest:g}" if margin and farthest <= float(margin) else UNDECIDED


def read() -> list[dict[str, str]]:
    """Rows of the table, each with its verdict."""
    with TABLE.open(encoding="utf-8", newline="") as stream:
        return [
            {**row, "verdict": verdict(row["rule"], row["measured"], row["fingers"])}
            for row in csv.DictReader(stream)
        ]


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """How many criteria have each verdict."""
    words = [verdict(row["rule"], row["measured"], row["fingers"]).split()[0] for row in rows]
    return {word: words.count(word) for word in VERDICTS}


def counted(rows: Sequence[Row]) -> str:
    """The counts as words, those that are there."""
    return ", ".join(f"{count} {word}" for word, count in counts(rows).items() if count)


def summary(rows: Sequence[Row]) -> str:
    """How many criteria have each verdict; circular ones and those that are not his apart."""
    parts = [
        (words, [row for row in rows if row["qualifier"] == qualifier])
        for words, qualifier in (
            ("Criteria of the thesis's claims", ""),
            ("circular", "circular"),
            ("not his", "not his"),
        )
    ]
    lines = [f"{words}, {len(chosen)}: {counted(chosen)}" for words, chosen in parts]
    return f"**{lines[0]}.** Counted apart: {'; '.join(lines[1:])}."


def tables(rows: Sequence[Row]) -> str:
    """One table for each of :data:`SECTIONS`, one criterion a row."""
    lines = []
    for first, heading in SECTIONS.items():
        lines += ["", f"## {heading}", "", "|#|the thesis (section)|criterion|measured|on|verdict|"]
        lines += ["|---|---|---|---|---|---|"]
        lines += [f"|{'|'.join(cells(row))}|" for row in rows if section_of(row) == first]
    return "\n".join(lines[1:])


def section_of(row: Row) -> int:
    """The first claim of the table that a row stands in."""
    number = int(row["number"].rstrip("abcdef"))
    return max(first for first in SECTIONS if first <= number)


def cells(row: Row) -> tuple[str, ...]:
    """Number, claim with its section, criterion, figure with its link, on how many, verdict."""
    judged = row["verdict"]
    unit = f" {row['unit']}" if judged.startswith("equal") and row["unit"] else ""
    qualifier = f", {row['qualifier']}" if row["qualifier"] else ""
    figure, _, bounds = shown(row).partition(" ")
    if not row["rule"]:
        figure, bounds = shown(row), ""
    measured = f"[{figure}]({row['page'].split()[0]}) {bounds}".strip()
    if row["rule"] and row["unit"]:
        measured += f"&nbsp;{row['unit']}"
    return (
        row["number"],
        f"{row['claim']} ({row['section']})",
        criterion(row),
        "; ".join(filter(None, (measured, row["note"]))),
        row["on"],
        f"{judged}{unit}{qualifier}",
    )


def criterion(row: Row) -> str:
    """The criterion with its rule and unit; its words alone where they state the other figure's
    interval."""
    sign, *bounds = row["rule"].partition(" ~ ")[0].split() or [""]
    if sign in ("", "<", ">") and len(bounds) != 1:
        return row["criterion"]
    limits = f"{sign} {bounds[0]}" if len(bounds) == 1 else " to ".join(bounds)
    return f"{row['criterion']}: {limits} {row['unit']}".strip()


def shown(row: Row) -> str:
    """What was measured, with its widest interval; one without width as it was widened."""
    measured = joined(row["measured"]).removesuffix(" exactly")
    stated = re.search(rf"\[({NUMBER}), ({NUMBER})\]", measured)
    if stated is None or stated[1] != stated[2]:
        return measured
    low, high = interval(row["measured"], row["fingers"])
    return f"{measured[: stated.start()]}[{low:+g}, {high:+g}]"


def figure(rows: Sequence[Row]) -> str:
    """Published figures (rules ``= x``) against measured ones with their intervals, as SVG."""
    compared = [row for row in rows if re.fullmatch(r"= [\d.]+", row["rule"])]
    compared = [row for row in compared if not row["qualifier"]]
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 {24 * len(compared) + 50}"'
        ' font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>'
    ]
    for k, row in enumerate(compared):
        y = 24 * k + 20
        ends = interval(row["measured"], row["fingers"])
        low, high = (AXIS_PX + PX_PER_POINT * end for end in ends)
        published = AXIS_PX + PX_PER_POINT * float(row["rule"].split()[1])
        measured = AXIS_PX + PX_PER_POINT * float(row["measured"].split()[0])
        words = html.escape(": ".join(filter(None, (row["claim"], row["criterion"]))))
        lines += [
            f'<text x="8" y="{y + 4}" font-size="11">{row["number"]} {words}</text>',
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
    """The page with its tables and summary written anew."""
    rows, text = read(), PAGE.read_text(encoding="utf-8")
    parts = {"summary": summary(rows), "claims": tables(rows)}
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
