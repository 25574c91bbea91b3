"""Transactions of ANSI/NIST-ITL: their frame is checked here, their fields are written and parsed by `nistitl`.

A Type-1, a minimal Type-2, and for every print a Type-14; Type-13 for a latent print, Type-15 for a palm. Equal input
gives equal bytes: date and control number are given, not made up.

Source: ANSI/NIST-ITL 1-2011, update 2015 (NIST Special Publication 500-290 edition 3): clause 8, annex B (traditional
encoding).
"""

from __future__ import annotations

import datetime
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.errors import importing, refusing, require
from splitknit.io.prints import PrintFile
from splitknit_match.records.finger_image import MAX_PIXELS, decode_print, encode_print
from splitknit_match.records.minutiae_record import (
    FINGER_CODES,
    ITL_IMPRESSIONS,
    LATENT_IMPRESSIONS,
    PALM_CODES,
    PALM_IMPRESSIONS,
    name_of,
    standard_code,
)

VERSION = "0502"
COMPRESSIONS = {"none": "NONE", "wsq": "WSQ20", "png": "PNG", "jp2": "JP2L"}
"""Names, and their codes in field 14.011."""
MAX_PRINTS = 98
"""Information designation characters go from 0 to 99; 0 is that of Type-2."""
_DATES = {14: "FCD", 13: "LCD", 15: "PCD"}
"""Types of records that hold one picture, and the names of their dates of capture."""
TEXTS = {"SHPS": r"[0-9]{2,5}", "SVPS": r"[0-9]{2,5}", "COM": r"[ -~]{1,126}", "FCT": r"[0-9]{1,2}",
         "MMS": r"[ -+\--~]{1,50}(,[ -+\--~]{1,50}){2}"}  # fmt: skip
"""Fields that a print's `text` may hold, and what they are: pixels an inch of the capture (14.016, .017), comment
(.020), technology of the capture (.901), and make, model and serial number of the device, with commas (.904)."""
MIN_PPI, MAX_PPI = 490.0, 5080.0
"""A print below the class of 500 ppi is not an exemplar."""


@dataclass(frozen=True, slots=True)
class TransactionFacts:
    """Facts of the whole transaction."""

    date: datetime.date
    """Date of the capture and of the transaction (fields 1.005, 14.005)."""
    control_number: str
    """Names this transaction among those of its originator (1.009)."""
    kind: str = "OTHER"
    """Type of transaction, agreed on with the receiver (1.004)."""
    destination: str = "UNKNOWN"
    """Agency that receives it (1.007)."""
    originator: str = "SPLITKNIT"
    """Agency that sends it (1.008), and that captured the prints (14.004)."""

    def __post_init__(self) -> None:
        for name in ("control_number", "kind", "destination", "originator"):
            text = getattr(self, name)
            sound = isinstance(text, str) and 0 < len(text) <= 40 and text.isascii() and text.isprintable()
            require(
                sound and ":" not in text,
                f"{name} of a transaction must be 1 to 40 printable ASCII characters without ':', but it is {text!a}.",
            )


def encode_transaction(prints: Sequence[PrintFile], facts: TransactionFacts, compression: str = "none") -> bytes:
    """Bytes of a transaction of 1 to 98 prints; the k-th gets the information designation character k.

    `compression`: ``none``, ``png``, ``jp2``, or ``wsq``, which loses a little and is for 500 ppi alone (field 14.011).
    Raises BadInput if there are none or too many, one cannot be compressed so, or the package `nistitl` is not
    installed.
    """
    require(1 <= len(prints) <= MAX_PRINTS, f"a transaction takes 1 to {MAX_PRINTS} prints, not {len(prints)}.")
    known = ", ".join(COMPRESSIONS)
    require(compression in COMPRESSIONS, f"'{compression}' is not a compression method; choose one of {known}.")
    nistitl = _itl_package()
    date = facts.date.strftime("%Y%m%d")
    message = nistitl.Message()
    agencies = {"DAI": facts.destination, "ORI": facts.originator}
    first = {"VER": VERSION, "TOT": facts.kind, "DAT": date, **agencies, "TCN": facts.control_number}
    for name, value in (first | {"NSR": "00.00", "NTR": "00.00"}).items():
        setattr(message[0], name, value)
    second = nistitl.AsciiRecord(2)
    second.IDC = 0
    message += second
    for number, item in enumerate(prints, start=1):
        message += _record(nistitl, item, compression, number, (facts.originator, date))
    return bytes(message.NIST)


