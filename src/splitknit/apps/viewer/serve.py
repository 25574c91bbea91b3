"""Start the server, open the page, wait until it is stopped."""

from __future__ import annotations

import contextlib
import html
import os
import tempfile
import webbrowser
from collections.abc import Iterator
from pathlib import Path

from splitknit.apps.viewer.guard import new_token
from splitknit.apps.viewer.handler import ViewerServer
from splitknit.apps.viewer.service import Service
from splitknit.errors import BadInput


def start(service: Service, port: int) -> ViewerServer:
    """Listen on 127.0.0.1; port 0 is any free one.

    Raises
    ------
    BadInput
        If the port is in use or not ours to take.
    """
    try:
        return ViewerServer(service, new_token(), port)
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(
            f"port {port} cannot be used ({reason}); choose another with --port, or leave it out for any free one."
        ) from error


def serve(server: ViewerServer) -> None:
    """Answer until Ctrl-C (or a polite kill)."""
    try:
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever(poll_interval=0.2)
    finally:
        server.server_close()


@contextlib.contextmanager
def opened_page(url: str) -> Iterator[bool]:
    """Open `url` in the browser; say whether there is one.

    The browser's command line can be read by every user of the machine and must not hold the token: it is given a file
    that only its owner may read, which leads on.
    """
    with tempfile.TemporaryDirectory(prefix="splitknit-view-") as folder:  # 0700
        page = Path(folder) / "open.html"
        leads = '<!doctype html><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
        leads += f'<meta http-equiv="refresh" content="0;url={html.escape(url, quote=True)}"><title>splitknit</title>'
        with os.fdopen(os.open(page, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w", encoding="utf-8") as stream:
            stream.write(leads)
        try:
            done = webbrowser.open(page.as_uri())
        except webbrowser.Error:
            done = False
        yield done
