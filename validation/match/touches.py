"""Eight touches of 5 mm, enrolled, against one: joined into one template, and each compared by itself.

    python validation/match/touches.py            # six sets of real prints; writes tables/touches.csv

Touches are a middle and a drawn window of each of a finger's first four impressions; probes are middle windows of its
others, impostors those of the other fingers of the set, two of each. Intervals draw fingers.

``--losses`` says of genuine probes that score no higher than impostors what the touches show of them, and on how many
touches they were laid rightly, by the alignment of the whole prints.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fvc import REAL, Job, made, prints
from windows import SURE, equal_error, pose, square, windows

from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.touches import join_touches

TABLE = Path(__file__).parent / "tables" / "touches.csv"
WAYS = ("joined", "best of eight", "sum of likelihoods", "agreeing poses")
NEAR_MM, NEAR_DEG = 0.6, 10.0
"""Of two alignments that agree."""
Pose = tuple[complex, complex]


def after(first: Pose, second: Pose) -> Pose:
    """One pose after another."""
    return first[0] * second[0], second[0] * first[1] + second[1]


def back(one: Pose) -> Pose:
    """The pose the other way round."""
    return 1 / one[0], -one[1] / one[0]


def near(one: Pose, other: Pose, mm: float, deg: float) -> bool:
    """Whether two poses agree."""
    return abs(np.rad2deg(np.angle(one[0] / other[0]))) < deg and abs(one[1] - other[1]) < mm


def agreeing(found: list[Any], among: dict[tuple[int, int], Any], press: list[int]) -> float:
    """The best score of a touch, and of every other press half of what its best agreeing touch has above -4.

    Touches agree if the probe, laid on one and then by it on the other, comes to lie where it was laid on that.
    `found`: matches of the probe with the touches, `among`: those of the touches with each other.
    """
    best = max(one.similarity for one in found)
    for i, one in enumerate(found):
        by_press: dict[int, float] = {}
        for j, other in enumerate(found):
            between = among.get((i, j)) or among.get((j, i))
            if press[i] == press[j] or not (one.ridge.compared and other.ridge.compared and between.ridge.compared):
                continue
            step = pose(between.ridge) if (i, j) in among else back(pose(between.ridge))
            if near(after(pose(one.ridge), step), pose(other.ridge), NEAR_MM, NEAR_DEG):
                by_press[press[j]] = max(by_press.get(press[j], 0.0), 0.5 * (max(other.similarity, -3.0) + 4.0))
        best = max(best, one.similarity + sum(by_press.values()))
    return best


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
        press = [n for n in enrolled for _ in ("middle", "drawn")]
        among = {(i, j): fused_match(sides[i], sides[j]) for i in range(len(sides)) for j in range(i)}
        for other in people:
            theirs = [n for n in range(len(owner)) if owner[n] == other and impression[n] >= 4]
            for n in theirs[: 4 if other == who else 2]:
                probe = Prepared(templates[n, "middle"])
                found = [fused_match(probe, side) for side in sides]
                single = [one.similarity for one in found]
                together, agreed = float(np.logaddexp.reduce(single)), agreeing(found, among, press)
                scores = [fused_match(probe, Prepared(whole)).similarity, max(single), together, agreed]
                rows.append((number * 100 + people.index(who), other == who, joined, scores))
    return rows


def losses(name: str, number: int, job: Job, limit: float = 1.8) -> None:
    """Print one set's genuine probes whose best score is below `limit`."""
    images, owner, impression = prints(name, job)
    wholes = [Prepared(made(image, "template", job)) for image in images]
    parts = {(n, which): part for n, mm, which, part in windows(images, number) if mm == 5}
    own, sides = {}, {}
    for key, part in parts.items():
        sides[key] = Prepared(made(part, "template", job))
        own[key] = pose(fused_match(sides[key], wholes[key[0]]).ridge)
    for n in [n for n in range(len(owner)) if impression[n] >= 4]:
        touches = [(m, which) for m in range(len(owner)) if owner[m] == owner[n] and impression[m] < 4
                   for which in ("middle", "drawn")]  # fmt: skip
        found = {key: fused_match(sides[n, "middle"], sides[key]) for key in touches}
        best = max(one.similarity for one in found.values())
        if best >= limit:
            continue
        if not any(one.ridge.compared for one in found.values()):
            print(f"{owner[n]} {impression[n] + 1}: not acquired")
            continue
        right, shown = 0, []
        for key, one in found.items():
            whole = fused_match(wholes[n], wholes[key[0]])
            if whole.similarity >= SURE:
                true = after(after(own[n, "middle"], pose(whole.ridge)), back(own[key]))
                right += near(pose(one.ridge), true, 1.0, 15.0)
                shown.append(cv2.intersectConvexConvex(square(5, true), square(5))[0])
        most = max(shown, default=0.0)
        print(f"{owner[n]} {impression[n] + 1}: {best:.1f}, {most:.0f} mm2 on one touch, {right} laid rightly")


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    parser.add_argument("--version", default="1")
    parser.add_argument("--losses", action="store_true")
    options = parser.parse_args()
    job = Job(options.cache, options.version)
    if options.losses:
        for number, name in enumerate(REAL):
            losses(name, number, job)
        return
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
