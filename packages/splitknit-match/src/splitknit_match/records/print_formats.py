"""The formats of prints and minutiae, in one table: name, suffix, how each is known, read and
written."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from splitknit import BadInput
from splitknit.errors import require
from splitknit.files import open_file
from splitknit.io.images import BMP, JPEG, PNG, TIFFS
from splitknit.io.prints import encode_print_png
from splitknit_match.records import finger_image, iso39794
from splitknit_match.records.fmr_bytes import ANSI_2004, ANSI_2009, ISO_2005, what_bytes_are
from splitknit_match.records.itl import decode_transaction
from splitknit_match.records.minutiae_files import (
    MAX_RECORD_BYTES,
    decode_minutiae_record,
    encode_minutiae_record,
)
from splitknit_match.records.minutiae_record import VENDOR_UNKNOWN, FingerView
from splitknit_match.records.pictures import PrintFile, decode_print_image, encode_print_tiff
from splitknit_match.records.wsq_image import SIGNATURE, decode_wsq, encode_wsq

WSQ_PPI = 500.0
"""Resolution of WSQ, which is defined for no other; files without a comment have it, too. Source:
specification of WSQ."""
_FIRST_BYTES = 16
"""First bytes by which a format is known. Source: definition: the formats' first bytes are shorter.
"""


@dataclass(frozen=True, slots=True)
class Writing:
    """What formats need beside the print itself."""

    compression: str = "none"
    """``none``, ``png``, ``wsq`` or ``jp2``, of finger image records."""
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
    encode: Callable[[Any, Writing], bytes] | None = None
    """Bytes of one print, or of the minutiae of one; None where it is only read."""
    max_bytes: int = 600_000_000
    """A longer file is refused before it is read."""


def read_prints(path: str | os.PathLike[str]) -> tuple[PrintFile | FingerView, ...]:
    """Read what a file of any of the formats holds: prints, or minutiae. Its bytes show the format,
    not its name. Raises BadInput if the file is missing, of no such format, truncated, damaged or
    too large.

    >>> read_prints("finger.fir")[0].image.shape  # doctest: +SKIP
    (500, 400)
    """
    name = os.fspath(path)
    with open_file(path, max(form.max_bytes for form in FORMATS.values())) as (stream, size):
        first = stream.read(_FIRST_BYTES)
        form = _format_of(first, size, name)
        return decode_prints(first + stream.read(form.max_bytes + 1 - len(first)), name)


def decode_prints(data: bytes, name: str) -> tuple[PrintFile | FingerView, ...]:
    """As :func:`read_prints`, of the bytes of a file."""
    return _format_of(data[:_FIRST_BYTES], len(data), name).decode(data, name)


def _format_of(first: bytes, size: int, name: str) -> PrintFormat:
    form = next((form for form in FORMATS.values() if first.startswith(form.starts)), None)
    if form is None:
        raise BadInput(
            f"{name} is {what_bytes_are(first, 'of another kind')}; prints and minutiae are read"
            f" from {READ}."
        )
    require(
        size <= form.max_bytes,
        f"{name} is too large: {size} bytes, at most {form.max_bytes} are read of its kind.",
    )
    return form


def _ppi(item: PrintFile) -> float:
    if item.resolution_ppi is None:
        raise BadInput("a print to be written must have a resolution.")
    return item.resolution_ppi


def _from_picture(data: bytes, name: str) -> tuple[PrintFile, ...]:
    return (decode_print_image(data, name),)


def _from_wsq(data: bytes, name: str) -> tuple[PrintFile, ...]:
    item = decode_wsq(data, name)
    return (dataclasses.replace(item, resolution_ppi=item.resolution_ppi or WSQ_PPI),)


def _minutiae(name: str, suffix: str, words: str, standard: str) -> PrintFormat:
    """A format of minutiae; which standard's a record is, shows when it is read."""
    return PrintFormat(
        name,
        suffix,
        "minutiae",
        words,
        (b"FMR\0",),
        decode_minutiae_record,
        lambda view, how: encode_minutiae_record(view, standard, how.owner),
        MAX_RECORD_BYTES,
    )


_MAX_IMAGE_RECORD_BYTES = 200_000_000
_ALL = (
    PrintFormat(
        "png",
        ".png",
        "image",
        "PNG",
        (PNG[:4],),
        _from_picture,
        lambda item, how: encode_print_png(item.image, _ppi(item), how.text),
    ),
    PrintFormat(
        "tiff",
        ".tiff",
        "image",
        "TIFF",
        TIFFS,
        _from_picture,
        lambda item, how: encode_print_tiff(item.image, _ppi(item), how.text),
    ),
    PrintFormat("jpeg", ".jpg", "image", "JPEG", (JPEG,), _from_picture),
    PrintFormat("bmp", ".bmp", "image", "BMP", (BMP,), _from_picture),
    PrintFormat(
        "wsq",
        ".wsq",
        "image",
        "WSQ",
        (SIGNATURE,),
        _from_wsq,
        lambda item, how: encode_wsq(item.image, _ppi(item)),
        100_000_000,  # bytes
    ),
    PrintFormat(
        "iso-19794-4",
        ".fir",
        "image",
        "ISO/IEC 19794-4",
        (finger_image.MAGIC,),
        finger_image.decode_finger_images,
        lambda item, how: finger_image.encode_finger_image(item, how.compression),
        _MAX_IMAGE_RECORD_BYTES,
    ),
    PrintFormat(
        "iso-39794-4",
        ".fim",
        "image",
        "ISO/IEC 39794-4",
        (iso39794.TAG,),
        iso39794.decode_finger_image_block,
        lambda item, how: iso39794.encode_finger_image_block(
            item, how.compression, quality=how.quality, owner=how.owner
        ),
        _MAX_IMAGE_RECORD_BYTES,
    ),
    PrintFormat(
        "ansi-nist-itl",
        ".an2",
        "image",
        "ANSI/NIST-ITL",
        (b"1.001:", b"1.01:", b"1.1:"),
        decode_transaction,
        None,
        _MAX_IMAGE_RECORD_BYTES,
    ),
    _minutiae("iso-19794-2", ".iso", "ISO/IEC 19794-2", ISO_2005),
    _minutiae("ansi-378", ".fmr", "ANSI/INCITS 378", ANSI_2004),
    _minutiae("ansi-378-2009", ".fmr", "ANSI/INCITS 378", ANSI_2009),
)
FORMATS = {form.name: form for form in _ALL}
"""All formats, in the order in which help lists them."""
READ = ", ".join(dict.fromkeys(form.words for form in _ALL))
"""For people: what is read."""
