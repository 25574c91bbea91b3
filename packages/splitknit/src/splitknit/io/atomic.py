"""Files and folders that appear whole or not at all.

Everything is written into a temporary folder beside the target and renamed at the end, so that an
exception, an interrupt or a full disk leaves neither a half-written result nor a damaged earlier
one. The temporary folder holds a mark of ours, what is made (``new``) and, for the moment of the
exchange, what it replaces (``old``). Marked folders that a killed program left beside a target are
removed by the next one that writes into the same folder.

Fingerprints are personal data: whatever is written is readable by its owner alone (files 0600,
folders 0700), or by the group too (0640, 0750) where the environment variable
:data:`GROUP_READABLE` is 1, which worker processes inherit.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import json
import os
import re
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO

from splitknit.errors import BadInput, require
from splitknit.files import AnyPath, read_bytes, refuse_links
from splitknit.interrupts import UNFINISHED

MANIFEST = ".splitknit"
"""File in every folder we write that lists what we wrote there: only that may be replaced."""
GROUP_READABLE = "SPLITKNIT_GROUP_READABLE"
_STRAY = frozenset({MANIFEST, ".DS_Store", "Thumbs.db", "desktop.ini"})
_TEMPORARY = re.compile(r"\.splitknit-[0-9a-f]{12}\.tmp")
_MARK, _MARK_FORMAT = "mark.json", "splitknit-temporary"
"""File in a temporary folder that names the target: what has none is not ours, whatever it is
called."""
_AT_WORK: set[Path] = set()  # folders that this process is filling


@contextlib.contextmanager
def atomic_folder(out: AnyPath, *, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary folder beside `out` that becomes `out` when the block ends without an
    exception.

    An existing `out` is replaced as a whole, but only if it is empty or if every file in it was
    written by splitknit (its manifest, ``.splitknit``, lists them). Parent folders are created.
    Where `out` is itself such a temporary folder, it is yielded as it is. Raises BadInput if `out`
    is a file, holds files not written here, exists while `overwrite` is false, lies behind a link
    inside a folder that the user named, or cannot be written.
    """
    target = _resolved(out)
    if target in _AT_WORK:
        yield target
        return
    _check_replaceable(target, overwrite)
    with _parents(target), _refuse_os_errors(target), _temporary(target) as new:
        try:
            new.mkdir(0o700)
            _AT_WORK.add(new)
            yield new
            document = {"format": "splitknit-folder", "version": 1, "files": _files(new)}
            (new / MANIFEST).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
            for_file, for_folder = private_modes()
            for path in (new, *new.rglob("*")):
                if not path.is_symlink():
                    path.chmod(for_folder if path.is_dir() else for_file)
            _swap(new, target, overwrite)
        finally:
            _AT_WORK.discard(new)


@contextlib.contextmanager
def atomic_file(path: AnyPath) -> Iterator[BinaryIO]:
    """Yield a binary file that becomes `path`, replacing a file of that name, when the block ends
    without exception. Parent folders are created. Raises BadInput if `path` is a folder or a
    device, is or lies behind a link inside a folder that the user named, or cannot be written.
    """
    target = _resolved(path)
    with _refuse_os_errors(target):
        require(not target.is_dir(), f"'{target}' is a folder; name a file to write.")
        # the renaming would take the place of /dev/null, where one may do that
        require(
            target.is_file() or not target.exists(),
            f"'{target}' is a device or a pipe; name a file to write.",
        )
    within = any(folder in _AT_WORK for folder in target.parents)  # it appears with its folder
    place = _in_place(target) if within else _temporary(target)
    with _parents(target), _refuse_os_errors(target), place as new, new.open("wb") as stream:
        yield stream
        stream.flush()
        new.chmod(private_modes()[0])
        new.replace(target)


def write_file(path: AnyPath, data: bytes) -> None:
    """Write `data` as the whole of a file; see :func:`atomic_file`."""
    with atomic_file(path) as stream:
        stream.write(data)


def private_modes() -> tuple[int, int]:
    """Return the permissions of new files and folders: the owner's alone, or the group's too."""
    return (0o640, 0o750) if os.environ.get(GROUP_READABLE) == "1" else (0o600, 0o700)


def make_folder(folder: Path) -> None:
    """Create a private folder and its missing parents where missing; OSError as
    :meth:`pathlib.Path.mkdir`."""
    mode = private_modes()[1]
    for path in [*(path for path in reversed(folder.parents) if not path.exists()), folder]:
        path.mkdir(mode, exist_ok=True)


def _resolved(path: AnyPath) -> Path:
    try:
        refuse_links(path)
        return Path(path).expanduser().resolve()
    except BadInput:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        raise BadInput(f"{os.fspath(path)!r} is not a usable path: {error}.") from error


@contextlib.contextmanager
def _temporary(target: Path) -> Iterator[Path]:
    """Yield the path, in a marked temporary folder beside `target`. A mark without a lock is left
    over."""
    import secrets  # who only reads needs none of it

    _sweep_once(target.parent)
    folder = target.with_name(f".splitknit-{secrets.token_hex(6)}.tmp")
    mark = json.dumps({"format": _MARK_FORMAT, "version": 1, "target": target.name})
    lock: int | None = None
    try:
        UNFINISHED.depth += 1
        try:
            for last in (False, False, True):  # another program may sweep it before it is locked
                try:
                    folder.mkdir(0o700)
                    lock = _open_folder(folder)
                    _lock(lock)
                    (folder / _MARK).write_text(mark, encoding="ascii")
                    break
                except FileNotFoundError:
                    _release(lock)
                    lock = None
                    if last:
                        raise
        finally:
            UNFINISHED.leave()
        yield folder / "new"
    finally:
        UNFINISHED.depth += 1
        try:
            with contextlib.suppress(OSError):
                _discard(folder)
            _release(lock)
        finally:
            UNFINISHED.leave()


