"""Strict access to JSON documents written by people: every refusal names the file, the field and what it holds."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, NoReturn

from splitknit.errors import BadInput, read_bytes, refusing, require

MAX_JSON_BYTES = 16_000_000
"""A document of 16 MB takes up to 0.5 GB once parsed; the largest written here, minutiae in space, have 10 MB."""


def read_json(path: Path, damaged: str | None = None) -> tuple[Any, bytes]:
    """Read a UTF-8 JSON file of one object strictly; return it and its bytes. `damaged`: message where it cannot be
    read. Raises BadInput if it is missing, too long, not UTF-8, no JSON object, or holds NaN, 1e999 or a key twice.
    """
    try:
        data = read_bytes(path, MAX_JSON_BYTES)
        document = parse_json(data, str(path))
        Fields(document, str(path))
        return document, data
    except BadInput as error:
        raise error if damaged is None else BadInput(damaged) from error


def parse_json(data: bytes, name: str) -> Any:
    """Parse the bytes of a JSON file; see :func:`read_json`."""
    require(len(data) <= MAX_JSON_BYTES, f"{name} is too large: {len(data)} bytes, at most {MAX_JSON_BYTES} are read.")

    def constant(word: str) -> NoReturn:
        raise BadInput(f"{name} contains {word}, which is not a JSON number; correct the file.")

    def fraction(word: str) -> float:
        value = float(word)
        require(math.isfinite(value), f"{name} contains {word[:20]}, which is beyond all numbers; correct the file.")
        return value

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        result = dict(items)
        require(len(result) == len(items), f"{name} gives a field twice in one object; correct the file.")
        return result

    try:
        text = data.decode("utf-8-sig")
        return json.loads(text, parse_constant=constant, parse_float=fraction, object_pairs_hook=pairs)
    except BadInput:
        raise
    except RecursionError:
        raise BadInput(f"{name} is nested too deeply to be one of our files; correct the file.") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not valid JSON: it is not text in UTF-8 (byte {error.start}).") from error
    except ValueError as error:  # JSON, and integers of thousands of digits
        raise BadInput(f"{name} is not valid JSON: {error}.") from error


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return f"an object of {len(value)}"
    if isinstance(value, list):
        plain = len(value) <= 16 and not any(isinstance(item, (dict, list)) for item in value)
        text = f"[{', '.join(map(_shown, value))}]" if plain else ""
        return text if plain and len(text) <= 60 else f"a list of {len(value)}"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**20:
        return "a huge integer"
    text = "null" if value is None else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


class Fields:
    """One JSON object of a file, and where in the file it is."""

    def __init__(self, value: Any, name: str, where: str = "") -> None:  # noqa: D107 - the class says it
        self.name, self.where = name, where
        if not isinstance(value, dict):
            raise BadInput(f"{name}: {where or 'the document'} must be an object, but it is {_shown(value)}.")
        self._value: dict[str, Any] = value

    def path(self, key: str) -> str:
        """Return the field's name as messages give it, such as ``camera.px_per_mm``; of an empty `key` the object's."""
        return ".".join(filter(None, (self.where, key)))

    def refuse(self, key: str, expected: str) -> NoReturn:
        """Raise that field `key` is not `expected`."""
        raise BadInput(f"{self.name}: {self.path(key)} must be {expected}, but it is {_shown(self._value.get(key))}.")

    def require(self, condition: bool, key: str, fault: str) -> None:
        """Raise what is wrong with field `key` unless `condition` holds."""
        require(condition, f"{self.name}: {self.path(key)} {fault}")

    def has(self, key: str) -> bool:
        """Whether the field is there and not null."""
        return self._value.get(key) is not None

    def keys(self) -> list[str]:
        """Names of all fields."""
        return list(self._value)

    def get(self, key: str) -> Any:
        """Return a field that must be there."""
        require(self.has(key), f"{self.name}: {self.path(key)} is missing.")
        return self._value[key]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string; `default` where the field is absent."""
        if default is not None and not self.has(key):
            return default
        value = self.get(key)
        if not isinstance(value, str):
            self.refuse(key, "a string")
        return value

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """Return one of `choices`; the first where the field is absent."""
        value = self.text(key, choices[0])
        if value not in choices:
            self.refuse(key, " or ".join(f'"{choice}"' for choice in choices))
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a finite number from `low` to `high`; `default` where the field is absent."""
        if default is not None and not self.has(key):
            return default
        value = as_number(self.get(key))
        if value is None or not low <= value <= high:
            self.refuse(key, f"a number from {low:g} to {high:g}")
        return value

    def numbers(self, key: str, counts: tuple[int, ...], limit: float = 1e6) -> tuple[Any, ...]:
        """Return a list of one of `counts` finite numbers, none beyond `limit`."""
        found = _numbers(self.get(key), counts, limit)
        if found is None:
            self.refuse(key, f"a list of {' or '.join(map(str, counts))} finite numbers, none beyond {limit:g}")
        return found

    def triples(self, key: str, limit: float, expected: str) -> tuple[tuple[Any, ...], ...]:
        """Return a list of lists of three finite numbers, none beyond `limit`; `expected`: what to say otherwise."""
        rows = tuple(_numbers(row, (3,), limit) for row in self.items(key))
        if None in rows:
            self.refuse(key, expected)
        return tuple(filter(None, rows))

    def items(self, key: str) -> list[Any]:
        """Return a list."""
        value = self.get(key)
        if not isinstance(value, list):
            self.refuse(key, "a list")
        return value

    def file(self, key: str, folder: Path) -> Path | None:
        """Return the path of a file in `folder` (:func:`inside`), None where the field is absent."""
        return inside(folder, self.get(key), self.name, self.path(key)) if self.has(key) else None

    def child(self, key: str) -> Fields:
        """Return an object within this one."""
        return Fields(self.get(key), self.name, self.path(key))

    def mapping(self, key: str) -> dict[str, Any]:
        """Return an object as it is, empty where the field is absent."""
        return dict(self.child(key)._value) if self.has(key) else {}

    def format(self, expected: str, version: int) -> None:
        """Require this file's ``format`` and ``version``."""
        if self.text("format") != expected:
            self.refuse("format", f'"{expected}"')
        if type(self.get("version")) is not int or self.get("version") != version:
            self.refuse("version", f"{version} (the only one this software reads)")


