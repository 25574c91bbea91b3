"""Prints in transactions of ANSI/NIST-ITL, in the traditional encoding.

Read are records of Type-14, of latent prints (Type-13), and of Type-4 with a single finger; others
are passed over.

Source: ANSI/NIST-ITL 1-2011, update 2015 (NIST Special Publication 500-290 edition 3): clause 8,
annex B (traditional encoding).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping

from splitknit import BadInput
from splitknit.errors import naming, require
from splitknit.findings import Finding
from splitknit_match.records.finger_image import (
    MAX_PIXELS,
    compression_of,
    decode_print,
    impression_of,
    ppi_of,
)
from splitknit_match.records.minutiae_record import FINGER_CODES, ITL_IMPRESSIONS, name_of
from splitknit_match.records.pictures import PrintFile

_START = re.compile(rb"([0-9]{1,2})\.0{0,2}1:([0-9]{1,10})\x1d")
_TAG = re.compile(rb"[0-9]{1,2}\.([0-9]{1,9}):")
_RECORD_END, _FIELD_END, _ITEM_END, _PART_END = b"\x1c", b"\x1d", b"\x1e", b"\x1f"
_BINARY = (3, 4, 5, 6, 7, 8)
"""Types whose records begin with their length in four bytes; which they are, only 1.003 states.
Source: ANSI/NIST-ITL 1."""
_COMPRESSIONS = {"NONE": "none", "WSQ20": "wsq", "PNG": "png", "JP2L": "jp2", "JP2": "jp2"}
_LATENT = Finding(
    "latent-print",
    "it is a latent print: false match rates were measured on prints of live fingers.",
)
_TYPE4 = struct.Struct(">5xB6sBHHB")
_TYPE4_COMPRESSIONS = {0: "none", 1: "wsq", 4: "jp2", 5: "jp2", 6: "png"}
_INCH_MM = 25.4
"""Source: definition of the inch."""
_MIN_PPI = 490.0
"""Least resolution: a print below the class of 500 ppi is not an exemplar. Source: ANSI/NIST-ITL 1
(class of 500 ppi)."""

_Fields = Mapping[int, bytes]


def decode_transaction(data: bytes, name: str = "the transaction") -> tuple[PrintFile, ...]:
    """Read the prints of a transaction.

    Raises BadInput, with `name`, if `data` is not a transaction in the traditional encoding, is
    damaged, holds no print, or one that is not 8-bit grey or not compressed by ``NONE``, ``WSQ20``,
    ``PNG``, ``JP2`` or ``JP2L``.
    """
    prints: list[PrintFile] = []
    first: _Fields = {}
    for number, (kind, record) in enumerate(_records(data, name), start=1):
        what = f"record {number} (Type-{kind}) of {name}"
        left = MAX_PIXELS - sum(item.image.size for item in prints)
        if kind == 1:
            first = _fields(record)
        elif kind == 4:
            prints += _type4(record, first, left, what)
        elif kind in (13, 14):
            prints.append(_type14(_fields(record), left, what, (_LATENT,) * (kind == 13)))
    require(prints, f"{name} holds no print of a single finger (no record of Type-14, -13 or -4).")
    return tuple(prints)


_MAX_RECORDS = 1000  # of a transaction


def _records(data: bytes, name: str) -> Iterator[tuple[int, bytes]]:
    """Type and bytes of each record, by the lengths that they state."""
    require(
        _START.match(data) is not None,
        f"{name} is not an ANSI/NIST-ITL transaction (it does not begin with '1.001:'); name"
        " another file.",
    )
    kinds: list[int] = []
    place = 0
    for count in range(_MAX_RECORDS + 1):
        if place >= len(data):
            return
        require(count < _MAX_RECORDS, f"{name} has more than {_MAX_RECORDS} records; split it.")
        start = _START.match(data, place)
        kind = kinds[count] if count < len(kinds) else 0
        binary = kind in _BINARY
        if binary:
            length = int.from_bytes(data[place : place + 4], "big")
            require(
                length > _TYPE4.size or kind != 4,
                f"a Type-4 record of {name} holds no image; it is damaged.",
            )
            least = 5
        elif start is not None:
            kind = int(start[1])
            length = int(start[2])
            least = len(start[0]) + 1
        else:
            raise BadInput(f"{name} is damaged: no record begins at byte {place}; copy it again.")
        require(
            (kind == 1) == (place == 0),
            f"{name} must begin with its only Type-1 record; it is damaged.",
        )
        rest = len(data) - place
        require(
            least <= length <= rest,
            f"{name} is truncated: its Type-{kind} record has {length} bytes, but {rest} are left;"
            " copy it again.",
        )
        record = data[place : place + length]
        require(
            binary or record.endswith(_RECORD_END),
            f"{name} is damaged: its Type-{kind} record does not end where its length field has"
            " it; copy it again.",
        )
        if kind == 1:
            content = _fields(record).get(3, b"").split(_ITEM_END)  # the types of all records
            types = [item.split(_PART_END)[0] for item in content[: _MAX_RECORDS + 1]]
            kinds = [int(text) if text.isdigit() and len(text) <= 2 else 0 for text in types]
        yield kind, record
        place += length


def _fields(record: bytes) -> dict[int, bytes]:
    """Contents of a tagged record's fields by their numbers; the image is the last, 999."""
    fields = {}
    place, end = 0, len(record) - len(_RECORD_END)
    while place < end:
        tag = _TAG.match(record, place)
        if tag is None:
            break
        number = int(tag[1])
        stop = end if number == 999 else record.find(_FIELD_END, place)
        stop = end if stop < 0 else stop
        fields[number] = record[tag.end() : stop]
        place = stop + 1
    return fields


