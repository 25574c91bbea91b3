"""Chunk files: Parquet tables that appear whole or not at all, with their provenance inside."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

from splitknit import canonical_json, importing, parse_json, refusing, require, settings_hash
from splitknit_match.batch.objects import Location, stored_file, whole_file

# Packages that only the batch engine needs, imported when it needs them.


def load(module: str, extra: str) -> Any:
    """Import `module`, which comes with the extra `extra`. Raises BadInput if it is not installed."""
    package = module.partition(".")[0]
    with importing(
        f"this needs {package}, which cannot be imported ({{error}}); pip install 'splitknit-match[{extra}]'."
    ):
        return importlib.import_module(module)


SUFFIX = ".parquet"
_KEY = b"splitknit"
_MAX_BYTES = 2_000_000_000  # largest file, and largest columns in it: surfaces of forty captures
_MAX_ROWS, _MAX_COLUMNS = 10_000_000, 1000
_TEXTS = {"capture", "subject", "finger", "session", "failure", "input_sha256", "a", "b"}
_FLAGS = {"acquired", "genuine", "compared"}
_PAYLOADS = {"template", "print", "images", "minutiae"}
_NEVER_NULL = (_TEXTS | _FLAGS | _PAYLOADS | {"area_mm2"}) - {"print", "images"}
_REMEDY = "delete it and run the same again: only what it holds is done anew"


def write_chunk(path: Location, columns: Mapping[str, Sequence[Any]], schema: Any, origin: Mapping[str, Any]) -> None:
    """Write a table; `origin` goes into the file's metadata. Equal columns and origin give equal bytes."""
    pa, pq = load("pyarrow", "batch"), load("pyarrow.parquet", "batch")
    described = schema.with_metadata({_KEY: canonical_json(origin).encode("ascii")})
    table = pa.table({name: pa.array(columns[name], type=schema.field(name).type) for name in schema.names}, described)
    with whole_file(path) as stream:
        texts = [name for name in schema.names if pa.types.is_string(schema.field(name).type)]
        packed: dict[str, Any] = {"compression": "zstd", "compression_level": 1, "use_dictionary": texts}
        pq.write_table(table, stream, **packed, write_statistics=False, store_schema=True)


def column_type(name: str) -> Any:
    """Arrow's type of a column, the same in all kinds of chunks; what has no type of its own is a number."""
    pa = load("pyarrow", "batch")
    if name in _TEXTS:
        return pa.string()
    if name == "warnings":
        return pa.list_(pa.string())
    return pa.bool_() if name in _FLAGS else pa.binary() if name in _PAYLOADS else pa.float64()


def read_chunk(path: Location, columns: Sequence[str] | None = None, needed: Sequence[str] = ()) -> Any:
    """Read a chunk as a ``pyarrow.Table`` without metadata: `columns`, or else whatever is there, among it `needed`.
    Raises BadInput if it is damaged, too large, or a column is missing or of another type.
    """
    pa, pq = load("pyarrow", "batch"), load("pyarrow.parquet", "batch")
    with stored_file(path, _MAX_BYTES) as stream, refusing(_damaged(path)):
        with pq.ParquetFile(stream) as file:
            facts, schema = file.metadata, file.schema_arrow
            leaves = [file.schema.column(k) for k in range(len(file.schema))]
        # the sizes of single columns are not asked for: pyarrow ends the process where their statistics are damaged
        size = sum(facts.row_group(k).total_byte_size for k in range(facts.num_row_groups))
        sizes = facts.num_rows <= _MAX_ROWS and size <= _MAX_BYTES and len(leaves) <= _MAX_COLUMNS
        require(sizes, f"'{path}' is too large; {_REMEDY}.")
        missing = [name for name in columns or needed if name not in schema.names]
        require(not missing, f"'{path}' holds no column '{''.join(missing[:1])}': it is of another version; {_REMEDY}.")
        names = list(dict.fromkeys(columns or schema.names))
        sound = len(set(schema.names)) == len(schema.names)
        require(sound and all(schema.field(one).type == column_type(one) for one in names), _damaged(path))
        # a value that is stored once can be in every row: texts are counted before they are written out, and what is
        # large comes row by row
        texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY" and leaf.path not in _PAYLOADS]
        schema = pa.schema([schema.field(name) for name in names])
        table, left = [schema.empty_table()], _MAX_BYTES
        with pq.ParquetFile(stream, metadata=facts, read_dictionary=texts) as file:
            for batch in file.iter_batches(1 if _PAYLOADS.intersection(names) else 1 << 16, columns=names):
                left -= sum(map(_decoded_bytes, batch.columns))
                require(left >= 0, f"'{path}' is too large; {_REMEDY}.")
                table.append(pa.table([batch.column(one.name).cast(one.type) for one in schema], schema))
        read = pa.concat_tables(table)
        read.validate(full=True)
        require(all(read.column(one).null_count == 0 for one in names if one in _NEVER_NULL), _damaged(path))
    return read.replace_schema_metadata(None)


def _decoded_bytes(column: Any) -> int:
    """Size of a column when its texts, which may be stored once each, are written out."""
    values = column.flatten() if hasattr(column, "flatten") and hasattr(column, "offsets") else column
    if not hasattr(values, "dictionary"):
        return int(column.nbytes)
    pc = load("pyarrow.compute", "batch")
    return 5 * len(column) + int(pc.sum(pc.binary_length(values.dictionary).take(values.indices)).as_py() or 0)


def read_origin(path: Location) -> dict[str, Any]:
    """Provenance in a chunk's metadata. Raises BadInput if the file is damaged."""
    schema = read_schema(path)
    with refusing(_damaged(path)):
        return dict(parse_json(schema.metadata[_KEY], str(path)))


def read_schema(path: Location) -> Any:
    """Columns of a chunk. Raises BadInput if the file is damaged."""
    pq = load("pyarrow.parquet", "batch")
    with stored_file(path, _MAX_BYTES) as stream, refusing(_damaged(path)):
        return pq.read_schema(stream)


def chunk_name(number: str, source: Sequence[Any]) -> str:
    """Name of a chunk's file without suffix: its number, and a hash of what its content follows from."""
    return f"{number}-{settings_hash(source)[:12]}"


def _damaged(path: Location) -> str:
    return f"'{path}' is damaged; {_REMEDY}."


def write_timings(folder: Location, name: str, facts: Mapping[str, Any]) -> None:
    """Write how long the work of a chunk took."""
    with whole_file(folder / f"{name}.json") as stream:
        stream.write((canonical_json(facts) + "\n").encode("ascii"))
