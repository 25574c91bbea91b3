"""Does a stated false match rate hold on fingers that did not set its threshold, and what does it
cost there?

    python validation/match/unseen.py --compare plain mirrored  # adds to the cache; an hour
    python validation/match/unseen.py  # unseen.json from what was compared; a minute
    python validation/match/unseen.py --write  # and the table of real impostors that ships

Every print of ``fvc.py``'s seven real sets against every other one, within sets and across them, by
the shipped matcher, whose constants were fitted on simulated presses. *Mirrored*: the same with one
side seen in a mirror, which makes another finger of each; *negative*: with the ridges of one side
light. The largest impostor scores follow a generalised Pareto distribution (Pickands 1975); a
threshold is the upper end of its interval of 95 %, drawing fingers. Each set in turn is left out
with its five fingers: its pairs are decided at the threshold of the six others. Intervals of 95 %
draw fingers. Hard sets: ``fvc2004_*``. Choices of the algorithm were made on all sets, so fingers
of another source can fail more often.

*Impressions*: a probe against 1, 2, 3 or 5 of the seven other impressions of its finger, all
choices counted; it is missed where none of them matches. *Of a finger*: at a smaller rate a
comparison, so that the stated one holds for all impressions of a finger together.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from math import comb
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from fvc import KNOWN, REAL, Job, features_of, prints
from impostors import ship
from numpy.typing import NDArray

from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.methods import fmr_table
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import inverted, mirrored

OUT = Path(__file__).resolve().parent / "unseen.json"
SETS = (*REAL, KNOWN)
FINGERS = 5
"""Fingers of a set."""
HARD = tuple(name for name in SETS if name.startswith("fvc2004"))
STATED = (1e-3, 1e-4)
REPLICATES = 1000
TAIL = 0.02
"""Fraction of impostors by which the tail is fitted; more of few, until they are a hundred."""
CHANGES = {
    "plain": lambda template: template,
    "mirrored": mirrored,
    "negative": inverted,
    "mirrored negative": lambda template: inverted(mirrored(template)),
}
"""Of one side."""
IMPRESSIONS = (1, 2, 3, 5)
Scores = NDArray[np.float64]


class Pairs(NamedTuple):
    """Compared pairs of prints."""

    a: NDArray[np.int64]
    """(N,) number of the finger, five a set."""
    b: NDArray[np.int64]
    print_a: NDArray[np.int64]
    print_b: NDArray[np.int64]
    similarity: Scores
    """(N,) minus infinity: a failure."""
    changed: NDArray[np.bool_]
    """(N,) whether one side is of another finger because it was changed."""

    @property
    def genuine(self) -> NDArray[np.bool_]:
        """(N,)."""
        return (self.a == self.b) & ~self.changed

    def taken(self, which: NDArray[np.bool_]) -> Pairs:
        """Some of them."""
        return Pairs(*(column[which] for column in self))

    def of_set(self, number: int) -> NDArray[np.bool_]:
        """(N,) whether a side is of a set."""
        return (self.a // FINGERS == number) | (self.b // FINGERS == number)

    def weight(self, drawn: Scores) -> Scores:
        """(N,) how often each is drawn with its fingers, of which ``drawn`` (F,) has the counts."""
        return np.where(self.a == self.b, drawn[self.a], drawn[self.a] * drawn[self.b])


def compare(job: Job, change: str) -> None:
    """Compare all prints of each two sets; what the cache holds is left out."""
    cv2.setNumThreads(1)
    folder = job.cache / "impostors"
    folder.mkdir(parents=True, exist_ok=True)
    templates, owners = [], []
    for name in SETS:
        images, owner, _ = prints(name, job)
        templates.append([features_of(image, "template", job) for image in images])
        everyone = sorted(set(owner))
        owners.append([everyone.index(each) for each in owner])
    sides = [[Prepared(template) for template in group] for group in templates]
    for x in range(len(SETS)):
        left = sides[x]
        if change != "plain":
            left = [Prepared(CHANGES[change](template)) for template in templates[x]]
        for y in range(x, len(SETS)):
            file = folder / f"{change}_{x}_{y}.npy"
            if file.is_file():
                continue
            rows = []
            for i, a in enumerate(left):
                for j, b in enumerate(sides[y]):
                    if x == y and (j < i or (j == i and change == "plain")):
                        continue
                    match = fused_match(a, b)
                    similarity = match.similarity if match.compared else np.nan
                    ends = x, y, owners[x][i], owners[y][j], i, j
                    rows.append((*ends, similarity, *match.evidence, match.ridge.overlap_mm2))
            part = folder / f"part_{file.name}"
            np.save(part, np.array(rows))
            part.replace(file)
            print(file.stem, len(rows), flush=True)


def compared(cache: Path, changes: list[str]) -> Pairs:
    """Pairs of the cache."""
    parts = []
    for change in changes:
        for file in sorted((cache / "impostors").glob(f"{change}_?_?.npy")):
            x, y, a, b, i, j, similarity = np.load(file).T[:7]
            changed = np.full(len(x), change != "plain")
            ends = [x * FINGERS + a, y * FINGERS + b, x * 100 + i, y * 100 + j]
            similarity = np.nan_to_num(similarity, nan=-np.inf)
            parts.append((*(end.astype(np.int64) for end in ends), similarity, changed))
    return Pairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class Tail(NamedTuple):
    """Impostor scores above ``start``: a fraction of all, distributed as a generalised Pareto."""

    start: float
    fraction: float
    shape: float
    scale: float

    def threshold(self, fmr: float) -> float:
        """Where the rate is ``fmr``."""
        stretch = np.log(self.fraction / fmr)
        if abs(self.shape) > 1e-6:
            stretch = np.expm1(self.shape * stretch) / self.shape
        return float(self.start + self.scale * stretch)


def fitted_tail(scores: Scores, weight: Scores, start: float) -> Tail:
    """By the largest likelihood; its profile over shape / scale (Grimshaw 1993)."""
    above = (scores > start) & (weight > 0)
    beyond, part = scores[above] - start, weight[above] / weight[above].sum()
    mean, largest = float(part @ beyond), float(beyond.max())
    ratio = np.concatenate(
        [-np.geomspace(0.95, 1e-4, 60) / largest, np.geomspace(1e-4, 3, 60) / mean]
    )
    shape = np.log1p(ratio[:, None] * beyond) @ part
    scale = shape / ratio
    likelihood = np.where(shape > -0.5, -np.log(scale) - shape, -np.inf)
    best = int(likelihood.argmax())
    fraction = float(weight[above].sum() / weight.sum())
    return Tail(start, fraction, float(shape[best]), float(scale[best]))


def drawn_fingers(pairs: Pairs) -> Iterator[Scores]:
    """Counts (F,) of the fingers of `pairs`, as often as replicates are drawn."""
    fingers = np.unique(np.concatenate([pairs.a, pairs.b]))
    rng = np.random.default_rng(0)
    for _ in range(REPLICATES):
        drawn = np.zeros(fingers.max() + 1)
        np.add.at(drawn, rng.choice(fingers, len(fingers)), 1)
        yield drawn


def thresholds(impostors: Pairs, rates: Sequence[float]) -> tuple[Tail, list[float]]:
    """The tail, and for each rate the upper end of the interval of 95 % of its threshold."""
    impostors = impostors.taken(np.argsort(-impostors.similarity))
    scores = impostors.similarity
    share = max(TAIL, 100 / len(scores))
    likely = int(share * len(scores))
    start = float(scores[likely])
    few = impostors.taken(np.arange(len(scores)) < likely)
    high = np.array([rate for rate in rates if rate >= share])
    ends = []
    for drawn in drawn_fingers(impostors):
        weight = impostors.weight(drawn)
        tail = fitted_tail(few.similarity, weight[:likely], start)
        tail = tail._replace(fraction=float(weight[:likely].sum() / weight.sum()))
        below = np.searchsorted(np.cumsum(weight) / weight.sum(), high)
        quantiles = scores[np.minimum(below, len(scores) - 1)].tolist()
        ends.append(quantiles + [tail.threshold(rate) for rate in rates if rate < share])
    own = fitted_tail(few.similarity, np.ones(likely), start)
    return own._replace(fraction=share), np.quantile(ends, 0.975, axis=0).tolist()


def table(impostors: Pairs, what: str, by: str) -> dict[str, Any]:
    """What the matcher reads: rates, and the similarities at which they surely hold."""
    count = len(impostors.a)
    rates = np.append(np.geomspace(0.5, 1 / (count + 1), 64), STATED)
    rates = np.sort(rates[rates >= 1 / (count + 1)])[::-1]
    similarity = np.maximum.accumulate(thresholds(impostors, rates.tolist())[1])
    lowest = float(impostors.similarity.min())
    return {
        "what": what,
        "by": by,
        "impostors": count,
        "similarity": np.round([lowest, *similarity], 5).tolist(),
        "fmr": [float(f"{rate:.3g}") for rate in (1.0, *rates)],
    }


def interval(count: Scores, total: Scores) -> list[float]:
    """Rate in percent and its interval, drawing fingers; counts of each."""
    drawn = np.random.default_rng(0).integers(len(count), size=(2 * REPLICATES, len(count)))
    ends = np.quantile(count[drawn].sum(1) / np.maximum(total[drawn].sum(1), 1), [0.025, 0.975])
    return [round(100 * float(each), 3) for each in (count.sum() / total.sum(), *ends)]


def false_matches(pairs: Pairs, accepted: NDArray[np.bool_]) -> dict[str, Any]:
    """Of impostor pairs: rate in percent with its interval, drawing the fingers of both sides."""
    wrong = pairs.taken(accepted)
    shares = [
        wrong.weight(drawn).sum() / pairs.weight(drawn).sum() for drawn in drawn_fingers(pairs)
    ]
    ends = np.quantile(shares, [0.025, 0.975])
    return {
        "impostors": len(pairs.a),
        "false_matches": int(accepted.sum()),
        "fmr": [float(f"{100 * each:.3g}") for each in (accepted.mean(), *ends)],
    }


def misses(pairs: Pairs, threshold: dict[int, float], sets: list[int], most: int) -> list[float]:
    """FNMR of some sets with its interval, where a probe is compared with `most` of the other
    impressions of its finger."""
    missed, total = [], []
    for finger in [number * FINGERS + k for number in sets for k in range(FINGERS)]:
        own = pairs.taken(pairs.genuine & (pairs.a == finger))
        accepted = own.similarity >= threshold[finger // FINGERS]
        probes = np.unique(np.concatenate([own.print_a, own.print_b]))
        lost = 0.0
        for probe in probes:
            seen = (own.print_a == probe) | (own.print_b == probe)
            low = int((~accepted & seen).sum())
            lost += comb(low, most) / comb(int(seen.sum()), most)
        missed.append(lost)
        total.append(len(probes))
    return interval(np.array(missed), np.array(total))


def blamed(missed: Pairs) -> dict[str, int]:
    """Impressions that have a part in all misses, each the commonest of those that are left."""
    counts = {}
    left = list(zip(missed.print_a.tolist(), missed.print_b.tolist(), strict=True))
    while left:
        (worst, count), *_ = Counter(each for pair in left for each in pair).most_common(1)
        number, place = divmod(worst, 100)
        counts[f"{SETS[number]} {101 + place // 8}_{place % 8 + 1}"] = count
        left = [pair for pair in left if worst not in pair]
    return counts


def report(pairs: Pairs) -> dict[str, Any]:
    """Every figure."""
    impostors = pairs.taken(~pairs.genuine)
    numbers = list(range(len(SETS)))
    hard = [SETS.index(name) for name in HARD]
    groups = {
        "all": numbers,
        "hard": hard,
        "others": [number for number in numbers if number not in hard],
    }
    tail, ends = thresholds(impostors, STATED)
    facts: dict[str, Any] = {
        "impostors": len(impostors.a),
        "tail": {name: round(value, 4) for name, value in tail._asdict().items()},
        "thresholds": [
            {"fmr": rate, "fit": round(tail.threshold(rate), 3), "end": round(end, 3)}
            for rate, end in zip(STATED, ends, strict=True)
        ],
        "at": {},
        "sets": {name: {} for name in SETS},
    }
    stated = [rate / most for rate in STATED for most in IMPRESSIONS]
    left_out = [thresholds(impostors.taken(~impostors.of_set(k)), stated)[1] for k in numbers]
    for rate in STATED:
        unseen = [
            dict(zip(numbers, (ends[stated.index(rate / most)] for ends in left_out), strict=True))
            for most in IMPRESSIONS
        ]
        kinds = {
            "unseen": unseen[0],
            "shipped": dict.fromkeys(numbers, fmr_table("fusion").threshold(rate)),
        }
        row = facts["at"][f"{rate:g}"] = {}
        for kind, threshold in kinds.items():
            row[kind] = {
                name: {f"fnmr_{k}": misses(pairs, threshold, group, k) for k in IMPRESSIONS}
                for name, group in groups.items()
            }
            accepted = impostors.similarity >= np.minimum(
                *(np.array([threshold[k] for k in side // FINGERS]) for side in impostors[:2])
            )
            row[kind]["all"] |= false_matches(impostors, accepted)
            row[kind]["all"]["of_them_mirrored"] = int((accepted & impostors.changed).sum())
        needed = np.array([unseen[0][k] for k in pairs.a // FINGERS])
        row["missed_with"] = blamed(pairs.taken(pairs.genuine & (pairs.similarity < needed)))
        row["unseen, of a finger"] = {
            name: {
                f"fnmr_{most}": misses(pairs, threshold, group, most)
                for most, threshold in zip(IMPRESSIONS, unseen, strict=True)
            }
            for name, group in groups.items()
        }
        for number, name in enumerate(SETS):
            own = impostors.taken(impostors.of_set(number))
            threshold = kinds["unseen"][number]
            facts["sets"][name][f"{rate:g}"] = {
                "threshold": round(threshold, 3),
                **{f"fnmr_{k}": misses(pairs, kinds["unseen"], [number], k) for k in IMPRESSIONS},
                "impostors": len(own.a),
                "false_matches": int((own.similarity >= threshold).sum()),
                "largest_impostor": round(float(own.similarity.max()), 2),
            }
    return facts


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--compare", nargs="+", choices=list(CHANGES), default=[])
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    for change in options.compare:
        compare(Job(options.cache), change)
    pairs = compared(options.cache, ["plain", "mirrored"])
    if options.write:
        what = "pairs of prints of 35 real fingers on seven sensors, and in a mirror"
        ship("fusion", table(pairs.taken(~pairs.genuine), what, "validation/match/unseen.py"))
    facts = report(pairs)
    OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
