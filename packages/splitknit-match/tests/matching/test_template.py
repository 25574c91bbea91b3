"""Templates of the ridge matcher: levels, packing, damage, chance of a match."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.errors import BadInput
from splitknit_match.matching.ridge_band import RidgeBand, ridge_band
from splitknit_match.matching.template import (
    _CHANCE,
    Template,
    failed_template,
    leveled,
    make_template,
    mirrored,
    pack,
    print_size,
    scaled,
    unpack,
    with_minutiae,
)
from splitknit_match.records.minutiae_record import Minutiae, no_minutiae


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(1, 40),
    columns=st.integers(1, 40),
    fraction=st.sampled_from([0.01, 0.5, 1]),
)
def test_packed_templates_come_back(seed, rows, columns, fraction):
    rng = np.random.default_rng(seed)
    valid = rng.random((rows, columns)) < fraction
    valid[rng.integers(rows), rng.integers(columns)] = True
    level = np.where(valid, rng.integers(0, 4, (rows, columns)), 0).astype(np.uint8)
    again = unpack(pack(Template(level, valid, 0.1)))
    assert np.array_equal(again.level, level)
    assert np.array_equal(again.valid, valid)
    assert again.pitch_mm == 0.1


@settings(max_examples=150, deadline=None, derandomize=True)
@given(data=st.binary(max_size=60))
def test_any_bytes_are_a_template_or_refused(data):
    try:
        template = unpack(data)
    except BadInput as error:
        wanted = "by the method minutiae" if data.startswith(b"SKMI") else "enroll the finger again"
        assert wanted in str(error)
    else:
        assert pack(template) == data or template.empty


def test_a_head_that_promises_much_costs_nothing():
    with bad_input():
        unpack(struct.pack("<HHIH", 2048, 2048, 2048 * 2048, 100))


def test_failures_to_acquire_are_empty():
    assert pack(failed_template()) == b""
    assert unpack(b"").empty
    rng = np.random.default_rng(0)
    tiny = ridge_band(rng.random((40, 40)).astype(np.float32), np.ones((40, 40), np.bool_), 0.1)
    assert make_template(tiny).empty  # 16 mm² at most
    flat = ridge_band(np.zeros((100, 100), np.float32), np.ones((100, 100), np.bool_), 0.1)
    assert make_template(flat).empty


def test_templates_are_small_and_keep_the_ridges(impressions, templates):
    template = templates[0]
    band = impressions[0].band()
    # two bits a pixel, and the outline
    assert len(pack(template)) < 2.5 * template.area_mm2 / 0.01 / 8 + 2000
    rows, columns = np.flatnonzero(band.valid.any(axis=1)), np.flatnonzero(band.valid.any(axis=0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    kept, original = template.value()[template.valid], band.value[box][template.valid]
    assert np.corrcoef(kept, original)[0, 1] > 0.92
    assert np.std(kept) == pytest.approx(1.0, abs=0.25)


def test_ten_times_the_relief_is_the_same_template(impressions):
    impression = impressions[3]
    a = impression.template()
    b = replace(impression, ridge_mm=10 * impression.ridge_mm + 0.01).template()
    assert a.valid.shape == b.valid.shape
    assert np.mean(a.valid == b.valid) > 0.999
    assert np.mean(a.level == b.level) > 0.999


def full(rows, columns, pitch_mm=0.1):
    level = np.random.default_rng(1).integers(0, 4, (rows, columns)).astype(np.uint8)
    return Template(level, np.ones((rows, columns), bool), pitch_mm)


def minutiae_at(places, size):
    x, y = np.array(places, np.int32).T
    count = len(places)
    return Minutiae(
        x,
        y,
        np.arange(count) % 32 * (np.pi / 16),
        np.ones(count, np.uint8),
        (np.arange(count) % 50 + 50).astype(np.uint8),
        size,
    )


def test_levels_and_their_values():
    value = np.array([[-2, -0.99, -0.97, -0.01, 0, 0.97, 0.98, 3]], np.float32)
    valid = np.ones(value.shape, bool)
    valid[0, -1] = False
    template = leveled(value, valid, 0.2)
    assert template.level.tolist() == [[0, 0, 1, 1, 2, 2, 3, 0]]
    assert template.level.dtype == np.uint8
    assert_allclose(
        template.value(), [[-1.51, -1.51, -0.45, -0.45, 0.45, 0.45, 1.51, 0]], rtol=1e-6
    )
    assert template.value().dtype == np.float32
    assert template.area_mm2 == pytest.approx(7 * 0.04)


def band_of(rows, columns, pitch_mm=0.1):
    value = np.random.default_rng(1).normal(size=(rows, columns)).astype(np.float32)
    return RidgeBand(value, np.ones((rows, columns), bool), pitch_mm)


def test_templates_are_cut_to_what_is_valid():
    band = band_of(100, 90)
    band.valid[:, :20] = band.valid[70:] = False
    template = make_template(band)
    assert template.valid.shape == (70, 70)
    assert_array_equal(template.level, leveled(band.value, band.valid, 0.1).level[:70, 20:])
    assert make_template(band, 49.0).area_mm2 == pytest.approx(49)
    assert make_template(band, 49.01).empty
    assert make_template(band_of(54, 55), 30.0).empty
    assert not make_template(band_of(60, 50)).empty
    failed = make_template(replace(band_of(9, 9), pitch_mm=0.3))
    assert failed.empty
    assert failed.pitch_mm == 0.3
    with bad_input(r"has \(2049, 9\) pixels, .* \(0\.2 mm\)"):
        make_template(band_of(2049, 9, 0.2))
    assert not make_template(band_of(2048, 9, 0.2)).empty


def test_runs_of_any_length_come_back():
    """Up to 65534 pixels in two bytes, longer ones in six."""
    for gap in (65533, 65534, 65535, 65536):
        valid = np.zeros((300, 300), bool)
        flat = valid.ravel()
        flat[:7] = True
        flat[7 + gap :][:9] = True
        template = Template(np.where(valid, 2, 0).astype(np.uint8), valid, 0.1)
        payload = pack(template)
        kind, *head = struct.unpack_from("<BHHIH", payload)
        assert (kind, *head) == (0, 300, 300, 5, 100)
        last = 300 * 300 - 16 - gap
        lengths = [
            struct.pack("<H", n) if n < 65535 else struct.pack("<HI", 65535, n)
            for n in (0, 7, gap, 9, last)
        ]
        runs = b"".join(lengths)
        assert payload[11 : 11 + len(runs)] == runs
        assert payload[11 + len(runs) :] == bytes([0b10101010] * 4)
        again = unpack(payload)
        assert_array_equal(again.valid, valid)
        assert_array_equal(again.level, template.level)


def test_first_pixels_stand_in_the_lowest_bits():
    template = Template(np.array([[1, 2, 3, 0, 2]], np.uint8), np.ones((1, 5), bool), 0.1)
    assert pack(template)[-2:] == bytes([0b00111001, 0b10])


@pytest.mark.parametrize(
    "head",
    [(0, 5, 2, 100), (5, 0, 2, 100), (1, 5, 2, 0), (1, 5, 0, 100), (1, 5, 7, 100), (1, 6, 2, 100)],
)
def test_heads_that_contradict_the_runs_are_refused(head):
    payload = pack(Template(np.zeros((1, 5), np.uint8), np.ones((1, 5), bool), 0.1))
    wrong = "the template's content contradicts itself; enroll the finger again."
    nothing = struct.pack("<HHIHH", 5, 0, 1, 100, 0)
    with bad_input(wrong):
        unpack(nothing)
    for data in (struct.pack("<HHIH", *head) + payload[10:], payload[:9], payload[:13]):
        with bad_input() as caught:
            unpack(data)
        assert str(caught.value) == wrong


@pytest.mark.parametrize(
    ("rows", "columns", "pitch_um", "fits"),
    [
        (2048, 8, 100, True),
        (2049, 8, 100, False),
        (8, 2049, 100, False),
        (1, 1, 60000, True),
        (1, 1, 60001, False),
    ],
)
def test_templates_larger_than_a_finger_are_refused(rows, columns, pitch_um, fits):
    template = Template(
        np.zeros((rows, columns), np.uint8), np.ones((rows, columns), bool), pitch_um / 1000
    )
    if fits:
        assert unpack(pack(template)).pitch_mm == pitch_um / 1000
        return
    area_mm2 = rows * columns * pitch_um**2 / 1e6
    with bad_input(rf"shows {area_mm2:.0f} mm² in {rows} x {columns} pixels"):
        unpack(pack(template))


def test_an_enlarged_template_shows_the_same():
    template = full(60, 50)
    template.valid[:, :10] = False
    template = leveled(template.value(), template.valid, 0.1)
    size = print_size(template)
    assert size == (round(5.9 * 500 / 25.4) + 1, round(4.9 * 500 / 25.4) + 1)
    template = replace(template, minutiae=minutiae_at([(0, 0), (96, 116), (50, 30)], size))
    larger = scaled(template, 1.5)
    assert larger.valid.shape == (90, 75)
    assert larger.pitch_mm == 0.1
    assert not larger.valid[:, :15].any()
    assert larger.valid[:, 16:].all()
    minutiae = larger.minutiae
    assert minutiae.size == print_size(larger)
    for k, (x, y) in enumerate([(0, 0), (96, 116), (50, 30)]):
        for place, old, new, at in (
            (x, size[1], minutiae.size[1], minutiae.x_px[k]),
            (y, size[0], minutiae.size[0], minutiae.y_px[k]),
        ):
            assert at == min(round((place + 0.5) * new / old - 0.5), new - 1)
    assert minutiae.x_px.dtype == np.int32
    assert_array_equal(minutiae.direction_rad, template.minutiae.direction_rad)
    assert scaled(full(60, 50), 1.5).minutiae is None
    none = scaled(replace(template, minutiae=no_minutiae()), 1.5)
    assert none.minutiae.size == minutiae.size
    assert none.minutiae.count == 0
    failed = failed_template()
    assert scaled(failed, 2.0) is failed
    assert scaled(full(3, 40), 0.1).valid.shape == (1, 4)


def test_a_mirrored_template_is_the_picture_in_a_mirror():
    template = full(30, 40)
    template.valid[:, :10] = False
    size = print_size(template)
    template = replace(template, minutiae=minutiae_at([(3, 4), (20, 7), (21, 9)], size))
    mirror = mirrored(template)
    assert_array_equal(mirror.level, template.level[:, ::-1])
    assert_array_equal(mirror.valid, template.valid[:, ::-1])
    assert mirror.minutiae.x_px.tolist() == [size[1] - 1 - x for x in (3, 20, 21)]
    assert mirror.minutiae.y_px.tolist() == [4, 7, 9]
    for new, old in zip(
        mirror.minutiae.direction_rad, template.minutiae.direction_rad, strict=True
    ):
        assert np.exp(1j * new) == pytest.approx(-np.exp(-1j * old))
        assert 0 <= new < 2 * np.pi
    again = mirrored(mirror).minutiae
    assert_array_equal(again.x_px, template.minutiae.x_px)
    assert mirrored(full(3, 4)).minutiae is None
    assert mirrored(replace(full(3, 4), minutiae=no_minutiae())).minutiae.count == 0


def test_minutiae_lie_on_the_ridges_they_were_found_on():
    """The band is the print seen in a mirror, and cut."""
    size = 200, 180  # of the print, 500 ppi
    step = 0.1 * 500 / 25.4
    valid = np.zeros((round(200 / step), round(180 / step)), bool)
    valid[20:80, 30:85] = True
    template = full(60, 55)
    places = [(10, 30), (60, 100), (90, 150), (100, 45), (119, 60), (121, 60), (60, 38), (60, 159)]
    kept = with_minutiae(template, valid, minutiae_at(places, size)).minutiae
    rows, columns = print_size(template)
    assert kept.size == (rows, columns)
    expected = []
    for x, y in places:
        column = (size[1] - 1 - x) / step - 30  # in the template
        row = y / step - 20
        place = (columns - 1) - column * step, row * step
        if -0.5 <= place[0] < columns - 0.5 and -0.5 <= place[1] < rows - 0.5:
            expected.append(place)
    assert 3 < len(expected) < len(places)
    assert kept.count == len(expected)
    assert_allclose(np.stack([kept.x_px, kept.y_px], axis=1), expected, atol=1.01)
    failed = with_minutiae(failed_template(), valid, minutiae_at(places, size))
    assert failed.minutiae.count == len(places)
    assert failed.empty


def test_the_chance_of_a_match_is_as_measured():
    file = Path(__file__).resolve().parents[4] / "validation" / "match" / "matchability.json"
    measured = json.loads(file.read_text(encoding="utf-8"))
    *weights, offset = measured["weights"]
    assert (offset, *weights) == _CHANCE
    for kind in ("whole", "windows", "touches"):
        for part in measured[kind]["bins"]:
            assert abs(part["predicted"] - part["observed"][0]) < 10, (kind, part)


def print_of(side_mm, minutiae, quality=60):
    """A square print."""
    side = round(side_mm / 0.1)
    place = np.zeros(minutiae, np.int32)
    kinds = np.ones(minutiae, np.uint8), np.full(minutiae, quality, np.uint8)
    found = Minutiae(place, place, np.zeros(minutiae), *kinds, (100, 100))
    return Template(np.ones((side, side), np.uint8), np.ones((side, side), bool), 0.1, found)


def test_the_chance_of_a_match_grows_with_skin_and_minutiae():
    small, large, clear = print_of(5, 6), print_of(15, 6), print_of(15, 40)
    assert small.chance < 0.3
    assert 0.8 < large.chance < clear.chance < 1
    assert print_of(15, 40, quality=10).chance < clear.chance
    assert replace(clear, kind="surface").chance is None
    assert replace(clear, minutiae=None).chance is None
    assert failed_template().chance is None
