"""Tables of ``docs/experiments/prints.md`` from ``agreement.json``: ``python validation/prints/agreement_report.py
[--check]``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "agreement.json"
PAGE = HERE.parents[1] / "docs" / "experiments" / "prints.md"
MARKS = "<!-- agreement -->", "<!-- /agreement -->"
WORDS = {
    "metric": "`metric`", "truth": "true relief", "snk": "`snk`", "pr-split": "`pr-split`",
    "ea-split": "`ea-split`", "pressed": "pressed print",
}  # fmt: skip
PICTURES = {"print": "mindtct", "enhanced": "mindtct, enhanced", "phase": "phase"}


def cell(figure: list[float | None], digits: int = 2) -> str:
    """A figure and its interval."""
    value, low, high = ("-" if v is None else f"{v:.{digits}f}" for v in figure)
    return f"{value} [{low}, {high}]"


def named(key: str) -> tuple[str, str]:
    """What was printed, and how its minutiae were sought."""
    *what, picture = key.split()
    words = [WORDS[what[0]]] + ([f"`{what[1]}`"] if len(what) > 1 else [])
    return " ".join(words), PICTURES[picture]


def section(facts: dict[str, Any]) -> str:
    """All tables."""
    fingers = facts["fingers"]
    many = ", ".join(f"{WORDS[k.split()[0]]} {v}" for k, v in fingers.items() if k.endswith(" 1"))
    lines = [
        f"Fingers measured so far, session 1: {many}.", "",
        "| print | minutiae by | recall | precision | direction off, median / 90th percentile, deg "
        "| below 60 deg of slant: recall / precision |",
        "| --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for key, row in facts["minutiae"].items():
        what, how = named(key)
        off = f"{row['direction_median_deg'][0]:.1f} / {row['direction_p90_deg'][0]:.1f}"
        flat = row["below_60_deg"]
        below = "-" if key.startswith("pressed") else f"{cell(flat['recall'])} / {cell(flat['precision'])}"
        lines.append(f"| {what} | {how} | {cell(row['recall'])} | {cell(row['precision'])} | {off} | {below} |")
    lines += ["", "Of the true minutiae on a print:", ""]
    lines += ["| print | mindtct finds | it misses, the phase shows | neither |", "| --- | --- | --- | --- |"]
    for key, row in facts["held"].items():
        fractions = " | ".join(f"{100 * value:.0f} %" for name, value in row.items() if name != "minutiae")
        lines.append(f"| {named(key + ' print')[0]} | {fractions} |")
    if "nfiq2" in facts:
        lines += ["", "NFIQ 2, medians over fingers:", ""]
        lines += ["| print | `metric` | true relief | median of the difference |", "| --- | --- | --- | --- |"]
        for method, row in facts["nfiq2"].items():
            lines.append(
                f"| `{method}` | {row['median']:.0f} | {row['median_of_true_relief']:.0f} | "
                f"{cell(row['median_difference'], 1)} |"
            )
    scores = [(named(key), row) for key, row in facts.get("bozorth3", {}).items()]
    for key, row in facts.get("cross_modal", {}).items():
        method, picture = key.split()[:2]
        scores.append(((f"`metric` `{method}` against the pressed print", PICTURES[picture]), row))
    if scores:
        lines += ["", "Scores of bozorth3 (session 1 against session 2, or against the pressed print):", ""]
        lines += [
            "| print | minutiae by | fingers | genuine above every impostor's | genuine, median | largest impostor |"
        ]
        lines += ["| --- | --- | --- | --- | --- | --- |"]
    for (what, how), row in scores:
        lines.append(
            f"| {what} | {how} | {row['fingers']} | {cell(row['above_all_impostors'])} | {row['genuine_median']:.0f} "
            f"| {row['impostor_largest']:.0f} |"
        )
    return "\n".join(lines)


def filled(page: str, text: str) -> str:
    """The page with the tables between its marks."""
    head, rest = page.split(MARKS[0])
    return f"{head}{MARKS[0]}\n{text}\n{MARKS[1]}{rest.split(MARKS[1])[1]}"


def main(arguments: list[str] | None = None) -> int:
    """Fill the page, or say whether it is filled with these results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args(arguments)
    page = PAGE.read_text(encoding="utf-8")
    wanted = filled(page, section(json.loads(RESULTS.read_text(encoding="utf-8"))))
    if options.check:
        return int(page != wanted)
    PAGE.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
