"""Transactions of ANSI/NIST-ITL with prints: Type-1, a minimal Type-2, and a Type-14 for every print.

They are written and parsed by the package `nistitl` (extra ``records``), in the traditional encoding, as version 0502
(ANSI/NIST-ITL 1-2011, update 2015). Equal input gives equal bytes: date and control number are given, not made up.

References
----------
ANSI/NIST-ITL 1-2011, NIST Special Publication 500-290 edition 3, 2015: clauses 8.1, 8.2, 8.14, annex B.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.io.atomic import atomic_file
from splitknit.io.finger_codes import FINGER_CODES, ITL_IMPRESSIONS, code_of
from splitknit.io.prints import encode_print_png
from splitknit.io.wsq_image import encode_wsq

VERSION = "0502"
COMPRESSIONS = {"none": "NONE", "wsq": "WSQ20", "png": "PNG"}
"""Names, and what field 14.011 says for them."""
MOST_PRINTS = 98
"""Information designation characters go from 0 to 99; 0 is that of Type-2."""
LEAST_PPI, MOST_PPI = 490.0, 5080.0
"""A print below the class of 500 ppi is no exemplar."""


@dataclass(frozen=True, slots=True, eq=False)
class TransactionPrint:
    """One print and what a Type-14 record says of it."""

    image: NDArray[np.uint8]
    """(H, W), ridges dark, as ink on paper."""
    finger: str = "unknown"
    """``right_thumb`` to ``left_little``, or ``unknown`` (field 14.013)."""
    impression: str = "contactless"
    """One of :data:`splitknit.io.finger_codes.IMPRESSIONS` (field 14.003)."""
    ppi: float = 500.0
    """Pixels per inch (fields 14.008 to 14.010)."""
    compression: str = "none"
    """``none`` and ``png`` lose nothing; ``wsq`` does, and is for 500 ppi alone (field 14.011)."""

    def __post_init__(self) -> None:
        array = np.asarray(self.image)
        require(
            array.ndim == 2 and array.dtype == np.uint8 and min(array.shape) >= 10 and max(array.shape) <= 99_999,
            f"a print must be (H, W) uint8, 10 to 99999 pixels each way, not {array.shape} {array.dtype}.",
        )
        require(
            LEAST_PPI <= self.ppi <= MOST_PPI,
            f"a print of a transaction has {LEAST_PPI:g} to {MOST_PPI:g} ppi, not {self.ppi:g}; resample it.",
        )
        code_of(self.finger, FINGER_CODES, "finger")
        code_of(self.impression, ITL_IMPRESSIONS, "impression type")
        require(
            self.compression in COMPRESSIONS,
            f"'{self.compression}' is no compression; choose one of {', '.join(COMPRESSIONS)}.",
        )


@dataclass(frozen=True, slots=True)
class TransactionFacts:
    """What the whole transaction says."""

    date: datetime.date
    """Of the capture and of the transaction (fields 1.005, 14.005)."""
    control_number: str
    """Names this transaction among those of its originator (1.009)."""
    kind: str = "OTHER"
    """Type of transaction, agreed on with the receiver (1.004)."""
    destination: str = "UNKNOWN"
    """Agency that receives it (1.007)."""
    originator: str = "SPLITKNIT"
    """Agency that sends it (1.008), and that captured the prints (14.004)."""

    def __post_init__(self) -> None:
        for name in ("control_number", "kind", "destination", "originator"):
            text = getattr(self, name)
            require(
                isinstance(text, str)
                and 0 < len(text) <= 40
                and text.isascii()
                and text.isprintable()
                and ":" not in text,
                f"{name} of a transaction must be 1 to 40 printable ASCII characters without ':', but it is {text!a}.",
            )


@dataclass(frozen=True, slots=True, eq=False)
class Transaction:
    """What a transaction holds."""

    prints: tuple[TransactionPrint, ...]
    facts: TransactionFacts


def encode_transaction(prints: Sequence[TransactionPrint], facts: TransactionFacts) -> bytes:
    """Bytes of a transaction.

    Parameters
    ----------
    prints : 1 to 98; the k-th gets the information designation character k
    facts : what all of it says

    Raises
    ------
    BadInput
        If there are none or too many, one cannot be compressed so, or the package `nistitl` is not installed.
    """
    require(1 <= len(prints) <= MOST_PRINTS, f"a transaction takes 1 to {MOST_PRINTS} prints, not {len(prints)}.")
    nistitl = itl_package()
    date = facts.date.strftime("%Y%m%d")
    message = nistitl.Message()
    first = message[0]
    for name, value in (
        ("VER", VERSION),
        ("TOT", facts.kind),
        ("DAT", date),
        ("DAI", facts.destination),
        ("ORI", facts.originator),
        ("TCN", facts.control_number),
        ("NSR", "00.00"),
        ("NTR", "00.00"),
    ):
        setattr(first, name, value)
    second = nistitl.AsciiRecord(2)
    second.IDC = 0
    message += second
    for number, item in enumerate(prints, start=1):
        message += _record(nistitl, item, number, facts.originator, date)
    return bytes(message.NIST)


def write_transaction(
    path: str | os.PathLike[str], prints: Sequence[TransactionPrint], facts: TransactionFacts
) -> None:
    """Write a transaction to a file, whole or not at all; see :func:`encode_transaction`."""
    data = encode_transaction(prints, facts)
    with atomic_file(path) as stream:
        stream.write(data)


def itl_package() -> Any:
    """Import `nistitl`, or say how to get it."""
    try:
        import nistitl  # type: ignore[import-untyped,import-not-found,unused-ignore]  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise BadInput("ANSI/NIST-ITL files need the package nistitl: pip install 'splitknit[records]'.") from error
    return nistitl


def _record(nistitl: Any, item: TransactionPrint, number: int, agency: str, date: str) -> Any:
    """Type-14 record; its resolution is in pixels per inch (SLC 1)."""
    rows, columns = item.image.shape
    record = nistitl.AsciiRecord(14)
    record.IDC = number
    for name, value in (
        ("IMP", ITL_IMPRESSIONS[item.impression]),
        ("SRC", agency),
        ("FCD", date),
        ("HLL", columns),
        ("VLL", rows),
        ("SLC", 1),
        ("THPS", round(item.ppi)),
        ("TVPS", round(item.ppi)),
        ("CGA", COMPRESSIONS[item.compression]),
        ("BPX", 8),
        ("FGP", FINGER_CODES[item.finger]),
    ):
        setattr(record, name, str(value))
    record.DATA = _pixels(item)
    return record


def _pixels(item: TransactionPrint) -> bytes:
    if item.compression == "wsq":
        return encode_wsq(item.image, item.ppi)
    return encode_print_png(item.image, item.ppi) if item.compression == "png" else item.image.tobytes()
