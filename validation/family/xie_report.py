"""Write the tables of ``xie.json`` as CSV into ``validation/family/tables``.

python validation/family/xie_report.py            # writes
python validation/family/xie_report.py --check    # exit code 1 if the tables do not show what the file holds
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
FOLDER = HERE / "tables"
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
Table = list[list[str]]


def interval(differences: Sequence[float]) -> tuple[float, float, float]:
    """Mean and its 95 % interval: fingers are drawn anew."""
    values = np.asarray(differences, dtype=np.float64)
    drawn = np.random.default_rng(SEED).integers(0, values.size, (RESAMPLES, values.size))
    low, high = np.quantile(values[drawn].mean(axis=1), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(values.mean()), float(low), float(high)


def difference(fingers: Sequence[Tree], light: str, first: str, second: str, figure: str) -> tuple[float, float, float]:
    """Second way minus first, finger by finger."""
    return interval([finger[light][second][figure] - finger[light][first][figure] for finger in fingers])


def pairs_table(results: Tree) -> Table:
    """Lambertian, layers and their difference by glare and channel."""
    lines = [["light, channel", "model", *(words for words, _ in COLUMNS.values())]]
    for light in (key for key in results["fingers"][0] if key != "seed"):
        for way in ("lambertian", "layers"):
            means = [np.mean([f[light][way][figure] for f in results["fingers"]]) for figure in COLUMNS]
            cells = [f"{m:.{d}f}" for m, (_, d) in zip(means, COLUMNS.values(), strict=True)]
            lines.append([light, way, *cells])
        cells = [
            _signed(difference(results["fingers"], light, "lambertian", "layers", figure), digits)
            for figure, (_, digits) in COLUMNS.items()
        ]
        lines.append([light, "difference", *cells])
    return lines


def causes_table(results: Tree) -> Table:
    """What of the difference comes from where, in grey."""
    lines = [["in grey: what is compared", "glare", *(words for words, _ in COLUMNS.values())]]
    for words, first, second in PAIRS:
        for glare in ("glare", "no glare"):
            cells = [
                _signed(difference(results["fingers"], f"{glare}, grey", first, second, figure), digits + 1)
                for figure, (_, digits) in COLUMNS.items()
            ]
            lines.append([words, glare, *cells])
    return lines


def slopes_table(results: Tree) -> Table:
    """Slopes of the finger's shape, found over true, in grey."""
    names = ("lambertian", "layers", "lambertian near", "layers near")
    lines = [["slopes found over true, in grey", *names]]
    for glare in ("glare", "no glare"):
        for low, high in ((0, 30), (30, 60)):
            cells = [
                f"{np.mean([f[f'{glare}, grey'][name][f'slopes_{low}_{high}'] for f in results['fingers']]):.2f}"
                for name in names
            ]
            lines.append([f"{glare}, skin at {low} to {high} deg", *cells])
    return lines


def itself_table(results: Tree) -> Table:
    """Fingers that the model has painted."""
    lines = [[
        "skin", "noise", "lambertian, deg", "layers, deg", "layers, rms deg", "the noise allows, rms deg",
        "share: correlation, error / spread", "depth: correlation, error / spread",
    ]]  # fmt: skip
    for row in results["itself"]:
        found = [
            f"{row[f'{name}_correlation']:.2f}, {row[f'{name}_error']:.2f} / {row[f'{name}_spread']:.2f}"
            for name in ("share", "depth")
        ]
        allowed = f"{row['allowed_rms_deg']:.2f}" if "allowed_rms_deg" in row else ""
        errors = [f"{row[name]:.2f}" for name in ("lambertian_deg", "layers_deg", "layers_rms_deg")]
        lines.append([row["skin"], f"{100 * row['noise']:g} %", *errors, allowed, *found])
    return lines


def photographs_table(results: Tree) -> Table:
    """Mean errors on the bear."""
    found = results["photographs"]
    if found is None:  # the photographs were not there when this was measured
        return []
    ways = ("lambertian", "layers", "lambertian robust", "layers robust")
    lines = [["mean error on the bear, deg", *ways]]
    for name, errors in found.items():
        lines.append([name, *(f"{errors[way]:.2f}" for way in ways)])
    return lines


def trials_table(results: Tree) -> Table:
    """What the settings were chosen from."""
    lines = [["trial (n of the skin, base reflectance, g of a scattering, layers)", "normals, deg, mean of all"]]
    names = results["trials"][0]["glare"]
    means = {
        name: float(np.mean([trial[glare][name] for trial in results["trials"] for glare in ("glare", "no glare")]))
        for name in names
    }
    for name in sorted(means, key=lambda key: means[key]):
        lines.append([name, f"{means[name]:.3f}"])
    return lines


TABLES = {
    "xie_pairs": pairs_table,
    "xie_causes": causes_table,
    "xie_slopes": slopes_table,
    "xie_itself": itself_table,
    "xie_photographs": photographs_table,
    "xie_trials": trials_table,
}


def _signed(found: tuple[float, float, float], digits: int) -> str:
    mean, low, high = found
    return f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--results", type=Path, default=HERE / "xie.json")
    chosen = parser.parse_args(arguments)
    results = json.loads(chosen.results.read_text(encoding="ascii"))
    stale = False
    for name, table in TABLES.items():
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(table(results))
        file = FOLDER / f"{name}.csv"
        stale |= not file.exists() or file.read_text(encoding="ascii") != text.getvalue()
        if not chosen.check:
            FOLDER.mkdir(exist_ok=True)
            file.write_text(text.getvalue(), encoding="ascii")
    return int(chosen.check and stale)


if __name__ == "__main__":
    sys.exit(main())
