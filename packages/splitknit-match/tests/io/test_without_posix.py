"""What Windows lacks (locks, owners, folders that open, opening below a folder) is not needed to read and write."""

from __future__ import annotations

import io
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from splitknit.io import atomic


@pytest.fixture(autouse=True)
def windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Windows answers, once pytest has made its folder."""
    opened, replaced, streams = os.open, Path.replace, []

    def no_folders(path: Any, *flags: Any, **more: Any) -> int:
        if os.path.isdir(path):  # noqa: PTH112
            raise PermissionError(13, "Permission denied")
        return opened(path, *flags, **more)

    def fdopen(*given: Any, **named: Any) -> io.IOBase:
        streams.append(io.open(*given, **named))  # noqa: SIM115, UP020
        return streams[-1]

    def closed_only(path: Path, target: Path) -> Path:
        assert all(stream.closed for stream in streams), "an open file is renamed"
        return replaced(path, target)

    monkeypatch.setattr(os, "open", no_folders)
    monkeypatch.setattr(os, "fdopen", fdopen)
    monkeypatch.setattr(shutil, "_use_fd_functions", False)
    monkeypatch.setattr(Path, "replace", closed_only)
    monkeypatch.setattr(os, "supports_dir_fd", set())
    monkeypatch.delattr(os, "getuid")
    monkeypatch.setattr(atomic, "_WINDOWS", True)
    monkeypatch.setitem(sys.modules, "fcntl", None)


def test_files_and_folders_are_written_and_replaced(tmp_path: Path) -> None:
    left = tmp_path / ".out.0123456789ab.tmp"
    left.write_text("may be another program's: nothing shows whether it is at work")
    for text in ("one", "two"):
        with atomic.atomic_folder(tmp_path / "out") as folder:
            (folder / "a").write_text(text)
        with atomic.atomic_file(tmp_path / "file") as stream:
            stream.write(text.encode())
        assert (tmp_path / "out" / "a").read_text() == (tmp_path / "file").read_text() == text
    assert {path.name for path in tmp_path.iterdir()} == {"out", "file", left.name}


def test_a_batch_holds_nothing(tmp_path: Path) -> None:
    with (tmp_path / "lock").open("wb") as one, (tmp_path / "lock").open("wb") as two:
        atomic.hold(one, "busy")
        atomic.hold(two, "busy")
