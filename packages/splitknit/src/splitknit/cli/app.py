"""The verbs as one app: cyclopts makes options of each function's signature, and what it returns is
printed here.

A result is printed as its ``str``, or with ``--json`` as the document of its ``facts`` if it has
any, else of its fields.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import shutil
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from inspect import BoundArguments
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter
from cyclopts.help import DefaultFormatter, HelpPanel, PanelSpec
from rich.box import HORIZONTALS
from rich.console import Console
from rich.text import Text

from splitknit.cli.console import one_line, progress_bar, warnings_shown, with_options
from splitknit.cli.exits import ANSWERS, BAD_INPUT, DONE, INTERNAL_ERROR, fail, say
from splitknit.errors import BadInput, Refused
from splitknit.files import given_folders
from splitknit.io.atomic import GROUP_READABLE
from splitknit.registry import VERBS, objects_of, verbs_known

_ABOUT = "Metric 3D fingerprints from photographs of a finger under one light after another."
_ENDING = (
    "Of every verb: --json prints one JSON object on stdout and nothing else; --traceback shows"
    " where an error came from; --group-readable lets your group read what is written (0640, 0750),"
    " where by default only you can (0600, 0700); --exit-code answers by the exit code: 0 a match,"
    " 10 no match, 11 undecided, 12 not acquired.\n\nExit code: 0"
    " done, 2 the input cannot be used, 1 internal error. See also 'splitknit VERB --help'."
)
_FLAG = Parameter(show=False)
_HELP = {"--help", "-h"}


@dataclasses.dataclass(frozen=True, slots=True)
class How:
    """What every verb can be told."""

    json: Annotated[bool, _FLAG] = False
    traceback: Annotated[bool, _FLAG] = False
    group_readable: Annotated[bool, _FLAG] = False
    exit_code: Annotated[bool, _FLAG] = False


def build_app(verb: str | None = None) -> App:
    """Return the app with all verbs, or with the functions of `verb` alone, for which less is
    loaded."""
    app = App(
        name="splitknit",
        help=_ABOUT,
        help_epilogue=_ENDING,
        help_format="plaintext",
        help_formatter=_Panels(panel_spec=PanelSpec(box=HORIZONTALS)),
        version=_version,
        default_parameter=Parameter(negative="", allow_repeating=True),  # the last one counts
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
    )
    for name in verbs_known():
        words = VERBS[name][1] if name in VERBS else None
        functions = objects_of(name) if verb in (None, name) else {}
        if "" in functions:
            app.command(functions[""], name=name)
            continue
        group = App(name=name, help=words)
        for last, function in functions.items():
            group.command(function, name=last)
        app.command(group)
    return app


class _Panels(DefaultFormatter):
    """Tables of options whose descriptions are filled anew, as docstrings break lines where they
    end; that a flag is off, or a list empty, by default goes without saying."""

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        for entry in panel.entries:
            text = getattr(entry.description, "primary_renderable", None)
            if isinstance(text, Text):
                text.plain = " ".join(text.plain.split())
        unstated = {"False", "()"}
        entries = [
            entry.copy(default=None) if entry.default in unstated else entry
            for entry in panel.entries
        ]
        super().__call__(console, options, panel.copy(entries=entries))


def words_of_verbs(app: App) -> list[list[str]]:
    """The words of all verbs, groups before what is in them."""
    words: list[list[str]] = []
    for name in verbs_known():
        words.append([name])
        words += [[name, last] for last in app[name] if not last.startswith("-")]
    return words


def run(words: Sequence[str]) -> int:
    """Run the verb that the words name, and return the exit code."""
    if "--version" in words:
        return say(f"{_version()}\n", DONE)
    app = build_app(next((word for word in words if not word.startswith("-")), ""))
    code = DONE

    @app.meta.default
    def splitknit(
        *rest: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
        how: Annotated[How, Parameter("*")] = How(),
    ) -> None:
        nonlocal code
        code = _guarded(app, rest, how)

    app.meta.suppress_keyboard_interrupt = False
    if not words or _HELP & set(words):
        return _help(app, words)
    try:
        app.meta(list(words))
    except CycloptsError as error:
        return fail(f"splitknit: error: {one_line(error, {})}", BAD_INPUT)
    return code


def _version() -> str:
    from importlib import metadata

    return f"splitknit {metadata.version('splitknit')}"


def _help(app: App, words: Sequence[str]) -> int:
    """Print the help that was asked for; on stderr, as bad input, where a verb was to be named."""
    text = help_of(app, [word for word in words if word not in _HELP])
    if _HELP & set(words):
        return say(text, DONE)
    print(text, end="", file=sys.stderr)
    return BAD_INPUT


def help_of(app: App, words: Sequence[str]) -> str:
    """The help of a verb; names between backticks in its docstring become options."""
    _, apps, _ = app.parse_commands(list(words))
    if words:
        for name in apps[-1]:
            apps[-1][name]  # is imported, so that it is described among the others
    width = shutil.get_terminal_size().columns
    console = Console(file=io.StringIO(), width=width, force_terminal=False, color_system=None)
    app.meta.help_print(list(words), console=console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    return with_options(text, options_of(app, words))


def options_of(app: App, words: Sequence[str]) -> dict[str, str]:
    """The options of the verb that `words` begin with, by the names of its function's arguments."""
    _, apps, _ = app.parse_commands(list(words))
    if apps[-1].default_command is None:
        return {}
    options = {}
    for argument in apps[-1].assemble_argument_collection():
        field = argument.field_info
        names = argument.negatives if field.default is True else argument.names
        options[field.name] = names[0] if names else field.name.upper()
    return options


