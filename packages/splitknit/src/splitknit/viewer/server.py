"""The server: what is opened, one request in, one answer out, until it is stopped.

Results are read-only (GET and HEAD).

Only the page that this server gave out, on this machine, may request: another page in the same browser may send
requests to the loopback address, but it does not know the token; the name it uses may lead here (DNS rebinding), but
then the ``Host`` is another; and browsers say where a request comes from. Another user of the machine may connect to
the port, but does not know the token either.
"""

from __future__ import annotations

import atexit
import contextlib
import gzip
import hmac
import html
import io
import logging
import os
import secrets
import socket
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from email.message import Message
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import parse_qsl

from splitknit.errors import BadInput, open_file, require
from splitknit.registry import MATCH, VIEWS, extension
from splitknit.viewer.catalogue import Catalogue, Reply, make_catalogue
from splitknit.viewer.service import Service

if TYPE_CHECKING:
    from splitknit.viewer.service import Query

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}
"""Sent with every answer."""


def _refusal(method: str, path: str, headers: Message, token: str, port: int) -> tuple[int, str] | None:
    """Return the status and the reason for which a request is refused, or None if it is let in; `path` as sent."""
    if _is_malformed(headers):
        return 400, "the request cannot be read: it has a body, or a header that is damaged or there twice"
    hosts = {f"127.0.0.1:{port}", f"localhost:{port}"} | ({"127.0.0.1", "localhost"} if port == 80 else set())
    host = headers.get("Host", "").lower()
    if host not in hosts:
        return 403, "this server answers to 127.0.0.1 and localhost only"
    if method not in ("GET", "HEAD"):
        return 405, "this server is read-only"
    start = "/" + token + "/"
    if not hmac.compare_digest(path[: len(start)].encode("utf-8", "replace"), start.encode("ascii")):
        return 403, "the address lacks this session's token; open the address that `splitknit view` printed"
    opening = path.partition("?")[0] == start and headers.get("Sec-Fetch-Dest", "document") == "document"
    origin = headers.get("Origin")
    foreign = origin is not None and origin != f"http://{host}" and not (opening and origin == "null")
    foreign = foreign or (headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none") and not opening)
    return (403, "requests of other pages are refused") if foreign else None


def _is_malformed(headers: Message) -> bool:
    """What other programs might read differently."""
    twice = any(len(headers.get_all(name, [])) > 1 for name in ("Host", "Origin", "Sec-Fetch-Site", "Sec-Fetch-Dest"))
    body = "Transfer-Encoding" in headers or any(size != "0" for size in headers.get_all("Content-Length", []))
    return (
        twice or body or bool(headers.defects) or bool(headers.get_payload())
    )  # a line that is not a header ends them


_DATABASE = b"SQLite format 3\0"


class Answering(Protocol):
    """What a server serves."""

    def answer(self, path: str, query: Query) -> Reply:
        """Answer a request to read. Raises BadInput if there is nothing at `path`."""


def open_paths(paths: Sequence[Path], capture: Path | None = None, key_file: Path | None = None) -> Service:
    """Return a service for a result, two results, a folder of results, photographs, a gallery, or an empty page.
    Raises BadInput if there is nothing to show, or it cannot be read.
    """
    if paths and _is_database(paths[0]):
        require(len(paths) == 1, "a gallery is shown alone; name nothing else.")
        open_people = extension(VIEWS, "people", "the view of a gallery", MATCH)
        return Service(Catalogue(paths[0].name, (), ()), open_people(paths[0], key_file))
    require(key_file is None, f"'{paths[0] if paths else ''}' is not a gallery; `key_file` is for galleries.")
    service = Service(make_catalogue(paths, capture))
    for entry in map(service.catalogue.entry, service.catalogue.chosen):
        service.check(entry)
    return service


def _is_database(path: Path) -> bool:
    with contextlib.suppress(BadInput, RuntimeError), open_file(path.expanduser(), 1 << 62) as (stream, _):
        return stream.read(len(_DATABASE)) == _DATABASE
    return False


def start(service: Answering, port: int) -> _ViewerServer:
    """Listen on 127.0.0.1; port 0 is any free one. Raises BadInput if the port is in use or may not be used."""
    try:
        return _ViewerServer(service, secrets.token_urlsafe(24), port)  # 192 random bits
    except OSError as error:
        reason = error.strerror or str(error)
        cure = "choose another `port`, or leave it out for any free one."
        raise BadInput(f"port {port} cannot be used ({reason}); {cure}") from error


def show(save: Callable[[Path], object], block: bool | None = None) -> str:
    """Show what `save` writes into a folder, which goes when the page ends; return the page's address. Raises BadInput
    if that cannot be shown. `block`: whether to answer until Ctrl-C, or in a thread, as long as this program runs; by
    default as matplotlib does it: a program waits, an interactive session goes on.
    """
    waits = not (hasattr(sys, "ps1") or sys.flags.interactive) if block is None else block
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="splitknit-show-"))  # 0700
        save(Path(folder) / "result")
        server = start(open_paths([Path(folder) / "result"]), 0)
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


