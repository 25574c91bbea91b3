"""The gallery's file: what is kept, what is gone, what survives, what is refused."""

import contextlib
import os
import resource
import signal
import sqlite3
import stat
import struct
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from refusals import bad_input
from splitknit.errors import BadInput
from splitknit_match.gallery.file import (
    APPLICATION_ID,
    Entry,
    GalleryFile,
    Key,
    NewCapture,
    session_order,
)
from splitknit_match.gallery.verbs import gallery_remove
from splitknit_match.matching.template import Template, pack

SETTINGS = "5e" * 32
KEY = Key("0f" * 32)


def payload(seed):
    """A template of noise: 60 x 50 pixels."""
    rng = np.random.default_rng(seed)
    return pack(
        Template(rng.integers(0, 4, (60, 50)).astype(np.uint8), np.ones((60, 50), bool), 0.1)
    )


def new(person, seed=0, finger="right_index", session="1"):
    entry = Entry(person, finger, session, "result", f"{seed:064x}", area_mm2=30.0)
    return NewCapture(entry, payload(seed) if seed >= 0 else b"")


def driver(key):
    """Module that opens galleries with this key."""
    return sqlite3 if key is None else pytest.importorskip("sqlcipher3").dbapi2


@pytest.fixture(params=["plain", "encrypted"])
def key(request):
    if request.param == "plain":
        return None
    pytest.importorskip("sqlcipher3")
    return KEY


@pytest.fixture
def file(tmp_path, key):
    """Ann's two fingers, Bob's two sessions, and a failure to acquire."""
    path = tmp_path / "people.skg"
    with GalleryFile(path, key) as gallery:
        gallery.add([new("Ann", 1), new("Ann", 2, "left_thumb"), new("Bob", 3)], SETTINGS)
        gallery.add([new("Bob", 4, session="2"), new("Zoë", -1)], SETTINGS)
    return path


def people(path, key):
    with GalleryFile(path, key) as gallery:
        return [row.words for row in gallery]


def test_what_is_put_in_comes_out(file, key):
    with GalleryFile(file, key) as gallery:
        assert len(gallery) == 5
        entries = gallery.entries()
        assert [entry.person for entry in entries] == ["Ann", "Ann", "Bob", "Bob", "Zoë"]
        assert [entry.template_bytes for entry in entries] == [len(payload(1))] * 4 + [0]
        assert (
            replace(entries[0], template_bytes=0, template_sha256="", row=0) == new("Ann", 1).entry
        )
        assert gallery.people().templates == {
            1: payload(1),
            2: payload(2),
            3: payload(3),
            4: payload(4),
            5: b"",
        }
        assert list(gallery) == entries
        assert gallery.people("Bob").of("Bob", None).entries == entries[2:4]
        assert [entry.row for entry in gallery.entries("Bob", session="2")] == [4]
        assert [entry.row for entry in gallery.entries(finger="left_thumb")] == [2]
        assert gallery.settings_sha256 == SETTINGS


def test_only_its_owner_may_read_it(file):
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert list(file.parent.iterdir()) == [file]  # one file at rest


def test_equal_enrolments_are_equal_files(tmp_path):
    for name in ("a", "b"):
        with GalleryFile(tmp_path / name) as gallery:
            gallery.add([new("Ann", 1), new("Bob", 2)], SETTINGS)
            gallery.remove("Ann")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_capture_is_kept_once(file, key):
    with GalleryFile(file, key) as gallery:
        assert gallery.add([new("Ann", 1), new("Cid", 9)], SETTINGS) == [False, True]
        with bad_input(r"Ann, right index, session 1 is in .* already"):
            gallery.add([new("Dan", 8), new("Ann", 5)], SETTINGS)
        assert len(gallery) == 6  # Dan neither
        assert gallery.add([new("Ann", 5)], SETTINGS, replaces=True) == [True]
        (entry,) = gallery.entries("Ann", "right_index")
        assert gallery.people().templates[entry.row] == payload(5)
        with bad_input("are of another version"):
            gallery.add([new("Dan", 8)], "00" * 32)
        assert len(gallery) == 6


