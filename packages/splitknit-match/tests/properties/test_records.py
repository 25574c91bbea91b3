"""Records of minutiae are read as they were written, each flipped bit included; tests/fuzz changes more of them."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from fmr_samples import ANSI_2009_BYTES, ANSI_BYTES, ISO_BYTES, STANDARDS, encode, records
from splitknit.errors import BadInput
from splitknit_match.records.minutiae_files import decode_minutiae_record
from splitknit_match.records.minutiae_record import MinutiaeRecord

FUZZ = settings(max_examples=200, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
SAMPLES = (ISO_BYTES, ANSI_BYTES, ANSI_2009_BYTES)
READERS: tuple[Callable[[bytes], MinutiaeRecord], ...] = (
    *(partial(decode_minutiae_record, standard=one) for one in STANDARDS),
    decode_minutiae_record,
)


def attempt(data: bytes) -> int:
    """Number of readers that took the bytes; each of them can write them again, and the others say why not."""
    taken = 0
    for reader in READERS:
        try:
            record = reader(data)
        except BadInput as error:
            assert "\n" not in str(error)
            assert str(error).endswith(".")
        else:
            assert encode(record) == data
            taken += 1
    return taken


@pytest.mark.parametrize("sample", SAMPLES)
def test_every_single_bit(sample: bytes) -> None:
    assert attempt(sample) == 2
    for place in range(len(sample)):
        for bit in range(8):
            data = bytearray(sample)
            data[place] ^= 1 << bit
            attempt(bytes(data))


@pytest.mark.parametrize("standard", STANDARDS)
def test_what_is_written_is_read(standard: str) -> None:
    @settings(FUZZ, max_examples=30)
    @given(records(standard))
    def check(record: MinutiaeRecord) -> None:
        data = encode(record)
        read = decode_minutiae_record(data)
        assert read.standard == standard
        assert attempt(data) == 2
        assert (read.device, read.certification) == (record.device, record.certification)
        for ours, theirs in zip(record.views, read.views, strict=True):
            for name in ("x_px", "y_px", "type", "quality"):
                np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
            turn = np.angle(np.exp(1j * (ours.direction_rad - theirs.direction_rad)))
            assert np.abs(turn).max(initial=0) <= np.deg2rad(1.0001)
            for name in ("finger", "impression", "view", "finger_quality", "size", "resolution_ppcm", "extended"):
                assert getattr(ours, name) == getattr(theirs, name), name

    check()


def test_counts_that_lie_cost_nothing() -> None:
    """A header may claim 255 views of 255 minutiae, or 65535 representations: nothing is made before it is there."""
    claims = [
        b"FMR\0 20\0" + bytes(4) + b"\0\0\1\0\1\0\0\xc5\0\xc5\xff\0" + b"\1\0\0\xff" * 3,
        b"FMR\0 20\0\xff\xff\xff\xff" + bytes(100),
        b"FMR\x00030\0\xff\xff\xff\xff\xff\xff\1" + b"\0\0\0\x22" * 5000,
        b"FMR\x00030\0\0\0\0\x15" + bytes(6) + b"\xff" * 5,
        b"FMR" + b"\0" * 2_000_000,
    ]
    tracemalloc.start()
    began = time.process_time()
    for data in claims:
        assert attempt(data) == 0
    assert time.process_time() - began < 2
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()
