"""Eight touches of 5 mm, enrolled, against one: joined into one template, and each compared by itself.

    python validation/match/touches.py            # six sets of real prints; writes tables/touches.csv
    python validation/match/touches.py --covered  # how much of the probes the touches show

Probes are middle windows of a finger's last four impressions, impostors those of the other fingers of the set, two of
each. Touches are (*two of four*) a middle and a drawn window of each of the first four impressions; (*presses*) drawn
windows of the seven other impressions and a middle one of the first; (*ring*) windows of the seven at the middle and
on a ring of 2.5 mm about it, as a device that guides its user has them, and one more at the middle. Intervals draw
fingers.

``--losses`` says of genuine probes that score no higher than impostors what the touches show of them, and on how many
touches they were laid rightly, by the alignment of the whole prints.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fvc import REAL, Image, Job, made, prints
from windows import SURE, cut, equal_error, pose, ridges, square, windows

from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.touches import join_touches

TABLE = Path(__file__).parent / "tables" / "touches.csv"
WAYS = ("best of eight", "sum of likelihoods", "agreeing poses", "joined")
ENROLMENTS = ("two of four", "presses", "ring")
RING_MM = 2.5
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


def touch(images: list[Image], parts: dict[tuple[int, str], Image], n: int, place: str) -> Image:
    """A window of 5 mm of print n: around the middle, where it was drawn, or on a ring about the middle."""
    if place in ("middle", "drawn"):
        return parts[n, place]
    rows, columns = ridges(images[n])
    angle, radius = np.deg2rad(float(place)), RING_MM * 500 / 25.4
    return cut(images[n], rows.mean() + radius * np.sin(angle), columns.mean() + radius * np.cos(angle), 5)


def enrolment(how: str, own: list[int], probe: int) -> list[tuple[int, str]]:
    """Prints and places of the eight touches with which a probe, a print of the same finger, is compared."""
    if how == "two of four":
        return [(n, place) for n in own[:4] for place in ("middle", "drawn")]
    others = [n for n in own if n != probe]
    if how == "presses":
        return [*((n, "drawn") for n in others), (others[0], "middle")]
    return [(others[0], "middle"), *((n, str(60 * k)) for k, n in enumerate(others[1:])), (others[-1], "middle")]


def compared(name: str, number: int, job: Job, how: str) -> list[tuple[int, bool, int, list[float]]]:
    """Finger, whether it is one, touches joined, and a score of each of the ways."""
    images, owner, impression = prints(name, job)
    parts = {(n, which): part for n, mm, which, part in windows(images, number) if mm == 5}
    people, rows = sorted(set(owner)), []
    for who in people:
        own = [n for n in range(len(owner)) if owner[n] == who]
        probes = [n for n in own if impression[n] >= 4]
        enrolled = {n: enrolment(how, own, n) for n in probes}
        keys = sorted({key for touches in enrolled.values() for key in touches})
        sides = {key: Prepared(made(touch(images, parts, *key), "template", job)) for key in keys}
        among = {pair: fused_match(*(sides[key] for key in pair)) for pair in itertools.combinations(keys, 2)}
        whole: dict[tuple[tuple[int, str], ...], tuple[Prepared, int]] = {}
        for other in people:
            theirs = [n for n in range(len(owner)) if owner[n] == other and impression[n] >= 4]
            for n in theirs[: 4 if other == who else 2]:
                touches = enrolled.get(n, enrolled[probes[0]])
                probe = Prepared(made(parts[n, "middle"], "template", job))
                found = [fused_match(probe, sides[key]) for key in touches]
                single = [one.similarity for one in found]
                pairs = [(i, j) for i in range(8) for j in range(8) if (touches[i], touches[j]) in among]
                between = {(i, j): among[touches[i], touches[j]] for i, j in pairs}
                agreed = agreeing(found, between, [key[0] for key in touches])
                scores, joined = [max(single), float(np.logaddexp.reduce(single)), agreed], 0
                if how == "two of four":
                    if not whole:
                        template, joined = join_touches([sides[key].template for key in touches])
                        whole[tuple(touches)] = Prepared(template), joined
                    template, joined = whole[tuple(touches)]
                    scores.append(fused_match(probe, template).similarity)
                rows.append((number * 100 + people.index(who), other == who, joined, scores))
    return rows


def covered(name: str, number: int, job: Job, how: str) -> list[float]:
    """How much of genuine probes the touches show, mm2, by the alignment of the whole prints, where all are sure."""
    images, owner, impression = prints(name, job)
    parts = {(n, which): part for n, mm, which, part in windows(images, number) if mm == 5}
    wholes = [Prepared(made(image, "template", job)) for image in images]
    own: dict[tuple[int, str], Pose | None] = {}
    grid = np.arange(-2.375, 2.5, 0.25)
    points = (grid[None, :] + 1j * grid[:, None]).ravel()
    found = []

    def placed(key: tuple[int, str]) -> Pose | None:
        if key not in own:
            laid = fused_match(Prepared(made(touch(images, parts, *key), "template", job)), wholes[key[0]])
            own[key] = pose(laid.ridge) if laid.similarity >= SURE else None
        return own[key]

    for n in [n for n in range(len(owner)) if impression[n] >= 4]:
        mine = placed((n, "middle"))
        if mine is None:
            continue
        shown = np.zeros(points.shape, dtype=bool)
        for key in enrolment(how, [m for m in range(len(owner)) if owner[m] == owner[n]], n):
            whole, there = fused_match(wholes[n], wholes[key[0]]), placed(key)
            if whole.similarity >= SURE and there is not None:
                turn, shift = after(after(mine, pose(whole.ridge)), back(there))
                at = turn * points + shift
                shown |= (np.abs(at.real) < 2.5) & (np.abs(at.imag) < 2.5)
        found.append(float(shown.sum()) / 16)
    return found


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
    parser.add_argument("--enrol", choices=ENROLMENTS, nargs="+", default=list(ENROLMENTS))
    parser.add_argument("--covered", action="store_true", help="how much of the probes the touches show")
    options = parser.parse_args()
    job = Job(options.cache, options.version)
    for number, name in enumerate(REAL) if options.losses else ():
        losses(name, number, job)
    for how in options.enrol if options.covered else ():
        areas = np.array([one for number, name in enumerate(REAL) for one in covered(name, number, job, how)])
        below = ", ".join(f"{100 * np.mean(areas < limit):.0f} % below {limit}" for limit in (6, 10, 15))
        print(f"{how}: of {areas.size} probes {np.median(areas):.0f} mm2 are shown (median), {below}", flush=True)
    if not (options.losses or options.covered):
        write(job, options.enrol)


def write(job: Job, enrolments: list[str]) -> None:
    """Compare, print and write; rows of other enrolments stay."""
    head = ("enrolled", "way", "genuine", "impostors", "equal_error_percent", "from", "to", "touches_joined")
    kept = [row for row in csv.reader(TABLE.open()) if row[0] in ENROLMENTS and row[0] not in enrolments]
    for how in enrolments:
        rows = [row for number, name in enumerate(REAL) for row in compared(name, number, job, how)]
        finger, same = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
        joined = sum({row[0]: row[2] for row in rows}.values())
        score, people = np.array([row[3] for row in rows]), np.unique(finger)
        rng = np.random.default_rng(48)
        draws = [np.concatenate([np.flatnonzero(finger == one) for one in rng.choice(people, len(people))])
                 for _ in range(500)]  # fmt: skip
        for k, way in enumerate(WAYS[: score.shape[1]]):
            low, high = np.quantile([equal_error(score[some, k], same[some]) for some in draws], (0.025, 0.975))
            found = (round(equal_error(score[:, k], same), 1), round(float(low), 1), round(float(high), 1))
            kept.append([how, way, same.sum(), (~same).sum(), *found, joined if way == "joined" else ""])
            print(*kept[-1], flush=True)
    with TABLE.open("w", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([head, *kept])


if __name__ == "__main__":
    main()
