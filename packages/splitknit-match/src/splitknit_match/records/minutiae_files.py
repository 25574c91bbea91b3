"""Records of minutiae in files: ISO/IEC 19794-2:2005 and :2011, ANSI/INCITS 378-2004, -2009 and its amendment 1.

Big-endian. A file is recognised by what it holds, not by its name. The layouts stand in ``docs/reference/records.md``.
Source: ISO/IEC 19794-2:2005 (with corrigendum 1:2009), clause 7; ISO/IEC 19794-2:2011, clause 8; ISO/IEC 29109-2;
ANSI/INCITS 378-2004, clause 6; ANSI/INCITS 378-2009; ANSI/INCITS 378-2009/AM 1-2010.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming, read_bytes, require
from splitknit_match.records.fmr_bytes import (
    ANSI_2004,
    ANSI_2009,
    ANSI_2009_AM1,
    ISO_2005,
    ISO_2011,
    MAGIC_030,
    MAGIC_035,
    MAGIC_20,
    MAX_RECORD_BYTES,
    Cursor,
    check_length,
    require_standard,
    standard_of,
)
from splitknit_match.records.minutiae_record import (
    ANSI_2004_IMPRESSIONS,
    ANSI_2009_IMPRESSIONS,
    FAILED,
    FINGER_CODES,
    ISO_2005_IMPRESSIONS,
    MAX_MINUTIAE,
    NOT_COMPUTED,
    VENDOR_UNKNOWN,
    FingerView,
    MinutiaeRecord,
    name_of,
    standard_code,
)

_MIN_RESOLUTION = 99
"""Pixels per cm; ISO/IEC 19794-2:2005 requires no less (250 ppi)."""
_SHORT_LIMIT = 65535
"""A longer record of ANSI/INCITS 378-2004 gives its length in six bytes instead of two."""
_SHORT, _LONG, _COUNTS = struct.Struct(">H"), struct.Struct(">I"), struct.Struct(">BB")
_PRODUCT, _IMAGE, _DEVICE = struct.Struct(">HH"), struct.Struct(">HHHHH"), struct.Struct(">BH")
_VIEW, _VIEW_2009 = struct.Struct(">BBBB"), struct.Struct(">BBBBHHHHHHB")
_HEAD_2011, _QUALITY_2011, _TAIL_2011 = struct.Struct(">HB"), struct.Struct(">BHH"), struct.Struct(">BBHHBHHBB")
_CAPTURE_2011 = b"\xff" * 9 + bytes(5)
"""Date of the capture, and technology, vendor and type of its device: all unknown."""
_MINUTIA = np.dtype([("x", ">u2"), ("y", ">u2"), ("direction", "u1"), ("quality", "u1")])


@dataclass(frozen=True, slots=True)
class _Standard:
    """In what the standards differ."""

    name: str
    magic: bytes
    steps: int
    """Directions in a turn."""
    impressions: Mapping[str, int]
    nearest: Mapping[str, str] = field(default_factory=dict)
    """Impression types without a code, and what is written for them: what they imitate."""
    product: bool = True
    """Whether the header names the product."""
    of_2009: bool = False
    """Every view has its own image size and resolution, and qualities may be 254 (not computed) and 255 (failed)."""


_CONTACTLESS = {"contactless": "live_plain", "contactless_rolled": "live_rolled"}
_STANDARDS = {
    one.name: one
    for one in (
        _Standard(ISO_2005, MAGIC_20, 256, ISO_2005_IMPRESSIONS, _CONTACTLESS, product=False),
        _Standard(ANSI_2004, MAGIC_20, 180, ANSI_2004_IMPRESSIONS, {"contactless_rolled": "contactless"}),
        _Standard(ISO_2011, MAGIC_030, 256, ANSI_2009_IMPRESSIONS, product=False, of_2009=True),
        _Standard(ANSI_2009, MAGIC_030, 180, ANSI_2009_IMPRESSIONS, of_2009=True),
        _Standard(ANSI_2009_AM1, MAGIC_035, 180, ANSI_2009_IMPRESSIONS, of_2009=True),
    )
}


def encode_minutiae_record(record: MinutiaeRecord, standard: str = ISO_2005) -> bytes:
    """Bytes of a record, directions rounded to the standard's steps (1.40625 deg, or 2 deg in ANSI/INCITS 378).

    ISO/IEC 19794-2:2005 has no code for contactless prints: they are written as live-scan ones. Raises BadInput if the
    standard cannot represent what the record holds.
    """
    of = _STANDARDS[standard]
    device_bits, certification_bits = (0, 0) if standard == ISO_2011 else (16, 8) if of.of_2009 else (12, 4)
    require(
        not any(view.extended for view in record.views) or record.standard == standard,
        f"the extended data are those of {record.standard or 'an unknown standard'} and mean something else in "
        f"{standard}; write record.without_extended().",
    )
    require(
        0 <= record.device < 1 << device_bits,
        f"the device's number must lie between 0 and {(1 << device_bits) - 1} in {standard}, not at {record.device}.",
    )
    require(
        0 <= record.certification < 1 << certification_bits,
        f"the device's certificates are {certification_bits} bits in {standard}, but they are {record.certification}.",
    )
    (owner, kind), head = record.product, b""
    if standard == ISO_2011:
        body = _HEAD_2011.pack(len(record.views), 0) + b"".join(map(_encode_2011, record.views))
        return of.magic + _LONG.pack(len(of.magic) + _LONG.size + len(body)) + body
    if of.product:
        require(
            0 < owner <= 65535 and 0 <= kind <= 65535,
            "the product's owner must lie between 1 and 65535 (0x0103: not registered) and its type between 0 and "
            f"65535, but they are {record.product}.",
        )
        head = _PRODUCT.pack(owner, kind)
    if of.of_2009:
        head += _DEVICE.pack(record.certification, record.device)
    else:
        (rows, columns), resolution = _common_image(record, standard)
        head += _IMAGE.pack(record.certification << 12 | record.device, columns, rows, *resolution)
    body = head + _COUNTS.pack(len(record.views), 0) + b"".join(_encode_view(view, of) for view in record.views)
    length = len(of.magic) + _LONG.size + len(body)
    if standard != ANSI_2004:
        return of.magic + _LONG.pack(length) + body
    short = length - _LONG.size + _SHORT.size
    if short <= _SHORT_LIMIT:
        return of.magic + _SHORT.pack(short) + body
    return of.magic + _SHORT.pack(0) + _LONG.pack(length + _SHORT.size) + body


def decode_minutiae_record(data: bytes, name: str = "the record", standard: str | None = None) -> MinutiaeRecord:
    """Read the bytes of a record, the whole file `data`; writing it again gives the same. `name` is for messages.

    Raises BadInput if it is of no standard that is read (the message names what it is), not of `standard` where one is
    wanted, truncated, or does not conform to its standard.
    """
    found = standard_of(data)
    of = _STANDARDS[standard or found or ISO_2005]
    require_standard(data, of.name, of.magic, name)
    cursor, head = Cursor(data, name, len(of.magic)), "its header"
    (length,) = cursor.unpack(_SHORT if of.name == ANSI_2004 else _LONG, head)
    if of.name == ANSI_2004 and length == 0:
        (length,) = cursor.unpack(_LONG, head)
        require(length > _SHORT_LIMIT, f"{name} gives its length ({length}) in six bytes where two would do.")
    facts: dict[str, Any] = {"standard": of.name}
    if of.name == ISO_2011:
        check_length(data, length, name)
        count, certified = cursor.unpack(_HEAD_2011, head)
        views = tuple(_decode_2011(cursor, f"view {number}", of, certified) for number in range(1, count + 1))
        require(cursor.place == len(data), f"{name} holds {len(data) - cursor.place} bytes behind its {count} views.")
        return naming(name, lambda: MinutiaeRecord(views, **facts))
    if of.product:
        facts["product"] = cursor.unpack(_PRODUCT, head)
        require(facts["product"][0] != 0, f"{name}: the owner of its product is 0, which {of.name} does not allow.")
    image: dict[str, Any] = {}
    if of.of_2009:
        facts["certification"], facts["device"] = cursor.unpack(_DEVICE, head)
    else:
        device, columns, rows, *resolution = cursor.unpack(_IMAGE, head)
        facts |= {"device": device & 0xFFF, "certification": device >> 12}
        image = {"size": (rows, columns), "resolution_ppcm": tuple(resolution)}
    count, reserved = cursor.unpack(_COUNTS, head)
    check_length(data, length, name)
    require(reserved == 0, f"{name}: the reserved byte of its header is {reserved}, but it must be 0.")
    require(
        of.name != ISO_2005 or min(image["resolution_ppcm"]) >= _MIN_RESOLUTION,
        f"{name}: the resolution is {' x '.join(map(str, image.get('resolution_ppcm', ())))} pixels per cm, but "
        f"{ISO_2005} requires {_MIN_RESOLUTION} at least; its producer does not keep to the standard.",
    )
    views = tuple(_decode_view(cursor, f"view {number}", of, image) for number in range(1, count + 1))
    rest = len(data) - cursor.place
    require(rest == 0, f"{name} holds {rest} bytes behind its {count} views; its counts or lengths do not fit.")
    return naming(name, lambda: MinutiaeRecord(views, **facts))


def read_minutiae_record(path: str | os.PathLike[str], standard: str | None = None) -> MinutiaeRecord:
    """Read a file of minutiae; see :func:`decode_minutiae_record`."""
    return decode_minutiae_record(read_bytes(path, MAX_RECORD_BYTES), os.fspath(path), standard)


def _common_image(record: MinutiaeRecord, standard: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Size and resolution that all views share, as standards with one of them in their header need."""
    first = record.views[0]
    equal = all(view.size == first.size and view.resolution_ppcm == first.resolution_ppcm for view in record.views)
    require(
        equal,
        f"{standard} has one image size and one resolution a record, but the views differ; write a record for each.",
    )
    least = min(first.resolution_ppcm)
    require(
        standard != ISO_2005 or least >= _MIN_RESOLUTION,
        f"{standard} needs at least {_MIN_RESOLUTION} pixels per cm, but the image has {least}.",
    )
    return first.size, first.resolution_ppcm


