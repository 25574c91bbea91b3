"""Ridges and minutiae of two prints: places, evidence, scales, and the order of sides."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit_match.matching import fusion, methods
from splitknit_match.matching.elastic import Agreement, patch_grid
from splitknit_match.matching.fusion import at_one_scale, fused_match, fused_score
from splitknit_match.matching.ridge import Prepared, ridge_match, scored
from splitknit_match.matching.template import Template, leveled, print_size, scaled
from splitknit_match.records.minutiae_record import Minutiae, no_minutiae

FINER = (1.35 / (0.1 * 2 * math.pi) / 2) ** 2
"""Ridges on an area of a drawn print over those of the usual two in a millimetre."""


def print_of(seed, rows=150, columns=130, minutiae=20):
    """Curved ridges with faults, and minutiae at random places."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns]
    bend = cv2.GaussianBlur(rng.normal(size=(rows, columns)).astype(np.float32), (0, 0), 12)
    phase = 1.35 * np.hypot(x - columns / 2, y - rows / 3) + 8 * bend / bend.std()
    template = leveled(
        (1.4 * np.sin(phase)).astype(np.float32), np.ones((rows, columns), bool), 0.1
    )
    return replace(template, minutiae=minutiae_of(template, seed, minutiae))


def minutiae_of(template, seed, count):
    rng = np.random.default_rng(seed)
    rows, columns = print_size(template)
    y, x = rng.integers(0, rows, count), rng.integers(0, columns, count)
    order = np.lexsort((y, x))
    kind = np.ones(count, np.uint8)
    direction = rng.integers(0, 32, count) * (np.pi / 16)
    return Minutiae(
        x[order].astype(np.int32), y[order].astype(np.int32), direction, kind, 50 * kind,
        (rows, columns),
    )  # fmt: skip


@pytest.fixture(scope="module")
def side():
    return print_of(1)


def test_the_key_is_of_the_ridges_alone(side):
    more_minutiae = replace(side, minutiae=minutiae_of(side, 2, 9))
    assert Prepared(side).key == Prepared(more_minutiae).key
    assert Prepared(side).key != Prepared(replace(side, pitch_mm=0.11)).key
    assert fusion._order(Prepared(side)) != fusion._order(Prepared(more_minutiae))
    assert fusion._order(Prepared(replace(side, minutiae=None)))[1] == b""


@pytest.mark.parametrize(
    ("overlap_mm2", "smaller_mm2", "factor"),
    [(30, 195, 30 / 60), (90, 195, 1), (30, 80, 30 / 40), (50, 80, 1)],
)
def test_little_overlap_lowers_the_similarity(side, overlap_mm2, smaller_mm2, factor):
    count = 10
    weight = np.full(count, overlap_mm2 / 1.6**2 / count, np.float32)
    agreement = Agreement(
        np.arange(count), np.full(count, 0.8, np.float32), np.zeros((count, 2)), weight
    )
    smaller = Template(
        np.zeros((10, 10 * smaller_mm2), np.uint8), np.ones((10, 10 * smaller_mm2), bool), 0.1
    )
    for pair in ((side, smaller), (smaller, side)):
        ready = Prepared(pair[0]), Prepared(pair[1])
        result = scored(*ready, patch_grid(ready[1].band), agreement)
        assert result.overlap_mm2 == pytest.approx(overlap_mm2, rel=1e-5)
        assert result.correlation == pytest.approx(0.8)
        assert result.similarity == pytest.approx(0.8 * math.sqrt(factor), rel=1e-5)
        assert result.compared


