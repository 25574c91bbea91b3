"""Files and folders that appear whole or not at all.

Everything is written under a temporary name beside the target and renamed at the end, so that an exception, an
interrupt or a full disk leaves neither a half-written result nor a damaged earlier one. What a killed program left
beside a target is removed by the next one that writes into the same folder.

Fingerprints are personal data: whatever is written is readable by its owner alone (files 0600, folders 0700), or by
the group too (0640, 0750) where the environment variable :data:`GROUP_READABLE` is 1, which worker processes inherit.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeVar

from splitknit.errors import BadInput, require

MANIFEST = ".splitknit"
"""File in every folder we write that lists what we wrote there: only that may be replaced."""
GROUP_READABLE = "SPLITKNIT_GROUP_READABLE"
_STRAY = frozenset({MANIFEST, ".DS_Store", "Thumbs.db", "desktop.ini"})
_LEFT_OVER = re.compile(r"\.(?P<target>.{1,100})\.[0-9a-f]{12}\.(?P<ending>tmp|old)", re.DOTALL)
_LONGEST_NAME = 100
Held = TypeVar("Held", int, int | None)
"""A descriptor that holds a lock; None of a folder on Windows."""
_WINDOWS = os.name == "nt"
"""Has no locks of this kind, opens no folders, and renames no open files."""
_AT_WORK: set[Path] = set()
"""Temporary folders that this process is filling."""


@contextlib.contextmanager
def atomic_folder(out: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary folder beside `out` that becomes `out` when the block ends without an exception.

    An existing `out` is replaced as a whole, but only if it is empty or if every file in it was written by splitknit
    (its manifest, ``.splitknit``, lists them); a folder with anything else in it is refused, never deleted. Parent
    folders are created. After an exception or an interrupt `out` is as it was and the temporary folder is gone.
    Everything in it becomes private (see above). Where `out` is itself such a temporary folder, it is yielded as it is.

    Raises
    ------
    BadInput
        If `out` is a file, holds files not written here, exists while `overwrite` is false, or cannot be written.
    """
    target = _resolved(out)
    if target in _AT_WORK:
        yield target
        return
    _check_replaceable(target, overwrite)
    with _parents(target), _refuse_os_errors(target):
        _sweep(target.parent)
        temporary, lock = _new_sibling(target, _make_folder)
        try:
            _AT_WORK.add(temporary)
            yield temporary
            _write_manifest(temporary)
            _make_private(temporary)
            _swap(temporary, target, overwrite)
        finally:
            _AT_WORK.discard(temporary)
            shutil.rmtree(temporary, ignore_errors=True)
            _release(lock)


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[BinaryIO]:
    """Yield a binary file that becomes `path`, replacing a file of that name, when the block ends without exception.

    Parent folders are created. The file is private (see above).

    Raises
    ------
    BadInput
        If `path` is a folder or a device, exists while `overwrite` is false, or cannot be written.
    """
    target = _resolved(path)
    with _refuse_os_errors(target):
        require(not target.is_dir(), f"'{target}' is a folder; name a file to write.")
        # the renaming would take the place of /dev/null, where one may do that
        require(target.is_file() or not target.exists(), f"'{target}' is a device or a pipe; name a file to write.")
    with _parents(target), _refuse_os_errors(target):
        _sweep(target.parent)
        temporary, descriptor = _new_sibling(target, _make_file)
        try:
            with os.fdopen(descriptor, "wb") as stream:
                yield stream
                stream.flush()
                temporary.chmod(private_modes()[0])
                if _WINDOWS:  # where no open file is renamed
                    stream.close()
                if overwrite:
                    temporary.replace(target)
                else:
                    _place(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)


def _place(temporary: Path, target: Path) -> None:
    """Rename, unless there is a file of that name; a link fails then, unlike a renaming."""
    try:
        target.hardlink_to(temporary)
    except FileExistsError:
        raise
    except OSError:  # a disk without links
        if target.exists():
            raise
        temporary.rename(target)


def private_modes() -> tuple[int, int]:
    """Return the permissions of new files and folders: the owner's alone, or the group's too."""
    return (0o640, 0o750) if os.environ.get(GROUP_READABLE) == "1" else (0o600, 0o700)


def make_folder(folder: Path) -> None:
    """Create a private folder and its missing parents; nothing happens to one that exists.

    Raises
    ------
    OSError
        If that fails, as :meth:`pathlib.Path.mkdir`.
    """
    mode = private_modes()[1]
    for path in [*(path for path in reversed(folder.parents) if not path.exists()), folder]:
        path.mkdir(mode, exist_ok=True)


