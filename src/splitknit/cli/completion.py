"""``splitknit completion``: the script with which a shell completes verbs, options, their values and paths."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, new_verb


def add_completion(verbs: Any, program: argparse.ArgumentParser) -> None:
    """Add the verb, which completes the words of `program`."""
    what = "print a script that completes verbs and options in your shell"
    verb = new_verb(verbs, "completion", what, partial(_run, program))
    verb.add_argument("shell", choices=("bash", "zsh", "fish", "powershell"), help="which shell reads it")


def _run(program: argparse.ArgumentParser, options: argparse.Namespace) -> Outcome:
    """Make a static script: to complete a word starts no Python."""
    import shtab  # type: ignore[import-untyped,unused-ignore]

    for action in _actions(program):
        if action.type is Path:
            folder = str(action.metavar) in ("DIR", "FOLDER")
            action.complete = shtab.DIRECTORY if folder else shtab.FILE  # type: ignore[attr-defined]
    script = shtab.complete(program, options.shell)
    return {"shell": options.shell, "script": script}, script.split("\n")


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """All arguments of a parser and of its verbs; argparse has no public way to them."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in dict.fromkeys(action.choices.values()):
                yield from _actions(below)
