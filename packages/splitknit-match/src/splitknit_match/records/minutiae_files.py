"""Records of minutiae in files: ISO/IEC 19794-2:2005, ANSI/INCITS 378-2004, -2009 and its amendment
1.

Big-endian. A file is recognised by what it holds, not by its name. What is written where the
standards leave a choice stands in ``docs/reference/records.md``. What identifies devices and
products, and extended data, is passed over.

Source: ISO/IEC 19794-2:2005 (with corrigendum 1:2009), clause 7; ISO/IEC 29109-2; ANSI/INCITS
378-2004, clause 6; ANSI/INCITS 378-2009; ANSI/INCITS 378-2009/AM 1-2010.
"""

from __future__ import annotations

import os
import struct
from typing import Any

import numpy as np

from splitknit.errors import BadInput, naming, require
from splitknit.files import read_bytes
from splitknit_match.records.fmr_bytes import (
    ANSI_2004,
    ANSI_2009,
    ISO_2005,
    MAGIC_030,
    MAGIC_20,
    Cursor,
    check_length,
    standard_of,
    what_bytes_are,
)
from splitknit_match.records.minutiae_record import (
    ANSI_2004_IMPRESSIONS,
    ANSI_2009_IMPRESSIONS,
    FINGER_CODES,
    ISO_2005_IMPRESSIONS,
    VENDOR_UNKNOWN,
    FingerView,
    name_of,
    standard_code,
)

_MIN_RESOLUTION = 99
"""Least resolution in pixels per cm. Source: ISO/IEC 19794-2:2005 (250 ppi)."""
_SHORT_LIMIT = 65535
"""A longer record of ANSI/INCITS 378-2004 gives its length in six bytes instead of two. Source:
ANSI/INCITS 378-2004."""
_MAX_VIEWS = 176
"""Views of a record, at most. Source: ISO/IEC 19794-2:2005."""
_MAX_WRITTEN = 255
"""Minutiae of a view: it cannot count more; those of the highest quality are written. Source:
ISO/IEC 19794-2:2005."""
_SHORT, _LONG, _COUNTS = struct.Struct(">H"), struct.Struct(">I"), struct.Struct(">BB")
_PRODUCT, _IMAGE, _DEVICE = struct.Struct(">HH"), struct.Struct(">HHHHH"), struct.Struct(">BH")
_VIEW, _VIEW_2009 = struct.Struct(">BBBB"), struct.Struct(">BBBBHHHHHHB")
_MINUTIA = np.dtype([("x", ">u2"), ("y", ">u2"), ("direction", "u1"), ("quality", "u1")])
_STEPS = {ISO_2005: 256}
"""Directions in a turn; in ANSI/INCITS 378 they are steps of 2 deg."""
_ANSI_STEPS = 180
"""Directions in a turn. Source: ANSI/INCITS 378 (2 deg)."""
_IMPRESSIONS = {ISO_2005: ISO_2005_IMPRESSIONS, ANSI_2004: ANSI_2004_IMPRESSIONS}
_IMITATED = {
    ISO_2005: {"contactless": "live_plain", "contactless_rolled": "live_rolled"},
    ANSI_2004: {"contactless_rolled": "contactless"},
}
"""Impression types without a code, and what is written for them."""


def encode_minutiae_record(
    view: FingerView, standard: str = ISO_2005, owner: int = VENDOR_UNKNOWN
) -> bytes:
    """Bytes of a record, directions rounded to the standard's steps (1.40625 deg, or 2 deg in
    ANSI/INCITS 378).

    It holds the 255 minutiae of the highest quality.

    ISO/IEC 19794-2:2005 has no code for contactless prints: they are written as live-scan ones.
    `owner`: IBIA's number of who makes the record, which ANSI/INCITS 378 states. Raises BadInput if
    the standard cannot represent the view.
    """
    view = view.best(_MAX_WRITTEN)
    rows, columns = view.size
    resolution = view.resolution_ppcm
    impression = _IMITATED.get(standard, {}).get(view.impression, view.impression)
    code = standard_code(
        impression, _IMPRESSIONS.get(standard, ANSI_2009_IMPRESSIONS), "impression type"
    )
    minutiae = _encode_minutiae(view, _STEPS.get(standard, _ANSI_STEPS))
    finger = FINGER_CODES[view.finger]
    head = b"" if standard == ISO_2005 else _PRODUCT.pack(owner, 0)
    if standard == ANSI_2009:
        image = columns, rows, *resolution
        head += _DEVICE.pack(0, 0)
        view_head = _VIEW_2009.pack(
            finger, 0, code, view.finger_quality, owner, 1, *image, view.count
        )
    else:
        require(
            standard != ISO_2005 or min(resolution) >= _MIN_RESOLUTION,
            f"{standard} needs at least {_MIN_RESOLUTION} pixels per cm, but the image has"
            f" {min(resolution)}.",
        )
        head += _IMAGE.pack(0, columns, rows, *resolution)
        view_head = _VIEW.pack(finger, code, view.finger_quality, view.count)
    body = head + _COUNTS.pack(1, 0) + view_head + minutiae + _SHORT.pack(0)
    magic = MAGIC_030 if standard == ANSI_2009 else MAGIC_20
    if standard == ANSI_2004:
        return magic + _SHORT.pack(len(magic) + _SHORT.size + len(body)) + body
    return magic + _LONG.pack(len(magic) + _LONG.size + len(body)) + body


