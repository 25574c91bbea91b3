"""Minutiae of one print, and the bytes in which they are kept.

The bytes, little-endian: ``SKMI``, version (uint16), what they were found in (a byte), rows and
columns of the print at 500 ppi and the number of minutiae (uint16 each), CRC-32 of all that follows
(uint32); for each minutia column and row (uint16 each), direction in 256 steps, type, quality (a
byte each). A print without any minutiae is zero bytes.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit_match.records.minutiae_record import (
    BIFURCATION,
    ENDING,
    KINDS,
    MIN_MINUTIAE,
    PPI,
    Minutiae,
    no_minutiae,
)

__all__ = [
    "BIFURCATION",
    "ENDING",
    "KINDS",
    "LARGEST_MM2",
    "MINUTIAE_VERSION",
    "MIN_MINUTIAE",
    "PPI",
    "Minutiae",
    "holds_minutiae",
    "no_minutiae",
    "pack_minutiae",
    "unpack_minutiae",
]

LARGEST_MM2 = 3600.0
"""Of one finger: a print with what is white about it, a template's box, a surface. A rolled print
has 1,600 (40 x 40 mm); four fingers side by side have 6,200 and are no print of one. Work and
memory (0.4 GB) grow with it."""
MINUTIAE_VERSION = 2
"""Version of the packed bytes; a reader refuses others. Source: definition of the packed bytes."""
_MAGIC, _HEAD = b"SKMI", struct.Struct("<4sHBHHHI")
_ROW = np.dtype(
    [("x", "<u2"), ("y", "<u2"), ("direction", "u1"), ("type", "u1"), ("quality", "u1")]
)
_STEP_RAD = 2 * np.pi / 256
"""Step of a minutia's direction. Source: definition of the packed bytes."""


def pack_minutiae(minutiae: Minutiae) -> bytes:
    """Bytes of minutiae, 17 and 7 for each; none where there are none.

    Directions are kept in steps of 1.4 deg; those of mindtct (11.25 deg) exactly.
    """
    if not minutiae.count:
        return b""
    steps = np.round(minutiae.direction_rad / _STEP_RAD).astype(np.int64) % 256
    columns: list[Any] = [minutiae.x_px, minutiae.y_px, steps, minutiae.type, minutiae.quality]
    body = np.rec.fromarrays(columns, _ROW).tobytes()
    counts = *minutiae.size, minutiae.count, zlib.crc32(body)
    return _HEAD.pack(_MAGIC, MINUTIAE_VERSION, KINDS.index(minutiae.kind), *counts) + body


def holds_minutiae(data: bytes) -> bool:
    """Whether a template's payload is of minutiae, not of ridges."""
    return data[:4] == _MAGIC


def unpack_minutiae(data: bytes) -> Minutiae:
    """Read what :func:`pack_minutiae` wrote.

    Raises BadInput if the bytes are damaged, of another version, or no minutiae.

    >>> unpack_minutiae(b"").acquired
    False
    """
    if not data:
        return no_minutiae()
    remedy = "extract them from the print again."
    sound = len(data) > _HEAD.size and holds_minutiae(data)
    require(
        sound, f"these {len(data)} bytes are no packed minutiae (they begin with 'SKMI'); {remedy}"
    )
    _, version, kind, rows, columns, count, checksum = _HEAD.unpack_from(data)
    require(
        version == MINUTIAE_VERSION,
        f"the minutiae are of version {version}, but this program reads version {MINUTIAE_VERSION};"
        f" {remedy}",
    )
    body = data[_HEAD.size :]
    whole = 0 < len(body) == count * _ROW.itemsize and zlib.crc32(body) == checksum
    require(
        whole and kind < len(KINDS),
        f"the packed minutiae are damaged (their length or checksum does not fit); {remedy}",
    )
    table = np.frombuffer(body, dtype=_ROW)
    x, y = (table[name].astype(np.int32) for name in "xy")
    turn = table["direction"] * _STEP_RAD
    size = rows, columns
    return Minutiae(x, y, turn, table["type"], table["quality"], size, kind=KINDS[kind])
