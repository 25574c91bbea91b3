"""``splitknit completion``: the script with which a shell completes verbs, options, their values and paths."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, new_verb


def add_completion(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "completion", "print a script that completes verbs and options in your shell", _run)
    verb.add_argument("shell", choices=("bash", "zsh", "fish", "powershell"), help="which shell reads it")


def _run(options: argparse.Namespace) -> Outcome:
    """Make a static script: to complete a word starts no Python."""
    import shtab  # type: ignore[import-untyped,unused-ignore]  # noqa: PLC0415

    from splitknit.cli.main import build_parser  # noqa: PLC0415

    parser = build_parser()
    for action in _actions(parser):
        if action.type is Path:
            folder = str(action.metavar) in ("DIR", "FOLDER")
            action.complete = shtab.DIRECTORY if folder else shtab.FILE  # type: ignore[attr-defined]
    script = shtab.complete(parser, options.shell)
    return {"shell": options.shell, "script": script}, [script]


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """All arguments of a parser and of its verbs; argparse has no public way to them."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in dict.fromkeys(action.choices.values()):
                yield from _actions(below)
