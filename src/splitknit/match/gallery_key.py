"""Encryption of a gallery: AES-256-GCM under a key of 32 bytes or a passphrase. The only place that knows a cipher.

References
----------
NIST SP 800-38D (GCM; unique nonces of 96 bits); RFC 7914 (scrypt); RFC 5869 (HKDF); RFC 2104 (HMAC).
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import unicodedata
from dataclasses import dataclass
from typing import Any

from splitknit.check import require
from splitknit.match.gallery_box import TAG_BYTES, Damaged

KEY_BYTES = 32
SALT_BYTES = 16
_NONCE_BYTES, _SEAL_BYTES = 12, 16
_LEAST_PASSPHRASE = 8
_MOST_CONTENT = 4096
_MOST_COST = 20


@dataclass(frozen=True, slots=True)
class ScryptSettings:
    """What a guess at a passphrase costs."""

    log2_n: int = 17
    """2^17 with r = 8 takes 128 MB and a third of a second a guess (the usual advice for stored passwords)."""
    r: int = 8
    """scrypt's size of a block, 1 to 32; memory grows with it."""
    p: int = 1
    """scrypt's number of rounds, 1 to 16; time grows with it."""

    def __post_init__(self) -> None:
        sound = 10 <= self.log2_n <= _MOST_COST and 1 <= self.r <= 32 and 1 <= self.p <= 16
        require(sound, f"scrypt needs 10 <= log2_n <= {_MOST_COST}, 1 <= r <= 32 and 1 <= p <= 16.")


@dataclass(frozen=True, slots=True, repr=False)
class Key:
    """What a user holds: 32 bytes, or a passphrase. Is never shown."""

    secret: bytes
    raw: bool
    """True: `secret` is 32 bytes of chance; false: a passphrase in UTF-8."""

    def __repr__(self) -> str:
        return f"Key(raw={self.raw})"


def key_from_bytes(content: bytes, where: str) -> Key:
    """Read a key: 64 hexadecimal digits or 32 bytes that are no text are a key, any other text is a passphrase.

    Parameters
    ----------
    content : of a key file or of an environment variable; line ends after it do not count
    where : for errors

    Raises
    ------
    BadInput
        If it is empty, larger than 4096 bytes, no text, or a passphrase of fewer than 8 characters.

    Examples
    --------
    >>> key_from_bytes(b"correct horse battery staple", "the key file")
    Key(raw=False)
    """
    require(len(content) <= _MOST_CONTENT, f"{where} holds {len(content)} bytes, which is no key (4096 at most).")
    try:
        text = content.decode("utf-8").rstrip("\r\n")
        readable = all(character.isprintable() for character in text)
    except UnicodeDecodeError:
        text, readable = "", False
    if readable and re.fullmatch(r"[0-9A-Fa-f]{64}", text):
        return Key(bytes.fromhex(text), raw=True)
    if not readable:
        expected = "a passphrase, 64 hexadecimal digits or 32 bytes are expected"
        require(len(content) == KEY_BYTES, f"{where} holds {len(content)} bytes that are no text; {expected}.")
        return Key(content, raw=True)
    phrase = unicodedata.normalize("NFC", text)
    require(
        len(phrase) >= _LEAST_PASSPHRASE,
        f"{where} holds a passphrase of {len(phrase)} characters; {_LEAST_PASSPHRASE} at least are expected, or 64 "
        "hexadecimal digits.",
    )
    return Key(phrase.encode("utf-8"), raw=False)


class SealedBox:
    """AES-256-GCM with a nonce of chance for every content, bound to its place."""

    overhead = _NONCE_BYTES + _SEAL_BYTES

    def __init__(self, key: Key, salt: bytes, scrypt: ScryptSettings) -> None:
        """Derive the keys of one gallery, which its salt makes its own."""
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM  # noqa: PLC0415 - few need it
        from cryptography.hazmat.primitives.hashes import SHA256  # noqa: PLC0415
        from cryptography.hazmat.primitives.kdf.hkdf import HKDF  # noqa: PLC0415

        require(len(salt) == SALT_BYTES, f"a salt has {SALT_BYTES} bytes, not {len(salt)}.")
        secret = key.secret if key.raw else _stretched(key.secret, salt, scrypt)
        derived = HKDF(SHA256(), 2 * KEY_BYTES, salt, b"splitknit gallery 1").derive(secret)
        self._cipher: Any = AESGCM(derived[:KEY_BYTES])
        self._tag_key = derived[KEY_BYTES:]

    def seal(self, content: bytes, context: bytes) -> bytes:
        """Nonce, ciphertext, authentication tag."""
        nonce = os.urandom(_NONCE_BYTES)
        return nonce + bytes(self._cipher.encrypt(nonce, content, context))

    def open(self, sealed: bytes, context: bytes) -> bytes:
        """Content, if key and place are those it was sealed with and no byte was changed."""
        from cryptography.exceptions import InvalidTag  # noqa: PLC0415

        if len(sealed) < self.overhead:
            raise Damaged
        try:
            return bytes(self._cipher.decrypt(sealed[:_NONCE_BYTES], sealed[_NONCE_BYTES:], context))
        except InvalidTag as error:
            raise Damaged from error

    def tag(self, names: bytes) -> bytes:
        """Begin of the names' HMAC: says nothing without the key."""
        return hmac.new(self._tag_key, names, hashlib.sha256).digest()[:TAG_BYTES]


def _stretched(phrase: bytes, salt: bytes, settings: ScryptSettings) -> bytes:
    from cryptography.hazmat.primitives.kdf.scrypt import Scrypt  # noqa: PLC0415

    return bytes(Scrypt(salt, KEY_BYTES, 2**settings.log2_n, settings.r, settings.p).derive(phrase))
