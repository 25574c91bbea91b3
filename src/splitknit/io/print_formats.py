"""The formats of prints and minutiae, in one table: name, suffix, how each is known, read and written."""

from __future__ import annotations

import dataclasses
import datetime
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from splitknit.errors import BadInput, open_file, require
from splitknit.io import finger_image, photos, prints, tiff, wsq_image
from splitknit.io.fmr_bytes import MAX_RECORD_BYTES, what_bytes_are
from splitknit.io.iso19794 import encode_iso19794
from splitknit.io.itl_reading import TransactionFacts, decode_transaction, encode_transaction
from splitknit.io.minutiae_files import decode_minutiae_record, encode_ansi378, encode_ansi378_2009
from splitknit.io.minutiae_record import FingerView, MinutiaeRecord
from splitknit.io.png import SIGNATURE as PNG
from splitknit.io.prints import PrintFile

WSQ_PPI = 500.0
"""WSQ is defined for no other; files without a comment have it, too."""
_FIRST_BYTES = 16


@dataclass(frozen=True, slots=True)
class Writing:
    """What formats need beside the print itself."""

    compression: str = "none"
    """``none``, ``png`` or ``wsq``, of finger image records and transactions."""
    date: datetime.date | None = None
    """Of the capture; transactions need it."""
    control_number: str = "1"
    """Of a transaction."""
    text: Mapping[str, str] = field(default_factory=dict)
    """Provenance, kept by PNG and TIFF."""


@dataclass(frozen=True, slots=True)
class PrintFormat:
    """One format."""

    name: str
    """By which ``--to`` names it."""
    suffix: str
    holds: Literal["image", "minutiae"]
    words: str
    starts: tuple[bytes, ...]
    """First bytes."""
    decode: Callable[[bytes, str], tuple[PrintFile | FingerView, ...]]
    encode: Callable[[PrintFile, Writing], bytes] | Callable[[FingerView, Writing], bytes] | None = None
    """Bytes of one print, or of the minutiae of one; None where it is only read."""
    max_bytes: int = 600_000_000
    """A longer file is refused before it is read."""


def read_prints(path: str | os.PathLike[str]) -> tuple[PrintFile | FingerView, ...]:
    """Read what a file of any of the formats holds: prints, or minutiae. Its bytes show the format, not its name.
    Raises BadInput if the file is missing, of no such format, truncated, damaged or too large.

    >>> read_prints("finger.fir")[0].image.shape  # doctest: +SKIP
    (500, 400)
    """
    name = os.fspath(path)
    with open_file(path, max(one.max_bytes for one in FORMATS.values())) as (stream, size):
        first = stream.read(_FIRST_BYTES)
        found = next((one for one in FORMATS.values() if first.startswith(one.starts)), None)
        if found is None:
            raise BadInput(
                f"{name} is {what_bytes_are(first, 'of another kind')}; prints and minutiae are read from {READ}."
            )
        require(
            size <= found.max_bytes,
            f"{name} is too large: {size} bytes, at most {found.max_bytes} are read of its kind.",
        )
        data = first + stream.read(found.max_bytes + 1 - len(first))
    require(len(data) <= found.max_bytes, f"{name} is too large; at most {found.max_bytes} bytes are read.")
    return found.decode(data, name)


def _wsq(data: bytes, name: str) -> tuple[PrintFile, ...]:
    found = wsq_image.decode_wsq(data, name)
    return (dataclasses.replace(found, resolution_ppi=found.resolution_ppi or WSQ_PPI),)


def _ppi(item: PrintFile) -> float:
    require(item.resolution_ppi is not None, "a print to be written must have a resolution.")
    return float(item.resolution_ppi or 0.0)


def _to_transaction(item: PrintFile, how: Writing) -> bytes:
    if how.date is None:
        raise BadInput("an ANSI/NIST-ITL transaction states the date of the capture; give it: `date` 2026-01-31.")
    return encode_transaction([item], TransactionFacts(how.date, how.control_number), how.compression)


def _record(view: FingerView, max_quality: int = 100) -> MinutiaeRecord:
    """One view, without what only the standard it came from understands."""
    kept = view.quality if max_quality > 100 else np.where(view.quality <= 100, view.quality, 0).astype(np.uint8)
    quality = view.finger_quality if view.finger_quality <= max_quality else 0
    return MinutiaeRecord((dataclasses.replace(view.best(), quality=kept, finger_quality=quality, extended=b""),))


def _minutiae(name: str, suffix: str, words: str, encode: Callable[[FingerView, Writing], bytes]) -> PrintFormat:
    """A format of minutiae; which standard's a record is, shows when it is read."""
    starts, max_bytes = (b"FMR\0",), MAX_RECORD_BYTES
    return PrintFormat(
        name, suffix, "minutiae", words, starts, lambda data, file: decode_minutiae_record(data, file).views, encode,
        max_bytes,
    )  # fmt: skip


def _picture(
    name: str, suffix: str, starts: tuple[bytes, ...], encode: Callable[[PrintFile, Writing], bytes] | None = None
) -> PrintFormat:
    """A format of pictures."""
    return PrintFormat(
        name, suffix, "image", name.upper(), starts, lambda data, file: (prints.decode_print_image(data, file),), encode
    )


_MAX_ITL = 200_000_000

FORMATS: dict[str, PrintFormat] = {
    one.name: one
    for one in (
        _picture("png", ".png", (PNG[:4],), lambda one, how: prints.encode_print_png(one.image, _ppi(one), how.text)),
        _picture(
            "tiff", ".tiff", tiff.SIGNATURES, lambda one, how: prints.encode_print_tiff(one.image, _ppi(one), how.text)
        ),
        _picture("jpeg", ".jpg", (photos.JPEG_SIGNATURE,)),
        _picture("bmp", ".bmp", (photos.BMP_SIGNATURE,)),
        PrintFormat(
            "wsq", ".wsq", "image", "WSQ", (wsq_image.SIGNATURE,), _wsq,
            lambda one, how: wsq_image.encode_wsq(one.image, _ppi(one)), 100_000_000,
        ),
        PrintFormat(
            "iso-19794-4", ".fir", "image", "ISO/IEC 19794-4", (finger_image.MAGIC,), finger_image.decode_finger_images,
            lambda one, how: finger_image.encode_finger_images([one], how.compression), 200_000_000,
        ),
        PrintFormat(
            "ansi-nist-itl", ".an2", "image", "ANSI/NIST-ITL", (b"1.001:", b"1.01:", b"1.1:"),
            decode_transaction, _to_transaction, _MAX_ITL,
        ),
        _minutiae("iso-19794-2", ".iso", "ISO/IEC 19794-2", lambda view, how: encode_iso19794(_record(view))),
        _minutiae("ansi-378", ".fmr", "ANSI/INCITS 378", lambda view, how: encode_ansi378(_record(view))),
        _minutiae(
            "ansi-378-2009", ".fmr", "ANSI/INCITS 378", lambda view, how: encode_ansi378_2009(_record(view, 255))
        ),
    )
}  # fmt: skip
"""All formats, in the order in which help lists them."""
READ = ", ".join(dict.fromkeys(one.words for one in FORMATS.values()))
"""For people: what is read."""
WRITTEN = tuple(name for name, one in FORMATS.items() if one.encode is not None)
"""Names that ``--to`` takes."""
