"""The notebooks of the documentation store nothing that was computed; `make docs` runs them, and an
error ends it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted(
    (Path(__file__).resolve().parents[1] / "docs" / "guide" / "notebooks").glob("*.ipynb")
)


def cells_of(notebook: Path) -> list[dict[str, Any]]:
    return list(json.loads(notebook.read_text(encoding="utf-8"))["cells"])


def test_there_are_three() -> None:
    assert [notebook.stem for notebook in NOTEBOOKS] == ["look", "match", "reconstruct"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_output_is_stored(notebook: Path) -> None:
    for cell in cells_of(notebook):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
