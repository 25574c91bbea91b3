"""Where a file came from: software, version, parameters, input hashes; and the JSON in which that
is written."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import json
import platform
from collections.abc import Container, Mapping, Set
from pathlib import PurePath
from typing import Any

import numpy as np

from splitknit.errors import BadInput
from splitknit.files import AnyPath, open_file
from splitknit.findings import Finding

JsonValue = None | bool | int | float | str | list["JsonValue"] | dict[str, "JsonValue"]


def provenance(
    settings: Any = None, hashes: Mapping[str, str] | None = None
) -> dict[str, JsonValue]:
    """Facts of every written file: ``software``, ``version``, ``settings``, ``settings_sha256`` and
    ``inputs``; no date, no host. `settings`: dataclass or mapping that shaped the result; `hashes`:
    SHA-256 of every input file by name.
    """
    from importlib import metadata  # slow to import

    plain = plain_json({} if settings is None else settings)
    return {
        "software": "splitknit",
        "version": metadata.version("splitknit"),
        "settings": plain,
        "settings_sha256": settings_hash(plain),
        "inputs": dict(sorted((hashes or {}).items())),
    }


def report_head(form: str) -> dict[str, Any]:
    """Begin a ``report.json`` of the format `form`: software, and when it was written."""
    return {
        "format": form,
        "version": 1,
        "software": {
            "name": "splitknit",
            "version": provenance()["version"],
            "python": platform.python_version(),
        },
        "written_at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def file_hash(path: AnyPath) -> str:
    """SHA-256 (hex) of a file, read in pieces; BadInput if it is missing, no regular file, or
    cannot be read."""
    with open_file(path, 1 << 50) as (stream, _):  # nothing is kept of it
        return hashlib.file_digest(stream, "sha256").hexdigest()


def settings_hash(settings: Any) -> str:
    """SHA-256 (hex) of the canonical JSON of `settings`."""
    return hashlib.sha256(canonical_json(settings).encode("ascii")).hexdigest()


def canonical_json(value: Any) -> str:
    """ASCII JSON of `value` with sorted keys, no spaces, floats in their shortest exact form;
    dataclasses, mappings, sequences, numpy and paths are converted. Raises BadInput for NaN or
    infinity, keys other than strings, or no JSON form.
    """
    return json.dumps(
        plain_json(value), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )


def json_text(value: Any) -> str:
    """Return `value` as the ASCII JSON of the files that we write, an item a line; see
    :func:`canonical_json`."""
    return json.dumps(plain_json(value), indent=1, allow_nan=False) + "\n"


def known_json(value: Any, nulls: Container[str] = ()) -> Any:
    """`value` as of :func:`plain_json`, without dataclass fields still None by default, but for
    those of `nulls`; of findings their facts."""
    if isinstance(value, Finding):
        return value.facts
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        known = {}
        for item in dataclasses.fields(value):
            content = getattr(value, item.name)
            if content is not None or item.default is not None or item.name in nulls:
                known[item.name] = known_json(content, nulls)
        return known
    return (
        [known_json(item, nulls) for item in value]
        if isinstance(value, (list, tuple))
        else plain_json(value)
    )


def plain_json(value: Any, where: str = "value") -> JsonValue:
    """Return `value` rebuilt from dict, list, str, int, float, bool and None alone; see
    :func:`canonical_json`."""
    try:
        plain: JsonValue = json.loads(json.dumps(value, default=_builtin, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where} has no form in JSON: {error}.") from error
    return plain


def _builtin(value: Any) -> Any:
    """Convert a value to a type that `json` can encode."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, PurePath):
        return value.as_posix()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {item.name: getattr(value, item.name) for item in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Set):
        return sorted(value)
    raise TypeError(f"it holds a {type(value).__name__}")