def decode_minutiae_record(data: bytes, name: str = "the record") -> tuple[FingerView, ...]:
    """Read the views of a record, the whole file `data`. `name` is for messages.

    Raises BadInput if it is of no standard that is read (the message names what it is), truncated,
    or does not conform to its standard.
    """
    standard = standard_of(data)
    if standard is None:
        raise BadInput(f"{name} is {what_bytes_are(data)}, but a record of minutiae is expected.")
    cursor, what = Cursor(data, name, len(MAGIC_20)), "its header"
    (length,) = cursor.unpack(_SHORT if standard == ANSI_2004 else _LONG, what)
    if standard == ANSI_2004 and length == 0:
        (length,) = cursor.unpack(_LONG, what)
        require(
            length > _SHORT_LIMIT,
            f"{name} gives its length ({length}) in six bytes where two would do.",
        )
    if standard != ISO_2005:
        owner, _ = cursor.unpack(_PRODUCT, what)
        require(
            owner != 0, f"{name}: the owner of its product is 0, which {standard} does not allow."
        )
    image = None
    if standard == ANSI_2009:
        cursor.unpack(_DEVICE, what)
    else:
        _, *image = cursor.unpack(_IMAGE, what)
        require(
            standard != ISO_2005 or min(image[2:]) >= _MIN_RESOLUTION,
            f"{name}: the resolution is {image[2]} x {image[3]} pixels per cm, but {standard}"
            f" requires {_MIN_RESOLUTION} at least; its producer does not keep to the standard.",
        )
    count, reserved = cursor.unpack(_COUNTS, what)
    check_length(data, length, name)
    later = ", or it is of ISO/IEC 19794-2:2011, which is not read" if standard == ANSI_2009 else ""
    require(
        reserved == 0,
        f"{name}: the reserved byte of its header is {reserved}, but it must be 0{later}.",
    )
    require(
        0 < count <= _MAX_VIEWS,
        f"{name}: a record holds 1 to {_MAX_VIEWS} views, but this one has {count}.",
    )
    views = tuple(
        _decode_view(cursor, f"view {number}", standard, image) for number in range(1, count + 1)
    )
    rest = len(data) - cursor.place
    require(
        rest == 0,
        f"{name} holds {rest} bytes behind its {count} views; its counts or lengths do not fit.",
    )
    return views


MAX_RECORD_BYTES = 20_000_000
"""Longest record of minutiae: 176 full views with full extended data take 12 MB."""


def read_minutiae_record(path: str | os.PathLike[str]) -> tuple[FingerView, ...]:
    """Read a file of minutiae; see :func:`decode_minutiae_record`."""
    return decode_minutiae_record(read_bytes(path, MAX_RECORD_BYTES), os.fspath(path))


def _decode_view(cursor: Cursor, what: str, standard: str, image: list[int] | None) -> FingerView:
    """Read the next view, of the `image` (columns, rows, resolution twice) that the header
    describes where it does."""
    name, head = cursor.name, f"the header of {what}"
    if image is None:
        finger, number, code, quality, _, _, *image, count = cursor.unpack(_VIEW_2009, head)
        require(number <= 15, f"{name}: views are numbered from 0 to 15, but {what} is {number}.")
    else:
        finger, packed, quality, count = cursor.unpack(_VIEW, head)
        code = packed & 15
    columns, rows, *resolution = image
    table = _decode_minutiae(cursor, count, _STEPS.get(standard, _ANSI_STEPS), what)
    (extended,) = cursor.unpack(_SHORT, f"the length of the extended data of {what}")
    cursor.take(extended, f"the extended data of {what}")
    if standard == ANSI_2009:  # 254: nobody computed it, 255: that failed
        quality = 0 if quality >= 254 else quality
        table["quality"][table["quality"] >= 254] = 0
    require(
        min(image) > 0,
        f"{name}: the image of {what} has no size or no resolution; correct the record.",
    )
    require(
        quality <= 100,
        f"{name}: the quality of {what} does not lie between 0 and 100; correct the record.",
    )
    impressions = _IMPRESSIONS.get(standard, ANSI_2009_IMPRESSIONS)
    label: dict[str, Any] = {
        "finger": name_of(finger, FINGER_CODES, f"finger position of {what} of {name}"),
        "impression": name_of(code, impressions, f"impression type of {what} of {name}"),
        "resolution_ppcm": tuple(resolution),
    }
    size = rows, columns
    return naming(
        f"{what} of {name}", lambda: FingerView(**table, size=size, finger_quality=quality, **label)
    )


def _decode_minutiae(cursor: Cursor, count: int, steps: int, what: str) -> dict[str, Any]:
    """Columns of `count` minutiae of six bytes; `steps` directions in a turn; `what` they are, for
    messages. Two bits of type and 14 of column, two reserved and 14 of row (all big-endian), a byte
    of direction, one of quality.
    """
    table = np.frombuffer(
        cursor.take(count * _MINUTIA.itemsize, f"the {count} minutiae of {what}"), _MINUTIA
    )
    name = cursor.name
    require(
        not (table["y"] >> 14).any(),
        f"{name}: the reserved bits of a minutia of {what} are not zero.",
    )
    require(
        int(table["direction"].max(initial=0)) < steps,
        f"{name}: the direction of a minutia of {what} is not one of {steps} steps.",
    )
    return {
        "x_px": (table["x"] & 0x3FFF).astype(np.int32),
        "y_px": table["y"].astype(np.int32),
        "direction_rad": table["direction"] * (2 * np.pi / steps),
        "type": (table["x"] >> 14).astype(np.uint8),
        "quality": table["quality"].copy(),
    }


def _encode_minutiae(view: FingerView, steps: int) -> bytes:
    """Bytes of a view's minutiae, six for each, directions rounded to the nearest of `steps` in a
    turn."""
    x = view.x_px | (view.type.astype(np.int64) << 14)
    direction = np.round(view.direction_rad * (steps / (2 * np.pi))).astype(np.int64) % steps
    return np.rec.fromarrays([x, view.y_px, direction, view.quality], _MINUTIA).tobytes()
