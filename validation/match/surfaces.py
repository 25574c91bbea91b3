"""Surfaces against presses: false match rates of prints that nothing touched, and what is missed.

    python validation/match/surfaces.py --work FOLDER --write    # 100 fingers; ten minutes

True surfaces of simulated fingers, in poses drawn from the twin's ranges, are unrolled as
``splitknit print`` does and compared with presses of the same and of all other fingers, and with
each other. Thresholds are upper ends, as ``unseen.py`` has them. Writes
``match_fmr_contactless*.json`` beside ``splitknit_match.matching.methods``, and
``tables/surfaces.csv``. FOLDER keeps the prints.
"""

from __future__ import annotations

import argparse
import itertools
import pickle
from pathlib import Path

import cv2
import numpy as np
from impostors import FINE, ship
from numpy.typing import NDArray
from pressed_prints import SENSORS, press
from unseen import Pairs, table

from splitknit.io.csv_table import csv_text
from splitknit_match.evaluation.rates import roc
from splitknit_match.matching.inputs import print_of_surface, print_template
from splitknit_match.matching.methods import (
    Compared,
    compare_templates,
    fmr_table,
)
from splitknit_match.matching.ridge import Prepared
from splitknit_simulator.finger.finger import draw_finger

OUT = Path(__file__).parent / "tables" / "surfaces.csv"
SEED = 53_000
Image = NDArray[np.uint8]


def prints(number: int, work: Path) -> tuple[Image, Image]:
    """A finger's surface, unrolled, and a press of it."""
    file = work / f"finger_{number}.pickle"
    if not file.is_file():
        seed = SEED + number
        sensor = SENSORS[list(SENSORS)[number % len(SENSORS)]]
        made = print_of_surface(FINE(seed)), press(draw_finger(seed).master(), number, sensor)
        file.write_bytes(pickle.dumps(made))
        print(number, end=" ", flush=True)
    kept: tuple[Image, Image] = pickle.loads(file.read_bytes())
    return kept


def rows_of(name: str, impostors: list[Compared], genuine: list[Compared]) -> list[object]:
    """A row of the table: how many, the most similar impostor, and who is missed at the smallest
    rate that was measured."""
    scores = np.array([pair.similarity for pair in impostors if pair.compared])
    kept = [pair for pair in genuine if pair.compared]
    answers = [pair.rated(None).answer for pair in genuine]
    own = np.array([pair.similarity for pair in kept])
    return [
        name,
        len(scores),
        round(float(np.median(scores)), 2),
        round(float(scores.max()), 2),
        round(fmr_table(name).threshold(fmr_table(name).smallest), 2),
        len(genuine),
        answers.count("match"),
        answers.count("undecided"),
        "" if not kept else round(100 * roc(own, scores).equal_error().value, 1),
        sum(pair.rated(None).answer == "match" for pair in impostors),
    ]


HEADER = [
    "rates", "impostors", "median", "most_similar", "threshold", "genuine", "matched", "undecided",
    "eer_percent", "false_matches",
]  # fmt: skip


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=100)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.work.mkdir(parents=True, exist_ok=True)
    images = [prints(number, options.work) for number in range(options.fingers)]
    surfaces = [Prepared(print_template(image, kind="contactless")) for image, _ in images]
    presses = [Prepared(print_template(image)) for _, image in images]
    fingers = range(options.fingers)
    unrolled = f"unrolled surfaces of {options.fingers} simulated fingers"
    rows: list[list[object]] = []
    every = [(i, j) for i in fingers for j in fingers]
    sides_of = {
        "contactless and prints": (f"{unrolled}, against presses", presses, every),
        "contactless alone": (unrolled, surfaces, [*itertools.combinations(fingers, 2)]),
    }
    pairs: dict[str, tuple[list[Compared], list[Compared]]] = {}
    for name, (what, others, chosen) in sides_of.items():
        genuine, impostors, ends = [], [], []
        for i, j in chosen:
            pair = compare_templates("fusion", surfaces[i], others[j])
            if pair.scores != name:
                continue
            (genuine if i == j else impostors).append(pair)
            if i != j and pair.compared:
                ends.append((i, j, pair.similarity))
        pairs[name] = impostors, genuine
        if options.write:
            a, b, similarity = np.array(ends).T
            none = np.zeros(len(a), bool)
            fingers = a.astype(int), b.astype(int)
            by = "validation/match/surfaces.py --write"
            ship(name, table(Pairs(*fingers, *fingers, similarity, none), what, by))
        print(name, len(impostors), flush=True)
    for name, (own, genuine) in pairs.items():
        rows.append(rows_of(name, own, genuine))
        print(dict(zip(HEADER, rows[-1], strict=True)), flush=True)
    if options.write:
        OUT.write_text(csv_text([HEADER, *rows]), encoding="utf-8")


if __name__ == "__main__":
    main()
