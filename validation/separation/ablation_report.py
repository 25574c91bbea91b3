"""Write the tables of ``ablation.json`` into ``docs/experiments/separation.md``, and those of ``clahe.json`` into
``docs/explain/reconstruction.md``, between their marks.

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

import numpy as np

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "experiments" / "separation.md"
HEADING = "## Ablation"
MARKS = ("<!-- ablation -->", "<!-- /ablation -->")
CONTRAST = HERE / "clahe.json"
CONTRAST_PAGE = HERE.parents[1] / "docs" / "explain" / "reconstruction.md"
CONTRAST_MARKS = ("<!-- clahe -->", "<!-- /clahe -->")
CONTRAST_COLUMNS = ("ridge_correlation", "ridge_gain", "ridge_rms_um", "normals_mean_deg", "surface_rms_mm")
REPLICATES = 4000
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


def contrast_section(results: Tree) -> str:
    """The contrast enhancement of ``snk``: its ways, and differences finger by finger, with bootstrap intervals."""
    seeds = results["seeds"]
    fingers = [finger["rows"] for finger in results["fingers"]]
    drawn = np.random.default_rng(0).integers(len(fingers), size=(REPLICATES, len(fingers)))

    def line(words: str, name: str, against: str, sign: str) -> str:
        cells = []
        for key in CONTRAST_COLUMNS:
            values = np.array([rows[name][key] - (rows[against][key] if against else 0.0) for rows in fingers])
            ends = np.percentile(values[drawn].mean(axis=1), (2.5, 97.5)).tolist()
            cells.append(_cell({"mean": float(values.mean()), "interval": ends}, COLUMNS[key][1], sign))
        return f"| {words} | " + " | ".join(cells) + " |"

    head = ["", *(COLUMNS[key][0] for key in CONTRAST_COLUMNS)]
    lines = [
        f"`snk` on {len(seeds)} fingers of the simulator (seeds {seeds[0]} to {seeds[-1]}, scale "
        f"{results['scale']:g}); mean [95 % interval, bootstrap over fingers], direct light by the shipped network, "
        "except where it says all light. Limits of 2, 3 and 4 are those of the text. In italics: differences, finger "
        "by finger.",
        "",
        "| " + " | ".join(head) + " |",
        "| --- " * len(head) + "|",
        *(line(row["words"], name, "", "") for name, row in results["rows"].items()),
        *(line(f"*{pair['words']}*", pair["row"], pair["against"], "+") for pair in results["pairs"]),
    ]
    return "\n".join(lines)


def filled(page: str, text: str, marks: tuple[str, str] = MARKS) -> str:
    """The page with `text` between its marks; they are added at its end, under a heading, if it has none."""
    first, last = marks
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
    jobs = [(options.page, options.results, section, MARKS)]
    if options.page == PAGE:
        jobs.append((CONTRAST_PAGE, CONTRAST, contrast_section, CONTRAST_MARKS))
    stale = False
    for place, file, text_of, marks in jobs:
        page = place.read_text(encoding="utf-8") if place.exists() else ""
        wanted = filled(page, text_of(json.loads(file.read_text(encoding="ascii"))), marks)
        stale |= wanted != page
        if not options.check:
            place.write_text(wanted, encoding="utf-8")
    return int(options.check and stale)


if __name__ == "__main__":
    sys.exit(main())
