"""Arguments that several verbs have: a verb is a function, and its signature makes the options of
the command line.

Its docstring (numpydoc) is the help; a name between backticks is shown as the option it becomes.
What stands here are the annotations that verbs share, and :func:`checked`, which refuses values out
of range for Python and command line alike.
"""

from __future__ import annotations

import functools
import inspect
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypeVar

from cyclopts import Parameter

from splitknit.errors import printable, refusing, require
from splitknit.settings import Limits, check_value, rules_of

P = ParamSpec("P")
R = TypeVar("R")

if TYPE_CHECKING:
    AnyPath = str | os.PathLike[str]
    """A path as Python callers give it."""
    Settings = Mapping[str, Any] | None
    """From ``stage.field`` to a value: changed settings."""
else:
    AnyPath = Path
    Settings = Annotated[
        tuple[str, ...] | None,
        Parameter(
            ("--set", "--settings"),
            help=(
                "Changed settings, each as STAGE.FIELD=VALUE; --settings names a JSON or TOML file"
                " of them."
            ),
            converter=lambda _, tokens: tuple((token.keyword, token.value) for token in tokens),
            n_tokens=1,
        ),
    ]

Progress = Annotated[Callable[[str, float], None], Parameter(parse=False)]
"""Is called with the name of a stage, and the fraction of the work that is done (0 to 1)."""
PYTHON_ONLY = Parameter(parse=False)
"""Marks an argument without an option; it needs a default."""
SEVERAL = Parameter(consume_multiple=True)
"""Marks an option that takes all words up to the next option."""
Natural = Annotated[
    int, Limits(0, 2**63 - 1), Parameter(converter=lambda _, tokens: whole_number(tokens[0].value))
]
Scale = Annotated[float, Limits(0.05, 1.0)]
Fraction = Annotated[float, Limits(0.0, 1.0)]
Positive = Annotated[float, Limits(0.0, above=True)]
Preset = Literal["metric", "snk", "pr", "ea", "pr-split", "ea-split", "kumar", "zheng", "lin"] | str
Encoding = Literal["linear", "srgb"]
ResolutionPpi = Annotated[
    float | None,
    Parameter(
        help=(
            "Pixels per inch of prints whose files do not state it; where they do, it is taken all"
            " the same."
        ),
    ),
]
Ridges = Annotated[
    Literal["dark", "light"] | None,
    Parameter(
        help=(
            "Whether ridges of prints are dark, as ink is, or light (default: as pictures show it;"
            " where they do not, both are compared)."
        ),
    ),
]


def silent(stage: str, fraction: float) -> None:
    """Report no progress."""


def whole_number(word: str) -> int:
    """The number that a word of the command line is; cyclopts would round 1.5. Raises BadInput."""
    require(word.isascii() and word.removeprefix("-").isdigit(), f"'{word}' must be a whole number")
    return int(word)


def point_of(word: str) -> tuple[float, float]:
    """The two numbers of a word X,Y. Raises BadInput.

    >>> point_of("-3,0.5")
    (-3.0, 0.5)
    """
    wanted = f"'{word}' must be X,Y, two numbers such as -3,0.5"
    with refusing(wanted):
        x, y = map(float, word.split(","))
    require(math.isfinite(x) and math.isfinite(y), wanted)
    return x, y


PlanePoint = Annotated[
    tuple[float, float],
    Parameter(
        converter=lambda _, tokens: point_of(tokens[0].value), n_tokens=1, allow_leading_hyphen=True
    ),
]
"""Two numbers that the command line takes as X,Y."""


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function refuse arguments that are out of the range or the choices which its signature
    declares.

    >>> @checked
    ... def shrink(scale: Scale = 1.0) -> float:
    ...     return scale
    >>> shrink(7.0)
    Traceback (most recent call last):
    splitknit.errors.BadInput: `scale` must be from 0.05 to 1, but it is 7.0.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def checking(*args: P.args, **kwargs: P.kwargs) -> R:
        arguments = signature.bind(*args, **kwargs).arguments
        for name, rule in rules_of(function):
            if arguments.get(name) is not None:
                check_value(f"`{name}`", rule, arguments[name])
        return function(*args, **kwargs)

    return checking


def refuse_given(why: str, **arguments: Any) -> None:
    """Refuse the first of these arguments that was given: is not None, False or empty; `why`
    follows its name."""
    for name, value in arguments.items():
        require(value is None or value is False or value == (), f"`{name}` {why}")


def text_of(lines: Sequence[str]) -> str:
    """Lines for people, none of which moves the cursor, whatever names of files it quotes."""
    return "\n".join(map(printable, lines))


@dataclass(frozen=True, slots=True)
class Report:
    """What a verb returns that writes files: the facts of its document, and the same in lines for
    people."""

    facts: dict[str, Any]
    lines: tuple[str, ...]

    def __str__(self) -> str:
        return text_of(self.lines)


def count(number: int, singular: str, plural: str | None = None) -> str:
    """Number and word."""
    return f"{number} {singular if number == 1 else plural or singular + 's'}"