def _encode_view(view: FingerView, of: _Standard) -> bytes:
    (rows, columns), finger = view.size, FINGER_CODES[view.finger]
    impression = of.nearest.get(view.impression, view.impression)
    code = standard_code(impression, of.impressions, "impression type")
    minutiae = _encode_minutiae(view, of.steps, FAILED if of.of_2009 else 100)
    if of.of_2009:
        require(view.quality_algorithm[0] > 0, "the vendor of the quality's algorithm must not be 0 (0x0103: unknown).")
        facts = (*view.quality_algorithm, columns, rows, *view.resolution_ppcm, view.count)
        head = _VIEW_2009.pack(finger, view.view, code, view.finger_quality, *facts)
    else:
        require(
            view.finger_quality <= 100,
            f"the finger's quality is {view.finger_quality} (not computed), which {of.name} cannot represent; give 0 "
            "to 100.",
        )
        head = _VIEW.pack(finger, view.view << 4 | code, view.finger_quality, view.count)
    return head + minutiae + _SHORT.pack(len(view.extended)) + view.extended


def _decode_view(cursor: Cursor, what: str, of: _Standard, image: Mapping[str, Any]) -> FingerView:
    """Read the next view, of the `image` that the header describes where it does."""
    name, head = cursor.name, f"the header of {what}"
    if of.of_2009:
        position, number, code, quality, *facts, count = cursor.unpack(_VIEW_2009, head)
        vendor, algorithm, columns, rows, *resolution = facts
        require(vendor != 0, f"{name}: the vendor of the quality of {what} is 0, which the standard does not allow.")
        image = {"size": (rows, columns), "resolution_ppcm": tuple(resolution)}
        image = {**image, "quality_algorithm": (vendor, algorithm)}
    else:
        position, packed, quality, count = cursor.unpack(_VIEW, head)
        number, code = packed >> 4, packed & 15
    table = _decode_minutiae(cursor, count, of.steps, what)
    (extended,) = cursor.unpack(_SHORT, f"the length of the extended data of {what}")
    highest = max(quality, int(table["quality"].max(initial=0)))
    require(of.of_2009 or highest <= 100, f"{name}: a quality of {what} is above 100, the highest.")
    fields: dict[str, Any] = {
        **table,
        **image,
        "finger_quality": quality,
        "finger": name_of(position, FINGER_CODES, f"finger position of {what} of {name}"),
        "impression": name_of(code, of.impressions, f"impression type of {what} of {name}"),
        "view": number,
        "extended": cursor.take(extended, f"the extended data of {what}"),
    }
    return naming(f"{name}, {what}", lambda: FingerView(**fields))


