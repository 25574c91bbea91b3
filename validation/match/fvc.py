"""Real prints of seven sensors by FVC's protocol: every system on the same pairs, peers included.

    python validation/match/fvc.py  # the shipped matcher and its peers, a table
    python validation/match/fvc.py --systems fusion nbis-py --sets fvc2004_db1b fvc2004_db2b
    python validation/match/fvc.py --systems fusion --leave-one-set-out --turned

Sets: ``../shared/data/fvc`` and ``fvc2002_db1b`` (fingers 101 to 105, eight impressions), and
simulated presses (``pressed_prints.py``, 24 fingers, four presses, seeds from 95,000). *All pairs*:
140 genuine and 640 impostor ones a set. *FVC*: the same genuine ones, and the first impressions of
all fingers as impostors (ten a set). Pooled: the six sets of ``fvc`` at one threshold. A failure to
acquire is a rejection. Intervals of 95 % draw fingers (five a set).

What is made of a print is kept in ``--cache`` by the print's hash: name another one after a change
of extraction. Scores are not kept. ``--leave-one-set-out`` fits the fusion's constants anew for
every set, on the evidence of all others; the shipped ones are fitted on simulated presses alone
(``--fit``, 24 fingers, four presses, every other one pulled, seeds from 92,000), of which no
finger is reported.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import multiprocessing
import os
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from bozorth3 import bozorth3
from numpy.typing import NDArray
from pressed_prints import PULLED, finger, press

from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.prints.minutiae import at_500_ppi, extract
from splitknit_match.prints.pressed import pressed_ridges
from splitknit_match.prints.ridge_field import outline_distance_mm
from splitknit_match.records.minutiae_record import Minutiae
from splitknit_match.records.pictures import read_print_png

HERE = Path(__file__).resolve().parent
OUT = HERE / "fvc.json"
DATA = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data"))
REAL = (
    "fvc2000_db2b",
    "fvc2000_db3b",
    "fvc2002_db2b",
    "fvc2004_db1b",
    "fvc2004_db2b",
    "fvc2004_db3b",
)
KNOWN = "fvc2002_db1b"
"""On which earlier choices were made: not pooled."""
SIMULATED = {"simulated": 95_000, "simulated_fit": 92_000}
PPI = {"fvc2002_db2b": 569.0, "fvc2004_db3b": 512.0}
FAR_0 = 1e-9
COLUMNS = {"both": [0, 1], "ridges_alone": [1], "minutiae_alone": [2]}
"""Of the fusion's evidence, in the order in which they are tried."""
TURNS_SEED = 5
Image = NDArray[np.uint8]
Evidence = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class System:
    """One way from two prints to a score."""

    make: str
    """Of :data:`FEATURES`."""
    ready: Callable[[Any], Any]
    """From what is kept to what is compared many times."""
    score: Callable[[Any, Any], float | tuple[float, ...]]
    """NaN is a failure to acquire; what comes after the score is its evidence."""


def enhanced_minutiae(image: Image) -> Minutiae:
    """Minutiae by mindtct of the enhanced print, 0.3 mm or more within its ridges: pressed prints
    fade out towards their outline."""
    pressed = pressed_ridges(image)
    every = extract(pressed.image, edge_mm=0.0)
    distance_mm = outline_distance_mm(pressed.inside, 500.0)
    return every.taken(distance_mm[every.y_px, every.x_px] >= 0.3)


FEATURES: dict[str, Callable[[Image], Any]] = {
    "template": print_template,
    "phase": lambda image: print_template(image).minutiae,
    "enhanced": enhanced_minutiae,
    "raw": lambda image: extract(image, edge_mm=0.0),
}


def fused(a: Any, b: Any) -> tuple[float, ...]:
    """The default of prints, and its evidence."""
    match = fused_match(a, b)
    return (match.similarity if match.compared else float("nan"), *match.evidence)


def ridges(a: Any, b: Any) -> float:
    """Ridges alone."""
    match = ridge_match(a, b)
    return match.similarity if match.compared else float("nan")


def bozorth(a: Any, b: Any) -> float:
    """bozorth3, as nbis-py has it."""
    return bozorth3(a, b) if a.acquired and b.acquired else float("nan")


