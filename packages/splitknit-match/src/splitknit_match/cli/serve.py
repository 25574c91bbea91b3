"""``splitknit serve --gallery GALLERY``: a gallery over HTTP, on this machine unless TLS is given."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from splitknit import BadInput
from splitknit.cli.verb import Outcome, Verb
from splitknit.errors import importing, printable, require
from splitknit.settings import Limits
from splitknit.verbs import AnyPath, Help, Job, KeyFile, Progress, path

LOCAL = ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True, slots=True)
class ServeJob(Job):
    """Serve a gallery over HTTP: enrol, identify, verify, quality."""

    # fmt: off
    _: KW_ONLY
    gallery: Annotated[AnyPath, Help("file of the gallery, made with the first finger", "GALLERY")]
    key_file: KeyFile = None
    token_file: Annotated[AnyPath | None, Help(
        "token that clients must send (or the variable SPLITKNIT_SERVE_TOKEN)", "FILE", secret=True)] = None
    host: Annotated[str, Help("address to listen at; others than this machine's need `certificate`", "HOST")] = LOCAL[0]
    port: Annotated[int, Limits(1, 65535), Help("port", "N")] = 8321
    certificate: Annotated[AnyPath | None, Help("TLS: certificate chain (PEM)", "FILE")] = None
    certificate_key: Annotated[AnyPath | None, Help("TLS: its private key (PEM)", "FILE", secret=True)] = None
    audit: Annotated[AnyPath | None, Help("file that gets a line for each act, without biometric data", "FILE")] = None
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Serve until a signal ends it."""
        from splitknit_match.gallery.gallery import Gallery  # verbs import what they need
        from splitknit_match.gallery.serve import make_app, read_token

        good = (self.certificate is None) == (self.certificate_key is None)
        require(good, "`certificate` and `certificate_key` go together.")
        cure = "give `certificate` and `certificate_key` for TLS, or a proxy's."
        require(self.host in LOCAL or self.certificate is not None, f"'{self.host}' is not this machine alone; {cure}")
        token = read_token(path(self.token_file))
        scheme = "http" if self.certificate is None else "https"

        with Gallery(path(self.gallery), path(self.key_file)) as gallery:
            if gallery.there:
                gallery.people()
            app, tls = make_app(gallery, token, path(self.audit)), (path(self.certificate), path(self.certificate_key))
            server = server_of(app, tls)
            with _listening(self.host, self.port) as door, contextlib.suppress(KeyboardInterrupt):
                for what, file in (
                    ("token", self.token_file),
                    ("key file", self.key_file),
                    ("key", self.certificate_key),
                ):
                    if file is not None and os.name == "posix" and path(file).stat().st_mode & 0o077:
                        fault = f"the {what} '{file}' can be read by others on this computer (chmod 600 ends that)."
                        print(printable(f"Please note: {fault}"), file=sys.stderr)
                words = f"Serving {self.gallery} at {scheme}://{self.host}:{self.port}; Ctrl-C ends it."
                print(printable(words), file=sys.stderr, flush=True)
                server.run(sockets=[door])
        return {}, []


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises BadInput if it cannot."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(
            f"cannot listen at port {port} of '{host}' ({reason}); give another `port` or `host`."
        ) from error


def server_of(app: Any, tls: tuple[Path | None, Path | None] = (None, None)) -> Any:
    """A server of an ASGI application; `tls`: certificate chain and private key. Raises BadInput if these do not fit.

    Connections that bring no whole request for 20 to 40 s are closed, and more than 64 at a time are refused.
    """
    with importing("serving needs uvicorn: pip install 'splitknit-match[serve]'."):
        import uvicorn
        from uvicorn.protocols.http.h11_impl import H11Protocol

    from splitknit_match.gallery import serve

    class Impatient(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.loop.call_later(serve.PATIENCE_S, self._look, None)

        def shutdown(self) -> None:
            cycle: Any = self.cycle
            if cycle is not None and cycle.more_body and not cycle.response_complete:  # it has not come as a whole
                self.transport.abort()
            else:
                super().shutdown()

        def _look(self, last: Any) -> None:
            cycle: Any = self.cycle
            if cycle is last and (cycle is None or cycle.response_complete):
                self.transport.close()
            if not self.transport.is_closing():
                self.loop.call_later(serve.PATIENCE_S, self._look, cycle)

    config = uvicorn.Config(
        app, log_level="warning", access_log=False, server_header=False, limit_concurrency=64, http=Impatient,
        timeout_keep_alive=5, timeout_graceful_shutdown=10, h11_max_incomplete_event_size=65_536,
        ssl_certfile=tls[0], ssl_keyfile=tls[1],
        ssl_keyfile_password="none",  # else OpenSSL asks at the terminal
    )  # fmt: skip
    try:
        config.load()
    except (OSError, ValueError) as error:  # OpenSSL's are OSErrors
        reason = f"'{tls[0]}' and '{tls[1]}' cannot be used for TLS ({error})"
        raise BadInput(f"{reason}; name PEM files that belong together, of a key without a passphrase.") from error
    return uvicorn.Server(config)


SERVE = Verb(ServeJob)
