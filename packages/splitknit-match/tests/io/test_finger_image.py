"""Finger image records, byte by byte: written as ISO/IEC 19794-4:2005 has it, read in three
layouts."""

import struct

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.records.finger_image import decode_finger_images, encode_finger_image
from splitknit_match.records.pictures import PrintFile

SMALL = np.arange(120, dtype=np.uint8).reshape(12, 10)
TYPED = bytes.fromhex(
    "46495200 30313000 0000000000a6 0000 001e 01 01 01f4 01f4 01f4 01f4 08 00 0000"
    "00000086 02 01 01 fe 09 000a 000c 00"
) + bytes(range(120))  # fmt: skip
"""One image of a right index, contactless, 500 ppi, not compressed: typed by the tables."""


def item(image=SMALL, ppi=500.0, finger="right_index", impression="contactless"):
    return PrintFile(image, ppi, {}, finger, impression)


def test_bytes_are_those_of_the_tables():
    assert encode_finger_image(item()) == TYPED


@pytest.mark.parametrize("compression", ["none", "png", "wsq"])
def test_images_come_back(compression):
    if compression == "wsq":
        pytest.importorskip("_wsq")
    rows, columns = np.mgrid[:140, :120]
    image = (127 + 90 * np.sin(0.7 * np.hypot(rows, columns))).astype(np.uint8)
    for a in (item(image), item(image[::-1].copy(), finger="left_thumb", impression="live_rolled")):
        (b,) = decode_finger_images(encode_finger_image(a, compression))
        assert (b.finger, b.impression, b.resolution_ppi, b.image.shape) == (
            a.finger,
            a.impression,
            500,
            a.image.shape,
        )
        assert np.abs(b.image.astype(int) - a.image).mean() < (4 if compression == "wsq" else 1e-9)


def test_the_layouts_of_others_are_read():
    """Two images of 2005; one of 2011 is refused."""
    two = TYPED[:8] + (len(TYPED) + 134).to_bytes(6, "big") + TYPED[14:] + TYPED[32:]
    assert [image.finger for image in decode_finger_images(two)] == ["right_index"] * 2
    with bad_input("of 2005"):
        decode_finger_images(TYPED[:5] + b"2" + TYPED[6:])


def test_pixels_per_cm_are_read():
    metric = bytearray(TYPED)
    metric[19] = 2
    for place in (20, 22, 24, 26):
        metric[place : place + 2] = struct.pack(">H", 394)
    assert decode_finger_images(bytes(metric))[0].resolution_ppi == 1000


def test_cuts_are_refused():
    sample = TYPED
    for length in range(len(sample)):
        with bad_input() as refused:
            decode_finger_images(sample[:length], "x.fir")
        assert "x.fir" in str(refused.value)
    with bad_input("bytes"):
        decode_finger_images(sample + b"\0", "x.fir")


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (29, b"\4", "JPEG 2000"),
        (28, b"\x10", "16 bits a pixel"),
        (19, b"\0", "no resolution"),
        (24, b"\1\0", "square pixels"),
        (41, b"\xff\xff\xff\xff", "more than the 64000000"),
        (41, b"\0\0", "its record states 12 x 0"),
        (43, b"\0\x0d", "holds 120 pixels, but its record states 13 x 10"),
        (36, b"\x0d", "finger position"),  # four fingers at once
        (32, b"\0\0\0\5", "a length of 5 bytes"),
        (4, b"040", "unknown version"),
        (0, b"FAR", "not a finger image record"),
    ],
)
def test_what_does_not_fit_is_named(place, value, words):
    data = TYPED[:place] + value + TYPED[place + len(value) :]
    with bad_input(words):
        decode_finger_images(data, "x.fir")


def test_a_small_file_costs_little():
    """A PNG of 20,000 x 20,000 pixels in a record that states so, and in one that states 10 x
    12."""
    import tracemalloc

    import cv2

    bomb = cv2.imencode(".png", np.zeros((8000, 8000), np.uint8))[1].tobytes()
    for rows, columns in ((12, 10), (60000, 60000)):
        head = struct.pack(">IBBBBBHHB", 14 + len(bomb), 2, 1, 1, 254, 0, columns, rows, 0)
        start = TYPED[:8] + (46 + len(bomb)).to_bytes(6, "big") + TYPED[14:29] + b"\5\0\0"
        tracemalloc.start()
        with bad_input("pixels"):
            decode_finger_images(start + head + bomb, "x.fir")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2_000_000


@pytest.mark.parametrize(
    ("wrong", "compression", "words"),
    [
        (item(ppi=300), "none", "500 or 1000 ppi"),
        (item(), "jpeg", "is not a compression method"),
        (item(SMALL.astype(float)), "none", "uint8"),
        (item(finger="ring"), "none", "'ring' has no code"),
    ],
)
def test_what_cannot_be_written_is_refused(wrong, compression, words):
    with bad_input(words):
        encode_finger_image(wrong, compression)