def turned(template, angle_rad, right_mm, up_mm):
    """The print, turned and moved, its minutiae with it."""
    rows, columns = template.valid.shape
    matrix = cv2.getRotationMatrix2D(
        ((columns - 1) / 2, (rows - 1) / 2), float(np.rad2deg(angle_rad)), 1.0
    )
    matrix[:, 2] += 10 * np.array([right_mm, -up_mm])
    value = cv2.warpAffine(template.value(), matrix, (columns, rows), flags=cv2.INTER_CUBIC)
    valid = cv2.warpAffine(template.valid.astype(np.float32), matrix, (columns, rows)) > 0.99
    minutiae = template.minutiae
    height, width = minutiae.size
    step = 25.4 / 500
    place = -(minutiae.x_px - (width - 1) / 2) - 1j * (minutiae.y_px - (height - 1) / 2)
    place = place * np.exp(1j * angle_rad) + complex(right_mm, up_mm) / step
    x = np.rint((width - 1) / 2 - place.real).astype(np.int32)
    y = np.rint((height - 1) / 2 - place.imag).astype(np.int32)
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    direction = (minutiae.direction_rad - angle_rad) % (2 * np.pi)
    order = np.lexsort((y[inside], x[inside]))
    moved = Minutiae(
        x[inside][order], y[inside][order], direction[inside][order],
        minutiae.type[inside][order], minutiae.quality[inside][order], minutiae.size,
    )  # fmt: skip
    return replace(leveled(value, valid, template.pitch_mm), minutiae=moved)


@pytest.mark.parametrize(("rows", "columns"), [(150, 130), (90, 80)])
def test_a_moved_print_is_found_by_both(rows, columns):
    """Large prints, and small ones (less than 100 mm2)."""
    a = print_of(3, rows, columns)
    b = turned(a, 0.25, 1.0, -0.5)
    match, back = fused_match(a, b), fused_match(b, a)
    assert match.ridge.rotation_deg == pytest.approx(np.rad2deg(0.25), abs=1.0)
    assert match.ridge.right_mm == pytest.approx(1.0, abs=0.15)
    assert match.ridge.up_mm == pytest.approx(-0.5, abs=0.15)
    assert back.similarity == match.similarity
    assert back.ridge.rotation_deg == pytest.approx(-match.ridge.rotation_deg, abs=1e-6)
    fraction, correlation, support, overlap_mm2 = match.evidence
    count = b.minutiae.count
    possible = math.sqrt(count * count)
    assert fraction == pytest.approx(count / math.sqrt(possible + 9), rel=0.12)
    assert correlation > 0.85
    assert support == match.minutiae > 5
    assert match.similarity == fused_score(*match.evidence)
    small = rows * columns < 10_000
    sides = Prepared(a), Prepared(b)
    assert math.isnan(overlap_mm2) != small
    if small:
        assert overlap_mm2 == pytest.approx(b.area_mm2 * FINER, rel=0.2)
        assert overlap_mm2 == pytest.approx(fusion._at_usual_period(b.area_mm2, *sides), rel=0.05)
        assert match.ridge.overlap_mm2 == pytest.approx(b.area_mm2, rel=0.05)
        assert match.ridge.correlation == correlation == match.ridge.similarity
    assert match.compared


def test_prints_without_minutiae_are_rated_by_their_overlap():
    a = print_of(3)
    b = turned(a, 0.25, 1.0, -0.5)
    a, b = replace(a, minutiae=no_minutiae()), replace(b, minutiae=no_minutiae())
    match = fused_match(a, b)
    fraction, correlation, support, overlap_mm2 = match.evidence
    assert math.isnan(fraction)
    assert math.isnan(support)
    assert match.minutiae is None
    assert correlation > 0.85
    assert overlap_mm2 == pytest.approx(b.area_mm2 * FINER, rel=0.2)
    sides = Prepared(a), Prepared(b)
    assert overlap_mm2 == pytest.approx(fusion._at_usual_period(b.area_mm2, *sides), rel=0.05)
    assert match.similarity == fused_score(*match.evidence)
    assert match.ridge.similarity == pytest.approx(ridge_match(a, b).similarity, abs=1e-6)


@pytest.mark.parametrize("scale", [1.12, 0.9])
def test_finer_ridges_are_enlarged(side, scale):
    larger = scaled(side, scale)
    assert fusion._log_frequency(side) == pytest.approx(
        math.log(1.35 / 0.1 / (2 * np.pi)), abs=0.05
    )
    sides = at_one_scale(side, larger)
    assert sides is not None
    assert sides[2] == pytest.approx(max(scale, 1 / scale), abs=0.06)
    if scale > 1:
        assert sides[1] is larger
        assert sides[0].valid.shape == scaled(side, sides[2]).valid.shape
    else:
        assert sides[0] is side
        assert sides[1].valid.shape == scaled(larger, sides[2]).valid.shape
    assert at_one_scale(side, side) is None
    assert fusion._log_frequency(replace(side, valid=np.zeros_like(side.valid))) == 0