def test_a_gallery_appears_with_its_first_finger(tmp_path, key):
    def refuse():
        raise BadInput("not this one.")

    path = tmp_path / "g.skg"
    for how in ({"first": refuse}, {"last": refuse}):
        with GalleryFile(path, key) as gallery:
            assert not gallery.there
            with bad_input("not this one"):
                gallery.add([new("Ann", 1)], SETTINGS, **how)
        assert not list(tmp_path.iterdir())
    path.touch()  # of one who was killed
    with GalleryFile(path, key) as gallery:
        gallery.add([new("Ann", 1)], SETTINGS)
    assert people(path, key) == ["Ann, right index, session 1"]


def test_nothing_remains_of_a_removed_finger(file, key):
    gone = payload(2)
    assert (gone[-200:] in file.read_bytes()) == (key is None)
    assert (b"left_thumb" in file.read_bytes()) == (key is None)
    with GalleryFile(file, key) as gallery:
        assert gallery.remove("Ann", "left_thumb") == 1
        assert gallery.remove("Zoë") == 1
        with bad_input("holds nothing of Zoë"):
            gallery.remove("Zoë")
    assert [path.name for path in file.parent.iterdir()] == [file.name]
    left = file.read_bytes()
    assert b"left_thumb" not in left
    assert "Zoë".encode() not in left
    assert not any(gone[part : part + 16] in left for part in range(0, len(gone) - 16, 16))
    assert people(file, key) == [
        "Ann, right index, session 1", "Bob, right index, session 1", "Bob, right index, session 2",
    ]  # fmt: skip


@pytest.mark.parametrize("table", ["capture", "person"])
@pytest.mark.parametrize("act", ["remove", "replace"])
def test_second_copies_in_a_page_go_with_a_removal(tmp_path, table, act):
    """SQLite may leave a second copy of a row between a page's pointers and its cells; here one is
    put there."""
    file = tmp_path / "g.skg"
    with GalleryFile(file) as gallery:
        gallery.add([new("Ann", 1), new("Ann", 2, "left_thumb"), new("Bob", 3)], SETTINGS)
    with contextlib.closing(sqlite3.connect(file)) as raw:
        (page,) = raw.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)
        ).fetchone()
        (size,) = raw.execute("PRAGMA page_size").fetchone()
    data = bytearray(file.read_bytes())
    begin = (page - 1) * size
    assert data[begin] == 13  # a leaf
    cells = int.from_bytes(data[begin + 5 : begin + 7], "big")
    assert not any(data[begin + cells - 16 : begin + cells])
    data[begin + cells - 16 : begin + cells] = b"a second copy of"
    file.write_bytes(data)
    with GalleryFile(file) as gallery:
        if act == "remove":
            gallery.remove("Ann", "left_thumb")
        else:
            gallery.add([new("Ann", 9)], SETTINGS, replaces=True)
    assert b"a second copy of" not in file.read_bytes()


@pytest.mark.parametrize("act", ["enrol", "the same again"])
def test_what_one_could_not_erase_the_next_writer_does(tmp_path, monkeypatch, act):
    """As after a kill between a removal and its VACUUM: here a reader is in the way."""
    file, gone = tmp_path / "g.skg", payload(1)[-200:]
    with GalleryFile(file) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)], SETTINGS)
    monkeypatch.setattr("splitknit_match.gallery.file.WAIT_S", 0.05)
    with contextlib.closing(sqlite3.connect(file)) as reader:
        reader.execute("BEGIN")
        reader.execute("SELECT * FROM about").fetchall()
        with GalleryFile(file) as gallery, bad_input("its bytes may still lie in the file"):
            gallery.remove("Ann")
        assert people(file, None) == ["Bob, right index, session 1"]
        assert gone in file.read_bytes()
    if act == "enrol":
        with GalleryFile(file) as gallery:
            gallery.add([new("Cid", 3)], SETTINGS)
    else:
        report = gallery_remove(file, person="Ann")
        assert "what was removed earlier is erased now" in report.lines[0]
        with bad_input("holds nothing of Ann"):
            gallery_remove(file, person="Ann")
    assert gone not in file.read_bytes() and b"Ann" not in file.read_bytes()
    assert list(tmp_path.iterdir()) == [file]