def _guarded(app: App, words: Sequence[str], how: How) -> int:
    """Run the verb; turn what goes wrong into one line and an exit code."""
    options: Mapping[str, str] = {}
    try:
        options = options_of(app, words)
        command, bound, _ = app.parse_args(list(words))
        if command.__name__ == "help_print":  # a group of verbs, without one
            return _help(app, words)
        return _report(_called(command, bound, how, options), how, options)
    except Exception as error:
        if how.json and isinstance(error, Refused):
            say(json.dumps(error.facts, indent=1, allow_nan=False) + "\n", BAD_INPUT)
        if how.traceback:
            traceback.print_exception(error)
        message, code = _reported(error, options)
        return fail(f"splitknit: {message}", code)


def _reported(error: Exception, options: Mapping[str, str]) -> tuple[str, int]:
    """An error as one line, and its exit code."""
    line = one_line(error, options)
    if isinstance(error, CycloptsError | BadInput):
        return f"error: {line}", BAD_INPUT
    if isinstance(error, PermissionError):
        return (
            f"error: '{one_line(error.filename, {})}' cannot be reached: {error.strerror}.",
            BAD_INPUT,
        )
    if isinstance(error, MemoryError):
        return (
            "error: not enough memory for this capture; use smaller images or more memory.",
            INTERNAL_ERROR,
        )
    advice = "internal error, please report it; --traceback shows where"
    return f"{type(error).__name__}: {line} ({advice})", INTERNAL_ERROR


def _called(command: Any, bound: BoundArguments, how: How, options: Mapping[str, str]) -> Any:
    """What the verb's function returns."""
    settings = bound.arguments.get("settings")
    if settings is not None:
        from splitknit.cli.options import read_changes  # not for help

        bound.arguments["settings"] = read_changes(settings)
    with ExitStack() as stack:
        stack.enter_context(given_folders(_paths_in(bound.arguments.values())))
        stack.enter_context(_permissions(how.group_readable))
        stack.enter_context(warnings_shown(options))
        if "progress" in bound.signature.parameters and not how.json and sys.stderr.isatty():
            bound.arguments["progress"] = stack.enter_context(progress_bar())
        return command(*bound.args, **bound.kwargs)


def _paths_in(values: Iterable[Any]) -> Iterator[Path]:
    for value in values:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, list | tuple):
            yield from _paths_in(value)
        elif dataclasses.is_dataclass(value):
            yield from _paths_in(getattr(value, field.name) for field in dataclasses.fields(value))


@contextmanager
def _permissions(group_readable: bool) -> Iterator[None]:
    """The permissions for new files that were asked for, of worker processes too."""
    earlier = os.environ.get(GROUP_READABLE, "")
    os.environ[GROUP_READABLE] = "1" if group_readable else earlier
    try:
        yield
    finally:
        os.environ[GROUP_READABLE] = earlier


def _report(result: Any, how: How, options: Mapping[str, str]) -> int:
    """Print a result for people, or for programs, and return the exit code."""
    from splitknit.io.provenance import known_json  # not for help

    if result is None:
        return DONE
    facts: Any = known_json(getattr(result, "facts", result)) if how.json or how.exit_code else {}
    code = ANSWERS.get(facts.get("answer", ""), DONE) if how.exit_code else DONE
    text = json.dumps(facts, indent=1, allow_nan=False) if how.json else str(result)
    return say(f"{with_options(text, options)}\n", code)
