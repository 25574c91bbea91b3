"""What all verbs share on a terminal: lines that move no cursor, notes, and the progress bar."""

from __future__ import annotations

import logging
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from splitknit.errors import printable
from splitknit.registry import MEMBERS


def one_line(error: object, options: Mapping[str, str]) -> str:
    """Return an error's text on one line that moves no cursor: what it quotes may hold any
    character.

    Arguments of Python functions, which stand between backticks, become the options of the verb
    that ran.

    >>> one_line("give `px_per_mm` 20, or `ridge_period_mm`.", {"px_per_mm": "--px-per-mm"})
    'give --px-per-mm 20, or ridge_period_mm.'
    """
    return printable(" ".join(with_options(str(error), options).split()) or "no further words")


def with_options(text: str, options: Mapping[str, str]) -> str:
    """Return `text` with the options of the arguments that stand between backticks; other names
    stay as words."""
    return re.sub("`([a-z_0-9]+)`", lambda name: options.get(name[1], name[1]), text)


@contextmanager
def warnings_shown(options: Mapping[str, str]) -> Iterator[None]:
    """In the block, what the library logs as a warning is printed to stderr as a note."""

    def emit(record: logging.LogRecord) -> None:
        print(f"splitknit: note: {one_line(record.getMessage(), options)}", file=sys.stderr)

    handler = logging.Handler(logging.WARNING)
    handler.emit = emit  # type: ignore[method-assign]
    loggers = [logging.getLogger(member.replace("-", "_")) for member in MEMBERS]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Yield what reports a stage and the fraction (0 to 1) of everything that is done, as a bar on
    stderr; the bar goes with the block.
    """
    began = time.monotonic()
    drawn = ""

    def draw(stage: str, fraction: float) -> None:
        nonlocal drawn
        done = min(1.0, fraction)
        width = max(4, min(80, shutil.get_terminal_size().columns - 45))
        minutes, seconds = divmod(int(time.monotonic() - began), 60)
        bar = "#" * round(width * done)
        line = (
            f"{printable(stage):24.24s} |{bar:{width}s}| {100.0 * done:3.0f} %"
            f" {minutes:02d}:{seconds:02d}"
        )
        if line != drawn:
            drawn = line
            print(f"\r{line}\x1b[K", end="", file=sys.stderr, flush=True)

    try:
        yield draw
    finally:
        if drawn:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
