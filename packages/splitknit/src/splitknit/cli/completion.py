"""``splitknit completion``: the script with which a shell completes verbs, options, their values and paths."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from splitknit.cli.verb import Outcome, Verb
from splitknit.verbs import Help, Job, Progress


@dataclass(frozen=True, slots=True)
class CompletionJob(Job):
    """Print a script that completes verbs and options in your shell."""

    shell: Annotated[Literal["bash", "zsh", "fish", "powershell"], Help("which shell reads it", positional=True)]

    def run(self, progress: Progress) -> str:
        """Make a static script: to complete a word starts no Python."""
        from splitknit.cli.main import build_parser
        from splitknit.errors import importing

        with importing("completion needs the package shtab: pip install 'splitknit[completion]' ({error})."):
            import shtab  # type: ignore[import-untyped,unused-ignore]

        program = build_parser()
        for action in _actions(program):
            if action.type is Path:
                folder = str(action.metavar) in ("DIR", "FOLDER")
                action.complete = shtab.DIRECTORY if folder else shtab.FILE  # type: ignore[attr-defined]
        return str(shtab.complete(program, self.shell))


def _show(script: str, job: CompletionJob) -> Outcome:
    return {"shell": job.shell, "script": script}, script.split("\n")


COMPLETION = Verb(CompletionJob, _show)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """All arguments of a parser and of its verbs; argparse has no public way to them."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in dict.fromkeys(action.choices.values()):
                yield from _actions(below)
