"""Write the figures of ``results.json`` to ``tables/``, and the short table of
``docs/experiments/accuracy.md``.

python validation/accuracy/report.py          # writes
python validation/accuracy/report.py --check  # exit code 1 if page or tables are out of date
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from summary import ROWS, Row

from splitknit.io.csv_table import csv_text

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "experiments" / "accuracy.md"
TABLES = HERE / "tables"
PATH_TRACED = ROOT / "validation" / "path_traced" / "tables" / "fingers.csv"
"""Two fingers of another renderer, measured by ``validation/path_traced/score.py``."""
ORDER = ("metric", "snk", "pr", "ea", "pr-split", "ea-split")
COLUMNS = {
    "surface_rms_mm": "surface rms, mm",
    "ridge_correlation": "ridge correlation",
    "ridge_gain": "gain",
    "ridge_rms_um": "rms, um",
    "ridge_good_area": "area > 0.8",
}
"""Figures of the page's table."""
POPULATION = (
    *(
        "preset",
        "captures",
        "refused",
        "seconds_median",
        "figure",
        "mean",
        "mean_low",
        "mean_high",
        "median",
    ),
    *(
        "first_quartile",
        "third_quartile",
        "worst",
        "minimum",
        "minimum_met_percent",
        "aim",
        "aim_met_percent",
    ),
)
"""Columns of ``tables/population.csv``."""
Tree = Mapping[str, Any]


def in_order(presets: Tree) -> list[str]:
    """`metric` first."""
    return sorted(presets, key=ORDER.index)


def results_table(population: Tree, path_traced: Iterable[Mapping[str, str]]) -> str:
    """What is asked, fingers of another renderer, and every preset on those of the simulator."""
    asked = []
    for key in COLUMNS:
        least, aim = ROWS[key].least, ROWS[key].aim
        asked.append(
            ""
            if least is None or aim is None
            else f"{_wanted(ROWS[key], least)} ({_wanted(ROWS[key], aim)})"
        )
    lines = [
        f"| light, preset | fingers | {' | '.join(COLUMNS.values())} |",
        "| --- " * (2 + len(COLUMNS)) + "|",
        f"| target (aim) |  | {' | '.join(asked)} |",
    ]
    for row in path_traced:
        cells = " | ".join(row.get(key, "") for key in COLUMNS)
        lines.append(f"| {row['light']}, `metric` | {row['fingers']} | {cells} |")
    for preset in in_order(population["presets"]):
        figures = population["presets"][preset]["figures"]
        cells = " | ".join(_with_interval(ROWS[key], figures.get(key)) for key in COLUMNS)
        lines.append(f"| own simulator, `{preset}` | {population['fingers']} | {cells} |")
    return "\n".join(lines)


def _with_interval(row: Row, figure: Tree | None) -> str:
    if figure is None:
        return ""
    mean, low, high = (f"{value:.{row.digits}f}" for value in (figure["mean"], *figure["interval"]))
    return f"{mean} [{low}, {high}]"


def _wanted(row: Row, wanted: Sequence[float]) -> str:
    if row.better == "low":
        return f"{wanted[1]:g}"
    return f"{wanted[0]:g}" if row.better == "high" else f"{wanted[0]:g} to {wanted[1]:g}"


def population_csv(population: Tree) -> str:
    """Every preset and figure: mean with interval, quartiles, the worst, and how many meet what is
    asked."""
    lines = [list(POPULATION)]
    for name in in_order(population["presets"]):
        preset = population["presets"][name]
        first = [
            name,
            str(preset["captures"]),
            str(len(preset["refused"])),
            f"{preset['seconds_median']:.1f}",
        ]
        for key, row in ROWS.items():
            figure = preset["figures"].get(key)
            if figure is None:
                continue
            values = (
                figure["mean"],
                *figure["interval"],
                figure["median"],
                *figure["quartiles"],
                figure["worst"],
            )
            asked = []
            for which, wanted in (("least", row.least), ("aim", row.aim)):
                met = "" if wanted is None else f"{100 * figure[f'meets_{which}']:.0f}"
                asked += ["" if wanted is None else _wanted(row, wanted), met]
            lines.append([*first, key, *(f"{value:.{row.digits}f}" for value in values), *asked])
    return csv_text(lines)


def singles_csv(population: Tree, preset: str = "metric") -> str:
    """Every finger."""
    keys = ("surface_rms_mm", "ridge_correlation", "ridge_gain", "ridge_good_area")
    lines = [["seed", "pattern", "scattering", "glare", "roughness", "melanin", *keys]]
    for single in population["singles"]:
        figures = single["figures"].get(preset)
        cells = (
            ["refused"] * len(keys)
            if figures is None
            else [f"{figures[k]:.{ROWS[k].digits}f}" for k in keys]
        )
        optics = [
            f"{single[name]:.{digits}f}"
            for name, digits in (("scattering", 2), ("glare", 2), ("roughness", 2))
        ]
        pattern = single["pattern"].replace("_", " ")
        lines.append([str(single["seed"]), pattern, *optics, f"{single['melanin']:.4f}", *cells])
    return csv_text(lines)


def filled(page: str, texts: Mapping[str, str]) -> str:
    """Replace what stands between ``<!-- name -->`` and ``<!-- /name -->``."""
    for name, text in texts.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        page, count = pattern.subn(lambda match, text=text: f"{match[1]}{text}\n{match[2]}", page)
        if count != 1:
            raise ValueError(f"the page has {count} places for '{name}'; one was expected.")
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; say whether the files are up to date"
    )
    parser.add_argument("--results", type=Path, default=HERE / "results.json")
    options = parser.parse_args(arguments)
    results = json.loads(options.results.read_text())
    population = results["population"]
    with PATH_TRACED.open(newline="", encoding="utf-8") as file:
        table = results_table(population, list(csv.DictReader(file)))
    wanted = {
        PAGE: filled(PAGE.read_text(encoding="utf-8"), {"results": table}),
        TABLES / "population.csv": population_csv(population),
        TABLES / "fingers.csv": singles_csv(population),
    }
    stale = [
        place
        for place, text in wanted.items()
        if not place.exists() or place.read_text("utf-8") != text
    ]
    if options.check:
        print(
            f"not up to date: {', '.join(place.name for place in stale)}" if stale else "up to date"
        )
        return int(bool(stale))
    for place in stale:
        place.write_text(wanted[place], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
