"""How a gallery's contents are wrapped: AES-256-GCM under a key of 32 bytes or a passphrase, or a digest only.

The only place that knows a cipher. A key comes from a file, a pipe or the environment, never from the command line.

References
----------
NIST SP 800-38D (GCM; unique nonces of 96 bits); RFC 7914 (scrypt); RFC 5869 (HKDF); RFC 2104 (HMAC); RFC 7693
(keyed BLAKE2). Clarke et al., "Incremental multiset hash functions and their application to memory integrity checking",
ASIACRYPT 2003 (MSet-Add-Hash).
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import io
import json
import os
import re
import select
import stat
import unicodedata
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from splitknit import AnyPath, BadInput, open_at_once, require, shown_path
from splitknit_match.gallery import COUNTER, KEY_VARIABLE
from splitknit_match.gallery.file import VERSION, damaged

_MAX_KEY_BYTES = 4096
_WRITER_S = 3.0
"""How long a pipe may be without a program that writes into it."""


def key_of(file: Key | AnyPath | None, variable: str = KEY_VARIABLE) -> Key | None:
    """Key from a file (with the counter file beside it), else from the environment; None where neither has one.

    Raises BadInput if the file cannot be read, is a pipe that nobody writes into, or what it holds is not a key.
    """
    if isinstance(file, Key):
        return file
    if file is not None:
        file = Path(file)
        content = _read_key(file)
        counter = file.with_name(file.name + COUNTER)
        return replace(key_from_bytes(content, f"the key file '{file}'"), counter=counter if counter.exists() else None)
    text = os.environ.get(variable)
    return None if text is None else key_from_bytes(os.fsencode(text), f"the variable {variable}")


def _read_key(file: Path) -> bytes:
    """Content of a file, or of a pipe such as the shell makes for ``<(...)``, up to a byte too many."""
    try:
        with io.FileIO(file, "rb", opener=open_at_once) as stream:
            mode = os.fstat(stream.fileno()).st_mode
            sound = stat.S_ISREG(mode) or stat.S_ISFIFO(mode)
            require(sound, f"the key file {shown_path(file)} is neither a file nor a pipe.")
            if stat.S_ISFIFO(mode):
                return _read_pipe(stream, file)
            return stream.read(_MAX_KEY_BYTES + 1)
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"the key file '{file}' cannot be read: {reason}.") from error


def _read_pipe(stream: io.FileIO, file: Path) -> bytes:
    """Read until all writers closed; a writer takes as long as it likes, as it may prompt for a password."""
    content, waited, written = b"", False, False
    events = select.poll()
    events.register(stream, select.POLLIN)
    while len(content) <= _MAX_KEY_BYTES:
        piece = stream.read(_MAX_KEY_BYTES + 1)
        if piece:
            content += piece
        elif piece is None:  # a writer is there and has written nothing yet
            events.poll()
        elif written:
            break
        else:
            require(not waited, f"the key file {shown_path(file)} is a pipe that no program writes into.")
            waited = not events.poll(1000 * _WRITER_S)
            written = not waited
            continue
        written = True
    return content


KEY_BYTES = 32
SALT_BYTES = 16
TAG_BYTES = 16
DIGEST_BYTES = 32
_NONCE_BYTES, _SEAL_BYTES = 12, 16
_MIN_PASSPHRASE = 8
_MAX_CONTENT = 4096
_MAX_MEMORY, _MAX_WORK = 2**30, 2**32
"""Bytes that scrypt may take, and may go through in all its rounds (about 10 s), whatever a gallery requests."""
_CHECK = b"splitknit gallery"


class Damaged(Exception):  # noqa: N818 - a statement about the content
    """A wrapped content cannot be opened: a byte was changed, it lies in another place, or the key is another."""


@dataclass(frozen=True, slots=True)
class ScryptSettings:
    """What a guess at a passphrase costs; it takes 128 * r * 2^log2_n bytes, p times one after another."""

    log2_n: int = 17
    """2^17 with r = 8 takes 128 MB and a third of a second a guess (the usual advice for stored passwords)."""
    r: int = 8
    """scrypt's size of a block, 1 to 32."""
    p: int = 1
    """scrypt's number of rounds, 1 to 16."""

    def __post_init__(self) -> None:
        ranges = {"log2_n": (10, 20), "r": (1, 32), "p": (1, 16)}
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            sound = type(value) is int and low <= value <= high
            require(sound, f"scrypt's {name} must be an integer from {low} to {high}, but it is {str(value)[:20]!a}.")
        memory = 128 * self.r * 2**self.log2_n
        require(
            memory <= _MAX_MEMORY and memory * self.p <= _MAX_WORK,
            f"scrypt with log2_n = {self.log2_n}, r = {self.r} and p = {self.p} takes {memory / 2**20:.0f} MB {self.p} "
            f"times; at most {_MAX_MEMORY / 2**20:.0f} MB, and {_MAX_WORK / 2**20:.0f} MB in all, are allowed.",
        )


