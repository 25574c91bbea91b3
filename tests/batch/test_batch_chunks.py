"""Chunks and timings of a store: damage is said in a sentence, and sizes are checked before they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from batch_stores import rows_of
from splitknit.errors import BadInput
from splitknit.io.npz import write_npz
from splitknit_match.batch.chunks import read_chunk, read_origin, write_chunk
from splitknit_match.batch.engine import to_scores
from splitknit_match.batch.store import Store

NAMES = ("S01/session_1/right_index", "S01/session_2/right_index", "S02/session_1/right_index")
COLUMNS = ("a", "b", "genuine", "similarity", "compared", "shift_mm")
ROWS: list[dict[str, Any]] = [
    dict(zip(COLUMNS, row, strict=True))
    for row in ((NAMES[0], NAMES[1], True, 0.9, True, 0.5), (NAMES[0], NAMES[2], False, 0.1, True, 0.25))
]


@pytest.fixture
def chunk(tmp_path: Path) -> Path:
    """A chunk of scores in a store."""
    file = tmp_path / "store" / "scores" / "ea" / "ridge" / "0.npz"
    write_chunk(file, ROWS, COLUMNS, {"kind": "scores"})
    return file


def scores(chunk: Path) -> Any:
    return Store(chunk.parents[3]).scores("ea", "ridge")


def test_a_sound_chunk_is_read(chunk: Path) -> None:
    assert rows_of(scores(chunk)) == ROWS
    assert list(read_chunk(chunk, ["b", "a"])) == ["b", "a"]
    assert read_origin(chunk) == {"kind": "scores"}
    with pytest.raises(BadInput, match="holds no column 'template'"):
        read_chunk(chunk, ["template"])


def test_payloads_lists_and_numbers_that_are_missing_come_back(tmp_path: Path) -> None:
    rows = [
        {"capture": "a", "template": b"\0x\0", "warnings": ["dark", "\u00b5m"], "area_mm2": None},
        {"capture": "bcd", "template": None, "warnings": [], "area_mm2": 2.0},
    ]
    for file in (tmp_path / "x.npz", tmp_path / "y.npz"):
        write_chunk(file, rows, tuple(rows[0]), {})
    assert (tmp_path / "x.npz").read_bytes() == (tmp_path / "y.npz").read_bytes()
    table = read_chunk(tmp_path / "x.npz")
    assert table["template"].tolist() == [b"\0x\0", b""]
    assert table["warnings"].tolist() == [["dark", "\u00b5m"], []]
    np.testing.assert_array_equal(table["area_mm2"], [np.nan, 2.0])
    write_chunk(tmp_path / "x.npz", [], tuple(rows[0]), {})
    assert [len(column) for column in read_chunk(tmp_path / "x.npz").values()] == [0] * 4


def test_of_a_pair_that_lies_in_two_chunks_the_first_counts(chunk: Path) -> None:
    write_chunk(chunk.with_name("1.npz"), [ROWS[1] | {"similarity": 0.7}, ROWS[0]], COLUMNS, {})
    assert rows_of(scores(chunk)) == ROWS


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"a": np.array([1.0, 2.0])}, "damaged"),
        ({"a": np.array(["x"])}, "damaged"),
        ({"genuine": np.array([0.0, 1.0])}, "damaged"),
        ({"genuine": None}, "holds no column 'genuine'"),
        ({"compared": None}, "holds no column 'compared'"),
        ({"similarity": np.array(["high", "low"])}, "damaged"),
        ({"similarity": np.zeros((2, 2))}, "damaged"),
        ({"template": np.zeros(3, np.uint8)}, "damaged"),
        ({"template": np.zeros(3, np.uint8), "template.ends": np.array([2, 4])}, "damaged"),
        ({"template": np.zeros(3, np.uint8), "template.ends": np.array([4, 3])}, "damaged"),
    ],
)
def test_columns_of_another_kind_are_refused(chunk: Path, change: dict[str, Any], words: str) -> None:
    columns = {name: np.array([row[name] for row in ROWS]) for name in COLUMNS} | change
    write_npz(chunk, {name: values for name, values in columns.items() if values is not None})
    with pytest.raises(BadInput, match=words) as caught:
        scores(chunk)
    assert "\n" not in str(caught.value)


def test_damage_is_refused_in_a_sentence(chunk: Path) -> None:
    whole = chunk.read_bytes()
    for content in (b"", b"PAR1", whole[:-9], whole[:100] + whole[120:]):
        chunk.write_bytes(content)
        with pytest.raises(BadInput, match="damaged"):
            read_chunk(chunk)
    for origin in ({}, {"origin": np.array("{")}, {"origin": np.array("3")}, {"origin": np.zeros(3)}):
        write_npz(chunk, {"a": np.array(["x"]), **origin})
        with pytest.raises(BadInput, match=r"damaged|not valid JSON"):
            read_origin(chunk)


def test_sizes_are_checked_before_a_chunk_is_read(chunk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_chunk(chunk, [row | {"a": "x" * 1_000_000} for row in ROWS], COLUMNS, {})
    monkeypatch.setattr("splitknit_match.batch.chunks._MAX_BYTES", 500_000)
    assert chunk.stat().st_size < 100_000
    with pytest.raises(BadInput, match="damaged"):
        read_chunk(chunk)


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
def test_names_that_are_no_captures_are_refused(chunk: Path, name: str) -> None:
    write_chunk(chunk, [row | {"a": name} for row in ROWS], COLUMNS, {})
    with pytest.raises(BadInput, match="names no capture"):
        to_scores(scores(chunk))
