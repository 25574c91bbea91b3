"""The gallery's file: what is kept, what is gone, what survives, what is refused."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sqlite3
import stat
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitknit.cli import main as cli
from splitknit.errors import BadInput
from splitknit_match.gallery import file as gallery_file
from splitknit_match.gallery.entry import Entry, NewCapture, session_order
from splitknit_match.gallery.file import APPLICATION_ID
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key, ScryptSettings
from splitknit_match.matching.template import Template, pack

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
    with contextlib.closing(sqlite3.connect(path)) as raw, raw:
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
    with contextlib.closing(sqlite3.connect(path)) as raw, raw:
        cells = [
            cell for row in raw.execute("SELECT entry, content FROM finger JOIN template USING (id)") for cell in row
        ]
    raw.close()
    assert len({cell[:12] for cell in cells}) == 40


def test_each_problem_is_one_printable_line(tmp_path: Path) -> None:
    path = tmp_path / "g.skg"
    with Gallery.create(path, SETTINGS) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)])
    data = bytearray(path.read_bytes())
    size = int.from_bytes(data[16:18], "big")
    for page in range(1, len(data) // size):  # the place where the cells begin
        data[page * size + 5 : page * size + 7] = b"\0\1"
    path.write_bytes(data)
    with Gallery.open(path) as gallery, contextlib.suppress(BadInput):
        problems = gallery.problems()
        assert problems
        for _, words in problems:
            assert words.strip() and words.isprintable()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path, whole: None, "there is no gallery"),
        (lambda path, whole: path.write_bytes(b""), "is not a gallery"),
        (lambda path, whole: path.write_text("people"), "is not a gallery"),
        (lambda path, whole: path.mkdir(), "is a folder"),
        (lambda path, whole: os.mkfifo(path), "is not a file"),
        (
            lambda path, whole: sqlite3.connect(path).executescript("CREATE TABLE t (x)").connection.close(),
            "another program's",
        ),
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
        ("DELETE FROM about; INSERT INTO about VALUES (zeroblob(20000))", "cannot be read"),
        ("PRAGMA user_version = 3", "version 3, but this program reads versions 1 and 2"),
        (f"PRAGMA application_id = {APPLICATION_ID + 1}", "another program's"),
    ):
        raw = sqlite3.connect(file)
        raw.executescript(change)
        raw.close()
        with pytest.raises(BadInput, match=words):
            Gallery.open(file, key)


@pytest.mark.parametrize("place", [b"CREATE TABLE about", b"about"])
def test_a_schema_that_is_no_text_is_refused(file: Path, key: Key | None, place: bytes) -> None:
    data = file.read_bytes()
    file.write_bytes(data.replace(place, b"\xff" * len(place), 1))
    with pytest.raises(BadInput, match="is damaged") as refused:
        Gallery.open(file, key)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize("change", [{"log2_n": 20, "r": 32, "p": 16}, {"r": 10**40}, {"p": "1"}, {"log2_n": None}])
def test_a_key_that_costs_too_much_is_refused(tmp_path: Path, monkeypatch, change: dict[str, object]) -> None:
    path, phrase = tmp_path / "g.skg", Key(b"correct horse", raw=False)
    Gallery.create(path, SETTINGS, phrase, CHEAP).close()
    raw = sqlite3.connect(path)
    about = json.loads(raw.execute("SELECT document FROM about").fetchone()[0])
    raw.execute("UPDATE about SET document = ?", (json.dumps(about | change),))
    raw.commit()
    raw.close()
    monkeypatch.setattr("splitknit_match.gallery.key._stretched", lambda *rest: pytest.fail("it was tried"))
    with pytest.raises(BadInput, match=r"is damaged .*scrypt"):
        Gallery.open(path, phrase)


def test_a_lack_of_memory_is_no_damage(file: Path, key: Key | None, monkeypatch) -> None:
    def lacking(*unused: object) -> None:
        raise MemoryError

    monkeypatch.setattr("splitknit_match.gallery.rows.decode_entry", lacking)
    with Gallery.open(file, key) as gallery, pytest.raises(MemoryError):
        gallery.entries()


def test_templates_of_other_settings_are_refused(file: Path, key: Key | None, monkeypatch) -> None:
    with Gallery.open(file, key) as gallery:
        gallery.require_comparable(SETTINGS)
        with pytest.raises(BadInput, match="made with other settings"):
            gallery.require_comparable("00" * 32)
        monkeypatch.setattr("splitknit_match.gallery.gallery.TEMPLATE_VERSION", 2)
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
        other.changing(),
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


def test_journals_are_overwritten_before_they_go(file: Path, key: Key | None, tmp_path: Path) -> None:
    """A second name of the journal's file shows what would stay in blocks that a file system frees."""
    raw = sqlite3.connect(file)
    (stored,) = raw.execute("SELECT content FROM template WHERE id = 2").fetchone()
    raw.close()
    journal = Path(f"{file}-journal")
    with Gallery.open(file, key) as gallery:
        for number, act in enumerate(
            (lambda: gallery.add([new("Cid", 9)]), lambda: gallery.remove([2]), lambda: gallery.rekey(KEY))
        ):
            kept = tmp_path / f"journal {number}"
            kept.touch()
            journal.hardlink_to(kept)
            act()
            assert kept.stat().st_size > 512
            assert not any(kept.read_bytes())
            assert not journal.exists()
    assert stored[-16:] not in file.read_bytes()