def _make_private(folder: Path) -> None:
    for_file, for_folder = private_modes()
    for path in folder.rglob("*"):
        if not path.is_symlink():
            path.chmod(for_folder if path.is_dir() else for_file)
    folder.chmod(for_folder)


def _resolved(path: str | os.PathLike[str]) -> Path:
    try:
        return Path(path).expanduser().resolve()
    except (OSError, ValueError, RuntimeError) as error:
        raise BadInput(f"{os.fspath(path)!r} is not a usable path: {error}.") from error


def _sibling(target: Path, ending: str = "tmp") -> Path:
    import secrets  # noqa: PLC0415 - who only reads needs none of it

    return target.with_name(f".{target.name[:_LONGEST_NAME]}.{secrets.token_hex(6)}.{ending}")


def _new_sibling(target: Path, make: Callable[[Path], Held]) -> tuple[Path, Held]:
    """Make a temporary file or folder beside `target`; return its path and the descriptor that holds its lock.

    Between its making and its locking :func:`_sweep` of another program may take it for a leftover: then once more.
    """
    while True:
        path = _sibling(target)
        with contextlib.suppress(FileNotFoundError):
            descriptor = make(path)
            _lock(descriptor, wait=True)
            if path.exists():
                return path, descriptor
            _release(descriptor)


def _make_file(path: Path) -> int:
    return os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0), 0o600)


def _make_folder(path: Path) -> int | None:
    path.mkdir(0o700)
    return _hold_folder(path)


def _hold_folder(path: Path) -> int | None:
    return None if _WINDOWS else os.open(path, os.O_RDONLY)


def _release(descriptor: int | None) -> None:
    if descriptor is not None:
        os.close(descriptor)


def hold(stream: IO[Any], busy: str) -> None:
    """Keep other programs out until `stream` is closed or this one ends; without effect where there are no such locks.

    Raises
    ------
    BadInput
        With the message `busy`, if another program holds it.
    """
    try:
        import fcntl  # noqa: PLC0415 - not on every system
    except ImportError:
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise BadInput(busy) from error


def _lock(descriptor: int | None, *, wait: bool) -> bool:
    """Lock; False if another program holds it and `wait` is false, or if this system or disk has no locks."""
    if descriptor is None:
        return False
    try:
        import fcntl  # noqa: PLC0415 - not on every system

        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return False
    return True


@functools.lru_cache(maxsize=4096)  # once a folder and process: some folders get thousands of files
def _sweep(parent: Path) -> None:
    """Remove what killed programs left in a folder; an earlier result whose replacement was cut short is put back."""
    with contextlib.suppress(OSError):
        for name in os.listdir(parent):  # noqa: PTH208 - names are all that is looked at in a large folder
            found = _LEFT_OVER.fullmatch(name)
            if found is not None:
                with contextlib.suppress(OSError):
                    _sweep_one(parent / name, parent / found["target"], found["ending"])


def _sweep_one(left: Path, target: Path, ending: str) -> None:
    status = left.lstat()
    own = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    if not own or not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        return
    descriptor = os.open(left, os.O_RDONLY)
    try:
        if not _lock(descriptor, wait=False):
            return  # its program is still at work
        if ending == "old" and not target.exists():
            if len(target.name) < _LONGEST_NAME:  # else it was cut
                left.rename(target)
        elif left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()
    finally:
        os.close(descriptor)


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
        make_folder(target.parent)
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
    own = manifest_of(target)
    for name in names:
        require(
            name in own or Path(name).name in _STRAY,
            f"'{target}' holds '{name}', which splitknit did not write there; name another folder.",
        )


def _files(folder: Path) -> list[str]:
    """Names of everything in `folder` that is not a folder itself; a link to a folder counts."""
    found = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in found)


def _write_manifest(folder: Path) -> None:
    document = {"format": "splitknit-folder", "version": 1, "files": _files(folder)}
    (folder / MANIFEST).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def manifest_of(folder: Path) -> frozenset[str]:
    """Names of the files that we wrote into a folder, relative to it; none where it was not written whole."""
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
    old, lock = _sibling(target, "old"), _hold_folder(target)
    try:
        _lock(lock, wait=False)  # it fails where another program replaces `target` as well, or has it swept
        target.rename(old)
        try:
            temporary.rename(target)
        except BaseException:
            old.rename(target)
            raise
        shutil.rmtree(old, ignore_errors=True)
    finally:
        _release(lock)
