"""Results to look at, and a server that shows them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from handmade import capture_of, finger
from splitknit.io.capture import read_capture, write_capture
from splitknit.report.result import write_results
from splitknit.viewer.server import _ViewerServer, open_paths, start
from viewer_server import Asking


@pytest.fixture(scope="session")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a capture and two results made from it, `metric` and `ea`."""
    folder = tmp_path_factory.mktemp("shown")
    for preset in ("metric", "ea"):
        result, truth = finger(preset=preset)
        if preset == "metric":
            write_capture(capture_of(result, lights=7), folder / "capture", truth)
        capture = read_capture(folder / "capture")
        object.__setattr__(result, "hashes", dict(capture.hashes))
        write_results(result, capture, folder / preset)
    return folder


@pytest.fixture
def asking() -> Iterator[Callable[..., Asking]]:
    """Return a function that serves paths and gives what asks the server."""
    servers: list[tuple[_ViewerServer, threading.Thread]] = []

    def make(*paths: Path, capture: Path | None = None) -> Asking:
        server = start(open_paths(paths, capture), 0)
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        servers.append((server, thread))
        return Asking(server)

    yield make
    for server, thread in servers:
        server.shutdown()
        thread.join()
        server.server_close()