_LOG = logging.getLogger(__name__)
_LONGEST_PATH = 2000
_MAX_CONNECTIONS = 32  # each has a thread; browsers open six
_HEAD_BYTES = 16_384
_HEAD_S = 20.0  # until a whole request must be there, from the connection's start or the last answer
_ANSWER_S = 60.0  # until a piece of an answer must be taken
_PACKED_FROM = 1000  # bytes from which an answer is compressed
_PACKED_KINDS = ("text/", "application/", "image/svg")
_FULL = b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nRetry-After: 1\r\nConnection: close\r\n\r\n"


@lru_cache(maxsize=64)
def _gzipped(content: bytes) -> bytes:
    return gzip.compress(content, 6, mtime=0)


class _ViewerServer(ThreadingHTTPServer):
    """Listens on the loopback address only."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, service: Answering, token: str, port: int) -> None:
        """Raises OSError where the port cannot be had."""
        self.service, self.token = service, token
        self._free = threading.BoundedSemaphore(_MAX_CONNECTIONS)
        super().__init__(("127.0.0.1", port), _Handler)

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
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = "127.0.0.1", int(self.server_address[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, as long as there are not too many."""
        if not self._free.acquire(blocking=False):
            with contextlib.suppress(OSError):
                request.setblocking(False)
                request.send(_FULL)
                request.recv(_HEAD_BYTES)  # what is not read would reset the connection before the answer is seen
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except Exception:  # no thread could be started; an interrupt may come when it has been, and passes
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and let the next one in."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """A page that was closed in the middle of an answer is not an error."""
        if not isinstance(sys.exc_info()[1], (ConnectionError, TimeoutError)):
            _LOG.exception("a request failed")

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "splitknit", ""
    server: _ViewerServer
    _unread = b""

    def handle_one_request(self) -> None:
        """Answer a request whose head comes whole, in time and not too long; else close, or report why not."""
        head = self._head()
        self.connection.settimeout(_ANSWER_S)
        self.close_connection = True
        if len(head) > _HEAD_BYTES:
            self.requestline, self.request_version, self.command = "", "HTTP/1.1", ""
            self._say(431, "the request is too long")
        elif head:
            self.rfile = io.BytesIO(head)
            super().handle_one_request()

    def _head(self) -> bytes:
        """Request line and headers; nothing if the connection ends or takes too long, too much if they are longer."""
        end = time.monotonic() + _HEAD_S
        while b"\r\n\r\n" not in self._unread:
            if len(self._unread) > _HEAD_BYTES:
                return self._unread
            self.connection.settimeout(max(end - time.monotonic(), 1e-3))
            try:
                more = self.connection.recv(_HEAD_BYTES)
            except OSError:
                return b""
            if not more:
                return b""
            self._unread += more
        head, _, self._unread = self._unread.partition(b"\r\n\r\n")
        return head + b"\r\n\r\n"

    def do_GET(self) -> None:
        self._respond()

    do_HEAD = do_POST = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_GET  # noqa: N815

    def _respond(self) -> None:
        path, _, query = self.path.partition("?")
        refused = _refusal(self.command, self.path, self.headers, self.server.token, self.server.server_port)
        if refused is None and len(self.path) > _LONGEST_PATH:
            refused = 414, "the address is too long"
        if refused is not None:
            self._say(*refused)
            return
        try:
            values = dict(parse_qsl(query, max_num_fields=20))
            answer = self.server.service.answer(path[len(self.server.token) + 2 :], values)
        except BadInput as error:
            self._say(404, str(error))
        except ValueError:
            self._say(400, "the request cannot be read")
        except Exception:
            _LOG.exception("%s failed", path[len(self.server.token) + 2 :])
            self._say(500, "the server failed; `splitknit view` says more where it was started")
        else:
            with contextlib.closing(answer):
                self._send(200, answer)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what http.server cannot read, as all else is refused."""
        self.request_version = self.protocol_version
        self._say(code, "the request cannot be read")

    def _say(self, status: int, words: str) -> None:
        """Send a refusal and close; the rest of the request is not read."""
        body = (words + "\n").encode("utf-8")
        self.close_connection = True
        self._send(status, Reply("text/plain; charset=utf-8", len(body), body, {"Connection": "close"}))

    def _send(self, status: int, answer: Reply) -> None:
        headers = {"Cache-Control": "no-store", **HEADERS, **answer.headers}
        size, chunks = answer.size, answer.chunks
        if isinstance(chunks, bytes):
            if size > _PACKED_FROM and answer.kind.startswith(_PACKED_KINDS) and self._takes_gzip():
                chunks = _gzipped(chunks)
                size, headers["Content-Encoding"] = len(chunks), "gzip"
            headers["Vary"] = "Accept-Encoding"
            chunks = [chunks]
        self.send_response(status)
        self.send_header("Content-Type", answer.kind)
        self.send_header("Content-Length", str(size))
        for name, value in headers.items():
            self.send_header(name, value)
        if status == 405:
            self.send_header("Allow", "GET, HEAD")
        self.end_headers()
        if self.command == "HEAD":
            return
        for chunk in chunks:
            self.wfile.write(chunk)

    def _takes_gzip(self) -> bool:
        named = ",".join(self.headers.get_all("Accept-Encoding", [])).lower()
        offered = [one.partition(";") for one in named.split(",")]
        refused = {"q=0", "q=0.0", "q=0.00", "q=0.000"}
        return any(name.strip() == "gzip" and how.replace(" ", "") not in refused for name, _, how in offered)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the address holds the token."""
