import contextlib
import json
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from refusals import bad_input
from splitknit.cli import main as cli
from splitknit.cli.exits import INTERRUPTS
from splitknit.files import given_folders, read_bytes
from splitknit.interrupts import UNFINISHED
from splitknit.io import atomic
from splitknit.io.atomic import GROUP_READABLE, MANIFEST, atomic_file, atomic_folder, manifest_of


def fill(out, **files):
    with atomic_folder(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)


def visible(folder):
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != ".splitknit"}


def test_a_folder_appears_whole_and_parents_are_made(tmp_path):
    out = tmp_path / "a" / "b" / "result"
    with atomic_folder(out) as folder:
        (folder / "first").write_text("1")
        (folder / "sub").mkdir()
        (folder / "sub" / "second").write_text("2")
        assert not out.exists()
        assert folder.parent.parent == out.parent  # renamed on one disk
    assert (out / "sub" / "second").read_text() == "2"
    assert os.listdir(out.parent) == ["result"]  # noqa: PTH208


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_after_a_failure_everything_is_as_before(tmp_path, error):
    def fail(out):
        with pytest.raises(error), atomic_folder(out) as folder:
            (folder / "half").write_text("x")
            raise error

    fail(tmp_path / "new" / "result")
    assert list(tmp_path.iterdir()) == []
    fill(tmp_path / "result", first="1")
    fail(tmp_path / "result")
    assert visible(tmp_path / "result") == {"first": "1"}
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_a_failed_rename_restores_the_earlier_result(tmp_path, monkeypatch):
    fill(tmp_path / "result", first="1")
    rename = Path.rename

    def broken(self, target):
        if self.name == "new" and target.name == "result":
            raise OSError(28, "No space left on device")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", broken)
    with bad_input("No space left on device"):
        fill(tmp_path / "result", new="2")
    assert visible(tmp_path / "result") == {"first": "1"}
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_an_earlier_result_is_replaced_as_a_whole(tmp_path):
    fill(tmp_path / "result", first="1", second="2")
    (tmp_path / "result" / ".DS_Store").touch()
    fill(tmp_path / "result", second="new")
    assert visible(tmp_path / "result") == {"second": "new"}
    (tmp_path / "empty").mkdir()
    fill(tmp_path / "empty", first="1")
    assert visible(tmp_path / "empty") == {"first": "1"}


def test_files_of_others_are_never_deleted(tmp_path):
    mine = tmp_path / "photos"
    mine.mkdir()
    (mine / "holiday.png").write_text("dear")
    with bad_input(r"'holiday\.png', which splitknit did not write"):
        fill(mine, first="1")
    fill(tmp_path / "result", first="1")
    (tmp_path / "result" / "link").symlink_to(mine)
    with bad_input("'link', which splitknit did not write"):
        fill(tmp_path / "result", first="2")
    for text in (
        "[]",
        "{",
        '{"format": "other", "files": ["holiday.png"]}',
        '{"format": "splitknit-folder"}',
    ):
        (mine / ".splitknit").write_text(text)
        with bad_input("did not write"):
            fill(mine, first="1")
    assert (mine / "holiday.png").read_text() == "dear"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("kind", ["pipe", "another folder's", "/dev/zero", "too large"])
def test_a_list_of_files_counts_only_as_a_file_of_its_own(tmp_path, kind):
    mark = tmp_path / "theirs" / MANIFEST
    fill(tmp_path / "ours", first="1")
    mark.parent.mkdir()
    if kind == "pipe":
        os.mkfifo(mark)
    elif kind == "too large":
        mark.write_bytes((tmp_path / "ours" / MANIFEST).read_bytes() + b" " * 16_000_000)
    else:
        mark.symlink_to("/dev/zero" if kind == "/dev/zero" else tmp_path / "ours" / MANIFEST)
    for name in ("first", None):  # beside a file, and alone
        (mark.parent / "first").write_text("theirs") if name else (mark.parent / "first").unlink()
        assert manifest_of(mark.parent) == frozenset()
        if name or kind != "too large":
            with bad_input("which splitknit did not write"):
                fill(mark.parent, first="2")
            assert os.path.lexists(mark)


