"""Minutiae by vote (Zheng) against plain ones: recall, precision, and scores between two sessions.

    python validation/family/voted.py --population POP --store STORE --work DIR [--out validation/family/voted.json]

POP is a simulated population, STORE a batch of it with the cases `ea` and `metric` and the matcher `minutiae`. Lists of
minutiae are kept in DIR, so that a run that was stopped goes on. The limit of the votes was chosen on the fingers of
`TUNED`, which are in none of the other figures.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from agreement_compare import agreed, counts
from voted_measure import Judge, lists_of, name_of, plain_of, unpacked

from splitknit.io.atomic import atomic_file
from splitknit_match.matching.minutiae import minutiae_match
from splitknit_match.matching.minutiae_record import Minutiae
from splitknit_match.matching.voted_minutiae import PICTURES, VoteSettings, vote

TUNED = [(subject, 1, finger) for subject in ("S15", "S16", "S17") for finger in ("right_index", "left_thumb")]
REPORTED = [(f"S{k:02d}", session, "right_index") for session in (1, 2) for k in range(1, 11)]
FRACTIONS = (0.15, 0.25, 0.35, 0.5, 0.6, 0.7)
REGION = {"margin_px": 10.0, "slant": (0.0, 60.0)}
"""Half a millimetre inside the print, where the finger's slant is below 60 deg."""


def kept_lists(population: Path, work: Path, capture: tuple[str, int, str]) -> dict[str, list[str]]:
    """Lists of a capture, from the disk where they are there."""
    file = work / f"{name_of(capture).replace('/', '-')}.json"
    if not file.is_file():
        found = lists_of(population, capture)
        with atomic_file(file) as stream:
            stream.write(json.dumps(found).encode("ascii"))
    return dict(json.loads(file.read_text(encoding="ascii")))


def ways(lists: dict[str, list[str]], plain: dict[str, Minutiae | None]) -> dict[str, Minutiae]:
    """Minutiae of a capture in every way that is compared."""
    found = {f"{case}, relief print": one for case, one in plain.items() if one is not None}
    for name in PICTURES:
        found[f"{name} of the first set"] = unpacked(lists, (name,))[0]
    for fraction in FRACTIONS:
        found[f"vote of all pictures, {fraction:g}"] = vote(
            unpacked(lists, PICTURES), VoteSettings(least_share=fraction)
        )
    default = VoteSettings()
    found["vote of all pictures"] = vote(unpacked(lists, PICTURES), default)
    for name in PICTURES:
        found[f"vote of {name}"] = vote(unpacked(lists, (name,)), default)
    firsts = [unpacked(lists, (name,))[0] for name in PICTURES]
    found["vote of the first set alone"] = vote(firsts, default)
    return found


def figures(captures: dict[Any, dict[str, Minutiae]], judges: dict[Any, Judge]) -> dict[str, Any]:
    """Recall and precision of every way, with intervals over fingers."""
    names = list(dict.fromkeys(name for found in captures.values() for name in found))
    result = {}
    for name in names:
        rows = [counts(judges[c].record(found[name]), **REGION) for c, found in captures.items() if name in found]
        result[name] = agreed(rows) | {"per_capture": float(np.mean([row["found"] for row in rows]))}
    return result


def scores(captures: dict[Any, dict[str, Minutiae]], name: str) -> dict[str, Any]:
    """bozorth3 of the first session against the second: genuine and impostor scores."""
    sessions = [[c for c in captures if c[1] == k and name in captures[c]] for k in (1, 2)]
    genuine, impostor = [], []
    for a in sessions[0]:
        for b in sessions[1]:
            score = minutiae_match(captures[a][name], captures[b][name])
            (genuine if (a[0], a[2]) == (b[0], b[2]) else impostor).append(score)
    top = max(impostor, default=np.nan)
    return {
        "genuine": sorted(genuine), "impostors": len(impostor), "impostor_maximum": top,
        "genuine_above_all_impostors": float(np.mean(np.array(genuine) > top)),
        "genuine_median": float(np.median(genuine)), "impostor_median": float(np.median(impostor)),
    }  # fmt: skip


def measure(population: Path, store: Path, work: Path, reported: list[Any], tuned: list[Any]) -> dict[str, Any]:
    """Everything that is reported."""
    work.mkdir(parents=True, exist_ok=True)
    document: dict[str, Any] = {"population": population.name, "region": REGION}
    for part, chosen in (("reported", reported), ("tuned", tuned)):
        captures = {}
        for capture in chosen:
            plain = {case: plain_of(store, case, capture) for case in ("ea", "metric")}
            captures[capture] = ways(kept_lists(population, work, capture), plain)
            print(part, name_of(capture), flush=True)
        first = {c: found for c, found in captures.items() if c[1] == 1}
        judges = {c: Judge(population, c) for c in first}
        document[part] = {"captures": [name_of(c) for c in first], "agreement": figures(first, judges)}
        if part == "reported":
            compared = ("ea, relief print", "metric, relief print", "vote of all pictures", "vote of albedo")
            document["scores"] = {name: scores(captures, name) for name in compared}
    return document


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--population", type=Path, required=True)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    options = parser.parse_args()
    document = measure(options.population, options.store, options.work, REPORTED, TUNED)
    options.out.write_text(json.dumps(document, indent=1) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
