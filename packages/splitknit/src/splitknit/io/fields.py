"""JSON documents written by people, checked by msgspec: a refusal names the file, the key and what
was expected.

Words to choose from are stated as a pattern, ``^(linear|srgb)$``, which msgspec shows and a Literal
it does not.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from splitknit.errors import BadInput, refusing, require
from splitknit.files import read_bytes

T = TypeVar("T")
_MAX_BYTES = 16_000_000
"""Largest document, which takes up to 0.5 GB once parsed; the largest written by splitknit
(minutiae in space) has 10 MB."""
Version1 = Annotated[int, msgspec.Meta(ge=1, le=1)]


def read_json(path: Path, damaged: str | None = None) -> tuple[dict[str, Any], bytes]:
    """Read a JSON file of one object; return it and its bytes. `damaged`: message where it cannot
    be read.

    Raises BadInput if it is missing, too long, or no JSON object.
    """
    try:
        return read_document(path, dict[str, Any])
    except BadInput as error:
        raise error if damaged is None else BadInput(damaged) from error


def read_document(path: Path, kind: type[T]) -> tuple[T, bytes]:
    """Read a JSON file of a `kind` that msgspec knows; return it and its bytes; BadInput as
    :func:`converted`."""
    data = read_bytes(path, _MAX_BYTES)
    return converted(parse_json(data, str(path)), kind, str(path)), data


def parse_json(data: bytes, name: str) -> Any:
    """Parse the bytes of a JSON file. Raises BadInput, with `name`, if it is too large or no JSON
    in UTF-8."""
    require(
        len(data) <= _MAX_BYTES,
        f"{name} is too large: {len(data)} bytes, at most {_MAX_BYTES} are read.",
    )
    try:
        return msgspec.json.decode(data.removeprefix(b"\xef\xbb\xbf"))
    except RecursionError:
        raise BadInput(
            f"{name} is nested too deeply to be one of our files; correct the file."
        ) from None
    except ValueError as error:
        raise BadInput(f"{name} is not valid JSON: {error}; correct the file.") from error


def converted(document: Any, kind: type[T], name: str) -> T:
    """`document`, of :func:`parse_json`, as a `kind` that msgspec knows. Raises BadInput naming
    file and key."""
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        what, _, place = str(error).replace("`", "").partition(" - at ")
        what = re.sub(r"str matching regex '\^\((.*)\)\$'", r"\1", what).replace("|", " or ")
        key = re.sub(r"^key in ", "", place).removeprefix("$").removeprefix(".")
        raise BadInput(
            f"{name}: {f'{key}: ' if key else ''}{what.rstrip('.')}; correct it."
        ) from error


def text_of(document: dict[str, Any], key: str, name: str) -> str:
    """The text of a key that a document must have. Raises BadInput naming file and key."""
    text = document.get(key)
    require(isinstance(text, str), f"{name}: {key}: expected str; correct the file.")
    return str(text)


def inside(folder: Path, value: str, file: str, field: str) -> Path:
    """Path `value`, relative to `folder`, in `field` of `file`; BadInput if empty, absolute, or
    beyond the folder."""
    what = f"{file}: {field}"
    require(value.strip(), f"{what} must be the name of a file, but it is empty.")
    parts = value.replace("\\", "/").split("/")
    with refusing(f"{what} is not a usable file name: {value[:60]!a}."):
        place = (folder / "/".join(parts)).resolve()
    within = (
        place.is_relative_to(folder.resolve()) and ".." not in parts and not value.startswith("~")
    )
    require(
        within and ":" not in parts[0],
        f"{what} leaves the capture folder: {value[:60]!a}; name a file inside it.",
    )
    return folder / value
