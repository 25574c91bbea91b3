"""Keys: what counts as one, and that contents open only with theirs, in their place."""

from __future__ import annotations

import pytest

from splitknit.errors import BadInput
from splitknit_match.gallery.key import Box, Damaged, Key, ScryptSettings, _SealedBox, key_from_bytes

CHEAP = ScryptSettings(log2_n=10)
SALT = b"s" * 16


def test_kinds_of_keys() -> None:
    digits = bytes(range(32)).hex().encode()
    assert key_from_bytes(digits + b"\n", "f") == key_from_bytes(digits.upper(), "f") == Key(bytes(range(32)), raw=True)
    assert key_from_bytes(bytes(range(32)), "f") == Key(bytes(range(32)), raw=True)
    assert key_from_bytes(b"eight ch\r\n", "f") == Key(b"eight ch", raw=False)
    assert key_from_bytes(b"a passphrase of 31 characters..\n", "f").raw is False
    assert key_from_bytes("Zoe\u0308 and Ann".encode(), "f") == key_from_bytes("Zo\u00eb and Ann".encode(), "f")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "passphrase of 0 characters"),
        (b"seven c\n", "passphrase of 7 characters"),
        (b"\xff" * 31, "31 bytes that are not text"),
        (b"two\nlines of text", "that are not text"),
        (b"x" * 5000, "5000 bytes, which is not a key"),
    ],
)
def test_what_is_no_key(content: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        key_from_bytes(content, "the key file")


def test_keys_are_not_shown() -> None:
    assert "secret" not in repr(Key(b"secret phrase", raw=False))


@pytest.mark.parametrize("key", [Key(b"k" * 32, raw=True), Key(b"a passphrase", raw=False)])
def test_contents_open_with_their_key_in_their_place(key: Key) -> None:
    box = _SealedBox(key, SALT, CHEAP)
    sealed = box.seal(b"ridges", b"row 1")
    assert len(sealed) == 6 + box.overhead
    assert b"ridges" not in sealed
    assert _SealedBox(key, SALT, CHEAP).open(sealed, b"row 1") == b"ridges"
    others = [
        _SealedBox(Key(b"K" * 32, raw=True), SALT, CHEAP), _SealedBox(key, b"t" * 16, CHEAP),
        _SealedBox(Key(key.secret, raw=True), SALT, CHEAP) if not key.raw else Box(),
    ]  # fmt: skip
    for other in others:
        with pytest.raises(Damaged):
            other.open(sealed, b"row 1")
        assert other.tag(b"Ann") != box.tag(b"Ann")
    for changed, place in ((sealed, b"row 2"), (sealed[:-1], b"row 1"), (b"", b"row 1"), (b"x" + sealed[1:], b"row 1")):
        with pytest.raises(Damaged):
            box.open(changed, place)


def test_a_passphrase_is_stretched_by_scrypt() -> None:
    """The key is HKDF of scrypt (RFC 7914), both of which other libraries know."""
    import hashlib
    import hmac

    secret = hashlib.scrypt(b"a passphrase", salt=SALT, n=1024, r=8, p=1, dklen=32)
    middle = hmac.new(SALT, secret, hashlib.sha256).digest()
    first = hmac.new(middle, b"splitknit gallery 2\x01", hashlib.sha256).digest()
    second = hmac.new(middle, first + b"splitknit gallery 2\x02", hashlib.sha256).digest()
    third = hmac.new(middle, second + b"splitknit gallery 2\x03", hashlib.sha256).digest()
    box = _SealedBox(Key(b"a passphrase", raw=False), SALT, CHEAP)
    assert box.tag(b"Ann") == hmac.new(second, b"Ann", hashlib.sha256).digest()[:16]
    leaf = hashlib.blake2b(b"row", digest_size=32, key=third).digest()
    assert box.leaf(b"row") == int.from_bytes(leaf, "little")
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    sealed = box.seal(b"ridges", b"place")
    assert AESGCM(first).decrypt(sealed[:12], sealed[12:], b"place") == b"ridges"


def test_plain_boxes_notice_damage() -> None:
    box = Box()
    sealed = box.seal(b"ridges", b"row 1")
    assert sealed.endswith(b"ridges")
    assert len(sealed) == 6 + box.overhead
    assert box.open(sealed, b"row 1") == b"ridges"
    for changed, place in ((sealed, b"row 2"), (sealed[:-1], b"row 1"), (b"", b"row 1")):
        with pytest.raises(Damaged):
            box.open(changed, place)


@pytest.mark.parametrize(
    ("cost", "words"),
    [
        ((40, 8, 1), "log2_n must be an integer from 10 to 20, but it is '40'"),
        ((10**30, 8, 1), "log2_n must be"),
        (("17", 8, 1), "log2_n must be"),
        ((17.5, 8, 1), "log2_n must be"),
        ((17, 0, 1), "r must be"),
        ((17, 8, True), "p must be"),
        ((20, 32, 1), "takes 4096 MB 1 times; at most 1024 MB"),
        ((20, 8, 16), "takes 1024 MB 16 times; at most 1024 MB, and 4096 MB in all"),
    ],
)
def test_costs_have_bounds(cost: tuple[int, int, int], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        ScryptSettings(*cost)
    ScryptSettings(20, 8, 4)
