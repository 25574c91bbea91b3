"""Files and folders that appear whole or not at all.

Everything is written under a temporary name beside the target and renamed at the end, so that an exception, an
interrupt or a full disk leaves neither a half-written result nor a damaged earlier one.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from splitknit.check import BadInput, require

MANIFEST = ".splitknit"
"""File in every folder we write that lists what we wrote there: only that may be replaced."""
_STRAY = frozenset({MANIFEST, ".DS_Store", "Thumbs.db", "desktop.ini"})


@contextlib.contextmanager
def atomic_folder(out: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary folder beside `out` that becomes `out` when the block ends without an exception.

    An existing `out` is replaced as a whole, but only if it is empty or if every file in it was written by splitknit
    (its manifest, ``.splitknit``, lists them); a folder with anything else in it is refused, never deleted. Parent
    folders are created. After an exception or an interrupt `out` is as it was and the temporary folder is gone.

    Raises
    ------
    BadInput
        If `out` is a file, holds files that are not ours, exists while `overwrite` is false, or cannot be written.
    """
    target = _resolved(out)
    _check_replaceable(target, overwrite)
    with _parents(target), _refuse_os_errors(target):
        temporary = _sibling(target)
        try:
            temporary.mkdir()
            yield temporary
            _write_manifest(temporary)
            _swap(temporary, target, overwrite)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yield a binary file that becomes `path`, replacing a file of that name, when the block ends without exception.

    Parent folders are created.

    Raises
    ------
    BadInput
        If `path` is a folder or cannot be written.
    """
    target = _resolved(path)
    with _refuse_os_errors(target):
        require(not target.is_dir(), f"'{target}' is a folder; name a file to write.")
    with _parents(target), _refuse_os_errors(target):
        temporary = _sibling(target)
        try:
            with temporary.open("xb") as stream:
                yield stream
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


def _resolved(path: str | os.PathLike[str]) -> Path:
    try:
        return Path(path).expanduser().resolve()
    except (OSError, ValueError, RuntimeError) as error:
        raise BadInput(f"{os.fspath(path)!r} is not a usable path: {error}.") from error


def _sibling(target: Path) -> Path:
    return target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.tmp")


@contextlib.contextmanager
def _refuse_os_errors(target: Path) -> Iterator[None]:
    """Turn a failure to write (permissions, full disk, name too long) into one sentence."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(f"cannot write '{target}': {reason}; choose another place.") from error


@contextlib.contextmanager
def _parents(target: Path) -> Iterator[None]:
    """Create the missing parents of `target`, and remove them again if the block fails."""
    missing = [folder for folder in target.parents if not folder.exists()]
    with _refuse_os_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for folder in missing:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _check_replaceable(target: Path, overwrite: bool) -> None:
    with _refuse_os_errors(target):
        if not target.exists():
            return
        require(target.is_dir(), f"'{target}' is a file; name a folder to write into.")
        require(not os.path.ismount(target), f"'{target}' is a mounted disk; name a folder inside it.")
        names = _files(target)
    if not names:
        return
    require(overwrite, f"'{target}' exists and is not empty; remove it or name another folder.")
    ours = _read_manifest(target)
    for name in names:
        require(
            name in ours or Path(name).name in _STRAY,
            f"'{target}' holds '{name}', which splitknit did not write there; name another folder.",
        )


def _files(folder: Path) -> list[str]:
    """Names of everything in `folder` that is not a folder itself; a link to a folder counts."""
    found = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in found)


def _write_manifest(folder: Path) -> None:
    document = {"format": "splitknit-folder", "version": 1, "files": _files(folder)}
    (folder / MANIFEST).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _read_manifest(folder: Path) -> frozenset[str]:
    try:
        document = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        if document["format"] != "splitknit-folder":
            return frozenset()
        return frozenset(str(name) for name in document["files"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return frozenset()


def _swap(temporary: Path, target: Path, overwrite: bool) -> None:
    """Put `temporary` in the place of `target`; if that fails, `target` is as before."""
    _check_replaceable(target, overwrite)  # it may have changed while we worked
    if not target.exists():
        temporary.rename(target)
        return
    old = _sibling(target)
    target.rename(old)
    try:
        temporary.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
