"""The command line: ``splitknit VERB``.

Exit code 0: done; 2: the input cannot be used (one sentence on stderr gives the reason and the remedy); 1: an internal
error; 130: interrupted. Results go to files, facts to stdout, everything else to stderr.

The module imports next to nothing and the rest within :func:`main`, which can then end an interrupt at any time.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from importlib import import_module

TYPE_CHECKING = False  # typing itself takes longer to import than all of the above
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from typing import Any, NoReturn

DONE, INTERNAL_ERROR, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_INTERRUPTED = "splitknit: interrupted; nothing was left half-written."
_interrupts: list[int] = []


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code."""
    program = arguments is None
    if program:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # on most processors its threads round sums otherwise
        _on_interrupt(_leave)
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):  # None where it is closed
                stream.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else arguments
    alone = words and words[0] in _VERBS and words[0] != "completion"  # which needs to know all
    parser = build_parser(words[0] if alone else None)
    try:
        options = parser.parse_args(arguments)
        if options.verb is None:
            parser.print_help(sys.stderr)
            return BAD_INPUT
    except SystemExit as stop:
        return int(stop.code or 0)
    if not program:
        return _guarded(options)
    try:
        _on_interrupt(_interrupt)  # from here on there is something to clean up
        try:
            return _guarded(options)
        finally:
            _on_interrupt(_leave)
    except KeyboardInterrupt:  # a second one, while the first was reported
        _leave()


def _on_interrupt(handler: Any) -> None:
    """Let Ctrl-C and SIGTERM call `handler`, except where the parent process ignores them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(number: int, _: object) -> None:
    _interrupts.append(number)
    raise KeyboardInterrupt


def _leave(*unused: object) -> NoReturn:
    """End at once: during import and exit, Python prints an exception's traceback, or drops the exception."""
    try:
        os.write(2, f"{_INTERRUPTED}\n".encode())
    finally:
        os._exit(INTERRUPTED)


_VERBS = {
    "demo": "demo.add_demo",
    "simulate": "simulate.add_simulate",
    "import": "import_photos.add_import",
    "reconstruct": "reconstruct.add_reconstruct",
    "separate": "separate.add_separate",
    "train": "train.add_train",
    "capture": "capture.add_capture",
    "calibrate": "calibrate.add_calibrate",
    "rig": "rig.add_rig",
    "evaluate": "evaluate.add_evaluate",
    "compare": "compare.add_compare",
    "match": "match.add_match",
    "enroll": "enroll.add_enroll",
    "identify": "identify.add_identify",
    "gallery": "gallery.add_gallery_verbs",
    "forget": "forget.add_forget",
    "export": "export.add_export",
    "batch": "batch.add_batch",
    "view": "view.add_view",
    "print": "print.add_print",
    "pad": "pad.add_pad",
    "completion": "completion.add_completion",
}
"""Every verb, in the order of ``--help``, and the function that adds it."""


def build_parser(verb: str | None = None) -> argparse.ArgumentParser:
    """Return the parser with all verbs, or with `verb` alone, for which less is loaded."""
    from splitknit.cli.verb import Parser

    parser = Parser(
        prog="splitknit",
        description="Metric 3D fingerprints from photographs of a finger under one light after another.",
        epilog="Exit code: 0 done, 2 the input cannot be used, 1 internal error. See also 'splitknit VERB --help'.",
    )
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    for name in _VERBS if verb is None else (verb,):
        module, _, function = _VERBS[name].partition(".")
        add = getattr(import_module(f"splitknit.cli.{module}"), function)
        add(verbs, parser) if name == "completion" else add(verbs)
    return parser


def _guarded(options: argparse.Namespace) -> int:
    """Run the verb; turn what goes wrong into one line and an exit code."""
    import contextlib
    import json

    from splitknit.cli.verb import one_line, run_verb
    from splitknit.errors import BadInput, Refused, printable

    try:
        facts, lines = run_verb(options)
        if facts or lines:  # `view` reports when it starts
            _say(json.dumps(facts, indent=1, allow_nan=False) if options.json else "\n".join(map(printable, lines)))
    except BadInput as error:
        if options.json and isinstance(error, Refused):
            with contextlib.suppress(BrokenPipeError):
                _say(json.dumps(error.facts, indent=1, allow_nan=False))
        return _fail(options, f"splitknit: error: {one_line(error)}", BAD_INPUT)
    except KeyboardInterrupt:
        return _fail(options, _INTERRUPTED, INTERRUPTED)
    except BrokenPipeError:
        # the reader of stdout has gone (`splitknit ... | head`): the work is done, so this is no error
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except MemoryError:
        message = "splitknit: error: not enough memory for this capture; use smaller images or more memory."
        return _fail(options, message, INTERNAL_ERROR)
    except Exception as error:
        advice = "internal error, please report it; --traceback shows where"
        message = f"splitknit: {type(error).__name__}: {one_line(error)} ({advice})"
        return _fail(options, message, INTERNAL_ERROR)
    return DONE


def _say(text: str) -> None:
    print(text, flush=True)


def _fail(options: argparse.Namespace, message: str, code: int) -> int:
    if options.traceback:
        import traceback

        traceback.print_exc()
    if _interrupts:  # an interrupt in the import of a compiled module comes out of it as an ImportError
        message, code = _INTERRUPTED, INTERRUPTED
    print(message, file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