def _itl_package() -> Any:
    with importing("ANSI/NIST-ITL files need the package nistitl: pip install 'splitknit-match[records]'."):
        import nistitl  # type: ignore[import-untyped,import-not-found,unused-ignore]  # an extra
    return nistitl


def _record(nistitl: Any, item: PrintFile, compression: str, number: int, source: tuple[str, str]) -> Any:
    """Record of a print, latent print or palm, of an agency and date; in pixels per inch (SLC 1)."""
    ppi = _checked(item).resolution_ppi or 0.0
    palm, latent = item.finger in PALM_CODES, item.impression in LATENT_IMPRESSIONS
    kind = 15 if palm else 13 if latent else 14
    impression = standard_code(item.impression, ITL_IMPRESSIONS, "impression type")
    require(
        item.impression in ("other", "unknown") or palm == (item.impression in PALM_IMPRESSIONS),
        f"'{item.impression}' is not an impression type of '{item.finger}'; name a {'palm' if palm else 'finger'}'s.",
    )
    (rows, columns), record = item.image.shape, nistitl.AsciiRecord(kind)
    fields = {"IDC": number, "SRC": source[0], _DATES[kind]: source[1], "IMP": impression, "HLL": columns, "VLL": rows}
    position = standard_code(item.finger, {**FINGER_CODES, **PALM_CODES}, "finger")
    fields |= {"SLC": 1, "THPS": round(ppi), "TVPS": round(ppi)}
    fields |= {"CGA": COMPRESSIONS[compression], "BPX": 8, "FGP": position}
    for name, value in fields.items():
        setattr(record, name, str(value))
    for name in TEXTS.keys() & item.text.keys():
        text = item.text[name]
        require(re.fullmatch(TEXTS[name], text) is not None, f"{text[:60]!a} cannot be written as field {name}.")
        setattr(record, name, [text.split(",")] if name == "MMS" else text)
    record.DATA = encode_print(item.image, ppi, compression)
    return record


def _checked(item: PrintFile) -> PrintFile:
    """Refuse a print that a record cannot hold."""
    array = np.asarray(item.image)
    require(
        array.ndim == 2 and array.dtype == np.uint8 and min(array.shape) >= 10 and max(array.shape) <= 99_999,
        f"a print must be (H, W) uint8, 10 to 99999 pixels each way, not {array.shape} {array.dtype}.",
    )
    ppi = item.resolution_ppi or 0.0
    require(
        MIN_PPI <= ppi <= MAX_PPI,
        f"a print of a transaction has {MIN_PPI:g} to {MAX_PPI:g} ppi, not {ppi:g}; resample it.",
    )
    return item


_START = re.compile(rb"([0-9]{1,2})\.0{0,2}1:([0-9]{1,10})\x1d")
_MAX_RECORDS = 1000
_SEPARATOR, _WITHIN = b"\x1c", (b"\x1d", b"\x1e", b"\x1f")
_MAX_PARTS = 100_000
"""Fields and their parts, before the images: the package makes Python objects of each."""
_INCH_MM, _CM_MM = 25.4, 10.0
_LATENT = "it is a latent print: false match rates were measured on prints of live fingers."
_BINARY = (3, 4, 5, 6, 7, 8)
"""Types whose records begin with their length in four bytes; which they are, only 1.003 states."""
_TYPE4 = struct.Struct(">B6sBHHB")
_TYPE4_COMPRESSIONS = {0: "none", 1: "wsq", 4: "jp2", 5: "jp2", 6: "png"}
_CONTENT = re.compile(rb"\x1d1\.0{0,2}3:([0-9\x1e\x1f]{1,9000})[\x1d\x1c]")


