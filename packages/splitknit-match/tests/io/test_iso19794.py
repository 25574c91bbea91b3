"""Records of ISO/IEC 19794-2:2005, byte for byte."""

from __future__ import annotations

import dataclasses
import struct
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import fmr_samples
from fmr_samples import ANSI_BYTES, ISO_BYTES, three_minutiae
from splitknit.errors import BadInput
from splitknit.io.atomic import write_file
from splitknit_match.records.fmr_bytes import ISO_2005, ISO_2011, standard_of
from splitknit_match.records.minutiae_files import (
    decode_minutiae_record,
    encode_minutiae_record,
    read_minutiae_record,
)
from splitknit_match.records.minutiae_record import MinutiaeRecord, pixels_per_cm

decode_iso = partial(decode_minutiae_record, standard=ISO_2005)


def sample_record() -> MinutiaeRecord:
    empty = fmr_samples.three_minutiae().best(0)
    return MinutiaeRecord(
        (
            three_minutiae(extended=bytes.fromhex("02210000")),
            dataclasses.replace(
                empty, finger="left_index", impression="live_plain", view=1, finger_quality=0, extended=b"\1\2\3"
            ),
        ),
        device=5,
        certification=8,
        standard=ISO_2005,
    )


def test_bytes_are_those_of_the_standard() -> None:
    assert encode_minutiae_record(sample_record()).hex(" ") == ISO_BYTES.hex(" ")


def test_fields_are_where_the_standard_has_them() -> None:
    record = decode_iso(ISO_BYTES)
    assert (record.device, record.certification, record.standard) == (5, 8, ISO_2005)
    first, second = record.views
    np.testing.assert_array_equal(first.x_px, [10, 300, 0])
    np.testing.assert_array_equal(first.y_px, [20, 400, 0])
    np.testing.assert_allclose(np.rad2deg(first.direction_rad), [90, 270, 358.59375])
    np.testing.assert_array_equal(first.type, [1, 2, 0])
    np.testing.assert_array_equal(first.quality, [50, 90, 0])
    assert (first.size, first.resolution_ppcm, first.finger_quality) == ((500, 350), (197, 197), 80)
    assert (first.finger, first.impression, first.view) == ("right_index", "swipe", 0)
    assert first.extended == bytes.fromhex("02210000")
    assert (second.finger, second.impression, second.view, second.count) == ("left_index", "live_plain", 1, 0)
    assert second.extended == b"\1\2\3"
    assert encode_minutiae_record(record) == ISO_BYTES


def test_a_file_is_written_and_read(tmp_path: Path) -> None:
    file = tmp_path / "new" / "minutiae.iso"
    write_file(file, encode_minutiae_record(sample_record()))
    assert file.read_bytes() == ISO_BYTES
    assert encode_minutiae_record(read_minutiae_record(file)) == ISO_BYTES
    with pytest.raises(BadInput, match="does not exist"):
        read_minutiae_record(tmp_path / "none.iso")


def test_directions_are_rounded_to_the_nearest_step() -> None:
    step = 2 * np.pi / 256
    view = three_minutiae(direction_rad=np.array([63.6 * step, -step, 255.7 * step]))
    read = decode_iso(encode_minutiae_record(MinutiaeRecord((view,)))).views[0]
    np.testing.assert_allclose(read.direction_rad / step, [64, 255, 0])


def test_contactless_is_written_as_what_it_imitates() -> None:
    for impression, name in (("contactless", "live_plain"), ("contactless_rolled", "live_rolled")):
        data = encode_minutiae_record(MinutiaeRecord((three_minutiae(impression=impression),)))
        assert decode_iso(data).views[0].impression == name
    with pytest.raises(BadInput, match="'other' has no code"):
        encode_minutiae_record(MinutiaeRecord((three_minutiae(impression="other"),)))


def test_every_truncation_is_named() -> None:
    for length in range(len(ISO_BYTES)):
        with pytest.raises(BadInput) as refused:
            decode_iso(ISO_BYTES[:length], "cut.iso")
        assert "truncated" in str(refused.value) or (length == 0 and "empty" in str(refused.value)), length
        assert "cut.iso" in str(refused.value)


