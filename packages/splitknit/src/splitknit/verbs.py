"""What a verb is: a frozen dataclass of documented fields that does the work.

The fields are declared once. The command line makes options of them (:mod:`splitknit.cli.verb`), :func:`function_of`
a Python function with its signature and docstring, and messages name them between backticks.
"""

from __future__ import annotations

import dataclasses
import os
import textwrap
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, ParamSpec, Protocol, TypeVar

from splitknit.errors import BadInput, require
from splitknit.settings import Limits, shown

P = ParamSpec("P")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
AnyPath = str | os.PathLike[str]
"""A path as Python callers give it; once the job is made, the field holds a :class:`pathlib.Path`."""
Progress = Callable[[str, float], None]
"""Is called with the name of a stage, and the fraction of the work that is done (0 to 1)."""


@dataclasses.dataclass(frozen=True, slots=True)
class Help:
    """What command line and documentation say of a field: ``Annotated[float, Help("...", metavar="MM")]``. In `text`
    another field stands between backticks, of which its option is made; the default is added where it names none.
    """

    text: str
    metavar: str = ""
    option: str = ""
    """Where it is not the field's name: ``--max-size``."""
    also: tuple[str, ...] = ()
    """Older names of the option."""
    positional: bool = False
    nargs: str = ""
    """``+`` or ``*``: one option takes several values; else a field of several values is an option that is repeated."""
    alone: str = ""
    """Value of an option that is given without one."""
    group: str = ""
    """Heading in ``--help``; of a field that is a dataclass itself, `text` is the heading of all its fields."""
    about: str = ""
    """A sentence below that heading."""
    either: str = ""
    """Fields with the same word exclude each other."""
    required: bool = False
    """One of these must be given."""
    read: Callable[[str], Any] | None = None
    """Makes the value of a word of the command line; raises BadInput or ValueError, ``'X' must be ...``."""
    python_only: bool = False
    """An argument of the function without an option."""
    takes: str = ""
    """What Python may give, where that is more than the command line."""
    secret: bool = False
    """A file that nobody else should be able to read."""


SETTINGS = Help("from ``stage.field`` to a value: changed settings")
"""Marks the field that ``--set`` and ``--settings`` fill."""

# options that several verbs have
Natural = Annotated[int, Limits(0, 2**63 - 1)]
Scale = Annotated[float, Limits(0.05, 1.0)]
Fraction = Annotated[float, Limits(0.0, 1.0)]
Positive = Annotated[float, Limits(0.0, above=True)]
Preset = Literal["metric", "snk", "pr", "ea", "pr-split", "ea-split", "kumar", "zheng", "lin"]
Encoding = Literal["linear", "srgb"]
HowReconstructed = Annotated[Preset, Help("how captures are reconstructed")]
Settings = Annotated[Mapping[str, Any] | None, SETTINGS]
Device = Annotated[
    Literal["cpu", "cuda", "auto"],
    Help(
        "where networks run: cpu (the default, always the same bytes), cuda (other last digits; needs "
        "onnxruntime-gpu), or auto, cuda where there is one"
    ),
]
Overwrite = Annotated[bool, Help("replace an earlier capture in DIR")]
InputPpi = Annotated[
    float | None,
    Help("pixels per inch of prints whose files do not state it; where they do, N is taken all the same", "N"),
]
KEY_FILE = Help(
    "key of an encrypted gallery: a passphrase, or 64 hexadecimal digits (or the variable SPLITKNIT_GALLERY_KEY)",
    "FILE",
    option="--key-file",
    secret=True,
)
KeyFile = Annotated[AnyPath | None, KEY_FILE]
FINGER = (
    "capture folder, result folder, template (.skt), print (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, ANSI/NIST-ITL) or "
    "record of minutiae (ISO 19794-2, ANSI 378), or photograph of a finger in colour"
)
"""Help on what is matched."""


class Runs(Protocol[R_co]):
    """A job: its fields are the input."""

    def run(self, progress: Progress) -> R_co:
        """Do the work, and return what came out."""


