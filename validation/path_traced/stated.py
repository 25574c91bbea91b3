"""Is the stated uncertainty right, where the images do not show by which factor all heights of a
finger are wrong?

    python validation/path_traced/stated.py DIR ...     # of make.py --drawn: tables/stated.csv

Part of a finger's error is one common factor, the rest differs from place to place. So the error of
one finger, over what is stated, is not near 1 even where the statement is right: it is
sqrt(1 - s + s z^2), with s the factor's share of the stated variance and z normal. Printed are how
many fingers lie within, below and above the limits, and the largest; then the same drawn so.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit import read_capture, reconstruct
from splitknit.errors import BadInput, require
from splitknit.io.csv_table import csv_text
from splitknit.io.npz import read_npz

sys.path.insert(0, str(Path(__file__).parent))

from score import score

TABLE = Path(__file__).parent / "tables" / "stated.csv"
WANTED = (0.75, 1.2)
"""Limits of the error over what is stated."""
DRAWS = 20_000


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        truths = [file for word in words for file in sorted(Path(word).glob("drawn_*_truth.npz"))]
        require(truths, "give folders of make.py --drawn: stated.py DIR ...")
        rows = [scored(file) for file in truths]
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    table = [list(rows[0]), *(row.values() for row in rows)]
    TABLE.write_text(csv_text(table), encoding="utf-8")
    ratios, shares = (
        np.array([float(row[name]) for row in rows])
        for name in ("error_over_stated", "factor_share")
    )
    print("measured:", ", ".join(f"{each:g}" for each in summary(ratios)))
    print("of a right statement:", expected(shares))
    return 0


def scored(truth: Path) -> dict[str, str | float]:
    """A row of the table: figures below 60 degrees of slant, and the factor's share of the stated
    variance."""
    name = truth.name.removesuffix("_truth.npz")
    result = reconstruct(read_capture(truth.with_name(name)))
    arrays = {name: getattr(result, name) for name in ("height_mm", "mask", "uncertainty_um")}
    figures = score(arrays, read_npz(truth))
    correlation, gain, rms_um = (figures[f"ridge_{key}"] for key in ("corr", "gain", "rms_um"))
    # |a - b|^2 with a b = gain b^2, where a is the relief and b the true one
    true_um = rms_um / np.sqrt((gain / correlation) ** 2 + 1 - 2 * gain)
    stated_um = rms_um / figures["error_over_stated"]
    factor_sd = result.facts["optics"]["gain_uncertainty"]
    print(name, flush=True)
    row = {
        "ridge_correlation": correlation,
        "ridge_gain": gain,
        "ridge_rms_um": rms_um,
        "stated_um": stated_um,
        "error_over_stated": figures["error_over_stated"],
        "factor_sd": factor_sd,
        "factor_share": (factor_sd * gain / correlation * true_um / stated_um) ** 2,
    }
    return {"finger": name, **{key: round(value, 3) for key, value in row.items()}}


def summary(ratios: NDArray[np.float64]) -> tuple[int, int, int, float]:
    """How many lie within the limits, below, above; the largest."""
    low, high = WANTED
    below, above = int((ratios < low).sum()), int((ratios > high).sum())
    return len(ratios) - below - above, below, above, float(ratios.max())


def expected(shares: NDArray[np.float64]) -> str:
    """Medians and intervals of 95 % of the same, where each `share` of the variance is exactly
    right; how often all lie within the limits."""
    normal = np.random.default_rng(0).standard_normal((DRAWS, len(shares)))
    ratios = np.sqrt(1 - shares + shares * normal**2)
    drawn = np.array([summary(row) for row in ratios])
    low, middle, high = np.percentile(drawn, [2.5, 50, 97.5], axis=0)
    parts = [f"{m:.3g} [{a:.3g}, {b:.3g}]" for a, m, b in zip(low, middle, high, strict=True)]
    return f"{', '.join(parts)}; all within: {(drawn[:, 0] == len(shares)).mean():.1g}"


if __name__ == "__main__":
    sys.exit(main())