def test_a_file_added_by_others_meanwhile_is_kept(tmp_path):
    fill(tmp_path / "result", first="1")
    with bad_input("did not write"), atomic_folder(tmp_path / "result") as folder:
        (folder / "first").write_text("2")
        (tmp_path / "result" / "notes").write_text("mine")
    assert visible(tmp_path / "result") == {"first": "1", "notes": "mine"}


def test_places_that_cannot_be_written_are_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    with bad_input("is a file"):
        fill(tmp_path / "file", first="1")
    with bad_input("cannot write"):
        fill(tmp_path / "file" / "result", first="1")
    with bad_input("cannot write"):
        fill(tmp_path / ("x" * 300), first="1")
    with bad_input("not a usable path"):
        fill(Path("a\0b"), first="1")
    with bad_input("exists and is not empty"), atomic_folder(tmp_path, overwrite=False):
        pass
    with bad_input("mounted disk"), atomic_folder("/"):
        pass
    assert visible(tmp_path) == {"file": "x"}


def test_a_file_in_an_unfinished_folder_is_written_whole_or_not_at_all(tmp_path):
    with atomic_folder(tmp_path / "result") as folder:
        for name in ("first", "sub/second"):
            with atomic_file(folder / name) as stream:
                stream.write(b"1")
        with contextlib.suppress(RuntimeError), atomic_file(folder / "half") as stream:
            stream.write(b"half")
            raise RuntimeError
        assert sorted(os.listdir(folder)) == ["first", "sub"]  # noqa: PTH208
    assert (tmp_path / "result" / "sub" / "second").read_text() == "1"


