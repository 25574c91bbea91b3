"""Settings as users write them: ``--set stage.field=value`` and ``--settings FILE``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splitknit.errors import BadInput, refusing, require
from splitknit.files import read_bytes
from splitknit.io.fields import parse_json
from splitknit.settings import flatten


def read_changes(changed: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return all changed settings as ``stage.field`` and value, of pairs of option (``--set``,
    ``--settings``) and word; assignments win over files. Raises BadInput if a file cannot be read
    or an assignment is not ``stage.field=value``.
    """
    changes: dict[str, Any] = {}
    for option, file in changed:
        if option == "--settings":
            changes |= _read_settings_file(Path(file))
    return changes | dict(parse_assignment(word) for option, word in changed if option == "--set")


def parse_assignment(text: str) -> tuple[str, Any]:
    """Split ``stage.field=value``; the value is JSON or a TOML value, and unquoted words are text.

    >>> parse_assignment("normals.iterations=3")
    ('normals.iterations', 3)
    >>> parse_assignment("knit.mode=crossover")
    ('knit.mode', 'crossover')
    """
    name, equals, value = text.partition("=")
    name = name.strip()
    parts = name.split(".")
    sound = bool(equals) and all(part.isidentifier() for part in parts)
    require(
        sound,
        f"--set {text[:100]!a} is not of the form stage.field=value, for example"
        " normals.method=robust.",
    )
    return name, _scalar(value.strip())


def _scalar(text: str) -> Any:
    """Return the value that `text` stands for; NaN and infinity are left to the settings to
    refuse."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    import tomllib  # most runs change nothing

    try:
        return tomllib.loads(f"value = {text}")["value"] if "\n" not in text else text
    except (ValueError, RecursionError):
        return text


def _read_settings_file(path: Path) -> dict[str, Any]:
    """Read a JSON (``.json``) or TOML file of settings: ``{"stage": {"field": value}}`` or dotted
    names."""
    # those of this program have 2 kB; the parser's time grows with the square of a name's length
    data = read_bytes(path, 64_000)
    if path.suffix.lower() == ".json":
        tree = parse_json(data, f"the settings file '{path}'")
    else:
        import tomllib

        try:
            tree = tomllib.loads(data.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            words = (
                "it is not a text file"
                if isinstance(error, UnicodeDecodeError)
                else ascii(str(error)[:200])[1:-1]
            )
            raise BadInput(f"the settings file '{path}' is not sound TOML: {words}.") from error
    require(
        isinstance(tree, dict),
        f"the settings file '{path}' must hold a table of settings by stage.",
    )
    with refusing(
        f"the settings file '{path}' is nested too deeply; name settings as stage.field."
    ):
        return flatten(tree)
