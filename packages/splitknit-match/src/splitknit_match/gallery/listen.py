"""The listening side of the service: an address, its certificate, how many clients are let in, and how it ends.

Whoever reaches the port may be silent, slow, or gone. None of them keeps others out, and none holds up the end.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from splitknit import UNFINISHED, BadInput, importing
from splitknit_match.gallery.serve import PATIENCE_S

MOST = 64
"""Connections at a time. Beyond them the oldest that waits for no answer is let go; where all wait, 16 more come in."""
STOP_S = 10.0
"""So long may what is at work take when the service is to end (a search of 10,000 fingers: 0.03 s, the first 18 s)."""
FAREWELL_S = 1.0
"""So long is a TLS client waited for that was told the end of its connection (asyncio: 30 s)."""


def serve(
    app: Any, protocol: type, address: tuple[str, int], tls: tuple[Path | None, Path | None], ready: Callable[[], None]
) -> None:
    """Serve an ASGI application at a host and port until a signal comes; call `ready` when the port is open.

    `tls`: certificate chain and private key, PEM. Raises BadInput if these do not fit, or nothing can listen there.
    """
    with importing("serving needs uvicorn: pip install 'splitknit-match[serve]'."):
        import uvicorn
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, server_header=False, limit_concurrency=MOST + 16,
        timeout_keep_alive=5, timeout_graceful_shutdown=round(STOP_S), http=protocol,
        h11_max_incomplete_event_size=65_536, ssl_certfile=tls[0], ssl_keyfile=tls[1],
        ssl_keyfile_password="none",  # else OpenSSL asks at the terminal
    )  # fmt: skip
    try:
        config.load()
    except (OSError, ValueError) as error:  # OpenSSL's are OSErrors
        reason = f"'{tls[0]}' and '{tls[1]}' cannot be used for TLS ({error})"
        raise BadInput(f"{reason}; name PEM files that belong together, of a key without a passphrase.") from error
    server = uvicorn.Server(config)
    with contextlib.suppress(KeyboardInterrupt), _listening(*address, server.server_state) as doors:
        ready()
        threading.Thread(target=_end, args=(server,), daemon=True).start()
        with asyncio.Runner(loop_factory=_Loop) as runner:
            runner.run(server.serve(sockets=doors))


def _end(server: Any) -> None:
    """End the program once it should have ended: threads that compare do not hear of a signal."""
    while not server.should_exit:
        time.sleep(0.1)
    time.sleep(STOP_S + 2 * FAREWELL_S)
    while UNFINISHED.depth:
        time.sleep(0.01)
    os._exit(0)


class _Loop(asyncio.SelectorEventLoop):
    async def create_server(self, *arguments: Any, **options: Any) -> asyncio.Server:
        if options.get("ssl") is not None:
            options |= {"ssl_handshake_timeout": PATIENCE_S, "ssl_shutdown_timeout": FAREWELL_S}
        return await super().create_server(*arguments, **options)


class _Door(socket.socket):
    """A socket that listens, of a service whose `state` knows who waits for an answer."""

    state: Any = None
    full = False

    def accept(self) -> tuple[socket.socket, Any]:
        if self.full:  # asyncio takes all that wait at once: first it closes who was let go
            self.full = False
            raise BlockingIOError
        accepted, client = super().accept()
        taken: list[socket.socket] = [one for one in self.state.taken if one.fileno() >= 0]
        self.full = len(taken) >= MOST
        if self.full:
            waiting = {
                one.transport.get_extra_info("socket").fileno()
                for one in self.state.connections
                if one.cycle is not None and not one.cycle.response_complete
            }
            idle = next((one for one in taken if one.fileno() not in waiting), None)
            if idle is not None:
                taken.remove(idle)
                with contextlib.suppress(OSError):
                    idle.shutdown(socket.SHUT_RDWR)  # its transport meets the end, and closes it
        self.state.taken = [*taken, accepted]
        return accepted, client


@contextlib.contextmanager
def _listening(host: str, port: int, state: Any) -> Iterator[list[socket.socket]]:
    """Sockets that listen at an address, of all families that it has. Raises BadInput if one cannot."""
    state.taken = []
    with contextlib.ExitStack() as stack:
        doors: list[socket.socket] = []
        try:
            for family, kind, number, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
                door = stack.enter_context(_Door(family, kind, number))
                door.state = state
                if os.name == "posix":
                    door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    door.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                door.bind(address)
                door.listen()
                doors.append(door)
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise BadInput(
                f"cannot listen at port {port} of '{host}' ({reason}); give another `port` or `host`."
            ) from error
        yield doors