def test_prints_of_two_scales_are_doubted(monkeypatch):
    a = print_of(3)
    b = scaled(turned(a, 0.1, 0.2, 0), 1.1)
    doubt = methods.scale_doubt(a, b, None)
    apart = 100 * (at_one_scale(a, b)[2] - 1)
    assert doubt.code == "unequal-scales"
    assert f"the ridges of one lie {apart:.0f} % farther apart" in str(doubt)
    assert methods.scale_doubt(a, scaled(print_of(4), 1.1), None) is None
    assert methods.scale_doubt(a, turned(a, 0.1, 0.2, 0), None) is None
    assert methods._prints_match(a, turned(a, 0.1, 0.2, 0), None, None)
    assert not methods._prints_match(a, print_of(4), None, None)
    decided = []
    monkeypatch.setattr(
        methods, "rate", lambda *values: decided.append(values) or methods._unknown("x")
    )
    assert methods.scale_doubt(a, b, 0.02, "own") is None
    assert decided[0][1] == "fusion"
    assert decided[0][3:] == (0.02, "own")


def bent(template):
    """The print on skin that is pulled to one side, more so towards its end."""
    rows, columns = template.valid.shape
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    value = cv2.remap(template.value(), x + 6 * (y / rows) ** 2, 1.02 * y, cv2.INTER_CUBIC)
    return replace(leveled(value, template.valid, 0.1), minutiae=template.minutiae)


@pytest.fixture(scope="module")
def pairs():
    whole, part = print_of(3), print_of(3, 90, 80)
    return {
        "moved": (whole, turned(whole, 0.25, 1.0, -0.5)),
        "bent": (whole, bent(whole)),
        "half": (whole, turned(whole, -2.0, 5.0, 3.0)),
        "small": (part, turned(part, 0.7, 1.0, -0.5)),
    }


@pytest.mark.parametrize(
    ("name", "fused", "ridges", "alignment"),
    [
        ("moved", (22.27, 18.98), (0.979, 133.1), (14.5, 1.0, -0.5)),
        ("bent", (18.67, 19.49), (0.967, 143.4), (-1.0, -0.18, 0.15)),
        ("half", (16.67, 7.14), (0.9745, 70.1), (-114.7, 5.0, 3.0)),
        ("small", (23.60, 18.02), (0.971, 43.4), (40.0, 1.0, -0.5)),
    ],
)
def test_scores_of_drawn_prints_stay(pairs, name, fused, ridges, alignment):
    """A constant or a step of the matchers that changes moves one of these."""
    match, ridge = fused_match(*pairs[name]), ridge_match(*pairs[name])
    assert (match.similarity, match.minutiae) == pytest.approx(fused, rel=0.02, abs=0.2)
    assert (ridge.similarity, ridge.overlap_mm2) == pytest.approx(ridges, rel=0.02, abs=0.01)
    assert (ridge.rotation_deg, ridge.right_mm, ridge.up_mm) == pytest.approx(alignment, abs=0.1)


def test_a_quick_comparison_lets_skin_slip_where_prints_may_be_of_one_finger(pairs, monkeypatch):
    monkeypatch.setattr(fusion, "SURE", 1000.0)
    closely = fused_match(*pairs["bent"])
    assert fused_match(*pairs["bent"], quick=True) == closely
    monkeypatch.setattr(fusion, "_bends", None)
    with pytest.raises(TypeError):
        fused_match(*pairs["bent"], quick=True)
    monkeypatch.setattr(fusion, "_MIN_EVIDENCE", 1000.0)
    excluded = fused_match(*pairs["bent"], quick=True)
    assert excluded.compared
    assert excluded.ridge.overlap_mm2 == pytest.approx(closely.ridge.overlap_mm2, rel=0.25)


def test_scores_of_different_prints_stay():
    for size, score, ridges in (((150, 130), -5.78, 0.173), ((90, 80), -3.43, 0.209)):
        a, b = print_of(3, *size), print_of(4, *size)
        assert fused_match(a, b).similarity == pytest.approx(score, abs=0.4)
        assert ridge_match(a, b).similarity == pytest.approx(ridges, abs=0.03)
