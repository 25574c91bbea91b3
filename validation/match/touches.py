"""Eight touches of 5 mm, enrolled, against one: joined into one template, and each compared by itself.

    python validation/match/touches.py            # six sets of real prints; writes tables/touches.csv

Touches are a middle and a drawn window of each of a finger's first four impressions; probes are middle windows of its
others, impostors those of the other fingers of the set, two of each. Intervals draw fingers.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from fvc import REAL, Job, made, prints
from windows import equal_error, windows

from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.touches import join_touches

TABLE = Path(__file__).parent / "tables" / "touches.csv"
WAYS = ("joined", "best of eight", "sum of likelihoods")


def compared(name: str, number: int, job: Job) -> list[tuple[int, bool, int, list[float]]]:
    """Finger, whether it is one, touches joined, and a score of each of the ways."""
    images, owner, impression = prints(name, job)
    parts = {(n, which): part for n, mm, which, part in windows(images, number) if mm == 5}
    templates = {key: made(part, "template", job) for key, part in parts.items()}
    people, rows = sorted(set(owner)), []
    for who in people:
        enrolled = [n for n in range(len(owner)) if owner[n] == who and impression[n] < 4]
        touches = [templates[n, which] for n in enrolled for which in ("middle", "drawn")]
        whole, joined = join_touches(touches)
        sides = [Prepared(one) for one in touches]
        for other in people:
            theirs = [n for n in range(len(owner)) if owner[n] == other and impression[n] >= 4]
            for n in theirs[: 4 if other == who else 2]:
                probe = Prepared(templates[n, "middle"])
                single = [fused_match(probe, side).similarity for side in sides]
                together = float(np.logaddexp.reduce(single))
                scores = [fused_match(probe, Prepared(whole)).similarity, max(single), together]
                rows.append((number * 100 + people.index(who), other == who, joined, scores))
    return rows


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    parser.add_argument("--version", default="1")
    options = parser.parse_args()
    job = Job(options.cache, options.version)
    rows = [row for number, name in enumerate(REAL) for row in compared(name, number, job)]
    finger, same = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    joined = {row[0]: row[2] for row in rows}
    score = np.array([row[3] for row in rows])
    rng = np.random.default_rng(48)
    draws = [np.concatenate([np.flatnonzero(finger == one) for one in rng.choice(list(joined), len(joined))])
             for _ in range(500)]  # fmt: skip
    with TABLE.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("way", "genuine", "impostors", "equal_error_percent", "from", "to", "touches_joined"))
        for k, way in enumerate(WAYS):
            low, high = np.quantile([equal_error(score[some, k], same[some]) for some in draws], (0.025, 0.975))
            found = (round(equal_error(score[:, k], same), 1), round(float(low), 1), round(float(high), 1))
            writer.writerow((way, same.sum(), (~same).sum(), *found, sum(joined.values())))
            print(way, found, f"{sum(joined.values())} of {8 * len(joined)} joined")


if __name__ == "__main__":
    main()
