"""The formats of prints and minutiae, in one table: name, suffix, how each is known, read and written."""

from __future__ import annotations

import dataclasses
import datetime
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from splitknit import BadInput
from splitknit.errors import open_file, require
from splitknit.io.images import BMP, JPEG, PNG, TIFFS
from splitknit.io.prints import PrintFile, decode_print_image, encode_print_png, encode_print_tiff
from splitknit_match.records import finger_image, iso39794, wsq_image
from splitknit_match.records.fmr_bytes import ANSI_2004, ANSI_2009, ISO_2005, ISO_2011, MAX_RECORD_BYTES, what_bytes_are
from splitknit_match.records.itl_reading import TransactionFacts, decode_transaction, encode_transaction
from splitknit_match.records.minutiae_files import decode_minutiae_record, encode_minutiae_record
from splitknit_match.records.minutiae_record import FAILED, VENDOR_UNKNOWN, FingerView, MinutiaeRecord

WSQ_PPI = 500.0
"""WSQ is defined for no other; files without a comment have it, too."""
_FIRST_BYTES = 16


@dataclass(frozen=True, slots=True)
class Writing:
    """What formats need beside the print itself."""

    compression: str = "none"
    """``none``, ``png``, ``wsq`` or ``jp2``, of finger image records and transactions."""
    date: datetime.date | None = None
    """Date of the capture; transactions need it."""
    control_number: str = "1"
    """Control number of a transaction."""
    text: Mapping[str, str] = field(default_factory=dict)
    """Provenance, kept by PNG and TIFF."""
    quality: int | None = None
    """Of the print, 0 to 100."""
    owner: int = VENDOR_UNKNOWN
    """IBIA's number of who makes the record."""


@dataclass(frozen=True, slots=True)
class PrintFormat:
    """One format."""

    name: str
    """By which `to` names it."""
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
        found = _format_of(first, size, name)
        return decode_prints(first + stream.read(found.max_bytes + 1 - len(first)), name)


def decode_prints(data: bytes, name: str) -> tuple[PrintFile | FingerView, ...]:
    """As :func:`read_prints`, of the bytes of a file."""
    return _format_of(data[:_FIRST_BYTES], len(data), name).decode(data, name)


def _format_of(first: bytes, size: int, name: str) -> PrintFormat:
    found = next((one for one in FORMATS.values() if first.startswith(one.starts)), None)
    if found is None:
        raise BadInput(
            f"{name} is {what_bytes_are(first, 'of another kind')}; prints and minutiae are read from {READ}."
        )
    limit = f"{name} is too large: {size} bytes, at most {found.max_bytes} are read of its kind."
    require(size <= found.max_bytes, limit)
    return found


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


def _record(view: FingerView, standard: str, owner: int) -> bytes:
    """Bytes of one view, without what only the standard it came from understands."""
    max_quality = FAILED if standard in (ANSI_2009, ISO_2011) else 100
    kept = view.quality if max_quality > 100 else np.where(view.quality <= 100, view.quality, 0).astype(np.uint8)
    quality = view.finger_quality if view.finger_quality <= max_quality else 0
    view = dataclasses.replace(
        view.best(), quality=kept, finger_quality=quality, quality_algorithm=(owner, 1), extended=b""
    )
    return encode_minutiae_record(MinutiaeRecord((view,), product=(owner, 0)), standard)


def _minutiae(name: str, suffix: str, words: str, standard: str) -> PrintFormat:
    """A format of minutiae; which standard's a record is, shows when it is read."""
    starts, max_bytes = (b"FMR\0",), MAX_RECORD_BYTES
    return PrintFormat(
        name, suffix, "minutiae", words, starts, lambda data, file: decode_minutiae_record(data, file).views,
        lambda view, how: _record(view, standard, how.owner), max_bytes,
    )  # fmt: skip


def _picture(
    name: str, suffix: str, starts: tuple[bytes, ...], encode: Callable[[PrintFile, Writing], bytes] | None = None
) -> PrintFormat:
    return PrintFormat(
        name, suffix, "image", name.upper(), starts, lambda data, file: (decode_print_image(data, file),), encode
    )


_MAX_ITL = 200_000_000

FORMATS: dict[str, PrintFormat] = {
    one.name: one
    for one in (
        _picture("png", ".png", (PNG[:4],), lambda one, how: encode_print_png(one.image, _ppi(one), how.text)),
        _picture(
            "tiff", ".tiff", TIFFS, lambda one, how: encode_print_tiff(one.image, _ppi(one), how.text)
        ),
        _picture("jpeg", ".jpg", (JPEG,)),
        _picture("bmp", ".bmp", (BMP,)),
        PrintFormat(
            "wsq", ".wsq", "image", "WSQ", (wsq_image.SIGNATURE,), _wsq,
            lambda one, how: wsq_image.encode_wsq(one.image, _ppi(one)), 100_000_000,
        ),
        PrintFormat(
            "iso-19794-4", ".fir", "image", "ISO/IEC 19794-4", (finger_image.MAGIC,), finger_image.decode_finger_images,
            lambda one, how: finger_image.encode_finger_images([one], how.compression), 200_000_000,
        ),
        PrintFormat(
            "iso-19794-4-2011", ".fir", "image", "ISO/IEC 19794-4", (finger_image.MAGIC,),
            finger_image.decode_finger_images, lambda one, how: finger_image.encode_finger_images(
                [one], how.compression, edition=2011, qualities=[how.quality], owner=how.owner), 200_000_000,
        ),
        PrintFormat(
            "iso-39794-4", ".fim", "image", "ISO/IEC 39794-4", (iso39794.TAG,), iso39794.decode_finger_image_block,
            lambda one, how: iso39794.encode_finger_image_block(
                [one], how.compression, quality=how.quality, owner=how.owner), 200_000_000,
        ),
        PrintFormat(
            "ansi-nist-itl", ".an2", "image", "ANSI/NIST-ITL", (b"1.001:", b"1.01:", b"1.1:"),
            decode_transaction, _to_transaction, _MAX_ITL,
        ),
        _minutiae("iso-19794-2", ".iso", "ISO/IEC 19794-2", ISO_2005),
        _minutiae("iso-19794-2-2011", ".iso", "ISO/IEC 19794-2", ISO_2011),
        _minutiae("ansi-378", ".fmr", "ANSI/INCITS 378", ANSI_2004),
        _minutiae("ansi-378-2009", ".fmr", "ANSI/INCITS 378", ANSI_2009),
    )
}  # fmt: skip
"""All formats, in the order in which help lists them."""
READ = ", ".join(dict.fromkeys(one.words for one in FORMATS.values()))
"""For people: what is read."""
WRITTEN = tuple(name for name, one in FORMATS.items() if one.encode is not None)
"""Names that `to` takes."""
