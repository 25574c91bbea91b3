"""What the tests of all members share: the independent data, the built rig, and interrupts that
reach them."""

from __future__ import annotations

import contextlib
import os
import signal
from pathlib import Path

import pytest

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # started in the background by a shell: what tests interrupt would inherit the deafness
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of independent data (SPLITKNIT_DATA, else ../shared/data beside the checkout); skips
    where absent."""
    default = Path(__file__).resolve().parents[1] / "shared" / "data"
    folder = Path(os.environ.get("SPLITKNIT_DATA") or default)
    if not folder.is_dir():
        pytest.skip(f"independent data not found at {folder} (set SPLITKNIT_DATA)")
    return folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs the built rig."""
    if os.environ.get("SPLITKNIT_HARDWARE"):
        return
    skip = pytest.mark.skip(
        reason="needs the built rig on a Raspberry Pi (set SPLITKNIT_HARDWARE=1)"
    )
    for item in items:
        if item.get_closest_marker("hardware"):
            item.add_marker(skip)
