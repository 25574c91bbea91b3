"""Records of minutiae for tests: typed byte by byte from the tables of the standards, and made at random."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from hypothesis import strategies as st

from splitknit_match.records.fmr_bytes import ANSI_2004, ANSI_2009, ANSI_2009_AM1, ISO_2005, ISO_2011
from splitknit_match.records.minutiae_files import encode_minutiae_record
from splitknit_match.records.minutiae_record import (
    ANSI_2004_IMPRESSIONS,
    ANSI_2009_IMPRESSIONS,
    FINGER_CODES,
    ISO_2005_IMPRESSIONS,
    FingerView,
    MinutiaeRecord,
)

THREE = """
 40 0a 00 14 40 32
 81 2c 01 90 c0 5a
 00 00 00 00 ff 00
"""
"""Ending at (10, 20), 64 steps, quality 50; bifurcation at (300, 400), 192 steps, 90; other at a corner, 255."""

ISO_BYTES = bytes.fromhex(
    """
    46 4d 52 00  20 32 30 00  00 00 00 3d
    80 05  01 5e  01 f4  00 c5  00 c5  02 00
    02 08 50 03"""
    + THREE
    + """ 00 04  02 21 00 00
    07 10 00 00  00 03  01 02 03"""
)
"""Two views: a swiped right index with three minutiae and four bytes of extended data; a left index, empty."""

ANSI_BYTES = bytes.fromhex(
    """
    46 4d 52 00  20 32 30 00  00 32
    01 03  00 07  10 05  01 5e  01 f4  00 c5  00 c6  01 00
    01 39 64 03
    40 0a 00 14 2d 32
    81 2c 01 90 87 5a
    00 00 00 00 b3 00
    00 00"""
)
"""One view: a contactless right thumb, number 3, with minutiae at 90, 270 and 358 deg."""

ANSI_2009_BYTES = bytes.fromhex(
    """
    46 4d 52 00  30 33 30 00  00 00 00 34
    00 1b  00 00  80  ab cd  01 00
    0a 00 18 fe  01 03 00 01  00 40  00 50  01 8a  01 8a  02
    40 0a 00 14 2d fe
    80 3f 00 4f 00 ff
    00 00"""
)
"""One view: a contactless left little finger at 1000 ppi, quality not computed."""


def three_minutiae(**changes: Any) -> FingerView:
    """The view of :data:`ISO_BYTES`, in our terms."""
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
def views(draw: st.DrawFn, impressions: list[str], number: int, finger: str, special: bool) -> FingerView:
    """A view with anything that a standard can say; `special` qualities where it has them."""
    rows, columns = draw(st.integers(1, 16383)), draw(st.integers(1, 16383))
    count = draw(st.integers(0, 12))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    quality = random.integers(0, 101, count)
    if special and count:
        quality[0] = draw(st.sampled_from([0, 100, 254, 255]))
    return FingerView(
        random.integers(0, columns, count),
        random.integers(0, rows, count),
        random.uniform(-10, 10, count),
        random.integers(0, 3, count),
        quality,
        (rows, columns),
        finger_quality=draw(st.sampled_from([0, 55, 100, 254, 255] if special else [0, 55, 100])),
        finger=finger,
        impression=draw(st.sampled_from(impressions)),
        view=number,
        resolution_ppcm=(draw(st.integers(99, 65535)), draw(st.integers(99, 65535))),
        extended=draw(st.binary(max_size=20)),
    )


@st.composite
def records(draw: st.DrawFn, standard: str) -> MinutiaeRecord:
    """A record with one to four views."""
    table = {ISO_2005: ISO_2005_IMPRESSIONS, ANSI_2004: ANSI_2004_IMPRESSIONS}.get(standard, ANSI_2009_IMPRESSIONS)
    old = standard in (ISO_2005, ANSI_2004)
    keys = draw(
        st.lists(
            st.tuples(st.sampled_from(list(FINGER_CODES)), st.integers(0, 15)), min_size=1, max_size=4, unique=True
        )
    )
    made = [draw(views(list(table), number, finger, not old)) for finger, number in keys]
    if old:  # one size and one resolution a record
        first = made[0]
        made = [dataclasses.replace(first, finger=view.finger, view=view.view) for view in made]
    if standard == ISO_2011:  # states neither device nor product
        return MinutiaeRecord(tuple(made), standard=standard)
    return MinutiaeRecord(
        tuple(made),
        device=draw(st.integers(0, 4095 if old else 65535)),
        certification=draw(st.integers(0, 15 if old else 255)),
        product=(draw(st.integers(1, 65535)), draw(st.integers(0, 65535))),
        standard=standard,
    )


def encode(record: MinutiaeRecord) -> bytes:
    """Bytes of a record in its own standard."""
    return encode_minutiae_record(record, record.standard)


STANDARDS = (ISO_2005, ISO_2011, ANSI_2004, ANSI_2009, ANSI_2009_AM1)


FIR_2011 = bytes.fromhex(
    "4649520030323000000000b100010001000000a107ea011f010203000000000000000002000101f401f401f401f408000000"
    "0a000c0000007800020406080a0c0e10121416181a1c1e20222426282a2c2e30323436383a3c3e40424446484a4c4e505254"
    "56585a5c5e60626466686a6c6e70727476787a7c7e80828486888a8c8e90929496989a9c9ea0a2a4a6a8aaacaeb0b2b4b6b8"
    "babcbec0c2c4c6c8caccced0d2d4d6d8dadcdee0e2e4e6e8eaecee"
)
"""A finger image record of ISO/IEC 19794-4:2011 as the package iso19794 0.1.0 writes it.

12 x 10 pixels 0, 2, 4 ... 238; 500 ppi, right index, live-scan plain."""
