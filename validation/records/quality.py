"""Quality of a minutia: how probably is it found again in another print of the finger?

    python validation/records/quality.py            # some minutes

writes ``tables/quality.csv`` beside this file: of minutiae that another impression shows, how many
of each quality it has too (within 0.75 mm and 29 deg, where minutiae lay the two prints on each
other), and the area under the curve. Presses 1 to 4 of five fingers on each of six sensors (FVC
2000, 2002, 2004); pairs that do not match are left out. The weights in ``prints/phase_minutiae.py``
were fitted on these; the columns `held_out` are of weights that were fitted without the sensor
itself.
"""

from __future__ import annotations

import csv
import itertools
import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.minutia_pairs import on_ridges, pair_minutiae
from splitknit_match.matching.ridge import Prepared
from splitknit_match.prints import phase_minutiae
from splitknit_match.records.pictures import read_print_png

HERE = Path(__file__).resolve().parent
SETS = (
    "fvc2002_db1b",
    "fvc/fvc2000_db2b",
    "fvc/fvc2002_db2b",
    "fvc/fvc2004_db1b",
    "fvc/fvc2004_db2b",
    "fvc/fvc2004_db3b",
)
MAX_DISTANCE_MM = 0.75
"""Distance within which a minutia is found again."""
MAX_TURN_RAD = 0.5
"""Difference of direction within which a minutia is found again."""
MIN_SIMILARITY = 5.0
"""Pairs that are less similar are left out: they may be laid on each other wrongly."""


def found_again(a: Prepared, b: Prepared) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which minutiae of A are shown by B, and which of them B has."""
    laid = max(pair_minutiae(a.cylinders, b.cylinders), key=lambda alignment: alignment.support)
    (place, turn), (others, turns) = (
        (side.cylinders.place, side.cylinders.turn) for side in (a, b)
    )
    there = laid.moved(place)
    gap = np.abs(there[:, None] - others)
    apart = np.angle(np.exp(1j * (turn[:, None] + laid.angle_rad - turns)))
    return on_ridges(b.template.valid, b.pixels(there)), (
        (gap < MAX_DISTANCE_MM) & (np.abs(apart) < MAX_TURN_RAD)
    ).any(axis=1)


def area(quality: NDArray[np.float64], repeated: NDArray[np.bool_]) -> float:
    """Area under the curve: how often one that is found again has the higher quality."""
    above = np.searchsorted(np.sort(quality[~repeated]), quality[repeated], side="left")
    same = np.searchsorted(np.sort(quality[~repeated]), quality[repeated], side="right") - above
    return float(np.mean((above + 0.5 * same) / (~repeated).sum()))


def fitted(terms: NDArray[np.float64], repeated: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Weights of a logistic regression, by Newton's method."""
    weights = np.zeros(terms.shape[1])
    for _ in range(20):
        rate = 1 / (1 + np.exp(-terms @ weights))
        weights += np.linalg.solve(
            (terms.T * (rate * (1 - rate))) @ terms, terms.T @ (repeated - rate)
        )
    return weights


def main() -> None:
    """Run."""
    root = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data"))
    terms: list[NDArray[np.float64]] = []
    plain = phase_minutiae._terms
    phase_minutiae._terms = lambda *minutiae: terms.append(plain(*minutiae)) or terms[-1]
    quality, repeated, sets, rows = [], [], [], []
    for name in SETS:
        sides = []
        for file in sorted((root / name).glob("*_[1-4].png")):
            terms.clear()
            item = read_print_png(file)
            ready = Prepared(print_template(item.image, item.resolution_ppi or 500.0))
            # none was cut off
            if ready.cylinders is not None and len(ready.cylinders.turn) == len(terms[-1]):
                sides.append((file.stem[:3], ready, terms[-1]))
        for (x, a, of_a), (y, b, of_b) in itertools.combinations(sides, 2):
            if x != y or fused_match(a, b).similarity < MIN_SIMILARITY:
                continue
            for probe, reference, design in ((a, b, of_a), (b, a, of_b)):
                visible, there = found_again(probe, reference)
                quality.append(probe.template.minutiae.quality[visible])
                repeated.append(there[visible])
                rows.append(design[visible])
                sets += [name] * int(visible.sum())
    values = np.concatenate(quality).astype(float)
    hit = np.concatenate(repeated)
    design = np.concatenate(rows)
    held = np.zeros(len(hit))
    owner = np.array(sets)
    for name in SETS:
        held[owner == name] = design[owner == name] @ fitted(
            design[owner != name], hit[owner != name]
        )
    held = 100 / (1 + np.exp(-held))
    with (HERE / "tables" / "quality.csv").open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(
            [
                "quality_from",
                "quality_to",
                "minutiae",
                "found_again",
                "held_out_minutiae",
                "held_out_again",
            ]
        )
        for low, high in ((0, 60), (60, 70), (70, 80), (80, 90), (90, 95), (95, 101)):
            cells: list[object] = [low, high - 1]
            for score in (values, held):
                part = (score >= low) & (score < high)
                cells += [int(part.sum()), round(float(hit[part].mean()), 3) if part.any() else ""]
            table.writerow(cells)
        table.writerow(
            [
                "area under the curve",
                "",
                len(hit),
                round(area(values, hit), 3),
                len(hit),
                round(area(held, hit), 3),
            ]
        )
    print("weights:", np.round(fitted(design, hit), 3).tolist(), file=sys.stderr)


if __name__ == "__main__":
    main()
