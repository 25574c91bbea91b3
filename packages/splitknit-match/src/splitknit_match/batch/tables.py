"""Tables of a store: ``.npz`` files that appear whole or not at all, with their provenance inside.

A column of text is an array of text, a flag is true or false, a payload (``template``) is the bytes
of the only row, and all else are numbers, NaN where there is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import refusing, require
from splitknit.io.fields import parse_json
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.provenance import canonical_json

SUFFIX = ".npz"
ORIGIN = "origin"
Table = dict[str, NDArray[Any]]
"""Columns by their names; payloads are arrays of ``bytes``."""
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
_PAYLOADS = ("template", "print", "minutiae")
_REMEDY = "delete it and run the same again: only what it holds is done anew"
_TYPES: dict[str, type] = dict.fromkeys(_TEXTS, np.str_) | dict.fromkeys(_FLAGS, np.bool_)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], origin: Mapping[str, Any]) -> None:
    """Write `rows`, of the same columns, and their `origin`; equal ones give equal bytes."""
    arrays = {ORIGIN: np.array(canonical_json(origin))}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if name in _PAYLOADS:
            arrays[name] = np.frombuffer(b"".join(values), np.uint8)
        else:
            arrays[name] = np.array(values, dtype=_TYPES.get(name, np.float64))
    write_npz(path, arrays)


def read_table(path: Path, columns: Sequence[str] | None = None) -> Table:
    """Read `columns` of a table, or else all.

    Raises BadInput if it is damaged or too large, or a column is missing or of another type.
    """
    arrays = _arrays(path, columns)
    names = columns or [name for name in arrays if name != ORIGIN]
    missing = [name for name in names if name not in arrays]
    require(
        not missing, f"'{path}' holds no column {missing}: it is of another version; {_REMEDY}."
    )
    with refusing(_damaged(path)):
        table = {name: _column(name, arrays) for name in names}
        require(len({len(column) for column in table.values()}) == 1, _damaged(path))
    return table


def read_origin(path: Path) -> dict[str, Any]:
    """Provenance of a table. Raises BadInput if the file is damaged."""
    with refusing(_damaged(path)):
        return dict(parse_json(str(_arrays(path, [ORIGIN])[ORIGIN]).encode(), str(path)))


MAX_BYTES = 100_000_000  # longest columns of one file


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
    return np.array([array.tobytes()], dtype=object) if name in _PAYLOADS else array


def _damaged(path: Path) -> str:
    return f"'{path}' is damaged; {_REMEDY}."