def decode_transaction(data: bytes, name: str = "the transaction") -> tuple[PrintFile, ...]:
    """Read the prints of a transaction: records of Type-14, Type-4 with a single finger, Type-13 and Type-15; of
    these two, what cannot be read is passed over where there are others.

    Raises BadInput, with `name`, if `data` is not a transaction in the traditional encoding, is damaged, holds no
    print, or one that is not 8-bit grey or not compressed by ``NONE``, ``WSQ20``, ``PNG``, ``JP2`` or ``JP2L``.
    """
    _check_frame(data, name)
    nistitl = _itl_package()
    message = nistitl.Message()
    with refusing(f"{name} is a damaged ANSI/NIST-ITL transaction; copy it again."):
        message.parse(data)
        records = list(message)
    named = [
        (record, f"Type-{kind} record {place} of {name}")
        for kind in (14, 4, 13, 15)
        for place, record in enumerate((record for record in records if record.type == kind), start=1)
    ]
    require(len(named) > 0, f"{name} holds no print (no record of Type-14, -13, -15 or -4).")
    short = next((words for record, words in named if record.type == 4 and len(record.value) <= _TYPE4.size), None)
    require(short is None, f"{short} holds no image; the file is damaged.")
    _check_first(records[0], name)
    found, pixels = [], 0
    for record, words in named:
        try:
            pixels += int(np.prod(_size(record, words)))
            too_many = f"{name} claims {pixels} pixels, more than the {MAX_PIXELS} that are read; split it."
            require(pixels <= MAX_PIXELS, too_many)
            found.append(_type4(record, words, records[0]) if record.type == 4 else _print(record, words))
        except BadInput:
            if record.type not in (13, 15) or named[0][0].type == record.type:
                raise  # else there are prints beside it
    prints = tuple(one for one in found if one is not None)
    require(len(prints) > 0, f"{name} holds no print of a single finger.")
    return prints


def _size(record: Any, name: str) -> tuple[int, int]:
    if record.type != 4:
        return _number(record, "VLL", name), _number(record, "HLL", name)
    _, _, _, columns, rows, _ = _TYPE4.unpack_from(record.value)
    return rows, columns


def _type4(record: Any, name: str, first: Any) -> PrintFile | None:
    """Print of a binary record of 500 ppi or the transaction's own resolution; None if it shows several fingers."""
    impression, positions, scale, columns, rows, code = _TYPE4.unpack_from(record.value)
    if positions[0] not in FINGER_CODES.values():
        return None  # plain impressions of several fingers, and of thumbs beside them
    require(code in _TYPE4_COMPRESSIONS, f"{name} is compressed by code {code}; none, WSQ, JPEG 2000 and PNG are read.")
    ppi = 500.0
    if scale != 0:
        text = _text(first, "NSR", f"the Type-1 record of {name}")
        require(re.fullmatch(r"[0-9]{1,3}\.[0-9]{1,2}", text) is not None, f"{name} states no resolution (1.011).")
        ppi = float(text) * _INCH_MM
    image = decode_print(record.value[_TYPE4.size :], _TYPE4_COMPRESSIONS[code], (rows, columns), name)
    kind = next((words for words, known in ITL_IMPRESSIONS.items() if known == impression), "unknown")
    return _checked(PrintFile(image, ppi, {}, name_of(positions[0], FINGER_CODES, "finger position"), kind))


def _check_frame(data: bytes, name: str) -> None:
    """Walk the records by the lengths that they give, before anything is copied."""
    place, count, parts = 0, 0, 0
    listed = _CONTENT.search(data, 0, 10_000)
    kinds = [] if listed is None else [one.split(b"\x1f")[0] for one in listed[1].split(b"\x1e")]
    while place < len(data):
        found = _START.match(data, place)
        if found is None and place == 0:
            raise BadInput(
                f"{name} is not an ANSI/NIST-ITL transaction (it does not begin with '1.001:'); name another file."
            )
        if count < len(kinds) and kinds[count] in [b"%d" % kind for kind in _BINARY]:
            length = int.from_bytes(data[place : place + 4], "big")
            require(
                5 <= length <= len(data) - place,
                f"{name} is truncated: its Type-{int(kinds[count])} record has {length} bytes, but {len(data) - place} "
                "are left; copy it again.",
            )
            place, count = place + length, count + 1
            continue
        if found is None:
            raise BadInput(f"{name} is damaged: no record begins at byte {place}; copy it again.")
        kind, length = int(found.group(1)), int(found.group(2))
        require((kind == 1) == (place == 0), f"{name} must begin with its only Type-1 record; it is damaged.")
        require(
            place + length <= len(data),
            f"{name} is truncated: its Type-{kind} record has {length} bytes, but {len(data) - place} are left; copy "
            "it again.",
        )
        whole = length > len(found.group(0)) and data[place + length - 1 : place + length] == _SEPARATOR
        require(
            whole,
            f"{name} is damaged: its Type-{kind} record does not end where its length field has it; copy it again.",
        )
        texts = data[place : place + length].split(b".999:")[0]
        parts += sum(texts.count(separator) for separator in _WITHIN)
        require(parts <= _MAX_PARTS, f"{name} has more than {_MAX_PARTS} fields; split it.")
        place, count = place + length, count + 1
        require(count <= _MAX_RECORDS, f"{name} has more than {_MAX_RECORDS} records; split it.")
    require(count > 0, f"{name} is empty; an ANSI/NIST-ITL transaction is expected.")


