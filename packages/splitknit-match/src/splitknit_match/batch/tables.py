"""Tables of a store: ``.npz`` files that appear whole or not at all, with their provenance inside.

A column of text is an array of text, a flag is true or false, a payload is the bytes of all rows
(``template``) and where each ends (``template.ends``), and all else are numbers, NaN where there
is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import refusing, require
from splitknit.io.fields import parse_json
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.provenance import canonical_json
from splitknit_match.batch.parameters import MAX_BYTES

SUFFIX = ".npz"
ORIGIN = "origin"
Table = dict[str, NDArray[Any]]
"""Columns by their names; payloads are arrays of ``bytes``."""
_ENDS = ".ends"
_TEXTS = (
    "capture",
    "subject",
    "finger",
    "session",
    "failure",
    "input_sha256",
    "a",
    "b",
    "warnings",
)
_FLAGS = ("acquired", "genuine", "compared")
_PAYLOADS = ("template", "print", "images", "minutiae")
_REMEDY = "delete it and run the same again: only what it holds is done anew"
_TYPES: dict[str, type] = dict.fromkeys(_TEXTS, np.str_) | dict.fromkeys(_FLAGS, np.bool_)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], origin: Mapping[str, Any]) -> None:
    """Write `rows`, of the same columns, and their `origin`; equal ones give equal bytes."""
    arrays: Table = {ORIGIN: np.array(canonical_json(origin))}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if name in _PAYLOADS:
            arrays[name] = np.frombuffer(b"".join(values), np.uint8)
            arrays[name + _ENDS] = np.cumsum([len(value) for value in values], dtype=np.int64)
        else:
            arrays[name] = np.array(values, dtype=_TYPES.get(name, np.float64))
    write_npz(path, arrays)


def read_table(path: Path, columns: Sequence[str] | None = None) -> Table:
    """Read `columns` of a table, or else all.

    Raises BadInput if it is damaged or too large, or a column is missing or of another type.
    """
    wanted = columns and [*columns, *(name + _ENDS for name in columns)]
    arrays = _arrays(path, wanted)
    names = columns or [name for name in arrays if name != ORIGIN and not name.endswith(_ENDS)]
    missing = [name for name in names if name not in arrays]
    fault = f"'{path}' holds no column {missing}: it is of another version"
    require(not missing, f"{fault}; {_REMEDY}.")
    with refusing(_damaged(path)):
        table = {name: _column(name, arrays) for name in names}
        require(len({len(column) for column in table.values()}) == 1, _damaged(path))
    return table


def read_origin(path: Path) -> dict[str, Any]:
    """Provenance of a table. Raises BadInput if the file is damaged."""
    with refusing(_damaged(path)):
        return dict(parse_json(str(_arrays(path, [ORIGIN])[ORIGIN]).encode(), str(path)))


def _arrays(path: Path, names: Sequence[str] | None) -> Table:
    try:
        return read_npz(path, names, MAX_BYTES)
    except BadInput as error:
        raise BadInput(_damaged(path)) from error


def _column(name: str, arrays: Table) -> NDArray[Any]:
    """One column; ValueError if it is not of the type that its name has."""
    array = arrays[name]
    kind = np.dtype(np.uint8 if name in _PAYLOADS else _TYPES.get(name, np.float64)).kind
    if array.ndim != 1 or array.dtype.kind != kind:
        raise ValueError
    if name not in _PAYLOADS:
        return array
    ends = [0, *arrays[name + _ENDS].tolist()]
    if ends != sorted(ends) or ends[-1] != len(array):
        raise ValueError
    whole = array.tobytes()
    column = np.empty(len(ends) - 1, dtype=object)
    column[:] = [whole[start:end] for start, end in pairwise(ends)]
    return column


def _damaged(path: Path) -> str:
    return f"'{path}' is damaged; {_REMEDY}."
