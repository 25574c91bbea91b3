"""Claims 43 and 45 over fingers: noise of curvature by cubic and quadratic fits, and ridge periods
of unrolled prints.

    python validation/prints/over_fingers.py POPULATION --scratch FOLDER

The first captures of a simulated population, reconstructed by ``metric``; what is in FOLDER is not
made again. Figures of one finger are those of ``curvature_noise.py`` (noise of 2 um) and
``ridge_period.py`` (medians of the size); means over fingers have Student's 95 %. The table is
written to ``tables/over_fingers.csv``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from curvature_noise import fits
from ridge_period import period_errors
from scipy import stats

from splitknit import read_capture, reconstruct
from splitknit.io.csv_table import csv_text
from splitknit_match.prints.sources import read_source

TABLE = Path(__file__).with_name("tables") / "over_fingers.csv"
ZONES = {"at the centre": "centre (< 20 deg)", "at 55 to 65 deg": "55-65 deg"}
FIGURES = {
    "cubic noise over quadratic, full windows": "{:.2f}",
    "cubic noise over quadratic, cut windows": "{:.2f}",
    "period, unrolled, at the centre, %": "{:.1f}",
    "period, unrolled, at 55 to 65 deg, %": "{:.1f}",
    "period, unrolled, at 55 to 65 deg less at the centre, %": "{:+.1f}",
    "period, plane, at 55 to 65 deg less at the centre, %": "{:+.1f}",
}


def figures_of(capture: Path, result: Path) -> dict[str, float]:
    """All figures of one finger."""
    noise = fits(capture, read_source(result, photo=False, surface=True))
    quadratic, cubic = (noise[f"{word}, noise 2.0 um"] for word in ("quadratic", "cubic"))
    row = {
        f"cubic noise over quadratic, {zone} windows": cubic[f"{zone}_windows"]
        / quadratic[f"{zone}_windows"]
        for zone in ("full", "cut")
    }
    errors = period_errors(capture, result)
    for words, kind in (("unrolled", "free"), ("plane", "plane")):
        centre, side = (
            100.0 * float(np.median(np.abs(errors[kind, zone]))) for zone in ZONES.values()
        )
        row[f"period, {words}, at the centre, %"] = centre
        row[f"period, {words}, at 55 to 65 deg, %"] = side
        row[f"period, {words}, at 55 to 65 deg less at the centre, %"] = side - centre
    return row


def mean(values: list[float], form: str) -> str:
    """Mean over fingers with its interval."""
    centre = float(np.mean(values))
    reach = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    text, low, high = (form.format(end) for end in (centre, centre - reach, centre + reach))
    return f"{text} [{low}, {high}]"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("population", type=Path)
    parser.add_argument("--captures", type=int, default=8)
    parser.add_argument("--scratch", type=Path, required=True)
    options = parser.parse_args()
    files = sorted(options.population.glob("*/session_*/*/truth.npz"))[: options.captures]
    rows = []
    for file in files:
        name = "-".join(file.parent.relative_to(options.population).parts)
        kept = options.scratch / f"{name}.json"
        if not kept.is_file():
            result = options.scratch / name
            reconstruct(read_capture(file.parent)).save(result)
            kept.write_text(json.dumps(figures_of(file.parent, result)), encoding="utf-8")
        rows.append(json.loads(kept.read_text(encoding="utf-8")))
        print(kept.name, rows[-1], flush=True)
    table = [
        [name, len(rows), mean([row[name] for row in rows], form)] for name, form in FIGURES.items()
    ]
    TABLE.write_text(csv_text([["what", "fingers", "mean"], *table]), encoding="utf-8")


if __name__ == "__main__":
    main()
