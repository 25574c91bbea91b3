"""What the byte layouts of minutiae records share: a reader that cannot overrun, and tables of six-byte minutiae."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, require
from splitknit.io.minutiae_record import MOST_MINUTIAE, FingerView, MinutiaeRecord

_MAX_BYTES = 20_000_000
"""176 full views with full extended data take 12 MB."""
ISO_STEPS, ANSI_STEPS = 256, 180
"""Directions in a turn: steps of 1.40625 and of 2 deg."""
_MINUTIA = np.dtype([("x", ">u2"), ("y", ">u2"), ("direction", "u1"), ("quality", "u1")])


@dataclass(slots=True)
class Cursor:
    """A place in a record; what would lie behind the end is refused in words."""

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


def read_record_bytes(path: Any) -> bytes:
    """Read a whole file of at most 20 MB.

    Raises
    ------
    BadInput
        If it is missing, larger, or cannot be read.
    """
    return read_bytes(path, _MAX_BYTES)


def check_length(data: bytes, said: int, name: str) -> None:
    """Require that a record has the length that its header says."""
    if len(data) < said:
        raise BadInput(f"{name} is truncated: its header says {said} bytes, but it has {len(data)}; copy it again.")
    require(
        len(data) == said,
        f"{name} has {len(data)} bytes, but its header says {said}; cut off what does not belong to the record.",
    )


def check_rest(cursor: Cursor, views: int) -> None:
    """Require that the views fill the record."""
    rest = len(cursor.data) - cursor.place
    require(
        rest == 0,
        f"{cursor.name} holds {rest} bytes behind its {views} views; its counts or lengths do not fit.",
    )


def decode_minutiae(cursor: Cursor, count: int, steps: int, what: str) -> dict[str, NDArray[Any]]:
    """Return columns of `count` minutiae of six bytes; `steps` directions in a turn; `what` they are, for messages.

    Two bits of type and 14 of column, two reserved and 14 of row (all big-endian), a byte of direction, one of quality.
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


def encode_minutiae(view: FingerView, steps: int, most_quality: int) -> bytes:
    """Bytes of a view's minutiae, six for each; qualities above `most_quality` (none known) become 0.

    Directions are rounded to the nearest of `steps` in a turn.
    """
    require(
        view.count <= MOST_MINUTIAE,
        f"a view holds at most {MOST_MINUTIAE} minutiae, but there are {view.count}; take FingerView.best().",
    )
    table = np.zeros(view.count, dtype=_MINUTIA)
    table["x"] = np.asarray(view.x_px) | (np.asarray(view.type).astype(np.int64) << 14)
    table["y"] = view.y_px
    table["direction"] = np.round(np.asarray(view.direction_rad) * (steps / (2 * np.pi))).astype(np.int64) % steps
    table["quality"] = np.where(np.asarray(view.quality) <= most_quality, view.quality, 0)
    return table.tobytes()


def make_view(name: str, what: str, **fields: Any) -> FingerView:
    """Make a view of what was read; what does not fit is said with the file's `name` and `what` it is."""
    try:
        return FingerView(**fields)
    except BadInput as error:
        raise BadInput(f"{name}, {what}: {error}") from error


def make_record(name: str, **fields: Any) -> MinutiaeRecord:
    """Make a record of what was read; what does not fit is said with the file's `name`."""
    try:
        return MinutiaeRecord(**fields)
    except BadInput as error:
        raise BadInput(f"{name}: {error}") from error


def check_writable(record: MinutiaeRecord, standard: str, device_bits: int, certification_bits: int) -> None:
    """Require what every standard asks of a record before it is written."""
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


def checked_product(record: MinutiaeRecord) -> tuple[int, int]:
    """Owner and type of the product, as every ANSI record names them."""
    owner, kind = record.product
    require(
        0 < owner <= 65535 and 0 <= kind <= 65535,
        f"the product's owner must lie between 1 and 65535 (0x0103: not registered) and its type between 0 and 65535, "
        f"but they are {record.product}.",
    )
    return owner, kind


def common_image(record: MinutiaeRecord, standard: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Size and resolution that all views share, as standards with one of them in their header need."""
    first = record.views[0]
    alike = all(view.size == first.size and view.resolution_ppcm == first.resolution_ppcm for view in record.views)
    require(
        alike,
        f"{standard} has one image size and one resolution a record, but the views differ; write a record for each.",
    )
    return first.size, first.resolution_ppcm
