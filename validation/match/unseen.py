"""What the stated false match rate of 1 in 10,000 costs on fingers that did not set its threshold.

    python validation/match/unseen.py  # 5 minutes of two cores: unseen.json
    python validation/match/unseen.py --write  # and the shipped table of real impostors

All pairs of whole prints within each of ``fvc.py``'s seven real sets, by the shipped matcher, whose
constants were fitted on simulated presses. Each set in turn is left out with its five fingers: the
threshold at 1e-4 comes from the six others' impostors, and where these end from the simulated ones,
as ``matching/methods.py`` takes it from all seven. *Shipped*: by the threshold of all seven, which
has seen these fingers. Intervals of 95 % draw fingers; with no false match the limit is the rule of
three over pairs. Hard sets: ``fvc2004_*``. Choices of the algorithm were made on all sets, so
fingers of another source can fail more often.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fvc import KNOWN, REAL, Job, features_of, prints
from impostors import ship, table_of
from numpy.typing import NDArray

from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.methods import REAL_PRINTS, TABLES, _document, similarity_at
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.score import FmrTable, calibrate_scores

OUT = Path(__file__).resolve().parent / "unseen.json"
SETS = (*REAL, KNOWN)
HARD = tuple(name for name in SETS if name.startswith("fvc2004"))
STATED = 1e-4
REPLICATES = 2000


def pairs_of_set(name: str, job: Job) -> NDArray[np.float64]:
    """(N, 4) of a set: both fingers, whether they are one, and the similarity (NaN: a failure)."""
    cv2.setNumThreads(1)
    images, owner, _ = prints(name, job)
    sides = [Prepared(features_of(image, "template", job)) for image in images]
    fingers = sorted(set(owner))
    rows = []
    for i, j in itertools.combinations(range(len(sides)), 2):
        comparison = fused_match(sides[i], sides[j])
        similarity = comparison.similarity if comparison.compared else np.nan
        a, b = fingers.index(owner[i]), fingers.index(owner[j])
        rows.append((a, b, a == b, similarity))
    return np.array(rows, dtype=np.float64)


def threshold_of(impostor: NDArray[np.float64]) -> float:
    """As the shipped table of the fusion has it at the stated rate, from these real impostors."""
    real, simulated = calibrate_scores(impostor), _document(TABLES["fusion"])
    similarity, fmr = np.array(simulated["similarity"]), np.array(simulated["fmr"])
    beyond = fmr < real.smallest
    table = FmrTable(
        np.append(real.similarity, np.maximum(similarity[beyond], real.similarity.max())),
        np.append(real.fmr, fmr[beyond]),
        real.impostors + simulated["impostors"],
        method="fusion",
    )
    return table.threshold(STATED)


def rates(
    sets: dict[str, NDArray[np.float64]], names: tuple[str, ...], threshold: dict[str, float]
) -> dict[str, Any]:
    """FNMR with an interval over fingers, and FMR, of these sets together, in percent."""
    missed, genuine, matched, impostors = [], [], 0, 0
    for name in names:
        a, _, same, similarity = sets[name].T
        accepted = np.nan_to_num(similarity, nan=-np.inf) >= threshold[name]
        matched += int((accepted & (same == 0)).sum())
        impostors += int((same == 0).sum())
        for finger in np.unique(a):
            own = (same == 1) & (a == finger)
            missed.append(int((~accepted & own).sum()))
            genuine.append(int(own.sum()))
    count, total = np.array(missed), np.array(genuine)
    keep = total > 0
    count, total = count[keep], total[keep]
    drawn = np.random.default_rng(0).integers(len(count), size=(REPLICATES, len(count)))
    share = np.quantile(count[drawn].sum(1) / total[drawn].sum(1), [0.025, 0.975])
    limit = 3 / impostors if not matched else None
    return {
        "fingers": len(count),
        "genuine": int(total.sum()),
        "fnmr": [round(100 * float(x), 1) for x in (count.sum() / total.sum(), *share)],
        "impostors": impostors,
        "false_matches": matched,
        "fmr_limit": None if limit is None else round(100 * limit, 3),
    }


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"))
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    job = Job(options.cache)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        by_set = pool.starmap(pairs_of_set, [(name, job) for name in SETS], chunksize=1)
    sets = dict(zip(SETS, by_set, strict=True))
    impostor = {
        name: rows[(rows[:, 2] == 0) & np.isfinite(rows[:, 3]), 3] for name, rows in sets.items()
    }
    if options.write:
        scores = np.concatenate(list(impostor.values()))
        what = "pairs of real prints of seven sensors"
        ship("real prints", table_of(scores, what, "validation/match/unseen.py"), REAL_PRINTS)
    left_out = {
        name: threshold_of(np.concatenate([impostor[each] for each in SETS if each != name]))
        for name in SETS
    }
    shipped = dict.fromkeys(SETS, similarity_at(STATED, "fusion"))
    facts: dict[str, Any] = {"stated": STATED, "shipped_threshold": shipped[KNOWN], "sets": {}}
    for kind, threshold in (("unseen", left_out), ("shipped", shipped)):
        facts[kind] = {
            "all": rates(sets, SETS, threshold),
            "hard": rates(sets, HARD, threshold),
            "others": rates(sets, tuple(name for name in SETS if name not in HARD), threshold),
        }
    for name in SETS:
        own = {"threshold": round(left_out[name], 3), **rates(sets, (name,), left_out)}
        facts["sets"][name] = own | {"largest_impostor": round(float(impostor[name].max()), 2)}
    OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