@pytest.mark.parametrize("table", ["finger", "template"])
@pytest.mark.parametrize("act", ["remove", "replace"])
def test_second_copies_in_a_page_go_with_a_removal(file: Path, key: Key | None, table: str, act: str) -> None:
    """SQLite may leave a second copy of a row between a page's pointers and its cells; here one is put there."""
    raw = sqlite3.connect(file)
    (page,) = raw.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()
    (size,) = raw.execute("PRAGMA page_size").fetchone()
    raw.close()
    data = bytearray(file.read_bytes())
    begin = (page - 1) * size
    assert data[begin] == 13  # a leaf
    cells = int.from_bytes(data[begin + 5 : begin + 7], "big")
    assert not any(data[begin + cells - 16 : begin + cells])
    data[begin + cells - 16 : begin + cells] = b"a second copy of"
    file.write_bytes(data)
    with Gallery.open(file, key) as gallery:
        assert gallery.problems() == []
        if act == "remove":
            gallery.remove([2])
        else:
            gallery.add([new("Ann", 9)], replace=True)
    assert b"a second copy of" not in file.read_bytes()


def test_a_gallery_never_shrinks(file: Path, key: Key | None) -> None:
    """What a file system takes from the end of a file is not overwritten."""
    with Gallery.open(file, key) as gallery:
        gallery.add([new(f"P{k}", 100 + k) for k in range(30)])
        before = file.stat().st_size
        gallery.remove(range(1, 30))
        assert file.stat().st_size >= before
        gallery.add([new(f"Q{k}", 200 + k) for k in range(25)])
        assert file.stat().st_size < 1.2 * before  # but what became free is used again
        assert gallery.problems() == []


def test_a_link_in_place_of_the_journal_leads_nowhere(file: Path, key: Key | None, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"not ours" * 1000)
    with Gallery.open(file, key) as gallery:
        Path(f"{file}-journal").symlink_to(other)
        with pytest.raises(BadInput, match="cannot be opened"):
            gallery.add([new("Cid", 9)])
    assert other.read_bytes() == b"not ours" * 1000


KILLED = """
import sys
sys.path.insert(0, sys.argv[2])
from test_gallery import KEY, SETTINGS, new
from splitknit_match.gallery.gallery import Gallery
gallery = Gallery.open(sys.argv[1], KEY if sys.argv[3] == "encrypted" else None)
def captures():
    for k in range(400):
        if k == 390:
            print("ready", flush=True)
            sys.stdin.read()
        yield new("Cid", 500 + k, session=str(k))
gallery.database.execute("PRAGMA cache_size=10")  # so that pages reach the file before the end
gallery.add(captures())
"""