def changed(place: int, *values: int) -> bytes:
    data = bytearray(ISO_BYTES)
    data[place : place + len(values)] = bytes(values)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ISO_BYTES + b"x", "62 bytes, but its header states 61"),
        (changed(11, 0x44), "header states 68 bytes, but it has 61"),
        (changed(22, 1), "9 bytes behind its 1 views"),
        (changed(22, 3), "within the header of view 3"),
        (changed(22, 0), "37 bytes behind its 0 views"),
        (changed(23, 1), "reserved byte of its header is 1"),
        (changed(18, 0, 98), "98 x 197 pixels per cm"),
        (changed(14, 0, 0), "500 x 0 pixels"),
        (changed(16, 1, 0x90), "outside the image of 400 x 350"),
        (changed(14, 1, 0x2C), "outside the image of 500 x 300"),
        (changed(24, 11), "finger position of view 1 of x.iso 11 is not one"),
        (changed(25, 9), "impression type of view 1 of x.iso 9 is not one of the standard's codes"),
        (changed(26, 101), "quality of view 1 is above 100"),
        (changed(27, 4), "truncated|reserved|within"),
        (changed(27, 255), "within the 255 minutiae of view 1"),
        (changed(28, 0xC0), "reserved type 3"),
        (changed(30, 0x40), "reserved bits"),
        (changed(33, 101), "above 100"),
        (changed(46, 0xFF), "within the extended data of view 1"),
        (changed(52, 2, 0), "two views are both number 0 of the finger 'right_index'"),
        (ANSI_BYTES, "a record of ANSI/INCITS 378-2004, but one of ISO/IEC 19794-2:2005 is expected"),
        (fmr_samples.ANSI_2009_BYTES, "a record of ANSI/INCITS 378-2009"),
        (b"FMR\x00035\0" + bytes(30), "amendment 1"),
        (b"FMR\x00030\0" + struct.pack(">IHBI", 49, 1, 0, 34) + bytes(30), "a record of ISO/IEC 19794-2:2011"),
        (b"FMR\x00040\0" + bytes(30), "unknown version b'040"),
        (b"\x7f\x60\x45" + bytes(20) + ISO_BYTES, r"an envelope \(CBEFF\?\) with a minutiae record inside, 23 bytes"),
        (b"FIR\x00010\0" + bytes(30), "finger image record"),
        (b"\x89PNG\r\n\x1a\n", "a PNG image"),
        (b"\xff\xa0\xff\xa8", "a WSQ image"),
        (b"1.001:200\x1d", "ANSI/NIST-ITL transaction"),
        (b"SKTMPL\r\n\1\0", "template of splitknit"),
        (b"anything", "does not begin with 'FMR'"),
        (b"", "is empty"),
    ],
)
def test_what_the_standard_does_not_allow_is_named(data: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words) as refused:
        decode_iso(data, "x.iso")
    text = str(refused.value)
    assert "x.iso" in text
    assert "\n" not in text


def test_two_views_of_one_number_are_refused() -> None:
    view = three_minutiae()
    with pytest.raises(BadInput, match="both number 0 of the finger 'right_index'"):
        MinutiaeRecord((view, view))


def test_what_cannot_be_said_is_not_written() -> None:
    view = three_minutiae()
    other = dataclasses.replace(view, finger="left_thumb", size=(600, 350))
    many = three_minutiae(
        **{name: np.resize(getattr(view, name), 300) for name in ("x_px", "y_px", "direction_rad", "type", "quality")}
    )
    for record, words in [
        (MinutiaeRecord((view, other)), "one image size"),
        (MinutiaeRecord((many,)), r"at most 255 minutiae, but there are 300; take FingerView.best\(\)"),
        (MinutiaeRecord((three_minutiae(finger_quality=254),)), "quality is 254"),
        (MinutiaeRecord((three_minutiae(extended=b"x"),)), "without_extended"),
        (MinutiaeRecord((three_minutiae(resolution_ppcm=(98, 98)),)), "at least 99"),
        (MinutiaeRecord((view,), device=4096), "between 0 and 4095"),
        (MinutiaeRecord((view,), certification=16), "4 bits"),
    ]:
        with pytest.raises(BadInput, match=words):
            encode_minutiae_record(record)
    assert decode_iso(encode_minutiae_record(MinutiaeRecord((many.best(),)))).views[0].count == 255
    plain = MinutiaeRecord((three_minutiae(extended=b"x"),)).without_extended()
    assert decode_iso(encode_minutiae_record(plain)).views[0].extended == b""


