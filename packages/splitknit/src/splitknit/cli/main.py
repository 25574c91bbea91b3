"""The command line: ``splitknit VERB``.

Exit code 0: done; 2: the input cannot be used (one sentence on stderr gives the reason and the
remedy); 1: an internal error; 130: interrupted. Results go to files, facts to stdout, everything
else to stderr.

The module imports next to nothing and the rest within :func:`main`, which can then end an interrupt
at any time.
"""

from __future__ import annotations

import io
import os
import signal
import sys

from splitknit.cli.exits import BAD_INPUT, INTERRUPTED, INTERRUPTION, INTERRUPTS, fail
from splitknit.interrupts import UNFINISHED

TYPE_CHECKING = False  # typing itself takes longer to import than all of the above
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any, NoReturn


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code."""
    program = arguments is None
    if program:
        # on most processors its threads round sums otherwise
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):  # None where it is closed
                stream.reconfigure(errors="backslashreplace")
        _on_interrupt(_leave)
    words = sys.argv[1:] if arguments is None else list(arguments)
    from splitknit.registry import refusal

    reason = refusal(words)
    if reason:
        return fail(f"splitknit: error: {reason}", BAD_INPUT)
    if not program:
        return _run(words)
    try:
        _on_interrupt(_interrupt)  # from here on there is something to clean up
        sys.unraisablehook = _interrupt_again
        try:
            return _run(words)
        finally:
            _on_interrupt(_leave)
    except KeyboardInterrupt:  # a second one, while the first was reported
        _leave()


def _run(words: Sequence[str]) -> int:
    try:
        from splitknit.cli.app import run

        return run(words)
    except (KeyboardInterrupt, ImportError):
        if not INTERRUPTS and not isinstance(sys.exception(), KeyboardInterrupt):
            raise
        return fail(INTERRUPTION, INTERRUPTED)


def _on_interrupt(handler: Any) -> None:
    """Let Ctrl-C and SIGTERM call `handler`, except where the parent process ignores them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(number: int, _: object) -> None:
    if UNFINISHED.depth:
        UNFINISHED.signal = number
        return
    INTERRUPTS.append(number)
    raise KeyboardInterrupt


def _interrupt_again(unraisable: sys.UnraisableHookArgs) -> None:
    """An interrupt within a finalizer or a weak reference's callback, which Python would print and
    forget, comes once more when that has ended."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
        return
    import _thread
    import threading

    timer = threading.Timer(0.01, _thread.interrupt_main, [INTERRUPTS[-1]])
    timer.daemon = True
    timer.start()


def _leave(*unused: object) -> NoReturn:
    """End at once: during import and exit, Python prints an exception's traceback, or drops the
    exception."""
    try:
        os.write(2, f"{INTERRUPTION}\n".encode())
    finally:
        os._exit(INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
