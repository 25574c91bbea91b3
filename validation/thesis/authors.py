"""The author's program beside his text: both matchers on the same captures, and what closed-set
scores do to rates.

    splitknit batch POPULATION --out STORE --cases snk,pr,ea \\
        --matchers thesis,thesis-code --impostors 1
    python validation/thesis/authors.py --population POPULATION --store STORE

``text``: the thesis's local binary patterns (5.2), without gate. ``code``: what the author's
program compares (``thesis-code``). ``closed set``: each query's scores are brought to [0, 1] over
the gallery of a session, as his program does before it draws curves. The best candidate of every
query gets 1: a threshold is not of a pair any more. ``fused`` is a b / (a + b) of normals and of
the shape's normals, each brought to [0, 1] over all scores, as he fuses.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from measure import Work, rate_rows
from run import read_truth
from trials import ATTRIBUTES, Captures, Pairs, Table, Trial, Values, read_captures, read_table
from variants import Variant, known_of, passing_everywhere

from splitknit_match.batch.store import Store
from splitknit_match.evaluation.intervals import BootstrapSettings
from tables import write_csv

CASES = ("snk", "pr", "ea")
MATCHERS = {"thesis": "text", "thesis-code": "code"}
JUDGED = (Variant("none", "single", "all"), Variant("none", "averaged", "all"))
OUT = Path(__file__).resolve().parent / "tables" / "authors.csv"


def scores_by_code(store: Any, captures: Captures, pairs: Pairs, case: str) -> dict[str, Values]:
    """Scores (N,) by attribute of the matcher ``thesis-code``, in the order of `pairs`."""
    table = store.scores(case, "thesis-code")
    a, b = (captures.places(table[side]) for side in ("a", "b"))
    count = len(captures.names)
    key = a * count + b
    order = np.argsort(key)
    place = order[np.searchsorted(key[order], pairs.a * count + pairs.b)]
    return {name: table[f"score_{name}"][place] for name in ATTRIBUTES}


def fused(scores: Mapping[str, Values]) -> Values:
    """The program's fusion of two attributes, after all scores of each are brought to [0, 1]."""
    a, b = (
        (scores[name] - np.nanmin(scores[name])) / np.ptp(scores[name][np.isfinite(scores[name])])
        for name in ("normals", "shape_normals")
    )
    return np.asarray(a * b / np.maximum(a + b, 1e-12))


def closed_set(pairs: Pairs, similarity: Values) -> tuple[Pairs, Values]:
    """Every capture as a query against the gallery of each other session: scores in [0, 1] over
    that gallery."""
    captures = pairs.captures
    count = len(captures.names)
    known = np.full((count, count), np.nan)
    known[pairs.a, pairs.b] = known[pairs.b, pairs.a] = similarity
    queries, others, scaled = [], [], []
    for query in range(count):
        for session in np.unique(captures.session):
            gallery = np.flatnonzero(captures.session == session)
            row = known[query, gallery]
            if session == captures.session[query] or not np.isfinite(row).all():
                continue
            queries.append(np.full(len(gallery), query))
            others.append(gallery)
            scaled.append((row - row.min()) / max(np.ptp(row), 1e-12))
    return Pairs(captures, np.concatenate(queries), np.concatenate(others)), np.concatenate(scaled)


def across_sessions(pairs: Pairs) -> np.ndarray:
    """Comparisons of two sessions, which is what the program compares."""
    return np.asarray(pairs.captures.session[pairs.a] != pairs.captures.session[pairs.b])


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--population", type=Path, required=True)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--replicates", type=int, default=300)
    parser.add_argument("--seed", type=int, default=680)
    options = parser.parse_args()
    store, truth = Store(options.store), read_truth(options.population)
    captures = read_captures(store, CASES)
    table = read_table(store, captures, CASES, tuple(MATCHERS))
    across = across_sessions(table.pairs)
    pairs = table.pairs.taken(across)
    settings = BootstrapSettings(replicates=options.replicates, seed=options.seed, curve_points=0)
    rows = []
    for case in CASES:
        by_code = scores_by_code(store, captures, pairs, case)
        by_text = {
            name: trial.similarity[across]
            for name in ATTRIBUTES
            if (trial := table.trial(case, "thesis", name))
        }
        for matcher, scores in (("text", by_text), ("code", by_code)):
            for name, values in {**scores, "fused": fused(scores)}.items():
                for gallery, (those, similarity) in (
                    ("open", (pairs, values)),
                    ("closed set", closed_set(pairs, values)),
                ):
                    trial = Trial(case, matcher, name, similarity, None)
                    part = Table(those, (trial,), ())
                    work = Work(part, known_of(those, truth), passing_everywhere(part), settings)
                    rows += [
                        {"gallery": gallery, **row} for row in rate_rows(work, [trial], 1, JUDGED)
                    ]
    kept = (
        "case",
        "matcher",
        "attribute",
        "gallery",
        "sessions",
        "genuine",
        "impostors",
        "fingers",
    )
    figures = [
        f"gar@{far}{end}"
        for far in ("0.01", "0.001")
        for end in ("", "_low_finger", "_high_finger")
    ]
    write_csv(options.out, [{name: row.get(name) for name in (*kept, *figures)} for row in rows])
    print(f"{options.out}: {len(rows)} rows")
    return 0


if __name__ == "__main__":
    sys.exit(main())
