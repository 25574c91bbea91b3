"""Opening and reading files that a user names: sizes are checked first, links are not followed."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar

from splitknit.errors import BadInput, require

AnyPath = str | os.PathLike[str]
"""A path as callers give it."""
T = TypeVar("T")
J = TypeVar("J")


@contextlib.contextmanager
def open_file(path: AnyPath, max_bytes: int) -> Iterator[tuple[io.BufferedReader[io.FileIO], int]]:
    """Open a regular file of at most `max_bytes`; yield the stream and the file's size. Raises
    BadInput if it is missing, no regular file (devices and pipes are not opened for reading), too
    large, or cannot be read, also in the block.
    """
    name = shown_path(path)
    try:
        # closes a folder, unlike fdopen
        with io.BufferedReader(io.FileIO(path, "rb", opener=open_at_once)) as stream:
            status = os.fstat(stream.fileno())
            require(stat.S_ISREG(status.st_mode), f"{name} is not a file.")
            require(
                status.st_size <= max_bytes,
                f"{name} is too large: {status.st_size} bytes, at most {max_bytes} are read.",
            )
            yield stream, status.st_size
    except FileNotFoundError as error:
        raise BadInput(f"{name} does not exist; add the file or correct the name.") from error
    except IsADirectoryError as error:
        raise BadInput(f"{name} is not a file.") from error
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        raise BadInput(
            f"{name} cannot be read: {getattr(error, 'strerror', None) or error}."
        ) from error


def open_at_once(path: AnyPath, flags: int, mode: int = 0o600) -> int:
    """Opener for files: through no link (:func:`given_folders`), and at once where a pipe has no
    writer."""
    refuse_links(path)
    return os.open(path, flags | os.O_NONBLOCK, mode)


_GIVEN: set[str] = set()


@contextlib.contextmanager
def given_folders(paths: Iterable[AnyPath]) -> Iterator[None]:
    """In the block, nothing inside these folders is read or written through a symbolic link: a
    folder may come from anyone. What the user named may be a link. Readers (:func:`open_file`) and
    writers (:mod:`splitknit.io.atomic`) ask :func:`refuse_links`, in worker processes too
    (:func:`with_given_folders`).
    """
    earlier = set(_GIVEN)
    for path in map(Path, paths):
        with contextlib.suppress(OSError, ValueError, RuntimeError):  # refused where it is used
            own = path.expanduser()
            _GIVEN.update(map(str, (path.absolute(), own.absolute(), own.resolve())))
    try:
        yield
    finally:
        _GIVEN.clear()
        _GIVEN.update(earlier)


def with_given_folders(work: Callable[[J], T]) -> Callable[[J], T]:
    """Return `work` for another process, where the same folders are given as here."""
    return functools.partial(_in_given_folders, tuple(_GIVEN), work)


def _in_given_folders(folders: tuple[str, ...], work: Callable[[J], T], job: J) -> T:
    with given_folders(folders):
        return work(job)


def refuse_links(path: AnyPath) -> None:
    """Refuse, by name, a link inside the nearest given folder above `path`. Raises BadInput."""
    whole = Path(path).absolute() if _GIVEN else None
    if whole is None or str(whole) in _GIVEN:
        return
    inside = [whole]
    for parent in whole.parents:
        if str(parent) in _GIVEN:
            link = next((part for part in reversed(inside) if part.is_symlink()), None)
            name = path if link == whole else link
            require(
                link is None,
                f"'{name}' is a link inside a folder, which is not followed; put the file or folder"
                " itself there.",
            )
            return
        inside.append(parent)


def read_bytes(path: AnyPath, max_bytes: int) -> bytes:
    """Read a whole regular file of at most `max_bytes`; every reader of a file goes through here.

    The size is checked before memory is taken, and again while reading, for a file that grows and
    for those of ``/proc``, which have no size. Raises BadInput as :func:`open_file`.

    >>> read_bytes("/dev/zero", 1000)
    Traceback (most recent call last):
    ...
    splitknit.errors.BadInput: /dev/zero is not a file.
    """
    with open_file(path, max_bytes) as (stream, size):
        data = stream.read(size + 1)
        while len(data) > size and len(data) <= max_bytes and (more := stream.read(1 << 16)):
            data += more
    require(
        len(data) <= max_bytes, f"{shown_path(path)} is too large: more than {max_bytes} bytes."
    )
    return data


def shown_path(path: AnyPath) -> str:
    """Return a path as messages give it, on one line."""
    text = os.fspath(path)
    return text if text.isprintable() else ascii(text)
