"""The gallery's file: what is kept, what is gone, what survives, what is refused."""

from __future__ import annotations

import os
import signal
import sqlite3
import stat
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splitknit.check import BadInput
from splitknit.match import Template, pack
from splitknit.match.gallery import Gallery, NewCapture
from splitknit.match.gallery_entry import Entry, session_order
from splitknit.match.gallery_file import APPLICATION_ID
from splitknit.match.gallery_key import Key, ScryptSettings

SETTINGS = "5e" * 32
KEY = Key(bytes(range(32)), raw=True)
CHEAP = ScryptSettings(log2_n=10)


def payload(seed: int) -> bytes:
    """A template of noise: 60 x 50 pixels."""
    rng = np.random.default_rng(seed)
    return pack(Template(rng.integers(0, 4, (60, 50)).astype(np.uint8), np.ones((60, 50), bool), 0.1))


def new(person: str, seed: int = 0, finger: str = "right_index", session: str = "1", **kept: object) -> NewCapture:
    entry = Entry(person, finger, session, "result", f"{seed:064x}", area_mm2=30.0)
    return NewCapture(entry, payload(seed) if seed >= 0 else b"", **kept)


@pytest.fixture(params=["plain", "encrypted"])
def key(request: pytest.FixtureRequest) -> Key | None:
    return KEY if request.param == "encrypted" else None


@pytest.fixture
def file(tmp_path: Path, key: Key | None) -> Path:
    """Ann's two fingers, Bob's two sessions, and a failure to acquire."""
    path = tmp_path / "people.skg"
    with Gallery.create(path, SETTINGS, key) as gallery:
        gallery.add([new("Ann", 1), new("Ann", 2, "left_thumb"), new("Bob", 3)])
        gallery.add([new("Bob", 4, session="2"), new("Zoë", -1)])
    return path


def people(path: Path, key: Key | None) -> list[str]:
    with Gallery.open(path, key) as gallery:
        return [one.entry.words for one in gallery.entries()]


def test_what_is_put_in_comes_out(file: Path, key: Key | None) -> None:
    with Gallery.open(file, key) as gallery:
        assert len(gallery) == 5
        found = gallery.entries()
        assert [one.entry.person for one in found] == ["Ann", "Ann", "Bob", "Bob", "Zoë"]
        assert [one.template_bytes for one in found] == [len(payload(1))] * 4 + [0]
        assert found[0].entry == replace(new("Ann", 1).entry, template_bytes=len(payload(1)))
        assert gallery.templates() == {1: payload(1), 2: payload(2), 3: payload(3), 4: payload(4), 5: b""}
        assert gallery.templates([4, 99]) == {4: payload(4)}
        assert [one.row for one in gallery.entries("Bob", session="2")] == [4]
        assert [one.row for one in gallery.entries(finger="left_thumb")] == [2]
        assert gallery.settings_sha256 == SETTINGS
        assert gallery.encrypted == (key is not None)
        assert gallery.problems() == []


def test_only_its_owner_may_read_it(file: Path) -> None:
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert list(file.parent.iterdir()) == [file]  # one file at rest


def test_equal_enrolments_are_equal_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with Gallery.create(tmp_path / name, SETTINGS) as gallery:
            gallery.add([new("Ann", 1), new("Bob", 2)])
            gallery.remove([1])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_capture_is_kept_once(file: Path, key: Key | None) -> None:
    with Gallery.open(file, key) as gallery:
        assert gallery.add([new("Ann", 1), new("Cid", 9)]) == [False, True]
        assert len(gallery) == 6
        with pytest.raises(BadInput, match=r"Ann, right index, session 1 is in .* already"):
            gallery.add([new("Dan", 8), new("Ann", 5)])
        assert len(gallery) == 6  # Dan neither
        assert gallery.add([new("Ann", 5)], replace=True) == [True]
        assert len(gallery) == 6
        assert gallery.templates([one.row for one in gallery.entries("Ann", "right_index")]) == {7: payload(5)}


def test_nothing_remains_of_a_removed_finger(file: Path, key: Key | None) -> None:
    raw = sqlite3.connect(file)
    (stored,) = raw.execute("SELECT content FROM template WHERE id = 2").fetchone()
    raw.close()
    assert stored[-200:] in file.read_bytes()
    assert (payload(2)[-200:] in file.read_bytes()) == (key is None)
    assert (b"left_thumb" in file.read_bytes()) == (key is None)
    with Gallery.open(file, key) as gallery:
        assert gallery.remove([one.row for one in gallery.entries("Ann", "left_thumb")]) == 1
    left = [path.read_bytes() for path in file.parent.iterdir()]
    assert [path.name for path in file.parent.iterdir()] == [file.name]
    for part in range(0, len(stored) - 16, 16):
        assert stored[part : part + 16] not in left[0]
    assert b"left_thumb" not in left[0]
    assert people(file, key) == [
        "Ann, right index, session 1", "Bob, right index, session 1", "Bob, right index, session 2",
        "Zoë, right index, session 1",
    ]  # fmt: skip


