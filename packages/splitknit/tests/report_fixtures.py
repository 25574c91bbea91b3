"""Written results, made once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from handmade import capture_of, comparison_of, finger
from splitknit.report.result import write_results


@pytest.fixture(scope="session")
def written(tmp_path_factory) -> tuple[Path, dict[str, Any]]:
    """Return a folder of results with a truth, and the facts of its report."""
    result, _ = finger()
    folder = tmp_path_factory.mktemp("written") / "result"
    write_results(result, capture_of(result), folder, [comparison_of(result)])
    return folder, json.loads((folder / "report.json").read_text())
