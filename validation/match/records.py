"""Records of minutiae by another vendor's extractor: the shipped matcher and its peers.

    python validation/match/records.py                            # eight sets, five minutes
    python validation/match/records.py --peer sourceafis=scores/  # and a peer's own scores
    python validation/match/records.py --write                     # and the rates that ship

Data: ``../shared/data/iso_templates``, ISO 19794-2 templates of a commercial extractor for eight
FVC sets, fingers 101 to 105, eight impressions: 140 genuine and 640 impostor pairs a set. What
there is to choose of the matcher was chosen on :data:`CHOSEN_ON`; the others are left for the
report. Impostors for the rates that ship are all pairs of different fingers of all sets, within
sets and between them; a threshold is an interval's upper end, as in ``unseen.py``, and each set is
decided by the seven others.

A peer's folder holds ``SET.csv`` for each set, columns ``a,b,score``, such as
``101_1,101_2,38.2``: a run of SourceAFIS (Java), which is not a part of this project.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import itertools
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bozorth3 import bozorth3
from fvc import DATA
from impostors import ship
from unseen import FINGERS, STATED, Pairs, false_matches, misses, table, thresholds

from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.prints.from_file import minutiae_of
from splitknit_match.records.minutiae_files import read_minutiae_record
from splitknit_match.records.minutiae_record import Minutiae
from splitknit_match.threads import one_blas_thread

OUT = Path(__file__).with_name("records.json")
CHOSEN_ON = ("fvc2002_db1b", "fvc2002_db3b", "fvc2004_db1b", "fvc2004_db3b")
LEFT_OUT = ("fvc2002_db2b", "fvc2002_db4b", "fvc2004_db2b", "fvc2004_db4b")
Named = dict[str, Minutiae]
"""From ``101_1`` to its minutiae."""


def records(name: str) -> Named:
    """The records of a set."""
    files = sorted((DATA / "iso_templates" / name).glob("*.iso"))
    if not files:
        raise SystemExit(f"there are no records of '{name}' below '{DATA}'; set SPLITKNIT_DATA.")
    return {file.stem: minutiae_of(read_minutiae_record(file)[0]) for file in files}


def compared(named: Named, compare: Callable[[str, str], float], name: str) -> tuple[Scores, float]:
    """All pairs of a set, and the processor time of one in milliseconds."""
    pairs = list(itertools.combinations(named, 2))
    begun = time.process_time()
    score = np.array([compare(a, b) for a, b in pairs])
    spent = 1000 * (time.process_time() - begun) / len(pairs)
    ids = ids_of([a.split("_")[0] for a, _ in pairs], [b.split("_")[0] for _, b in pairs])
    return Scores(ids.same, score, finger=ids, name=name), spent


def peers(folders: list[str]) -> Iterator[tuple[str, Callable[[str, Named, str, str], float]]]:
    """Name, and what compares two records of a set."""
    yield "minutiae", lambda _, named, a, b: minutiae_match(named[a], named[b])
    if importlib.util.find_spec("nbis") is not None:
        yield "bozorth3", lambda _, named, a, b: bozorth3(named[a], named[b])
    for option in folders:
        name, _, folder = option.partition("=")
        tables: dict[tuple[str, str, str], float] = {}
        for file in Path(folder).glob("*.csv"):
            with file.open(encoding="utf-8") as stream:
                for row in csv.DictReader(stream):
                    tables[file.stem, row["a"], row["b"]] = float(row["score"])
        yield name, lambda set_name, _, a, b, tables=tables: tables[set_name, a, b]


def every_pair() -> Pairs:
    """All pairs of two records, within sets and between them."""
    sides = [
        (FINGERS * number + int(key[:3]) - 101, 100 * number + k, minutiae)
        for number, name in enumerate((*CHOSEN_ON, *LEFT_OUT))
        for k, (key, minutiae) in enumerate(records(name).items())
    ]
    rows = [
        (a[0], b[0], a[1], b[1], minutiae_match(a[2], b[2]))
        for a, b in itertools.combinations(sides, 2)
    ]
    *ends, similarity = np.array(rows).T
    return Pairs(*(end.astype(int) for end in ends), similarity, np.zeros(len(rows), bool))


def unseen(pairs: Pairs) -> dict[str, Any]:
    """Rates where every set is decided by the seven others: percent, intervals draw fingers."""
    impostors = pairs.taken(~pairs.genuine)
    numbers = range(len(CHOSEN_ON) + len(LEFT_OUT))
    ends = np.array([thresholds(impostors.taken(~impostors.of_set(k)), STATED)[1] for k in numbers])
    facts = {}
    for fmr, end in zip(STATED, ends.T, strict=True):
        needed = np.minimum(end[impostors.a // FINGERS], end[impostors.b // FINGERS])
        facts[f"{fmr:g}"] = {
            "fnmr": misses(pairs, dict(enumerate(end)), [*numbers], 1),
            **false_matches(impostors, impostors.similarity >= needed),
        }
    return facts


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peer", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--write", action="store_true", help="the rates, and the figures")
    options = parser.parse_args()
    one_blas_thread()
    pairs = every_pair()
    if options.write:
        what = "ISO templates of 40 real fingers, eight FVC sets"
        by = "validation/match/records.py --write"
        ship("minutiae_of_records", table(pairs.taken(~pairs.genuine), what, by))
    settings = BootstrapSettings(replicates=300, targets=(0.001,), curve_points=0)
    facts: dict[str, Any] = {"chosen_on": CHOSEN_ON, "left_out": LEFT_OUT}
    for system, compare in peers(options.peer):
        rows: dict[str, Any] = {}
        for name in (*CHOSEN_ON, *LEFT_OUT):
            named = records(name)
            scores, spent = compared(named, partial(compare, name, named), f"{system} {name}")
            eer = bootstrap(scores, "finger", settings).figures["eer"]
            values = (eer.value, eer.low, eer.high)
            rows[name] = {
                "eer": [round(100 * float(value), 2) for value in values],
                "misses_at_no_false_match": round(
                    100 * float((scores.genuine <= scores.impostor.max()).mean()), 1
                ),
                "ms": round(spent, 2),
            }
            print(system, name, rows[name], flush=True)
        for what, sets in (
            ("mean_chosen_on", CHOSEN_ON),
            ("mean_left_out", LEFT_OUT),
            ("mean", (*CHOSEN_ON, *LEFT_OUT)),
        ):
            rows[what] = round(float(np.mean([rows[name]["eer"][0] for name in sets])), 2)
            print(system, what, rows[what], flush=True)
        facts[system] = rows
    facts["unseen"] = unseen(pairs)
    print(facts["unseen"], flush=True)
    if options.write:
        OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
