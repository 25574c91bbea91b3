"""Write the tables of ``ablation.json`` to ``tables/`` and the short one into
``docs/experiments/separation.md``, those of ``clahe.json`` into ``tables/clahe.csv`` and four rows
of them into ``docs/explain/reconstruction.md``; errors after the best factor, which amplification
does not change, into ``tables/best_factor.csv``.

python validation/separation/ablation_report.py          # writes
python validation/separation/ablation_report.py --check  # exit code 1 if they are out of date
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ablation import statistics

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "experiments" / "separation.md"
TABLES = HERE / "tables"
MARKS = ("<!-- ablation -->", "<!-- /ablation -->")
RESULTS = HERE / "ablation.json"
CONTRAST = HERE / "clahe.json"
CONTRAST_PAGE = HERE.parents[1] / "docs" / "explain" / "reconstruction.md"
CONTRAST_MARKS = ("<!-- clahe -->", "<!-- /clahe -->")
CONTRAST_SHOWN = (
    "sRGB code, cells of 64 px, limit 3",
    "*sRGB code instead of linear light*",
    "*network instead of all light, sRGB code*",
)
CONTRAST_COLUMNS = (
    "ridge_correlation",
    "ridge_gain",
    "ridge_rms_um",
    "normals_mean_deg",
    "surface_rms_mm",
)
BEST_FACTOR = (
    ("network instead of all light", "clahe", "clahe_srgb_cells_3", "clahe_srgb_cells_3_all"),
    ("CLAHE, all light", "ablation", "snk_clahe_all", "snk_plain_all"),
    ("true direct light, CLAHE on", "ablation", "snk_clahe_direct", "snk_clahe_all"),
    ("true direct light, CLAHE off", "ablation", "snk_plain_direct", "snk_plain_all"),
)
"""Words, which results, row, and the row it is compared with."""
REPLICATES = 4000
COLUMNS = {
    "ridge_correlation": ("ridge correlation", 3),
    "ridge_gain": ("gain", 2),
    "ridge_rms_um": ("rms, um", 1),
    "ridge_good_area": ("area > 0.8", 3),
    "normals_mean_deg": ("normals, deg", 1),
    "surface_rms_mm": ("surface rms, mm", 3),
}
PAGE_COLUMNS = ("ridge_correlation", "ridge_gain", "surface_rms_mm")
PAGE_ROWS = {
    "ea-split": "`ea-split`",
    "snk_clahe_network": "`snk`",
    "near_in": "near lights",
    "near_truth": "near lights without specular reflection",
    "grey_in": "blur inverted, grey",
    "grey_truth": "blur inverted, grey, without specular reflection",
    "shading": "blur of blue light inverted (`metric` without networks)",
    "metric": "`metric`",
}
"""Rows of the page's table."""
AT_MOST_ONE = ("ridge_correlation", "ridge_good_area")
Tree = Mapping[str, Any]