def test_the_best_are_kept_in_their_order() -> None:
    best = three_minutiae().best(2)
    np.testing.assert_array_equal(best.quality, [50, 90])
    np.testing.assert_array_equal(best.x_px, [10, 300])


def test_unknown_qualities_become_zero() -> None:
    view = three_minutiae(quality=np.array([254, 90, 255]))
    read = decode_iso(encode_minutiae_record(MinutiaeRecord((view,)))).views[0]
    np.testing.assert_array_equal(read.quality, [0, 90, 0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"x_px": np.array([1, 2])}, "one length"),
        ({"x_px": np.array([1.5, 2, 3])}, "x_px of minutiae must be whole numbers"),
        ({"x_px": np.array([-1, 2, 3])}, "outside the image"),
        ({"y_px": np.array([1, 500, 3])}, "outside the image of 500 x 350"),
        ({"x_px": np.array([16384, 2, 3]), "size": (500, 20000)}, "16383 is the largest"),
        ({"direction_rad": np.array([np.nan, 0, 0])}, "finite"),
        ({"type": np.array([3, 0, 0])}, "types of minutiae"),
        ({"quality": np.array([101, 0, 0])}, "between 0 and 100, but it is .101"),
        ({"finger_quality": -1}, "the finger's quality"),
        ({"finger": "thumb"}, "'thumb' is not a finger"),
        ({"impression": "ink"}, "'ink' is not an impression type"),
        ({"view": 16}, "from 0 to 15"),
        ({"size": (0, 350)}, "does not fit"),
        ({"resolution_ppcm": (0, 197)}, "between 1 and 65535"),
        ({"extended": bytes(65536)}, "65536 bytes"),
        ({"quality_algorithm": (-1, 0)}, "vendor and algorithm"),
    ],
)
def test_views_are_checked(changes: dict, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        three_minutiae(**changes)


def test_records_without_views_are_refused() -> None:
    with pytest.raises(BadInput, match="1 to 176 views"):
        MinutiaeRecord(())


def test_resolutions_are_whole_pixels_per_cm() -> None:
    assert pixels_per_cm(500) == (197, 197)
    assert pixels_per_cm(1000) == (394, 394)
    for ppi in (0, np.nan, 30_000):
        with pytest.raises(BadInput, match="250 and 25400"):
            pixels_per_cm(ppi)


ISO_2011_BYTES = bytes.fromhex(
    "464d5200 30333000 00000048 0001 00"
    "00000039 ffffffffffffffffff 00 0000 0000 01 50 0103 0001"
    "02 00 00c5 00c5 18 015e 01f4 60 03"
    "400a0014 40 32  812c0190 c0 5a  00000000 ff 00  0000"
)  # fmt: skip
"""Typed by the tables: one view of a right index, contactless, quality 80 by algorithm 1 of nobody registered."""


def test_the_edition_of_2011() -> None:
    view = three_minutiae(impression="contactless")
    data = encode_minutiae_record(MinutiaeRecord((view,)), ISO_2011)
    assert data.hex(" ") == ISO_2011_BYTES.hex(" ")
    assert standard_of(data) == ISO_2011
    record = decode_minutiae_record(data)
    (found,) = record.views
    assert (found.finger_quality, found.impression, found.quality_algorithm) == (80, "contactless", (0x0103, 1))
    np.testing.assert_array_equal(found.x_px, [10, 300, 0])
    assert encode_minutiae_record(record, ISO_2011) == data
    short = bytearray(data[: -2 - 3 * 6])
    short[11], short[18], short[-2] = len(data) - 3, 0x39 - 3, 5 << 4  # five bytes each, no quality
    for k in range(3):
        short += data[-20 + 6 * k : -15 + 6 * k]
    (found,) = decode_minutiae_record(bytes(short) + b"\0\0").views
    assert found.quality.tolist() == [254, 254, 254]


def test_cuts_and_changes_of_2011_are_refused_or_read() -> None:
    for length in range(len(ISO_2011_BYTES)):
        with pytest.raises(BadInput):
            decode_minutiae_record(ISO_2011_BYTES[:length])
    for place in range(8, len(ISO_2011_BYTES)):
        for bit in range(8):
            data = bytearray(ISO_2011_BYTES)
            data[place] ^= 1 << bit
            try:
                decode_minutiae_record(bytes(data))
            except BadInput as error:
                assert "\n" not in str(error)
