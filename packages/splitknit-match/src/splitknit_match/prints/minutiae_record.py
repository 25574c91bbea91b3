"""Minutiae of one print, and the bytes in which they are kept.

The bytes, little-endian: ``SKMI``, version (uint16), rows and columns of the print at 500 ppi and the number of
minutiae (uint16 each), CRC-32 of all that follows (uint32); for each minutia column and row (uint16 each), direction in
256 steps, type, quality (a byte each). A print without any minutiae is zero bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

PPI = 500.0
"""Resolution of the grid on which minutiae lie, whatever the print's resolution was."""
MINUTIAE_VERSION = 1
"""Version of the packed bytes; a reader refuses others."""
ENDING, BIFURCATION = 1, 2
"""Types, with the codes of ISO/IEC 19794-2; 0 is any other."""
MIN_MINUTIAE = 10
"""bozorth3 compares no fewer (its MIN_COMPUTABLE_BOZORTH_MINUTIAE); what has fewer is a failure to acquire."""
MAX_MINUTIAE = 200
"""bozorth3 compares no more (its MAX_BOZORTH_MINUTIAE)."""
LARGEST_SIDE_PX = 8192
LARGEST_MM2 = 3600.0
"""Of one finger: a print with what is white about it, a template's box, a surface. A rolled print has 1,600 (40 x 40
mm); four fingers side by side have 6,200 and are no print of one. Work and memory (0.4 GB) grow with it."""
_MAGIC, _HEAD = b"SKMI", struct.Struct("<4sHHHHI")
_ROW = np.dtype([("x", "<u2"), ("y", "<u2"), ("direction", "u1"), ("type", "u1"), ("quality", "u1")])
_STEP_RAD = 2 * np.pi / 256


@dataclass(frozen=True, slots=True, eq=False)
class Minutiae:
    """N minutiae of one print, on its pixel grid at 500 ppi.

    The frame is that of the print (mirrored against the camera's picture), column 0 at its left, row 0 at the tip.
    """

    x_px: NDArray[np.int32]
    """(N,) column, 0 is the leftmost pixel's centre."""
    y_px: NDArray[np.int32]
    """(N,) row, downwards."""
    direction_rad: NDArray[np.float64]
    """(N,) in [0, 2 pi), counter-clockwise from the right as seen in the print: from the minutia towards the side that
    has one more ridge, along the ridge that ends or between the branches (as ISO/IEC 19794-2 and ANSI/INCITS 378)."""
    type: NDArray[np.uint8]
    """(N,) 1 ridge ending, 2 bifurcation, 0 other."""
    quality: NDArray[np.uint8]
    """(N,) 0 to 100."""
    size: tuple[int, int]
    """(rows, columns) of the print at 500 ppi."""

    def __post_init__(self) -> None:
        columns = (self.x_px, self.y_px, self.direction_rad, self.type, self.quality)
        require(
            all(column.shape == (len(self.x_px),) for column in columns),
            f"minutiae must be lists of one length, but they have the shapes {[column.shape for column in columns]}.",
        )
        rows, width = self.size
        require(
            0 <= rows <= LARGEST_SIDE_PX and 0 <= width <= LARGEST_SIDE_PX,
            f"a print of {rows} x {width} pixels at 500 ppi is larger than {LARGEST_SIDE_PX}; check its resolution.",
        )
        if self.count:
            inside = self.x_px.min() >= 0 and self.y_px.min() >= 0
            inside = inside and self.x_px.max() < width and self.y_px.max() < rows
            require(inside, f"minutiae must lie inside their print of {rows} x {width} pixels.")
            require(np.isfinite(self.direction_rad).all(), "directions of minutiae must be finite.")
            require(int(self.quality.max()) <= 100, "qualities of minutiae must lie between 0 and 100.")
            require(int(self.type.max()) <= BIFURCATION, "types of minutiae are 0, 1 (ending) and 2 (bifurcation).")

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.x_px)

    @property
    def acquired(self) -> bool:
        """Whether they are enough to be compared; false is a failure to acquire."""
        return self.count >= MIN_MINUTIAE

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """(N,) to the right of the print's middle."""
        return np.asarray((self.x_px - (self.size[1] - 1) / 2) * 25.4 / PPI)

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """(N,) up from the print's middle, towards the tip."""
        return np.asarray(((self.size[0] - 1) / 2 - self.y_px) * 25.4 / PPI)

    def taken(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Minutiae:
        """Some of them, by their places or by a mask."""
        return Minutiae(
            self.x_px[index], self.y_px[index], self.direction_rad[index], self.type[index], self.quality[index],
            self.size,
        )  # fmt: skip


def no_minutiae(size: tuple[int, int] = (0, 0)) -> Minutiae:
    """Return what a print without minutiae gives: a failure to acquire."""
    whole, small = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.uint8)
    return Minutiae(whole, whole, np.zeros(0), small, small, size)


def pack_minutiae(minutiae: Minutiae) -> bytes:
    """Bytes of minutiae, 16 and 7 for each; none where there are none.

    Directions are kept in steps of 1.4 deg; those of mindtct (11.25 deg) exactly.
    """
    if not minutiae.count:
        return b""
    steps = np.round(minutiae.direction_rad / _STEP_RAD).astype(np.int64) % 256
    columns: list[Any] = [minutiae.x_px, minutiae.y_px, steps, minutiae.type, minutiae.quality]
    body = np.rec.fromarrays(columns, _ROW).tobytes()
    return _HEAD.pack(_MAGIC, MINUTIAE_VERSION, *minutiae.size, minutiae.count, zlib.crc32(body)) + body


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
    require(sound, f"these {len(data)} bytes are no packed minutiae (they begin with 'SKMI'); {remedy}")
    _, version, rows, columns, count, checksum = _HEAD.unpack_from(data)
    require(
        version == MINUTIAE_VERSION,
        f"the minutiae are of version {version}, but this program reads version {MINUTIAE_VERSION}; {remedy}",
    )
    body = data[_HEAD.size :]
    require(
        0 < len(body) == count * _ROW.itemsize and zlib.crc32(body) == checksum,
        f"the packed minutiae are damaged (their length or checksum does not fit); {remedy}",
    )
    table = np.frombuffer(body, dtype=_ROW)
    x, y = (table[name].astype(np.int32) for name in "xy")
    direction, kind, quality = table["direction"] * _STEP_RAD, table["type"].copy(), table["quality"].copy()
    return Minutiae(x, y, direction, kind, quality, (rows, columns))