def rows_table(results: Tree) -> str:
    """The ways of the page, with their figures."""
    names = ["light", *(COLUMNS[key][0] for key in PAGE_COLUMNS)]
    lines = ["| " + " | ".join(names) + " |", "| --- " * len(names) + "|"]
    for name, words in PAGE_ROWS.items():
        if name in results["rows"]:
            row = results["rows"][name]
            figures = row["figures"]
            refused = f" ({row['refused']} refused)" if row["refused"] else ""
            cells = [
                _cell(_cut(key, figures[key], ""), COLUMNS[key][1], "") if figures else ""
                for key in PAGE_COLUMNS
            ]
            lines.append(f"| {words}{refused} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def rows_csv(results: Tree) -> str:
    """Every way with all its figures."""
    rows = [
        [name, row["group"], row["words"], str(row["refused"])]
        for name, row in results["rows"].items()
    ]
    return _csv(
        ["row", "group", "words", "refused"],
        rows,
        [row["figures"] for row in results["rows"].values()],
        "",
    )


def pairs_csv(results: Tree) -> str:
    """Differences, finger by finger."""
    rows = [[pair["words"], pair["row"], pair["against"]] for pair in results["pairs"]]
    return _csv(
        ["difference", "row", "against"], rows, [pair["figures"] for pair in results["pairs"]], "+"
    )


def _csv(first: list[str], rows: list[list[str]], figures: list[Tree], sign: str) -> str:
    """CSV with three columns for each figure, rounded as on the page."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*first, *(key + end for key in COLUMNS for end in ("", "_low", "_high"))])
    for row, values in zip(rows, figures, strict=True):
        cells = list(row)
        for key, (_, digits) in COLUMNS.items():
            figure = _cut(key, values[key], sign) if values else {"mean": None, "interval": None}
            three = (figure["mean"], *(figure["interval"] or (None, None)))
            cells += ["" if value is None else f"{value:{sign}z.{digits}f}" for value in three]
        writer.writerow(cells)
    return text.getvalue()


def _cut(key: str, figure: Tree, sign: str) -> Tree:
    """Student's t knows nothing of what a figure can be."""
    if sign or key not in AT_MOST_ONE or figure["interval"] is None:
        return figure
    return {**figure, "interval": [min(end, 1.0) for end in figure["interval"]]}


def _cell(figure: Tree, digits: int, sign: str) -> str:
    def formatted(value: float) -> str:
        return f"{value:{sign}z.{digits}f}"

    if figure["interval"] is None:
        return formatted(figure["mean"])
    low, high = figure["interval"]
    return f"{formatted(figure['mean'])} [{formatted(low)}, {formatted(high)}]"


def section(results: Tree) -> str:
    """What stands between the marks."""
    seeds = results["seeds"]
    return "\n".join(
        [
            (
                f"{len(seeds)} fingers, images at {results['scale']:g} of the full scale; mean [95"
                " % interval over fingers, Student's t]; [definitions](accuracy.md#definitions)."
            ),
            "",
            rows_table(results),
        ]
    )


def contrast_rows(results: Tree) -> list[list[str]]:
    """The contrast enhancement of ``snk``: its ways, and differences finger by finger, with
    bootstrap intervals."""
    fingers = [finger["rows"] for finger in results["fingers"]]
    drawn = np.random.default_rng(0).integers(len(fingers), size=(REPLICATES, len(fingers)))

    def row(words: str, name: str, against: str, sign: str) -> list[str]:
        cells = []
        for key in CONTRAST_COLUMNS:
            values = np.array(
                [rows[name][key] - (rows[against][key] if against else 0.0) for rows in fingers]
            )
            ends = np.percentile(values[drawn].mean(axis=1), (2.5, 97.5)).tolist()
            cells.append(
                _cell({"mean": float(values.mean()), "interval": ends}, COLUMNS[key][1], sign)
            )
        return [words, *cells]

    return [
        ["", *(COLUMNS[key][0] for key in CONTRAST_COLUMNS)],
        *(row(way["words"], name, "", "") for name, way in results["rows"].items()),
        *(
            row(f"*{pair['words']}*", pair["row"], pair["against"], "+")
            for pair in results["pairs"]
        ),
    ]


def contrast_section(results: Tree, row_names: Sequence[str] = CONTRAST_SHOWN) -> str:
    """Rows of the contrast enhancement as a table of the page."""
    seeds = results["seeds"]
    head, *rows = contrast_rows(results)
    lines = [
        (
            f"`snk` on {len(seeds)} fingers of the simulator (seeds {seeds[0]} to {seeds[-1]},"
            f" scale {results['scale']:g}); mean [95 % interval, bootstrap over fingers]; in"
            " italics: differences, finger by finger. All rows:"
            " [clahe.csv](../../validation/separation/tables/clahe.csv)."
        ),
        "",
        "| " + " | ".join(head) + " |",
        "| --- " * len(head) + "|",
        *("| " + " | ".join(row) + " |" for row in rows if row[0] in row_names),
    ]
    return "\n".join(lines)


def contrast_csv(results: Tree) -> str:
    """All rows as CSV: mean and interval of each figure in columns of their own; differences begin
    with a sign."""
    head, *rows = contrast_rows(results)
    names = [f"{name}{end}" for name in head[1:] for end in ("", " low", " high")]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["light", *names])
    for words, *cells in rows:
        table.writerow(
            [
                words.strip("*"),
                *(value for cell in cells for value in re.findall(r"[+-]?[\d.]+", cell)),
            ]
        )
    return text.getvalue()


def best_factor_csv(results: Tree, contrast: Tree) -> str:
    """Ridge error that is left after the factor that suits the finger best, in um: differences
    finger by finger."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["what", "fingers", "mean", "unit"])
    for words, tree, name, against in BEST_FACTOR:
        rows = [
            finger["rows"] for finger in {"clahe": contrast, "ablation": results}[tree]["fingers"]
        ]
        values = [best_factor_um(row[name]) - best_factor_um(row[against]) for row in rows]
        table.writerow([words, len(rows), _cell(statistics(values), 2, "+"), "um"])
    return text.getvalue()


def best_factor_um(row: Mapping[str, float]) -> float:
    """With e = g t + n: rms(e - t)^2 = s^2 ((g / r)^2 - 2 g + 1), where s is the standard deviation
    of the true ridges t, g the gain, r the correlation; the best factor leaves s sqrt(1 - r^2)."""
    gain, correlation = row["ridge_gain"], row["ridge_correlation"]
    true_um = row["ridge_rms_um"] / float(np.sqrt((gain / correlation) ** 2 - 2.0 * gain + 1.0))
    return true_um * float(np.sqrt(1.0 - correlation**2))


def filled(page: str, text: str, marks: tuple[str, str]) -> str:
    """The page with `text` between its marks."""
    first, last = marks
    before, rest = page.split(first, 1)
    return f"{before}{first}\n{text}\n{last}{rest.split(last, 1)[1]}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args(arguments)
    results, contrast = (
        json.loads(file.read_text(encoding="ascii")) for file in (RESULTS, CONTRAST)
    )
    page, contrast_page = (place.read_text(encoding="utf-8") for place in (PAGE, CONTRAST_PAGE))
    wanted = {
        PAGE: filled(page, section(results), MARKS),
        CONTRAST_PAGE: filled(contrast_page, contrast_section(contrast), CONTRAST_MARKS),
        TABLES / "ablation.csv": rows_csv(results),
        TABLES / "ablation_pairs.csv": pairs_csv(results),
        TABLES / "clahe.csv": contrast_csv(contrast),
        TABLES / "best_factor.csv": best_factor_csv(results, contrast),
    }
    stale = [
        place
        for place, text in wanted.items()
        if not place.exists() or place.read_text(encoding="utf-8") != text
    ]
    if not options.check:
        for place, text in wanted.items():
            place.write_text(text, encoding="utf-8")
    return int(options.check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
