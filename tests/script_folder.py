"""Scripts of a folder under validation are not a package: import them by their names, and forget
them afterwards."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest

Script = Callable[[str], ModuleType]
VALIDATION = Path(__file__).resolve().parents[1] / "validation"


@contextmanager
def scripts_of(folder: Path) -> Iterator[Script]:
    """A function that imports a script of `folder` by its name."""
    names = {file.stem for file in folder.glob("*.py")}
    with pytest.MonkeyPatch.context() as patch:
        for name in names & set(sys.modules):
            patch.delitem(sys.modules, name)
        patch.syspath_prepend(str(folder))
        yield importlib.import_module
        for name in names & set(sys.modules):
            del sys.modules[name]