def minutiae(a: Any, b: Any) -> float:
    """Minutiae alone."""
    return minutiae_match(a, b) if a.acquired and b.acquired else float("nan")


SYSTEMS = {
    "fusion": System("template", Prepared, fused),
    "ridge": System("template", Prepared, ridges),
    "minutiae": System("phase", lambda features: features, minutiae),
    "bozorth3": System("phase", lambda features: features, bozorth),
    "enhanced": System("enhanced", lambda features: features, bozorth),
    "nbis-py": System("raw", lambda features: features, bozorth),
}


@dataclass(frozen=True, slots=True)
class Job:
    """Where prints and what is made of them are kept."""

    cache: Path
    turn: bool = False
    fingers: int = 24
    presses: int = 4


def prints(name: str, job: Job) -> tuple[list[Image], list[str], list[int]]:
    """Prints of a set at 500 ppi, whose, and the impression's number."""
    if name in SIMULATED:
        file = job.cache / f"{name}_{job.fingers}_{job.presses}.pickle"
        if not file.is_file():
            masters = [finger(SIMULATED[name] + k) for k in range(job.fingers)]
            ranges = [None, PULLED if name == "simulated_fit" else None]
            kept(
                file,
                [
                    press(master, number, ranges[number % 2])
                    for master in masters
                    for number in range(job.presses)
                ],
            )
        images = pickle.loads(file.read_bytes())
        owner = [f"{k}" for k in range(job.fingers) for _ in range(job.presses)]
        impression = list(range(job.presses)) * job.fingers
    else:
        folder = DATA / name if name == KNOWN else DATA / "fvc" / name
        files = sorted(folder.glob("*.png"))
        if not files:
            raise SystemExit(
                f"there are no prints in '{folder}'; name the folder of the data by SPLITKNIT_DATA."
            )
        images = [at_500_ppi(read_print_png(file).image, PPI.get(name, 500.0)) for file in files]
        owner = [file.stem.split("_")[0] for file in files]
        impression = [int(file.stem.split("_")[1]) - 1 for file in files]
    if job.turn:
        angles = np.random.default_rng([TURNS_SEED, len(images)]).uniform(0, 360, len(images))
        images = [
            turned(image, angle) for image, angle in zip(images, angles.tolist(), strict=True)
        ]
    return images, [f"{name}/{number}" for number in owner], impression


def turned(image: Image, angle_deg: float) -> Image:
    """A print, turned counter-clockwise on a sheet that holds it, beyond its border as bright as
    its paper."""
    rows, columns = image.shape
    side = int(np.ceil(np.hypot(rows, columns))) + 2
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), angle_deg, 1.0)
    matrix[:, 2] += (side - columns) / 2, (side - rows) / 2
    paper = float(np.percentile(image, 95))
    return np.asarray(
        cv2.warpAffine(image, matrix, (side, side), flags=cv2.INTER_CUBIC, borderValue=paper),
        np.uint8,
    )


def kept(file: Path, content: Any) -> None:
    """Write through a temporary name: another run may read."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(content))
    part.replace(file)


def features_of(image: Image, kind: str, job: Job) -> Any:
    """What a system keeps of a print."""
    name = hashlib.sha256(image.tobytes() + str(image.shape).encode()).hexdigest()[:24]
    file = job.cache / f"{kind}_1" / name
    if not file.is_file():
        kept(file, FEATURES[kind](image))
    return pickle.loads(file.read_bytes())


@dataclass(frozen=True, slots=True)
class SetScores:
    """All pairs of one set by one system."""

    scores: Scores
    first: NDArray[np.bool_]
    """(N,) of FVC's protocol."""
    milliseconds: float
    """Processor time of a pair, prepared."""
    evidence: NDArray[np.float64]
    """(N, K) of the fusion, from which its constants are fitted."""


def pairs_of(owner: Sequence[str], limit: int | None) -> list[tuple[int, int]]:
    """All genuine pairs, and all impostor ones, or `limit` of them."""
    all_pairs = list(itertools.combinations(range(len(owner)), 2))
    others = [pair for pair in all_pairs if owner[pair[0]] != owner[pair[1]]]
    if limit is not None and limit < len(others):
        chosen = np.random.default_rng([3, len(owner)]).permutation(len(others))[:limit]
        others = [others[k] for k in sorted(chosen)]
    return [pair for pair in all_pairs if owner[pair[0]] == owner[pair[1]]] + others


