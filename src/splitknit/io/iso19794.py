"""Minutiae records of ISO/IEC 19794-2:2005 (with corrigendum 1:2009), the record format: byte for byte.

All numbers are big-endian::

    header, 24 bytes                      each view, 6 bytes and 6 for each minutia
     0  "FMR" NUL                          0  finger position, 0 to 10
     4  " 20" NUL                          1  view number (4 bits), impression type (4 bits)
     8  length of the record (4 bytes)     2  quality of the finger, 0 to 100
    12  certificates (4 bits), device      3  number of minutiae
    14  columns of the image               4  minutiae:  2 bits type, 14 bits column
    16  rows of the image                                2 bits 0, 14 bits row
    18  pixels per cm along columns                      direction, steps of 360/256 deg
    20  pixels per cm along rows                         quality, 0 (none known) to 100
    22  number of views                       length of the extended data (2 bytes)
    23  0                                     extended data

References
----------
ISO/IEC 19794-2:2005, clause 7; ISO/IEC 29109-2 (conformance).
"""

from __future__ import annotations

import os
import struct

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.atomic import atomic_file
from splitknit.io.fmr_bytes import (
    ISO_2005,
    ISO_STEPS,
    MAGIC_20,
    Cursor,
    ViewCodes,
    check_length,
    check_writable,
    common_image,
    decode_views,
    encode_views,
    make_record,
    read_record_bytes,
    require_standard,
)
from splitknit.io.minutiae_record import BIFURCATION, ISO_2005_IMPRESSIONS, MAX_MINUTIAE, FingerView, MinutiaeRecord

_HEADER = struct.Struct(">8sIHHHHHBB")
_MIN_RESOLUTION = 99
"""Pixels per cm; the standard requires no less (250 ppi)."""
_CODES = ViewCodes(
    ISO_2005, ISO_STEPS, ISO_2005_IMPRESSIONS, {"contactless": "live_plain", "contactless_rolled": "live_rolled"}
)
"""The standard has no code for contactless prints: what they imitate is written."""


def encode_iso19794(record: MinutiaeRecord) -> bytes:
    """Bytes of a record.

    Contactless prints are written as live-scan plain (or rolled) ones: the standard has no code of their own for them.
    Directions are rounded to 1.40625 deg.

    Raises
    ------
    BadInput
        If the standard cannot represent what the record holds.
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
    """Read the bytes of a record; writing it again gives the same bytes.

    Parameters
    ----------
    data : the whole file
    name : of the file, for messages

    Raises
    ------
    BadInput
        If it is truncated, of another standard, or holds what the standard does not allow.
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
    return make_record(name, views=views, device=device & 0xFFF, certification=device >> 12, standard=ISO_2005)


def write_iso19794(path: str | os.PathLike[str], record: MinutiaeRecord) -> None:
    """Write a record to a file, whole or not at all; see :func:`encode_iso19794`."""
    data = encode_iso19794(record)
    with atomic_file(path) as stream:
        stream.write(data)


def read_iso19794(path: str | os.PathLike[str]) -> MinutiaeRecord:
    """Read a record's file; see :func:`decode_iso19794`."""
    return decode_iso19794(read_record_bytes(path), os.fspath(path))


# Minutiae for chip cards (ISO/IEC 19794-2:2005): bare lists without any header, in millimetres instead of pixels.
#
# Normal size, 5 bytes a minutia: 2 bits type and 14 of x, 2 bits 0 and 14 of y (0.01 mm, big-endian), direction in
# 256 steps. Compact size, 3 bytes: x, y (0.1 mm), 2 bits type and 6 of direction in 64 steps. Quality, finger and
# image are not kept: the card and what surrounds the list know them. A list has no mark that distinguishes it from
# other bytes.
#
# Source: ISO/IEC 19794-2:2005, clause 8 (finger minutiae card formats).


