"""Files of minutiae, whatever their standard: recognised by what they hold, not by their name."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable

from splitknit.errors import BadInput, naming, read_bytes, require
from splitknit.io.fmr_bytes import (
    ANSI_2004,
    ANSI_2009,
    ANSI_2009_AM1,
    ANSI_STEPS,
    ISO_2005,
    MAGIC_030,
    MAGIC_035,
    MAGIC_20,
    MAX_RECORD_BYTES,
    Cursor,
    ViewCodes,
    check_length,
    check_rest,
    check_writable,
    common_image,
    decode_minutiae,
    decode_views,
    encode_minutiae,
    encode_views,
    make_view,
    require_standard,
    standard_of,
)
from splitknit.io.iso19794 import decode_iso19794
from splitknit.io.minutiae_record import (
    ANSI_2004_IMPRESSIONS,
    ANSI_2009_IMPRESSIONS,
    FAILED,
    FINGER_CODES,
    FingerView,
    MinutiaeRecord,
    name_of,
    standard_code,
)

# Minutiae records of ANSI/INCITS 378-2009 and of its amendment 1 (2010): byte for byte.
#
# Every view has its own image size and resolution, qualities may be 254 (not computed) and 255 (failed). Numbers are
# big-endian; the layout stands in docs/reference/records.md.
#
# Source: ANSI/INCITS 378-2009; ANSI/INCITS 378-2009/AM 1-2010.

_HEADER = struct.Struct(">8sIHHBHBB")
_VIEW = struct.Struct(">BBBBHHHHHHB")
_EXTENDED = struct.Struct(">H")


def encode_ansi378_2009(record: MinutiaeRecord, amendment: bool = False) -> bytes:
    """Bytes of a record; directions are rounded to 2 deg. `record`: what to write; `amendment`: as amendment 1 of 2010,
    which differs in the version alone. Raises BadInput if the standard has no way to say what the record holds.
    """
    standard, magic = (ANSI_2009_AM1, MAGIC_035) if amendment else (ANSI_2009, MAGIC_030)
    check_writable(record, standard, 16, 8)
    owner, kind = _checked_product(record)
    body = b"".join(_encode_view(view) for view in record.views)
    length = _HEADER.size + len(body)
    return _HEADER.pack(magic, length, owner, kind, record.certification, record.device, len(record.views), 0) + body


def decode_ansi378_2009(data: bytes, name: str = "the record") -> MinutiaeRecord:
    """Read the bytes of a record, with or without the amendment; writing it again gives the same bytes. Raises
    BadInput, with `name`, if it is truncated, of another standard, or says what the standard does not allow.
    """
    amended = standard_of(data) == ANSI_2009_AM1
    standard = ANSI_2009_AM1 if amended else ANSI_2009
    require_standard(data, standard, MAGIC_035 if amended else MAGIC_030, name)
    cursor = Cursor(data, name)
    _, length, owner, kind, certification, device, count, reserved = cursor.unpack(_HEADER, "its header")
    check_length(data, length, name)
    require(owner != 0, f"{name}: the owner of its product is 0, which {standard} does not allow.")
    require(reserved == 0, f"{name}: the reserved byte of its header is {reserved}, but it must be 0.")
    views = tuple(_decode_view(cursor, f"view {number}") for number in range(1, count + 1))
    check_rest(cursor, count)
    return naming(name, lambda: MinutiaeRecord(views, device, certification, (owner, kind), standard))


def _encode_view(view: FingerView) -> bytes:
    (rows, columns), impression = view.size, standard_code(view.impression, ANSI_2009_IMPRESSIONS, "impression type")
    require(view.quality_algorithm[0] > 0, "the vendor of the quality's algorithm must not be 0 (0x0103: unknown).")
    minutiae = encode_minutiae(view, ANSI_STEPS, FAILED)
    head = _VIEW.pack(
        FINGER_CODES[view.finger],
        view.view,
        impression,
        view.finger_quality,
        *view.quality_algorithm,
        columns,
        rows,
        *view.resolution_ppcm,
        view.count,
    )
    return head + minutiae + _EXTENDED.pack(len(view.extended)) + view.extended


def _decode_view(cursor: Cursor, what: str) -> FingerView:
    name = cursor.name
    position, number, impression, quality, vendor, algorithm, columns, rows, x_ppcm, y_ppcm, count = cursor.unpack(
        _VIEW, f"the header of {what}"
    )
    table = decode_minutiae(cursor, count, ANSI_STEPS, what)
    (extended,) = cursor.unpack(_EXTENDED, f"the length of the extended data of {what}")
    require(vendor != 0, f"{name}: the vendor of the quality of {what} is 0, which the standard does not allow.")
    fields = {
        "size": (rows, columns),
        "finger_quality": quality,
        "finger": name_of(position, FINGER_CODES, f"finger position of {what} of {name}"),
        "impression": name_of(impression, ANSI_2009_IMPRESSIONS, f"impression type of {what} of {name}"),
        "view": number,
        "resolution_ppcm": (x_ppcm, y_ppcm),
        "quality_algorithm": (vendor, algorithm),
        "extended": cursor.take(extended, f"the extended data of {what}"),
    }
    return make_view(name, what, **table, **fields)


# Minutiae records of ANSI/INCITS 378-2004: byte for byte.
#
# As :mod:`splitknit.io.iso19794`, but for the header, of 26 bytes (30 where the record is longer than 65535), steps of
# 2 deg, and a code for contactless prints.
#
# Source: ANSI/INCITS 378-2004, clause 6.

_START = struct.Struct(">8sH")
_LONG = struct.Struct(">I")
_REST = struct.Struct(">HHHHHHHBB")
_SHORT_LIMIT = 65535
_CODES = ViewCodes(ANSI_2004, ANSI_STEPS, ANSI_2004_IMPRESSIONS, {"contactless_rolled": "contactless"})


def encode_ansi378(record: MinutiaeRecord) -> bytes:
    """Bytes of a record; directions are rounded to 2 deg. BadInput if the standard cannot say what the record holds."""
    check_writable(record, ANSI_2004, 12, 4)
    (rows, columns), resolution = common_image(record, ANSI_2004)
    owner, kind = _checked_product(record)
    body = encode_views(record.views, _CODES)
    device = record.certification << 12 | record.device
    rest = _REST.pack(owner, kind, device, columns, rows, *resolution, len(record.views), 0)
    length = _START.size + len(rest) + len(body)
    if length <= _SHORT_LIMIT:
        return _START.pack(MAGIC_20, length) + rest + body
    return _START.pack(MAGIC_20, 0) + _LONG.pack(length + _LONG.size) + rest + body


def decode_ansi378(data: bytes, name: str = "the record") -> MinutiaeRecord:
    """Read the bytes of a record; writing it again gives the same bytes. `data`: the whole file; `name`: of the file,
    for messages. Raises BadInput if it is truncated, of another standard, or says what the standard does not allow.
    """
    require_standard(data, ANSI_2004, MAGIC_20, name)
    cursor = Cursor(data, name)
    _, length = cursor.unpack(_START, "its header")
    if length == 0:
        (length,) = cursor.unpack(_LONG, "its header")
        require(length > _SHORT_LIMIT, f"{name} gives its length ({length}) in six bytes where two would do.")
    owner, kind, device, columns, rows, x_ppcm, y_ppcm, count, reserved = cursor.unpack(_REST, "its header")
    check_length(data, length, name)
    require(owner != 0, f"{name}: the owner of its product is 0, which {ANSI_2004} does not allow.")
    require(reserved == 0, f"{name}: the reserved byte of its header is {reserved}, but it must be 0.")
    views = decode_views(cursor, count, (rows, columns), (x_ppcm, y_ppcm), _CODES)
    return naming(name, lambda: MinutiaeRecord(views, device & 0xFFF, device >> 12, (owner, kind), ANSI_2004))


_READERS: dict[str, Callable[[bytes, str], MinutiaeRecord]] = {
    ISO_2005: decode_iso19794,
    ANSI_2004: decode_ansi378,
    ANSI_2009: decode_ansi378_2009,
    ANSI_2009_AM1: decode_ansi378_2009,
}


def decode_minutiae_record(data: bytes, name: str = "the record") -> MinutiaeRecord:
    """Read the bytes of a record of ISO/IEC 19794-2:2005 or ANSI/INCITS 378-2004 or -2009. Raises BadInput if it is of
    no such standard (the message names what it is), truncated, or does not conform to its standard.
    """
    standard = standard_of(data)
    if standard in _READERS:
        return _READERS[standard](data, name)
    if standard is not None:
        raise BadInput(f"{name} is a record of {standard}, which is not read; export it as {ISO_2005}.")
    require_standard(data, ISO_2005, MAGIC_20, name)
    raise AssertionError  # the line above refused it


def read_minutiae_record(path: str | os.PathLike[str]) -> MinutiaeRecord:
    """Read a file of minutiae; see :func:`decode_minutiae_record`."""
    return decode_minutiae_record(read_bytes(path, MAX_RECORD_BYTES), os.fspath(path))


def _checked_product(record: MinutiaeRecord) -> tuple[int, int]:
    """Owner and type of the product, as every ANSI record names them."""
    owner, kind = record.product
    require(
        0 < owner <= 65535 and 0 <= kind <= 65535,
        f"the product's owner must lie between 1 and 65535 (0x0103: not registered) and its type between 0 and 65535, "
        f"but they are {record.product}.",
    )
    return owner, kind
