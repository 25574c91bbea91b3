"""Comparisons of one block, one table of the store; and score files."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import refusing
from splitknit.io.atomic import write_file
from splitknit.io.provenance import provenance, settings_hash
from splitknit_match.batch.matchers import matcher_of
from splitknit_match.batch.store import SCORES, SUFFIX, Place, Table, read_origin, write_table
from splitknit_match.batch.tasks import Done
from splitknit_match.evaluation.protocol import Comparisons
from splitknit_match.evaluation.scores import score_table


@dataclass(frozen=True, slots=True)
class Block:
    """Comparisons that are made together."""

    pairs: Comparisons
    names: Mapping[int, str]  # of the captures that are compared
    places: Mapping[int, Place]  # where the matcher's input is


def compare_block(folder: Path, name: str, origin: Mapping[str, Any], block: Block) -> Done:
    """Make the comparisons of a block by the matcher `name`, and write their table."""
    started = time.thread_time()
    matcher, names, places = matcher_of(name), block.names, block.places
    missing = dict.fromkeys(("similarity", *matcher.columns), math.nan)
    earlier = {int(a): matcher.database(places[a]) for a in np.unique(block.pairs.a)}
    rows = []
    query = None
    previous = -1
    columns = (block.pairs.a, block.pairs.b, block.pairs.genuine)
    for a, b, genuine in zip(*(column.tolist() for column in columns), strict=True):
        if b != previous:  # one query after the other
            query, previous = matcher.query(places[b]), b
        compared = earlier[a] is not None and query is not None
        values = matcher.compare(earlier[a], query) if compared else missing
        row = {"a": names[a], "b": names[b], "genuine": genuine}
        rows.append(row | {"similarity": values["similarity"], "compared": compared} | values)
    inputs = {names[k]: read_origin(places[k].file)["inputs"][names[k]] for k in names}
    origin = {**provenance(matcher.document, inputs), "kind": "scores", "kind_version": 1, **origin}
    content = settings_hash([origin, [(row["a"], row["b"]) for row in rows]])
    write_table(folder / f"{content[:24]}{SUFFIX}", rows, origin)
    return Done(len(rows), time.thread_time() - started)


def write_scores(path: Path, table: Table) -> None:
    """Write comparisons of a store as a score file, with the matcher's own columns; what was not
    compared is blank.
    """
    names: dict[str, list[list[str]]] = {"finger": [], "subject": [], "session": []}
    with refusing("a table of scores names no capture, such as S01/session_2/right_index."):
        for side in "ab":
            parts = [capture.split("/") for capture in table[side].tolist()]
            names["finger"].append([f"{subject}/{finger}" for subject, _, finger in parts])
            names["subject"].append([subject for subject, _, _ in parts])
            names["session"].append([session.removeprefix("session_") for _, session, _ in parts])
    own = {name: column.tolist() for name, column in table.items() if name not in SCORES}
    scores = {"score": table["similarity"].tolist(), **own}
    sides = {kind: (a, b) for kind, (a, b) in names.items()}
    write_file(path, score_table(table["genuine"].tolist(), sides, scores))