@dataclass(frozen=True, slots=True, repr=False)
class Key:
    """What a user holds: 32 bytes, or a passphrase. Is never shown."""

    secret: bytes
    raw: bool
    """True: `secret` is 32 bytes of chance; false: a passphrase in UTF-8."""
    counter: Path | None = None
    """File that remembers the last change of every gallery of this key, so that an older copy of one is refused."""

    def __repr__(self) -> str:
        return f"Key(raw={self.raw})"


def key_from_bytes(content: bytes, where: str) -> Key:
    """Read a key: 64 hexadecimal digits or 32 bytes that are not text are a key, any other text is a passphrase.

    Line ends after it do not count; `where` is for errors. Raises BadInput if it is empty, larger than 4096 bytes, no
    text, or a passphrase of fewer than 8 characters.

    >>> key_from_bytes(b"correct horse battery staple", "the key file")
    Key(raw=False)
    """
    require(len(content) <= _MAX_CONTENT, f"{where} holds {len(content)} bytes, which is not a key (4096 at most).")
    try:
        text = content.decode("utf-8").rstrip("\r\n")
        readable = all(character.isprintable() for character in text)
    except UnicodeDecodeError:
        text, readable = "", False
    if readable and re.fullmatch(r"[0-9A-Fa-f]{64}", text):
        return Key(bytes.fromhex(text), raw=True)
    if not readable:
        expected = "a passphrase, 64 hexadecimal digits or 32 bytes are expected"
        require(len(content) == KEY_BYTES, f"{where} holds {len(content)} bytes that are not text; {expected}.")
        return Key(content, raw=True)
    phrase = unicodedata.normalize("NFC", text)
    require(
        len(phrase) >= _MIN_PASSPHRASE,
        f"{where} holds a passphrase of {len(phrase)} characters; {_MIN_PASSPHRASE} at least are expected, or 64 "
        "hexadecimal digits.",
    )
    return Key(phrase.encode("utf-8"), raw=False)


class Box:
    """Wraps contents; each belongs to one place (`context`) and cannot be opened as that of another.

    This one hides nothing: a SHA-256 of content and place stands in front of the content.
    """

    overhead = DIGEST_BYTES
    """Bytes that wrapping adds."""
    gallery = ""
    """Name of the gallery in a counter file: its salt; blank where nothing is encrypted."""

    def seal(self, content: bytes, context: bytes) -> bytes:
        """Digest and content."""
        return _digest(content, context) + content

    def open(self, sealed: bytes, context: bytes) -> bytes:
        """Content, if the digest fits; raises :class:`Damaged`."""
        content = sealed[DIGEST_BYTES:]
        if not hmac.compare_digest(sealed[:DIGEST_BYTES], _digest(content, context)):
            raise Damaged
        return content

    def tag(self, names: bytes) -> bytes:
        """Begin of the names' SHA-256: equal for equal names, to find them without opening every row."""
        return hashlib.sha256(b"splitknit gallery, names\0" + names).digest()[:TAG_BYTES]

    def leaf(self, row: bytes) -> int:
        """Hash of a row, whose sum is the gallery's root: SHA-256 finds mistakes, but anyone can compute it."""
        return int.from_bytes(hashlib.sha256(row).digest(), "little")

    def version(self, change: int) -> bytes:
        """16 bytes for a row of this change: the change's number, so that equal enrolments give equal files."""
        return change.to_bytes(TAG_BYTES, "big")


def _digest(content: bytes, context: bytes) -> bytes:
    return hashlib.sha256(len(context).to_bytes(4, "little") + context + content).digest()


class _SealedBox(Box):
    """AES-256-GCM with a nonce of chance for every content, bound to its place."""

    overhead = _NONCE_BYTES + _SEAL_BYTES

    def __init__(self, key: Key, salt: bytes, scrypt: ScryptSettings, version: int = VERSION) -> None:
        """Derive the keys of one gallery, which its salt and the version of its format make its own."""
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM  # few need it
        from cryptography.hazmat.primitives.hashes import SHA256
        from cryptography.hazmat.primitives.kdf.hkdf import HKDF

        require(len(salt) == SALT_BYTES, f"a salt has {SALT_BYTES} bytes, not {len(salt)}.")
        secret = key.secret if key.raw else _stretched(key.secret, salt, scrypt)
        derived = HKDF(SHA256(), 3 * KEY_BYTES, salt, b"splitknit gallery %d" % version).derive(secret)
        self.gallery = salt.hex()
        self._cipher: Any = AESGCM(derived[:KEY_BYTES])
        self._tag_key, self._leaf_key = derived[KEY_BYTES : 2 * KEY_BYTES], derived[2 * KEY_BYTES :]

    def seal(self, content: bytes, context: bytes) -> bytes:
        """Nonce, ciphertext, authentication tag."""
        nonce = os.urandom(_NONCE_BYTES)
        return nonce + bytes(self._cipher.encrypt(nonce, content, context))

    def open(self, sealed: bytes, context: bytes) -> bytes:
        """Content, if key and place are those it was sealed with and no byte was changed."""
        from cryptography.exceptions import InvalidTag

        if len(sealed) < self.overhead:
            raise Damaged
        try:
            return bytes(self._cipher.decrypt(sealed[:_NONCE_BYTES], sealed[_NONCE_BYTES:], context))
        except InvalidTag as error:
            raise Damaged from error

    def tag(self, names: bytes) -> bytes:
        """Begin of the names' HMAC: reveals nothing without the key."""
        return hmac.digest(self._tag_key, names, "sha256")[:TAG_BYTES]

    def leaf(self, row: bytes) -> int:
        """Keyed BLAKE2: without the key nobody makes rows of a given sum (MSet-Add-Hash, its result being sealed)."""
        return int.from_bytes(hashlib.blake2b(row, digest_size=32, key=self._leaf_key).digest(), "little")

    def version(self, change: int) -> bytes:
        """16 bytes of chance: of two copies of a gallery that were changed apart, no rows have the same."""
        return os.urandom(TAG_BYTES)


