"""One run at a time writes a store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splitknit.check import BadInput

_FILE = ".lock"


@contextmanager
def alone(store: Path) -> Iterator[None]:
    """Hold the store for this run; a killed run lets go.

    Raises
    ------
    BadInput
        If another run holds it, or the folder cannot be written.
    """
    import fcntl  # noqa: PLC0415 - not on every system

    try:
        stream = (store / _FILE).open("ab")
    except OSError as error:
        raise BadInput(f"cannot write into '{store}': {error.strerror or error}; choose another place.") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise BadInput(f"another run is writing into '{store}'; wait for it, or stop it.") from error
        yield