def test_a_killed_writer_leaves_what_was_there(file: Path, key: Key | None, tmp_path: Path) -> None:
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
    kept = tmp_path / "journal"
    kept.hardlink_to(f"{file}-journal")
    assert any(kept.read_bytes())
    assert len(people(file, key)) == 5
    assert not any(kept.read_bytes())  # the killed one's journal was not just unlinked
    assert not Path(f"{file}-journal").exists()
    with Gallery.open(file, key) as gallery:
        assert gallery.problems() == []
        assert gallery.add([new("Dan", 8)]) == [True]
    assert not Path(f"{file}-journal").exists()


def test_no_journal_stays_after_an_interrupt_or_beside_a_gallery_that_is_read(
    file: Path, key: Key | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, come = Path(f"{file}-journal"), []
    work = gallery_file.wiping

    def interrupted(place: Path) -> Any:
        if not come:
            come.append(place)
            signal.raise_signal(signal.SIGINT)
        return work(place)

    earlier = signal.signal(signal.SIGINT, cli._interrupt)
    monkeypatch.setattr(gallery_file, "wiping", interrupted)
    try:
        with Gallery.open(file, key) as gallery, pytest.raises(KeyboardInterrupt):
            gallery.remove([gallery.entries()[0].row])
    finally:
        signal.signal(signal.SIGINT, earlier)
        cli._interrupts.clear()
    assert come and not journal.exists()
    journal.write_bytes(b"\0" * 512 + b"a removed template")
    with Gallery.open(file, key):  # to read
        assert not journal.exists()


MANY_KILLED = """
import os, pathlib, random, signal, sys, time
sys.path.insert(0, sys.argv[2])
from test_gallery import KEY, new
from splitknit.errors import BadInput
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key
path, KEYS = sys.argv[1], [KEY if sys.argv[3] == "encrypted" else None, Key(bytes(range(32)), raw=True)]
random.seed(int(sys.argv[4]))

def opened():
    # by the key that the last change of keys left
    try:
        return Gallery.open(path, KEYS[0])
    except BadInput:
        KEYS.reverse()
        return Gallery.open(path, KEYS[0])

def changed(people, what, who):
    # a change of keys names somebody who may have been removed before
    return people - {who} if what == "remove" else people | {who} if what != "rekey" else people

def write(told, seed):
    # changes, each told before and after
    rng = random.Random(seed)
    with opened() as gallery:
        people = [one.entry.person for one in gallery.entries()]
        for k in range(1000):
            what = rng.choice(["add", "add", "replace", "remove", "rekey"]) if len(people) > 3 else "add"
            who = f"W{seed}-{k}" if what == "add" else rng.choice(people)
            os.write(told, f"{what} {who}\\n".encode())
            if what == "remove":
                gallery.remove([one.row for one in gallery.entries(who)])
                people.remove(who)
            elif what == "rekey":
                KEYS.reverse()
                gallery.rekey(KEYS[0])
            else:
                gallery.add([new(who, rng.randrange(10**6))], replace=True)
                people += [who] * (what == "add")
            os.write(told, b"done\\n")

for kill in range(50):
    with opened() as gallery:
        assert gallery.problems() == [], gallery.problems()
        before = {one.entry.person: one.entry.source_sha256 for one in gallery.entries()}
    reader, told = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            write(told, kill)
        finally:
            os._exit(1)
    os.close(told)
    said = os.read(reader, 1000)  # it is at work
    time.sleep(random.uniform(0, 0.02))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while more := os.read(reader, 100000):
        said += more
    os.close(reader)
    *lines, last = said.decode().split("\\n")
    assert last == "" and lines, lines
    people = set(before)
    under_way = lines.pop().split() if lines[-1] != "done" else None
    for line in lines:
        if line != "done":
            what, who = line.split()
            people = changed(people, what, who)
    possible = [set(people)]
    if under_way:
        possible.append(changed(people, *under_way))
    with opened() as gallery:
        assert {one.entry.person for one in gallery.entries()} in possible, (lines, under_way)
print("sound")
"""


def test_fifty_killed_writers_lose_nothing(file: Path, key: Key | None) -> None:
    """What was told as done is there, of what was under way all or nothing, and every seal and the root hold."""
    arguments = [str(file), str(Path(__file__).parent), "plain" if key is None else "encrypted", "7"]
    found = subprocess.run([sys.executable, "-c", MANY_KILLED, *arguments], capture_output=True, text=True, check=False)
    assert found.stdout == "sound\n", found.stderr


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
