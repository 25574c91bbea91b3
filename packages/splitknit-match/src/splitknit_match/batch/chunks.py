"""Chunk files: tables as ``.npz`` that appear whole or not at all, with their provenance inside.

A text column is an array of text, ``warnings`` are JSON, a flag is true or false, a payload is the bytes of all rows
(``template``) and where each ends (``template.ends``), and all else are numbers, NaN where there is none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import refusing, require
from splitknit.io.atomic import atomic_file
from splitknit.io.fields import parse_json
from splitknit.io.npz import read_npz
from splitknit.io.npz import write_npz as write_arrays
from splitknit.io.provenance import canonical_json, settings_hash

SUFFIX = ".npz"
Table = dict[str, NDArray[Any]]
"""Columns by their names; payloads are arrays of ``bytes``, warnings of lists."""
_ORIGIN, _ENDS = "origin", ".ends"
_MAX_BYTES = 2_000_000_000  # largest columns in a file: surfaces of forty captures
_TEXTS = {"capture", "subject", "finger", "session", "failure", "input_sha256", "a", "b", "warnings"}
_FLAGS = {"acquired", "genuine", "compared"}
_PAYLOADS = {"template", "print", "images", "minutiae"}
_REMEDY = "delete it and run the same again: only what it holds is done anew"


def write_chunk(path: Path, rows: Sequence[Mapping[str, Any]], names: Sequence[str], origin: Mapping[str, Any]) -> None:
    """Write the columns `names` of rows, and their `origin`. Equal rows and origin give equal bytes."""
    arrays: Table = {_ORIGIN: np.array(canonical_json(origin))}
    for name in names:
        values = [row[name] for row in rows]
        if name in _PAYLOADS:
            parts = [value or b"" for value in values]
            arrays[name] = np.frombuffer(b"".join(parts), np.uint8)
            arrays[f"{name}{_ENDS}"] = np.cumsum([len(part) for part in parts], dtype=np.int64)
        elif name in _TEXTS:
            arrays[name] = np.array([json.dumps(one) if name == "warnings" else one for one in values], dtype=np.str_)
        else:
            arrays[name] = np.array(values, dtype=np.bool_ if name in _FLAGS else np.float64)
    write_arrays(path, arrays)


def read_chunk(path: Path, columns: Sequence[str] | None = None, needed: Sequence[str] = ()) -> Table:
    """Columns of a chunk: `columns`, or else whatever is there, among it `needed`. Raises BadInput if it is damaged,
    too large, or a column is missing or of another type.
    """
    wanted = None if columns is None else {*columns, *(f"{name}{_ENDS}" for name in columns)}
    arrays = _arrays(path, wanted)
    missing = [name for name in columns or needed if name not in arrays]
    require(not missing, f"'{path}' holds no column '{''.join(missing[:1])}': it is of another version; {_REMEDY}.")
    with refusing(_damaged(path)):
        names = columns or [name for name in arrays if name != _ORIGIN and not name.endswith(_ENDS)]
        table = {name: _column(name, arrays, _damaged(path)) for name in names}
        require(len({len(column) for column in table.values()}) == 1, _damaged(path))
    return table


def _arrays(path: Path, names: set[str] | None) -> Table:
    try:
        return read_npz(path, names, _MAX_BYTES)
    except BadInput as error:
        raise BadInput(_damaged(path)) from error


def _column(name: str, arrays: Table, damaged: str) -> NDArray[Any]:
    array = arrays[name]
    kinds = "u" if name in _PAYLOADS else "U" if name in _TEXTS else "b" if name in _FLAGS else "f"
    require(array.ndim == 1 and array.dtype.kind == kinds, damaged)
    if name not in _PAYLOADS and name != "warnings":
        return array
    if name == "warnings":
        values: list[Any] = [json.loads(text) for text in array.tolist()]
    else:
        ends, whole = arrays[f"{name}{_ENDS}"].tolist(), array.tobytes()
        starts = [0, *ends][: len(ends)]
        require([0, *ends] == sorted([0, *ends]) and (ends or [0])[-1] == len(whole), damaged)
        values = [whole[start:end] for start, end in zip(starts, ends, strict=True)]
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column


def read_origin(path: Path) -> dict[str, Any]:
    """Provenance in a chunk. Raises BadInput if the file is damaged."""
    with refusing(_damaged(path)):
        return dict(parse_json(str(_arrays(path, {_ORIGIN})[_ORIGIN]).encode(), str(path)))


def chunk_name(number: str, source: Sequence[Any]) -> str:
    """Name of a chunk's file without suffix: its number, and a hash of what its content follows from."""
    return f"{number}-{settings_hash(source)[:12]}"


def _damaged(path: Path) -> str:
    return f"'{path}' is damaged; {_REMEDY}."


def write_timings(folder: Path, name: str, facts: Mapping[str, Any]) -> None:
    """Write how long the work of a chunk took."""
    with atomic_file(folder / f"{name}.json") as stream:
        stream.write((canonical_json(facts) + "\n").encode("ascii"))
