"""Chunk files: Parquet tables that appear whole or not at all, with their provenance inside."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splitknit.batch.packages import load
from splitknit.check import BadInput
from splitknit.io import atomic_file
from splitknit.io.provenance import canonical_json

SUFFIX = ".parquet"
_KEY = b"splitknit"
_REMEDY = "delete it and run the same again: only what it holds is done anew"


def write_chunk(path: Path, columns: Mapping[str, Sequence[Any]], schema: Any, origin: Mapping[str, Any]) -> None:
    """Write a table; `origin` goes into the file's metadata.

    Equal columns and origin give equal bytes.
    """
    pa, pq = load("pyarrow", "batch"), load("pyarrow.parquet", "batch")
    described = schema.with_metadata({_KEY: canonical_json(origin).encode("ascii")})
    table = pa.table({name: pa.array(columns[name], type=schema.field(name).type) for name in schema.names}, described)
    with atomic_file(path) as stream:
        pq.write_table(
            table,
            stream,
            compression="zstd",
            compression_level=1,
            use_dictionary=[name for name in schema.names if pa.types.is_string(schema.field(name).type)],
            write_statistics=False,
            store_schema=True,
        )


def read_chunk(path: Path, columns: Sequence[str] | None = None) -> Any:
    """Read a chunk as a ``pyarrow.Table`` without metadata.

    Raises
    ------
    BadInput
        If it is damaged.
    """
    pa, pq = load("pyarrow", "batch"), load("pyarrow.parquet", "batch")
    try:
        table = pq.read_table(path, columns=None if columns is None else list(columns), partitioning=None)
    except (pa.ArrowException, OSError) as error:
        raise _damaged(path) from error
    missing = [name for name in columns or () if name not in table.column_names]
    if missing:
        raise BadInput(f"'{path}' holds no column '{missing[0]}': it is of another version; {_REMEDY}.")
    return table.replace_schema_metadata(None)


def read_origin(path: Path) -> dict[str, Any]:
    """Provenance in a chunk's metadata.

    Raises
    ------
    BadInput
        If the file is damaged.
    """
    pa, pq = load("pyarrow", "batch"), load("pyarrow.parquet", "batch")
    try:
        return dict(json.loads(pq.read_schema(path).metadata[_KEY]))
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise _damaged(path) from error


def chunk_files(folder: Path) -> list[Path]:
    """Finished chunks in a folder, in their order; what is being written has another name."""
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix == SUFFIX and not file.name.startswith("."))


def _damaged(path: Path) -> BadInput:
    return BadInput(f"'{path}' is damaged; {_REMEDY}.")


def write_timings(folder: Path, name: str, facts: Mapping[str, Any]) -> None:
    """Write how long the work of a chunk took."""
    with atomic_file(folder / f"{name}.json") as stream:
        stream.write((canonical_json(facts) + "\n").encode("ascii"))
