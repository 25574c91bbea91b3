"""Ridges and minutiae of two prints: places, evidence, scales, and the order of sides."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit_match.matching import fusion, methods, ridge
from splitknit_match.matching.coarse import inverse
from splitknit_match.matching.elastic import Agreement, compare_patches, rigid
from splitknit_match.matching.fusion import at_one_scale, fused_match, fused_score
from splitknit_match.matching.ridge import Prepared, RidgeMatch, placed, ridge_match, scored
from splitknit_match.matching.template import Template, leveled, print_size, scaled
from splitknit_match.prints.minutiae_record import Minutiae, no_minutiae


def print_of(seed: int, rows: int = 150, columns: int = 130, minutiae: int = 20) -> Template:
    """Curved ridges with faults, and minutiae at random places."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns]
    bend = cv2.GaussianBlur(rng.normal(size=(rows, columns)).astype(np.float32), (0, 0), 12)
    phase = 1.35 * np.hypot(x - columns / 2, y - rows / 3) + 8 * bend / bend.std()
    template = leveled(
        (1.4 * np.sin(phase)).astype(np.float32), np.ones((rows, columns), bool), 0.1
    )
    return replace(template, minutiae=minutiae_of(template, seed, minutiae))


def minutiae_of(template: Template, seed: int, count: int) -> Minutiae:
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
def side() -> Template:
    return print_of(1)


def test_places_of_a_template_are_measured_from_its_middle(side: Template) -> None:
    places = np.array([0, 1 + 2j, -3.05])
    np.testing.assert_allclose(
        Prepared(side).pixels(places), [[64.5, 74.5], [74.5, 54.5], [34, 74.5]]
    )


def test_a_prepared_side_is_smooth_and_zero_outside() -> None:
    template = print_of(1)
    template.valid[:, :40] = False
    band = Prepared(template).band
    assert band.value.dtype == np.float32
    assert not band.value[:, :40].any()
    smooth = cv2.GaussianBlur(template.value(), (0, 0), 0.6)
    np.testing.assert_allclose(band.value[20:-20, 50:-20], smooth[20:-20, 50:-20], atol=0.02)
    assert band.pitch_mm == 0.1
    assert band.valid is template.valid
    prepared = Prepared(template)
    assert (prepared.first.step, prepared.first.reach) == (24, 8)
    assert (prepared.close.step, prepared.close.reach) == (12, 4)
    assert (prepared.patches.step, prepared.patches.reach) == (16, 4)
    assert ridge.prepared(prepared) is prepared
    assert ridge.prepared(template).template is template


def test_cylinders_take_three_minutiae(side: Template) -> None:
    for count, described in ((2, False), (3, True)):
        few = replace(side, minutiae=minutiae_of(side, 1, count))
        assert (Prepared(few).cylinders is not None) == described
    assert Prepared(replace(side, minutiae=None)).cylinders is None


def test_the_key_is_of_the_ridges_alone(side: Template) -> None:
    more_minutiae = replace(side, minutiae=minutiae_of(side, 2, 9))
    assert Prepared(side).key == Prepared(more_minutiae).key
    assert Prepared(side).key != Prepared(replace(side, pitch_mm=0.11)).key
    assert fusion._order(Prepared(side)) != fusion._order(Prepared(more_minutiae))
    assert fusion._order(Prepared(replace(side, minutiae=None)))[1] == b""


def test_an_alignment_is_where_a_lies_on_b(side: Template) -> None:
    a, b = Prepared(side), Prepared(print_of(2, 121, 141))
    affine = rigid(a.band, b.band, 0.4, 1.5, -0.7)
    result = placed(RidgeMatch(0.5, 0.6, 70.0, compared=True), affine, a, b)
    assert (result.similarity, result.correlation, result.overlap_mm2) == (0.5, 0.6, 70.0)
    assert result.rotation_deg == pytest.approx(np.rad2deg(0.4))
    assert result.right_mm == pytest.approx(1.5)
    assert result.up_mm == pytest.approx(0.7)
    assert result.compared
    back = placed(result, inverse(affine), b, a)
    assert back.rotation_deg == pytest.approx(-np.rad2deg(0.4))


@pytest.mark.parametrize(
    ("overlap_mm2", "smaller_mm2", "factor"),
    [(30, 195, 30 / 60), (90, 195, 1), (30, 80, 30 / 40), (50, 80, 1)],
)
def test_little_overlap_lowers_the_similarity(
    side: Template, overlap_mm2: float, smaller_mm2: float, factor: float
) -> None:
    count = 10
    weight = np.full(count, overlap_mm2 / 1.6**2 / count, np.float32)
    agreement = Agreement(
        np.arange(count), np.full(count, 0.8, np.float32), np.zeros((count, 2)), weight
    )
    smaller = Template(
        np.zeros((10, 10 * smaller_mm2), np.uint8), np.ones((10, 10 * smaller_mm2), bool), 0.1
    )
    for pair in ((side, smaller), (smaller, side)):
        result = scored(*map(Prepared, pair), agreement)
        assert result.overlap_mm2 == pytest.approx(overlap_mm2, rel=1e-5)
        assert result.correlation == pytest.approx(0.8)
        assert result.similarity == pytest.approx(0.8 * math.sqrt(factor), rel=1e-5)
        assert result.compared


