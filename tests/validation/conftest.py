"""The scripts of validation/accuracy are no package: import them by their folder, and forget them afterwards."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

ACCURACY = Path(__file__).resolve().parents[2] / "validation" / "accuracy"


@pytest.fixture
def accuracy(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], ModuleType]]:
    """Import a script of validation/accuracy by its name."""
    names = {file.stem for file in ACCURACY.glob("*.py")}
    for name in names & set(sys.modules):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(ACCURACY))
    yield importlib.import_module
    for name in names & set(sys.modules):
        del sys.modules[name]
