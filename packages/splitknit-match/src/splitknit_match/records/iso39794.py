"""Finger images of ISO/IEC 39794-4:2019 in tagged binary encoding (DER written, BER read), by
`asn1tools`.

The module below is our own, of the fields that are public: ISO/IEC 39794-1 publishes its ASN.1;
part 4 is described field by field in the source of JMRTD. What follows the sampling rate of a
representation is passed over. Of part 2 (minutiae) no description is public: it is neither written
nor read.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from splitknit import BadInput
from splitknit.errors import importing, refusing, require
from splitknit_match.records.finger_image import (
    MAX_PIXELS,
    compression_of,
    decode_print,
    encode_print,
    impression_of,
    ppi_of,
)
from splitknit_match.records.minutiae_record import (
    FINGER_CODES,
    VENDOR_UNKNOWN,
    name_of,
    standard_code,
)
from splitknit_match.records.pictures import PrintFile

TAG = b"\x64"
"""First byte: application tag 4, constructed."""
_MODULE = """
FingerImage DEFINITIONS AUTOMATIC TAGS ::= BEGIN
FingerImageDataBlock ::= [APPLICATION 4] SEQUENCE {
  versionBlock SEQUENCE { generation INTEGER, year INTEGER, ... },
  representationBlocks SEQUENCE OF RepresentationBlock, ... }
RepresentationBlock ::= SEQUENCE {
  position Code, impression Code, imageDataFormat Code, imageData OCTET STRING,
  captureDateTimeBlock SEQUENCE { ... } OPTIONAL, captureDeviceBlock SEQUENCE { ... } OPTIONAL,
  qualityBlocks SEQUENCE OF QualityBlock OPTIONAL,
  spatialSamplingRateBlock SEQUENCE {
    samplesPerUnit INTEGER, unitDimension INTEGER } OPTIONAL, ... }
QualityBlock ::= SEQUENCE {
  algorithmIdBlock SEQUENCE { organization INTEGER, id INTEGER },
  scoreOrError CHOICE { score INTEGER, error SEQUENCE { ... } }, ... }
Code ::= CHOICE { code INTEGER, extensionBlock SEQUENCE { fallback INTEGER, ... } }
END
"""
_IMPRESSIONS = {
    "live_plain": 0,
    "live_rolled": 1,
    "swipe": 8,
    "contactless": 24,
    "contactless_rolled": 25,
    "other": 28,
    "unknown": 29,
    "contactless_moving": 41,
    "contactless_rolled_moving": 42,
}
"""Moving fingers have the codes 42 and 41 in ANSI/NIST-ITL."""
_FORMATS = {"none": 0, "wsq": 1, "jp2": 3, "png": 4}
_READ = {0: "none", 1: "wsq", 2: "jp2", 3: "jp2", 4: "png"}
_PGM = re.compile(rb"P5\s+([0-9]{1,6})\s+([0-9]{1,6})\s+255\s")
_GENERATION = 3
"""Generation of the standard. Source: ISO/IEC 39794-4:2019."""
_YEAR = 2019
"""Year of the standard. Source: ISO/IEC 39794-4:2019."""
_INCH = 0
"""Unit of resolution; centimetres are 1. Source: ISO/IEC 39794-4:2019."""


@cache
def _codec(rules: str) -> Any:
    with importing(
        "ISO/IEC 39794 needs the package asn1tools: pip install 'splitknit-match[records]'."
    ):
        import asn1tools  # type: ignore[import-untyped,import-not-found,unused-ignore]  # an extra
    return asn1tools.compile_string(_MODULE, rules)


def encode_finger_image_block(
    item: PrintFile,
    compression: str = "none",
    *,
    quality: int | None = None,
    owner: int = VENDOR_UNKNOWN,
) -> bytes:
    """Bytes of a FingerImageDataBlock of one print; `compression` as of 19794-4, where ``none`` is
    a PGM file inside.

    `quality`: 0 to 100, by algorithm 1 of `owner`. Raises BadInput if it has no resolution, its
    impression type has no code here, or the package `asn1tools` is not installed.
    """
    ppi = item.resolution_ppi or 0.0
    require(1 <= ppi <= 65535, "a print of a finger image block must have a resolution.")
    head = b"P5\n%d %d\n255\n" % item.image.shape[::-1] if compression == "none" else b""
    block: dict[str, Any] = {
        "position": ("code", standard_code(item.finger, FINGER_CODES, "finger")),
        "impression": ("code", standard_code(item.impression, _IMPRESSIONS, "impression type")),
        "imageData": head + encode_print(item.image, ppi, compression),
        "imageDataFormat": ("code", _FORMATS[compression]),
        "spatialSamplingRateBlock": {"samplesPerUnit": round(ppi), "unitDimension": _INCH},
    }
    if quality is not None:
        score = {
            "algorithmIdBlock": {"organization": owner, "id": 1},
            "scoreOrError": ("score", quality),
        }
        block["qualityBlocks"] = [score]
    document = {
        "versionBlock": {"generation": _GENERATION, "year": _YEAR},
        "representationBlocks": [block],
    }
    return bytes(_codec("der").encode("FingerImageDataBlock", document))


def decode_finger_image_block(data: bytes, name: str = "the record") -> tuple[PrintFile, ...]:
    """Read the images of a FingerImageDataBlock.

    Raises BadInput, with `name`, if it is none, truncated or damaged, claims more than 64 million
    pixels, or an image is not 8-bit grey or states no resolution.
    """
    damaged = (
        f"{name} is not a finger image of ISO/IEC 39794-4 in tagged binary encoding, or damaged;"
        " copy it again."
    )
    require(data[:1] == TAG, damaged)
    codec = _codec("ber")
    with refusing(damaged):
        require(codec.decode_length(data) == len(data), damaged)
        document = codec.decode("FingerImageDataBlock", data)
    blocks = document["representationBlocks"]
    generation = document["versionBlock"]["generation"]
    require(generation == _GENERATION, f"{name} is of generation {generation}; 3 is read.")
    require(blocks, f"{name} holds no image.")
    prints = []
    left = MAX_PIXELS
    for number, block in enumerate(blocks, start=1):
        what = f"image {number} of {name}"
        rate = block.get("spatialSamplingRateBlock", {"samplesPerUnit": 0, "unitDimension": _INCH})
        ppi = ppi_of(
            rate["unitDimension"] + 1, rate["samplesPerUnit"], rate["samplesPerUnit"], what
        )
        stored = bytes(block["imageData"])
        size = None
        compression = compression_of(_code(block["imageDataFormat"]), _READ, what)
        if compression == "none":
            head = _PGM.match(stored)
            if head is None:
                raise BadInput(f"{what} is not an 8-bit PGM image; convert it.")
            stored = stored[head.end() :]
            size = int(head[2]), int(head[1])
        image = decode_print(stored, compression, what, size=size, limit=left)
        left -= image.size
        finger = name_of(_code(block["position"]), FINGER_CODES, f"finger position of {what}")
        impression = impression_of(_code(block["impression"]), _IMPRESSIONS)
        prints.append(PrintFile(image, ppi, {}, finger, impression))
    return tuple(prints)


def _code(choice: tuple[str, Any]) -> int:
    return int(choice[1] if choice[0] == "code" else choice[1]["fallback"])