def _type14(fields: _Fields, left: int, name: str, findings: tuple[Finding, ...]) -> PrintFile:
    """The print of a record: field 11 is its compression, 12 its bits a pixel, 999 the image."""
    compression = _text(fields, 11, name)
    read = ", ".join(_COMPRESSIONS)
    require(
        compression in _COMPRESSIONS,
        f"{name} is compressed as {compression[:20]!a}; {read} are read: convert it.",
    )
    require(_number(fields, 12, name) == 8, f"{name} is not 8-bit grey; convert it.")
    require(fields.get(999), f"{name} holds no image (field 999).")
    unit, x, y, rows, columns, position, code = (
        # unit, resolution along rows and columns, rows, columns, finger, impression type
        _number(fields, field, name)
        for field in (8, 9, 10, 7, 6, 13, 3)
    )
    ppi = ppi_of(unit, x, y, name)
    image = decode_print(
        fields[999], _COMPRESSIONS[compression], name, size=(rows, columns), limit=left
    )
    finger = naming(name, lambda: name_of(position, FINGER_CODES, "finger position"))
    impression = naming(name, lambda: name_of(code, ITL_IMPRESSIONS, "impression type"))
    return _checked(PrintFile(image, ppi, {}, finger, impression, findings), name)


def _type4(record: bytes, first: _Fields, left: int, name: str) -> list[PrintFile]:
    """Print of a binary record of 500 ppi or the transaction's own resolution; none if it shows
    several fingers."""
    code, positions, scale, columns, rows, compression = _TYPE4.unpack_from(record)
    if positions[0] not in FINGER_CODES.values():
        return []  # plain impressions of several fingers, and of thumbs beside them
    ppi = 500.0
    if scale != 0:
        text = first.get(11, b"").decode("ascii", "replace")
        require(
            re.fullmatch(r"[0-9]{1,3}\.[0-9]{1,2}", text) is not None,
            f"{name} states no resolution (1.011).",
        )
        ppi = float(text) * _INCH_MM
    kind = compression_of(compression, _TYPE4_COMPRESSIONS, name)
    image = decode_print(record[_TYPE4.size :], kind, name, size=(rows, columns), limit=left)
    finger = name_of(positions[0], FINGER_CODES, "finger position")
    return [_checked(PrintFile(image, ppi, {}, finger, impression_of(code, ITL_IMPRESSIONS)), name)]


_MAX_PPI = 5080.0  # highest resolution of a print


def _checked(item: PrintFile, name: str) -> PrintFile:
    """Refuse a picture that is no print."""
    rows, columns = item.image.shape
    require(
        min(rows, columns) >= 10,
        f"{name} has {rows} x {columns} pixels; a print has 10 each way at least.",
    )
    ppi = item.resolution_ppi or 0.0
    require(
        _MIN_PPI <= ppi <= _MAX_PPI,
        f"{name}: a print of a transaction has {_MIN_PPI:g} to {_MAX_PPI:g} ppi, not {ppi:g};"
        " resample it.",
    )
    return item


def _text(fields: _Fields, field: int, name: str) -> str:
    text = fields.get(field, b"")
    require(text, f"{name} lacks the field {field}; it does not conform to ANSI/NIST-ITL.")
    return text.decode("ascii", "replace")


def _number(fields: _Fields, field: int, name: str) -> int:
    text = _text(fields, field, name)
    require(
        text.isascii() and text.isdecimal() and len(text) <= 5,
        f"{name} has {text[:20]!a} for the field {field}, where a whole number of at most 5 digits"
        " is expected.",
    )
    return int(text)