def _encode_2011(view: FingerView) -> bytes:
    """A representation of ISO/IEC 19794-2:2011: one block of quality, and minutiae of six bytes.

    Ridge endings lie where the skeleton of the valleys forks (ending type 0), as in :2005.
    """
    (rows, columns), of = view.size, _STANDARDS[ISO_2011]
    quality = b"\0"
    if view.finger_quality != NOT_COMPUTED:
        quality = b"\1" + _QUALITY_2011.pack(view.finger_quality, *view.quality_algorithm)
    code = standard_code(view.impression, of.impressions, "impression type")
    tail = _TAIL_2011.pack(
        FINGER_CODES[view.finger], view.view, *view.resolution_ppcm, code, columns, rows, 6 << 4, view.count
    )
    body = _CAPTURE_2011 + quality + tail + _encode_minutiae(view, of.steps, FAILED)
    body += _SHORT.pack(len(view.extended)) + view.extended
    return _LONG.pack(_LONG.size + len(body)) + body


def _decode_2011(cursor: Cursor, what: str, of: _Standard, certified: int) -> FingerView:
    """Read the next representation; date and device of the capture, certificates and further qualities are left out."""
    name, head, start = cursor.name, f"the header of {what}", cursor.place
    (length,) = cursor.unpack(_LONG, head)
    cursor.take(len(_CAPTURE_2011), head)
    blocks = [cursor.unpack(_QUALITY_2011, head) for _ in range(cursor.take(1, head)[0])]
    if certified:
        cursor.take(3 * cursor.take(1, head)[0], head)
    position, number, *resolution, code, columns, rows, layout, count = cursor.unpack(_TAIL_2011, head)
    require(layout >> 4 in (5, 6), f"{name}: minutiae of {what} have {layout >> 4} bytes; 5 or 6 are expected.")
    table = _decode_minutiae(cursor, count, of.steps, what, layout >> 4)
    (extended,) = cursor.unpack(_SHORT, f"the length of the extended data of {what}")
    quality = blocks[0] if blocks else (NOT_COMPUTED, VENDOR_UNKNOWN, 1)
    fields: dict[str, Any] = {
        **table,
        "size": (rows, columns),
        "resolution_ppcm": tuple(resolution),
        "finger_quality": quality[0],
        "quality_algorithm": quality[1:],
        "finger": name_of(position, FINGER_CODES, f"finger position of {what} of {name}"),
        "impression": name_of(code, of.impressions, f"impression type of {what} of {name}"),
        "view": number,
        "extended": cursor.take(extended, f"the extended data of {what}"),
    }
    require(cursor.place == start + length, f"{name} is damaged: the length of {what} does not fit; copy it again.")
    return naming(f"{name}, {what}", lambda: FingerView(**fields))