def test_what_became_free_is_used_again(file, key):
    with GalleryFile(file, key) as gallery:
        gallery.add([new(f"P{k}", 100 + k) for k in range(30)], SETTINGS)
        before = file.stat().st_size
        for k in range(3):
            for n in range(10):
                gallery.remove(f"P{10 * k + n}")
            gallery.add([new(f"Q{k}-{n}", 200 + n) for n in range(10)], SETTINGS)
        assert file.stat().st_size < 1.1 * before


@pytest.mark.slow
def test_all_sides_of_a_key(tmp_path):
    pytest.importorskip("sqlcipher3")
    phrase, digits = Key("correct 'horse'"), Key("ab" * 32)
    secrets = [b"Ann", b"right_index", payload(1)[40:60]]
    for path, own in (
        (tmp_path / "plain", None),
        (tmp_path / "phrase", phrase),
        (tmp_path / "digits", KEY),
    ):
        with GalleryFile(path, own) as gallery:
            gallery.add([new("Ann Example", 1)], SETTINGS)
        assert [secret in path.read_bytes() for secret in secrets] == [own is None] * 3
        for wrong in (None, phrase, digits, KEY):
            if wrong is own or wrong == own:
                continue
            words = "not encrypted; leave" if own is None else "it is encrypted; give its key"
            words = words if own is None or wrong is None else "the key is not that of the gallery"
            with bad_input(words) as refused:
                GalleryFile(path, wrong).entries()
            assert len(str(refused.value).splitlines()) == 1
            with bad_input(words):
                GalleryFile(path, wrong).add([new("Eve", 3)], SETTINGS)
        assert people(path, own) == ["Ann Example, right index, session 1"]


def test_what_an_encrypted_file_reveals_is_no_name_and_any_changed_byte_is_noticed(tmp_path):
    pytest.importorskip("sqlcipher3")
    path = tmp_path / "g.skg"
    with GalleryFile(path, KEY) as gallery:
        gallery.add([new(f"Annabella {k}", 1) for k in range(20)], SETTINGS)
    whole = path.read_bytes()
    assert b"Annabella" not in whole and len(set(whole[:4000])) > 200
    for place in range(100, len(whole), len(whole) // 9):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        with GalleryFile(path, KEY) as gallery, bad_input():
            gallery.people()


def test_without_sqlcipher_one_sentence_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sqlcipher3", None)
    with bad_input(r"need SQLCipher: pip install 'splitknit-match\[encrypt\]'"):
        GalleryFile(tmp_path / "g.skg", KEY)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            "UPDATE capture SET template = zeroblob(500) WHERE id = 1",
            "the template of Ann.* is damaged",
        ),
        ("UPDATE capture SET session = 'a/b' WHERE id = 1", "cannot be a session"),
        ("UPDATE person SET name = '' WHERE id = 1", "cannot be a person's name"),
        ("UPDATE capture SET area_mm2 = 9e999 WHERE id = 1", "area_mm2 must be"),
    ],
)
def test_damage_is_refused(tmp_path, change, words):
    path = tmp_path / "g.skg"
    with GalleryFile(path) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)], SETTINGS)
        with contextlib.closing(sqlite3.connect(path)) as raw, raw:
            raw.execute(change)
        with bad_input(words):
            gallery.people()
        if "template" in words:  # its names are known, so that it can be taken out
            assert gallery.remove("Ann") == 1
            assert gallery.people().templates == {2: payload(2)}


def test_damaged_pages_are_noticed_when_it_is_opened(tmp_path):
    path = tmp_path / "g.skg"
    with GalleryFile(path) as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)], SETTINGS)
    data = bytearray(path.read_bytes())
    size = int.from_bytes(data[16:18], "big")
    for page in range(1, len(data) // size):  # the place where the cells begin
        data[page * size + 5 : page * size + 7] = b"\0\1"
    path.write_bytes(data)
    with bad_input("is damaged") as refused:
        len(GalleryFile(path))
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path, whole: None, "there is no gallery"),
        (lambda path, whole: path.write_bytes(b""), "there is no gallery"),
        (lambda path, whole: path.write_text("people"), "is not a gallery"),
        (lambda path, whole: path.mkdir(), "is not a file"),
        (lambda path, whole: os.mkfifo(path), "there is no gallery"),
        (
            lambda path, whole: (
                sqlite3.connect(path).executescript("CREATE TABLE t (x)").connection.close()
            ),
            "another program's",
        ),
        (lambda path, whole: path.write_bytes(whole[:4096]), "is damaged"),
        (
            lambda path, whole: path.write_bytes(whole[:100] + b"\xff" * 3000 + whole[3100:]),
            "is damaged",
        ),
        (
            lambda path, whole: path.write_bytes(whole[:20]),
            "is damaged|not a gallery|another program",
        ),
    ],
)
def test_what_is_no_gallery_is_refused(tmp_path, make, words):
    with GalleryFile(tmp_path / "sound") as gallery:
        gallery.add([new("Ann", 1), new("Bob", 2)], SETTINGS)
    make(tmp_path / "g.skg", (tmp_path / "sound").read_bytes())
    with bad_input(words) as refused:
        GalleryFile(tmp_path / "g.skg").entries()
    assert len(str(refused.value).splitlines()) == 1


