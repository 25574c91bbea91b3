"""The key of an encrypted gallery: from a file, a pipe or the environment, never from the command line."""

from __future__ import annotations

import io
import os
import re
import select
import stat
import unicodedata
from dataclasses import dataclass
from pathlib import Path

from splitknit import BadInput
from splitknit.errors import open_at_once, require, shown_path
from splitknit.verbs import AnyPath

KEY_VARIABLE = "SPLITKNIT_GALLERY_KEY"
_MAX_KEY_BYTES = 4096
_WRITER_S = 3.0
"""How long a pipe may be without a program that writes into it."""


@dataclass(frozen=True, slots=True, repr=False)
class Key:
    """64 hexadecimal digits, or a passphrase. Is never shown."""

    text: str

    @property
    def pragma(self) -> str:
        """SQLCipher's statement that opens a gallery; a passphrase is stretched (PBKDF2, 256,000 rounds of SHA-512)."""
        if re.fullmatch("[0-9A-Fa-f]{64}", self.text):
            return f"PRAGMA key = \"x'{self.text}'\""
        quoted = self.text.replace("'", "''")
        return f"PRAGMA key = '{quoted}'"


def key_of(file: Key | AnyPath | None) -> Key | None:
    """Key from a file or a pipe, else from the environment; None where neither has one.

    Raises BadInput if the file cannot be read, is a pipe that nobody writes into, or what it holds is not a key.
    """
    if isinstance(file, Key):
        return file
    if file is not None:
        content, where = _read(Path(file)), f"the key file '{file}'"
    elif KEY_VARIABLE in os.environ:
        content, where = os.fsencode(os.environ[KEY_VARIABLE]), f"the variable {KEY_VARIABLE}"
    else:
        return None
    text = unicodedata.normalize("NFC", content.decode("utf-8", "replace").rstrip("\r\n"))
    sound = len(content) <= _MAX_KEY_BYTES and text.isprintable() and "\ufffd" not in text and len(text) >= 8
    require(
        sound,
        f"{where} holds no key: a passphrase of 8 characters or more, or 64 hexadecimal digits, are expected.",
    )
    return Key(text)


def _read(file: Path) -> bytes:
    """Content of a file, or of a pipe such as the shell makes for ``<(...)``, up to a byte too many."""
    try:
        with io.FileIO(file, "rb", opener=open_at_once) as stream:
            mode = os.fstat(stream.fileno()).st_mode
            sound = stat.S_ISREG(mode) or stat.S_ISFIFO(mode)
            require(sound, f"the key file {shown_path(file)} is neither a file nor a pipe.")
            content = stream.read(_MAX_KEY_BYTES + 1)
            if stat.S_ISREG(mode):
                return content or b""
            if content == b"":  # no program has it open to write yet
                select.select([stream], [], [], _WRITER_S)
                content = stream.read(_MAX_KEY_BYTES + 1)
                require(content != b"", f"the key file {shown_path(file)} is a pipe that no program writes into.")
            os.set_blocking(stream.fileno(), True)  # a writer takes as long as it likes: it may ask for a password
            content = content or b""
            while len(content) <= _MAX_KEY_BYTES and (piece := stream.read(_MAX_KEY_BYTES + 1)):
                content += piece
            return content
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"the key file '{file}' cannot be read: {reason}.") from error
