"""``splitknit serve --gallery GALLERY``: a gallery over HTTP, on this machine unless TLS is given."""

from __future__ import annotations

import os
import sys
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any

from splitknit import AnyPath, Help, Job, KeyFile, Limits, Outcome, Progress, Verb, path, printable, require

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
        from splitknit_match.gallery.key import key_of  # verbs import what they need
        from splitknit_match.gallery.listen import serve
        from splitknit_match.gallery.serve import make_app, read_token
        from splitknit_match.gallery.warm import OpenGallery

        good = (self.certificate is None) == (self.certificate_key is None)
        require(good, "`certificate` and `certificate_key` go together.")
        cure = "give `certificate` and `certificate_key` for TLS, or a proxy's."
        require(self.host in LOCAL or self.certificate is not None, f"'{self.host}' is not this machine alone; {cure}")
        token = read_token(path(self.token_file))
        scheme = "http" if self.certificate is None else "https"

        def ready() -> None:
            for what, file in (("token", self.token_file), ("key file", self.key_file), ("key", self.certificate_key)):
                if file is not None and os.name == "posix" and path(file).stat().st_mode & 0o077:
                    fault = f"the {what} '{file}' can be read by others on this computer (chmod 600 ends that)."
                    print(printable(f"Please note: {fault}"), file=sys.stderr)
            words = f"Serving {self.gallery} at {scheme}://{self.host}:{self.port}; Ctrl-C ends it."
            print(printable(words), file=sys.stderr, flush=True)

        with OpenGallery.open(path(self.gallery), key_of(path(self.key_file))) as gallery:
            app, tls = make_app(gallery, token, path(self.audit)), (path(self.certificate), path(self.certificate_key))
            serve(app, impatient(), (self.host, self.port), tls, ready)
        return {}, []


def impatient() -> type:
    """Uvicorn's HTTP/1.1 protocol; connections that bring no whole request for 20 to 40 s, or take no answer for 20 s,
    are closed.
    """
    import h11
    from uvicorn.protocols.http.h11_impl import H11Protocol

    from splitknit_match.gallery import serve

    class Impatient(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.untaken: Any = None
            self.loop.call_later(serve.PATIENCE_S, self._look, None)

        def data_received(self, data: bytes) -> None:
            if not self.transport.is_closing():
                super().data_received(data)
                if self.conn.their_state is h11.DONE and self.conn.trailing_data[0]:
                    self.cycle.keep_alive = False  # more was asked before the answer: one is given, not thousands

        def pause_writing(self) -> None:
            super().pause_writing()
            self.untaken = self.loop.call_later(serve.PATIENCE_S, self.transport.abort)

        def resume_writing(self) -> None:
            super().resume_writing()
            self.untaken.cancel()

        def shutdown(self) -> None:
            """End without a request that has not come as a whole, or an answer that is not taken."""
            cycle: Any = self.cycle  # None before the first request
            coming = cycle is not None and cycle.more_body and not cycle.response_complete
            if coming or self.transport.get_write_buffer_size():
                self.transport.abort()
            else:
                super().shutdown()

        def _look(self, last: Any) -> None:
            cycle: Any = self.cycle
            if cycle is last and (cycle is None or cycle.response_complete):
                self.transport.close()
            if not self.transport.is_closing():
                self.loop.call_later(serve.PATIENCE_S, self._look, cycle)

    return Impatient


SERVE = Verb(ServeJob)
