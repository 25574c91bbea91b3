"""Write the figures of ``results.json`` into ``docs/experiments/accuracy.md``, between its marks.

python validation/accuracy/report.py            # writes
python validation/accuracy/report.py --check    # exit code 1 if the page does not show what results.json holds
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from summary import ROWS, Row

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGES = {
    ROOT / "docs" / "experiments" / "accuracy.md": (
        "run",
        "targets",
        "population",
        "variations_summary",
        "variations",
        "singles",
    ),
}
"""The marks of every page."""
ORDER = ("metric", "snk", "pr", "ea", "pr-split", "ea-split")
Tree = Mapping[str, Any]


def in_order(presets: Tree) -> list[str]:
    """`metric` first."""
    return sorted(presets, key=ORDER.index)


def population_table(population: Tree) -> str:
    """One table for each preset, the first with what is asked."""
    presets = population["presets"]
    return "\n\n".join(_preset_table(name, presets[name]) for name in in_order(presets))


def _preset_table(name: str, preset: Tree) -> str:
    lines = [
        f"**`{name}`**, {preset['captures']} captures, {len(preset['refused'])} refused, "
        f"{preset['seconds_median']:.1f} s each (median, one core of a busy machine):",
        "",
        "| figure | mean [95 % interval] | median (quartiles) | worst | minimum: fraction met | aim: fraction met |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for key, row in ROWS.items():
        found = preset["figures"].get(key)
        if found is not None:
            lines.append(_line(row, found))
    return "\n".join(lines)


def _line(row: Row, found: Tree) -> str:
    def shown(value: float) -> str:
        return f"{value:.{row.digits}f}"

    unit = f", {row.unit}" if row.unit else ""
    asked = []
    for name, wanted in (("least", row.least), ("aim", row.aim)):
        asked.append("" if wanted is None else f"{_wanted(row, wanted)}: {100 * found[f'meets_{name}']:.0f} %")
    low, high = found["interval"]
    first, third = found["quartiles"]
    return (
        f"| {row.words}{unit} | {shown(found['mean'])} [{shown(low)}, {shown(high)}] "
        f"| {shown(found['median'])} ({shown(first)}, {shown(third)}) | {shown(found['worst'])} "
        f"| {asked[0]} | {asked[1]} |"
    )


def _wanted(row: Row, wanted: Sequence[float]) -> str:
    if row.better == "low":
        return f"{wanted[1]:g}"
    return f"{wanted[0]:g}" if row.better == "high" else f"{wanted[0]:g} to {wanted[1]:g}"


def targets_table(population: Tree) -> str:
    """What is asked, and the mean of every preset."""
    presets = in_order(population["presets"])
    lines = [
        f"| figure (mean over the fingers) | at least | aim for | {' | '.join(f'`{p}`' for p in presets)} |",
        "| --- | --- | --- |" + " --- |" * len(presets),
    ]
    for key, row in ROWS.items():
        if row.least is None or row.aim is None:
            continue
        unit = f", {row.unit}" if row.unit else ""
        cells = []
        for preset in presets:
            found = population["presets"][preset]["figures"].get(key)
            cells.append("-" if found is None else f"{found['mean']:.{row.digits}f}")
        asked = f"{_wanted(row, row.least)} | {_wanted(row, row.aim)}"
        lines.append(f"| {row.words}{unit} | {asked} | {' | '.join(cells)} |")
    return "\n".join(lines)


def variation_table(variation: Tree) -> str:
    """One line for each value; means over the fingers."""
    presets = in_order(variation["values"][0]["presets"])
    keys = ("surface_rms_mm", "ridge_correlation", "ridge_gain", "ridge_good_area", "normals_mean_deg")
    head = [f"{ROWS[k].words}" + (f", {ROWS[k].unit}" if ROWS[k].unit else "") for k in keys]
    unit = f", {variation['unit']}" if variation["unit"] else ""
    lines = [
        f"**{variation['words']}{unit}** ({_fingers(variation['fingers'])}; {variation['base']:g} elsewhere)",
        "",
        f"| value | {'preset | ' if len(presets) > 1 else ''}{' | '.join(head)} |",
        "| --- |" + " --- |" * (len(keys) + (len(presets) > 1)),
    ]
    for entry in variation["values"]:
        for preset in presets:
            found = entry["presets"][preset]
            cells = [f"{found[k]:.{ROWS[k].digits}f}" if k in found else "refused" for k in keys]
            first = f"| {entry['value']:g} | " + (f"`{preset}` | " if len(presets) > 1 else "")
            lines.append(f"{first}{' | '.join(cells)} |")
    return "\n".join(lines)


def _fingers(count: int) -> str:
    return "1 finger" if count == 1 else f"{count} fingers"


def variations_summary(variations: Tree, preset: str = "metric") -> str:
    """What each variation does to the figures, the most harmful first: the largest change from the base value."""
    rows = []
    for name, variation in variations.items():
        entries = {entry["value"]: entry["presets"].get(preset, {}) for entry in variation["values"]}
        base = entries.get(variation["base"])
        others = [(value, found) for value, found in entries.items() if value != variation["base"] and found]
        if not base or not others or "surface_rms_mm" not in base:
            continue
        value, worst = max(others, key=lambda pair: _loss(pair[1], base))
        rows.append((_loss(worst, base), name, value, variation, worst))
    lines = [
        "| what is varied | worst value | surface rms, mm | ridge correlation | ridge gain | area > 0.8 |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for _, name, value, variation, worst in sorted(rows, key=lambda row: -row[0]):
        base = next(e["presets"][preset] for e in variation["values"] if e["value"] == variation["base"])
        cells = [
            f"{base[key]:.{ROWS[key].digits}f} -> {worst[key]:.{ROWS[key].digits}f}" if key in worst else "refused"
            for key in ("surface_rms_mm", "ridge_correlation", "ridge_gain", "ridge_good_area")
        ]
        unit = f" {variation['unit']}" if variation["unit"] else ""
        lines.append(
            f"| {name.replace('_', ' ')} | {value:g}{unit} (base {variation['base']:g}) | {' | '.join(cells)} |"
        )
    return "\n".join(lines)


def _loss(found: Tree, base: Tree) -> float:
    """How much worse, in units of the room between what is asked at least and perfection."""
    if "surface_rms_mm" not in found:
        return float("inf")
    return max(
        (found["surface_rms_mm"] - base["surface_rms_mm"]) / 0.13,
        (base["ridge_correlation"] - found["ridge_correlation"]) / 0.15,
        (ROWS["ridge_gain"].cost(found["ridge_gain"]) - ROWS["ridge_gain"].cost(base["ridge_gain"])) / 0.4,
        (base["ridge_good_area"] - found["ridge_good_area"]) / 0.1,
    )


def singles_table(population: Tree, preset: str = "metric") -> str:
    """Every finger."""
    keys = ("surface_rms_mm", "ridge_correlation", "ridge_gain", "ridge_good_area")
    lines = [
        f"| seed | pattern | scattering | glare | roughness | melanin | {' | '.join(ROWS[k].words for k in keys)} |",
        "| --- | --- | --- | --- | --- | --- |" + " --- |" * len(keys),
    ]
    for single in population["singles"]:
        found = single["figures"].get(preset)
        cells = ["refused"] * len(keys) if found is None else [f"{found[k]:.{ROWS[k].digits}f}" for k in keys]
        lines.append(
            f"| {single['seed']} | {single['pattern'].replace('_', ' ')} | {single['scattering']:.2f} "
            f"| {single['glare']:.2f} | {single['roughness']:.2f} | {single['melanin']:.4f} | {' | '.join(cells)} |"
        )
    return "\n".join(lines)


def parts(results: Tree) -> dict[str, str]:
    """Text of every marked part of the page."""
    population = results["population"]
    found = {
        "targets": targets_table(population),
        "population": population_table(population),
        "singles": singles_table(population),
        "run": f"{population['fingers']} fingers, seeds {population['first_seed']} to "
        f"{population['first_seed'] + population['fingers'] - 1}, images at {population['scale']:g} of the full scale.",
    }
    variations = results.get("variations", {})
    if variations:
        found["variations_summary"] = variations_summary(variations)
        found["variations"] = "\n\n".join(variation_table(v) for v in variations.values())
    return found


def filled(page: str, texts: Mapping[str, str]) -> str:
    """Replace what stands between ``<!-- name -->`` and ``<!-- /name -->``."""
    for name, text in texts.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        page, count = pattern.subn(lambda match, text=text: f"{match[1]}{text}\n{match[2]}", page)
        if count != 1:
            raise ValueError(f"the page has {count} places for '{name}'; one was expected.")
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; say whether the pages are up to date")
    parser.add_argument("--results", type=Path, default=HERE / "results.json")
    options = parser.parse_args(arguments)
    texts = parts(json.loads(options.results.read_text()))
    stale = []
    for page, marks in PAGES.items():
        old = page.read_text(encoding="utf-8")
        new = filled(old, {name: texts[name] for name in marks if name in texts})
        if new != old:
            stale.append(page.name)
            if not options.check:
                page.write_text(new, encoding="utf-8")
    if options.check:
        print(f"not up to date: {', '.join(stale)}" if stale else "up to date")
    return int(options.check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