class Job:
    """Base of jobs and of groups of their fields: paths become ``Path``, ranges and choices are checked."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    def __post_init__(self) -> None:
        check(self)


def check(job: Any) -> None:
    """Turn paths of a job into :class:`pathlib.Path`, and check ranges and choices; BadInput names field and value. A
    job with rules between its fields begins its own ``__post_init__`` with this.
    """
    for field in fields_of(type(job)):
        given = value = getattr(job, field.name)
        if field.kind is Path and field.read is None:
            value = _as_paths(value, field.many)
        elif field.many and isinstance(value, list):
            value = tuple(value)
        if value is not given:
            object.__setattr__(job, field.name, value)
        _check(field, value)


def refuse_given(job: Any, names: Iterable[str], why: str) -> None:
    """Refuse the first of these fields that has another value than its default; `why` follows its name."""
    defaults = {field.name: field.default for field in fields_of(type(job))}
    for name in names:
        require(getattr(job, name) == defaults[name], f"`{name}` {why}")


@dataclasses.dataclass(frozen=True, slots=True)
class Field:
    """One field of a job, with what its type declares."""

    name: str
    kind: Any
    """``bool``, ``int``, ``float``, ``str``, ``Path``, or the dataclass of a group."""
    many: bool
    """Whether it is a tuple of any length."""
    choices: tuple[Any, ...]
    limits: Limits | None
    help: Help | None
    default: Any
    """``dataclasses.MISSING`` where it must be given."""

    @property
    def is_group(self) -> bool:
        """Whether it is a dataclass of further fields."""
        return dataclasses.is_dataclass(self.kind)

    @property
    def is_option(self) -> bool:
        """Whether the command line has it."""
        return self.help is not None and not self.help.python_only

    @property
    def read(self) -> Callable[[str], Any] | None:
        """What reads a word of the command line."""
        return None if self.help is None else self.help.read


def _fields_of(job: Any) -> tuple[Field, ...]:
    hints = typing.get_type_hints(job, include_extras=True)
    ordered = sorted((one for one in dataclasses.fields(job) if one.init), key=lambda one: bool(one.kw_only))
    return tuple(_field(one, hints[one.name]) for one in ordered)


fields_of: Callable[[Any], tuple[Field, ...]] = cache(_fields_of)
"""The fields of a job in the order of its arguments."""


def _field(one: dataclasses.Field[Any], hint: Any) -> Field:
    kinds, notes = _parts(hint)
    kinds = [kind for kind in kinds if kind is not types.NoneType]
    several = next(
        (one for one in kinds if typing.get_origin(one) is Sequence or typing.get_args(one)[-1:] == (...,)), None
    )
    if several is not None:
        kinds, more = _parts(typing.get_args(several)[0])
        notes += more
    kind = kinds[0]
    choices: tuple[Any, ...] = ()
    if any(kind is Path or kind is os.PathLike or typing.get_origin(kind) is os.PathLike for kind in kinds):
        kind = Path
    elif typing.get_origin(kind) is Literal:
        choices = typing.get_args(kind)
        kind = type(choices[0])
    default = one.default if one.default_factory is dataclasses.MISSING else one.default_factory()
    limits = next((note for note in notes if isinstance(note, Limits)), None)
    words = next((note for note in notes if isinstance(note, Help)), None)
    return Field(one.name, kind, several is not None, choices, limits, words, default)


def _parts(hint: Any) -> tuple[list[Any], list[Any]]:
    """Types of a union, and all that they are annotated with, from the outside in."""
    if typing.get_origin(hint) is Annotated:
        kinds, notes = _parts(hint.__origin__)
        return kinds, [*reversed(hint.__metadata__), *notes]
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        each = [_parts(one) for one in typing.get_args(hint)]
        return [kind for kinds, _ in each for kind in kinds], [note for _, notes in each for note in notes]
    return [hint], []


def _as_paths(value: Any, many: bool) -> Any:
    if many and isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_as_paths(one, False) for one in value)
    path = Path(value) if isinstance(value, str | os.PathLike) and not isinstance(value, Path) else value
    return (path,) if many and path is not None else path


def _check(field: Field, value: Any) -> None:
    rule, wanted = field.limits, ""
    if value is None:
        return
    if rule is not None and (field.kind in (int, float)) and not rule.hold(value):
        wanted = str(rule)
    elif field.choices and any(one not in field.choices for one in (value if field.many else (value,))):
        wanted = "one of " + ", ".join(str(choice) for choice in field.choices)
    if wanted:
        raise BadInput(f"`{field.name}` must be {wanted}, but it is {shown(value)}.")


@typing.overload
def path(given: None) -> None: ...
@typing.overload
def path(given: AnyPath) -> Path: ...
def path(given: AnyPath | None) -> Path | None:
    """The path that a field of a job holds, for the type checker: :data:`AnyPath` is what callers may give."""
    return None if given is None else Path(given)


def function_of(job: Callable[P, Runs[R]], name: str = "") -> Callable[P, R]:
    """Return the function of a job: its arguments are the fields, and it returns what :meth:`Runs.run` does.

    Its name is that of the class in snake case without ``Job``, or `name`; its docstring is the class's, with the
    section Parameters out of the fields, and where it has none Raises.
    """

    def function(*args: P.args, **kwargs: P.kwargs) -> R:
        return job(*args, **kwargs).run(lambda stage, fraction: None)

    import inspect  # dataclasses has it loaded already

    kind: Any = job
    plain = {one.name: _type_words(one) for one in fields_of(kind)}
    found = inspect.signature(kind)
    given = [one.replace(annotation=plain[one.name]) for one in found.parameters.values()]
    returned = kind.run.__annotations__.get("return", "Any")
    snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in kind.__name__.removesuffix("Job"))[1:]
    function.__name__ = function.__qualname__ = name or snake
    function.__module__ = kind.__module__
    function.__doc__ = _docstring(kind)
    function.__dict__.update(job=job, __signature__=found.replace(parameters=given, return_annotation=returned))
    return function


def _docstring(job: Any) -> str:
    import inspect

    text = inspect.getdoc(job) or ""
    lines = ["Parameters", "----------"]
    for one in fields_of(job):
        optional = "" if one.default is dataclasses.MISSING else ", optional"
        lines += [f"{one.name} : {_type_words(one)}{optional}"]
        group = f"See :class:`{one.kind.__module__}.{one.kind.__name__}`: " if one.is_group else ""
        words = "" if one.help is None else group + with_default(one)
        lines += textwrap.wrap(words, 116, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False)
    parts = text.split("\n\n")
    place = next((k for k, part in enumerate(parts) if k and part.split("\n")[1:2] == ["-" * len(part.split("\n")[0])]),
                 len(parts))  # fmt: skip
    if not any(part.startswith("Raises\n") for part in parts):
        after = place + sum(part.startswith("Returns\n") for part in parts)
        parts.insert(
            after, "Raises\n------\nBadInput\n    Naming the argument or the file at fault; nothing is written."
        )
    return "\n\n".join([*parts[:place], "\n".join(lines), *parts[place:]])


def with_default(field: Field) -> str:
    """The field's help, with its default where the text names none."""
    assert field.help is not None
    text, default = field.help.text, field.default
    silent = default is None or default is dataclasses.MISSING or isinstance(default, bool | tuple) or field.is_group
    if silent or "default" in text:
        return text
    number = isinstance(default, float) and abs(default) >= 1e-3
    return f"{text} (default: {f'{default:g}' if number else default})"


def _type_words(field: Field) -> str:
    if field.help is not None and field.help.takes:
        return field.help.takes
    if field.choices:
        words = "{" + ", ".join(repr(one) for one in field.choices) + "}"
    elif field.kind is Path:
        words = "path"
    elif field.help is SETTINGS:
        words = "mapping"
    else:
        words = getattr(field.kind, "__name__", str(field.kind))
    return f"sequence of {words}" if field.many else words
