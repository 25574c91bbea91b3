"""Template files: whole, damaged, old, empty."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from refusals import bad_input
from splitknit_match.records.templates import (
    HEADER_BYTES,
    MAGIC,
    decode_template,
    encode_template,
    read_template,
    write_template,
)


def test_what_is_written_is_read(tmp_path):
    file = tmp_path / "new" / "a.skt"
    write_template(file, b"ridges" * 100, 3)
    assert file.stat().st_size == HEADER_BYTES + 600
    assert read_template(file, 3) == b"ridges" * 100


def test_a_failure_to_acquire_is_a_file_of_no_bytes(tmp_path):
    file = tmp_path / "none.skt"
    write_template(file, b"", 1)
    assert file.stat().st_size == 0
    assert read_template(file, 1) == b""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: b"\x89PNG" + data[4:], "not a template"),
        (lambda data: data.replace(b"\r\n", b"\n", 1), "not a template"),
        (lambda data: data[:20], "within its header"),
        (lambda data: data[:-1], "does not fit its header"),
        (lambda data: data + b"x", "does not fit its header"),
        (lambda data: data[:-1] + b"x", "damaged"),
        (lambda data: data[:8] + b"\x02" + data[9:], "version 2, but this program reads version 1"),
        (lambda data: data[:10] + b"\x01" + data[11:], "damaged"),
    ],
)
def test_other_files_are_refused(tmp_path, change, words):
    file = tmp_path / "bad.skt"
    file.write_bytes(change(encode_template(b"ridges", 1)))
    with bad_input(words) as refused:
        read_template(file, 1)
    assert "bad.skt" in str(refused.value)


def test_missing_files_and_folders_are_refused(tmp_path):
    with bad_input("does not exist"):
        read_template(tmp_path / "none.skt", 1)
    with bad_input("is not a file"):
        read_template(tmp_path, 1)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    payload=st.binary(min_size=1, max_size=50),
    place=st.integers(0, 10_000),
    change=st.integers(1, 255),
)
def test_every_changed_byte_is_noticed(payload, place, change):
    data = bytearray(encode_template(payload, 1))
    assert decode_template(bytes(data), 1) == payload
    data[place % len(data)] ^= change
    with bad_input():
        decode_template(bytes(data), 1)


def test_header_of_nothing_is_refused():
    import hashlib

    empty = MAGIC + b"\x01\0\0\0\0\0\0\0" + hashlib.sha256(b"").digest()
    with bad_input("damaged"):
        decode_template(empty, 1)