def test_all_sides_of_a_key(tmp_path: Path) -> None:
    path = tmp_path / "g.skg"
    phrase, other = Key(b"correct horse", raw=False), Key(b"x" * 32, raw=True)
    with Gallery.create(path, SETTINGS) as gallery:
        gallery.add([new("Ann Example", 1, code=b"code of Ann", code_version=3, images=b"picture of Ann")])
    secrets = [b"Ann", b"right_index", b"code of", b"picture", payload(1)[40:60]]
    assert all(one in path.read_bytes() for one in secrets)
    with pytest.raises(BadInput, match="not encrypted; leave the key out"):
        Gallery.open(path, KEY)
    with Gallery.open(path) as gallery:
        assert gallery.rekey(phrase, CHEAP) == 1
        assert gallery.templates() == {1: payload(1)}
    assert not any(one in path.read_bytes() for one in secrets)
    for wrong, words in (
        (None, "is encrypted; give its key"),
        (other, "is a passphrase, but 32 bytes"),
        (Key(b"wrong horse", raw=False), "the key is not that of the gallery"),
    ):
        with pytest.raises(BadInput, match=words):
            Gallery.open(path, wrong)
    with Gallery.open(path, phrase) as gallery:
        gallery.rekey(other)
    with pytest.raises(BadInput, match=r"is 32 bytes .* but a passphrase"):
        Gallery.open(path, phrase)
    with Gallery.open(path, other) as gallery:
        assert gallery.codes(3) == {1: b"code of Ann"}
        assert gallery.codes(2) == {}
        assert gallery.images() == {1: b"picture of Ann"}
        gallery.rekey(None)
    with Gallery.open(path) as gallery:
        assert gallery.entries()[0].entry.person == "Ann Example"


@pytest.mark.parametrize("column", ["entry", "template", "code", "images"])
def test_any_changed_byte_is_noticed(tmp_path: Path, key: Key | None, column: str) -> None:
    path = tmp_path / "g.skg"
    with Gallery.create(path, SETTINGS, key) as gallery:
        gallery.add([new("Ann", 1, code=b"code", code_version=1, images=b"image"), new("Bob", 2)])
    table = column if column in ("template", "images") else "finger"
    field = column if table == "finger" else "content"
    with sqlite3.connect(path) as raw:
        (sealed,) = raw.execute(f"SELECT {field} FROM {table} WHERE id = 1").fetchone()
        changed = bytearray(sealed)
        changed[len(changed) // 2] ^= 4
        raw.execute(f"UPDATE {table} SET {field} = ? WHERE id = 1", (bytes(changed),))
    raw.close()
    with Gallery.open(path, key) as gallery:
        (problem,) = gallery.problems()
        assert problem[0] == 1
        assert column in problem[1]
        assert gallery.remove([1]) == 1  # what is damaged can be taken out
        assert gallery.problems() == []
        assert gallery.templates() == {2: payload(2)}


def test_every_seal_has_its_own_nonce(tmp_path: Path) -> None:
    path = tmp_path / "g.skg"
    with Gallery.create(path, SETTINGS, KEY) as gallery:
        gallery.add([new(f"P{k}", 1) for k in range(20)])
    with sqlite3.connect(path) as raw:
        cells = [
            cell for row in raw.execute("SELECT entry, content FROM finger JOIN template USING (id)") for cell in row
        ]
    raw.close()
    assert len({cell[:12] for cell in cells}) == 40


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path, whole: None, "there is no gallery"),
        (lambda path, whole: path.write_bytes(b""), "is not a gallery"),
        (lambda path, whole: path.write_text("people"), "is not a gallery"),
        (lambda path, whole: path.mkdir(), "is a folder"),
        (lambda path, whole: sqlite3.connect(path).executescript("CREATE TABLE t (x)").close(), "another program's"),
        (lambda path, whole: path.write_bytes(whole[:4096]), "is damaged"),
        (lambda path, whole: path.write_bytes(whole[:100] + b"\xff" * 3000 + whole[3100:]), "is damaged"),
        (lambda path, whole: path.write_bytes(whole[:20]), "is damaged|not a gallery|another program"),
    ],
)
def test_what_is_no_gallery_is_refused(tmp_path: Path, make, words: str) -> None:
    with Gallery.create(tmp_path / "sound", SETTINGS) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)])
    make(tmp_path / "g.skg", (tmp_path / "sound").read_bytes())
    with pytest.raises(BadInput, match=words) as refused:
        Gallery.open(tmp_path / "g.skg")
    assert len(str(refused.value).splitlines()) == 1


