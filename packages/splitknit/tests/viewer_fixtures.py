"""A result to look at, and a server that shows it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from handmade import capture_of, finger
from splitknit.io.results import read_result
from splitknit.report.result import write_results
from splitknit.viewer.server import PageServer, pages_of, start


@pytest.fixture(scope="session")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a result."""
    folder = tmp_path_factory.mktemp("shown") / "metric"
    result, _ = finger()
    write_results(result, capture_of(result), folder)
    return folder


@pytest.fixture(scope="module")
def server(shown: Path) -> Iterator[PageServer]:
    """Return a server that shows it."""
    server = start(pages_of(read_result(shown), "metric"), 0)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()
