"""Transactions of ANSI/NIST-ITL read: their frame is checked here, their fields are parsed by `nistitl`.

References
----------
ANSI/NIST-ITL 1-2011, update 2015, annex B (traditional encoding).
"""

from __future__ import annotations

import datetime
import os
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, refusing, require
from splitknit.io.finger_codes import FINGER_CODES, ITL_IMPRESSIONS, name_of
from splitknit.io.itl_transaction import COMPRESSIONS, Transaction, TransactionFacts, TransactionPrint, itl_package
from splitknit.io.png import decode_png, png_header
from splitknit.io.wsq_image import decode_wsq

_MAX_BYTES = 200_000_000
_START = re.compile(rb"([0-9]{1,2})\.0{0,2}1:([0-9]{1,10})\x1d")
_MOST_RECORDS = 1000
_MOST_PIXELS = 64_000_000
_SEPARATOR, _WITHIN = b"\x1c", (b"\x1d", b"\x1e", b"\x1f")
_MOST_PARTS = 100_000
"""Fields and their parts, before the images: the package makes Python objects of each."""
_INCH_MM, _CM_MM = 25.4, 10.0


def decode_transaction(data: bytes, name: str = "the transaction") -> Transaction:
    """Read the prints (Type-14 records) of a transaction; records of other types are passed over.

    Parameters
    ----------
    data : the whole file
    name : of the file, for messages

    Raises
    ------
    BadInput
        If it is no transaction in the traditional encoding, truncated or damaged, holds no print, or one that is not
        8-bit grey or compressed otherwise than ``NONE``, ``WSQ20`` or ``PNG``.
    """
    _check_frame(data, name)
    nistitl = itl_package()
    message = nistitl.Message()
    with refusing(f"{name} is a damaged ANSI/NIST-ITL transaction; copy it again."):
        message.parse(data)
        records = list(message)
    prints = tuple(
        _print(record, f"Type-14 record {place} of {name}")
        for place, record in enumerate((record for record in records if record.type == 14), start=1)
    )
    require(len(prints) > 0, f"{name} holds no print (no Type-14 record).")
    return Transaction(prints, _facts(records[0], name))


def read_transaction(path: str | os.PathLike[str]) -> Transaction:
    """Read a transaction's file; see :func:`decode_transaction`."""
    return decode_transaction(read_bytes(path, _MAX_BYTES), os.fspath(path))


def _check_frame(data: bytes, name: str) -> None:
    """Walk the records by the lengths that they give, before anything is copied."""
    place, count, parts = 0, 0, 0
    while place < len(data):
        found = _START.match(data, place)
        if found is None and place == 0:
            raise BadInput(
                f"{name} is no ANSI/NIST-ITL transaction (it does not begin with '1.001:'); name another file."
            )
        if found is None:
            raise BadInput(
                f"{name} is damaged, or holds binary records (Type-3 to Type-8), which are not read: no record begins "
                f"at byte {place}."
            )
        kind, length = int(found.group(1)), int(found.group(2))
        require((kind == 1) == (place == 0), f"{name} must begin with its only Type-1 record; it is damaged.")
        require(
            place + length <= len(data),
            f"{name} is truncated: its Type-{kind} record has {length} bytes, but {len(data) - place} are left; copy "
            "it again.",
        )
        whole = length > len(found.group(0)) and data[place + length - 1 : place + length] == _SEPARATOR
        require(whole, f"{name} is damaged: its Type-{kind} record does not end where its length says; copy it again.")
        texts = data[place : place + length].split(b".999:")[0]
        parts += sum(texts.count(separator) for separator in _WITHIN)
        require(parts <= _MOST_PARTS, f"{name} has more than {_MOST_PARTS} fields; split it.")
        place, count = place + length, count + 1
        require(count <= _MOST_RECORDS, f"{name} has more than {_MOST_RECORDS} records; split it.")
    require(count > 0, f"{name} is empty; an ANSI/NIST-ITL transaction is expected.")