def code_secret(key: Key | None, salt: bytes) -> bytes:
    """Secret of renewable codes (:mod:`splitknit_match.matching.renewable`) under a key and a salt, 32 bytes.

    The key is the gallery's; another salt gives another secret. Without a key the secret is no secret.
    """
    if key is None:
        return hashlib.sha256(b"splitknit codes, no key\0" + salt).digest()
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF

    secret = key.secret if key.raw else _stretched(key.secret, salt, ScryptSettings())
    return bytes(HKDF(SHA256(), KEY_BYTES, salt, b"splitknit codes 1").derive(secret))


def _stretched(phrase: bytes, salt: bytes, settings: ScryptSettings) -> bytes:
    from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

    return bytes(Scrypt(salt, KEY_BYTES, 2**settings.log2_n, settings.r, settings.p).derive(phrase))


def lock(key: Key | None, scrypt: ScryptSettings | None) -> dict[str, Any]:
    """A gallery's record of how it is wrapped, under a new salt."""
    if key is None:
        return {"box": "plain"}
    chosen = scrypt or ScryptSettings()
    salt = os.urandom(SALT_BYTES)
    check = _SealedBox(key, salt, chosen).seal(_CHECK, _check_context(VERSION))
    cost = {} if key.raw else {"log2_n": chosen.log2_n, "r": chosen.r, "p": chosen.p}
    kind = "raw" if key.raw else "scrypt"
    return {"box": "aes-256-gcm", "key": kind, "salt": salt.hex(), "check": check.hex(), **cost}


def box_of(about: dict[str, Any], key: Key | None, path: Path, version: int = VERSION) -> Box:
    """Box of a gallery. Raises BadInput if the key is missing, wrong, of the other kind, or not wanted, the gallery's
    record is damaged, or its passphrase would take too much memory or time to try.
    """
    wrong = damaged(path, "its own record cannot be read")
    known = all(isinstance(about.get(name), kind) for name, kind in _ABOUT.items())
    require(known and about["box"] in ("plain", "aes-256-gcm"), wrong)
    if about["box"] == "plain":
        require(
            key is None,
            f"a key was given, but the gallery '{path}' is not encrypted; leave the key out, or encrypt it with "
            "'splitknit gallery rekey'.",
        )
        return Box()
    if key is None:
        raise BadInput(f"the gallery '{path}' is encrypted; give its key with `key_file` or in SPLITKNIT_GALLERY_KEY.")
    try:
        salt, check = bytes.fromhex(about["salt"]), bytes.fromhex(about["check"])
        raw = {"raw": True, "scrypt": False}[about["key"]]
        cost = () if raw else (about["log2_n"], about["r"], about["p"])
        require(len(salt) == SALT_BYTES, wrong)
    except (KeyError, ValueError, TypeError) as error:
        raise BadInput(wrong) from error
    try:
        scrypt = ScryptSettings(*cost)
    except BadInput as error:
        raise BadInput(damaged(path, str(error).rstrip("."))) from error
    kinds = "32 bytes (64 hexadecimal digits)", "a passphrase"
    require(
        key.raw == raw,
        f"the key does not fit: that of the gallery '{path}' is {kinds[not raw]}, but {kinds[not key.raw]} was given.",
    )
    box = _SealedBox(key, salt, scrypt, version)
    with contextlib.suppress(Damaged):
        if box.open(check, _check_context(version)) == _CHECK:
            return box
    raise BadInput(f"the key is not that of the gallery '{path}'; give the one it was encrypted with.")


def document_of(about: dict[str, Any]) -> str:
    """As it is stored."""
    return json.dumps(about, sort_keys=True)


def _check_context(version: int) -> bytes:
    return b"splitknit gallery %d\0check\0" % version


_ABOUT = {"box": str, "settings_sha256": str, "template_version": int}
