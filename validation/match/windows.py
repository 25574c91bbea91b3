"""Small prints: square windows of real prints against whole prints and against each other, by what
overlaps.

    python validation/match/windows.py --compare 24000  # adds to the cache, in a fixed order
    python validation/match/windows.py  # fits, rates and tables from what was compared
    python validation/match/windows.py --write  # and writes what the matcher ships
    python validation/match/windows.py --sensors --write  # small sensors, eight touches; 15 minutes

Windows of 4 to 10 mm are cut from every print of ``fvc.py``'s seven real sets: one around the
middle of its ridges, one where it is drawn. *Whole*: a window against a whole print of the same
sensor, of another finger or of the same one. *Touches*: middle windows of the first four
impressions of each finger against each other. Evidence is kept, so that constants and false match
rates follow from one run: every set is judged by constants fitted on the six others.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fvc import KNOWN, REAL, Image, Job, features_of, logistic, prints, turned
from impostors import FOLDER, at_least, ship
from numpy.typing import NDArray
from scipy.stats import binomtest
from unseen import Pairs, table, thresholds

from splitknit_match.evaluation.rates import roc
from splitknit_match.matching import fusion
from splitknit_match.matching.fusion import SMALL_MM2, fused_match
from splitknit_match.matching.methods import TABLES, fmr_table
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template

HERE = Path(__file__).resolve().parent
OUT = HERE / "windows.json"
SETS = (*REAL, KNOWN)
SIZES_MM = (4, 5, 6, 8, 10)
SEED = 48
WHOLE = 0
"""Kind of a comparison: a window with a whole print."""
TOUCHES = 1
"""Kind of a comparison: a window with another window."""
PRINTS = 2
"""Kind of a comparison: whole prints."""
RATED_MM2 = 6.0
"""Overlap from which on rates are stated."""
EXCLUDED_MM2 = 40.0
"""Overlap from which on nine of ten genuine pairs pass (see ``by_overlap``)."""
MIXED_COUNT = 5600
"""Comparisons of all sets in turn, genuine and impostor."""
IMPOSTOR_COUNT = 2800
"""Further comparisons, of impostors alone."""


def windows(images: list[Image], number: int) -> list[tuple[int, int, str, Image]]:
    """Of each print and size a window around the middle, and a drawn one: print, mm, which,
    pixels."""
    rng = np.random.default_rng([SEED, number])
    crops = []
    for n, image in enumerate(images):
        rows, columns = ridges(image)
        middle = rows.mean(), columns.mean()
        for mm in (*SIZES_MM, 13):
            for which in ("middle", "drawn"):
                y, x = middle
                if which == "drawn":
                    k = rng.integers(len(rows))
                    y, x = y + 0.6 * (rows[k] - y), x + 0.6 * (columns[k] - x)
                crops.append((n, mm, which, cut(image, y, x, mm)))
    return [crop for crop in crops if crop[1] in SIZES_MM]


def ridges(image: Image) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of pixels that lie on ridges."""
    detail = image.astype(np.float32) - cv2.GaussianBlur(image.astype(np.float32), (0, 0), 6)
    spread = cv2.GaussianBlur(detail * detail, (0, 0), 12)
    rows, columns = np.nonzero(spread > 0.25 * np.quantile(spread, 0.95))
    return rows, columns


def cut(image: Image, y: float, x: float, mm: float) -> Image:
    """A square window about a place, moved into the print."""
    side = round(mm * 500 / 25.4)
    top = int(np.clip(round(y - side / 2), 0, max(0, image.shape[0] - side)))
    left = int(np.clip(round(x - side / 2), 0, max(0, image.shape[1] - side)))
    return np.ascontiguousarray(image[top : top + side, left : left + side])


@dataclass(frozen=True, slots=True)
class Task:
    """One comparison: kind, set, size, whether of one finger, the window, and the other's
    number."""

    kind: int
    number: int
    mm: int
    same: bool
    window: tuple[int, int, str]
    reference: int


