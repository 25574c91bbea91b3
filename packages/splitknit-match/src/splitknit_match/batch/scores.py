"""Comparisons of one block: one chunk of the store."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitknit.io.provenance import canonical_json, provenance
from splitknit_match.batch.chunks import SUFFIX, chunk_name, write_chunk, write_timings
from splitknit_match.batch.execution import TaskDone
from splitknit_match.batch.matchers import READY, matcher
from splitknit_match.batch.reading import Place, small_column
from splitknit_match.matching.surface import MatchingSettings

VERSION = 1  # version of a chunk's columns
COLUMNS = ("a", "b", "genuine", "similarity", "compared")
"""Of every chunk of scores, before the matcher's own."""


@dataclass(frozen=True, slots=True)
class ScoreTask:
    """Comparisons that are made together, and where they go."""

    store: Path
    case: str
    case_sha256: str
    population_sha256: str
    matcher: str
    matching: MatchingSettings
    block: int
    database: str  # by which a process knows what it has ready
    pairs: tuple[tuple[str, str, bool], ...]  # earlier capture, later capture, whether they are of one finger
    places: Mapping[str, Place]  # where the matcher's input is
    origins: Mapping[str, Place]  # where the features came from, for the hashes of the input
    seed: int


def score_block(task: ScoreTask) -> TaskDone:
    """Make the comparisons of a task and write its chunk."""
    started = time.thread_time()
    using = matcher(task.matcher, task.matching)
    missing: dict[str, Any] = dict.fromkeys(("similarity", *using.columns), math.nan)
    rows: list[dict[str, Any]] = []
    key = (task.store, task.database, canonical_json(using.document))
    held: tuple[str, Any] = ("", None)
    for a, b, genuine in sorted(task.pairs, key=lambda pair: (pair[1], pair[0])):  # one query after the other
        if held[0] != b:
            held = (b, using.query(task.places[b]))
        left, right = READY.of(key, a, using, task.places[a]), held[1]
        compared = left is not None and right is not None
        values = using.compare(left, right) if compared else missing
        rows.append({"a": a, "b": b, "genuine": genuine, "compared": compared, **values})
    rows.sort(key=lambda row: (row["a"], row["b"]))
    captures = sorted({name for a, b, _ in task.pairs for name in (a, b)})
    origin = provenance(using.document, {name: small_column(task.origins[name], "input_sha256") for name in captures})
    origin |= {"kind": "scores", "kind_version": VERSION, "case": task.case, "case_sha256": task.case_sha256}
    origin |= {"matcher": task.matcher, "population_sha256": task.population_sha256, "seed": task.seed}
    pairs = [[a, b] for a, b, _ in task.pairs]
    name = chunk_name(f"{task.block:012d}", [task.case_sha256, task.matcher, using.document, pairs])
    seconds = time.thread_time() - started
    facts = {"pairs": len(rows), "processor_s": round(seconds, 3)}
    write_timings(task.store / "timings" / task.case / task.matcher, name, facts)
    file = task.store / "scores" / task.case / task.matcher / f"{name}{SUFFIX}"
    write_chunk(file, rows, (*COLUMNS, *using.columns), origin)
    return TaskDone(len(rows), seconds)
