"""Write the tables of ``ablation.json`` into ``docs/experiments/separation.md``, between their marks.

python validation/separation/ablation_report.py            # writes
python validation/separation/ablation_report.py --check    # exit code 1 if the page does not show what the file holds
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "experiments" / "separation.md"
HEADING = "## Ablation"
MARKS = ("<!-- ablation -->", "<!-- /ablation -->")
COLUMNS = {
    "ridge_correlation": ("ridge correlation", 3),
    "ridge_gain": ("gain", 2),
    "ridge_rms_um": ("rms, um", 1),
    "ridge_good_area": ("area > 0.8", 3),
    "normals_mean_deg": ("normals, deg", 1),
    "surface_rms_mm": ("surface rms, mm", 3),
}
AT_MOST_ONE = ("ridge_correlation", "ridge_good_area")
Tree = Mapping[str, Any]


def rows_table(results: Tree) -> str:
    """Every way with its figures, the groups apart."""
    lines = _head("light")
    group = ""
    for row in results["rows"].values():
        if row["group"] != group:
            group = row["group"]
            lines.append(f"| **{group}** |" + " |" * len(COLUMNS))
        words = row["words"] + (f" ({row['refused']} refused)" if row["refused"] else "")
        lines.append(_line(words, row["figures"], ""))
    return "\n".join(lines)


def pairs_table(results: Tree) -> str:
    """Differences, finger by finger."""
    lines = _head("difference")
    lines += [_line(pair["words"], pair["figures"], "+") for pair in results["pairs"]]
    return "\n".join(lines)


def _head(first: str) -> list[str]:
    names = [first, *(words for words, _ in COLUMNS.values())]
    return ["| " + " | ".join(names) + " |", "| --- " * len(names) + "|"]


def _line(words: str, figures: Tree, sign: str) -> str:
    cells = [
        _cell(_cut(key, figures[key], sign), digits, sign) if figures else "" for key, (_, digits) in COLUMNS.items()
    ]
    return f"| {words} | " + " | ".join(cells) + " |"


def _cut(key: str, figure: Tree, sign: str) -> Tree:
    """Student's t knows nothing of what a figure can be."""
    if sign or key not in AT_MOST_ONE or figure["interval"] is None:
        return figure
    return {**figure, "interval": [min(end, 1.0) for end in figure["interval"]]}


def _cell(figure: Tree, digits: int, sign: str) -> str:
    def shown(value: float) -> str:
        return f"{value:{sign}z.{digits}f}"

    if figure["interval"] is None:
        return shown(figure["mean"])
    low, high = figure["interval"]
    return f"{shown(figure['mean'])} [{shown(low)}, {shown(high)}]"


def section(results: Tree) -> str:
    """What stands between the marks."""
    seeds = results["seeds"]
    return "\n".join(
        [
            f"{len(seeds)} fingers, seeds {seeds[0]} to {seeds[-1]}, images at {results['scale']:g} of the full scale; "
            f"direct light through checks of {results['check_mm']:g} mm. Mean [95 % interval over fingers, Student's "
            "t, cut at 1]; definitions in [accuracy.md](accuracy.md#definitions).",
            "",
            rows_table(results),
            "",
            "Differences of one way from another, finger by finger:",
            "",
            pairs_table(results),
        ]
    )


def filled(page: str, text: str) -> str:
    """The page with `text` between its marks; they are added at its end, under a heading, if it has none."""
    first, last = MARKS
    if first not in page:
        return f"{page.rstrip()}\n\n{HEADING}\n\n{first}\n{text}\n{last}\n"
    before, rest = page.split(first, 1)
    if last not in rest:
        raise ValueError(f"the page has {first}, but no {last} after it.")
    return f"{before}{first}\n{text}\n{last}{rest.split(last, 1)[1]}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--results", type=Path, default=HERE / "ablation.json")
    parser.add_argument("--page", type=Path, default=PAGE)
    options = parser.parse_args(arguments)
    results = json.loads(options.results.read_text(encoding="ascii"))
    page = options.page.read_text(encoding="utf-8") if options.page.exists() else ""
    wanted = filled(page, section(results))
    if options.check:
        return int(wanted != page)
    options.page.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