def tasks(number: int, owner: list[str], impression: list[int], count: int) -> list[Task]:
    """Of a set, in the order in which they are compared: touches between windows against whole
    prints."""
    rng = np.random.default_rng([SEED, number, 1])
    everyone = np.array(owner)
    whole = []
    for k in range(count):
        n = int(rng.integers(len(owner)))
        mm = int(rng.choice(SIZES_MM))
        which = str(rng.choice(["middle", "drawn"]))
        same = k % 5 == 4
        others = [m for m in np.flatnonzero((everyone == owner[n]) == same).tolist() if m != n]
        whole.append(Task(WHOLE, number, mm, same, (n, mm, which), int(rng.choice(others))))
    few = [n for n in range(len(owner)) if impression[n] < 4]
    touches = [
        Task(TOUCHES, number, mm, owner[i] == owner[j], (i, mm, "middle"), j)
        for i, j in itertools.combinations(few, 2)
        for mm in (4, 5, 6, 8)
    ]
    order = rng.permutation(len(touches))
    spread = np.argsort(
        np.concatenate([np.arange(count) / count, np.arange(len(touches)) / len(touches)]),
        kind="stable",
    )
    both = whole + [touches[k] for k in order]
    return [both[k] for k in spread]


def first(todo: list[list[Task]]) -> list[Task]:
    """The tasks of all sets in turn."""
    return [task for group in itertools.zip_longest(*todo) for task in group if task][:MIXED_COUNT]


