"""What a search loses that compares only a part of a gallery of prints: the part chosen by minutiae, or by codes.

    python validation/gallery/shortlist.py          # some minutes

writes ``tables/shortlist.csv`` beside this file: of the pairs of presses that match (FVC 2000, 2002, 2004, presses 1 to
4 of five fingers on each of six sensors; the method fusion at a false match rate of 1 in 10,000), how many are not
among the given fraction of other fingers, with the 95 % interval of Clopper and Pearson. Nothing was fitted on these
prints.
"""

from __future__ import annotations

import csv
import itertools
import os
from pathlib import Path

import numpy as np
from scipy.stats import beta

from splitknit import read_print_png
from splitknit_match.matching.code import code_of, probe_codes
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.methods import similarity_at
from splitknit_match.matching.minutia_pairs import pair_minutiae
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.search import SearchSettings

HERE = Path(__file__).resolve().parent
SETS = (
    "fvc2002_db1b", "fvc/fvc2000_db2b", "fvc/fvc2002_db2b", "fvc/fvc2004_db1b", "fvc/fvc2004_db2b", "fvc/fvc2004_db3b",
)  # fmt: skip
FRACTIONS = (0.2, 0.1, 0.05, 0.02)


def main() -> None:
    """Run."""
    root = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data"))
    owner, sides = [], []
    for name in SETS:
        for file in sorted((root / name).glob("*_[1-4].png")):
            item = read_print_png(file)
            ready = Prepared(print_template(item.image, item.resolution_ppi or 500.0))
            if ready.cylinders is not None:
                owner.append(f"{name}/{file.stem[:3]}")
                sides.append(ready)
    codes = np.stack([code_of(one.template).astype(np.float32) for one in sides])
    how, count = SearchSettings(), len(sides)
    by_codes = np.stack(
        [(codes @ probe_codes(one.template, how.variants_of(one.template)).T).max(axis=1) for one in sides]
    )
    by_minutiae, matches = np.zeros((count, count)), np.zeros((count, count), bool)
    limit = similarity_at(1e-4, "fusion")
    for i, j in itertools.combinations(range(count), 2):
        laid = pair_minutiae(sides[i].cylinders, sides[j].cylinders)
        by_minutiae[i, j] = by_minutiae[j, i] = max((one.support for one in laid), default=0.0)
        if owner[i] == owner[j]:
            matches[i, j] = fused_match(sides[i], sides[j]).similarity >= limit
    other = np.array(owner)[:, None] != np.array(owner)
    rows = [["chosen_by", "fraction_compared", "matching_pairs", "lost", "low", "high"]]
    for how_chosen, score in (("minutiae", by_minutiae), ("codes", np.maximum(by_codes, by_codes.T))):
        for fraction in FRACTIONS:
            lost = int((matches & (score < np.quantile(score[other], 1 - fraction))).sum())
            n = int(matches.sum())
            low = beta.ppf(0.025, lost, n - lost + 1) if lost else 0.0
            rows.append([how_chosen, fraction, n, lost, f"{low:.4f}", f"{beta.ppf(0.975, lost + 1, n - lost):.4f}"])
    with (HERE / "tables" / "shortlist.csv").open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
