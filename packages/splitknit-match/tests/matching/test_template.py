"""Templates of the ridge matcher: levels, packing, damage."""

from __future__ import annotations

import contextlib
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.errors import BadInput
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.template import Template, failed_template, make_template, pack, unpack


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(1, 40),
    columns=st.integers(1, 40),
    fraction=st.sampled_from([0.01, 0.5, 1]),
)
def test_packed_templates_come_back(seed: int, rows: int, columns: int, fraction: float) -> None:
    rng = np.random.default_rng(seed)
    valid = rng.random((rows, columns)) < fraction
    valid[rng.integers(rows), rng.integers(columns)] = True
    level = np.where(valid, rng.integers(0, 4, (rows, columns)), 0).astype(np.uint8)
    again = unpack(pack(Template(level, valid, 0.1)))
    assert np.array_equal(again.level, level)
    assert np.array_equal(again.valid, valid)
    assert again.pitch_mm == 0.1


def test_long_runs_come_back() -> None:
    valid = np.zeros((400, 400), dtype=np.bool_)
    valid[390:] = True
    valid[200, 7] = True
    template = Template(valid.astype(np.uint8) * 3, valid, 0.1)
    assert np.array_equal(unpack(pack(template)).valid, valid)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(data=st.binary(max_size=60))
def test_any_bytes_are_a_template_or_refused(data: bytes) -> None:
    try:
        template = unpack(data)
    except BadInput as error:
        wanted = "by the method minutiae" if data.startswith(b"SKMI") else "enroll the finger again"
        assert wanted in str(error)
    else:
        assert pack(template) == data or template.empty


@settings(max_examples=100, deadline=None, derandomize=True)
@given(place=st.integers(0, 1 << 20), change=st.integers(1, 255), cut=st.integers(0, 40))
def test_damage_never_breaks_the_reader(place: int, change: int, cut: int) -> None:
    valid = np.zeros((12, 15), dtype=np.bool_)
    valid[2:10, 3:12] = True
    data = bytearray(pack(Template(valid.astype(np.uint8), valid, 0.1)))
    data[place % len(data)] ^= change
    data = data[: len(data) - cut]
    with contextlib.suppress(BadInput):
        unpack(bytes(data))


def test_a_head_that_promises_much_costs_nothing() -> None:
    with pytest.raises(BadInput):
        unpack(struct.pack("<HHIH", 2048, 2048, 2048 * 2048, 100))


def test_failures_to_acquire_are_empty() -> None:
    assert pack(failed_template()) == b""
    assert unpack(b"").empty
    rng = np.random.default_rng(0)
    tiny = ridge_band(rng.random((40, 40)).astype(np.float32), np.ones((40, 40), np.bool_), 0.1)
    assert make_template(tiny).empty  # 16 mm² at most
    flat = ridge_band(np.zeros((100, 100), np.float32), np.ones((100, 100), np.bool_), 0.1)
    assert make_template(flat).empty


def test_templates_are_small_and_keep_the_ridges(impressions, templates) -> None:
    template = templates[0]
    band = impressions[0].band()
    # two bits a pixel, and the outline
    assert len(pack(template)) < 2.5 * template.area_mm2 / 0.01 / 8 + 2000
    rows, columns = np.flatnonzero(band.valid.any(axis=1)), np.flatnonzero(band.valid.any(axis=0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    kept, original = template.value()[template.valid], band.value[box][template.valid]
    assert np.corrcoef(kept, original)[0, 1] > 0.92
    assert np.std(kept) == pytest.approx(1.0, abs=0.25)


def test_ten_times_the_relief_is_the_same_template(impressions) -> None:
    impression = impressions[3]
    a = impression.template()
    b = replace(impression, ridge_mm=10 * impression.ridge_mm + 0.01).template()
    assert a.valid.shape == b.valid.shape
    assert np.mean(a.valid == b.valid) > 0.999
    assert np.mean(a.level == b.level) > 0.999
