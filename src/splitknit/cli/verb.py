"""What all verbs of the command line share: their options, what they return, and the progress bar."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

PRESETS = ("metric", "snk", "pr", "ea", "pr-split", "ea-split", "kumar", "zheng", "lin", "xie")

FINGERS = (
    "capture folder, result folder, template (.skt), print (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, ANSI/NIST-ITL) or "
    "record of minutiae (ISO 19794-2, ANSI 378), or photograph of a finger in colour"
)
"""What is matched, for help."""

T = TypeVar("T")
Outcome = tuple[dict[str, Any], list[str]]
"""Facts for ``--json``, and the same in lines for people."""


class Parser(argparse.ArgumentParser):
    """A parser, and those of its verbs: ``--version``, and errors of one line that suggest what a typo stands for."""

    def __init__(self, *given: Any, **named: Any) -> None:  # noqa: D107 - as its parent's
        super().__init__(*given, **named)
        self._words: list[str] = []
        self.add_argument("--version", action=_Version, help="print the program's version and exit")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse the words after a verb; an unknown one is refused here, where the verb's options are known."""
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

        print(f"splitknit {__version__}")
        parser.exit()


def _suggestion(word: str, choices: Iterable[str]) -> str:
    from difflib import get_close_matches  # only errors need it

    close = get_close_matches(word, choices, 1)
    return f"; did you mean '{close[0]}' instead of '{word}'?" if close else ""


def one_line(error: object) -> str:
    """Return an error's text on one line that moves no cursor: what it quotes may hold any character.

    Arguments of Python functions, which stand between backticks, become options.

    >>> one_line("give `px_per_mm` 20, or `max_megapixels`.")
    'give --px-per-mm 20, or --max-size.'
    """
    from splitknit.errors import printable  # `--help` needs none of it

    text = re.sub("`([a-z_]+)`", lambda name: _OPTIONS.get(name[1], f"--{name[1].replace('_', '-')}"), str(error))
    return printable(" ".join(text.split()) or "no further words")


_OPTIONS = {
    "max_megapixels": "--max-size",
    "ridge_period_mm": "--ridge-period",
    "f_number": "--aperture",
    "radius_mm": "--ball-radius",
    "spacing_mm": "--pitch",
    "pitch_mm": "--pitch",
}
"""Those with other names than the argument."""


def new_verb(verbs: Any, name: str, does: str, run: Callable[[argparse.Namespace], Outcome]) -> argparse.ArgumentParser:
    """Add the verb `name`; `does` is its one line of help, without a full stop."""
    verb: argparse.ArgumentParser = verbs.add_parser(name, help=does, description=does[0].upper() + does[1:] + ".")
    verb.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else")
    verb.add_argument("--traceback", action="store_true", help="show where an error came from")
    verb.add_argument(
        "--group-readable",
        action="store_true",
        help="let your group read what is written (0640, 0750); by default only you can (0600, 0700)",
    )
    verb.set_defaults(run=run)
    return verb


def run_verb(options: argparse.Namespace) -> Outcome:
    """Run the chosen verb, its workers included, with the permissions for new files that were asked for."""
    from splitknit.errors import given_folders  # `--help` needs none of it
    from splitknit.gallery import VERB
    from splitknit.io.atomic import GROUP_READABLE

    kind = getattr(options, "kind", None)
    VERB.set(f"{options.verb} {kind}" if isinstance(kind, str) else options.verb)
    named = [one for value in vars(options).values() for one in (value if isinstance(value, list) else [value])]
    earlier = os.environ.get(GROUP_READABLE, "")
    os.environ[GROUP_READABLE] = "1" if options.group_readable else earlier
    try:
        with given_folders(one for one in named if isinstance(one, Path)):
            facts, lines = options.run(options)
            return facts, [*lines, *_key_notes(options)] if lines else lines
    finally:
        os.environ[GROUP_READABLE] = earlier


def _key_notes(options: argparse.Namespace) -> list[str]:
    """A warning of each key file that others can read."""
    given = [getattr(options, name, None) for name in ("key_file", "new_key_file")]
    return [
        f"Please note: the key file '{file}' can be read by others on this computer (chmod 600 ends that)."
        for file in given
        if file is not None and os.name == "posix" and file.stat().st_mode & 0o077
    ]


