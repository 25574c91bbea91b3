"""How a gallery's contents are wrapped so that damage shows; the encrypted kind is in ``gallery_key``."""

from __future__ import annotations

import hashlib
import hmac
from typing import Protocol

DIGEST_BYTES = 32
TAG_BYTES = 16


class Damaged(Exception):  # noqa: N818 - a statement about the content
    """A wrapped content cannot be opened: a byte was changed, it lies in another place, or the key is another."""


class Box(Protocol):
    """Wraps contents; each belongs to one place (`context`) and cannot be opened as that of another."""

    overhead: int
    """Bytes that wrapping adds."""

    def seal(self, content: bytes, context: bytes) -> bytes:
        """Wrap."""

    def open(self, sealed: bytes, context: bytes) -> bytes:
        """Unwrap; raises :class:`Damaged`."""

    def tag(self, names: bytes) -> bytes:
        """16 bytes that are equal for equal names, to find them without opening every row."""


class PlainBox:
    """Nothing is hidden: a SHA-256 of content and place in front of the content."""

    overhead = DIGEST_BYTES

    def seal(self, content: bytes, context: bytes) -> bytes:
        """Digest and content."""
        return _digest(content, context) + content

    def open(self, sealed: bytes, context: bytes) -> bytes:
        """Content, if the digest fits."""
        content = sealed[DIGEST_BYTES:]
        if not hmac.compare_digest(sealed[:DIGEST_BYTES], _digest(content, context)):
            raise Damaged
        return content

    def tag(self, names: bytes) -> bytes:
        """Begin of the names' SHA-256."""
        return hashlib.sha256(b"splitknit gallery, names\0" + names).digest()[:TAG_BYTES]


def _digest(content: bytes, context: bytes) -> bytes:
    return hashlib.sha256(len(context).to_bytes(4, "little") + context + content).digest()
