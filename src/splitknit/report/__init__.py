"""Pages for people: figures, charts and self-contained HTML, from templates."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def template(name: str) -> Any:
    """A page of ``templates/``, to be rendered; a name that it does not get is an error."""
    import jinja2  # charts need none of it

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)