def test_two_patch_fits_follow_a_start(side: Template) -> None:
    a, b = Prepared(side), Prepared(side)
    start = rigid(a.band, b.band, 0.02, 0.2, 0.1)
    before = compare_patches(b.first, a.band, start)
    affine = ridge.refined(a, b, start, before)
    corners = np.array([[30, 30, 1], [100, 30, 1], [65, 120, 1]])
    np.testing.assert_allclose(corners @ affine.T, corners[:, :2], atol=0.6)
    assert compare_patches(b.patches, a.band, affine).mean > 0.95


def test_scores_are_sums_of_weighted_evidence() -> None:
    nan = math.nan
    assert fused_score(nan, nan, 4.0, nan) == pytest.approx(0.8927 * 4 - 3.947)
    assert fused_score(nan, nan, 0.0, nan) == -10.2292
    assert fused_score(nan, nan, nan, nan) == -10.2292
    assert fused_score(0.5, 0.4, 7.0, nan) == pytest.approx(3.5044 * 0.5 + 19.9267 * 0.4 - 10.2292)
    for overlap_mm2, root in ((49.0, 7), (100.0, 10), (400.0, 10)):
        assert fused_score(nan, 0.4, nan, overlap_mm2) == pytest.approx(
            8.4813 * 0.4 + 0.5001 * 0.4 * root - 5.6423
        )
        assert fused_score(0.5, 0.4, 3.0, overlap_mm2) == pytest.approx(
            4.8715 * 0.5 + 8.1117 * 0.4 + 0.5104 * 0.4 * root - 6.1373
        )


def turned(template: Template, angle_rad: float, right_mm: float, up_mm: float) -> Template:
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
def test_a_moved_print_is_found_by_both(rows: int, columns: int) -> None:
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
    assert math.isnan(overlap_mm2) != small
    if small:
        assert overlap_mm2 == pytest.approx(b.area_mm2, rel=0.05)
        assert match.ridge.correlation == correlation == match.ridge.similarity
    assert match.compared


def test_prints_without_minutiae_are_rated_by_their_overlap() -> None:
    a = print_of(3)
    b = turned(a, 0.25, 1.0, -0.5)
    a, b = replace(a, minutiae=no_minutiae()), replace(b, minutiae=no_minutiae())
    match = fused_match(a, b)
    fraction, correlation, support, overlap_mm2 = match.evidence
    assert math.isnan(fraction)
    assert math.isnan(support)
    assert match.minutiae is None
    assert correlation > 0.85
    assert overlap_mm2 == pytest.approx(b.area_mm2, rel=0.05)
    assert match.similarity == fused_score(*match.evidence)
    assert match.ridge.similarity == pytest.approx(ridge_match(a, b).similarity, abs=1e-6)


def test_minutiae_of_different_places_are_counted_where_both_show_them(side: Template) -> None:
    """A side that shows half of the other can agree in half of its minutiae."""
    half = replace(side, valid=side.valid.copy())
    half.valid[:, 65:] = False
    a, b = Prepared(half), Prepared(side)
    patches = b.patches
    count, possible = fusion._agreeing_minutiae(a, b, patches, np.eye(2, 3), None)
    in_a = -(side.minutiae.x_px - (side.minutiae.size[1] - 1) / 2) * 0.0508 <= 0
    assert count == pytest.approx(in_a.sum(), rel=0.15)
    assert possible == pytest.approx(math.sqrt(in_a.sum() * 20), rel=0.1)
    moved = rigid(a.band, b.band, 0.0, 3.0, 0.0)
    assert fusion._agreeing_minutiae(a, b, patches, moved, None)[0] < 0.5 * count
    bend = np.full((*patches.grid, 2), 20, np.float32)
    assert fusion._agreeing_minutiae(a, b, patches, np.eye(2, 3), bend)[0] < 0.5 * count


@pytest.mark.parametrize("pitch_mm", [0.1, 0.12])
@pytest.mark.parametrize("period_mm", [0.4, 0.5, 0.7])
def test_the_usual_frequency_is_that_of_the_ridges(period_mm: float, pitch_mm: float) -> None:
    y, x = np.mgrid[:140, :150] * pitch_mm
    waves = np.sin(2 * np.pi / period_mm * (0.8 * x + 0.6 * y)).astype(np.float32)
    template = leveled(waves, np.ones(waves.shape, bool), pitch_mm)
    assert fusion._log_frequency(template) == pytest.approx(math.log(1 / period_mm), abs=0.02)


@pytest.mark.parametrize("scale", [1.12, 0.9])
def test_finer_ridges_are_enlarged(side: Template, scale: float) -> None:
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


