"""Exit codes, and what must be at hand before anything else is imported."""

from __future__ import annotations

import os
import sys

DONE = 0
"""Exit code. Source: definition."""
INTERNAL_ERROR = 1
"""Exit code. Source: definition."""
BAD_INPUT = 2
"""Exit code. Source: definition."""
INTERRUPTED = 130
"""Exit code of a program ended by SIGINT. Source: 128 and the signal's number."""
_MATCHED = {"match": DONE, "no match": 10, "undecided": 11, "not acquired": 12}
ANSWERS = {
    **_MATCHED,
    "passed": DONE,
    "failed": 10,
}
"""How a verb with ``--exit-code`` ends, by the ``answer`` among its facts."""
INTERRUPTION = "splitknit: interrupted; nothing was left half-written."
INTERRUPTS: list[int] = []
"""Signals that have come."""


def say(text: str, code: int) -> int:
    """Write to stdout, and return the exit code: `code`, or that of bad input where stdout takes
    nothing."""
    try:
        print(text, end="", flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):  # `splitknit ... | head` is not an error
            print(
                f"splitknit: error: stdout cannot be written: {error.strerror}; what was to be"
                " written to files or changed in them is done.",
                file=sys.stderr,
            )
            return BAD_INPUT
    return code


def fail(message: str, code: int) -> int:
    """Write the one line of an error to stderr, and return the exit code."""
    # an interrupt in the import of a compiled module comes out of it as an ImportError
    if INTERRUPTS:
        message, code = INTERRUPTION, INTERRUPTED
    print(message, file=sys.stderr)
    return code
