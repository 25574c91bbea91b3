"""How probably will a print match another impression of its finger, as large as it is?

    python validation/match/matchability.py --compare  # adds to the cache; ten minutes
    python validation/match/matchability.py  # matchability.json beside this file; a minute

*Whole*: all pairs of impressions of a finger; *windows*: those of ``windows.py``, of one size, of
different impressions; *touches*: those of its ``--sensors``. A pair matches as ``match`` decides by
default. The chance is a logistic regression on one side alone, so that every pair counts twice, and
every size the same; each set is judged by the six others, touches by windows and whole prints.
Intervals of 95 % draw fingers. The rates of small prints, by which is decided, were measured on the
same prints.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fvc import Job, features_of, logistic, prints
from numpy.typing import NDArray
from unseen import interval
from windows import ENROLLED, SENSORS_PX, SETS, SIZES_MM, touches, windows

from splitknit_match.matching.methods import compare_templates, rate
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template

OUT = Path(__file__).resolve().parent / "matchability.json"
SETS_FINGERS = 5
TOUCHES_MM = -1
"""In place of a window's side; 0: whole prints."""
BINS = 5
Rows = NDArray[np.float64]
"""(N, 6) of a print in a pair: side of the window in mm, finger, number of the print, whether the
pair matches, and what is known of the print."""


def known(template: Template) -> tuple[float, float]:
    """Logarithm of the area in mm2, and root of how many minutiae another print should show."""
    quality = 0.0 if template.minutiae is None else float(template.minutiae.quality.sum())
    return float(np.log(max(template.area_mm2, 1.0))), float(np.sqrt(quality / 100))


def compare(job: Job) -> None:
    """Compare whole prints, and windows of one size; what the cache holds is left out."""
    cv2.setNumThreads(1)
    for number, name in enumerate(SETS):
        file = job.cache / f"matchability_{number}.npy"
        if file.is_file():
            continue
        images, owner, _ = prints(name, job)
        parts = [(n, mm, image) for n, mm, _, image in windows(images, number)]
        parts += [(n, 0, image) for n, image in enumerate(images)]
        fingers = sorted(set(owner))
        rows = []
        for mm, finger in itertools.product((0, *SIZES_MM), range(SETS_FINGERS)):
            sides = [
                (k, n, Prepared(features_of(image, "template", job)))
                for k, (n, size, image) in enumerate(parts)
                if size == mm and owner[n] == fingers[finger]
            ]
            for (i, n, a), (j, m, b) in itertools.combinations(sides, 2):
                if n != m:
                    match = compare_templates("fusion", a, b).rated(None).answer == "match"
                    about = mm, number * SETS_FINGERS + finger
                    rows += [(*about, i, match, *known(a.template))]
                    rows += [(*about, j, match, *known(b.template))]
        np.save(file, np.array(rows))
        print(name, len(rows), flush=True)


def of_touches(job: Job) -> Rows:
    """Pairs of touches that ``windows.py --sensors`` compared."""
    rows = []
    for number in range(len(SENSORS_PX)):
        compared = np.load(job.cache / f"sensor_{number}.npy")
        enrolled, _, _ = touches(job, number)
        own = compared[compared[:, 0] == compared[:, 1]]
        for k, (finger, _, _, score, overlap_mm2) in enumerate(own.tolist()):
            match = rate(score, "windows", overlap_mm2).answer == "match"
            side = number * ENROLLED + k % ENROLLED
            about = TOUCHES_MM, finger, side, match
            rows.append((*about, *known(enrolled[int(finger)][k % ENROLLED])))
    return np.array(rows)


def fitted(rows: Rows) -> NDArray[np.float64]:
    """Weights of what is known, and the offset; all sizes count the same."""
    _, size, count = np.unique(rows[:, 0], return_inverse=True, return_counts=True)
    weight = 1 / (count[size] * len(count))
    x = np.column_stack([rows[:, 4:], np.ones(len(rows))])
    return logistic(x, rows[:, 3] == 1, weight)


def chance(rows: Rows, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) of a match."""
    return 1 / (1 + np.exp(-np.column_stack([rows[:, 4:], np.ones(len(rows))]) @ weights))


def by_finger(rows: Rows, hits: NDArray[np.bool_]) -> list[float]:
    """Rate in percent with its interval."""
    finger = rows[:, 1].astype(int)
    counts = (
        np.bincount(finger, each, minlength=len(SETS) * SETS_FINGERS) for each in (hits, None)
    )
    return interval(*counts)


def figures(rows: Rows, predicted: NDArray[np.float64]) -> dict[str, Any]:
    """Predicted and observed matches in five bins of the prints, and misses without the worst
    bin."""
    match = rows[:, 3] == 1
    parts = np.array_split(np.argsort(predicted, kind="stable"), BINS)
    rest = np.concatenate(parts[1:])
    _, side = np.unique(rows[:, [0, 1, 2]], axis=0, return_inverse=True)
    own = (np.bincount(side.ravel(), match) / np.bincount(side.ravel()))[side.ravel()]
    best = np.argsort(own, kind="stable")[len(parts[0]) :]
    return {
        "comparisons": len(rows),
        "bins": [
            {
                "predicted": round(100 * float(predicted[part].mean()), 1),
                "observed": by_finger(rows[part], match[part]),
            }
            for part in parts
        ],
        "missed": by_finger(rows, ~match),
        "missed_without_worst_fifth": by_finger(rows[rest], ~match[rest]),
        "missed_without_those_that_matched_least": by_finger(rows[best], ~match[best]),
    }


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    options = parser.parse_args()
    job = Job(options.cache)
    if options.compare:
        compare(job)
    rows = np.concatenate(
        [np.load(job.cache / f"matchability_{number}.npy") for number in range(len(SETS))]
    )
    rows = np.concatenate([rows, of_touches(job)])
    number = rows[:, 1] // SETS_FINGERS
    predicted = np.zeros(len(rows))
    for each in range(len(SETS)):
        others = rows[(number != each) & (rows[:, 0] >= 0)]
        predicted[number == each] = chance(rows[number == each], fitted(others))
    mm = rows[:, 0]
    kinds = {"whole": mm == 0, "windows": mm > 0, "touches": mm == TOUCHES_MM}
    kinds |= {f"windows of {size} mm": mm == size for size in SIZES_MM}
    facts: dict[str, Any] = {"weights": np.round(fitted(rows[mm >= 0]), 3).tolist()}
    facts |= {kind: figures(rows[part], predicted[part]) for kind, part in kinds.items()}
    facts["sets"] = {
        name: {
            kind: [
                round(100 * float(each[(number == k) & kinds[kind]].mean()), 1)
                for each in (predicted, rows[:, 3])
            ]
            for kind in ("whole", "windows", "touches")
        }
        for k, name in enumerate(SETS)
    }
    OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
