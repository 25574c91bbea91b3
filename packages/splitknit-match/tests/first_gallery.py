"""A gallery as version 1 wrote it, for tests of what reads and migrates it."""

from __future__ import annotations

import hashlib
import hmac
import json
import sqlite3
from pathlib import Path

from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from splitknit_match.gallery.entry import NewCapture, encode_entry
from splitknit_match.gallery.key import Key


def of_version_1(path: Path, captures: list[NewCapture], key: Key | None, settings_sha256: str) -> None:
    """Write it; nothing here is the program's but the entry."""
    salt = bytes(range(16))
    middle = hmac.digest(salt, b"" if key is None else key.secret, "sha256")
    first = hmac.digest(middle, b"splitknit gallery 1\x01", "sha256")
    second = hmac.digest(middle, first + b"splitknit gallery 1\x02", "sha256")

    def seal(content: bytes, column: str, tag: bytes) -> bytes:
        place = b"splitknit gallery 1\0" + column.encode() + b"\0" + tag
        if key is None:
            return hashlib.sha256(len(place).to_bytes(4, "little") + place + content).digest() + content
        return b"nonce of 12 " + AESGCM(first).encrypt(b"nonce of 12 ", content, place)

    about = {"settings_sha256": settings_sha256, "template_version": 1, "box": "plain"}
    if key is not None:
        check = seal(b"splitknit gallery", "check", b"").hex()
        about |= {"box": "aes-256-gcm", "key": "raw", "salt": salt.hex(), "check": check}
    raw = sqlite3.connect(path)
    raw.executescript(
        "PRAGMA application_id = 0x534B4741; PRAGMA user_version = 1; CREATE TABLE about (document TEXT NOT NULL);"
        "CREATE TABLE finger (id INTEGER PRIMARY KEY, tag BLOB NOT NULL UNIQUE, entry BLOB NOT NULL, code BLOB, "
        "code_version INTEGER); CREATE TABLE images (id INTEGER PRIMARY KEY, content BLOB NOT NULL);"
        "CREATE TABLE template (id INTEGER PRIMARY KEY, content BLOB NOT NULL)"
    )
    raw.execute("INSERT INTO about VALUES (?)", (json.dumps(about, sort_keys=True),))
    for row, one in enumerate(captures, start=1):
        if key is None:
            tag = hashlib.sha256(b"splitknit gallery, names\0" + one.entry.names).digest()[:16]
        else:
            tag = hmac.digest(second, one.entry.names, "sha256")[:16]
        object.__setattr__(one.entry, "template_bytes", len(one.template))
        code = None if one.code is None else seal(one.code, "code", tag)
        cells = (row, tag, seal(encode_entry(one.entry), "entry", tag), code, one.code_version)
        raw.execute("INSERT INTO finger VALUES (?, ?, ?, ?, ?)", cells)
        raw.execute("INSERT INTO template VALUES (?, ?)", (row, seal(one.template, "template", tag)))
        if one.images is not None:
            raw.execute("INSERT INTO images VALUES (?, ?)", (row, seal(one.images, "images", tag)))
    raw.commit()
    raw.close()
