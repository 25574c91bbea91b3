"""What the byte layouts of minutiae records share: a reader that cannot overrun, and tables of six-byte minutiae."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, naming, require
from splitknit.io.minutiae_record import FINGER_CODES, MAX_MINUTIAE, FingerView, MinutiaeRecord, name_of, standard_code

MAX_RECORD_BYTES = 20_000_000
"""176 full views with full extended data take 12 MB."""
ISO_STEPS, ANSI_STEPS = 256, 180
"""Directions in a turn: steps of 1.40625 and of 2 deg."""
_MINUTIA = np.dtype([("x", ">u2"), ("y", ">u2"), ("direction", "u1"), ("quality", "u1")])


@dataclass(slots=True)
class Cursor:
    """A place in a record; what would lie behind the end is refused with a message."""

    data: bytes
    name: str
    """Of the file."""
    place: int = 0

    def take(self, count: int, what: str) -> bytes:
        """Return the next `count` bytes, `what` they are."""
        end = self.place + count
        if end > len(self.data):
            raise BadInput(
                f"{self.name} is truncated: it ends after {len(self.data)} bytes, within {what} (to byte {end}); copy "
                "it again."
            )
        taken = self.data[self.place : end]
        self.place = end
        return taken

    def unpack(self, layout: struct.Struct, what: str) -> tuple[Any, ...]:
        """Return the numbers of the next bytes, `what` they are."""
        return layout.unpack(self.take(layout.size, what))


def check_length(data: bytes, said: int, name: str) -> None:
    """Require that a record has the length that its header states."""
    if len(data) < said:
        raise BadInput(f"{name} is truncated: its header states {said} bytes, but it has {len(data)}; copy it again.")
    require(
        len(data) == said,
        f"{name} has {len(data)} bytes, but its header states {said}; cut off what does not belong to the record.",
    )


def check_rest(cursor: Cursor, views: int) -> None:
    """Require that the views fill the record."""
    rest = len(cursor.data) - cursor.place
    require(
        rest == 0,
        f"{cursor.name} holds {rest} bytes behind its {views} views; its counts or lengths do not fit.",
    )


def decode_minutiae(cursor: Cursor, count: int, steps: int, what: str) -> dict[str, NDArray[Any]]:
    """Columns of `count` minutiae of six bytes; `steps` directions in a turn; `what` they are, for messages. Two bits
    of type and 14 of column, two reserved and 14 of row (all big-endian), a byte of direction, one of quality.
    """
    table = np.frombuffer(cursor.take(count * _MINUTIA.itemsize, f"the {count} minutiae of {what}"), dtype=_MINUTIA)
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


def encode_minutiae(view: FingerView, steps: int, max_quality: int) -> bytes:
    """Bytes of a view's minutiae, six for each, directions rounded to the nearest of `steps` in a turn; qualities above
    `max_quality` (none known) become 0.
    """
    require(
        view.count <= MAX_MINUTIAE,
        f"a view holds at most {MAX_MINUTIAE} minutiae, but there are {view.count}; take FingerView.best().",
    )
    table = np.zeros(view.count, dtype=_MINUTIA)
    table["x"] = np.asarray(view.x_px) | (np.asarray(view.type).astype(np.int64) << 14)
    table["y"] = view.y_px
    table["direction"] = np.round(np.asarray(view.direction_rad) * (steps / (2 * np.pi))).astype(np.int64) % steps
    table["quality"] = np.where(np.asarray(view.quality) <= max_quality, view.quality, 0)
    return table.tobytes()


def make_view(name: str, what: str, **fields: Any) -> FingerView:
    """Make a view of what was read; what does not fit is said with the file's `name` and `what` it is."""
    return naming(f"{name}, {what}", lambda: FingerView(**fields))


def check_writable(record: MinutiaeRecord, standard: str, device_bits: int, certification_bits: int) -> None:
    """Require what every standard demands of a record before it is written."""
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


