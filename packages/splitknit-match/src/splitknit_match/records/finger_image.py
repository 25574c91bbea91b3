"""Finger image records of ISO/IEC 19794-4:2005; ``docs/reference/records.md`` has what is written.

Source: ISO/IEC 19794-4:2005, clause 7.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import require
from splitknit.io.images import decode_image, decoded
from splitknit.io.prints import encode_print_png
from splitknit.model import GreyArray
from splitknit_match.records.fmr_bytes import Cursor, check_length
from splitknit_match.records.minutiae_record import (
    ANSI_2004_IMPRESSIONS,
    FINGER_CODES,
    name_of,
    standard_code,
)
from splitknit_match.records.pictures import PrintFile
from splitknit_match.records.wsq_image import decode_wsq, encode_wsq

MAGIC = b"FIR\0"
_V2005 = b"010\0"
_PARAMETERS = struct.Struct(">HHBBHHHHBBH")
"""Layout of the header of 2005, from the capture device on."""
_VIEW = struct.Struct(">IBBBBBHHB")
_HEADER_BYTES = 14 + _PARAMETERS.size
"""Bytes of the header. Source: ISO/IEC 19794-4:2005."""
WRITTEN = ("none", "png", "wsq", "jp2")
"""Compressions; ``jp2`` is JPEG 2000 without loss."""
_CODES = {"none": 0, "wsq": 2, "jpeg": 3, "jp2": 4, "png": 5}
_LEVELS = {500: 30, 1000: 40}
"""Acquisition levels of 8 bits, by pixels per inch, of devices that nobody certified (31 and 41:
certified)."""
_NO_QUALITY = 254
"""The only value that the standard has for the quality: not defined. Source: ISO/IEC 19794-4:2005.
"""
_CM_PER_INCH = 2.54
"""Source: definition of the inch."""
_IMPRESSIONS = {**ANSI_2004_IMPRESSIONS, "unknown": 29}
_NEAREST = {"contactless_rolled": "contactless", "unknown": "live_plain", "other": "live_plain"}
"""Impression types without a code, and what is written for them."""


def encode_finger_image(item: PrintFile, compression: str = "none") -> bytes:
    """Bytes of a record of ISO/IEC 19794-4:2005 of one print, of 500 or 1000 ppi.

    `compression`: ``none``, ``png``, ``jp2`` or ``wsq`` (which loses a little, and is for 500 ppi
    alone). No device is said to be certified, no quality stated. Raises BadInput if the standard
    cannot state what it is.

    >>> import numpy as np
    >>> len(encode_finger_image(PrintFile(np.zeros((20, 10), np.uint8), 500.0, {})))
    246
    """
    ppi = round(item.resolution_ppi or 0)
    require(
        ppi in _LEVELS,
        "the image of a finger image record has 500 or 1000 ppi; resample the print.",
    )
    rows, columns = item.image.shape
    require(
        item.image.dtype == np.uint8 and min(rows, columns) > 0 and max(rows, columns) <= 65535,
        f"a print must be (H, W) uint8, at most 65535 pixels each way, not {item.image.shape}"
        f" {item.image.dtype}.",
    )
    finger = standard_code(item.finger, FINGER_CODES, "finger")
    impression = _NEAREST.get(item.impression, item.impression)
    kind = standard_code(impression, ANSI_2004_IMPRESSIONS, "impression type")
    data = encode_print(item.image, float(ppi), compression)
    view = (
        _VIEW.pack(_VIEW.size + len(data), finger, 1, 1, _NO_QUALITY, kind, columns, rows, 0) + data
    )
    parameters = _PARAMETERS.pack(
        0, _LEVELS[ppi], 1, 1, ppi, ppi, ppi, ppi, 8, _CODES[compression], 0
    )
    return MAGIC + _V2005 + (_HEADER_BYTES + len(view)).to_bytes(6, "big") + parameters + view


MAX_PIXELS = 64_000_000  # of all images of a file together
_MAX_IMAGES = 1000  # of a file


def decode_finger_images(data: bytes, name: str = "the record") -> tuple[PrintFile, ...]:
    """Read the images of a record of ISO/IEC 19794-4:2005.

    Raises BadInput, with `name`, if `data` is another file, truncated or damaged, claims more than
    64 million pixels, or an image is not 8-bit grey, has no square pixels, or is compressed
    otherwise than by WSQ, JPEG, JPEG 2000 or PNG.
    """
    require(
        data[:4] == MAGIC,
        f"{name} is not a finger image record (they begin with 'FIR'); name another file.",
    )
    require(
        data[4:8] == _V2005,
        f"{name} is a finger image record of an unknown version {data[4:8]!r}; 010 (of 2005) is"
        " read: convert it.",
    )
    cursor = Cursor(data, name, 8)
    check_length(data, int.from_bytes(cursor.take(6, "its header"), "big"), name)
    _, _, _, unit, _, _, x, y, bits, code, _ = cursor.unpack(_PARAMETERS, "its header")
    ppi = ppi_of(unit, x, y, name)
    usual = (
        float(level)
        for level in _LEVELS
        if round(level / _CM_PER_INCH) == round(ppi / _CM_PER_INCH)
    )
    ppi = next(usual, ppi)
    require(bits == 8, f"{name} has {bits} bits a pixel; 8-bit grey is read.")
    compression = compression_of(code, {number: words for words, number in _CODES.items()}, name)
    prints: list[PrintFile] = []
    left = MAX_PIXELS
    while cursor.place < len(data) and len(prints) < _MAX_IMAGES:
        what = f"image {len(prints) + 1}"
        length, finger, _, _, _, impression, columns, rows, _ = cursor.unpack(
            _VIEW, f"the header of {what}"
        )
        require(
            length >= _VIEW.size,
            f"{name} is damaged: {what} states a length of {length} bytes; copy it again.",
        )
        stored = cursor.take(length - _VIEW.size, f"the pixels of {what}")
        where = f"{what} of {name}"
        image = decode_print(stored, compression, where, size=(rows, columns), limit=left)
        left -= image.size
        position = name_of(finger, FINGER_CODES, f"finger position of {where}")
        prints.append(PrintFile(image, ppi, {}, position, impression_of(impression, _IMPRESSIONS)))
    require(
        prints and cursor.place == len(data),
        f"{name} is damaged: it holds no image, or more than {_MAX_IMAGES}.",
    )
    return tuple(prints)


def ppi_of(unit: int, x: int, y: int, name: str) -> float:
    """Resolution as records state it, in pixels per inch (`unit` 1) or centimetre (2), along
    columns and rows."""
    require(
        unit in (1, 2) and x > 0,
        f"{name} gives no resolution (scale units {unit}; 1 or 2 is expected).",
    )
    require(x == y, f"{name} has {x} pixels along and {y} across; square pixels are expected.")
    return float(x) if unit == 1 else x * _CM_PER_INCH


def compression_of(code: int, codes: Mapping[int, str], name: str) -> str:
    """Compression, as :func:`decode_print` names it, of a record's code."""
    if code not in codes:
        raise BadInput(
            f"{name} is compressed by code {code}; none, WSQ, JPEG 2000, PNG and some JPEG are"
            " read."
        )
    return codes[code]