def test_other_versions_and_tables_are_refused(file: Path, key: Key | None) -> None:
    for change, words in (
        ("CREATE TRIGGER t AFTER INSERT ON finger BEGIN DELETE FROM finger; END", "tables are not a gallery's"),
        ("DROP TRIGGER t; UPDATE about SET document = '{}'", "cannot be read"),
        ("UPDATE about SET document = 'x'", "cannot be read"),
        ("DELETE FROM about", "cannot be read"),
        ("PRAGMA user_version = 3", "version 3, but this program reads versions 1 and 2"),
        (f"PRAGMA application_id = {APPLICATION_ID + 1}", "another program's"),
    ):
        raw = sqlite3.connect(file)
        raw.executescript(change)
        raw.close()
        with pytest.raises(BadInput, match=words):
            Gallery.open(file, key)


def test_templates_of_other_settings_are_refused(file: Path, key: Key | None, monkeypatch) -> None:
    with Gallery.open(file, key) as gallery:
        gallery.require_comparable(SETTINGS)
        with pytest.raises(BadInput, match="made with other settings"):
            gallery.require_comparable("00" * 32)
        monkeypatch.setattr("splitknit.match.gallery.TEMPLATE_VERSION", 2)
        with pytest.raises(BadInput, match="of version 1, but this program makes version 2"):
            gallery.require_comparable(SETTINGS)


def test_writers_wait_for_each_other_and_lose_nothing(file: Path, key: Key | None) -> None:
    def write(number: int) -> None:
        with Gallery.open(file, key) as gallery:
            for k in range(10):
                gallery.add([new(f"W{number}", 1000 * number + k, session=str(k))])

    threads = [threading.Thread(target=write, args=(number,)) for number in range(3)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    with Gallery.open(file, key) as gallery:
        assert len(gallery) == 35
        assert gallery.problems() == []


def test_one_who_waits_too_long_is_told(file: Path, key: Key | None) -> None:
    with (
        Gallery.open(file, key) as other,
        Gallery.open(file, key, wait_s=0.05) as gallery,
        other._rows.changing(),
    ):
        assert len(gallery) == 5  # readers do not wait
        with pytest.raises(BadInput, match="another program is writing"):
            gallery.add([new("Cid", 9)])
    assert len(people(file, key)) == 5


def test_who_opened_before_a_change_of_key_writes_nothing_unreadable(file: Path, key: Key | None) -> None:
    with Gallery.open(file, key) as early, Gallery.open(file, key) as late:
        late.rekey(Key(b"n" * 32, raw=True))
        for act in (lambda: early.add([new("Cid", 9)]), early.entries, early.templates):
            with pytest.raises(BadInput, match="was changed meanwhile"):
                act()


KILLED = """
import sys
sys.path.insert(0, sys.argv[2])
from test_gallery import KEY, SETTINGS, new
from splitknit.match.gallery import Gallery
gallery = Gallery.open(sys.argv[1], KEY if sys.argv[3] == "encrypted" else None)
def captures():
    for k in range(400):
        if k == 390:
            print("ready", flush=True)
            sys.stdin.read()
        yield new("Cid", 500 + k, session=str(k))
gallery._rows.database.execute("PRAGMA cache_size=10")  # so that pages reach the file before the end
gallery.add(captures())
"""


def test_a_killed_writer_leaves_what_was_there(file: Path, key: Key | None) -> None:
    arguments = [str(file), str(Path(__file__).parent), "plain" if key is None else "encrypted"]
    before = file.stat().st_size
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"ready\n"
        writer.send_signal(signal.SIGKILL)
        writer.wait()
    assert file.stat().st_size > before  # it was at work in the file
    assert Path(f"{file}-journal").exists()
    assert len(people(file, key)) == 5
    with Gallery.open(file, key) as gallery:
        assert gallery.problems() == []
        assert gallery.add([new("Dan", 8)]) == [True]


def test_read_only_galleries_are_read(file: Path, key: Key | None) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everything")
    file.chmod(0o400)
    assert len(people(file, key)) == 5
    with Gallery.open(file, key) as gallery, pytest.raises(BadInput, match="may not be written"):
        gallery.add([new("Cid", 9)])


def test_codes_are_added_later(file: Path, key: Key | None) -> None:
    with Gallery.open(file, key) as gallery:
        gallery.set_codes({1: b"one", 3: b"three", 77: b"nobody"}, 2)
        assert gallery.codes(2) == {1: b"one", 3: b"three"}
        assert [one.code_version for one in gallery.entries()] == [2, None, 2, None, None]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"person": ""}, "person's name"),
        ({"person": "a\nb"}, "person's name"),
        ({"person": "x" * 101}, "person's name"),
        ({"finger": "Right Index"}, "cannot be a finger"),
        ({"session": "a/b"}, "cannot be a session"),
        ({"images": "all"}, "images are"),
    ],
)
def test_names_that_cannot_be(change: dict[str, str], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        replace(new("Ann").entry, **change)


def test_one_name_has_one_way_of_writing() -> None:
    assert new("Zoe\u0308").entry == new(" Zo\u00eb ").entry


def test_sessions_are_in_order() -> None:
    assert sorted(["b", "10", "2", "a"], key=session_order) == ["2", "10", "a", "b"]
