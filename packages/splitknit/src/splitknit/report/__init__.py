"""Pages for people: figures and self-contained HTML, from templates."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from splitknit.errors import printable


@cache
def template(page: str | Path) -> Any:
    """The template of a page, from ``templates/`` or a file; rendering it without one of its names
    is an error."""
    import jinja2  # pictures need none of it

    shared = Path(__file__).parent / "templates"
    file = shared / page
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([file.parent, shared]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        # texts of files, as on a terminal
        finalize=lambda value: printable(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(file.name)
