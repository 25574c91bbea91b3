"""The scripts under validation are not packages: import them by their folder, and forget them
afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from script_folder import Script, scripts_of

ACCURACY = Path(__file__).resolve().parents[2] / "validation" / "accuracy"


@pytest.fixture
def accuracy() -> Iterator[Script]:
    """Import a script of validation/accuracy by its name."""
    with scripts_of(ACCURACY) as named:
        yield named


@pytest.fixture(scope="module")
def script(request: pytest.FixtureRequest) -> Iterator[Script]:
    """Import a script of the module's `FOLDER` by its name."""
    with scripts_of(request.module.FOLDER) as named:
        yield named
