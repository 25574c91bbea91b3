"""Transactions of ANSI/NIST-ITL: their bytes, what comes back, what is refused."""

from __future__ import annotations

import datetime
import time
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.io import itl_reading
from splitknit.io.itl_reading import (
    TransactionFacts,
    decode_transaction,
    encode_transaction,
)
from splitknit.io.minutiae_record import FINGER_CODES
from splitknit.io.prints import PrintFile

nistitl = pytest.importorskip("nistitl")
FACTS = TransactionFacts(datetime.date(2026, 11, 20), "P01-7", "OTHER", "LAB", "RIG3")
NOISE = np.random.default_rng(2).integers(0, 256, (11, 13)).astype(np.uint8)


def a_print(
    image: NDArray[Any], finger: str = "unknown", impression: str = "contactless", ppi: float = 500.0
) -> PrintFile:
    return PrintFile(image, ppi, {}, finger, impression)


SMALL = a_print(np.arange(120, dtype=np.uint8).reshape(10, 12), "right_index")


def test_bytes_are_those_of_the_standard() -> None:
    pixels = bytes(range(120))
    expected = (
        b"1.001:124\x1d1.002:0502\x1d1.003:1\x1f2\x1e2\x1f0\x1e14\x1f1\x1d1.004:OTHER\x1d1.005:20261120\x1d1.007:LAB"
        b"\x1d1.008:RIG3\x1d1.009:P01-7\x1d1.011:00.00\x1d1.012:00.00\x1c"
        b"2.001:17\x1d2.002:0\x1c"
        b"14.001:267\x1d14.002:1\x1d14.003:24\x1d14.004:RIG3\x1d14.005:20261120\x1d14.006:12\x1d14.007:10\x1d14.008:1"
        b"\x1d14.009:500\x1d14.010:500\x1d14.011:NONE\x1d14.012:8\x1d14.013:2\x1d14.999:" + pixels + b"\x1c"
    )
    data = encode_transaction([SMALL], FACTS)
    assert data == expected
    assert encode_transaction([SMALL], FACTS) == data


def assert_same(found: Sequence[PrintFile], prints: list[PrintFile]) -> None:
    for read, written in zip(found, prints, strict=True):
        np.testing.assert_array_equal(read.image, written.image)
        for name in ("finger", "impression", "resolution_ppi"):
            assert getattr(read, name) == getattr(written, name), name


def test_prints_come_back_as_they_were() -> None:
    prints = [
        a_print(NOISE, "right_thumb", "contactless", 500),
        a_print(NOISE, "left_little", "live_rolled", 1000),
        a_print(NOISE, "unknown", "contactless_moving", 500),
    ]
    for compression in ("none", "png"):
        assert_same(decode_transaction(encode_transaction(prints, FACTS, compression)), prints)


@pytest.mark.parametrize("finger", list(FINGER_CODES))
def test_every_finger_has_its_code(finger: str) -> None:
    data = encode_transaction([a_print(NOISE, finger)], FACTS)
    assert b"\x1d14.013:%d\x1d" % FINGER_CODES[finger] in data
    assert decode_transaction(data)[0].finger == finger


def test_wsq_inside_is_the_print_nearly() -> None:
    pytest.importorskip("_wsq")
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (100, 110)).astype(np.uint8), (0, 0), 4)
    data = encode_transaction([a_print(image)], FACTS, "wsq")
    assert b"14.011:WSQ20" in data
    read = decode_transaction(data)[0]
    assert np.abs(read.image.astype(int) - image).mean() < 6
    with pytest.raises(BadInput, match="WSQ is for 500 ppi"):
        encode_transaction([a_print(image, ppi=1000)], FACTS, "wsq")


def test_pixels_may_hold_separators_and_field_names() -> None:
    image = np.frombuffer((b"\x1c\x1d\x1e\x1f14.001:1\x1d14.999:" * 20)[:300], dtype=np.uint8).reshape(15, 20)
    for compression in ("none", "png"):
        item = a_print(image)
        assert_same(decode_transaction(encode_transaction([item, item], FACTS, compression)), [item, item])


