"""A reader of records that cannot overrun, and which standard's a record of minutiae is."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from splitknit.errors import require


@dataclass(slots=True)
class Cursor:
    """A place in a record; what would lie behind the end is refused with a message."""

    data: bytes
    name: str
    """Name of the file."""
    place: int = 0

    def take(self, count: int, what: str) -> bytes:
        """Return the next `count` bytes, `what` they are."""
        end = self.place + count
        require(
            end <= len(self.data),
            f"{self.name} is truncated: it ends after {len(self.data)} bytes, within {what} (to"
            f" byte {end}); copy it again.",
        )
        taken = self.data[self.place : end]
        self.place = end
        return taken

    def unpack(self, layout: struct.Struct, what: str) -> tuple[Any, ...]:
        """Return the numbers of the next bytes, `what` they are."""
        return layout.unpack(self.take(layout.size, what))


def check_length(data: bytes, stated: int, name: str) -> None:
    """Require that a record has the length that its header states."""
    cure = "copy it again" if len(data) < stated else "cut off what does not belong to the record"
    fault = "is truncated: it " if len(data) < stated else ""
    require(
        len(data) == stated,
        f"{name} {fault}has {len(data)} bytes, but its header states {stated}; {cure}.",
    )


# Which standard's record a file is: minutiae records of several standards begin with the same eight
# bytes.

ISO_2005 = "ISO/IEC 19794-2:2005"
ANSI_2004 = "ANSI/INCITS 378-2004"
ANSI_2009 = "ANSI/INCITS 378-2009"

MAGIC_20 = b"FMR\0 20\0"
"""First bytes of ISO/IEC 19794-2:2005 and ANSI/INCITS 378-2004."""
MAGIC_030 = b"FMR\x00030\0"
"""First bytes of ANSI/INCITS 378-2009, and of ISO/IEC 19794-2:2011, which is not read."""
MAGIC_035 = b"FMR\x00035\0"
"""First bytes of amendment 1 to ANSI/INCITS 378-2009."""

_OTHERS = (
    (b"FIR\0", "a finger image record (ISO/IEC 19794-4)"),
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
    (b"SQLite format 3\0", "a database, such as a gallery"),
    (b"{", "a JSON file"),
)


def standard_of(data: bytes) -> str | None:
    """Return the standard of a minutiae record, by its header alone; None if it is another file.
    `data`: the file, or its first bytes. ISO/IEC 19794-2:2005 gives its length in four bytes,
    ANSI/INCITS 378-2004 in two (or, from 64 KiB, in six), in the same place. The length that fits
    the file decides; if none does, the one that is possible.

    >>> standard_of(b"FMR\\0 20\\0" + bytes([0, 0, 0, 32]) + bytes(20))
    'ISO/IEC 19794-2:2005'
    >>> standard_of(b"FMR\\0 20\\0" + bytes([0, 34]) + bytes(24))
    'ANSI/INCITS 378-2004'
    """
    if data[:8] != MAGIC_20:
        return ANSI_2009 if data[:8] in (MAGIC_030, MAGIC_035) else None
    short = int.from_bytes(data[8:10], "big")
    whole = int.from_bytes(data[8:12], "big")
    if whole == len(data):
        return ISO_2005
    if len(data) in (short, int.from_bytes(data[10:14], "big")) and (
        short > 0 or len(data) > 65535
    ):
        return ANSI_2004
    if short:  # 26 and more would be a record of 1.7 MB by ISO
        return ANSI_2004 if short >= 26 else ISO_2005
    return ANSI_2004 if whole < 24 else ISO_2005  # the first bytes of a length in six


def what_bytes_are(
    data: bytes, otherwise: str = "no minutiae record (it does not begin with 'FMR')"
) -> str:
    """Name what a file is by its bytes, for messages; `otherwise` where they are not known."""
    if not data:
        return "empty"
    known = next((words for start, words in _OTHERS if data.startswith(start)), None)
    if known is not None:
        return known
    if data[:4] == b"FMR\0":
        return f"a minutiae record of an unknown version {data[4:8]!r}"
    at = data.find(b"FMR\0", 1, 4096)
    inner = f"an envelope (CBEFF?) with a minutiae record inside, {at} bytes from its beginning"
    return inner if at > 0 else otherwise
