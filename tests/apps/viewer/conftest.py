"""Results to look at, and a server that shows them."""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from handmade import capture_of, finger

from splitknit.apps.outputs import write_results
from splitknit.apps.viewer.handler import ViewerServer
from splitknit.apps.viewer.open_paths import open_paths
from splitknit.apps.viewer.serve import start
from splitknit.io import read_capture, write_capture


def started(*arguments: object) -> tuple[subprocess.Popen[str], dict[str, Any]]:
    """Start `splitknit view`; return its process and what it says."""
    command = [sys.executable, "-m", "splitknit.apps.cli", "view", *map(str, arguments), "--no-browser", "--json"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    lines = []
    while not lines or lines[-1] != "}\n":
        lines.append(running.stdout.readline())
        assert lines[-1], running.stderr.read()  # type: ignore[union-attr]
    return running, json.loads("".join(lines))


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


@dataclass
class Asking:
    """A server in a thread, and how to ask it."""

    server: ViewerServer

    def get(self, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Ask for a path below the token; names of headers have _ for -."""
        return self.raw(f"/{self.server.token}/{path}", method, **headers)

    def raw(self, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Ask for a whole path, as it is."""
        connection = http.client.HTTPConnection("127.0.0.1", self.server.server_port, timeout=30)
        try:
            connection.putrequest(method, path, skip_host="Host" in headers)
            for name, value in headers.items():
                connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()


@pytest.fixture
def asking() -> Iterator[Callable[..., Asking]]:
    """Return a function that serves paths and gives what asks the server."""
    servers: list[tuple[ViewerServer, threading.Thread]] = []

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