def replaced(old: bytes, new: bytes, wide: bool = False) -> bytes:
    """Replace a field, and the lengths with it."""
    message = nistitl.Message()
    message.parse(encode_transaction([SMALL], FACTS))
    kind, tag = (int(number) for number in old.split(b"."))
    record = next(record for record in message if record.type == kind)
    if wide:
        record[6].value = new.decode()
    if new == b"":
        del record[tag]
    elif tag == 999:
        record[tag].value = new
    else:
        record[tag].value = new.decode()
    return bytes(message.NIST)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (replaced(b"14.006", b"13"), "holds 120 pixels, but its record states 10 x 13"),
        (replaced(b"14.006", b"-1"), "whole number of at most 5 digits"),
        (replaced(b"14.006", b"123456"), "whole number"),
        (replaced(b"14.007", b"99999", wide=True), "claims 9999800001 pixels, more than"),
        (replaced(b"14.006", b""), "lacks the field HLL"),
        (replaced(b"14.008", b"0"), "no resolution"),
        (replaced(b"14.010", b"501"), "square pixels"),
        (replaced(b"14.009", b"100") .replace(b"14.010:500", b"14.010:100"), "490 to 5080 ppi, not 100"),
        (replaced(b"14.011", b"JP2"), "compressed as 'JP2'; only NONE, WSQ20, PNG"),
        (replaced(b"14.011", b"PNG"), "PNG"),
        (replaced(b"14.011", b"WSQ20"), "not a WSQ file"),
        (replaced(b"14.012", b"16"), "not 8-bit grey"),
        (replaced(b"14.013", b"13"), "finger position 13 is not one"),
        (replaced(b"14.003", b"9"), "impression type 9 is not one"),
        (replaced(b"14.999", b"abc"), "holds 3 pixels"),
        (replaced(b"1.005", b"20261341"), "Type-1 record that cannot be read"),
        (replaced(b"1.009", b""), "lacks the field TCN"),
        (encode_transaction([SMALL], FACTS) + b"x", "no record begins at byte 408"),
        (b"", "is empty"),
        (b"FMR\0 20\0", "does not begin with '1.001:'"),
        (b"1.001:5\x1d", "truncated|does not end"),
        (b"1.001:0\x1d", "does not end where"),
        (b"1.001:9999999999\x1d", "truncated: its Type-1 record has 9999999999 bytes"),
        (b"14.001:9\x1d\x1c", "must begin with its only Type-1"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(data: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words) as refused:
        decode_transaction(data, "t.an2")
    assert "t.an2" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_transactions_without_prints_are_refused() -> None:
    message = nistitl.Message()
    message.TOT = "X"
    with pytest.raises(BadInput, match="holds no print"):
        decode_transaction(bytes(message.NIST))


def test_pixels_per_cm_are_read() -> None:
    data = replaced(b"14.008", b"2").replace(b"14.009:500\x1d14.010:500", b"14.009:394\x1d14.010:394")
    assert decode_transaction(data)[0].resolution_ppi == pytest.approx(394 * 2.54)


def test_every_truncation_is_refused() -> None:
    data = encode_transaction([SMALL, SMALL], FACTS)
    for length in range(len(data)):
        with pytest.raises(BadInput):
            decode_transaction(data[:length])


def test_what_cannot_be_said_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    for words, make in [
        ("1 to 98 prints, not 0", lambda: encode_transaction([], FACTS)),
        ("1 to 98 prints, not 99", lambda: encode_transaction([SMALL] * 99, FACTS)),
        ("490 to 5080", lambda: encode_transaction([a_print(NOISE, ppi=300)], FACTS)),
        ("'ring' has no code", lambda: encode_transaction([a_print(NOISE, "ring")], FACTS)),
        ("'ink' has no code", lambda: encode_transaction([a_print(NOISE, impression="ink")], FACTS)),
        ("'zip' is no compression", lambda: encode_transaction([SMALL], FACTS, "zip")),
        ("uint8", lambda: encode_transaction([a_print(NOISE.astype(float))], FACTS)),
        ("10 to 99999 pixels", lambda: encode_transaction([a_print(NOISE[:9])], FACTS)),
        ("without ':'", lambda: TransactionFacts(FACTS.date, "14.999:x")),
        ("1 to 40 printable", lambda: TransactionFacts(FACTS.date, "a\x1cb")),
        ("1 to 40 printable", lambda: TransactionFacts(FACTS.date, "")),
    ]:
        with pytest.raises(BadInput, match=words):
            make()
    monkeypatch.setitem(__import__("sys").modules, "nistitl", None)
    with pytest.raises(BadInput, match=r"splitknit\[records\]"):
        itl_reading.encode_transaction([SMALL], FACTS)
    with pytest.raises(BadInput, match=r"splitknit\[records\]"):
        itl_reading.decode_transaction(b"1.001:10\x1d\x1c"[:9] + b"\x1c")


FUZZ = settings(max_examples=100, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
FIRST = 129
"""Bytes of the Type-1 record."""
SOUND = encode_transaction([SMALL, a_print(NOISE)], FACTS, "png")


def attempt(data: bytes) -> None:
    try:
        decode_transaction(data)
    except BadInput as error:
        assert "\n" not in str(error)


@FUZZ
@given(st.sampled_from([b"", b"1.001:", SOUND[:FIRST], SOUND[: FIRST + 17]]), st.binary(max_size=120))
def test_any_bytes(start: bytes, data: bytes) -> None:
    attempt(start + data)


@FUZZ
@given(st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), min_size=1, max_size=4))
def test_changed_bytes(changes: list[tuple[int, int]]) -> None:
    data = bytearray(SOUND)
    for place, value in changes:
        data[place] ^= value
    attempt(bytes(data))


def test_many_records_take_no_time() -> None:
    began = time.process_time()
    attempt(SOUND[:FIRST] + b"2.001:17\x1d2.002:0\x1c" * 100_000)
    assert time.process_time() - began < 2
