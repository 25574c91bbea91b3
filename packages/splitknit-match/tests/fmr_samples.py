"""Records of minutiae: byte by byte from the tables of the standards, and random ones."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from splitknit_match.records.fmr_bytes import ANSI_2004, ANSI_2009, ISO_2005
from splitknit_match.records.minutiae_record import (
    ANSI_2004_IMPRESSIONS,
    ANSI_2009_IMPRESSIONS,
    FINGER_CODES,
    ISO_2005_IMPRESSIONS,
    FingerView,
)

THREE = """
 40 0a 00 14 40 32
 81 2c 01 90 c0 5a
 00 00 00 00 ff 00
"""
"""Ending at (10, 20), 64 steps, quality 50; bifurcation at (300, 400), 192 steps, 90; other at a
corner, 255."""

ISO_BYTES = bytes.fromhex(
    """
    46 4d 52 00  20 32 30 00  00 00 00 3d
    80 05  01 5e  01 f4  00 c5  00 c5  02 00
    02 08 50 03"""
    + THREE
    + """ 00 04  02 21 00 00
    07 10 00 00  00 03  01 02 03"""
)
"""Two views: a swiped right index with three minutiae and four bytes of extended data; a left
index, empty."""

ANSI_BYTES = bytes.fromhex("""
    46 4d 52 00  20 32 30 00  00 32
    01 03  00 07  10 05  01 5e  01 f4  00 c5  00 c6  01 00
    01 39 64 03
    40 0a 00 14 2d 32
    81 2c 01 90 87 5a
    00 00 00 00 b3 00
    00 00""")
"""One view: a contactless right thumb, number 3, with minutiae at 90, 270 and 358 deg."""

ANSI_2009_BYTES = bytes.fromhex("""
    46 4d 52 00  30 33 30 00  00 00 00 34
    00 1b  00 00  80  ab cd  01 00
    0a 00 18 fe  01 03 00 01  00 40  00 50  01 8a  01 8a  02
    40 0a 00 14 2d fe
    80 3f 00 4f 00 ff
    00 00""")
"""One view: a contactless left little finger at 1000 ppi, quality not computed."""


def transaction(*records: bytes, content: bytes = b"") -> bytes:
    """A transaction of ANSI/NIST-ITL: a Type-1 record and these; binary ones need field 1.003."""
    fields = b"\x1d1.002:0502\x1d1.003:%s\x1d1.004:OTHER\x1d1.011:39.37\x1d1.012:39.37\x1c"
    return _with_length(b"1.001:", fields % content) + b"".join(records)


def type_14(image: NDArray[np.uint8], kind: int = 14, **changes: bytes) -> bytes:
    """A record of Type-14 (or -13), fields by hand: IMP to FGP, and the image."""
    rows, columns = image.shape
    fields = {
        "IMP": (3, b"24"),
        "SRC": (4, b"LAB"),
        "HLL": (6, b"%d" % columns),
        "VLL": (7, b"%d" % rows),
        "SLC": (8, b"1"),
        "THPS": (9, b"500"),
        "TVPS": (10, b"500"),
        "CGA": (11, b"NONE"),
        "BPX": (12, b"8"),
        "FGP": (13, b"2"),
        "COM": (20, b"a comment"),
        "DATA": (999, image.tobytes()),
    }
    fields = {name: (number, changes.get(name, value)) for name, (number, value) in fields.items()}
    stated = [(number, value) for number, value in fields.values() if value]
    parts = [b"\x1d%d.%03d:%s" % (kind, number, value) for number, value in stated]
    return _with_length(b"%d.001:" % kind, b"".join(parts) + b"\x1c")


def _with_length(tag: bytes, rest: bytes) -> bytes:
    """The length counts its own digits."""
    plain = len(tag) + len(rest)
    length = next(n for n in range(plain, plain + 20) if n == plain + len(b"%d" % n))
    return tag + b"%d" % length + rest


def three_minutiae(**changes: Any) -> FingerView:
    """The first view of :data:`ISO_BYTES`."""
    view = FingerView(
        np.array([10, 300, 0]),
        np.array([20, 400, 0]),
        np.deg2rad([90.0, 270.0, 255 * 360 / 256]),
        np.array([1, 2, 0]),
        np.array([50, 90, 0]),
        (500, 350),
        finger_quality=80,
        finger="right_index",
        impression="swipe",
    )
    return dataclasses.replace(view, **changes)


@st.composite
def views(draw: st.DrawFn, standard: str) -> FingerView:
    """A view with any contents that a standard can hold."""
    table = {ISO_2005: ISO_2005_IMPRESSIONS, ANSI_2004: ANSI_2004_IMPRESSIONS}.get(
        standard, ANSI_2009_IMPRESSIONS
    )
    rows, columns = draw(st.integers(1, 16383)), draw(st.integers(1, 16383))
    count = draw(st.integers(0, 12))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    return FingerView(
        random.integers(0, columns, count),
        random.integers(0, rows, count),
        random.uniform(-10, 10, count),
        random.integers(0, 3, count),
        random.integers(0, 101, count),
        (rows, columns),
        finger_quality=draw(st.sampled_from([0, 55, 100])),
        finger=draw(st.sampled_from(list(FINGER_CODES))),
        impression=draw(st.sampled_from(list(table))),
        resolution_ppcm=(draw(st.integers(99, 65535)), draw(st.integers(99, 65535))),
    )


STANDARDS = (ISO_2005, ANSI_2004, ANSI_2009)
