"""Keys: what counts as one, and where it comes from."""

import os
from pathlib import Path

import pytest

from refusals import bad_input
from splitknit_match.gallery.file import Key, key_of


def test_kinds_of_keys(tmp_path, monkeypatch):
    for content, key in (
        (b"0f" * 32 + b"\n", "0f" * 32),
        (b"eight ch\r\n", "eight ch"),
        ("Zoe\u0308 and Ann".encode(), "Zo\u00eb and Ann"),
    ):
        (tmp_path / "key").write_bytes(content)
        assert key_of(tmp_path / "key") == Key(key)
    monkeypatch.setenv("SPLITKNIT_GALLERY_KEY", "another phrase")
    assert key_of(None) == Key("another phrase")
    monkeypatch.delenv("SPLITKNIT_GALLERY_KEY")
    assert key_of(None) is None


@pytest.mark.parametrize(
    "content", [b"", b"seven c\n", b"\xff" * 31, b"two\nlines of text", b"x" * 5000]
)
def test_what_is_no_key(tmp_path, content):
    (tmp_path / "key").write_bytes(content)
    with bad_input("holds no key"):
        key_of(tmp_path / "key")


def test_keys_are_not_shown():
    assert "secret" not in repr(Key("secret phrase"))


@pytest.mark.slow
def test_a_key_comes_from_a_pipe(tmp_path):
    """``--key-file <(...)``; one that nobody writes into holds nobody."""
    os.mkfifo(tmp_path / "pipe")
    with bad_input("holds no key"):
        key_of(tmp_path / "pipe")
    ours, theirs = os.pipe()
    os.write(theirs, b"a phrase for tests")
    os.close(theirs)
    assert key_of(Path(f"/dev/fd/{ours}")) == Key("a phrase for tests")
    os.close(ours)
    with bad_input("holds no key"):
        key_of(Path("/dev/zero"))
    with bad_input("cannot be read"):
        key_of(Path("/none"))
