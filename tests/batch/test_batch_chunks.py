"""Chunks and timings of a store: damage is said in a sentence, and sizes are checked before they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from splitknit.errors import BadInput
from splitknit_match.batch.chunks import column_type, read_chunk, read_origin, read_schema, write_chunk
from splitknit_match.batch.engine import _names_of
from splitknit_match.batch.scores import score_schema
from splitknit_match.batch.store import Store

NAMES = ("S01/session_1/right_index", "S01/session_2/right_index", "S02/session_1/right_index")
COLUMNS: dict[str, list[Any]] = {
    "a": [NAMES[0], NAMES[0]], "b": [NAMES[1], NAMES[2]], "genuine": [True, False], "similarity": [0.9, 0.1],
    "compared": [True, True], "shift_mm": [0.5, 0.25],
}  # fmt: skip


@pytest.fixture
def chunk(tmp_path: Path) -> Path:
    """A chunk of scores in a store."""
    file = tmp_path / "store" / "scores" / "ea" / "ridge" / "0.parquet"
    write_chunk(file, COLUMNS, score_schema(("shift_mm",)), {"kind": "scores"})
    return file


def scores(chunk: Path) -> Any:
    return Store(chunk.parents[3]).scores("ea", "ridge")


def test_a_sound_chunk_is_read(chunk: Path) -> None:
    assert scores(chunk).to_pydict() == COLUMNS
    assert read_chunk(chunk, ["b", "a"]).column_names == ["b", "a"]
    assert read_origin(chunk) == {"kind": "scores"}
    assert read_schema(chunk).names == list(COLUMNS)
    with pytest.raises(BadInput, match="holds no column 'template'"):
        read_chunk(chunk, ["template"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"a": pa.array([b"\xff", b"x"]).view(pa.string())}, "damaged"),  # no UTF-8
        ({"a": pa.array([1, 2])}, "damaged"),
        ({"a": pa.array([None, "x"])}, "damaged"),
        ({"genuine": pa.array([0.0, 1.0])}, "damaged"),
        ({"genuine": None}, "holds no column 'genuine'"),
        ({"compared": None}, "holds no column 'compared'"),
        ({"similarity": pa.array(["high", "low"])}, "damaged"),
        ({"similarity": pa.array([None, 0.5])}, "lack numbers"),
        ({"shift_mm": pa.array([None, 0.5])}, "lack numbers"),
    ],
)
def test_columns_of_another_kind_are_refused(chunk: Path, change: dict[str, Any], words: str) -> None:
    columns = {name: pa.array(values, column_type(name)) for name, values in COLUMNS.items()} | change
    pq.write_table(pa.table({name: values for name, values in columns.items() if values is not None}), chunk)
    with pytest.raises(BadInput, match=words) as caught:
        scores(chunk)
    assert "\n" not in str(caught.value)


def test_damage_is_refused_in_a_sentence(chunk: Path) -> None:
    whole = chunk.read_bytes()
    for content in (b"", b"PAR1", whole[:-9], whole[:100] + whole[120:]):
        chunk.write_bytes(content)
        with pytest.raises(BadInput, match="damaged"):
            read_chunk(chunk)
    for metadata in ({}, {"splitknit": "{"}, {"splitknit": "3"}, {"splitknit": b"\xff"}):
        pq.write_table(pa.table({"a": ["x"]}).replace_schema_metadata(metadata), chunk)
        with pytest.raises(BadInput, match=r"damaged|not valid JSON"):
            read_origin(chunk)


def test_sizes_are_checked_before_a_chunk_is_read(chunk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitknit_match.batch.chunks._MAX_ROWS", 1)
    with pytest.raises(BadInput, match="too large"):
        read_chunk(chunk)
    monkeypatch.undo()
    name = "x" * 1_000_000
    write_chunk(chunk, COLUMNS | {"a": [name, name]}, score_schema(("shift_mm",)), {})
    monkeypatch.setattr("splitknit_match.batch.chunks._MAX_BYTES", 500_000)
    assert chunk.stat().st_size < 100_000
    with pytest.raises(BadInput, match="too large"):
        read_chunk(chunk)


@pytest.mark.parametrize("name", ["capture", "warnings", "template"])
def test_a_value_that_is_stored_once_counts_in_every_row(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """300 bytes, of which pyarrow would make thirty times what a chunk may hold."""
    monkeypatch.setattr("splitknit_match.batch.chunks._MAX_BYTES", 1_000_000)
    kind = pa.binary() if name == "template" else pa.string()
    values: Any = pa.DictionaryArray.from_arrays(pa.array([0] * 300, pa.int32()), pa.array(["x" * 100_000], kind))
    if name == "warnings":
        values = pa.ListArray.from_arrays(pa.array(range(301), pa.int32()), values)
    pq.write_table(pa.table({name: values}), tmp_path / "x.parquet", compression="zstd", store_schema=False)
    assert (tmp_path / "x.parquet").stat().st_size < 5000
    with pytest.raises(BadInput, match="too large"):
        read_chunk(tmp_path / "x.parquet")


@pytest.mark.parametrize("text", ["", "[]", "3", '{"S01": "fast"}', '{"S01": 1e999}', '{"S01": null}', "\u00ff{}"])
def test_damaged_timings_are_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "timings" / "ea" / "0.json"
    file.parent.mkdir(parents=True)
    file.write_text('{"S01": 1.5}')
    assert Store(tmp_path).seconds("ea") == {"S01": 1.5}
    file.write_text(text)
    with pytest.raises(BadInput, match=r"0\.json.*delete it"):
        Store(tmp_path).seconds("ea")


@pytest.mark.parametrize("name", ["", "S01", "S01/right_index", "a/b/c/d"])
def test_names_that_are_no_captures_are_refused(name: str) -> None:
    with pytest.raises(BadInput, match="names no capture"):
        _names_of(name)
