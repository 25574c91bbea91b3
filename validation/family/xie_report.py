"""Write the tables of ``xie.json`` into ``docs/experiments/published-systems.md``, between their marks.

python validation/family/xie_report.py            # writes
python validation/family/xie_report.py --check    # exit code 1 if the page does not show what the file holds
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
PAGE = HERE.parents[1] / "docs" / "experiments" / "published-systems.md"
RESAMPLES, CONFIDENCE, SEED = 10_000, 0.95, 42
COLUMNS = {
    "normals_deg": ("normals, deg", 2),
    "ridge_correlation": ("ridge correlation", 3),
    "ridge_gain": ("ridge gain", 4),
    "shape_rms_mm": ("shape rms, mm", 3),
}
PAIRS = (
    ("distant lights, equal weights", "lambertian", "layers"),
    ("the same without layers: a surface alone (Fresnel)", "lambertian", "fresnel"),
    ("layers against the surface alone", "fresnel", "layers"),
    ("layers that nothing holds, against held ones", "layers", "layers free"),
    ("distant lights, shadow and gloss left out", "lambertian robust", "layers robust"),
    ("near lights, equal weights", "lambertian near", "layers near"),
)
Tree = Mapping[str, Any]


def interval(differences: Sequence[float]) -> tuple[float, float, float]:
    """Mean and its 95 % interval: fingers are drawn anew."""
    values = np.asarray(differences, dtype=np.float64)
    drawn = np.random.default_rng(SEED).integers(0, values.size, (RESAMPLES, values.size))
    low, high = np.quantile(values[drawn].mean(axis=1), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(values.mean()), float(low), float(high)


def difference(fingers: Sequence[Tree], light: str, first: str, second: str, figure: str) -> tuple[float, float, float]:
    """Second way minus first, finger by finger."""
    return interval([finger[light][second][figure] - finger[light][first][figure] for finger in fingers])


def pairs_table(results: Tree) -> str:
    """Lambertian, layers and their difference by glare and channel."""
    lines = _head("light, channel", "", *(words for words, _ in COLUMNS.values()))
    for light in (key for key in results["fingers"][0] if key != "seed"):
        for way in ("lambertian", "layers"):
            means = [np.mean([f[light][way][figure] for f in results["fingers"]]) for figure in COLUMNS]
            cells = [f"{m:.{d}f}" for m, (_, d) in zip(means, COLUMNS.values(), strict=True)]
            lines.append(_row(light if way == "lambertian" else "", way, *cells))
        cells = [
            _signed(difference(results["fingers"], light, "lambertian", "layers", figure), digits)
            for figure, (_, digits) in COLUMNS.items()
        ]
        lines.append(_row("", "**difference**", *cells))
    return "\n".join(lines)


def causes_table(results: Tree) -> str:
    """What of the difference comes from where, in grey."""
    lines = _head("in grey: what is compared", "glare", *(words for words, _ in COLUMNS.values()))
    for words, first, second in PAIRS:
        for glare in ("glare", "no glare"):
            cells = [
                _signed(difference(results["fingers"], f"{glare}, grey", first, second, figure), digits + 1)
                for figure, (_, digits) in COLUMNS.items()
            ]
            lines.append(_row(words if glare == "glare" else "", glare, *cells))
    return "\n".join(lines)


def slopes_table(results: Tree) -> str:
    """Slopes of the finger's shape, found over true, in grey."""
    names = ("lambertian", "layers", "lambertian near", "layers near")
    lines = _head("slopes found over true, in grey", *names)
    for glare in ("glare", "no glare"):
        for low, high in ((0, 30), (30, 60)):
            cells = [
                f"{np.mean([f[f'{glare}, grey'][name][f'slopes_{low}_{high}'] for f in results['fingers']]):.2f}"
                for name in names
            ]
            lines.append(_row(f"{glare}, skin at {low} to {high} deg", *cells))
    return "\n".join(lines)


def itself_table(results: Tree) -> str:
    """Fingers that the model has painted."""
    lines = _head(
        "skin", "noise", "lambertian, deg", "layers, deg", "layers, rms deg", "the noise allows, rms deg",
        "share: correlation, error / spread", "depth: correlation, error / spread",
    )  # fmt: skip
    for row in results["itself"]:
        found = [
            f"{row[f'{name}_correlation']:.2f}, {row[f'{name}_error']:.2f} / {row[f'{name}_spread']:.2f}"
            for name in ("share", "depth")
        ]
        allowed = f"{row['allowed_rms_deg']:.2f}" if "allowed_rms_deg" in row else ""
        errors = [f"{row[name]:.2f}" for name in ("lambertian_deg", "layers_deg", "layers_rms_deg")]
        lines.append(_row(row["skin"], f"{100 * row['noise']:g} %", *errors, allowed, *found))
    return "\n".join(lines)


def photographs_table(results: Tree) -> str:
    """Mean errors on the bear."""
    found = results["photographs"]
    if found is None:
        return "The photographs were not there when this was measured."
    ways = ("lambertian", "layers", "lambertian robust", "layers robust")
    lines = _head("mean error on the bear, deg", *ways)
    for name, errors in found.items():
        lines.append(_row(name, *(f"{errors[way]:.2f}" for way in ways)))
    return "\n".join(lines)


def trials_table(results: Tree) -> str:
    """What the settings were chosen from."""
    lines = _head("trial (n of the skin, base reflectance, g of a scattering, layers)", "normals, deg, mean of all")
    names = results["trials"][0]["glare"]
    means = {
        name: float(np.mean([trial[glare][name] for trial in results["trials"] for glare in ("glare", "no glare")]))
        for name in names
    }
    for name in sorted(means, key=lambda key: means[key]):
        lines.append(_row(name, f"{means[name]:.3f}"))
    return "\n".join(lines)


TABLES = {
    "xie pairs": pairs_table,
    "xie causes": causes_table,
    "xie slopes": slopes_table,
    "xie itself": itself_table,
    "xie photographs": photographs_table,
    "xie trials": trials_table,
}


def filled(text: str, results: Tree) -> str:
    """The page with its tables."""
    for name, table in TABLES.items():
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if begin not in text or end not in text:
            sys.exit(f"{PAGE} has no marks {begin} and {end}.")
        before, rest = text.split(begin, 1)
        text = before + begin + "\n" + table(results) + "\n" + end + rest.split(end, 1)[1]
    return text


def _head(*names: str) -> list[str]:
    return [_row(*names), "| --- " * len(names) + "|"]


def _row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _signed(found: tuple[float, float, float], digits: int) -> str:
    mean, low, high = found
    return f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--results", type=Path, default=HERE / "xie.json")
    chosen = parser.parse_args(arguments)
    page = PAGE.read_text(encoding="utf-8")
    wanted = filled(page, json.loads(chosen.results.read_text(encoding="ascii")))
    if not chosen.check:
        PAGE.write_text(wanted, encoding="utf-8")
    return int(chosen.check and wanted != page)


if __name__ == "__main__":
    sys.exit(main())
