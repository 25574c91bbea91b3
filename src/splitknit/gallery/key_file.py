"""The key of a gallery, from a file, a pipe or the environment; it never stands on the command line."""

from __future__ import annotations

import io
import os
import select
import stat
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from splitknit.errors import BadInput, open_at_once, require, shown_path

if TYPE_CHECKING:
    from splitknit.gallery.key import Key

KEY_VARIABLE, NEW_KEY_VARIABLE = "SPLITKNIT_GALLERY_KEY", "SPLITKNIT_GALLERY_NEW_KEY"
COUNTER = ".counter"
"""End of the name of the counter file that may lie beside a key file."""
_MAX_KEY_BYTES = 4096
_WRITER_S = 3.0
"""How long a pipe may be without a program that writes into it."""


def key_of(file: Path | None, variable: str = KEY_VARIABLE) -> Key | None:
    """Key from a file (with the counter file beside it), else from the environment; None where neither has one.

    Raises
    ------
    BadInput
        If the file cannot be read, is a pipe that nobody writes into, or what it holds is no key.
    """
    from splitknit.gallery.key import key_from_bytes  # noqa: PLC0415 - verbs import what they need

    if file is not None:
        content = _read_key(file)
        counter = file.with_name(file.name + COUNTER)
        return replace(key_from_bytes(content, f"the key file '{file}'"), counter=counter if counter.exists() else None)
    text = os.environ.get(variable)
    return None if text is None else key_from_bytes(os.fsencode(text), f"the variable {variable}")


def _read_key(file: Path) -> bytes:
    """Content of a file, or of a pipe such as the shell makes for ``--key-file <(...)``, up to a byte too many."""
    try:
        with io.FileIO(file, "rb", opener=open_at_once) as stream:
            mode = os.fstat(stream.fileno()).st_mode
            sound = stat.S_ISREG(mode) or stat.S_ISFIFO(mode)
            require(sound, f"the key file {shown_path(file)} is neither a file nor a pipe.")
            if stat.S_ISFIFO(mode):
                return _read_pipe(stream, file)
            return stream.read(_MAX_KEY_BYTES + 1)
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"the key file '{file}' cannot be read: {reason}.") from error


def _read_pipe(stream: io.FileIO, file: Path) -> bytes:
    """Read until all writers closed; a writer takes as long as it likes, as it may prompt for a password."""
    content, waited, written = b"", False, False
    events = select.poll()
    events.register(stream, select.POLLIN)
    while len(content) <= _MAX_KEY_BYTES:
        piece = stream.read(_MAX_KEY_BYTES + 1)
        if piece:
            content += piece
        elif piece is None:  # a writer is there and has written nothing yet
            events.poll()
        elif written:
            break
        else:
            require(not waited, f"the key file {shown_path(file)} is a pipe that no program writes into.")
            waited = not events.poll(1000 * _WRITER_S)
            written = not waited
            continue
        written = True
    return content


def key_notes(file: Path | None) -> list[str]:
    """What should be said of a key file."""
    if file is None or os.name != "posix" or file.stat().st_mode & 0o077 == 0:
        return []
    return [f"the key file '{file}' can be read by others on this computer (chmod 600 ends that)."]
