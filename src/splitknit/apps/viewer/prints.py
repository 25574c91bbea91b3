"""A result's print."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from splitknit.apps.viewer.paths import open_below
from splitknit.io.prints import PrintFile, read_print_png


@lru_cache(maxsize=8)
def print_of(folder: Path) -> PrintFile:
    """Read a result's ``print.png``.

    Raises
    ------
    BadInput
        If there is none, it is a link, or it cannot be read.
    """
    open_below(folder, "print.png").close()
    return read_print_png(folder / "print.png")