def common_image(record: MinutiaeRecord, standard: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Size and resolution that all views share, as standards with one of them in their header need."""
    first = record.views[0]
    equal = all(view.size == first.size and view.resolution_ppcm == first.resolution_ppcm for view in record.views)
    require(
        equal,
        f"{standard} has one image size and one resolution a record, but the views differ; write a record for each.",
    )
    return first.size, first.resolution_ppcm


# Views of fingers as ISO/IEC 19794-2:2005 and ANSI/INCITS 378-2004 both write them: 6 bytes and 6 for each minutia.

_VIEW = struct.Struct(">BBBB")
_EXTENDED = struct.Struct(">H")


@dataclass(frozen=True, slots=True)
class ViewCodes:
    """In what the two standards differ."""

    standard: str
    steps: int
    """Directions in a turn."""
    impressions: Mapping[str, int]
    nearest: Mapping[str, str]
    """Impression types without a code, and what is written for them."""


def encode_views(views: tuple[FingerView, ...], codes: ViewCodes) -> bytes:
    """Bytes of all views. Raises BadInput if the standard cannot represent what a view holds."""
    return b"".join(_encode_view(view, codes) for view in views)


def decode_views(
    cursor: Cursor, count: int, size: tuple[int, int], resolution_ppcm: tuple[int, int], codes: ViewCodes
) -> tuple[FingerView, ...]:
    """Read `count` views, which fill the rest of the record; BadInput if truncated or not as the standard allows."""
    views = []
    for number in range(1, count + 1):
        what, name = f"view {number}", cursor.name
        position, packed, quality, minutiae = cursor.unpack(_VIEW, f"the header of {what}")
        table = decode_minutiae(cursor, minutiae, codes.steps, what)
        (extended,) = cursor.unpack(_EXTENDED, f"the length of the extended data of {what}")
        require(
            quality <= 100 and (minutiae == 0 or int(table["quality"].max()) <= 100),
            f"{name}: a quality of {what} is above 100, the highest.",
        )
        fields = {
            "size": size,
            "finger_quality": quality,
            "finger": name_of(position, FINGER_CODES, f"finger position of {what} of {name}"),
            "impression": name_of(packed & 15, codes.impressions, f"impression type of {what} of {name}"),
            "view": packed >> 4,
            "resolution_ppcm": resolution_ppcm,
            "extended": cursor.take(extended, f"the extended data of {what}"),
        }
        views.append(make_view(name, what, **table, **fields))
    check_rest(cursor, count)
    return tuple(views)


def _encode_view(view: FingerView, codes: ViewCodes) -> bytes:
    require(
        view.finger_quality <= 100,
        f"the finger's quality is {view.finger_quality} (not computed), which {codes.standard} cannot represent; "
        "give 0 to 100.",
    )
    impression = codes.nearest.get(view.impression, view.impression)
    packed = view.view << 4 | standard_code(impression, codes.impressions, "impression type")
    minutiae = encode_minutiae(view, codes.steps, 100)
    head = _VIEW.pack(FINGER_CODES[view.finger], packed, view.finger_quality, view.count)
    return head + minutiae + _EXTENDED.pack(len(view.extended)) + view.extended


# Which standard's record a file is: minutiae records of several standards begin with the same eight bytes.

ISO_2005 = "ISO/IEC 19794-2:2005"
ISO_2011 = "ISO/IEC 19794-2:2011"
ANSI_2004 = "ANSI/INCITS 378-2004"
ANSI_2009 = "ANSI/INCITS 378-2009"
ANSI_2009_AM1 = "ANSI/INCITS 378-2009 amendment 1"

MAGIC_20 = b"FMR\0 20\0"
"""Of ISO/IEC 19794-2:2005 and of ANSI/INCITS 378-2004."""
MAGIC_030 = b"FMR\x00030\0"
"""Of ISO/IEC 19794-2:2011 and of ANSI/INCITS 378-2009."""
MAGIC_035 = b"FMR\x00035\0"
"""Of amendment 1 to ANSI/INCITS 378-2009."""

_OTHERS = (
    (b"FIR\0", "a finger image record (ISO/IEC 19794-4 or ANSI/INCITS 381)"),
    (b"FAC\0", "a face record (ISO/IEC 19794-5)"),
    (b"IIR\0", "an iris record (ISO/IEC 19794-6)"),
    (b"\xff\xa0", "a WSQ image"),
    (b"1.001:", "an ANSI/NIST-ITL transaction"),
    (b"SKTMPL\r\n", "a template of splitknit (.skt)"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"II*\0", "a TIFF image"),
    (b"MM\0*", "a TIFF image"),
    (b"PK\x03\x04", "a ZIP or NPZ file"),
    (b"{", "a JSON file"),
)
_ENVELOPE_BYTES = 4096
_TOLD_APART_BYTES = 14
"""Fewer do not distinguish the standards."""


def standard_of(data: bytes) -> str | None:
    """Return the standard of a minutiae record, by its header alone; None if it is no such record. `data`: the file, or
    its first bytes. ISO/IEC 19794-2:2005 gives its length in four bytes, ANSI/INCITS 378-2004 in two (or, from 64 KiB,
    in six), in the same place. The length that fits the file decides; if none does, the one that is possible.

    >>> standard_of(b"FMR\\0 20\\0" + bytes([0, 0, 0, 32]) + bytes(20))
    'ISO/IEC 19794-2:2005'
    >>> standard_of(b"FMR\\0 20\\0" + bytes([0, 34]) + bytes(24))
    'ANSI/INCITS 378-2004'
    """
    if data[:8] == MAGIC_20:
        return _of_20(data)
    if data[:8] == MAGIC_030:
        return ISO_2011 if _is_iso_2011(data) else ANSI_2009
    return ANSI_2009_AM1 if data[:8] == MAGIC_035 else None


def require_standard(data: bytes, wanted: str, magic: bytes, name: str) -> None:
    """Raise :class:`BadInput`, with what the bytes are instead, unless they are a record of the `wanted` standard."""
    found = standard_of(data)
    if not data:
        raise BadInput(f"{name} is empty; a record of {wanted} is expected.")
    if len(data) < _TOLD_APART_BYTES and data[: len(magic)] == magic[: len(data)]:
        raise BadInput(f"{name} is truncated: it ends after {len(data)} bytes of the header; copy it again.")
    if found == wanted:
        return
    if found is not None:
        raise BadInput(
            f"{name} is a record of {found}, but one of {wanted} is expected; convert it or read it as such."
        )
    raise BadInput(f"{name} is {what_bytes_are(data)}, but a record of {wanted} is expected.")


def _of_20(data: bytes) -> str:
    short, whole = int.from_bytes(data[8:10], "big"), int.from_bytes(data[8:12], "big")
    if whole == len(data):
        return ISO_2005
    if len(data) in (short, int.from_bytes(data[10:14], "big")) and (short > 0 or len(data) > 65535):
        return ANSI_2004
    if short:  # 26 and more would be a record of 1.7 MB by ISO
        return ANSI_2004 if short >= 26 else ISO_2005
    return ANSI_2004 if whole < 24 else ISO_2005  # the first bytes of a length in six


def _is_iso_2011(data: bytes) -> bool:
    """Whether the lengths of the representations, of 34 bytes at least each, add up to that of the record."""
    total, place = int.from_bytes(data[8:12], "big"), 15
    for _ in range(int.from_bytes(data[12:14], "big")):
        length = int.from_bytes(data[place : place + 4], "big")
        if length < 34 or place + length > total:
            return False
        place += length
        if place > len(data):
            return True
    return place == total


def what_bytes_are(data: bytes, otherwise: str = "no minutiae record (it does not begin with 'FMR')") -> str:
    """Name what a file is by its bytes, for messages; `otherwise` where they are not known."""
    if not data:
        return "empty"
    for start, words in _OTHERS:
        if data.startswith(start):
            return words
    if data[:4] == b"FMR\0":
        return f"a minutiae record of an unknown version {data[4:8]!r}"
    at = data.find(b"FMR\0", 1, _ENVELOPE_BYTES)
    if at > 0:
        return f"an envelope (CBEFF?) with a minutiae record inside, {at} bytes from its beginning"
    return otherwise
