"""A gallery that something else changed: older, exchanged, missing and resurrected rows, older copies, version 1."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from test_gallery import KEY, SETTINGS, new, payload

from first_gallery import of_version_1
from splitknit.errors import BadInput
from splitknit_match.gallery.file import ROWS
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key
from splitknit_match.gallery.rows import Row

CODED = {"code": b"code", "code_version": 1}


@pytest.fixture(params=["plain", "encrypted"])
def key(request: pytest.FixtureRequest) -> Key | None:
    return KEY if request.param == "encrypted" else None


def tables(path: Path) -> dict[str, list[tuple]]:
    """All that is in a gallery, as it is stored."""
    raw = sqlite3.connect(path)
    found = {name: raw.execute(f"SELECT * FROM {name}").fetchall() for name in (*ROWS, "state", "about")}
    raw.close()
    return found


def put(raw: sqlite3.Connection, earlier: dict[str, list[tuple]], row: int) -> None:
    """Put a row back, from all tables."""
    for name in ROWS:
        raw.execute(f"DELETE FROM {name} WHERE id = ?", (row,))
        for cells in earlier[name]:
            if cells[0] == row:
                raw.execute(f"INSERT INTO {name} VALUES ({', '.join('?' * len(cells))})", cells)


def swapped(raw: sqlite3.Connection, earlier: dict, table: str, column: str) -> None:
    cells = raw.execute(f"SELECT {column} FROM {table} WHERE id IN (2, 4) ORDER BY id").fetchall()
    for (cell,), row in zip(cells, (4, 2), strict=True):
        raw.execute(f"UPDATE {table} SET {column} = ? WHERE id = ?", (cell, row))


def old_template(raw: sqlite3.Connection, earlier: dict) -> None:
    cells = dict(earlier["template"])
    raw.execute("UPDATE template SET content = ? WHERE id = 5", (cells[3],))


def old_row_in_place(raw: sqlite3.Connection, earlier: dict) -> None:
    raw.execute("DELETE FROM finger WHERE id = 5")
    raw.execute("DELETE FROM template WHERE id = 5")
    put(raw, earlier, 3)


def old_row_of_a_code(raw: sqlite3.Connection, earlier: dict) -> None:
    put(raw, earlier, 2)


def old_state(raw: sqlite3.Connection, earlier: dict) -> None:
    raw.execute("UPDATE state SET sealed = ?", earlier["state"][0])


def gone(raw: sqlite3.Connection, earlier: dict) -> None:
    for name in ROWS:
        raw.execute(f"DELETE FROM {name} WHERE id = 4")


def other_settings(raw: sqlite3.Connection, earlier: dict) -> None:
    about = json.loads(earlier["about"][0][0])
    raw.execute("UPDATE about SET document = ?", (json.dumps(about | {"settings_sha256": "00" * 32}),))


def statement(text: str) -> Callable[[sqlite3.Connection, dict], None]:
    return lambda raw, earlier: raw.execute(text)


ROW, ROOT, STATE = r"row \d of .* is damaged", "are not those that were last written", "the record of all its rows"
ATTACKS = {
    "templates exchanged": (lambda raw, earlier: swapped(raw, earlier, "template", "content"), ROW),
    "codes exchanged": (lambda raw, earlier: swapped(raw, earlier, "finger", "code"), ROW),
    "entries exchanged": (lambda raw, earlier: swapped(raw, earlier, "finger", "entry"), ROW),
    "another row's version": (
        statement("UPDATE finger SET version = (SELECT version FROM finger WHERE id = 5) WHERE id = 4"),
        ROOT,
    ),
    "an old template beside a newer entry": (old_template, ROW),
    "an old row in place of a newer one": (old_row_in_place, ROOT),
    "an old row with its old code": (old_row_of_a_code, ROOT),
    "a removed row brought back": (lambda raw, earlier: put(raw, earlier, 1), ROOT),
    "a removed row under another number": (
        lambda raw, earlier: raw.execute("INSERT INTO finger VALUES (9, ?, ?, ?, ?, ?)", earlier["finger"][0][1:]),
        ROOT,
    ),
    "a row taken away": (gone, ROOT),
    "a template taken away": (statement("DELETE FROM template WHERE id = 4"), ROW),
    "a code taken away": (statement("UPDATE finger SET code = NULL WHERE id = 2"), ROW),
    "an image taken away": (statement("DELETE FROM images"), ROW),
    "another version of a code": (statement("UPDATE finger SET code_version = 2 WHERE id = 2"), ROOT),
    "a code that is said to be missing": (statement("UPDATE finger SET code_version = NULL WHERE id = 2"), ROOT),
    "a column of another kind": (statement("UPDATE finger SET tag = 'text' WHERE id = 2"), ROOT),
    "the state as it was before": (old_state, ROOT),
    "no state": (statement("DELETE FROM state"), STATE),
    "a state of another kind": (statement("UPDATE state SET sealed = 'text'"), STATE),
    "two states": (statement("INSERT INTO state SELECT * FROM state"), STATE),
    "templates that are said to be of other settings": (other_settings, STATE),
}


@pytest.fixture
def changed(tmp_path: Path, key: Key | None) -> tuple[Path, dict[str, list[tuple]]]:
    """Ann (row 1) was removed, Bob's code (2) made anew, Cid (3, now 5) replaced; and all as it was before that."""
    path = tmp_path / "people.skg"
    with Gallery.create(path, SETTINGS, key) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2, **CODED), new("Cid", 3), new("Dan", 4, **CODED)])
        earlier = tables(path)
        gallery.add([new("Cid", 6)], replace=True)
        gallery.remove([1])
        gallery.set_codes({2: b"newer code"}, 1)
        pictured = new("Eve", 7, images=b"picture")
        object.__setattr__(pictured.entry, "images", "thumbnail")
        gallery.add([pictured])
        assert gallery.problems() == []
    return path, earlier