def test_other_versions_and_tables_are_refused(tmp_path):
    file = tmp_path / "g.skg"
    with GalleryFile(file) as gallery:
        gallery.add([new("Ann", 1)], SETTINGS)
        for change, words in (
            (
                "CREATE TRIGGER t AFTER INSERT ON capture BEGIN DELETE FROM capture; END",
                "tables are not a gallery's",
            ),
            (
                "DROP TRIGGER t; UPDATE about SET template_version = 1",
                "of version 1, but this program makes version 2",
            ),
            ("DELETE FROM about", "its own record is missing"),
            (
                "PRAGMA user_version = 3",
                "version 3, but this program reads version 5; export it with the program",
            ),
            (f"PRAGMA application_id = {APPLICATION_ID + 1}", "another program's"),
        ):
            with contextlib.closing(sqlite3.connect(file)) as raw:
                raw.executescript(change)
            for act in (gallery.entries, lambda: gallery.add([new("Bob", 2)], SETTINGS)):
                with bad_input(words):
                    act()


def test_a_schema_that_is_no_text_is_refused(tmp_path):
    file = tmp_path / "g.skg"
    with GalleryFile(file) as gallery:
        gallery.add([new("Ann", 1)], SETTINGS)
    whole = file.read_bytes()
    for place in (b"CREATE TABLE about", b"about"):
        file.write_bytes(whole.replace(place, b"\xff" * len(place), 1))
        with bad_input("is damaged") as refused:
            GalleryFile(file).entries()
        assert str(refused.value).isprintable()


def test_writers_wait_for_each_other_and_lose_nothing(file, key):
    def write(number):
        with GalleryFile(file, key) as gallery:
            for k in range(10):
                gallery.add([new(f"W{number}", 1000 * number + k, session=str(k))], SETTINGS)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with GalleryFile(file, key) as gallery:
        assert len(gallery) == 45
        assert len(gallery.people().templates) == 45


def test_one_who_waits_too_long_is_told(file, key, monkeypatch):
    def meanwhile():
        monkeypatch.setattr("splitknit_match.gallery.file.WAIT_S", 0.05)
        with GalleryFile(file, key) as another:
            assert len(another) == 5  # readers do not wait
            with bad_input("another program is writing"):
                another.add([new("Cid", 9)], SETTINGS)

    with GalleryFile(file, key) as gallery:
        gallery.add([new("Dan", 8)], SETTINGS, first=meanwhile)
    assert len(people(file, key)) == 6


def test_a_file_that_is_replaced_meanwhile_is_left_alone(file, key):
    other_file = file.with_name("other.skg")
    other_file.write_bytes(file.read_bytes())
    with GalleryFile(file, key) as gallery, bad_input("was replaced or removed meanwhile"):
        gallery.add([new("Dan", 8)], SETTINGS, last=lambda: other_file.replace(file))
    assert len(people(file, key)) == 5


@pytest.mark.parametrize("end", ["-journal", "-wal", "-shm"])
@pytest.mark.parametrize("make", [Path.symlink_to, Path.hardlink_to, None])
def test_what_lies_beside_it_leads_nowhere(file, key, tmp_path, end, make):
    beside, other_file = Path(f"{file}{end}"), tmp_path / "other"
    other_file.write_bytes(b"not ours" * 1000)
    if make is None:
        os.mkfifo(beside)
    else:
        make(beside, other_file)
    with GalleryFile(file, key) as gallery:
        for act in (gallery.entries, lambda: gallery.add([new("Cid", 9)], SETTINGS)):
            with bad_input(f"{end}' leads to another file, or is no plain"):
                act()
    assert other_file.read_bytes() == b"not ours" * 1000


