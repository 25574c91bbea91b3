"""The structure of a WSQ file, checked before its decoder sees it.

WSQ has no checksums: a changed byte inside the image data cannot be told from a picture. What can be found is a file
that ends early, has a damaged header, or claims more pixels than any print has.

References
----------
FBI IAFIS-IC-0110 (V3.1), WSQ Gray-Scale Fingerprint Image Compression Specification, 2010: markers and segments.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from splitknit.errors import BadInput, require

SIGNATURE = b"\xff\xa0"
_END, _FRAME, _BLOCK = 0xA1, 0xA2, 0xA3
_TABLES = frozenset({0xA4, 0xA5, 0xA6, 0xA7, 0xA8})
"""Filters, quantisers, Huffman codes, restart interval, comment."""
_COMMENT = 0xA8
_MARKER_IN_BLOCK = re.compile(rb"\xff[^\x00\xa9-\xff]", re.DOTALL)
_MOST_PIXELS = 25_000_000


@dataclass(frozen=True, slots=True)
class WsqHeader:
    """The facts of the frame header and of the comment."""

    rows: int
    columns: int
    ppi: int | None
    """Of the comment (NIST_COM), if it says."""


def wsq_header(data: bytes, name: str) -> WsqHeader:
    """Walk all segments of a WSQ file to its end marker.

    Raises
    ------
    BadInput
        If it is no WSQ file, ends early, is damaged, or claims more than 25 million pixels.
    """
    require(data[:2] == SIGNATURE, f"{name} is not a WSQ file (it begins with FF A0); name another file.")
    truncated = f"{name} is truncated: the WSQ file ends within the image; copy it again."
    damaged = f"{name} is damaged: a marker of the WSQ file is missing; copy it again."
    size: tuple[int, int] | None = None
    place, blocks, ppi = 2, 0, None
    while True:
        require(place + 2 <= len(data), truncated)
        require(data[place] == 0xFF, damaged)
        marker = data[place + 1]
        if marker == _END:
            break
        require(marker in _TABLES or marker in (_FRAME, _BLOCK), damaged)
        require(place + 4 <= len(data), truncated)
        length = int.from_bytes(data[place + 2 : place + 4], "big")
        body = data[place + 4 : place + 2 + length]
        require(length >= 2 and len(body) == length - 2, truncated)
        place += 2 + length
        if marker == _FRAME:
            require(size is None, f"{name} is damaged: it has two WSQ frames; copy it again.")
            size = _frame(body, name)
        elif marker == _COMMENT:
            ppi = _ppi(body) or ppi
        elif marker == _BLOCK:
            require(size is not None, f"{name} is damaged: its image data come before their size; copy it again.")
            found = _MARKER_IN_BLOCK.search(data, place)
            if found is None:
                raise BadInput(truncated)
            place, blocks = found.start(), blocks + 1
    if size is None or blocks == 0:
        raise BadInput(f"{name} is damaged: the WSQ file holds no image; copy it again.")
    return WsqHeader(*size, ppi)


def _frame(body: bytes, name: str) -> tuple[int, int]:
    require(
        len(body) == 15, f"{name} is damaged: its WSQ frame header has {len(body) + 2} bytes, not 17; copy it again."
    )
    rows, columns = int.from_bytes(body[2:4], "big"), int.from_bytes(body[4:6], "big")
    require(rows > 0 and columns > 0, f"{name} is damaged: its WSQ frame header gives no size; copy it again.")
    require(
        rows * columns <= _MOST_PIXELS,
        f"{name} claims {rows} x {columns} pixels, more than {_MOST_PIXELS}; no print is that large.",
    )
    return rows, columns


def _ppi(comment: bytes) -> int | None:
    found = re.search(rb"^NIST_COM .*^PPI ([0-9]{1,5})$", comment, re.MULTILINE | re.DOTALL)
    return int(found.group(1)) if found else None