def read_all(path: Path, key: Key | None) -> None:
    with Gallery.open(path, key) as gallery:
        gallery.entries(), gallery.templates(), gallery.codes(1), gallery.images()


@pytest.mark.parametrize("name", ATTACKS)
def test_what_something_else_changed_is_found(changed, key: Key | None, name: str) -> None:
    path, earlier = changed
    attack, words = ATTACKS[name]
    read_all(path, key)
    raw = sqlite3.connect(path)
    attack(raw, earlier)
    raw.commit()
    raw.close()
    with pytest.raises(BadInput, match=words):
        read_all(path, key)
    with Gallery.open(path, key) as gallery:
        assert gallery.problems() != []
        if words != ROW:
            with pytest.raises(BadInput, match=words):
                gallery.add([new("Eve", 8)])
        gallery.repair()
        assert gallery.problems() == []
    read_all(path, key)


def test_a_change_is_found_while_the_gallery_is_open(changed, key: Key | None) -> None:
    path, earlier = changed
    with Gallery.open(path, key) as gallery:
        assert len(gallery) == 4
        raw = sqlite3.connect(path)
        put(raw, earlier, 1)
        raw.commit()
        raw.close()
        with pytest.raises(BadInput, match=ROOT):
            gallery.entries()


def test_repair_keeps_what_opens_and_says_what_did_not(changed, key: Key | None) -> None:
    path, _ = changed
    raw = sqlite3.connect(path)
    raw.execute("UPDATE finger SET version = x'00' WHERE id = 2")
    raw.execute("INSERT INTO template VALUES (88, x'00')")  # without a name
    raw.commit()
    raw.close()
    with Gallery.open(path, key) as gallery:
        assert {row for row, _ in gallery.problems()} == {None, 2, 88}
        assert gallery.repair() == [2, 88]
        assert list(gallery.templates()) == [4, 5, 6]
        assert gallery.repair() == []


def test_an_older_copy_is_found_by_the_counter(tmp_path: Path) -> None:
    path, copy, counter = tmp_path / "g.skg", tmp_path / "copy", tmp_path / "key.counter"
    counter.touch()
    key, without = Key(KEY.secret, raw=True, counter=counter), KEY
    with Gallery.create(path, SETTINGS, key) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)])
        shutil.copy(path, copy)
        gallery.remove([1])
    shutil.copy(path, tmp_path / "newest")
    shutil.copy(copy, path)
    read_all(path, without)  # nothing else could know
    for act in (lambda gallery: gallery.entries(), lambda gallery: gallery.add([new("Cid", 3)])):
        with (
            Gallery.open(path, key) as gallery,
            pytest.raises(BadInput, match=r"is an older copy: .* 1 changes, .* 2;"),
        ):
            act(gallery)
    shutil.copy(tmp_path / "newest", path)
    with Gallery.open(path, without) as gallery:  # ahead of the counter, as after a crash before it was written
        gallery.add([new("Cid", 3)])
    read_all(path, key)
    assert list(json.loads(counter.read_text()).values()) == [3]
    shutil.copy(copy, path)
    with Gallery.open(path, key) as gallery:
        gallery.repair()  # the older one is wanted
    read_all(path, key)
    assert counter.stat().st_mode & 0o777 == 0o600


def test_a_copy_under_an_earlier_key_is_older(tmp_path: Path) -> None:
    path, copy, counter = tmp_path / "g.skg", tmp_path / "copy", tmp_path / "key.counter"
    counter.touch()
    key = Key(KEY.secret, raw=True, counter=counter)
    with Gallery.create(path, SETTINGS, key) as gallery:
        gallery.add([new("Ann", 1)])
        shutil.copy(path, copy)
        gallery.rekey(key)
    read_all(path, key)
    with pytest.raises(BadInput, match="is an older copy"):
        read_all(copy, key)


