"""Files of minutiae, whatever their standard: recognised by what they hold, not by their name."""

from __future__ import annotations

import os
from collections.abc import Callable

from splitknit.errors import BadInput
from splitknit.io.ansi378 import decode_ansi378
from splitknit.io.ansi378_2009 import decode_ansi378_2009
from splitknit.io.fmr_bytes import read_record_bytes
from splitknit.io.fmr_identify import (
    ANSI_2004,
    ANSI_2009,
    ANSI_2009_AM1,
    ISO_2005,
    MAGIC_20,
    require_standard,
    standard_of,
)
from splitknit.io.iso19794 import decode_iso19794
from splitknit.io.minutiae_record import MinutiaeRecord

_READERS: dict[str, Callable[[bytes, str], MinutiaeRecord]] = {
    ISO_2005: decode_iso19794,
    ANSI_2004: decode_ansi378,
    ANSI_2009: decode_ansi378_2009,
    ANSI_2009_AM1: decode_ansi378_2009,
}


def decode_minutiae_record(data: bytes, name: str = "the record") -> MinutiaeRecord:
    """Read the bytes of a record of ISO/IEC 19794-2:2005 or ANSI/INCITS 378-2004 or -2009.

    Raises
    ------
    BadInput
        If it is of no such standard (the message names what it is), truncated, or not as its standard asks.
    """
    standard = standard_of(data)
    if standard in _READERS:
        return _READERS[standard](data, name)
    if standard is not None:
        raise BadInput(f"{name} is a record of {standard}, which is not read; export it as {ISO_2005}.")
    require_standard(data, ISO_2005, MAGIC_20, name)
    raise AssertionError  # the line above refused it


def read_minutiae_record(path: str | os.PathLike[str]) -> MinutiaeRecord:
    """Read a file of minutiae; see :func:`decode_minutiae_record`."""
    return decode_minutiae_record(read_record_bytes(path), os.fspath(path))
