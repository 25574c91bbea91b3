"""Files below a folder, and nothing else: no way out by ``..``, absolute names or links."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from splitknit.errors import BadInput, require

_PIECE = 1 << 20


def open_below(root: Path, name: str) -> BinaryIO:
    """Open the plain file `name` (relative, parts apart by ``/``) below `root` for reading.

    Each part is opened from the one before it and none may be a symbolic link, so that what is checked is what is
    opened.

    Raises
    ------
    BadInput
        If the name leaves the folder, a part of it is a link, or it is not a plain file that can be read.
    """
    parts = name.split("/")
    plain = all(part not in ("", ".", "..") and not set(part) & set("\\\0:") for part in parts)
    require(plain, "the name leads out of the folder.")
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
    held: list[int] = []
    try:
        held.append(os.open(root, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0)))
        for part in parts:
            held.append(os.open(part, flags, dir_fd=held[-1]))
        require(stat.S_ISREG(os.fstat(held[-1]).st_mode), f"'{parts[-1]}' is not a plain file.")
        return os.fdopen(held.pop(), "rb")
    except OSError as error:
        raise BadInput(f"'{parts[-1]}' is not there, or it cannot be read.") from error
    finally:
        for handle in held:
            os.close(handle)


class Pieces:
    """The content of an open file, a piece at a time; whoever has it closes it."""

    def __init__(self, stream: BinaryIO) -> None:  # noqa: D107 - the class says it
        self._stream = stream
        self.size = os.fstat(stream.fileno()).st_size

    def __iter__(self) -> Iterator[bytes]:
        while piece := self._stream.read(_PIECE):
            yield piece

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def read_below(root: Path, name: str, most_bytes: int = 1 << 30) -> bytes:
    """Return the content of a file that :func:`open_below` opens."""
    with open_below(root, name) as stream:
        require(os.fstat(stream.fileno()).st_size <= most_bytes, f"'{name}' is too large.")
        return stream.read()
