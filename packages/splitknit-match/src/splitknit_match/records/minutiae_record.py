"""Minutiae of one print, the bytes in which they are kept, and what a record of them holds in every
standard; codes of fingers and impressions.

The bytes, little-endian: ``SKMI``, version (uint16), what they were found in (a byte), rows and
columns of the print at 500 ppi and the number of minutiae (uint16 each), CRC-32 of all that follows
(uint32); for each minutia column and row (uint16 each), direction in 256 steps, type, quality (a
byte each). A print without any minutiae is zero bytes.
"""

from __future__ import annotations

import dataclasses
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Array, BoolArray, GreyArray

FINGER_CODES = {
    "unknown": 0,
    "right_thumb": 1,
    "right_index": 2,
    "right_middle": 3,
    "right_ring": 4,
    "right_little": 5,
    "left_thumb": 6,
    "left_index": 7,
    "left_middle": 8,
    "left_ring": 9,
    "left_little": 10,
}
"""Finger positions in all the standards here: ISO/IEC 19794-2 table 2, ANSI/INCITS 378,
ANSI/NIST-ITL table 8."""

LATENT_IMPRESSIONS = {
    "latent_impression": 4,
    "latent_tracing": 5,
    "latent_photo": 6,
    "latent_lift": 7,
}
FINGER_IMPRESSIONS = {
    "live_plain": 0,
    "live_rolled": 1,
    "nonlive_plain": 2,
    "nonlive_rolled": 3,
    "swipe": 8,
    "optical_contact_plain": 20,
    "optical_contact_rolled": 21,
    "nonoptical_contact_plain": 22,
    "nonoptical_contact_rolled": 23,
    "contactless": 24,
    "contactless_rolled": 25,
    "nonoptical_contactless_plain": 26,
    "nonoptical_contactless_rolled": 27,
    "other": 28,
    "unknown": 29,
    "contactless_rolled_moving": 41,
    "contactless_moving": 42,
}
ITL_IMPRESSIONS = {**FINGER_IMPRESSIONS, **LATENT_IMPRESSIONS}
"""ANSI/NIST-ITL 1-2011 (update 2015), table 7, of single fingers: 24 is a plain print, taken
contactless of a finger at rest; older editions call it live-scan, optical, contactless, plain."""

ANSI_2009_IMPRESSIONS = {name: code for name, code in FINGER_IMPRESSIONS.items() if code <= 29}
"""Impression types by name. Source: ANSI/INCITS 378-2009."""

ISO_2005_IMPRESSIONS = {
    "live_plain": 0,
    "live_rolled": 1,
    "nonlive_plain": 2,
    "nonlive_rolled": 3,
    "swipe": 8,
}
"""ISO/IEC 19794-2:2005, table 3. It has no code for contactless prints."""

ANSI_2004_IMPRESSIONS = {**ISO_2005_IMPRESSIONS, "contactless": 9}
"""ANSI/INCITS 378-2004."""

IMPRESSIONS = tuple(ITL_IMPRESSIONS)
"""All names."""


def name_of(code: int, codes: Mapping[str, int], what: str) -> str:
    """Name of a `code` of the table `codes`, BadInput if there is none; `what` it is, for messages.

    >>> name_of(7, FINGER_CODES, "finger position")
    'left_index'
    """
    names = [name for name, known in codes.items() if known == code]
    known = ", ".join(str(value) for value in sorted(codes.values()))
    require(
        names,
        f"the {what} {code} is not one of the standard's codes ({known}); correct the record.",
    )
    return names[0]


def standard_code(name: str, codes: Mapping[str, int], what: str) -> int:
    """Code of a `name` in the table `codes`, BadInput if there is none; `what` it is, for
    messages."""
    require(
        name in codes, f"the {what} '{name}' has no code here; choose one of {', '.join(codes)}."
    )
    return codes[name]


PPI = 500.0
"""Resolution of the grid on which minutiae of prints lie, whatever the print's resolution was.
Source: definition."""
ENDING = 1
"""Type of a minutia at which a ridge ends. Source: ISO/IEC 19794-2:2005."""
BIFURCATION = 2
"""Type of a minutia at which a ridge forks; all the standards share these codes, 0 is any other.
Source: ISO/IEC 19794-2:2005."""
MIN_MINUTIAE = 10
"""Fewest minutiae that are compared; what has fewer is a failure to acquire. Source: NBIS."""
VENDOR_UNKNOWN = 0x0103
"""IBIA's number for a producer that has not registered. Source: IBIA."""
RESOLUTION_500_PPI = (197, 197)
"""500 pixels per inch in pixels per centimetre, rounded as the standards' whole numbers require.
Source: derived."""


