"""Transactions of ANSI/NIST-ITL: their bytes, what comes back, what is refused."""

from __future__ import annotations

import datetime
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.io.prints import PrintFile
from splitknit_match.prints.from_file import read_print_file
from splitknit_match.records import itl_reading
from splitknit_match.records.itl_reading import (
    TransactionFacts,
    decode_transaction,
    encode_transaction,
)
from splitknit_match.records.minutiae_record import FINGER_CODES

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


def test_a_contactless_print_says_so_in_its_fields() -> None:
    """By hand: scan (14.016, .017), comment (.020), technology (.901) and device (.904), before the image."""
    text = {"SHPS": "1000", "SVPS": "1000", "COM": "no contact print", "FCT": "7", "MMS": "ACME,rig 7,0012"}
    item = PrintFile(SMALL.image, 500.0, {**text, "Software": "not written"}, "right_index", "contactless")
    data = encode_transaction([item], FACTS)
    fields = (
        b"\x1d14.013:2\x1d14.016:1000\x1d14.017:1000\x1d14.020:no contact print\x1d14.901:7"
        b"\x1d14.904:ACME\x1frig 7\x1f0012\x1d14.999:"
    )
    assert data[-121 - len(fields) : -121] == fields
    assert decode_transaction(data)[0].text == text
    # what another producer states otherwise is passed over
    odd = data.replace(b"no contact print", b"no contact print"[:-1] + b"\xfc")
    assert "COM" not in decode_transaction(odd)[0].text
    for name, wrong in (("FCT", "seven"), ("COM", "a\x1db"), ("MMS", "ACME,rig"), ("SHPS", "")):
        with pytest.raises(BadInput, match=f"cannot be written as field {name}"):
            encode_transaction([PrintFile(SMALL.image, 500.0, {name: wrong})], FACTS)


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
        (replaced(b"14.011", b"JP2"), "not a JPEG 2000 image"),
        (replaced(b"14.011", b"JPEGB"), "compressed as 'JPEGB'; only NONE, WSQ20, PNG, JP2L"),
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
        ("'zip' is not a compression method", lambda: encode_transaction([SMALL], FACTS, "zip")),
        ("uint8", lambda: encode_transaction([a_print(NOISE.astype(float))], FACTS)),
        ("10 to 99999 pixels", lambda: encode_transaction([a_print(NOISE[:9])], FACTS)),
        ("without ':'", lambda: TransactionFacts(FACTS.date, "14.999:x")),
        ("1 to 40 printable", lambda: TransactionFacts(FACTS.date, "a\x1cb")),
        ("1 to 40 printable", lambda: TransactionFacts(FACTS.date, "")),
    ]:
        with pytest.raises(BadInput, match=words):
            make()
    monkeypatch.setitem(__import__("sys").modules, "nistitl", None)
    with pytest.raises(BadInput, match=r"splitknit-match\[records\]"):
        itl_reading.encode_transaction([SMALL], FACTS)
    with pytest.raises(BadInput, match=r"splitknit-match\[records\]"):
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


def with_type4(*records: bytes, native: str = "19.69", cut: int | None = None) -> bytes:
    """A transaction of Type-1, Type-2 and binary records of Type-4, by nistitl."""
    message = nistitl.Message()
    message[0].VER, message[0].TOT, message[0].DAT, message[0].TCN = "0502", "OTHER", "20261120", "1"
    message[0].DAI, message[0].ORI, message[0].NSR, message[0].NTR = "LAB", "RIG", native, native
    second = nistitl.AsciiRecord(2)
    second.IDC = 0
    message += second
    for number, value in enumerate(records, start=1):
        record = nistitl.BinaryRecord(4)
        record.IDC, record.value = number, value
        message += record
    return bytes(message.NIST)[:cut]


def type4(finger: int = 2, scale: int = 0, code: int = 0, data: bytes | None = None) -> bytes:
    positions = bytes([finger, 255, 255, 255, 255, 255])
    body = SMALL.image.tobytes() if data is None else data
    return bytes([1]) + positions + bytes([scale]) + bytes([0, 12, 0, 10]) + bytes([code]) + body


def test_binary_records_are_read() -> None:
    """Rolled prints of Type-4, at 500 ppi or the native resolution; four fingers at once are passed over."""
    data = with_type4(type4(), type4(13), type4(7, scale=1), native="39.37")
    found = decode_transaction(data)
    assert [one.finger for one in found] == ["right_index", "left_index"]
    assert [round(one.resolution_ppi or 0) for one in found] == [500, 1000]
    assert {one.impression for one in found} == {"live_rolled"}
    for one in found:
        np.testing.assert_array_equal(one.image, SMALL.image)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (with_type4(type4(), cut=-1), "truncated"),
        (with_type4(b"abc"), "holds no image"),
        (with_type4(type4(14)), "no print of a single finger"),
        (with_type4(type4(code=9)), "compressed by code 9"),
        (with_type4(type4(data=b"xyz")), "holds 3 pixels"),
        (with_type4(type4(scale=1), native="00.00"), "ppi"),
    ],
)
def test_broken_binary_records_are_refused(data: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        decode_transaction(data, "x.an2")


def test_jpeg2000_of_1000_ppi_comes_back() -> None:
    given = PrintFile(np.tile(SMALL.image, (4, 4)), 1000.0, {}, "right_index", "contactless")
    (found,) = decode_transaction(encode_transaction([given], FACTS, "jp2"))
    assert found.resolution_ppi == 1000
    np.testing.assert_array_equal(found.image, given.image)


def test_latent_prints_and_palms_have_their_records() -> None:
    """Type-13 and Type-15, written, parsed by nistitl, and read; a palm is compared with nothing."""
    prints = [
        a_print(NOISE, "right_thumb", "latent_lift", 1000),
        a_print(NOISE, "left_hypothenar", "live_palm"),
        a_print(NOISE, "right_index", "live_plain"),
    ]
    data = encode_transaction(prints, FACTS)
    message = nistitl.Message()
    message.parse(data)
    kinds = [(one.type, str(one.IMP), str(one.FGP)) for one in message if one.type > 2]
    assert kinds == [(13, "7", "1"), (15, "10", "36"), (14, "0", "2")]
    assert b"\x1d13.005:20261120\x1d" in data and b"\x1d15.005:20261120\x1d" in data
    found = decode_transaction(data)
    assert_same(found, [prints[2], prints[0], prints[1]])
    assert [bool(one.note) for one in found] == [False, True, False], "rates of latent prints were not measured"
    for finger, impression in (("right_index", "live_palm"), ("right_thenar", "contactless")):
        with pytest.raises(BadInput, match="not an impression type of"):
            encode_transaction([a_print(NOISE, finger, impression)], FACTS)


def test_a_palm_is_not_compared(tmp_path: Path) -> None:
    file = tmp_path / "palm.an2"
    file.write_bytes(encode_transaction([a_print(np.tile(NOISE, (9, 9)), "right_thenar", "live_palm")], FACTS))
    with pytest.raises(BadInput, match="shows a palm"):
        read_print_file(file)
    both = [SMALL, a_print(NOISE, "right_thenar", "live_palm")]
    data = encode_transaction(both, FACTS)
    file.write_bytes(data)
    assert [one.finger for one in decode_transaction(data)] == ["right_index", "right_thenar"]
    odd = data.replace(b"15.011:NONE", b"15.011:JPEG")  # passed over beside a print
    assert [one.finger for one in decode_transaction(odd)] == ["right_index"]
