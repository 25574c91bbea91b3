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

TYPE_CHECKING = False  # typing itself takes longer to import than all of the above
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from typing import Any, NoReturn

DONE, INTERNAL_ERROR, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_MATCHED = {"match": DONE, "no match": 10, "undecided": 11, "not acquired": 12}
ANSWERS = {**_MATCHED, "live": DONE, "attack": 10, "unknown": 11}
"""How a verb with ``--exit-code`` ends, by the ``answer`` among its facts."""
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
    from splitknit.registry import GONE

    typed = " ".join(words).replace("=", " ") + " "
    gone = next((name for name in GONE if _asks_for(name, typed)), "")
    if gone:
        print(f"splitknit: error: '{gone}' left the program: {GONE[gone]}", file=sys.stderr)
        return BAD_INPUT
    parser = build_parser(next((word for word in words if not word.startswith("-")), ""))
    try:
        options = parser.parse_args(arguments)
        if options.verb is None:
            parser.print_help(sys.stderr)
            return BAD_INPUT
    except SystemExit as stop:
        return _say("", int(stop.code or 0))
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


def _asks_for(name: str, typed: str) -> bool:
    """Whether the words typed begin with a verb that left, or have an option that left anywhere behind its verb."""
    verb, _, option = name.partition(" --")
    return typed.startswith(f"{verb} ") and (not option or f" --{option} " in typed)


def _on_interrupt(handler: Any) -> None:
    """Let Ctrl-C and SIGTERM call `handler`, except where the parent process ignores them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(number: int, _: object) -> None:
    errors = sys.modules.get("splitknit.errors")
    if errors is not None and hasattr(errors, "UNFINISHED") and errors.UNFINISHED.depth:
        errors.UNFINISHED.signal = number
        return
    _interrupts.append(number)
    raise KeyboardInterrupt


def _leave(*unused: object) -> NoReturn:
    """End at once: during import and exit, Python prints an exception's traceback, or drops the exception."""
    try:
        os.write(2, f"{_INTERRUPTED}\n".encode())
    finally:
        os._exit(INTERRUPTED)


def build_parser(verb: str | None = None) -> argparse.ArgumentParser:
    """Return the parser with the options of all verbs, or of `verb` alone, for which less is loaded."""
    from splitknit.cli.verb import Parser, add_group
    from splitknit.registry import GROUP, VERBS, objects_of, registered

    about = "Metric 3D fingerprints from photographs of a finger under one light after another."
    codes = "Exit code: 0 done, 2 the input cannot be used, 1 internal error. See also 'splitknit VERB --help'."
    parser = Parser(prog="splitknit", description=about, epilog=codes)
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    others = {} if verb in VERBS else dict.fromkeys(name.split(" ")[0] for name in registered(GROUP))
    for name in dict.fromkeys((*VERBS, *others)):
        words = VERBS.get(name, ("", ""))[1]
        if verb is None or verb == name:
            add_group(verbs, name, words, objects_of(name))
        elif verb not in VERBS:  # the list of verbs, for --help and typing errors
            verbs.add_parser(name, help=words)
    return parser


def _guarded(options: argparse.Namespace) -> int:
    """Run the verb; turn what goes wrong into one line and an exit code."""
    import json

    from splitknit.cli.verb import one_line, run_verb
    from splitknit.errors import BadInput, Refused, printable

    try:
        facts, lines = run_verb(options)
        code = ANSWERS.get(facts.get("answer", ""), DONE) if getattr(options, "exit_code", False) else DONE
        if facts or lines:  # `view` reports when it starts
            text = json.dumps(facts, indent=1, allow_nan=False) if options.json else "\n".join(map(printable, lines))
            code = _say(f"{text}\n", code)
    except BadInput as error:
        if options.json and isinstance(error, Refused):
            _say(json.dumps(error.facts, indent=1, allow_nan=False) + "\n", BAD_INPUT)
        message = f"splitknit: error: {one_line(error, getattr(options, 'option_of', {}))}"
        return _fail(options, message, BAD_INPUT)
    except PermissionError as error:
        message = f"splitknit: error: '{one_line(error.filename)}' cannot be reached: {error.strerror}."
        return _fail(options, message, BAD_INPUT)
    except KeyboardInterrupt:
        return _fail(options, _INTERRUPTED, INTERRUPTED)
    except MemoryError:
        message = "splitknit: error: not enough memory for this capture; use smaller images or more memory."
        return _fail(options, message, INTERNAL_ERROR)
    except Exception as error:
        advice = "internal error, please report it; --traceback shows where"
        message = f"splitknit: {type(error).__name__}: {one_line(error)} ({advice})"
        return _fail(options, message, INTERNAL_ERROR)
    return code


def _say(text: str, code: int) -> int:
    """Write to stdout, and return the exit code: `code`, or that of bad input where stdout takes nothing."""
    try:
        print(text, end="", flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):  # `splitknit ... | head` is not an error
            reason = "what was to be written to files or changed in them is done"
            print(f"splitknit: error: stdout cannot be written: {error.strerror}; {reason}.", file=sys.stderr)
            return BAD_INPUT
    return code


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