KINDS = ("print", "photo", "scaled photo", "surface", "contactless")
"""What a finger's template or minutiae were made of, by the numbers that templates keep: a print of
its contact; a photograph whose scale was assumed; one of known scale; a reconstruction; a print of
a reconstruction or a capture, which nothing touched. Source: definition of templates."""


@dataclass(frozen=True, slots=True, eq=False)
class Minutiae:
    """N minutiae of one print, on its pixel grid at 500 ppi.

    The frame is that of the print (mirrored against the camera's picture), column 0 at its left,
    row 0 at the tip.
    """

    x_px: NDArray[np.int32]
    """(N,) column, 0 is the leftmost pixel's centre."""
    y_px: NDArray[np.int32]
    """(N,) row, downwards."""
    direction_rad: Array
    """(N,) in [0, 2 pi), counter-clockwise from the right as seen in the print: from the minutia
    towards the side that has one more ridge, along the ridge that ends or between the branches (as
    ISO/IEC 19794-2 and ANSI/INCITS 378)."""
    type: GreyArray
    """(N,) 1 ridge ending, 2 bifurcation, 0 other."""
    quality: GreyArray
    """(N,) 0 to 100."""
    size: tuple[int, int]
    """(rows, columns) of the image."""
    kind: str = field(default="print", kw_only=True)
    """What they were found in, one of :data:`KINDS`."""
    largest_px: ClassVar[int] = 8192
    """Side of the image, at 500 ppi."""

    def __post_init__(self) -> None:
        columns = (self.x_px, self.y_px, self.direction_rad, self.type, self.quality)
        require(
            all(column.shape == (len(self.x_px),) for column in columns),
            "minutiae must be lists of one length, but they have the shapes"
            f" {[column.shape for column in columns]}.",
        )
        rows, width = self.size
        require(
            0 <= rows <= self.largest_px and 0 <= width <= self.largest_px,
            f"a print of {rows} x {width} pixels at 500 ppi is larger than {self.largest_px}; check"
            " its resolution.",
        )
        inside = (self.x_px >= 0) & (self.y_px >= 0) & (self.x_px < width) & (self.y_px < rows)
        require(inside.all(), f"minutiae must lie inside their print of {rows} x {width} pixels.")
        require(np.isfinite(self.direction_rad).all(), "directions of minutiae must be finite.")
        require((self.quality <= 100).all(), "qualities of minutiae must lie between 0 and 100.")
        require(
            (self.type <= BIFURCATION).all(),
            "types of minutiae are 0, 1 (ending) and 2 (bifurcation).",
        )

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.x_px)

    @property
    def acquired(self) -> bool:
        """Whether they are enough to be compared; false is a failure to acquire."""
        return self.count >= MIN_MINUTIAE

    @property
    def x_mm(self) -> Array:
        """(N,) to the right of the print's middle."""
        return np.asarray((self.x_px - (self.size[1] - 1) / 2) * 25.4 / PPI)

    @property
    def y_mm(self) -> Array:
        """(N,) up from the print's middle, towards the tip."""
        return np.asarray(((self.size[0] - 1) / 2 - self.y_px) * 25.4 / PPI)

    def taken(self, index: NDArray[np.integer] | BoolArray) -> Self:
        """Some of them, by their places or by a mask."""
        names = ("x_px", "y_px", "direction_rad", "type", "quality")
        return dataclasses.replace(self, **{name: getattr(self, name)[index] for name in names})

    def best(self, count: int) -> Self:
        """The `count` minutiae of the highest quality, in the order they have here."""
        return self.taken(
            np.sort(np.argsort(-self.quality.astype(np.int64), kind="stable")[:count])
        )


def no_minutiae(size: tuple[int, int] = (0, 0)) -> Minutiae:
    """Return what a print without minutiae gives: a failure to acquire."""
    whole, small = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.uint8)
    return Minutiae(whole, whole, np.zeros(0), small, small, size)


@dataclass(frozen=True, slots=True, eq=False)
class FingerView(Minutiae):
    """Minutiae of one image of one finger, as a record has them, on the image's pixel grid."""

    finger_quality: int
    """0 to 100, the higher the better (such as NFIQ 2)."""
    finger: str = "unknown"
    """``right_thumb`` to ``left_little``, or ``unknown``."""
    impression: str = "contactless"
    """One of :data:`splitknit_match.records.minutiae_record.IMPRESSIONS`."""
    resolution_ppcm: tuple[int, int] = RESOLUTION_500_PPI
    """Pixels per centimetre along columns and rows."""
    largest_px: ClassVar[int] = 65535


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
    require(
        len(data) > _HEAD.size and holds_minutiae(data),
        f"these {len(data)} bytes are no packed minutiae (they begin with 'SKMI'); {remedy}",
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
