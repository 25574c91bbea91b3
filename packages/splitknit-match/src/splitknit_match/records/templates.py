"""Template files (``.skt``): what a gallery keeps of a finger, with a header that distinguishes
damage from age.

Header, little-endian: 8 bytes ``SKTMPL`` CR LF (a transfer as text destroys it and is noticed),
version (uint16), two bytes of zero, size of the payload (uint32), SHA-256 of the payload (32
bytes). A file of zero bytes is a finger that could not be acquired, and is not an error.
"""

from __future__ import annotations

import hashlib
import os
import struct

from splitknit import BadInput
from splitknit.errors import require
from splitknit.files import read_bytes
from splitknit.io.atomic import write_file

MAGIC = b"SKTMPL\r\n"
_HEAD = struct.Struct("<8sHHI32s")
HEADER_BYTES = _HEAD.size
_LARGEST_TEMPLATE_BYTES = 16_000_000


def encode_template(payload: bytes, version: int) -> bytes:
    """Content of a template file: header and `payload`, of `version` (0 to 65535); nothing for an
    empty payload."""
    if not payload:
        return b""
    return _HEAD.pack(MAGIC, version, 0, len(payload), hashlib.sha256(payload).digest()) + payload


def is_template(data: bytes) -> bool:
    """Whether a file's content is a template, of any version."""
    try:
        return bool(decode_template(data, int.from_bytes(data[8:10], "little")))
    except BadInput:
        return False


def decode_template(data: bytes, version: int, name: str = "the template") -> bytes:
    """Payload of a template file's content `data`, empty for a failure to acquire; BadInput, with
    `name`, if it is no template, of another version than `version`, incomplete or damaged.
    """
    if not data:
        return b""
    remedy = "make the template again"
    require(
        data[: len(MAGIC)] == MAGIC[: len(data)],
        f"{name} is not a template of splitknit (it does not begin with 'SKTMPL'); name a .skt"
        " file.",
    )
    require(len(data) >= HEADER_BYTES, f"{name} ends within its header; {remedy}.")
    _, own, reserved, size, digest = _HEAD.unpack_from(data)
    require(
        own == version,
        f"{name} is a template of version {own}, but this program reads version {version};"
        f" {remedy}.",
    )
    payload = data[HEADER_BYTES:]
    sound = reserved == 0 and len(payload) == size > 0
    require(
        sound and hashlib.sha256(payload).digest() == digest,
        f"{name} is damaged: its content does not fit its header; {remedy}.",
    )
    return payload


def read_template(path: str | os.PathLike[str], version: int) -> bytes:
    """Payload of a template file; BadInput if it cannot be read, or as :func:`decode_template`."""
    return decode_template(
        read_bytes(path, _LARGEST_TEMPLATE_BYTES + HEADER_BYTES), version, os.fspath(path)
    )


def write_template(path: str | os.PathLike[str], payload: bytes, version: int) -> None:
    """Write a template file, whole or not at all, empty for an empty payload; BadInput if it cannot
    be written."""
    write_file(path, encode_template(payload, version))