_NORMAL = np.dtype([("x", ">u2"), ("y", ">u2"), ("direction", "u1")])
_COMPACT = np.dtype([("x", "u1"), ("y", "u1"), ("packed", "u1")])
_NORMAL_MM, _COMPACT_MM = 0.01, 0.1
_NORMAL_STEPS, _COMPACT_STEPS = 256, 64


def encode_card(view: FingerView, compact: bool = True) -> bytes:
    """Bytes of a view's minutiae for a card: 3 bytes each where `compact`, 5 otherwise. Raises BadInput if there are
    more than 255, or one lies further right or down than the format reaches (25.5 mm, 163.83 mm).
    """
    require(view.count <= MAX_MINUTIAE, f"a card takes at most {MAX_MINUTIAE} minutiae, not {view.count}; see best().")
    unit, steps, largest = (_COMPACT_MM, _COMPACT_STEPS, 255) if compact else (_NORMAL_MM, _NORMAL_STEPS, 16383)
    x_ppcm, y_ppcm = view.resolution_ppcm
    x, y = (
        np.round(np.asarray(pixels) * (10 / ppcm / unit)).astype(np.int64)
        for pixels, ppcm in ((view.x_px, x_ppcm), (view.y_px, y_ppcm))
    )
    reach = max((int(np.max(x)), int(np.max(y)))) if view.count else 0
    require(
        reach <= largest,
        f"a minutia lies {reach * unit:.1f} mm from the image's edge, but this format reaches {largest * unit:.2f} mm; "
        "crop the print.",
    )
    direction = np.round(np.asarray(view.direction_rad) * (steps / (2 * np.pi))).astype(np.int64) % steps
    table = np.zeros(view.count, dtype=_COMPACT if compact else _NORMAL)
    kind = np.asarray(view.type).astype(np.int64)
    if compact:
        table["x"], table["y"], table["packed"] = x, y, kind << 6 | direction
    else:
        table["x"], table["y"], table["direction"] = kind << 14 | x, y, direction
    return table.tobytes()


def decode_card(
    data: bytes, size: tuple[int, int], ppcm: tuple[int, int], compact: bool = True, name: str = "the list"
) -> FingerView:
    """Read minutiae of a card onto the pixels of an image.

    `data`: the list; `size`: (rows, columns) of the image; `ppcm`: its pixels per cm along columns and rows; `compact`:
    3 bytes a minutia, otherwise 5; `name`: of the list, for messages. Returns FingerView, of an unknown finger and
    impression, with qualities of 0. Raises BadInput if the length is not that of a list, a reserved bit or type is
    used, or a minutia lies outside the image.
    """
    row = _COMPACT if compact else _NORMAL
    count, rest = divmod(len(data), row.itemsize)
    require(
        rest == 0 and count <= MAX_MINUTIAE,
        f"{name} has {len(data)} bytes, which is no list of at most {MAX_MINUTIAE} minutiae of {row.itemsize}.",
    )
    table = np.frombuffer(data, dtype=row)
    if compact:
        unit, steps, kind, direction = _COMPACT_MM, _COMPACT_STEPS, table["packed"] >> 6, table["packed"] & 63
        x, y = table["x"], table["y"]
    else:
        unit, steps, kind, direction = _NORMAL_MM, _NORMAL_STEPS, table["x"] >> 14, table["direction"]
        x, y = table["x"] & 16383, table["y"]
        require(not bool((y >> 14).any()), f"{name}: the reserved bits of a minutia are not zero.")
    require(not bool((kind > BIFURCATION).any()), f"{name}: a minutia has the reserved type 3.")
    require(min(ppcm) > 0, f"the resolution must be positive, but it is {ppcm} pixels per cm.")
    none: NDArray[np.uint8] = np.zeros(count, dtype=np.uint8)
    return FingerView(
        np.round(x * (unit * ppcm[0] / 10)).astype(np.int32),
        np.round(y * (unit * ppcm[1] / 10)).astype(np.int32),
        direction.astype(np.float64) * (2 * np.pi / steps),
        kind.astype(np.uint8),
        none,
        size,
        finger_quality=0,
        impression="unknown",
        resolution_ppcm=ppcm,
    )