def _decode_minutiae(cursor: Cursor, count: int, steps: int, what: str, size: int = 6) -> dict[str, NDArray[Any]]:
    """Columns of `count` minutiae of six bytes; `steps` directions in a turn; `what` they are, for messages. Two bits
    of type and 14 of column, two reserved and 14 of row (all big-endian), a byte of direction, one of quality, which
    those of `size` 5 lack.
    """
    taken = np.frombuffer(cursor.take(count * size, f"the {count} minutiae of {what}"), np.uint8).reshape(count, size)
    padded = np.full((count, 6), NOT_COMPUTED, np.uint8)
    padded[:, :size] = taken
    table = np.frombuffer(padded.tobytes(), dtype=_MINUTIA)
    name = cursor.name
    require(not bool((table["x"] >> 14 == 3).any()), f"{name}: a minutia of {what} has the reserved type 3.")
    require(not bool((table["y"] >> 14).any()), f"{name}: the reserved bits of a minutia of {what} are not zero.")
    require(
        count == 0 or int(table["direction"].max()) < steps,
        f"{name}: the direction of a minutia of {what} is not one of {steps} steps.",
    )
    return {
        "x_px": (table["x"] & 0x3FFF).astype(np.int32),
        "y_px": table["y"].astype(np.int32),
        "direction_rad": table["direction"] * (2 * np.pi / steps),
        "type": (table["x"] >> 14).astype(np.uint8),
        "quality": table["quality"].copy(),
    }


def _encode_minutiae(view: FingerView, steps: int, max_quality: int) -> bytes:
    """Bytes of a view's minutiae, six for each, directions rounded to the nearest of `steps` in a turn; qualities above
    `max_quality` (none known) become 0.
    """
    require(
        view.count <= MAX_MINUTIAE,
        f"a view holds at most {MAX_MINUTIAE} minutiae, but there are {view.count}; take FingerView.best().",
    )
    x = np.asarray(view.x_px) | (np.asarray(view.type).astype(np.int64) << 14)
    direction = np.round(np.asarray(view.direction_rad) * (steps / (2 * np.pi))).astype(np.int64) % steps
    quality = np.where(np.asarray(view.quality) <= max_quality, view.quality, 0)
    return np.rec.fromarrays([x, np.asarray(view.y_px), direction, quality], _MINUTIA).tobytes()
