"""Shared fixtures."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of independent data (SPLITKNIT_DATA, else ../shared/data beside the checkout); skips where absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SPLITKNIT_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"independent data not found at {folder} (set SPLITKNIT_DATA)")
    return folder
