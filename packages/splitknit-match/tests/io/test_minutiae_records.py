"""Records of minutiae of ISO/IEC 19794-2:2005 and ANSI/INCITS 378, byte for byte."""

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from numpy.testing import assert_allclose, assert_array_equal

from fmr_samples import (
    ANSI_2009_BYTES,
    ANSI_BYTES,
    ISO_BYTES,
    STANDARDS,
    THREE,
    three_minutiae,
    views,
)
from refusals import bad_input
from splitknit.errors import BadInput
from splitknit_match.records.fmr_bytes import ANSI_2004, ANSI_2009, ISO_2005, standard_of
from splitknit_match.records.minutiae_files import (
    decode_minutiae_record,
    encode_minutiae_record,
    read_minutiae_record,
)
from splitknit_match.records.minutiae_record import FingerView

SAMPLES = {ISO_2005: ISO_BYTES, ANSI_2004: ANSI_BYTES, ANSI_2009: ANSI_2009_BYTES}


def changed(data, place, *values):
    return data[:place] + bytes(values) + data[place + len(values) :]


def test_bytes_are_those_of_the_standards():
    head = (
        "46 4d 52 00  20 32 30 00  00 00 00 30  00 00  01 5e  01 f4  00 c5  00 c5  01 00  02 08"
        " 50 03"
    )
    assert encode_minutiae_record(three_minutiae()) == bytes.fromhex(head + THREE + "00 00")
    thumb = three_minutiae(
        direction_rad=np.deg2rad([90.0, 270.0, 358.0]),
        finger="right_thumb",
        impression="contactless",
        finger_quality=100,
        resolution_ppcm=(197, 198),
    )
    # no product, no device, view 0
    expected = changed(changed(ANSI_BYTES, 12, 0, 0, 0, 0), 27, 0x09)
    assert encode_minutiae_record(thumb, ANSI_2004) == expected
    little = FingerView(
        np.array([10, 63]),
        np.array([20, 79]),
        np.deg2rad([90.0, 0.0]),
        np.array([1, 2]),
        np.array([0, 0]),
        (80, 64),
        finger_quality=0,
        finger="left_little",
        resolution_ppcm=(394, 394),
    )
    expected = changed(ANSI_2009_BYTES, 16, 0, 0, 0)
    for place, *values in ((24, 0, 0, 0x1B), (43, 0), (49, 0)):
        expected = changed(expected, place, *values)
    assert encode_minutiae_record(little, ANSI_2009, owner=0x1B) == expected


def test_fields_are_where_the_standards_have_them():
    first, second = decode_minutiae_record(ISO_BYTES)
    assert_array_equal(first.x_px, [10, 300, 0])
    assert_array_equal(first.y_px, [20, 400, 0])
    assert_allclose(np.rad2deg(first.direction_rad), [90, 270, 358.59375])
    assert_array_equal(first.type, [1, 2, 0])
    assert_array_equal(first.quality, [50, 90, 0])
    assert (first.size, first.resolution_ppcm, first.finger_quality) == ((500, 350), (197, 197), 80)
    assert (first.finger, first.impression) == ("right_index", "swipe")
    assert (second.finger, second.impression, second.count) == ("left_index", "live_plain", 0)
    (view,) = decode_minutiae_record(ANSI_BYTES)
    assert_allclose(np.rad2deg(view.direction_rad), [90, 270, 358])
    assert (view.finger, view.impression, view.finger_quality) == (
        "right_thumb",
        "contactless",
        100,
    )
    assert (view.size, view.resolution_ppcm) == ((500, 350), (197, 198))
    for data in (ANSI_2009_BYTES, changed(ANSI_2009_BYTES, 6, 0x35)):  # amendment 1
        (view,) = decode_minutiae_record(data)
        assert (view.finger, view.impression, view.size, view.finger_quality) == (
            "left_little",
            "contactless",
            (80, 64),
            0,
        )
        assert_array_equal(view.quality, [0, 0])  # 254 and 255: not known