@pytest.mark.parametrize("through", ["file", "link"])
def test_a_journal_deletes_no_other_file(file, key, tmp_path, through):
    """SQLite deletes the *super-journal* that the end of a journal names."""
    magic, victim = bytes.fromhex("d9d505f920a163d7"), tmp_path / "victim"
    victim.write_bytes(b"not ours")
    name, opened = os.fsencode(victim), file
    header = magic + struct.pack(">IIIII", 0, 0, 1, 512, 4096)
    sums = struct.pack(">II", len(name), sum(name))
    Path(f"{file}-journal").write_bytes(header.ljust(512, b"\0") + b"page" + name + sums + magic)
    if through == "link":
        opened = tmp_path / "link.skg"
        opened.symlink_to(file)
    with GalleryFile(opened, key) as gallery:
        for act in (gallery.entries, lambda: gallery.add([new("Cid", 9)], SETTINGS)):
            with bad_input("-journal' leads to another file"):
                act()
    assert victim.read_bytes() == b"not ours"


HUGE = "length(hex(zeroblob(400000000)))"
HOSTILE = {
    "check": f"REPLACE(sql, 'UNIQUE (person', 'CHECK({HUGE} > 0), UNIQUE (person')",
    "generated": f"REPLACE(sql, 'UNIQUE (', 'g INT NOT NULL AS ({HUGE}), UNIQUE (')",
    "statistics": f"'CREATE TABLE sqlite_stat1(tbl, idx, stat AS ({HUGE}))'",
}
"""Statements in place of that of the table of captures."""
MEMORY = """
import re, sys
from pathlib import Path
sys.path += sys.argv[1].split(":")
from test_gallery import KEY, BadInput, GalleryFile
for path in sys.argv[3:]:
    try:
        GalleryFile(path, KEY if sys.argv[2] == "encrypted" else None).entries()
    except BadInput as error:
        print(error)
print(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read in /proc")
def test_a_hostile_schema_is_refused_before_it_is_evaluated(file, key):
    """It would take 1.2 to 2 GB."""
    files = []
    for name, statement in HOSTILE.items():
        path = file.with_name(name)
        path.write_bytes(file.read_bytes())
        files.append(str(path))
        with contextlib.closing(driver(key).connect(path, isolation_level=None)) as raw:
            for change in () if key is None else (key.pragma,):
                raw.execute(change)
            raw.execute("PRAGMA writable_schema=ON")
            if name == "statistics":
                raw.execute("UPDATE sqlite_master SET name = 'sqlite_stat1' WHERE name = 'capture'")
            raw.execute(
                f"UPDATE sqlite_master SET sql = {statement}"
                " WHERE name IN ('capture', 'sqlite_stat1')"
            )
    kind = "plain" if key is None else "encrypted"
    process = subprocess.run(
        [sys.executable, "-c", MEMORY, ":".join(sys.path), kind, *files],
        capture_output=True,
        text=True,
        check=True,
    )
    *refused, peak_kb = process.stdout.splitlines()
    assert len(refused) == 3
    assert all("its tables are not a gallery's" in line for line in refused)
    assert int(peak_kb) < 300_000


def test_pages_that_no_gallery_has_are_refused(tmp_path):
    """Checking a sparse file of 8 TB would take 0.3 GB."""
    file, pages = tmp_path / "g.skg", 2**28 + 1
    with GalleryFile(file) as gallery:
        gallery.add([new("Ann", 1)], SETTINGS)
    try:
        os.truncate(file, pages * 4096)
    except OSError:
        pytest.skip("the file system has no such files")
    with file.open("r+b") as stream:
        stream.seek(28)
        stream.write(pages.to_bytes(4, "big"))
    with bad_input("too many pages"):
        GalleryFile(file).entries()


@contextlib.contextmanager
def full_beyond(size):
    """No file can grow beyond `size` bytes, which SQLite reports as a full disk does."""
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))


@pytest.mark.parametrize("size", [0, 33_000])
def test_a_full_disk_is_no_damage(file, key, size):
    """There is no room for the index of the log, or for the log."""
    with GalleryFile(file, key) as gallery, full_beyond(size):
        if size:
            assert len(gallery) == 5
        else:
            with bad_input(r"is full, or .* the gallery cannot be read"):
                gallery.entries()
        with bad_input(r"is full, or .* the gallery was not changed"):
            gallery.add([new(f"P{k}", k) for k in range(40)], SETTINGS)
    assert len(people(file, key)) == 5


def test_a_change_that_was_made_is_no_failure_on_a_full_disk(tmp_path, key):
    """There is room for the gallery, not for the index of a log, of 32 kB."""
    path = tmp_path / "g.skg"
    with GalleryFile(path, key) as gallery, full_beyond(32_000):
        assert gallery.add([new("Ann", 1)], SETTINGS) == [True]
    assert people(path, key) == ["Ann, right index, session 1"]


KILLED = """
import os, random, signal, sys, time
sys.path += sys.argv[2].split(":")
from test_gallery import KEY, SETTINGS, new
from splitknit_match.gallery.file import GalleryFile
path, key = sys.argv[1], KEY if sys.argv[3] == "encrypted" else None
random.seed(7)

