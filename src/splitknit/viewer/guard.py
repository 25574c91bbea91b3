"""Which requests are authorised: only the page that this server gave out, on this machine.

Another page in the same browser may send requests to the loopback address, but it does not know the token; the name it
uses may lead here (DNS rebinding), but then the ``Host`` is another; and browsers state where a request comes from.
Another user of the machine may connect to the port, but does not know the token either.
"""

from __future__ import annotations

import hmac
import secrets
from email.message import Message

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
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


def new_token() -> str:
    """Return 192 random bits, as they may stand in an address."""
    return secrets.token_urlsafe(24)


def refusal(method: str, path: str, headers: Message, token: str, port: int) -> tuple[int, str] | None:
    """Return the status and the reason for which a request is refused, or None if it is let in.

    Parameters
    ----------
    method : str
    path : str
        As sent, still encoded.
    headers : Message
    token : str
        The first part of every address.
    port : int
        On which we listen.
    """
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
    return twice or body or bool(headers.defects) or bool(headers.get_payload())  # a line that is no header ends them
