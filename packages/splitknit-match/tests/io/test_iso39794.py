"""Finger images of ISO/IEC 39794-4: DER typed by hand, what comes back, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.records.pictures import PrintFile

pytest.importorskip("asn1tools")

from splitknit_match.records.iso39794 import decode_finger_image_block, encode_finger_image_block

SMALL = np.arange(120, dtype=np.uint8).reshape(12, 10)
PGM = b"P5\n10 12\n255\n" + SMALL.tobytes()


def tlv(tag, *parts):
    content = b"".join(parts)
    size = len(content)
    length = (
        bytes([size])
        if size < 128
        else b"\x81" + bytes([size])
        if size < 256
        else b"\x82" + size.to_bytes(2, "big")
    )
    return bytes.fromhex(tag) + length + content


def typed(*more, quality=True, image=PGM):
    """A right index, contactless, PGM, quality 63 by algorithm 1 of owner 0x0123, 500 a inch."""
    version = tlv("a0", tlv("80", b"\3"), tlv("81", b"\x07\xe3"))
    scored = tlv(
        "a6",
        tlv("30", tlv("a0", tlv("80", b"\1\x23"), tlv("81", b"\1")), tlv("a1", tlv("80", b"\x3f"))),
    )
    fields = [
        tlv("a0", tlv("80", b"\2")),
        tlv("a1", tlv("80", b"\x18")),
        tlv("a2", tlv("80", b"\0")),
        tlv("83", image),
        scored if quality else b"",
        tlv("a7", tlv("80", b"\x01\xf4"), tlv("81", b"\0")),
        *more,
    ]
    return tlv("64", version, tlv("a1", tlv("30", *fields)))


def item(finger="right_index", impression="contactless", ppi=500.0):
    return PrintFile(SMALL, ppi, {}, finger, impression)


def test_bytes_are_those_of_the_encoding_rules():
    assert encode_finger_image_block(item(), quality=63, owner=0x0123).hex(" ") == typed().hex(" ")
    assert encode_finger_image_block(item()).hex(" ") == typed(quality=False).hex(" ")


@pytest.mark.parametrize("compression", ["none", "png", "jp2"])
def test_images_come_back(compression):
    images = [
        item(),
        item("left_thumb", "live_rolled", 1000.0),
        item("unknown", "contactless_moving"),
    ]
    for a in (replace(image, image=np.tile(SMALL, (20, 20))) for image in images):
        (b,) = decode_finger_image_block(encode_finger_image_block(a, compression))
        np.testing.assert_array_equal(a.image, b.image)
        assert (a.finger, a.impression, a.resolution_ppi) == (
            b.finger,
            b.impression,
            b.resolution_ppi,
        )


def test_what_others_may_add_is_passed_over():
    """A rotation, annotations, a later edition's field; an extension block with its fallback; an
    indefinite length."""
    more = tlv("89", b"\5"), tlv("ad", tlv("30", tlv("80", b"\1"))), tlv("9f1f", b"xyz")
    (image,) = decode_finger_image_block(typed(*more))
    assert (image.finger, image.resolution_ppi) == ("right_index", 500)
    extended = typed().replace(
        tlv("a1", tlv("80", b"\x18")), tlv("a1", tlv("a1", tlv("80", b"\x18")))
    )
    extended = bytes([0x64, 0x81, extended[2] + 2]) + extended[3:]
    place = extended.index(b"\xa1\x81", 3)
    inner = bytearray(extended)
    inner[place + 2] += 2
    inner[place + 5] += 2
    (image,) = decode_finger_image_block(bytes(inner))
    assert image.impression == "contactless"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "or damaged"),
        (typed() + b"\0", "or damaged"),
        (typed(image=b"P5\n10 13\n255\n" + SMALL.tobytes()), "its record states 13 x 10"),
        (typed(image=b"P6\n10 12\n255\n" + SMALL.tobytes()), "not an 8-bit PGM"),
        (typed(image=b"P5\n99999 99999\n255\n"), "more than the 64000000 pixels"),
        (
            typed().replace(bytes.fromhex("a7078002"), bytes.fromhex("a8078002")),
            "gives no resolution",
        ),
        (typed().replace(bytes.fromhex("800103"), bytes.fromhex("800104"), 1), "generation 4"),
    ],
)
def test_what_is_wrong_is_named(data, words):
    with bad_input(words):
        decode_finger_image_block(data)


def test_prints_that_have_no_code_are_refused():
    with bad_input("impression type 'nonlive_plain' has no code"):
        encode_finger_image_block(item(impression="nonlive_plain"))
    with bad_input("must have a resolution"):
        encode_finger_image_block(PrintFile(SMALL, None, {}))