def compared(task: tuple[str, str, Job]) -> SetScores:
    """One system on one set."""
    cv2.setNumThreads(1)
    name, system_name, job = task
    system = SYSTEMS[system_name]
    images, owner, impression = prints(name, job)
    sides = [system.ready(features_of(image, system.make, job)) for image in images]
    pairs = pairs_of(owner, 800 if name in SIMULATED else None)
    for side in sides:  # what is made at the first use is not part of a pair's time
        system.score(side, side)
    begun = time.process_time()
    table = np.array([system.score(sides[i], sides[j]) for i, j in pairs]).reshape(len(pairs), -1)
    spent = 1000 * (time.process_time() - begun) / len(pairs)
    ids = ids_of([owner[i] for i, _ in pairs], [owner[j] for _, j in pairs])
    same = ids.same
    first = np.array(
        [s or impression[i] == impression[j] == 0 for s, (i, j) in zip(same, pairs, strict=True)]
    )
    scores = Scores(same, table[:, 0], finger=ids, name=f"{system_name} {name}")
    return SetScores(scores, first, spent, table[:, 1:])


def pooled(runs: Sequence[SetScores], name: str) -> SetScores:
    """Several sets at one threshold."""
    parts = [run.scores for run in runs]
    names = [
        [scores.finger.names[k] for k in scores.finger.codes.T.ravel()]
        for scores in parts
        if scores.finger
    ]
    halves = [
        (side_names[: len(side_names) // 2], side_names[len(side_names) // 2 :])
        for side_names in names
    ]
    ids = ids_of([x for a, _ in halves for x in a], [x for _, b in halves for x in b])
    scores = Scores(
        np.concatenate([scores.label for scores in parts]),
        np.concatenate([scores.score for scores in parts]),
        finger=ids,
        name=name,
    )
    spent = float(np.mean([run.milliseconds for run in runs]))
    first = np.concatenate([run.first for run in runs])
    return SetScores(scores, first, spent, np.concatenate([run.evidence for run in runs]))


def fitted(runs: Sequence[SetScores]) -> dict[str, list[float]]:
    """Slopes and offset of logistic regressions on both kinds of evidence and on each alone; sets
    count the same."""
    table = np.concatenate([run.evidence for run in runs])
    label = np.concatenate([run.scores.label for run in runs])
    labels = [run.scores.label for run in runs]
    weight = np.concatenate(
        [np.where(part, 0.5 / part.sum(), 0.5 / (~part).sum()) / len(runs) for part in labels]
    )
    result = {}
    for name, columns in COLUMNS.items():
        known = ~np.isnan(table[:, columns]).any(axis=1)
        x = np.column_stack([table[known][:, columns], np.ones(known.sum())])
        answer = logistic(x, label[known], weight[known])
        result[name] = [round(float(value), 4) for value in answer]
    return result


def logistic(
    x: Evidence, label: NDArray[np.bool_], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weighted logistic regression, held back a little (3e-3 on standardised columns), by Newton's
    steps."""
    scale = np.append(x[:, :-1].std(axis=0), 1.0)
    z = x / scale
    hold = np.append(np.full(x.shape[1] - 1, 3e-3), 0.0)
    answer = np.zeros(x.shape[1])
    for _ in range(100):
        rate = 1 / (1 + np.exp(-(z @ answer)))
        bend = (z * (weight * rate * (1 - rate) + 1e-12)[:, None]).T @ z + np.diag(hold + 1e-9)
        step = np.linalg.solve(bend, z.T @ (weight * (rate - label)) + hold * answer)
        answer -= step * min(1.0, 2.0 / float(np.abs(step).max()))
        if float(np.abs(step).max()) < 1e-9:
            break
    return np.asarray(answer / scale)


def left_out(runs: dict[str, SetScores]) -> dict[str, SetScores]:
    """Every set scored by constants that were fitted on all others."""
    result = {}
    for name, run in runs.items():
        part = fitted([other_run for key, other_run in runs.items() if key != name])
        score = np.array([scored_by(row, part) for row in run.evidence])
        scores = Scores(run.scores.label, score, finger=run.scores.finger, name=run.scores.name)
        result[name] = SetScores(scores, run.first, run.milliseconds, run.evidence)
    return result


def scored_by(row: Evidence, part: dict[str, list[float]]) -> float:
    """The fusion's score of one pair by other constants."""
    for name, columns in COLUMNS.items():
        if not np.isnan(row[columns]).any():
            return float(np.append(row[columns], 1.0) @ part[name])
    return float("nan")


def figures(run: SetScores, settings: BootstrapSettings) -> dict[str, Any]:
    """Rates of all pairs with intervals by finger, and FVC's own."""
    scores = run.scores
    interval = bootstrap(scores, "finger", settings).figures
    impostor = scores.impostor[~np.isnan(scores.impostor)]
    fvc = scores.taken(run.first)
    row = {
        name: [round(100 * float(value), 2) for value in (part.value, part.low, part.high)]
        for name, part in (
            ("eer", interval["eer"]),
            ("gar_far_1", interval["gar@0.01"]),
            ("gar_far_0.1", interval["gar@0.001"]),
            ("gar_far_0", interval[f"gar@{FAR_0:g}"]),
        )
    }
    return {
        **row,
        "far_at_0": round(100 * float((impostor >= 0).sum() / scores.impostor.size), 2),
        "threshold_far_1": round(float(np.quantile(impostor, 0.99)), 3),
        "fvc_eer": round(100 * bootstrap(fvc, "plain", settings).figures["eer"].value, 2),
        "genuine": int(scores.genuine.size),
        "impostors": int(scores.impostor.size),
        "genuine_failed": int(np.isnan(scores.genuine).sum()),
        "impostors_failed": int(np.isnan(scores.impostor).sum()),
        "ms": round(run.milliseconds, 2),
    }


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--systems", nargs="+", choices=list(SYSTEMS), default=list(SYSTEMS))
    parser.add_argument(
        "--sets", nargs="+", choices=(*REAL, KNOWN, *SIMULATED), default=(*REAL, KNOWN, "simulated")
    )
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    parser.add_argument(
        "--turned", action="store_true", help="every print by an angle of its own, 0 to 360 deg"
    )
    parser.add_argument(
        "--fit", action="store_true", help="the fusion's constants, on the set simulated_fit"
    )
    parser.add_argument(
        "--leave-one-set-out", action="store_true", help="the fusion, fitted on all other sets"
    )
    parser.add_argument("--write", action="store_true", help=f"add the figures to {OUT.name}")
    options = parser.parse_args()
    sets = (
        *options.sets,
        *(("simulated_fit",) if options.fit and "simulated_fit" not in options.sets else ()),
    )
    job = Job(options.cache, options.turned)
    settings = BootstrapSettings(replicates=300, targets=(0.01, 0.001, FAR_0), curve_points=0)
    facts: dict[str, Any] = {}
    with multiprocessing.Pool(2) as pool:
        for system in options.systems:
            runs = {}
            tasks = [(name, system, job) for name in sets]
            for name, run in zip(sets, pool.imap(compared, tasks), strict=True):
                runs[name] = run
                facts.setdefault(system, {})[name] = figures(run, settings)
                print(name, system, facts[system][name], flush=True)
            if system == "fusion" and options.fit:
                facts["fitted"] = fitted([runs["simulated_fit"]])
                print("fitted:", facts["fitted"], flush=True)
            parts = {system: runs}
            if system == "fusion" and options.leave_one_set_out:
                parts["fusion, others"] = left_out(runs)
                for name, run in parts["fusion, others"].items():
                    facts.setdefault("fusion, others", {})[name] = figures(run, settings)
                    print(name, "left out:", facts["fusion, others"][name], flush=True)
            for kind, part in parts.items():
                several = [run for name, run in part.items() if name in REAL]
                if len(several) > 1:
                    facts[kind]["pooled"] = figures(pooled(several, kind), settings)
                    print("pooled", kind, facts[kind]["pooled"], flush=True)
    if options.write:
        known = json.loads(OUT.read_text(encoding="utf-8")) if OUT.is_file() else {}
        known |= {"fitted": facts.pop("fitted")} if "fitted" in facts else {}
        known.setdefault("turned" if job.turn else "as_they_are", {}).update(facts)
        OUT.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