def test_photographs_are_tried_about_the_scale_of_their_ridges(monkeypatch) -> None:
    tried = []

    def record(a: Prepared, b: Prepared) -> RidgeMatch:
        shapes = a.template.valid.shape, b.template.valid.shape
        tried.append(shapes)
        return RidgeMatch(float(shapes[0][0] == 94 or shapes[1][0] == 94))

    frequency = {100: 0.0, 90: 9.0}
    monkeypatch.setattr(fusion, "fused_match", record)
    monkeypatch.setattr(
        fusion, "_log_frequency", lambda template: frequency[template.valid.shape[0]]
    )
    a, b = (
        Prepared(Template(np.zeros((n, n), np.uint8), np.ones((n, n), bool), 0.1))
        for n in (100, 90)
    )
    middle = math.exp(-0.15)
    match, scale, number = fusion.fused_photo(a, b, (True, False))
    sizes = [round(100 * middle * s) for s in (1.0, 0.94, 1.06, 0.88, 1.12)]
    assert tried == [((n, n), (90, 90)) for n in sizes]
    assert (scale, number) == (middle, 0)
    tried.clear()
    match, scale, number = fusion.fused_photo(a, b, (False, True))
    sizes = [round(90 / middle * s) for s in (1.0, 0.94, 1.06, 0.88, 1.12)]
    assert tried == [((100, 100), (n, n)) for n in sizes]
    assert number == 1
    assert sizes.count(94) <= 1
    assert match.similarity == (94 in sizes)
    both = [fusion.fused_photo(*pair, (True, True))[2] for pair in ((a, b), (b, a))]
    assert sorted(both) == [0, 1]
    assert both[0] == (fusion._order(a) > fusion._order(b))


def test_prints_of_two_scales_are_doubted(monkeypatch) -> None:
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


def test_agreeing_minutiae_count_for_an_alignment(monkeypatch) -> None:
    """Where ridges show two alignments alike, that of more minutiae is taken."""
    a, b = Prepared(print_of(3)), Prepared(print_of(3))
    (pairing, *_) = fusion.pair_minutiae(a.cylinders, b.cylinders)
    still = rigid(a.band, b.band, 0.0, 0.0, 0.0)
    agreement = compare_patches(b.first, a.band, still)
    monkeypatch.setattr(fusion, "likely_alignments", lambda a, b: [still + [[0, 0, 7]] * 2])
    bends = []

    def compared(patches: object, band: object, affine: object, bend: object = None) -> Agreement:
        bends.append((patches is b.patches, bend is not None))
        return agreement

    monkeypatch.setattr(fusion, "compare_patches", compared)
    monkeypatch.setattr(fusion, "refined", lambda a, b, affine, agreement: affine)
    for of_pairing, of_ridges, shift in ((5.0, 1.0, 0), (1.0, 5.0, 7)):
        counts = {True: of_ridges, False: of_pairing}
        monkeypatch.setattr(
            fusion,
            "_agreeing_minutiae",
            lambda a, b, patches, affine, bend, counts=counts: (counts[affine[0, 2] > 3], 9.0),
        )
        bends.clear()
        best = fusion._best_alignment(a, b, [pairing], math.inf, drift=True)
        assert bends == [(False, True), (False, True), (True, True), (True, True)]
        np.testing.assert_allclose(best.affine[:, 2], [shift, shift], atol=1.0)
        # minutiae that are sure leave no alignment of ridges to choose
        sure = fusion._best_alignment(a, b, [pairing], pairing.support, drift=True)
        np.testing.assert_allclose(sure.affine, pairing.affine(a.band, b.band))
    bends.clear()
    fusion._best_alignment(a, b, [], math.inf, drift=False)
    assert bends == [(False, False), (True, False), (True, True), (True, True)]


def test_a_match_without_details_was_not_compared() -> None:
    assert RidgeMatch(-1.0) == RidgeMatch(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, compared=False)
    assert RidgeMatch(-1.0).compared is False


def test_a_small_print_is_laid_on_the_larger_one(monkeypatch) -> None:
    laid = []

    def best_pose(a: Prepared, b: Prepared, pairings: list) -> None:
        laid.append((a.template.area_mm2, b.template.area_mm2))
        raise StopIteration

    monkeypatch.setattr(fusion, "_best_pose", best_pose)
    for seed in range(4):
        pair = print_of(seed, 90, 80), print_of(seed + 4, 60, 70)
        for sides in (pair, pair[::-1]):
            with pytest.raises(StopIteration):
                fused_match(*sides)
    np.testing.assert_allclose(laid, [(72.0, 42.0)] * 8)


def test_poses_without_overlap_were_not_compared(monkeypatch) -> None:
    a, b = Prepared(print_of(3, 90, 80)), Prepared(print_of(3, 60, 70))
    for overlap_mm2 in (0.0, 0.4):
        monkeypatch.setattr(
            fusion, "overlap_correlation", lambda *values, area=overlap_mm2: (0.5, area)
        )
        pose = fusion._best_pose(a, b, [])
        assert pose.ridge == RidgeMatch(0.5, 0.5, overlap_mm2, compared=overlap_mm2 > 0)