@pytest.mark.parametrize("content", ["[]", "{", '{"a": "b"}', '{"a": 1.5}', "\xff"])
def test_what_is_no_counter_is_refused(tmp_path: Path, content: str) -> None:
    counter = tmp_path / "key.counter"
    with Gallery.create(tmp_path / "g.skg", SETTINGS, KEY) as gallery:
        gallery.add([new("Ann", 1)])
    counter.write_text(content, encoding="latin-1")
    with pytest.raises(BadInput, match="is not a counter file"):
        read_all(tmp_path / "g.skg", Key(KEY.secret, raw=True, counter=counter))


@pytest.fixture
def first(tmp_path: Path, key: Key | None) -> Path:
    path = tmp_path / "first.skg"
    of_version_1(path, [new("Ann", 1, **CODED), new("Bob", 2, images=b"picture"), new("Cid", -1)], key, SETTINGS)
    return path


def contents(gallery: Gallery) -> list:
    return [gallery.entries(), gallery.templates(), gallery.codes(1), gallery.images(), gallery.settings_sha256]


def test_version_1_is_read_and_migrated(first: Path, key: Key | None) -> None:
    with Gallery.open(first, key) as gallery:
        before = contents(gallery)
        assert before[1] == {1: payload(1), 2: payload(2), 3: b""}
        assert before[2:4] == [{1: b"code"}, {2: b"picture"}]
        assert len(gallery) == 3
        assert gallery.problems() == []
        assert gallery.without_code(1) == [2, 3]
        data = first.read_bytes()
        for act in (
            lambda: gallery.add([new("Dan", 4)]), lambda: gallery.remove([1]), lambda: gallery.set_codes({2: b"c"}, 1),
            lambda: gallery.rekey(Key(b"n" * 32, raw=True)), gallery.repair, gallery.require_version,
        ):  # fmt: skip
            with pytest.raises(BadInput, match=r"of version 1, .*splitknit gallery migrate"):
                act()
        assert first.read_bytes() == data
        assert gallery.migrate() == 3
        assert contents(gallery) == before
        gallery.require_version()
        with pytest.raises(BadInput, match="of version 2 already"):
            gallery.migrate()
    with Gallery.open(first, key) as gallery:
        assert contents(gallery) == before
        assert gallery.problems() == []
        assert gallery.add([new("Ann", 1), new("Dan", 4)]) == [False, True]
        assert gallery.remove([1]) == 1
    raw = sqlite3.connect(first)
    assert raw.execute("PRAGMA user_version").fetchone() == (2,)
    raw.close()


def test_a_migration_is_whole_or_nothing(first: Path, key: Key | None) -> None:
    raw = sqlite3.connect(first)
    raw.execute("UPDATE template SET content = zeroblob(300) WHERE id = 2")
    raw.commit()
    raw.close()
    data = tables_of_1(first)
    with Gallery.open(first, key) as gallery:
        with pytest.raises(BadInput, match=r"row 2 .* is damaged"):
            gallery.migrate()
        assert gallery.templates([1]) == {1: payload(1)}
    assert tables_of_1(first) == data


def tables_of_1(path: Path) -> list:
    raw = sqlite3.connect(path)
    found = [raw.execute(f"SELECT * FROM {name}").fetchall() for name in ("about", "finger", "images", "template")]
    raw.close()
    return found


def test_a_copy_of_version_1_is_older_than_its_migration(tmp_path: Path) -> None:
    path, copy, counter = tmp_path / "g.skg", tmp_path / "copy", tmp_path / "key.counter"
    counter.touch()
    key = Key(KEY.secret, raw=True, counter=counter)
    of_version_1(path, [new("Ann", 1)], key, SETTINGS)
    shutil.copy(path, copy)
    read_all(path, key)
    with Gallery.open(path, key) as gallery:
        gallery.migrate()
    read_all(path, key)
    with pytest.raises(BadInput, match="is an older copy"):
        read_all(copy, key)


def test_contents_are_bound_to_their_row_and_entry() -> None:
    row = Row(1, b"t" * 16, b"v" * 16, 1, b"entry")
    others = [replace(row, tag=b"T" * 16), replace(row, version=b"V" * 16), replace(row, entry=b"another")]
    for content in ("code", "template", "images"):
        assert row.context(content) not in [other.context(content) for other in others]
    assert row.context("code") != replace(row, code_version=2).context("code")
    assert len({row.context(content) for content in ("entry", "code", "template", "images")}) == 4
