"""Settings: frozen dataclasses whose ranges stand on the field, and changes by name, ``stage.field
= value``."""

from __future__ import annotations

import math
import re
import sys
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Annotated, Any, ClassVar, TypeVar

from splitknit.errors import BadInput, require

Settings = TypeVar("Settings")
_KINDS = {"float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text"}


@dataclass(frozen=True, slots=True)
class Limits:
    """Range of a field, declared on its type: ``Annotated[float, Limits(0, 1)]``.

    It holds for a number, for every number of a tuple, and not for None; what is not finite lies in
    no range.
    """

    min: float = -math.inf
    max: float = math.inf
    above: bool = False
    """Whether `min` itself is excluded."""

    def hold(self, value: Any) -> bool:
        """Whether a value, or every part of a tuple, lies in the range."""
        if isinstance(value, tuple):
            return all(self.hold(part) for part in value)
        if value is None or isinstance(value, str):
            return value is None
        finite = (
            abs(value) <= sys.float_info.max if isinstance(value, int) else math.isfinite(value)
        )
        within = self.min < value <= self.max if self.above else self.min <= value <= self.max
        return bool(within and finite)  # whole numbers may have any length

    def __str__(self) -> str:
        if math.isinf(self.max):
            if self.min == 0:
                return "positive" if self.above else "zero or more"
            return f"{'above' if self.above else 'at least'} {self.min:g}"
        if math.isinf(self.min):
            return f"at most {self.max:g}"
        largest = "2^63 - 1" if self.max == 2**63 - 1 else f"{self.max:g}"
        return f"{'above' if self.above else 'from'} {self.min:g} to {largest}"


class Checked:
    """Base of settings dataclasses: what the fields' types declare (:class:`Limits`, ``Literal``)
    is checked.

    Messages name a field with the name of its group before it: the class's name in snake case
    (``HeightSettings``: ``height``), or its ``_group``, which may be empty. A class with rules
    between fields has its own ``__post_init__``, which calls ``check_fields(self)`` first.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, slots=True)
    ... class BlurSettings(Checked):
    ...     sigma_mm: Annotated[float, Limits(0, 4)] = 1.0
    >>> BlurSettings(sigma_mm=5.0)
    Traceback (most recent call last):
    splitknit.errors.BadInput: blur.sigma_mm must be from 0 to 4, but it is 5.0.
    """

    __slots__ = ()
    _group: ClassVar[str | None] = None

    def __post_init__(self) -> None:
        check_fields(self)


def check_fields(settings: Checked) -> None:
    """Check each field of settings against the range or choices of its type; BadInput names field
    and value."""
    kind = type(settings)
    for name, rule in rules_of(kind):  # type: ignore[arg-type]  # a class is hashable
        check_value(f"{_group(kind)}{name}", rule, getattr(settings, name))


def check_value(name: str, rule: Limits | tuple[Any, ...], value: Any) -> None:
    """Refuse a value out of its range or choices; None is in each. Raises BadInput."""
    if isinstance(rule, Limits):
        sound, wanted = rule.hold(value), str(rule)
    else:
        wanted = "one of " + ", ".join(str(choice) for choice in rule)
        sound = value is None or value in rule
    if not sound:
        raise BadInput(f"{name} must be {wanted}, but it is {quoted(value)}.")


def _group(kind: type[Checked]) -> str:
    group = kind._group
    if group is None:
        group = re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower().removesuffix("_settings")
    return group and group + "."


