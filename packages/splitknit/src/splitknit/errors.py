"""Input checks with one message style: what was expected, what came, what to do about it.

Every check raises :class:`BadInput`, a ``ValueError`` whose text is one sentence that a user can
act on. The command line prints it and exits with code 2. An argument stands between backticks in it
(```px_per_mm```), of which the command line makes its option.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

T = TypeVar("T")


class BadInput(ValueError):  # noqa: N818 - states a fault of the input, not of the program
    """The input cannot be used; the message names the part, and the remedy.

    A message quotes what files hold: characters that end a line or cannot be printed become escapes
    in it, and what is longer than 2000 characters is cut.
    """

    def __init__(self, message: str = "") -> None:
        """Take over the message."""
        super().__init__(printable(message if len(message) <= 2000 else f"{message[:2000]} ..."))


def printable(text: str) -> str:
    """Return `text` on one line that moves no cursor: what cannot be printed, and what turns the
    direction of writing, become escapes.

    Every line that a person reads goes through here: names of files, and what files hold, may be
    any characters.

    >>> print(printable(chr(27) + "[2J" + chr(0x202E) + "gnp.exe"))
    \\x1b[2J\\u202egnp.exe
    """
    return (
        text
        if text.isprintable()
        else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    )


class Refused(BadInput):
    """The input was understood and is not good enough; `facts` hold what was found all the same."""

    def __init__(self, message: str, facts: dict[str, Any]) -> None:
        """Take over the message and the facts."""
        super().__init__(message)
        self.facts = facts


class BadExposure(BadInput):
    """A sound image is black, blank or overexposed."""


def require(condition: Any, message: str, kind: type[BadInput] = BadInput) -> None:
    """Raise :class:`BadInput`, or a `kind` of it, with `message` unless `condition` holds."""
    if not condition:
        raise kind(message)


@contextlib.contextmanager
def importing(message: str) -> Iterator[None]:
    """Turn a failure to import a package that not every installation has into BadInput, with
    Python's reason. `message` says how to get it.
    """
    try:
        yield
    except (ImportError, OSError) as error:
        raise BadInput(f"{message.rstrip('.')} ({error}).") from error


def naming(path: object, work: Callable[[], T]) -> T:
    """Let what stages refuse, which know arrays only, name the file."""
    try:
        return work()
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


@contextlib.contextmanager
def refusing(message: str) -> Iterator[None]:
    """Turn whatever a parser raises in the block into :class:`BadInput` with `message`, one
    sentence.

    A :class:`BadInput` passes as it is, and so does a :class:`MemoryError`: it is not a fault of
    the input.

    >>> with refusing("the table is damaged; write it again."):
    ...     {}["rows"]
    Traceback (most recent call last):
    ...
    splitknit.errors.BadInput: the table is damaged; write it again.
    """
    try:
        yield
    except (BadInput, MemoryError):
        raise
    except Exception as error:  # parsers raise whatever they meet
        raise BadInput(message) from error
