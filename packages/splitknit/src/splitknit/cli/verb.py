"""Options out of the fields of a job (:mod:`splitknit.verbs`), and what all verbs share: messages, the progress bar."""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import MISSING, dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn, get_args, get_origin

from splitknit.verbs import SETTINGS, Field, fields_of, with_default

NO_NAMES: Mapping[str, str] = MappingProxyType({})
Outcome = tuple[dict[str, Any], list[str]]
"""Facts for ``--json``, and the same in lines for people."""


class Parser(argparse.ArgumentParser):
    """A parser, and those of its verbs: ``--version``, and errors of one line that suggest what a typo stands for."""

    def __init__(self, *given: Any, **named: Any) -> None:  # noqa: D107 - as its parent's
        super().__init__(*given, **named)
        self._words: list[str] = []
        self._negative_number_matcher = re.compile(r"-\.?\d")  # a place begins with one: -3,0.5
        self.refusal = ""
        """Why this verb cannot be used."""
        self.add_argument("--version", action=_Version, help="print the program's version and exit")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse the words after a verb; an unknown one is refused here, where the verb's options are known."""
        if self.refusal:
            self.exit(2, f"splitknit: error: {self.refusal}\n")
        self._words = sys.argv[1:] if args is None else list(args)
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        options = list(self._option_string_actions)
        typos = [word.partition("=")[0] for word in self._words if word.startswith("--") and len(word) > 2]
        for word in typos:
            if not any(option.startswith(word) for option in options):
                message += _suggestion(word, options)
                break
        self.exit(2, f"{self.prog}: error: {one_line(message)}\nSee '{self.prog} --help'.\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message = str(error.message) + _suggestion(str(value), map(str, action.choices or ()))
            raise


class _Version(argparse.Action):
    """Print the version, which is looked up only then."""

    def __init__(self, **named: Any) -> None:
        super().__init__(nargs=0, **(named | {"dest": argparse.SUPPRESS, "default": argparse.SUPPRESS}))

    def __call__(self, parser: argparse.ArgumentParser, *unused: Any) -> None:
        from splitknit import __version__

        parser._print_message(f"splitknit {__version__}\n", sys.stdout)  # as argparse prints its help
        parser.exit()


def _suggestion(word: str, choices: Iterable[str]) -> str:
    from difflib import get_close_matches  # only errors need it

    close = get_close_matches(word, choices, 1)
    return f"; did you mean '{close[0]}' instead of '{word}'?" if close else ""


def one_line(error: object, names: Mapping[str, str] = NO_NAMES) -> str:
    """Return an error's text on one line that moves no cursor: what it quotes may hold any character.

    Arguments of Python functions, which stand between backticks, become the options of the verb that ran.

    >>> one_line("give `px_per_mm` 20, or `max_megapixels`.", {"max_megapixels": "--max-size"})
    'give px_per_mm 20, or --max-size.'
    """
    from splitknit.errors import printable  # `--help` needs none of it

    return printable(" ".join(with_options(str(error), names).split()) or "no further words")


def with_options(text: str, names: Mapping[str, str]) -> str:
    """Return `text` with the options of the fields that stand between backticks; other names stay as words."""
    return re.sub("`([a-z_0-9]+)`", lambda name: names.get(name[1], name[1]), text) if "`" in text else text


def _told(facts: Any, names: Mapping[str, str]) -> Any:
    """Facts with the options that their sentences name."""
    if isinstance(facts, Mapping):
        return {key: _told(value, names) for key, value in facts.items()}
    if isinstance(facts, list | tuple):
        return [_told(one, names) for one in facts]
    return with_options(facts, names) if isinstance(facts, str) else facts


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb of the command line: the job that does its work, and how its result is presented."""

    job: type[Any]
    """A dataclass of :mod:`splitknit.verbs`; the first sentence of its docstring is the verb's help."""
    show: Callable[..., Outcome] = lambda outcome, *_: outcome
    """Is called with the job's result and the job, and with `also` where there is one; by default the result is what
    is shown already."""
    also: type[Any] | None = None
    """A dataclass of further options, which change the presentation alone."""


def add_verb(verbs: Any, name: str, verb: Verb) -> None:
    """Add a verb: `name` is its last word."""
    names = options_of(verb)
    words = " ".join((verb.job.__doc__ or "").partition("\n\n")[0].split()).removesuffix(".")
    does = with_options(words[0].lower() + words[1:] if words[1:2].islower() else words, names)  # one line of help
    parser = verbs.add_parser(name, help=does, description=does[0].upper() + does[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else")
    parser.add_argument("--traceback", action="store_true", help="show where an error came from")
    private = "let your group read what is written (0640, 0750); by default only you can (0600, 0700)"
    parser.add_argument("--group-readable", action="store_true", help=private)
    places: dict[str, Any] = {}
    for part in (verb.job, verb.also):
        if part is not None:
            _add_fields(parser, parser, part, places, names)
    secrets = [field.name for field in every_field(verb) if field.help and field.help.secret]
    parser.set_defaults(run=partial(_run, verb), option_of=names, secrets=secrets)


def add_group(verbs: Any, name: str, words: str, objects: Mapping[str, str]) -> None:
    """Add what is registered as a verb, or as the verbs that follow it; or what says that nothing is."""
    from splitknit.registry import VERBS, load, not_installed

    if not objects:
        missing = verbs.add_parser(name, help=words)
        missing.refusal = not_installed(f"'splitknit {name}'", VERBS[name][0])
        return
    if "" not in objects:
        group = verbs.add_parser(name, help=words, description=words[:1].upper() + words[1:] + "." if words else None)
        verbs = group.add_subparsers(dest="kind", metavar="WHAT", title="what", required=True)
    for last, value in objects.items():
        add_verb(verbs, last or name, load(value))


def options_of(verb: Verb) -> dict[str, str]:
    """The options of a verb by the names of its fields, as messages give them; positional ones by their metavar."""
    fields = list(every_field(verb))
    given = {field.help.option for field in fields if field.help is not None and field.help.option}
    renamed = {option.strip("-").replace("-", "_"): option for option in given}
    return renamed | {field.name: _option(field) for field in fields}


def every_field(verb: Verb) -> Iterator[Field]:
    """The fields of a verb that are options, and those of its groups."""
    todo = [field for part in (verb.job, verb.also) if part is not None for field in fields_of(part)]
    while todo:
        field = todo.pop(0)
        if field.is_group:
            todo += fields_of(field.kind)
        elif field.is_option:
            yield field


def _option(field: Field) -> str:
    """How a field is written on the command line: its option, or a word for its place."""
    assert field.help is not None
    if field.help.positional:
        return field.help.metavar or field.name.upper()
    if field.help is SETTINGS:
        return "--set"
    negative = "no-" if field.default is True else ""
    return field.help.option or f"--{negative}{field.name.replace('_', '-')}"


def _add_fields(
    parser: argparse.ArgumentParser, place: Any, part: Any, places: dict[str, Any], names: Mapping[str, str]
) -> None:
    def below(title: str, about: str) -> Any:
        if title not in places:
            places[title] = parser.add_argument_group(title, with_options(about, names) or None)
        return places[title]

    for field in fields_of(part):
        if not field.is_option:
            continue
        assert field.help is not None
        if field.is_group:
            _add_fields(parser, below(field.help.text, field.help.about), field.kind, places, names)
            continue
        here = below(field.help.group, field.help.about) if field.help.group else place
        if field.help.either:
            key = f"either {field.help.either}"
            if key not in places:
                places[key] = here.add_mutually_exclusive_group(required=field.help.required)
            here = places[key]
        if field.help is SETTINGS:
            _add_settings(here)
        else:
            _add_option(here, field, names)


def _add_option(place: Any, field: Field, names: Mapping[str, str]) -> None:
    """Add one field as a positional argument, a switch or an option with its value."""
    words = field.help
    assert words is not None
    given: dict[str, Any] = {"help": with_options(with_default(field), names).replace("%", "%%")}
    needed = field.default is MISSING
    if field.kind is bool:
        given["action"] = f"store_{str(not field.default).lower()}"
        place.add_argument(_option(field), *words.also, dest=field.name, **given)
        return
    given["default"] = None if needed or field.many else field.default
    given["type"] = _reader(field)
    if field.choices:
        given["choices"] = field.choices
    if words.metavar or not field.choices:
        given["metavar"] = words.metavar or None
    pair = get_origin(field.kind) is tuple and words.read is None
    if pair:
        given |= {"nargs": len(get_args(field.kind)), "type": get_args(field.kind)[0]}
    if words.positional:
        usual = ("+" if needed else "*") if field.many else (None if needed else "?")
        given["nargs"] = words.nargs or usual
        place.add_argument(field.name, **given)
        return
    if words.alone:
        given |= {"nargs": "?", "const": words.alone}
    if field.many:
        given |= {"nargs": words.nargs, "action": "extend"} if words.nargs else {"action": "append"}
    place.add_argument(_option(field), *words.also, dest=field.name, required=needed and not words.either, **given)


def _reader(field: Field) -> Callable[[str], Any] | None:
    """What argparse calls with a word; where the field has a range, its message states it."""
    read, rule = field.read, field.limits
    if read is None and rule is None:
        return field.kind if field.kind is not str else None
    kind, noun = field.kind, "a whole number" if field.kind is int else "a number"
    if rule is not None:
        span = "from 0 to 2^63 - 1" if rule.max == 2**63 - 1 else str(rule)
        noun = "a positive number" if span == "positive" else f"{noun} {span}"

    def checked(text: str) -> Any:
        try:
            if read is not None:
                return read(text)
            sound = kind is not int or (text.isascii() and text.removeprefix("-").isdigit())
            value = kind(text) if sound else math.nan
        except ValueError as error:
            if read is not None:
                raise argparse.ArgumentTypeError(str(error)) from error
            value = math.nan
        if rule is not None and not rule.hold(value):
            raise argparse.ArgumentTypeError(f"'{text}' must be {noun}")
        return value

    return checked


def job_of(part: Any, options: argparse.Namespace) -> Any:
    """Make a dataclass of what was parsed. Raises BadInput as it does."""
    given: dict[str, Any] = {}
    for field in fields_of(part):
        if field.is_group:
            given[field.name] = job_of(field.kind, options)
        elif field.help is SETTINGS:
            from splitknit.cli.options import read_changes  # most runs change nothing

            some = options.settings is not None or options.assignments
            given[field.name] = read_changes(options.settings, options.assignments) if some else None
        elif field.is_option:
            value = getattr(options, field.name)
            if value is not None or field.default is MISSING:
                given[field.name] = tuple(value) if isinstance(value, list) else value
    return part(**given)


def _run(verb: Verb, options: argparse.Namespace) -> Outcome:
    names = options.option_of
    parts = [job_of(part, options) for part in (verb.job, verb.also) if part is not None]
    with _Warnings(names), _ProgressBar(options) as progress:
        result = parts[0].run(progress.update)
    facts, lines = verb.show(result, *parts)
    return facts, lines


class _Warnings:
    """While it is entered, what the library logs as a warning is printed to stderr as a note."""

    def __init__(self, names: Mapping[str, str]) -> None:
        import logging  # `--help` needs none of it

        self._handler = logging.Handler(logging.WARNING)
        self._handler.emit = lambda record: print(  # type: ignore[method-assign]
            f"splitknit: note: {one_line(record.getMessage(), names)}", file=sys.stderr
        )
        self._logger = logging.getLogger("splitknit")

    def __enter__(self) -> None:
        self._logger.addHandler(self._handler)

    def __exit__(self, *unused: object) -> None:
        self._logger.removeHandler(self._handler)


def _notes_on_secrets(options: argparse.Namespace) -> list[str]:
    """A warning of each secret file that others can read."""
    modes = os.environ.get("SPLITKNIT_GROUP_READABLE") == "1" or options.group_readable
    files = {getattr(options, name): "gallery" if name == "gallery" else "key file" for name in options.secrets}
    return [
        f"Please note: the {what} '{file}' can be read by others on this computer (chmod 600 ends that)."
        for file, what in files.items()
        if file is not None and os.name == "posix" and file.is_file()
        if file.stat().st_mode & (0o007 if what == "gallery" and modes else 0o077)
    ]


_OUTPUT: ContextVar[bool] = ContextVar("json", default=False)


def wants_json() -> bool:
    """Whether the verb that runs was given ``--json``, for one that prints before it ends."""
    return _OUTPUT.get()


def run_verb(options: argparse.Namespace) -> Outcome:
    """Run the chosen verb, its workers included, with the permissions for new files that were asked for."""
    from splitknit.errors import given_folders  # `--help` needs none of it
    from splitknit.io.atomic import GROUP_READABLE

    _OUTPUT.set(options.json)
    named = [one for value in vars(options).values() for one in (value if isinstance(value, list) else [value])]
    earlier = os.environ.get(GROUP_READABLE, "")
    os.environ[GROUP_READABLE] = "1" if options.group_readable else earlier
    try:
        with given_folders(one for one in named if isinstance(one, Path)):
            facts, lines = options.run(options)
    finally:
        os.environ[GROUP_READABLE] = earlier
    lines = [with_options(line, options.option_of) for line in lines]
    return _told(facts, options.option_of), [*lines, *_notes_on_secrets(options)] if lines else lines


def _add_settings(place: Any) -> None:
    wins = "change one setting; may be repeated and wins over --settings"
    named: dict[str, Any] = {"metavar": "STAGE.FIELD=VALUE", "dest": "assignments", "help": wins}
    place.add_argument("--set", action="append", default=[], **named)
    place.add_argument("--settings", type=Path, metavar="FILE", help="JSON or TOML file of settings")


def count(number: int, one: str, many: str | None = None) -> str:
    """Number and word."""
    return f"{number} {one if number == 1 else many or one + 's'}"


class _ProgressBar:
    """A bar on a terminal, from the first report on; silence in a pipe and with ``--json``."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._wanted = sys.stderr.isatty() and not options.json
        self._began, self._drawn = time.monotonic(), ""

    def __enter__(self) -> _ProgressBar:
        return self

    def update(self, stage: str, fraction: float) -> None:
        """Report that `stage` is at work and `fraction` (0 to 1) of everything is done."""
        from splitknit.errors import printable

        if self._wanted:
            done, width = min(1.0, fraction), max(4, min(80, shutil.get_terminal_size().columns - 45))
            minutes, seconds = divmod(int(time.monotonic() - self._began), 60)
            bar = "#" * round(width * done)
            self._draw(f"{printable(stage):24.24s} |{bar:{width}s}| {100.0 * done:3.0f} % {minutes:02d}:{seconds:02d}")

    def _draw(self, line: str) -> None:
        if line != self._drawn:
            self._drawn = line
            print(f"\r{line}\x1b[K", end="", file=sys.stderr, flush=True)

    def __exit__(self, *unused: object) -> None:
        if self._drawn:
            self._draw("")