def _check_first(record: Any, name: str) -> None:
    """Refuse a transaction whose Type-1 record does not state its facts."""
    texts = {key: _text(record, key, f"the Type-1 record of {name}") for key in ("TOT", "DAT", "DAI", "ORI", "TCN")}
    try:
        date = datetime.datetime.strptime(texts["DAT"], "%Y%m%d").date()
        TransactionFacts(date, texts["TCN"], texts["TOT"], texts["DAI"], texts["ORI"])
    except ValueError as error:  # BadInput is one
        words = ascii((" ".join(str(error).split()) or type(error).__name__)[:120])[1:-1]
        raise BadInput(f"{name} has a Type-1 record that cannot be read: {words}") from error


def _print(record: Any, name: str) -> PrintFile:
    rows, columns = _number(record, "VLL", name), _number(record, "HLL", name)
    compression = _text(record, "CGA", name)
    names = {code: word for word, code in COMPRESSIONS.items()} | {"JP2": "jp2"}
    require(
        compression in names,
        f"{name} is compressed as {compression[:20]!a}; only {', '.join(COMPRESSIONS.values())} are read: convert it.",
    )
    require(_number(record, "BPX", name) == 8, f"{name} is not 8-bit grey; convert it.")
    data = record[999].value if record[999] is not None else b""
    require(isinstance(data, bytes) and len(data) > 0, f"{name} holds no image (field {record.type}.999).")
    ppi = _resolution(record, name)
    try:
        image = decode_print(data, names[compression], (rows, columns), name)
        known = {14: FINGER_CODES, 15: PALM_CODES, 13: {**FINGER_CODES, **PALM_CODES}}[record.type]
        finger = name_of(_number(record, "FGP", name), known, "finger position")
        impression = name_of(_number(record, "IMP", name), ITL_IMPRESSIONS, "impression type")
        text = {key: _joined(record[key].value) for key in TEXTS if record[key] is not None}
        text = {key: one for key, one in text.items() if re.fullmatch(TEXTS[key], one)}
        return _checked(PrintFile(image, ppi, text, finger, impression, _LATENT if record.type == 13 else ""))
    except BadInput as error:
        raise BadInput(str(error) if name in str(error) else f"{name}: {error}") from error


def _joined(value: Any) -> str:
    """Text of a field, or of its items and subfields with commas."""
    return ",".join(map(_joined, value)) if isinstance(value, list) else str(value)


def _resolution(record: Any, name: str) -> float:
    unit, x, y = (_number(record, key, name) for key in ("SLC", "THPS", "TVPS"))
    require(unit in (1, 2), f"{name} gives no resolution (scale units {unit}; 1 or 2 is expected).")
    require(x == y, f"{name} has {x} pixels along and {y} across; square pixels are expected.")
    return float(x) if unit == 1 else x * _INCH_MM / _CM_MM


def _text(record: Any, key: str, name: str) -> str:
    field = record[key]
    value = None if field is None else field.value
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, str) or not value:
        raise BadInput(f"{name} lacks the field {key}; it does not conform to ANSI/NIST-ITL.")
    return value


def _number(record: Any, key: str, name: str) -> int:
    text = _text(record, key, name)
    require(
        text.isascii() and text.isdecimal() and len(text) <= 5,
        f"{name} has {text[:20]!a} for {key}, where a whole number of at most 5 digits is expected.",
    )
    return int(text)
