"""Minutiae records of ISO/IEC 19794-2:2005 (with corrigendum 1:2009), the record format, big-endian.

The layout stands in ``docs/reference/records.md``. Source: ISO/IEC 19794-2:2005, clause 7; ISO/IEC 29109-2.
"""

from __future__ import annotations

import os
import struct

from splitknit.errors import naming, read_bytes, require
from splitknit.io.atomic import write_file
from splitknit.io.fmr_bytes import (
    ISO_2005,
    ISO_STEPS,
    MAGIC_20,
    MAX_RECORD_BYTES,
    Cursor,
    ViewCodes,
    check_length,
    check_writable,
    common_image,
    decode_views,
    encode_views,
    require_standard,
)
from splitknit.io.minutiae_record import ISO_2005_IMPRESSIONS, MinutiaeRecord

_HEADER = struct.Struct(">8sIHHHHHBB")
_MIN_RESOLUTION = 99
"""Pixels per cm; the standard requires no less (250 ppi)."""
_CODES = ViewCodes(
    ISO_2005, ISO_STEPS, ISO_2005_IMPRESSIONS, {"contactless": "live_plain", "contactless_rolled": "live_rolled"}
)
"""The standard has no code for contactless prints: what they imitate is written."""


def encode_iso19794(record: MinutiaeRecord) -> bytes:
    """Bytes of a record, directions rounded to 1.40625 deg. Contactless prints are written as live-scan ones: the
    standard has no code for them. Raises BadInput if the standard cannot represent what the record holds.
    """
    check_writable(record, ISO_2005, 12, 4)
    (rows, columns), resolution = common_image(record, ISO_2005)
    require(
        min(resolution) >= _MIN_RESOLUTION,
        f"{ISO_2005} needs at least {_MIN_RESOLUTION} pixels per cm, but the image has {min(resolution)}.",
    )
    body = encode_views(record.views, _CODES)
    device = record.certification << 12 | record.device
    length = _HEADER.size + len(body)
    return _HEADER.pack(MAGIC_20, length, device, columns, rows, *resolution, len(record.views), 0) + body


def decode_iso19794(data: bytes, name: str = "the record") -> MinutiaeRecord:
    """Read the bytes of a record, the whole file `data`; writing it again gives the same. `name` is for messages.
    Raises BadInput if it is truncated, of another standard, or holds what the standard does not allow.
    """
    require_standard(data, ISO_2005, MAGIC_20, name)
    cursor = Cursor(data, name)
    _, length, device, columns, rows, x_ppcm, y_ppcm, count, reserved = cursor.unpack(_HEADER, "its header")
    check_length(data, length, name)
    require(reserved == 0, f"{name}: the reserved byte 23 is {reserved}, but it must be 0.")
    require(
        min(x_ppcm, y_ppcm) >= _MIN_RESOLUTION,
        f"{name}: the resolution is {x_ppcm} x {y_ppcm} pixels per cm, but {ISO_2005} requires {_MIN_RESOLUTION} at "
        "least; its producer does not keep to the standard.",
    )
    views = decode_views(cursor, count, (rows, columns), (x_ppcm, y_ppcm), _CODES)
    return naming(
        name, lambda: MinutiaeRecord(views, device=device & 0xFFF, certification=device >> 12, standard=ISO_2005)
    )


def write_iso19794(path: str | os.PathLike[str], record: MinutiaeRecord) -> None:
    """Write a record to a file, whole or not at all; see :func:`encode_iso19794`."""
    write_file(path, encode_iso19794(record))


def read_iso19794(path: str | os.PathLike[str]) -> MinutiaeRecord:
    """Read a record's file; see :func:`decode_iso19794`."""
    return decode_iso19794(read_bytes(path, MAX_RECORD_BYTES), os.fspath(path))
