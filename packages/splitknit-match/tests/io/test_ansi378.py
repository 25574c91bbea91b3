"""Records of ANSI/INCITS 378-2004 and -2009, byte for byte."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from fmr_samples import ANSI_2009_BYTES, ANSI_BYTES, ISO_BYTES, three_minutiae
from splitknit.errors import BadInput
from splitknit_match.records.fmr_bytes import ANSI_2004, ANSI_2009, ANSI_2009_AM1
from splitknit_match.records.minutiae_files import (
    decode_minutiae_record,
    encode_minutiae_record,
    read_minutiae_record,
)
from splitknit_match.records.minutiae_record import FingerView, MinutiaeRecord

encode_2004, encode_2009 = (partial(encode_minutiae_record, standard=one) for one in (ANSI_2004, ANSI_2009))
decode_2004, decode_2009 = (partial(decode_minutiae_record, standard=one) for one in (ANSI_2004, ANSI_2009))


def contactless_thumb() -> MinutiaeRecord:
    view = three_minutiae(
        direction_rad=np.deg2rad([90.0, 270.0, 358.0]),
        finger="right_thumb",
        impression="contactless",
        finger_quality=100,
        view=3,
        resolution_ppcm=(197, 198),
    )
    return MinutiaeRecord((view,), device=5, certification=1, product=(0x0103, 7))


def test_bytes_are_those_of_the_standard() -> None:
    assert encode_2004(contactless_thumb()).hex(" ") == ANSI_BYTES.hex(" ")


def test_fields_are_where_the_standard_has_them() -> None:
    record = decode_2004(ANSI_BYTES)
    assert (record.device, record.certification, record.product, record.standard) == (5, 1, (0x0103, 7), ANSI_2004)
    (view,) = record.views
    np.testing.assert_allclose(np.rad2deg(view.direction_rad), [90, 270, 358])
    assert (view.finger, view.impression, view.view, view.finger_quality) == ("right_thumb", "contactless", 3, 100)
    assert (view.size, view.resolution_ppcm) == ((500, 350), (197, 198))
    assert encode_2004(record) == ANSI_BYTES


def test_directions_are_rounded_to_two_degrees() -> None:
    view = three_minutiae(direction_rad=np.deg2rad([359.5, -3.0, 0.9]))
    read = decode_2004(encode_2004(MinutiaeRecord((view,)))).views[0]
    np.testing.assert_allclose(np.rad2deg(read.direction_rad), [0, 356, 0], atol=1e-9)


def test_long_records_have_a_length_of_six_bytes() -> None:
    views = [three_minutiae(view=k, extended=bytes(40_000)) for k in range(2)]
    record = MinutiaeRecord(tuple(views), standard=ANSI_2004)
    data = encode_2004(record)
    assert data[8:10] == b"\0\0"
    assert int.from_bytes(data[10:14], "big") == len(data) == 30 + 2 * (6 + 18 + 40_000)
    assert encode_2004(decode_2004(data)) == data
    fitting = MinutiaeRecord((three_minutiae(extended=bytes(65535 - 50)),), standard=ANSI_2004)
    assert encode_2004(fitting)[8:10] == b"\xff\xff"
    with pytest.raises(BadInput, match="truncated"):
        decode_2004(data[:5000])


def test_every_truncation_is_named() -> None:
    for length in range(1, len(ANSI_BYTES)):
        with pytest.raises(BadInput, match="truncated"):
            decode_2004(ANSI_BYTES[:length])


def changed(place: int, *values: int, of: bytes = ANSI_BYTES) -> bytes:
    data = bytearray(of)
    data[place : place + len(values)] = bytes(values)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ISO_BYTES, "a record of ISO/IEC 19794-2:2005, but one of ANSI/INCITS 378-2004 is expected"),
        (ANSI_2009_BYTES, "a record of ANSI/INCITS 378-2009, but one of ANSI/INCITS 378-2004"),
        (ANSI_BYTES[:8] + b"\0\0\0\0\0\x36" + ANSI_BYTES[10:], "in six bytes where two would do"),
        (changed(10, 0, 0), "owner of its product is 0"),
        (changed(25, 7), "reserved byte of its header is 7"),
        (changed(34, 180), "not one of 180 steps"),
        (changed(27, 0x30 | 7), "impression type of view 1 of .* 7 is not one"),
        (ANSI_BYTES + b"\0", "51 bytes, but its header states 50"),
    ],
)
def test_what_the_standard_does_not_allow_is_named(data: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        decode_2004(data)


def little_finger() -> MinutiaeRecord:
    view = FingerView(
        np.array([10, 63]),
        np.array([20, 79]),
        np.deg2rad([90.0, 0.0]),
        np.array([1, 2]),
        np.array([254, 255]),
        (80, 64),
        finger_quality=254,
        finger="left_little",
        resolution_ppcm=(394, 394),
    )
    return MinutiaeRecord((view,), device=0xABCD, certification=0x80, product=(0x1B, 0))


def test_2009_bytes_are_those_of_the_standard() -> None:
    assert encode_2009(little_finger()).hex(" ") == ANSI_2009_BYTES.hex(" ")
    record = decode_2009(ANSI_2009_BYTES)
    (view,) = record.views
    assert (record.device, record.certification, record.product) == (0xABCD, 0x80, (0x1B, 0))
    assert (view.finger, view.impression, view.finger_quality) == ("left_little", "contactless", 254)
    assert (view.size, view.resolution_ppcm, view.quality_algorithm) == ((80, 64), (394, 394), (0x0103, 1))
    np.testing.assert_array_equal(view.quality, [254, 255])
    assert encode_2009(record) == ANSI_2009_BYTES


def test_the_amendment_differs_in_its_version() -> None:
    data = encode_minutiae_record(little_finger(), ANSI_2009_AM1)
    assert data == ANSI_2009_BYTES[:6] + b"5" + ANSI_2009_BYTES[7:]
    assert decode_minutiae_record(data).standard == ANSI_2009_AM1
    assert decode_2009(ANSI_2009_BYTES).standard == ANSI_2009


def test_views_of_2009_may_differ_in_size() -> None:
    first = little_finger().views[0]
    second = dataclasses.replace(first, size=(90, 70), resolution_ppcm=(197, 197), finger="left_ring")
    read = decode_2009(encode_2009(MinutiaeRecord((first, second))))
    assert [view.size for view in read.views] == [(80, 64), (90, 70)]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ISO_BYTES, "a record of ISO/IEC 19794-2:2005"),
        (ANSI_BYTES, "a record of ANSI/INCITS 378-2004"),
        (changed(12, 0, 0, of=ANSI_2009_BYTES), "owner of its product is 0"),
        (changed(20, 1, of=ANSI_2009_BYTES), "reserved byte"),
        (changed(22, 16, of=ANSI_2009_BYTES), "from 0 to 15"),
        (changed(23, 9, of=ANSI_2009_BYTES), "impression type of view 1"),
        (changed(24, 253, of=ANSI_2009_BYTES), "finger's quality must lie between 0 and 100, but it is .253"),
        (changed(25, 0, 0, of=ANSI_2009_BYTES), "vendor of the quality"),
        (changed(33, 0, 0, of=ANSI_2009_BYTES), "between 1 and 65535"),
    ],
)
def test_what_2009_does_not_allow_is_named(data: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        decode_2009(data)


def test_files_are_known_by_what_they_hold(tmp_path: Path) -> None:
    amended = ANSI_2009_BYTES[:6] + b"5" + ANSI_2009_BYTES[7:]
    for data in (ISO_BYTES, ANSI_BYTES, ANSI_2009_BYTES, amended):
        (tmp_path / "minutiae.any").write_bytes(data)
        assert read_minutiae_record(tmp_path / "minutiae.any").views[0].count >= 2
    (tmp_path / "minutiae.any").write_bytes(b"FMR\x00030\0" + bytes([0, 0, 0, 49, 0, 1, 0, 0, 0, 0, 34]) + bytes(30))
    with pytest.raises(BadInput, match="minutiae of view 1 have 0 bytes; 5 or 6"):
        read_minutiae_record(tmp_path / "minutiae.any")
    (tmp_path / "minutiae.any").write_bytes(b"GIF89a")
    with pytest.raises(BadInput, match="no minutiae record"):
        read_minutiae_record(tmp_path / "minutiae.any")


@pytest.mark.parametrize("encode", [encode_2004, encode_2009])
def test_products_need_an_owner(encode) -> None:
    with pytest.raises(BadInput, match="owner must lie between 1 and 65535"):
        encode(dataclasses.replace(contactless_thumb(), product=(0, 0)))
