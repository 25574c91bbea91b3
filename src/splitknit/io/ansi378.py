"""Minutiae records of ANSI/INCITS 378-2004: byte for byte.

As :mod:`splitknit.io.iso19794`, but for the header, of 26 bytes (30 where the record is longer than 65535), steps of 2
deg, and a code for contactless prints. All numbers are big-endian::

    header                                    each view
     0  "FMR" NUL                              as in ISO/IEC 19794-2:2005, with directions in steps of 2 deg
     4  " 20" NUL
     8  length (2 bytes; or 0 and 4 bytes)
    10  owner (not 0) of the product that made it
    12  type of the product
    14  certificates (4 bits), device
    16  columns, 18 rows of the image
    20  pixels per cm along columns, 22 along rows
    24  number of views
    25  0

References
----------
ANSI/INCITS 378-2004, clause 6.
"""

from __future__ import annotations

import os
import struct

from splitknit.errors import require
from splitknit.io.atomic import atomic_file
from splitknit.io.finger_codes import ANSI_2004_IMPRESSIONS
from splitknit.io.fmr_bytes import (
    ANSI_STEPS,
    Cursor,
    check_length,
    check_writable,
    checked_product,
    common_image,
    make_record,
    read_record_bytes,
)
from splitknit.io.fmr_identify import ANSI_2004, MAGIC_20, require_standard
from splitknit.io.fmr_views import ViewCodes, decode_views, encode_views
from splitknit.io.minutiae_record import MinutiaeRecord

_START = struct.Struct(">8sH")
_LONG = struct.Struct(">I")
_REST = struct.Struct(">HHHHHHHBB")
_SHORT_LIMIT = 65535
_CODES = ViewCodes(ANSI_2004, ANSI_STEPS, ANSI_2004_IMPRESSIONS, {"contactless_rolled": "contactless"})


def encode_ansi378(record: MinutiaeRecord) -> bytes:
    """Bytes of a record; directions are rounded to 2 deg.

    Raises
    ------
    BadInput
        If the standard has no way to say what the record holds.
    """
    check_writable(record, ANSI_2004, 12, 4)
    (rows, columns), resolution = common_image(record, ANSI_2004)
    owner, kind = checked_product(record)
    body = encode_views(record.views, _CODES)
    device = record.certification << 12 | record.device
    rest = _REST.pack(owner, kind, device, columns, rows, *resolution, len(record.views), 0)
    length = _START.size + len(rest) + len(body)
    if length <= _SHORT_LIMIT:
        return _START.pack(MAGIC_20, length) + rest + body
    return _START.pack(MAGIC_20, 0) + _LONG.pack(length + _LONG.size) + rest + body


def decode_ansi378(data: bytes, name: str = "the record") -> MinutiaeRecord:
    """Read the bytes of a record; writing it again gives the same bytes.

    Parameters
    ----------
    data : the whole file
    name : of the file, for messages

    Raises
    ------
    BadInput
        If it is truncated, of another standard, or says what the standard does not allow.
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
    return make_record(
        name,
        views=views,
        device=device & 0xFFF,
        certification=device >> 12,
        product=(owner, kind),
        standard=ANSI_2004,
    )


def write_ansi378(path: str | os.PathLike[str], record: MinutiaeRecord) -> None:
    """Write a record to a file, whole or not at all; see :func:`encode_ansi378`."""
    data = encode_ansi378(record)
    with atomic_file(path) as stream:
        stream.write(data)


def read_ansi378(path: str | os.PathLike[str]) -> MinutiaeRecord:
    """Read a record's file; see :func:`decode_ansi378`."""
    return decode_ansi378(read_record_bytes(path), os.fspath(path))