def test_a_nested_atomic_folder_appears_with_the_outer_one(tmp_path):
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "result") as outer:
        with atomic_folder(outer) as inner:
            assert inner == outer
            (inner / "first").write_text("1")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    with atomic_folder(tmp_path / "result") as outer, atomic_folder(outer) as inner:
        (inner / "first").write_text("1")
    assert visible(tmp_path / "result") == {"first": "1"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with bad_input("Permission denied"):
        fill(tmp_path / "locked" / "result", first="1")


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a" / "file.bin"
    with atomic_file(path) as stream:
        stream.write(b"first")
        assert not path.exists()
    with pytest.raises(RuntimeError), atomic_file(path) as stream:
        stream.write(b"second")
        raise RuntimeError
    assert path.read_bytes() == b"first"
    with pytest.raises(KeyboardInterrupt), atomic_file(tmp_path / "b" / "file.bin") as stream:
        raise KeyboardInterrupt
    assert not (tmp_path / "b").exists()
    with bad_input("is a folder"), atomic_file(tmp_path):
        pass
    assert [entry.name for entry in path.parent.iterdir()] == ["file.bin"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_a_pipe_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        with bad_input("is a device or a pipe"), atomic_file(tmp_path / name) as stream:
            stream.write(b"never")
    assert (tmp_path / "pipe").is_fifo()
    assert {path.name for path in tmp_path.iterdir()} == {"pipe", "link"}


@pytest.mark.parametrize(
    ("group", "for_file", "for_folder"), [("", 0o600, 0o700), ("1", 0o640, 0o750)]
)
def test_what_is_written_is_private(tmp_path, monkeypatch, group, for_file, for_folder):
    monkeypatch.setenv(GROUP_READABLE, group)
    out = tmp_path / "new" / "result"
    with atomic_folder(out) as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "open").touch(0o666)
        (folder / "link").symlink_to(tmp_path)
    with atomic_file(tmp_path / "other" / "file"):
        pass
    modes = {
        path: stat.S_IMODE(path.lstat().st_mode)
        for path in tmp_path.rglob("*")
        if not path.is_symlink()
    }
    assert {mode for path, mode in modes.items() if path.is_dir()} == {for_folder}
    assert {mode for path, mode in modes.items() if path.is_file()} == {for_file}
    assert len(modes) == 7
    # what was there keeps its permissions (pytest's are these)
    assert tmp_path.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("place", ["mkdir", "_lock", "_discard", "rename", "_release"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_tidying_waits_until_that_is_done(tmp_path, monkeypatch, number, place):
    fill(tmp_path / "result", first="1")
    where = Path if place in ("mkdir", "rename") else atomic
    work, come = getattr(where, place), []

    def interrupted(*arguments, **named):
        done = work(*arguments, **named) if place in ("mkdir", "_lock", "rename") else None
        if not come:
            come.append(number)
            signal.raise_signal(number)
        return work(*arguments, **named) if place in ("_discard", "_release") else done

    earlier = signal.signal(number, cli._interrupt)
    try:
        with pytest.raises(KeyboardInterrupt), monkeypatch.context() as patched:
            patched.setattr(where, place, interrupted)
            fill(tmp_path / "result", first="2")
    finally:
        signal.signal(number, earlier)
        INTERRUPTS.clear()
    assert come and [path.name for path in tmp_path.iterdir()] == ["result"]
    assert visible(tmp_path / "result")["first"] in ("1", "2")
    assert UNFINISHED.depth == 0


KILLED = """
import os, signal, sys
from pathlib import Path
from splitknit.io.atomic import atomic_file, atomic_folder
out, where = Path(sys.argv[1]), sys.argv[2]
if where == "file":
    with atomic_file(out) as stream:
        stream.write(b"half")
        stream.flush()
        os.kill(os.getpid(), signal.SIGKILL)
rename = Path.rename
def stopped(self, target):
    if where == "swap" and self.name == "new":
        os.kill(os.getpid(), signal.SIGKILL)
    return rename(self, target)
Path.rename = stopped
with atomic_folder(out) as folder:
    (folder / "new").write_text("2")
    if where == "folder":
        os.kill(os.getpid(), signal.SIGKILL)
"""


def unmarked(parent):
    """Hidden files and folders of a user, some of them called as ours are, and backups of results
    of ours."""
    names = (
        ".kept.tmp",
        ".photos.202611221145.old",
        ".photo.0123456789ab.tmp",
        ".splitknit-0123456789ab.tmp",
    )
    folders = (
        ".photos.202611221146.old",
        ".splitknit-0123456789ac.tmp",
        ".splitknit-0123456789ad.tmp",
        ".splitknit-0123456789ae.tmp",
    )
    for name in names:
        (parent / name).write_text("mine")
    for name in folders:
        (parent / name).mkdir()
        (parent / name / "mine").write_text("mine")
        (parent / name / ".splitknit").write_text(
            '{"format": "splitknit-folder", "files": ["mine"]}'
        )
    mark = '{"format": "splitknit-temporary", "version": 1, "target": "../x"}'
    (parent / folders[2] / "mark.json").write_text(mark)
    (parent / folders[3] / "mark.json").write_text('{"format": "other", "target": "x"}')
    return [parent / name for name in (*names, *folders)]


def test_a_mark_restores_nothing_elsewhere_and_replaces_no_new_result(tmp_path):
    """A received folder may hold marks: they lead nowhere; what took the place of an old result is
    not replaced."""
    for name, target in (("0123456789ab", "../away"), ("0123456789ac", "taken")):
        left = tmp_path / "received" / f".splitknit-{name}.tmp"
        for part in ("new", "old"):
            (left / part).mkdir(parents=True)
        (left / "old" / "result").write_text("old")
        (left / "mark.json").write_text(
            json.dumps({"format": "splitknit-temporary", "target": target})
        )
    (tmp_path / "received" / "taken").write_text("mine")
    with atomic_file(tmp_path / "received" / "file"):
        pass
    assert sorted(os.listdir(tmp_path)) == ["received"]  # noqa: PTH208
    assert (tmp_path / "received" / "taken").read_text() == "mine"
    assert len(list(tmp_path.rglob("old/result"))) == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("owned", ["", ".splitknit-0123456789ab.tmp"])
def test_nothing_of_another_owner_is_removed(tmp_path, owned):
    folder = tmp_path / "shared"
    left = folder / ".splitknit-0123456789ab.tmp"
    left.mkdir(parents=True)
    (left / "mark.json").write_text('{"format": "splitknit-temporary", "target": "x"}')
    os.chown(folder / owned, 12345, 12345)
    with atomic_file(folder / "file"):
        pass
    assert left.is_dir()


def test_nothing_is_written_through_a_link_inside_a_given_folder(tmp_path):
    mine, received = tmp_path / "mine", tmp_path / "given"
    mine.mkdir()
    (mine / "file").write_text("mine")
    received.mkdir()
    (received / "file").symlink_to(mine / "file")
    (received / "folder").symlink_to(mine)
    (tmp_path / "link").symlink_to(received)
    for named in (received, tmp_path / "link"):
        with given_folders([named]):
            for name in ("file", "folder/file", "folder/new/file"):
                for write in (atomic_file, atomic_folder):
                    with bad_input("is a link inside a folder"), write(named / name):
                        pass
                with bad_input("is a link inside a folder"):
                    read_bytes(named / name, 100)
            with atomic_file(named / "below" / "own") as stream:
                stream.write(b"own")
            assert read_bytes(named / "below" / "own", 100) == b"own"
        assert read_bytes(named / "file", 100) == b"mine"  # named by nobody
    with given_folders([received, received / "file"]):  # the link itself is named
        assert read_bytes(received / "file", 100) == b"mine"
    assert {path.name: path.read_text() for path in mine.iterdir()} == {"file": "mine"}


@pytest.mark.parametrize("where", ["file", "folder", "swap"])
def test_the_next_program_removes_what_a_killed_one_left(tmp_path, where):
    fill(tmp_path / "kept", first="1")
    mine = unmarked(tmp_path)
    out = tmp_path / ("file" if where == "file" else "kept")
    run = subprocess.run([sys.executable, "-c", KILLED, str(out), where], check=False)
    assert run.returncode == -signal.SIGKILL
    left = [path for path in tmp_path.iterdir() if path not in {*mine, tmp_path / "kept"}]
    assert len(left) == 1
    again = (
        "from splitknit.io.atomic import atomic_file; import sys;"
        " atomic_file(sys.argv[1]).__enter__()"
    )
    for digits in ("10", "11"):  # killed before its mark was written
        (tmp_path / f".splitknit-0123456789{digits}.tmp").mkdir()
    (tmp_path / ".splitknit-012345678911.tmp" / "mark.json").touch()
    there = set(tmp_path.iterdir())
    with atomic_folder(tmp_path / "at_work"):  # another program at work is left alone
        before = set(tmp_path.iterdir()) - there
        assert len(before) == 1
        subprocess.run([sys.executable, "-c", again, str(tmp_path / "other")], check=True)
        assert before <= set(tmp_path.iterdir())
    assert {path.name for path in tmp_path.iterdir()} == {
        "kept",
        "at_work",
        *(path.name for path in mine),
    }
    assert visible(tmp_path / "kept") == {"first": "1"}
    for path in mine:
        assert (path if path.is_file() else path / "mine").read_text() == "mine"


def test_a_temporary_folder_that_another_program_removes_is_made_again(tmp_path, monkeypatch):
    """Between its making and its locking it looks as if its program had been killed."""
    hold, opened = atomic._open_folder, []

    def swept(folder):
        opened.append(folder)
        if len(opened) == 1:
            folder.rmdir()
        return hold(folder)

    monkeypatch.setattr(atomic, "_open_folder", swept)
    with atomic_file(tmp_path / "file") as stream:
        stream.write(b"1")
    assert len(opened) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
