"""``splitknit view`` in a process of its own, and how to ask a server."""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
from typing import Any

from splitknit.viewer.server import PageServer


def started(*arguments: object) -> tuple[subprocess.Popen[str], dict[str, Any]]:
    """Start `splitknit view`; return its process and what it says."""
    command = [sys.executable, "-m", "splitknit.cli.main", "view", *map(str, arguments), "--no-browser", "--json"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    lines = []
    while not lines or lines[-1] != "}\n":
        lines.append(running.stdout.readline())
        assert lines[-1], running.stderr.read()  # type: ignore[union-attr]
    return running, json.loads("".join(lines))


def ask(server: PageServer, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Ask for a whole path, as it is; names of headers have _ for -."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    try:
        connection.putrequest(method, path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()