@pytest.mark.parametrize("standard", STANDARDS)
def test_what_is_written_is_read(standard):
    @settings(
        max_examples=30,
        derandomize=True,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(views(standard))
    def check(view):
        data = encode_minutiae_record(view, standard)
        assert standard_of(data) == standard
        (read,) = decode_minutiae_record(data)
        for name in ("x_px", "y_px", "type", "quality"):
            assert_array_equal(getattr(read, name), getattr(view, name))
        turn = np.angle(np.exp(1j * (read.direction_rad - view.direction_rad)))
        assert np.abs(turn).max(initial=0) <= np.deg2rad(1.0001)
        for name in ("finger", "impression", "finger_quality", "size", "resolution_ppcm"):
            assert getattr(read, name) == getattr(view, name), name

    check()


def test_long_records_have_a_length_of_six_bytes():
    body = ANSI_BYTES[10:26] + ANSI_BYTES[26:-2] + (65535).to_bytes(2, "big") + bytes(65535)
    data = ANSI_BYTES[:8] + b"\0\0" + (14 + len(body)).to_bytes(4, "big") + body
    assert decode_minutiae_record(data)[0].count == 3
    with bad_input("truncated"):
        decode_minutiae_record(data[:5000])


def test_files_are_known_by_what_they_hold(tmp_path):
    for data in SAMPLES.values():
        (tmp_path / "minutiae.any").write_bytes(data)
        assert read_minutiae_record(tmp_path / "minutiae.any")[0].count >= 2
    with bad_input("does not exist"):
        read_minutiae_record(tmp_path / "none.iso")


@pytest.mark.parametrize("standard", STANDARDS)
def test_cuts_and_flipped_bits_are_refused_or_read(standard):
    sample = SAMPLES[standard]
    for length in range(1, len(sample)):
        with bad_input(r"truncated|but a record of minutiae is expected") as refused:
            decode_minutiae_record(sample[:length], "cut.iso")
        assert "cut.iso" in str(refused.value)
    for place in range(len(sample)):
        for bit in range(8):
            try:
                decode_minutiae_record(changed(sample, place, sample[place] ^ 1 << bit))
            except BadInput as error:
                assert "\n" not in str(error) and str(error).endswith(".")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ISO_BYTES + b"x", "62 bytes, but its header states 61"),
        (changed(ISO_BYTES, 22, 1), "9 bytes behind its 1 views"),
        (changed(ISO_BYTES, 22, 3), "within the header of view 3"),
        (changed(ISO_BYTES, 22, 0), "1 to 176 views, but this one has 0"),
        (changed(ISO_BYTES, 23, 1), "reserved byte of its header is 1"),
        (changed(ISO_BYTES, 18, 0, 98), "98 x 197 pixels per cm"),
        (changed(ISO_BYTES, 14, 0, 0), "no size or no resolution"),
        (changed(ISO_BYTES, 16, 1, 0x90), "inside their print of 400 x 350 pixels"),
        (changed(ISO_BYTES, 24, 11), "finger position of view 1 of x.iso 11 is not one"),
        (
            changed(ISO_BYTES, 25, 9),
            "impression type of view 1 of x.iso 9 is not one of the standard's codes",
        ),
        (changed(ISO_BYTES, 26, 101), "the quality of view 1 does not lie between 0 and 100"),
        (changed(ISO_BYTES, 27, 255), "within the 255 minutiae of view 1"),
        (changed(ISO_BYTES, 28, 0xC0), "types of minutiae are"),
        (changed(ISO_BYTES, 30, 0x40), "reserved bits"),
        (changed(ISO_BYTES, 33, 101), "qualities of minutiae"),
        (changed(ISO_BYTES, 46, 0xFF), "within the extended data of view 1"),
        (ANSI_BYTES[:8] + b"\0\0\0\0\0\x36" + ANSI_BYTES[10:], "in six bytes where two would do"),
        (changed(ANSI_BYTES, 10, 0, 0), "owner of its product is 0"),
        (changed(ANSI_BYTES, 34, 180), "not one of 180 steps"),
        (changed(ANSI_2009_BYTES, 20, 1), "19794-2:2011, which is not read"),
        (changed(ANSI_2009_BYTES, 22, 16), "from 0 to 15"),
        (changed(ANSI_2009_BYTES, 24, 253), "the quality of view 1"),
        (changed(ANSI_2009_BYTES, 33, 0, 0), "no size or no resolution"),
        (b"FMR\x00040\0" + bytes(30), "unknown version b'040"),
        (
            b"\x7f\x60\x45" + bytes(20) + ISO_BYTES,
            r"an envelope \(CBEFF\?\) with a minutiae record inside, 23 bytes",
        ),
        (b"FIR\x00010\0" + bytes(30), "finger image record"),
        (b"SKTMPL\r\n\1\0", "template of splitknit"),
        (b"anything", "does not begin with 'FMR'"),
        (b"", "is empty, but"),
    ],
)
def test_what_the_standards_do_not_allow_is_named(data, words):
    with bad_input(words) as refused:
        decode_minutiae_record(data, "x.iso")
    assert "x.iso" in str(refused.value)


def test_counts_that_lie_cost_nothing():
    """A header may claim 255 views of 255 minutiae: nothing is made before it is there."""
    claims = [
        b"FMR\0 20\0" + bytes(4) + b"\0\0\1\0\1\0\0\xc5\0\xc5\xff\0" + b"\1\0\0\xff" * 3,
        b"FMR\0 20\0\xff\xff\xff\xff" + bytes(100),
        b"FMR\x00030\0\xff\xff\xff\xff\xff\xff\1" + b"\0\0\0\x22" * 5000,
        b"FMR" + b"\0" * 2_000_000,
    ]
    tracemalloc.start()
    began = time.process_time()
    for data in claims:
        with bad_input():
            decode_minutiae_record(data)
    assert time.process_time() - began < 2
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()


def test_contactless_is_written_as_what_it_imitates():
    for impression, name in (("contactless", "live_plain"), ("contactless_rolled", "live_rolled")):
        data = encode_minutiae_record(three_minutiae(impression=impression))
        assert decode_minutiae_record(data)[0].impression == name


def test_what_cannot_be_said_is_not_written():
    view = three_minutiae()
    names = ("x_px", "y_px", "direction_rad", "type", "quality")
    many = three_minutiae(**{name: np.resize(getattr(view, name), 300) for name in names})
    for wrong, words in [
        (three_minutiae(resolution_ppcm=(98, 98)), "at least 99"),
        (three_minutiae(impression="other"), "'other' has no code"),
    ]:
        with bad_input(words):
            encode_minutiae_record(wrong)
    assert decode_minutiae_record(encode_minutiae_record(many))[0].count == 255
    assert_array_equal(view.best(2).quality, [50, 90])