def group(verbs: Any, name: str, does: str) -> Any:
    """A verb that is followed by another."""
    group = verbs.add_parser(name, help=does, description=does[0].upper() + does[1:] + ".")
    return group.add_subparsers(dest="kind", metavar="WHAT", title="what", required=True)


def from_options(kind: type[T], options: argparse.Namespace, **others: Any) -> T:
    """Make a dataclass whose fields are those options that have their names, and `others`."""
    from dataclasses import fields

    named = {one.name: getattr(options, one.name) for one in fields(kind) if hasattr(options, one.name)}  # type: ignore[arg-type]
    return kind(**(named | others))


def add_preset(verb: argparse.ArgumentParser) -> None:
    """Add ``--preset`` for captures that are reconstructed on the way."""
    verb.add_argument(
        "--preset", choices=PRESETS, default="metric", help="how captures are reconstructed (default: metric)"
    )


def add_settings(verb: argparse.ArgumentParser) -> None:
    """Add ``--set`` and ``--settings``."""
    verb.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="STAGE.FIELD=VALUE",
        dest="assignments",
        help="change one setting; may be repeated and wins over --settings",
    )
    verb.add_argument("--settings", type=Path, metavar="FILE", help="JSON or TOML file of settings")


def add_device(verb: argparse.ArgumentParser) -> None:
    """Add ``--device``."""
    verb.add_argument(
        "--device",
        choices=("cpu", "cuda", "auto"),
        default="cpu",
        help="where networks run: cpu (the default, always the same bytes), cuda (other last digits; needs "
        "onnxruntime-gpu), or auto, cuda where there is one",
    )


def add_overwrite(verb: argparse.ArgumentParser) -> None:
    """Add ``--overwrite``."""
    verb.add_argument("--overwrite", action="store_true", help="replace an earlier capture in DIR")


def add_input_ppi(verb: Any) -> None:
    """Add ``--input-ppi``."""
    verb.add_argument(
        "--input-ppi",
        type=float,
        metavar="N",
        help="pixels per inch of prints whose files do not state it; where they do, N is taken all the same",
    )


def natural(text: str) -> int:
    """Read a whole number that is not negative (a type for argparse)."""
    value = int(text) if text.isascii() and text.isdigit() else -1
    if not 0 <= value < 2**63:
        raise argparse.ArgumentTypeError(f"'{text}' must be a whole number from 0 to 2^63 - 1")
    return value


def scale(text: str) -> float:
    """Read the size of images relative to the full frame (a type for argparse)."""
    return number(0.05, 1.0)(text)


def fraction(text: str) -> float:
    """Read a fraction (a type for argparse)."""
    return number(0.0, 1.0)(text)


def number(low: float, high: float, expected: str = "") -> Callable[[str], float]:
    """A type for argparse: a number from `low` to `high`, or what is `expected` in words."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            wanted = expected or f"a number from {low:g} to {high:g}"
            raise argparse.ArgumentTypeError(f"'{text}' must be {wanted}")
        return value

    return read


def refuse_given(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Refuse the first of these options that is given; `why` follows its name."""
    from splitknit.errors import require  # `--help` needs none of it

    for name in names:
        option = {"print_file": "print"}.get(name, name.replace("_", "-"))
        value = getattr(options, name)
        require(value is None or value is False, f"--{option} {why}")


class Progress:
    """A bar on a terminal; silence in a pipe and with ``--json``."""

    def __init__(self, options: argparse.Namespace) -> None:  # noqa: D107 - a context manager
        self._bar: Any = None
        self._wanted = sys.stderr.isatty() and not options.json

    def __enter__(self) -> Progress:
        if self._wanted:
            from tqdm import tqdm

            self._bar = tqdm(
                total=100,
                leave=False,
                bar_format="{desc:24.24s} |{bar}| {percentage:3.0f} % {elapsed}",
                file=sys.stderr,
            )
        return self

    def update(self, stage: str, fraction: float) -> None:
        """Report that `stage` is at work and `fraction` (0 to 1) of everything is done."""
        from splitknit.errors import printable

        if self._bar is not None:
            self._bar.set_description_str(printable(stage), refresh=False)
            self._bar.n = min(100.0, round(100.0 * fraction, 1))
            self._bar.refresh()

    def __exit__(self, *unused: object) -> None:
        if self._bar is not None:
            self._bar.close()
