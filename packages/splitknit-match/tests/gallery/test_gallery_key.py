"""Keys: what counts as one, and where it comes from."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from splitknit.errors import BadInput
from splitknit_match.gallery.key import Key, key_of


def test_kinds_of_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.parametrize("content", [b"", b"seven c\n", b"\xff" * 31, b"two\nlines of text", b"x" * 5000])
def test_what_is_no_key(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "key").write_bytes(content)
    with pytest.raises(BadInput, match="holds no key"):
        key_of(tmp_path / "key")


def test_keys_are_not_shown() -> None:
    assert "secret" not in repr(Key("secret phrase"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_a_key_comes_from_a_pipe_that_somebody_writes_into(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("splitknit_match.gallery.key._WRITER_S", 0.3)
    pipe, phrase = tmp_path / "key", "a phrase for tests"
    os.mkfifo(pipe)
    with pytest.raises(BadInput, match="a pipe that no program writes into"):
        key_of(pipe)
    slowly = 'sleep 0.1; exec >"$1"; sleep 0.5; printf %s "$2"; sleep 0.1; echo'
    with subprocess.Popen(["sh", "-c", slowly, "sh", pipe, phrase]) as writer:
        assert key_of(pipe) == Key(phrase)
    assert writer.returncode == 0
    ours, theirs = os.pipe()
    os.write(theirs, phrase.encode())
    os.close(theirs)
    assert key_of(Path(f"/dev/fd/{ours}")) == Key(phrase)  # --key-file <(...)
    os.close(ours)
    with pytest.raises(BadInput, match="is neither a file nor a pipe"):
        key_of(Path("/dev/zero"))
