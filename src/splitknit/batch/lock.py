"""One run at a time writes a store."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splitknit.errors import BadInput
from splitknit.io.atomic import private_modes

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
        stream = os.fdopen(os.open(store / _FILE, os.O_CREAT | os.O_WRONLY, private_modes()[0]), "wb")
    except OSError as error:
        raise BadInput(f"cannot write into '{store}': {error.strerror or error}; choose another place.") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise BadInput(f"another run is writing into '{store}'; wait for it, or stop it.") from error
        yield