def decode_print(
    stored: bytes,
    compression: str,
    name: str,
    *,
    size: tuple[int, int] | None,
    limit: int,
) -> GreyArray:
    """Decode a print as records hold it: ``none``, ``wsq``, ``jp2`` or a picture file, of at most
    `limit` pixels.

    `size`: rows and columns as its record states them, needed for ``none``. Raises BadInput if it
    has another size, is not 8-bit grey, or is damaged.
    """
    fault = f"{name} makes more than the {MAX_PIXELS} pixels that are read; split the record."
    expected = ""
    if size is not None:
        rows, columns = size
        expected = f", but its record states {rows} x {columns}"
        require(rows * columns <= limit, fault)
        limit = rows * columns
        if compression == "none":
            require(len(stored) == limit > 0, f"{name} holds {len(stored)} pixels{expected}.")
            return np.frombuffer(stored, dtype=np.uint8).reshape(size).copy()
    if compression == "wsq":
        image = decode_wsq(stored, name).image
    elif compression == "jp2":
        image = decode_jpeg2000(stored, name, limit)
    else:
        pixels = decode_image(stored, name, max_pixels=limit)
        require(
            pixels.shape[2] == 1 and pixels.dtype == np.uint8,
            f"{name} is not 8-bit grey; convert it.",
        )
        image = pixels[..., 0].astype(np.uint8)
    require(
        size in (None, image.shape),
        f"{name} holds {image.shape[0]} x {image.shape[1]} pixels{expected}.",
    )
    require(image.size <= limit, fault)
    return image


def impression_of(code: int, codes: Mapping[str, int]) -> str:
    """Name of an impression type, ``unknown`` where `codes` have none."""
    # latent ones, for example
    return next((words for words, known in codes.items() if known == code), "unknown")


def encode_print(image: GreyArray, ppi: float, compression: str) -> bytes:
    """Encode a print (H, W) for a record, by one of `WRITTEN`. Raises BadInput if WSQ cannot hold
    it."""
    require(
        compression in WRITTEN,
        f"'{compression}' is not a compression method; choose one of {', '.join(WRITTEN)}.",
    )
    if compression == "wsq":
        return encode_wsq(image, ppi)
    if compression == "jp2":
        return encode_jpeg2000(image)
    return (
        encode_print_png(image, ppi)
        if compression == "png"
        else np.ascontiguousarray(image).tobytes()
    )


_SMALLEST = 32
"""Pixels of a print's shorter side at least. Source: JPEG 2000, five halvings."""


def encode_jpeg2000(image: NDArray[np.uint8]) -> bytes:
    """Compress a print (H, W) uint8 as JPEG 2000 (a JP2 file) without loss; BadInput below 32
    pixels a side."""
    require(
        min(image.shape) >= _SMALLEST,
        f"a print of {image.shape[0]} x {image.shape[1]} pixels is too small for JPEG 2000; choose"
        " PNG.",
    )
    return cv2.imencode(".jp2", image, [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000])[1].tobytes()


def decode_jpeg2000(data: bytes, name: str, max_pixels: int) -> NDArray[np.uint8]:
    """Decode a print (H, W) of JP2 or its code stream. BadInput if damaged, not 8-bit grey, or
    above `max_pixels`."""
    start = data.find(b"\xff\x4f\xff\x51")  # the code stream begins with its sizes
    head = data[start + 8 : start + 43]
    require(
        start >= 0 and len(head) == 35,
        f"{name} is not a JPEG 2000 image, or truncated; copy it again.",
    )
    right, down, left, up, *_, components = struct.unpack_from(">IIIIIIIIH", head)
    rows = down - up
    columns = right - left
    require(
        rows > 0 and columns > 0 and rows * columns <= max_pixels,
        f"{name} claims {rows} x {columns} pixels.",
    )
    require(components == 1 and head[34] == 7, f"{name} is not 8-bit grey; convert it.")
    image = decoded(data, name)
    require(
        image.shape == (rows, columns, 1) and image.dtype == np.uint8,
        f"{name} is damaged; copy it again.",
    )
    return image[..., 0]
