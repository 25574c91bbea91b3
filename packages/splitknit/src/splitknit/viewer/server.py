"""The server of ``splitknit view``: one page and one surface, held in memory, until it is stopped.

Only the page that this server gave out, on this machine, may request: another page in the same browser may send
requests to the loopback address, but it does not know the token; the name it uses may lead here (DNS rebinding), but
then the ``Host`` is another; and browsers say where a request comes from. Another user of the machine may connect to
the port, but does not know the token either.
"""

from __future__ import annotations

import atexit
import contextlib
import hmac
import html
import json
import os
import secrets
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput
from splitknit.model import Reconstruction
from splitknit.viewer.surface import surface_in

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Sent with every answer."""
_STATIC = Path(__file__).parent / "static"
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_MOST_POINTS = 600_000  # of a surface that is sent
_MAX_CONNECTIONS = 32  # each has a thread; browsers open six
_SINGLE = ("Host", "Origin", "Sec-Fetch-Site", "Sec-Fetch-Dest")
Pages = Mapping[str, tuple[str, bytes]]
"""Kind and content by the address below the token."""


def pages_of(result: Reconstruction, title: str) -> Pages:
    """All that is served of a result; BadInput if it holds no surface.

    ``surface`` holds rows and columns as int32, then x, y, height and relief as float32 fields of that shape, NaN
    outside the surface; ``facts`` is JSON.
    """
    surface = surface_in(result)
    points = int(np.isfinite(surface.height_mm).sum())
    step = int(np.ceil(np.sqrt(points / _MOST_POINTS)))
    whole = (surface.x_mm, surface.y_mm, surface.height_mm, surface.ridge_mm)
    fields = [np.ascontiguousarray(field[::step, ::step], dtype="<f4") for field in whole]
    facts = {
        "title": title,
        "preset": result.preset,
        "unit": surface.unit.name,
        "spacing": surface.pitch_mm * step,
        "warnings": list(result.warnings),
    }
    files = sorted(file for file in _STATIC.rglob("*") if file.suffix in _TYPES)
    pages = {
        file.relative_to(_STATIC).as_posix(): (f"{_TYPES[file.suffix]}; charset=utf-8", file.read_bytes())
        for file in files
    }
    pages[""] = pages.pop("index.html")
    pages["facts"] = ("application/json", json.dumps(facts).encode())
    sides = np.array(fields[0].shape, dtype="<i4").tobytes()
    pages["surface"] = ("application/octet-stream", sides + b"".join(field.tobytes() for field in fields))
    return pages


def start(pages: Pages, port: int) -> PageServer:
    """Listen on 127.0.0.1; port 0 is any free one. Raises BadInput if the port is in use or may not be used."""
    try:
        return PageServer(pages, port)
    except OSError as error:
        reason = error.strerror or str(error)
        cure = "choose another `port`, or leave it out for any free one."
        raise BadInput(f"port {port} cannot be used ({reason}); {cure}") from error


def show(result: Reconstruction, block: bool | None = None) -> str:
    """Show a result; return the page's address. `block`: whether to answer until Ctrl-C, or in a thread, as long as
    this program runs; by default as matplotlib does it: a program waits, an interactive session goes on.
    """
    waits = not (hasattr(sys, "ps1") or sys.flags.interactive) if block is None else block
    with contextlib.ExitStack() as stack:
        server = start(pages_of(result, "result"), 0)
        stack.callback(server.server_close)
        shown = stack.enter_context(opened_page(server.url))
        if waits:
            words = "Shown in the browser" if shown else "Open this address"
            sys.stdout.write(f"{server.url}\n{words}; Ctrl-C ends it.\n")
            sys.stdout.flush()
            server.run()
        else:
            threading.Thread(target=server.run, daemon=True).start()
            atexit.register(stack.pop_all().close)
        return server.url


@contextlib.contextmanager
def opened_page(url: str) -> Iterator[bool]:
    """Open `url` in the browser; return whether there is one. The browser's command line, which every user of the
    machine can read, must not hold the token: it is given a file that only its owner may read, which leads on.
    """
    with tempfile.TemporaryDirectory(prefix="splitknit-view-") as folder:  # 0700
        page = Path(folder) / "open.html"
        leads = '<!doctype html><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
        leads += f'<meta http-equiv="refresh" content="0;url={html.escape(url, quote=True)}"><title>splitknit</title>'
        with os.fdopen(os.open(page, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w", encoding="utf-8") as stream:
            stream.write(leads)
        # keys are not the browser's business, nor that of what it starts
        kept = {name: os.environ.pop(name) for name in [*os.environ] if name.startswith("SPLITKNIT_")}
        try:
            done = webbrowser.open(page.as_uri())
        except webbrowser.Error:
            done = False
        finally:
            os.environ.update(kept)
        yield done


class PageServer(ThreadingHTTPServer):
    """Listens on the loopback address only."""

    daemon_threads = True

    def __init__(self, pages: Pages, port: int) -> None:
        """Raises OSError where the port cannot be had."""
        self.pages, self.token = pages, secrets.token_urlsafe(24)  # 192 random bits
        self._free = threading.BoundedSemaphore(_MAX_CONNECTIONS)
        super().__init__(("127.0.0.1", port), _Handler)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"

    def run(self) -> None:
        """Answer until Ctrl-C or SIGTERM."""
        try:
            with contextlib.suppress(KeyboardInterrupt):
                self.serve_forever(poll_interval=0.2)
        finally:
            self.server_close()

    def server_bind(self) -> None:
        """Bind without asking the network for this host's name."""
        # on Windows SO_REUSEADDR would share the port
        exclusive = getattr(socket, "SO_EXCLUSIVEADDRUSE", socket.SO_REUSEADDR)
        self.socket.setsockopt(socket.SOL_SOCKET, exclusive, 1)
        self.socket.bind(self.server_address)
        self.server_name, self.server_port = "127.0.0.1", int(self.socket.getsockname()[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, as long as there are not too many."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and let the next one in."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """A page that was closed in the middle of an answer is not an error."""


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version, sys_version = "splitknit", ""
    timeout = 20.0

    def do_GET(self) -> None:
        path = self.path.partition("?")[0][len(self.server.token) + 2 :]
        refused = self._refusal()
        if refused:
            self.send_error(403, refused)
        elif path not in self.server.pages:
            self.send_error(404, "there is nothing at this address.")
        else:
            self._send(200, *self.server.pages[path])

    do_HEAD = do_GET  # noqa: N815

    def _refusal(self) -> str:
        """The reason for which a request is refused, or nothing."""
        headers, port = self.headers, self.server.server_port
        if any(len(headers.get_all(name, [])) > 1 for name in _SINGLE):
            return "a header is there twice."
        host = headers.get("Host", "").lower()
        if host not in (f"127.0.0.1:{port}", f"localhost:{port}"):
            return "this server answers to 127.0.0.1 and localhost only."
        start = f"/{self.server.token}/"
        if not hmac.compare_digest(self.path[: len(start)].encode("utf-8", "replace"), start.encode("ascii")):
            return "the address lacks this session's token; open the address that `splitknit view` printed."
        opening = self.path == start and headers.get("Sec-Fetch-Dest", "document") == "document"
        own = headers.get("Origin", f"http://{host}") == f"http://{host}"
        own = own and headers.get("Sec-Fetch-Site", "none") in ("same-origin", "none")
        return "" if own or (opening and headers.get("Origin", "null") == "null") else "other pages are refused."

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse in one sentence, which repeats nothing of the request."""
        self.close_connection = True
        words = message if code in (403, 404) and message else "the request cannot be read."
        self._send(code, "text/plain; charset=utf-8", f"{words}\n".encode())

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(content)), **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the address holds the token."""