@contextlib.contextmanager
def _in_place(target: Path) -> Iterator[Path]:
    try:
        yield target
    except BaseException:
        target.unlink(missing_ok=True)
        raise


def _discard(folder: Path) -> None:
    """Remove a temporary folder, its mark last, unless it still holds the earlier target of an
    interrupted exchange."""
    new = folder / "new"
    old = folder / "old"
    if os.path.lexists(new) and os.path.lexists(old):
        return
    for part in (new, old):
        if part.is_dir() and not part.is_symlink():
            shutil.rmtree(part)
        else:
            part.unlink(missing_ok=True)
    (folder / _MARK).unlink(missing_ok=True)
    folder.rmdir()


def _open_folder(path: Path) -> int:
    return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)


def _release(descriptor: int | None) -> None:
    if descriptor is not None:
        os.close(descriptor)


def hold(stream: IO[Any], busy: str) -> None:
    """Keep other programs out until `stream` is closed. Raises BadInput, `busy`, if one holds
    it."""
    require(_lock(stream.fileno(), fcntl.LOCK_NB), busy)


def _lock(descriptor: int, flags: int = 0) -> bool:
    """Lock; False where the disk has no locks, or with the flag LOCK_NB if another program holds
    it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | flags)
    except OSError:
        return False
    return True


def sweep(folder: Path) -> None:
    """Remove what killed programs left in a folder and in those below it; see
    :func:`_sweep_one`."""
    for parent, _, _ in os.walk(folder, followlinks=False):
        _sweep_folder(Path(parent))


def _sweep_folder(parent: Path) -> None:
    with contextlib.suppress(OSError):
        names = os.listdir(parent) if _is_own(parent.stat()) else ()  # noqa: PTH208 - names suffice
        for name in names:
            if _TEMPORARY.fullmatch(name):
                with contextlib.suppress(OSError):
                    _sweep_one(parent / name)


_sweep_once = functools.lru_cache(maxsize=4096)(_sweep_folder)
"""Once a folder and process: some folders get thousands of files."""


def _sweep_one(left: Path) -> None:
    """Remove this user's left-over temporary folder; put an earlier result whose replacement was
    cut short back."""
    if not _is_own(left.lstat()):
        return
    lock = _open_folder(left)
    try:
        if not _lock(lock, fcntl.LOCK_NB):
            return  # its program is still at work
        name = _marked_target(left)
        if name is None:
            return
        target = left.with_name(name or left.name)
        if (
            os.path.lexists(left / "new")
            and os.path.lexists(left / "old")
            and not os.path.lexists(target)
        ):
            (left / "old").rename(target)
        _discard(left)
    finally:
        os.close(lock)


def _is_own(status: os.stat_result) -> bool:
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()


def _marked_target(folder: Path) -> str | None:
    """Name of the target that a temporary folder's mark states: "" where its program was killed
    before or after there was one, so that it holds nothing; None where it is not one of ours.
    """
    mark = folder / _MARK
    names = set(os.listdir(folder))  # noqa: PTH208
    if mark.is_symlink() or not names <= {_MARK, "new", "old"}:
        return None
    if not names or (names == {_MARK} and mark.lstat().st_size == 0):
        return ""
    with contextlib.suppress(ValueError, TypeError, KeyError, RecursionError):
        document = json.loads(read_bytes(mark, 1 << 16))
        name = document["target"]
        if document["format"] == _MARK_FORMAT and Path(name).name == name not in ("", ".."):
            return str(name)
    return None


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
        require(
            not os.path.ismount(target), f"'{target}' is a mounted disk; name a folder inside it."
        )
        names = _files(target)
    if not names:
        return
    require(overwrite, f"'{target}' exists and is not empty; remove it or name another folder.")
    own = manifest_of(target)
    for name in names:
        ours = name in own or (
            Path(name).name in _STRAY and stat.S_ISREG((target / name).lstat().st_mode)
        )
        require(
            ours,
            f"'{target}' holds '{name}', which splitknit did not write there; name another folder.",
        )


def _files(folder: Path) -> list[str]:
    """Names of everything in `folder` that is not a folder itself; a link to a folder counts."""
    paths = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in paths)


def manifest_of(folder: Path) -> frozenset[str]:
    """The files that splitknit wrote into a folder; empty if the folder is incomplete or its
    manifest is not a plain file."""
    manifest = folder / MANIFEST
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
        # 16 MB are 300,000 names
        document = {} if manifest.is_symlink() else json.loads(read_bytes(manifest, 16_000_000))
        if document["format"] == "splitknit-folder":
            return frozenset(map(str, document["files"]))
    return frozenset()


def _swap(new: Path, target: Path, overwrite: bool) -> None:
    """Put `new` in the place of `target`; if that fails, `target` is as before."""
    _check_replaceable(target, overwrite)  # it may have changed while we worked
    old = new.with_name("old")
    UNFINISHED.depth += 1
    try:
        if target.exists():
            target.rename(old)
        new.rename(target)
    except BaseException:
        if os.path.lexists(old) and not os.path.lexists(target):
            old.rename(target)
        raise
    finally:
        UNFINISHED.leave()
