"""Transactions of ANSI/NIST-ITL: what is read of them, what is refused. Their bytes are made by
hand (fmr_samples)."""

import time

import numpy as np
import pytest

from fmr_samples import transaction, type_14
from refusals import bad_input
from splitknit.io.prints import encode_print_png
from splitknit_match.records.finger_image import encode_jpeg2000
from splitknit_match.records.itl import decode_transaction
from splitknit_match.records.minutiae_record import FINGER_CODES
from splitknit_match.records.wsq_image import encode_wsq

SMALL = np.arange(120, dtype=np.uint8).reshape(10, 12)
LARGE = np.tile(SMALL, (10, 10))
TYPE_2 = b"2.001:17\x1d2.002:0\x1c"


def test_prints_are_read():
    fine = {"THPS": b"1000", "TVPS": b"1000", "IMP": b"1", "FGP": b"10"}
    data = transaction(TYPE_2, type_14(SMALL), type_14(LARGE, **fine), type_14(SMALL, 13, IMP=b"7"))
    plain, rolled, latent = decode_transaction(data)
    assert (plain.finger, plain.impression, plain.resolution_ppi) == (
        "right_index",
        "contactless",
        500,
    )
    assert (rolled.finger, rolled.impression, rolled.resolution_ppi) == (
        "left_little",
        "live_rolled",
        1000,
    )
    assert latent.impression == "latent_lift"
    assert [finding.code for finding in latent.findings] == ["latent-print"]
    for item, image in ((plain, SMALL), (rolled, LARGE), (latent, SMALL)):
        np.testing.assert_array_equal(item.image, image)


@pytest.mark.parametrize("finger", list(FINGER_CODES))
def test_every_finger_has_its_code(finger):
    (item,) = decode_transaction(transaction(type_14(SMALL, FGP=b"%d" % FINGER_CODES[finger])))
    assert item.finger == finger


@pytest.mark.parametrize("code", [b"PNG", b"JP2L", b"JP2", b"WSQ20"])
def test_compressions_are_read(code):
    if code == b"WSQ20":
        pytest.importorskip("_wsq")
    encode = {b"PNG": encode_print_png, b"WSQ20": encode_wsq}.get(code, encode_jpeg2000)
    (item,) = decode_transaction(transaction(type_14(LARGE, CGA=code, DATA=encode(LARGE))))
    assert np.abs(item.image.astype(int) - LARGE).mean() < (6 if code == b"WSQ20" else 1e-9)


def test_pixels_may_hold_separators_and_field_names():
    image = np.frombuffer(
        (b"\x1c\x1d\x1e\x1f14.001:1\x1d14.999:" * 20)[:300], dtype=np.uint8
    ).reshape(15, 20)
    for item in decode_transaction(transaction(type_14(image), type_14(image))):
        np.testing.assert_array_equal(item.image, image)


def test_pixels_per_cm_are_read():
    (item,) = decode_transaction(transaction(type_14(SMALL, SLC=b"2", THPS=b"394", TVPS=b"394")))
    assert item.resolution_ppi == pytest.approx(394 * 2.54)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"HLL": b"13"}, "holds 120 pixels, but its record states 10 x 13"),
        ({"HLL": b"-1"}, "whole number of at most 5 digits"),
        ({"HLL": b"123456"}, "whole number"),
        ({"HLL": b"99999", "VLL": b"99999"}, "more than the 64000000 pixels"),
        ({"HLL": b""}, "lacks the field 6"),
        ({"SLC": b"0"}, "no resolution"),
        ({"TVPS": b"501"}, "square pixels"),
        ({"THPS": b"100", "TVPS": b"100"}, "490 to 5080 ppi, not 100"),
        ({"CGA": b"JP2"}, "not a JPEG 2000 image"),
        ({"CGA": b"JPEGB"}, "compressed as 'JPEGB'; NONE, WSQ20, PNG, JP2L"),
        ({"CGA": b"PNG"}, "PNG"),
        ({"CGA": b"WSQ20"}, "not a WSQ file"),
        ({"BPX": b"16"}, "not 8-bit grey"),
        ({"FGP": b"13"}, "finger position 13 is not one"),
        ({"IMP": b"9"}, "impression type 9 is not one"),
        ({"DATA": b"abc"}, "holds 3 pixels"),
        ({"DATA": b""}, "holds no image"),
    ],
)
def test_fields_that_do_not_fit_are_named(changes, words):
    with bad_input(words) as refused:
        decode_transaction(transaction(type_14(SMALL, **changes)), "t.an2")
    assert "t.an2" in str(refused.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (transaction(type_14(SMALL)) + b"x", "no record begins at byte"),
        (transaction(TYPE_2), "holds no print"),
        (transaction(type_14(SMALL)).replace(b"14.007:", b"14,007:"), "lacks the field 11"),
        (b"", "does not begin with '1.001:'"),
        (b"FMR\0 20\0", "does not begin with '1.001:'"),
        (b"1.001:5\x1d", "truncated"),
        (b"1.001:0\x1d", "truncated"),
        (b"1.001:10\x1d\0", "does not end where"),
        (b"1.001:9999999999\x1d", "truncated: its Type-1 record has 9999999999 bytes"),
        (b"14.001:9\x1d\x1c", "must begin with its only Type-1"),
    ],
)
def test_broken_frames_are_refused(data, words):
    with bad_input(words):
        decode_transaction(data)


def test_every_cut_is_refused():
    data = transaction(type_14(SMALL), type_14(SMALL))
    whole = {len(transaction(type_14(SMALL)))}  # a sound transaction of one print
    for length in set(range(len(data))) - whole:
        with bad_input():
            decode_transaction(data[:length])


def test_many_records_take_no_time():
    began = time.process_time()
    with bad_input("more than 1000 records"):
        decode_transaction(transaction(*[TYPE_2] * 100_000))
    assert time.process_time() - began < 2


def type_4(finger=2, scale=0, code=0, pixels=SMALL):
    head = bytes([1, 1, finger, 255, 255, 255, 255, 255, scale, 0, 12, 0, 10, code])
    body = head + bytes(pixels)
    return (4 + len(body)).to_bytes(4, "big") + body


def with_type_4(*records):
    content = b"1\x1f%d" % len(records) + b"".join(
        b"\x1e4\x1f%d" % (number + 1) for number in range(len(records))
    )
    return transaction(*records, content=content)


def test_binary_records_are_read():
    """Rolled prints of Type-4, at 500 ppi or the native resolution; four fingers at once are passed
    over."""
    prints = decode_transaction(with_type_4(type_4(), type_4(13), type_4(7, scale=1)))
    assert [item.finger for item in prints] == ["right_index", "left_index"]
    assert [round(item.resolution_ppi or 0) for item in prints] == [500, 1000]
    for item in prints:
        assert item.impression == "live_rolled"
        np.testing.assert_array_equal(item.image, SMALL)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (with_type_4(type_4())[:-1], "truncated"),
        (with_type_4((8).to_bytes(4, "big") + b"abcd"), "holds no image"),
        (with_type_4(type_4(14)), "no print of a single finger"),
        (with_type_4(type_4(code=9)), "compressed by code 9"),
        (with_type_4(type_4(pixels=b"xyz")), "holds 3 pixels"),
        (with_type_4(type_4(scale=1)).replace(b"1.011:39.37", b"1.011:00.00"), "ppi"),
    ],
)
def test_broken_binary_records_are_refused(data, words):
    with bad_input(words):
        decode_transaction(data, "x.an2")