def changed(people, what, who):
    return people - {who} if what == "remove" else people | {who}

def write(told, seed):
    # changes, each told before and after
    rng = random.Random(seed)
    with GalleryFile(path, key) as gallery:
        people = [one.person for one in gallery.entries()]
        for k in range(1000):
            what = rng.choice(["add", "add", "replace", "remove"]) if len(people) > 3 else "add"
            who = f"W{seed}-{k}" if what == "add" else rng.choice(people)
            os.write(told, f"{what} {who}\\n".encode())
            if what == "remove":
                gallery.remove(who)
                people.remove(who)
            else:
                gallery.add([new(who, rng.randrange(10**6))], SETTINGS, replaces=True)
                people += [who] * (what == "add")
            os.write(told, b"done\\n")

for kill in range(30):
    with GalleryFile(path, key) as gallery:
        before = {one.person for one in gallery.people().entries.values()}
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
            people = changed(people, *line.split())
    possible = [people] + ([changed(people, *under_way)] if under_way else [])
    with GalleryFile(path, key) as gallery:
        assert {one.person for one in gallery.entries()} in possible, (lines, under_way)
print("sound")
"""


def test_thirty_killed_writers_lose_nothing(file, key):
    """What was told as done is there, of what was under way all or nothing."""
    arguments = [str(file), ":".join(sys.path), "plain" if key is None else "encrypted"]
    process = subprocess.run(
        [sys.executable, "-c", KILLED, *arguments], capture_output=True, text=True, check=False
    )
    assert process.stdout == "sound\n", process.stderr


def test_an_interrupt_in_the_middle_changes_nothing(file, key):
    with GalleryFile(file, key) as gallery, pytest.raises(KeyboardInterrupt):
        gallery.add([new("Dan", 8)], SETTINGS, last=lambda: signal.raise_signal(signal.SIGINT))
    assert len(people(file, key)) == 5
    assert list(file.parent.iterdir()) == [file]


def test_read_only_galleries_are_read(file, key):
    if os.geteuid() == 0:
        pytest.skip("root may write everything")
    file.chmod(0o400)
    assert len(people(file, key)) == 5
    with GalleryFile(file, key) as gallery, bad_input("may not be written"):
        gallery.add([new("Cid", 9)], SETTINGS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"person": ""}, "person's name"),
        ({"person": "a\nb"}, "person's name"),
        ({"person": "x" * 101}, "person's name"),
        ({"finger": "Right Index"}, "cannot be a finger"),
        ({"session": "a/b"}, "cannot be a session"),
    ],
)
def test_names_that_cannot_be(change, words):
    with bad_input(words):
        replace(new("Ann").entry, **change)


def test_one_name_has_one_way_of_writing():
    assert new("Zoe\u0308").entry == new(" Zo\u00eb ").entry


def test_sessions_are_in_order():
    assert sorted(["b", "10", "2", "a"], key=session_order) == ["2", "10", "a", "b"]