def _facts(record: Any, name: str) -> TransactionFacts:
    texts = {key: _text(record, key, f"the Type-1 record of {name}") for key in ("TOT", "DAT", "DAI", "ORI", "TCN")}
    try:
        date = datetime.datetime.strptime(texts["DAT"], "%Y%m%d").date()
        return TransactionFacts(date, texts["TCN"], texts["TOT"], texts["DAI"], texts["ORI"])
    except ValueError as error:  # BadInput is one
        raise BadInput(f"{name} has a Type-1 record that cannot be read: {_short(error)}") from error


def _print(record: Any, name: str) -> TransactionPrint:
    rows, columns = _number(record, "VLL", name), _number(record, "HLL", name)
    require(rows * columns <= _MOST_PIXELS, f"{name} claims {rows} x {columns} pixels; no print is that large.")
    compression = _text(record, "CGA", name)
    names = {code: word for word, code in COMPRESSIONS.items()}
    require(
        compression in names,
        f"{name} is compressed as {compression[:20]!a}; only {', '.join(COMPRESSIONS.values())} are read: convert it.",
    )
    require(_number(record, "BPX", name) == 8, f"{name} is not 8-bit grey; convert it.")
    data = record[999].value if record[999] is not None else b""
    require(isinstance(data, bytes) and len(data) > 0, f"{name} holds no image (field 14.999).")
    ppi = _resolution(record, name)
    try:
        return TransactionPrint(
            _pixels(data, names[compression], (rows, columns), name),
            name_of(_number(record, "FGP", name), FINGER_CODES, "finger position"),
            name_of(_number(record, "IMP", name), ITL_IMPRESSIONS, "impression type"),
            ppi,
            names[compression],
        )
    except BadInput as error:
        raise BadInput(str(error) if name in str(error) else f"{name}: {error}") from error


def _resolution(record: Any, name: str) -> float:
    unit, x, y = (_number(record, key, name) for key in ("SLC", "THPS", "TVPS"))
    require(unit in (1, 2), f"{name} gives no resolution (scale units {unit}; 1 or 2 is expected).")
    require(x == y, f"{name} has {x} pixels along and {y} across; square pixels are expected.")
    return float(x) if unit == 1 else x * _INCH_MM / _CM_MM


def _pixels(data: bytes, compression: str, size: tuple[int, int], name: str) -> NDArray[np.uint8]:
    """Decode the image, of the (rows, columns) that the record says."""
    expected = f"but its record says {size[0]} x {size[1]}"
    if compression == "none":
        require(len(data) == size[0] * size[1], f"{name} holds {len(data)} pixels, {expected}.")
        return np.frombuffer(data, dtype=np.uint8).reshape(size).copy()
    if compression == "wsq":
        image = decode_wsq(data, name).image
    else:
        header = png_header(data, name)
        require(
            (header.rows, header.columns) == size, f"{name} holds {header.rows} x {header.columns} pixels, {expected}."
        )
        pixels = decode_png(data, name)
        require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not 8-bit grey; convert it.")
        image = np.asarray(pixels[..., 0], dtype=np.uint8)
    require(image.shape == size, f"{name} holds {image.shape[0]} x {image.shape[1]} pixels, {expected}.")
    return image


def _text(record: Any, key: str, name: str) -> str:
    field = record[key]
    value = None if field is None else field.value
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, str) or not value:
        raise BadInput(f"{name} lacks the field {key}; it is not as ANSI/NIST-ITL asks.")
    return value


def _number(record: Any, key: str, name: str) -> int:
    text = _text(record, key, name)
    require(
        text.isascii() and text.isdecimal() and len(text) <= 5,
        f"{name} says {text[:20]!a} for {key}, where a whole number of at most 5 digits is expected.",
    )
    return int(text)


def _short(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return ascii(text[:120])[1:-1]
