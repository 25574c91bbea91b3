"""What stands at a package's door: the names of its ``__init__.pyi``, each imported when it is
first used; those of its ``__all__`` are for users, the others for the other members.


So ``import splitknit`` is quick, and the list is the one that type checkers read.
"""

from __future__ import annotations

import re
import sys

# as typing's, whose import would take longer than all the rest of the command line's start
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_LINE = re.compile(r"^from (\S+) import (\w+) as (\w+)$", re.MULTILINE)
_NAME = re.compile(r'"(\w+)"')


def door(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of the `package` whose ``__init__.py`` is
    `file`."""
    with open(f"{file}i", encoding="utf-8") as stream:  # noqa: PTH123 - pathlib is slower to import
        text = stream.read()
    homes = {door: (module, name) for module, name, door in _LINE.findall(text)}
    names = _NAME.findall(text.partition("__all__ = ")[2])

    def load(name: str) -> Any:
        if name == "__version__":
            from importlib import metadata

            return metadata.version(package)
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        import importlib

        module, there = homes[name]
        value = getattr(importlib.import_module(module), there)
        setattr(sys.modules[package], name, value)
        return value

    return load, lambda: names, names