@cache
def rules_of(kind: Any) -> tuple[tuple[str, Limits | tuple[Any, ...]], ...]:
    """Fields of a class, or arguments of a function, whose types declare a range or choices."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return tuple((name, rule) for name, hint in hints.items() for rule in _rules_in(hint))


def _rules_in(hint: Any) -> list[Limits | tuple[Any, ...]]:
    if typing.get_origin(hint) is Annotated:
        ranges = [item for item in hint.__metadata__ if isinstance(item, Limits)]
        return [*ranges, *_rules_in(hint.__origin__)]
    if typing.get_origin(hint) is typing.Literal:
        return [typing.get_args(hint)]
    kinds = [kind for kind in typing.get_args(hint) if kind is not types.NoneType]
    if typing.get_origin(hint) in (typing.Union, types.UnionType) and len(kinds) == 1:
        return _rules_in(kinds[0])
    return []


def quoted(value: Any) -> str:
    """Return a value as messages quote it, cut where it is long."""
    try:
        text = ascii(value)
    except ValueError:  # a whole number of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 100 else text[:97] + "..."


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested mappings into one, with dotted names.

    >>> flatten({"knit": {"mode": "crossover"}, "normals.method": "robust"})
    {'knit.mode': 'crossover', 'normals.method': 'robust'}
    """
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{name}.")
        else:
            flat[name] = value
    return flat


def differing(first: Any, second: Any, name: str = "") -> list[str]:
    """Dotted names of what differs between two documents of settings.

    >>> differing({"knit": {"mode": "none"}, "seed": 1}, {"knit": {"mode": "whole"}, "seed": 1})
    ['knit.mode']
    """
    if not isinstance(first, Mapping) or not isinstance(second, Mapping):
        return [] if first == second else [name]
    names: list[str] = []
    for key in sorted(first.keys() | second.keys()):
        names += differing(first.get(key), second.get(key), f"{name}.{key}".strip("."))
    return names


def override(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """`settings` (nested frozen dataclasses) with `changes`: from ``stage.field`` to a value, or
    nested mappings. Raises BadInput if a field is unknown (the nearest name is offered), of another
    type, or refused.
    """
    result = settings
    for name, value in flatten(changes).items():
        require(
            len(name) <= 100 and name.isprintable(),
            f"there is no setting {name[:100]!a}; settings are named as stage.field.",
        )
        result = _replaced(result, name.split("."), value, name)
    return result


def _replaced(settings: Any, path: list[str], value: Any, name: str) -> Any:
    known = [field.name for field in fields(settings)] if is_dataclass(settings) else []
    if not known or path[0] not in known:
        parent = name[: -len(".".join(path))]
        from difflib import get_close_matches  # only errors need it

        near = get_close_matches(path[0], known, n=1, cutoff=0.5)
        hint = (
            f"did you mean '{parent}{near[0]}'?"
            if near
            else f"known are {', '.join(parent + k for k in known)}."
        )
        raise BadInput(f"there is no setting '{name}'; " + (hint if known else "it has no parts."))
    current = getattr(settings, path[0])
    if len(path) > 1:
        require(is_dataclass(current), f"there is no setting '{name}'; '{path[0]}' has no parts.")
        return replace(settings, **{path[0]: _replaced(current, path[1:], value, name)})
    if is_dataclass(current):
        parts = ", ".join(f"{name}.{field.name}" for field in fields(current))
        raise BadInput(f"setting '{name}' is a group; set one of its parts: {parts}.")
    hint_type = typing.get_type_hints(type(settings)).get(path[0], Any)
    return replace(settings, **{path[0]: _converted(value, hint_type, name)})


def _converted(value: Any, hint: Any, name: str) -> Any:
    """`value` as the type of the field, without guessing: an int may become a float, a list a
    tuple."""
    import msgspec  # only changes need it

    try:
        return msgspec.convert(value, hint)
    except (msgspec.ValidationError, UnicodeError) as error:
        choices = [
            "one of " + ", ".join(map(repr, rule))
            for rule in _rules_in(hint)
            if not isinstance(rule, Limits)
        ]
        kinds = re.findall(r"\w+", str(error).partition("`")[2].partition("`")[0])
        wanted = choices or [_KINDS.get(kind, kind) for kind in kinds] or ["in range"]
        raise BadInput(
            f"setting '{name}' must be {' or '.join(wanted)}, but it is {quoted(value)}."
        ) from error
