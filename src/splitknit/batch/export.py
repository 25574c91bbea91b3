"""Scores of the store for everyone: as :class:`splitknit.evaluation.Scores`, and as CSV files."""

from __future__ import annotations

import csv
import io
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.evaluation.scores import Ids, Scores, ids_of
from splitknit.io.atomic import atomic_file

_KINDS = ("finger", "subject", "session")


def to_scores(table: Any, column: str = "similarity", name: str | None = None) -> Scores:
    """Comparisons of the store, ready to be evaluated.

    Parameters
    ----------
    table : ``pyarrow.Table`` of :meth:`splitknit.batch.Store.scores`
    column : what is the score; of a ``dissimilarity...``, 1 - its value, as everywhere in the library
    name : of the scores; that of the column where it is missing

    Returns
    -------
    Scores
        NaN where nothing was compared, with the names of fingers, subjects and sessions.
    """
    require(column in table.column_names, f"the scores hold no column '{column}'; they have {table.column_names}.")
    score = np.array(table.column(column).to_numpy(), dtype=np.float64)
    score = 1.0 - score if column.startswith("dissimilarity") else score
    score[~_flags(table, "compared")] = np.nan
    return Scores(_flags(table, "genuine"), score, **_ids(table), name=name or column)


def write_csv(path: Path, table: Any) -> None:
    """Write comparisons as a score file: ``label``, ``score``, names of both sides, and the matcher's own columns."""
    a, b = table.column("a").to_pylist(), table.column("b").to_pylist()
    own = [name for name in table.column_names if name not in ("a", "b", "genuine", "similarity", "compared")]
    compared = _flags(table, "compared").tolist()
    columns: dict[str, list[Any]] = {
        "label": _flags(table, "genuine").astype(int).tolist(),
        "score": _numbers(table, "similarity", compared),
    }
    for kind in _KINDS:
        columns |= {f"{kind}_a": [_names_of(one)[kind] for one in a], f"{kind}_b": [_names_of(one)[kind] for one in b]}
    columns |= {name: _numbers(table, name, compared) for name in own}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    with atomic_file(path) as stream:
        stream.write(text.getvalue().encode("utf-8"))


@lru_cache(maxsize=4096)
def _names_of(capture: str) -> dict[str, str]:
    """Finger (of the world), subject and session of a capture's name.

    Examples
    --------
    >>> names_of("S01/session_2/right_index")
    {'finger': 'S01/right_index', 'subject': 'S01', 'session': '2'}
    """
    subject, session, finger = parts if len(parts := capture.split("/")) == 3 else ("", "", "")
    require(
        bool(subject), f"{capture[:60]!a} names no capture, such as S01/session_2/right_index; run the batch again."
    )
    return {"finger": f"{subject}/{finger}", "subject": subject, "session": session.removeprefix("session_")}


def _ids(table: Any) -> dict[str, Ids]:
    sides = [[_names_of(one) for one in table.column(side).to_pylist()] for side in ("a", "b")]
    return {kind: ids_of(*([names[kind] for names in side] for side in sides)) for kind in _KINDS}


def _flags(table: Any, column: str) -> NDArray[np.bool_]:
    return np.array(table.column(column).to_numpy(zero_copy_only=False), dtype=np.bool_)


def _numbers(table: Any, column: str, compared: list[bool]) -> list[str]:
    """Shortest exact text of each number, blank where nothing was compared."""
    values = table.column(column).to_pylist()
    return [repr(float(value)) if known else "" for value, known in zip(values, compared, strict=True)]