def second(owners: list[list[str]]) -> list[Task]:
    """More impostors: drawn windows, each against four whole prints of other fingers."""
    rng = np.random.default_rng([SEED, 2])
    chosen = []
    for k in range(IMPOSTOR_COUNT // 4):
        number = k % len(owners)
        owner = np.array(owners[number])
        n = int(rng.integers(len(owner)))
        mm = int(rng.choice(SIZES_MM))
        which = str(rng.choice(["middle", "drawn"]))
        others = rng.choice(np.flatnonzero(owner != owner[n]), 4, replace=False)
        chosen += [
            Task(WHOLE, number, mm, False, (n, mm, which), int(reference)) for reference in others
        ]
    return chosen


def compare(job: Job, most: int) -> None:
    """Compare the next tasks, in turn of every set; evidence is kept as it comes."""
    file = job.cache / "windows.npy"
    known = np.load(file) if file.is_file() else np.zeros((0, 11))
    todo = []
    sides: dict[tuple[int, Any], Prepared] = {}
    owners: list[list[str]] = []
    kept: list[tuple[list[Image], dict[tuple[int, int, str], Image]]] = []
    for number, name in enumerate(SETS):
        images, owner, impression = prints(name, job)
        kept.append(
            (images, {(n, mm, which): part for n, mm, which, part in windows(images, number)})
        )
        owners.append(owner)
        todo.append(tasks(number, owner, impression, 2500))

    def side(number: int, key: Any) -> Prepared:
        if (number, key) not in sides:
            image = kept[number][0][key] if isinstance(key, int) else kept[number][1][key]
            sides[number, key] = Prepared(features_of(image, "template", job))
        return sides[number, key]

    rows = []
    begun = time.monotonic()
    for task in [*first(todo), *second(owners), *third(owners)][len(known) : most]:
        reference = task.reference if task.kind != TOUCHES else (task.reference, task.mm, "middle")
        own = task.window[0] if task.kind == PRINTS else task.window
        match = fused_match(side(task.number, own), side(task.number, reference))
        rows.append(
            (
                task.kind,
                task.number,
                task.mm,
                task.same,
                task.window[0],
                task.reference,
                *match.evidence,
                match.ridge.overlap_mm2,
            )
        )
        # turned windows are large
        for key in [key for key in sides if not isinstance(key[1], int)][:-50]:
            del sides[key]
        if len(rows) % 250 == 0:
            np.save(file, np.concatenate([known, np.array(rows, dtype=np.float64)]))
            print(
                f"{len(known) + len(rows)} comparisons, {time.monotonic() - begun:.0f} s",
                flush=True,
            )
    if rows:
        np.save(file, np.concatenate([known, np.array(rows, dtype=np.float64)]))


def third(owners: list[list[str]]) -> list[Task]:
    """All pairs of whole prints of each set."""
    return [
        Task(PRINTS, number, 0, owner[i] == owner[j], (i, 0, ""), j)
        for number, owner in enumerate(owners)
        for i, j in itertools.combinations(range(len(owner)), 2)
    ]


@dataclass(frozen=True, slots=True)
class Constants:
    """Of the score: without minutiae, and with."""

    overlap: NDArray[np.float64]
    both: NDArray[np.float64]


def fitted(rows: NDArray[np.float64]) -> Constants:
    """Logistic regressions on windows, both classes of equal weight."""
    rows = rows[(rows[:, 0] != PRINTS) & ~np.isnan(rows[:, 7])]
    fraction, correlation, overlap, same = rows[:, 6], rows[:, 7], rows[:, 9], rows[:, 3] == 1
    grown = correlation * np.sqrt(np.minimum(overlap, SMALL_MM2))
    weights = []
    for known, columns in (
        (np.isnan(fraction), [correlation, grown]),
        (~np.isnan(fraction), [fraction, correlation, grown]),
    ):
        x = np.stack([*(column[known] for column in columns), np.ones(known.sum())], axis=1)
        label = same[known]
        weights.append(
            np.round(
                logistic(x, label, np.where(label, 0.5 / label.sum(), 0.5 / (~label).sum())), 4
            )
        )
    return Constants(*weights)


def scored(rows: NDArray[np.float64], by: Constants) -> NDArray[np.float64]:
    """The fusion's scores by these constants of small prints."""
    fusion.BY_OVERLAP = tuple(by.overlap.tolist())
    fusion.BY_OVERLAP_AND_MINUTIAE = tuple(by.both.tolist())
    return np.array([fusion.fused_score(*row) for row in rows[:, 6:10].tolist()])


def cllr(score: NDArray[np.float64], same: NDArray[np.bool_]) -> float:
    """Cost of log-likelihood ratios, in bits (Bruemmer and du Preez 2006)."""
    return float(np.logaddexp(0, -score[same]).mean() + np.logaddexp(0, score[~same]).mean()) / (
        2 * np.log(2)
    )


def equal_error(score: NDArray[np.float64], same: NDArray[np.bool_]) -> float:
    """Where both rates are equal, in percent."""
    return round(100 * roc(score[same], score[~same]).equal_error().value, 2)


def shares(passed: NDArray[np.bool_]) -> list[float]:
    """Fraction and its interval (Wilson), in percent."""
    interval = binomtest(int(passed.sum()), max(passed.size, 1)).proportion_ci(method="wilson")
    low, high = (float(interval.low), float(interval.high)) if passed.size else (0.0, 1.0)
    return [
        round(100 * fraction, 3)
        for fraction in (float(passed.mean()) if passed.size else 0.0, low, high)
    ]


def at_stated(score: NDArray[np.float64], rows: NDArray[np.float64], fmr: float) -> dict[str, Any]:
    """False matches and non-matches where every set is decided by a threshold of the six others."""
    same, number = rows[:, 3] == 1, rows[:, 1]
    accepted = np.zeros(len(rows), dtype=bool)
    for set_number in range(len(SETS)):
        others = np.sort(score[(number != set_number) & ~same])
        allowed = int(fmr * (others.size + 1)) - 1  # (k + 1) / (N + 1) at most fmr
        threshold = np.inf if allowed < 0 else others[others.size - 1 - allowed] + 1e-9
        accepted[number == set_number] = score[number == set_number] >= threshold
    per = {
        name: {
            "fmr": shares(accepted[(number == k) & ~same]),
            "fnmr": shares(~accepted[(number == k) & same]),
        }
        for k, name in enumerate(SETS)
    }
    return {
        "stated": fmr,
        "fmr": shares(accepted[~same]),
        "fnmr": shares(~accepted[same]),
        "sets": per,
    }


def report(rows: NDArray[np.float64]) -> tuple[dict[str, Any], NDArray[np.float64], Constants]:
    """Every figure, the scores by constants of the other sets, and the constants of all."""
    number, same, kind, mm = rows[:, 1], rows[:, 3] == 1, rows[:, 0], rows[:, 2]
    score = np.zeros(len(rows))
    for set_number in range(len(SETS)):
        part = number == set_number
        score[part] = scored(rows[part], fitted(rows[~part]))
    overlap = rows[:, 10]
    small = ~np.isnan(rows[:, 9])
    facts: dict[str, Any] = {"comparisons": len(rows), "sizes": {}, "by_overlap": {}, "sets": {}}
    for which, name in ((TOUCHES, "touch to touch"), (WHOLE, "window to whole print")):
        for size in SIZES_MM:
            part = (kind == which) & (mm == size)
            if part.any() and (same & part).any():
                facts["sizes"][f"{name}, {size} mm"] = {
                    "genuine": int((part & same).sum()),
                    "impostors": int((part & ~same).sum()),
                    "eer": equal_error(score[part], same[part]),
                }
    windows_ = (kind != PRINTS) & small
    limit = float(np.sort(score[windows_ & ~same & (overlap >= RATED_MM2)])[-1])
    for low, high in itertools.pairwise((0, 6, 10, 15, 20, 30, 40, 60, 400)):
        part = windows_ & (overlap >= low) & (overlap < high)
        impostor = score[part & ~same]
        facts["by_overlap"][f"{low} to {high} mm2"] = {
            "impostors": int(impostor.size),
            "q99": round(float(np.quantile(impostor, 0.99)), 2),
            "q999": round(float(np.quantile(impostor, 0.999)), 2),
            "largest": round(float(impostor.max()), 2),
            "genuine above all": shares(score[part & same] > limit),
        }
    whole = (kind == PRINTS) & ~small
    rated = windows_ & (overlap >= RATED_MM2)
    for name, part in (("whole prints", whole), ("windows", rated)):
        if part.any():
            facts[name] = {
                "genuine": int((part & same).sum()),
                "impostors": int((part & ~same).sum()),
                "eer": equal_error(score[part], same[part]),
                "cllr": round(cllr(score[part], same[part]), 3),
                "at": [at_stated(score[part], rows[part], fmr) for fmr in (0.01, 0.001)],
            }
            for k, set_name in enumerate(SETS):
                own = part & (number == k)
                if not (own & same).any():
                    continue
                facts["sets"].setdefault(set_name, {})[name] = {
                    "eer": equal_error(score[own], same[own]),
                    "cllr": round(cllr(score[own], same[own]), 3),
                }
    return facts, score, fitted(rows)


def write(
    facts: dict[str, Any], rows: NDArray[np.float64], constants: Constants, cache: Path
) -> None:
    """Figures, and the table of small prints that the matcher ships; constants are copied by hand
    into ``matching/fusion.py``."""
    small = rows[(rows[:, 0] != PRINTS) & ~np.isnan(rows[:, 9])]
    ends = (5 * small[:, 1] + small[:, column] // 8 for column in (4, 5))
    every = np.column_stack([*ends, small[:, 4], scored(small, constants), small[:, 10]])
    what = "windows of 16 to 100 mm² of real prints of seven sensors"
    touches = np.concatenate([np.load(cache / f"sensor_{k}.npy") for k in range(len(SENSORS_PX))])
    alone = table(impostors_of(every), what, "validation/match/windows.py")
    ship_small(alone, impostors_of(touches))
    document = {
        "fitted": {
            "overlap": constants.overlap.tolist(),
            "overlap_and_minutiae": constants.both.tolist(),
        }
    }
    known = json.loads(OUT.read_text(encoding="utf-8")) if OUT.is_file() else {}
    document["sensors"] = known.get("sensors")
    OUT.write_text(json.dumps({**document, **facts}, indent=1) + "\n", encoding="utf-8")


SENSORS_PX = {"64 x 80": (80, 64), "80 x 80": (80, 80), "103 x 52": (52, 103)}
"""Rows and columns of small sensors at 500 ppi."""
ENROLLED = 8
"""Touches enrolled."""
MAX_TURN_DEG = 45.0
SPREAD = 0.5
"""Of places of touches about the middle of the ridges, over that of the ridges."""


def touch(image: Image, size: tuple[int, int], rng: np.random.Generator) -> Image:
    """What a small sensor of some rows and columns sees of a print that is turned."""
    turned_ = turned(image, float(rng.uniform(-MAX_TURN_DEG, MAX_TURN_DEG)))
    rows, columns = ridges(turned_)
    k = rng.integers(len(rows))
    places = []
    for line, side, whole in zip((rows, columns), size, turned_.shape, strict=True):
        middle = line.mean() + SPREAD * (line[k] - line.mean())
        places.append(int(np.clip(round(middle - side / 2), 0, whole - side)))
    top, left = places
    return np.ascontiguousarray(turned_[top : top + size[0], left : left + size[1]])


def touches(
    job: Job, number: int
) -> tuple[list[list[Template]], list[list[Template]], np.random.Generator]:
    """Of each finger, by a small sensor: touches enrolled, every fourth impression as a probe; and
    what draws on."""
    size = list(SENSORS_PX.values())[number]
    rng = np.random.default_rng([SEED, 3, number])
    enrolled, probes = [], []
    for images in (prints(name, job)[0] for name in SETS):
        for first in range(0, len(images), 8):
            kept = [first + k for k in range(8) if k not in (3, 7)]
            places = [kept[n % 6] for n in range(ENROLLED)]
            for side, chosen in ((enrolled, places), (probes, [first + 3, first + 7])):
                drawn = [touch(images[k], size, rng) for k in chosen]
                side.append([features_of(each, "template", job) for each in drawn])
    return enrolled, probes, rng


def sensors(job: Job) -> dict[str, NDArray[np.float64]]:
    """Comparisons of touches of small sensors: probes against eight touches of their finger and of
    twelve others, four of them of its sensor."""
    compared = {}
    for number, name in enumerate(SENSORS_PX):
        file = job.cache / f"sensor_{number}.npy"
        if not file.is_file():
            *both, rng = touches(job, number)
            enrolled, probes = ([[*map(Prepared, own)] for own in side] for side in both)
            rows = []
            for finger, own in enumerate(probes):
                first = finger // 5 * 5
                same = [k for k in range(first, first + 5) if k != finger]
                far = [k for k in range(len(probes)) if not first <= k < first + 5]
                others = same + rng.choice(far, 8, replace=False).tolist()
                for n, probe in enumerate(own):
                    for other in (finger, *others):
                        for side in enrolled[other]:
                            match = fused_match(probe, side)
                            score = match.similarity if match.compared else np.nan
                            rows.append((finger, other, n, score, match.ridge.overlap_mm2))
            np.save(file, np.array(rows))
        compared[name] = np.load(file)
    return compared


def impostors_of(rows: NDArray[np.float64]) -> Pairs:
    """Rated comparisons of parts of two fingers."""
    finger, other, _, score, overlap = rows.T
    kept = (finger != other) & (overlap >= RATED_MM2) & np.isfinite(score)
    ends = finger[kept].astype(int), other[kept].astype(int)
    return Pairs(*ends, *ends, score[kept], np.zeros(kept.sum(), bool))


def of_sensor(rows: NDArray[np.float64], every: Pairs) -> dict[str, Any]:
    """Rates of a small sensor at thresholds by the touches of `every` sensor on the fingers of the
    six other sets: of comparisons, and of probes against all touches of a finger."""
    finger, other, _, score, overlap = rows.T
    same = finger == other
    stated = fmr_table("windows").smallest
    shipped = json.loads((FOLDER / TABLES["windows"]).read_text(encoding="utf-8"))
    by_windows = shipped["measured"]["similarity"][-1]
    threshold = np.zeros(len(rows))
    for number in range(len(SETS)):
        ends = thresholds(every.taken(~every.of_set(number)), (stated,))[1]
        threshold[finger // 5 == number] = ends[0]
    accepted = (score >= threshold) & (overlap >= RATED_MM2)
    missed = ~accepted.reshape(-1, ENROLLED).any(axis=1)[same[::ENROLLED]].reshape(-1, 2)
    drawn = np.random.default_rng(0).integers(len(missed), size=(2000, len(missed)))
    ends_ = np.quantile(missed[drawn].mean(axis=(1, 2)), [0.025, 0.975])
    by_overlap = {}
    for low, high in itertools.pairwise((6, 8, 10, 12, 17)):
        part = same & (overlap >= low) & (overlap < high)
        by_overlap[f"{low} to {high} mm2"] = {
            "genuine": int(part.sum()),
            "matched": shares(accepted[part]),
        }
    return {
        "stated": stated,
        "fnmr": [round(100 * float(x), 1) for x in (missed.mean(), *ends_)],
        "probes": int(missed.size),
        "impostors": int((~same).sum()),
        "false_matches": int((accepted & ~same).sum()),
        "by_windows_alone": int(((score >= by_windows) & (overlap >= RATED_MM2) & ~same).sum()),
        "genuine_by_overlap": by_overlap,
    }


def ship_small(windows_alone: dict[str, Any], every: Pairs) -> None:
    """Write what the matcher ships: the larger rate of windows and of touches."""
    what = "touches of 13 to 17 mm² of 35 real fingers"
    touches = table(every, what, "validation/match/windows.py --sensors")
    areas = {"rated_mm2": RATED_MM2, "excluded_mm2": EXCLUDED_MM2}
    ship("windows", {**areas, **at_least(windows_alone, touches)})


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--compare", type=int, metavar="N", help="compare until the cache holds N")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--sensors", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.sensors:
        known = json.loads(OUT.read_text(encoding="utf-8"))
        rows = sensors(Job(options.cache))
        every = impostors_of(np.concatenate(list(rows.values())))
        known["sensors"] = {name: of_sensor(each, every) for name, each in rows.items()}
        if options.write:
            shipped = json.loads((FOLDER / TABLES["windows"]).read_text(encoding="utf-8"))
            ship_small(shipped.get("measured", shipped), every)
        OUT.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
        print(json.dumps(known["sensors"], indent=1))
        return
    if options.compare is not None:
        compare(Job(options.cache), options.compare)
    rows = np.load(options.cache / "windows.npy")
    facts, _, constants = report(rows)
    print(json.dumps(facts, indent=1))
    print("constants:", constants.overlap.tolist(), constants.both.tolist())
    if options.write:
        write(facts, rows, constants, options.cache)


if __name__ == "__main__":
    main()
