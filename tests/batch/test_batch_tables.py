"""Tables of a store: damage is reported in a sentence, and sizes are checked before they are
read."""

import numpy as np
import pytest

from batch_stores import rows_of
from refusals import bad_input
from splitknit.io.npz import write_npz
from splitknit_match.batch.engine import write_scores
from splitknit_match.batch.store import Store, read_origin, read_table, write_table

NAMES = ("S01/session_1/right_index", "S01/session_2/right_index", "S02/session_1/right_index")
COLUMNS = ("a", "b", "genuine", "similarity", "compared", "shift_mm")
ROWS = [
    dict(zip(COLUMNS, row, strict=True))
    for row in (
        (NAMES[0], NAMES[1], True, 0.9, True, 0.5),
        (NAMES[0], NAMES[2], False, 0.1, True, 0.25),
    )
]


@pytest.fixture
def table(tmp_path):
    """Scores in a store."""
    file = tmp_path / "store" / "scores" / "ea" / "ridge" / "0.npz"
    write_table(file, ROWS, {"kind": "scores"})
    return file


def scores(table):
    return Store(table.parents[3]).scores("ea", "ridge")


def test_a_sound_table_is_read(table):
    assert rows_of(scores(table)) == ROWS
    assert list(read_table(table, ["b", "a"])) == ["b", "a"]
    assert read_origin(table) == {"kind": "scores"}
    with bad_input(r"holds no column .*template"):
        read_table(table, ["template"])


def test_payloads_and_numbers_that_are_missing_come_back(tmp_path):
    row = {"capture": "a", "template": b"\0x\0", "warnings": '["dark"]', "area_mm2": None}
    for file in (tmp_path / "x.npz", tmp_path / "y.npz"):
        write_table(file, [row | {"print": b""}], {})
    assert (tmp_path / "x.npz").read_bytes() == (tmp_path / "y.npz").read_bytes()
    table = read_table(tmp_path / "x.npz")
    assert table["template"].tolist() == [b"\0x\0"]
    assert table["print"].tolist() == [b""]
    assert table["warnings"].tolist() == ['["dark"]']
    np.testing.assert_array_equal(table["area_mm2"], [np.nan])


def test_of_a_pair_that_lies_in_two_tables_the_first_counts(table):
    write_table(table.with_name("1.npz"), [ROWS[1] | {"similarity": 0.7}, ROWS[0]], {})
    assert rows_of(scores(table)) == ROWS


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"a": np.array([1.0, 2.0])}, "damaged"),
        ({"a": np.array(["x"])}, "damaged"),
        ({"genuine": np.array([0.0, 1.0])}, "damaged"),
        ({"a": None}, "other columns"),
        ({"similarity": np.array(["high", "low"])}, "damaged"),
        ({"similarity": np.zeros((2, 2))}, "damaged"),
        ({"template": np.zeros(3, np.uint8)}, "damaged"),
    ],
)
def test_columns_of_another_kind_are_refused(table, change, words):
    columns = {name: np.array([row[name] for row in ROWS]) for name in COLUMNS} | change
    write_npz(table, {name: values for name, values in columns.items() if values is not None})
    with bad_input(words) as caught:
        scores(table)
    assert "\n" not in str(caught.value)


def test_damage_is_refused_in_a_sentence(table):
    whole = table.read_bytes()
    for content in (b"", b"PAR1", whole[:-9], whole[:100] + whole[120:]):
        table.write_bytes(content)
        with bad_input("damaged"):
            read_table(table)
    for origin in (
        {},
        {"origin": np.array("{")},
        {"origin": np.array("3")},
        {"origin": np.zeros(3)},
    ):
        write_npz(table, {"a": np.array(["x"]), **origin})
        with bad_input(r"damaged|not valid JSON"):
            read_origin(table)


def test_sizes_are_checked_before_a_table_is_read(table, monkeypatch):
    write_table(table, [row | {"a": "x" * 1_000_000} for row in ROWS], {})
    monkeypatch.setattr("splitknit_match.batch.store.MAX_BYTES", 500_000)
    assert table.stat().st_size < 100_000
    with bad_input("damaged"):
        read_table(table)


@pytest.mark.parametrize("name", ["", "S01", "S01/right_index", "a/b/c/d"])
def test_names_that_are_no_captures_are_refused(table, name):
    write_table(table, [row | {"a": name} for row in ROWS], {})
    with bad_input("names no capture"):
        write_scores(table.with_name("x.csv"), scores(table))