def _numbers(value: Any, counts: tuple[int, ...], limit: float) -> tuple[float, ...] | None:
    """A list of one of `counts` finite numbers, none beyond `limit`; None where it is anything else."""
    numbers = [as_number(item) for item in value] if isinstance(value, list) else []
    good = tuple(item for item in numbers if item is not None and abs(item) <= limit)
    return good if len(good) == len(numbers) and len(good) in counts else None


def as_number(value: Any) -> float | None:
    """Return `value` as a finite float, or None if it is not a number; true and false are not numbers."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def inside(folder: Path, value: Any, file: str, field: str) -> Path:
    """Path `value`, relative to `folder`, in field `field` of `file`. BadInput if no string, absolute, or beyond it."""
    what = f"{file}: {field}"
    if not isinstance(value, str) or not value.strip():
        raise BadInput(f"{what} must be the name of a file, but it is {_shown(value)}.")
    leaves = f"{what} leaves the capture folder: {_shown(value)}; name a file inside it."
    parts = value.replace("\\", "/").split("/")
    require(not value.startswith(("/", "\\", "~")) and ":" not in parts[0], leaves)
    depth = 0
    for part in parts:
        depth += {"..": -1, ".": 0, "": 0}.get(part, 1)
        require(depth >= 0, leaves)
    with refusing(f"{what} is not a usable file name: {_shown(value)}."):
        os.fsencode(value)
        require((folder / value).resolve().is_relative_to(folder.resolve()), leaves)
    return folder / value
