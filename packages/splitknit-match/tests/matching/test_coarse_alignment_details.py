"""Coarse alignment against plain sums: views, directions, peaks and poses."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit_match.matching import coarse
from splitknit_match.matching.coarse import CoarseViews, every_pose, inverse, likely_alignments
from splitknit_match.matching.elastic import rigid
from splitknit_match.matching.parameters import BLOCKS, COARSE_GRID_PX, POSES
from splitknit_match.matching.ridge_band import RidgeBand


def texture(seed: int, rows: int, columns: int) -> RidgeBand:
    """Ridges of two waves whose directions change, so that each place is its own."""
    noise = np.random.default_rng(seed).normal(size=(rows, columns)).astype(np.float32)
    value = cv2.GaussianBlur(noise, (0, 0), 1.5) - cv2.GaussianBlur(noise, (0, 0), 2.5)
    return RidgeBand(value / value.std(), np.ones(value.shape, bool), 0.1)


def waves(angle_rad: float, rows: int = 200, columns: int = 180) -> RidgeBand:
    """Parallel ridges whose normal is `angle_rad` counter-clockwise from the right."""
    y, x = np.mgrid[:rows, :columns]
    value = 1.4 * np.sin(0.8 * (x * np.cos(angle_rad) - y * np.sin(angle_rad)))
    return RidgeBand(value.astype(np.float32), np.ones(value.shape, bool), 0.1)


@pytest.fixture(scope="module")
def views() -> CoarseViews:
    return CoarseViews(texture(1, 200, 180))


def test_spectra_hold_the_frequencies_of_ridges_alone(views: CoarseViews) -> None:
    passed = np.abs(views.ridges()) > 0
    down = np.fft.fftfreq(216, 0.15)
    across = np.fft.rfftfreq(216, 0.15)
    expected = [[1.2 < np.hypot(u, v) < 0.5 / 0.15 for u in across] for v in down]
    np.testing.assert_array_equal(passed, expected)


@pytest.mark.parametrize("number", [0, 1, 35, 71])
def test_a_view_correlates_with_itself_by_one(views: CoarseViews, number: int) -> None:
    spectrum = views.ridges(number)
    correlation = np.fft.irfft2(spectrum * spectrum.conj(), s=COARSE_GRID_PX)
    assert correlation[0, 0] == pytest.approx(1, abs=0.01)
    assert correlation.argmax() == 0
    assert spectrum.dtype == np.complex64


def test_views_are_whitened_by_the_root_of_their_magnitude(views: CoarseViews) -> None:
    soft = cv2.warpAffine(
        views._soft,
        np.array([[1.5, 0, 89.5 - 1.5 * 107.5], [0, 1.5, 99.5 - 1.5 * 107.5]]),
        (216, 216),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    spectrum = np.fft.rfft2(soft) / 216
    magnitude = np.maximum(np.abs(spectrum), 0.05 * np.abs(spectrum).max())
    expected = np.where(np.abs(views.ridges()) > 0, spectrum / np.sqrt(magnitude), 0)
    expected *= 216 / np.sqrt(2 * (np.abs(expected) ** 2).sum())
    np.testing.assert_allclose(views.ridges(), expected, atol=1e-3 * np.abs(expected).max())


def test_the_band_is_smoothed_for_the_coarse_grid() -> None:
    point = RidgeBand(np.zeros((41, 41), np.float32), np.ones((41, 41), bool), 0.1)
    point.value[20, 20] = 1
    soft = CoarseViews(point)._soft
    assert soft.sum() == pytest.approx(1, abs=1e-3)
    _, column = np.indices(soft.shape) - 20
    assert (soft * column**2).sum() == pytest.approx(0.6**2, rel=0.05)


def test_no_band_makes_no_numbers_that_are_not_finite() -> None:
    nothing = RidgeBand(np.zeros((60, 50), np.float32), np.ones((60, 50), bool), 0.1)
    assert not CoarseViews(nothing).ridges().any()
    assert np.isfinite(CoarseViews(nothing).directions).all()


def test_views_turn_round_after_a_whole_turn(views: CoarseViews) -> None:
    assert views.ridges(144) is views.ridges(0)
    assert views.ridges(-1) is views.ridges(143)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 200.0])
def test_pictures_are_turned_counter_clockwise_about_their_middle(angle_deg: float) -> None:
    picture = texture(2, 41, 61).value
    size = 31, 37
    turned = coarse._turned(picture, np.deg2rad(angle_deg), 1.5, size)
    assert turned.shape == size
    cos, sin = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    for row, column in ((15, 18), (20, 18), (15, 24), (9, 10)):
        right, up = 1.5 * (column - 18), 1.5 * (15 - row)
        # what is seen there lay clockwise before
        x, y = 30 + cos * right + sin * up, 20 - (cos * up - sin * right)
        left, top = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - left, y - top
        expected = (1 - fy) * ((1 - fx) * picture[top, left] + fx * picture[top, left + 1]) + fy * (
            (1 - fx) * picture[top + 1, left] + fx * picture[top + 1, left + 1]
        )
        assert turned[row, column] == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("angle_deg", [0.0, 25.0, 90.0, 140.0])
def test_blocks_hold_the_doubled_directions(angle_deg: float) -> None:
    spectra = CoarseViews(waves(np.deg2rad(angle_deg))).directions
    assert spectra.shape == (3, 36, BLOCKS[0], BLOCKS[1] // 2 + 1)
    scale = np.sqrt(BLOCKS[0] * BLOCKS[1])
    for number in (0, 3, 20):
        cosine, sine, fraction = scale * np.fft.irfft2(spectra[:, number], s=BLOCKS)
        doubled = 2 * np.deg2rad(angle_deg + 5 * number)
        middle = np.s_[11:16, 10:14]
        np.testing.assert_allclose(cosine[middle], np.cos(doubled), atol=0.05)
        np.testing.assert_allclose(sine[middle], np.sin(doubled), atol=0.05)
        np.testing.assert_allclose(fraction[middle], 1, atol=1e-3)
        assert abs(fraction[0, 0]) < 1e-3
        # 20 x 18 mm of blocks of 1.5 mm
        assert fraction.sum() == pytest.approx(20 * 18 / 1.5**2, rel=0.04)


def test_weak_ridges_show_little_direction() -> None:
    band = waves(0.0)
    faint = band.value.copy()
    faint[:, :90] *= 0.1
    spectra = CoarseViews(replace(band, value=faint)).directions
    cosine = np.sqrt(BLOCKS[0] * BLOCKS[1]) * np.fft.irfft2(spectra[0, 0], s=BLOCKS)
    assert cosine[13, 16] == pytest.approx(1, abs=0.02)
    # a hundredth of the power, over 0.3 of the mean of both middle ones: half of the skin
    assert 0.01 < cosine[13, 7] < 0.12


def test_directions_agree_over_the_root_of_the_overlap() -> None:
    rng = np.random.default_rng(3)
    a = rng.normal(size=(3, 2, *BLOCKS))
    b = rng.normal(size=(3, 1, *BLOCKS))
    a[2], b[2] = rng.uniform(0, 1, a[2].shape) ** 4, rng.uniform(0, 1, b[2].shape) ** 4
    product = np.fft.rfft2(a).conj() * np.fft.rfft2(b)
    scores = coarse._direction_agreement(product)
    overlaps = np.array(
        [
            [
                [(a[2, n] * np.roll(b[2, 0], (-r, -c), (0, 1))).sum() for c in range(BLOCKS[1])]
                for r in range(BLOCKS[0])
            ]
            for n in range(2)
        ]
    )
    least = 0.2 * overlaps.max()
    for n in range(2):
        best = max(
            sum((a[k, n] * np.roll(b[k, 0], (-r, -c), (0, 1))).sum() for k in (0, 1))
            / np.sqrt(max(overlaps[n, r, c], least))
            for r in range(BLOCKS[0])
            for c in range(BLOCKS[1])
        )
        assert scores[n] == pytest.approx(best)


def turned_band(band: RidgeBand, angle_deg: float, right_mm: float, up_mm: float) -> RidgeBand:
    """The band, turned about its middle and moved."""
    rows, columns = band.value.shape
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), angle_deg, 1.0)
    matrix[:, 2] += 10 * np.array([right_mm, -up_mm])
    value = cv2.warpAffine(band.value, matrix, (columns, rows), flags=cv2.INTER_CUBIC)
    valid = cv2.warpAffine(band.valid.astype(np.float32), matrix, (columns, rows)) > 0.99
    return replace(band, value=np.where(valid, value, np.float32(0)), valid=valid)


@pytest.mark.parametrize("number", [0, 3, 60, 74, 141])
def test_the_peak_is_the_shift_of_a_turned_band(number: int) -> None:
    a = texture(5, 200, 180)
    b = turned_band(a, 2.5 * number, 1.2, -0.9)
    peak = coarse._peak(CoarseViews(a), CoarseViews(b).ridges(), number)
    assert peak.angle_deg == 2.5 * number
    assert peak.right_mm == pytest.approx(1.2, abs=0.16)
    assert peak.down_mm == pytest.approx(0.9, abs=0.16)
    assert 0.5 < peak.height <= 1.01
    affine = peak.affine(a, b)
    np.testing.assert_allclose(
        affine,
        rigid(a, b, np.deg2rad(2.5 * number), peak.right_mm, peak.down_mm),
    )


@pytest.mark.parametrize(
    ("angle_deg", "right_mm", "down_mm", "expected"),
    [
        (6.0, 0, 0, True),
        (6.1, 0, 0, False),
        (-6.0, 0, 0, True),
        (354.0, 0, 0, True),
        (353.0, 0, 0, False),
        (180.0, 0, 0, False),
        (0.0, 0.59, 0, True),
        (0.0, 0, -0.61, False),
        (0.0, 0.5, 0.5, False),
    ],
)
def test_near_alignments_are_one(
    angle_deg: float, right_mm: float, down_mm: float, expected: bool
) -> None:
    first = coarse._Peak(1.0, 3.0, 1.0, -2.0)
    second = coarse._Peak(1.0, 3.0 + angle_deg, 1.0 + right_mm, -2.0 + down_mm)
    assert first.near(second) is expected
    assert second.near(first) is expected


@pytest.mark.parametrize(
    ("angle_deg", "right_mm", "up_mm"), [(0, 1.2, 0.9), (-17.5, 0, -2), (195, 0.6, 0)]
)
def test_the_likely_alignment_is_the_true_one(
    angle_deg: float, right_mm: float, up_mm: float
) -> None:
    """Curved ridges, as on a finger: directions alone tell rotations."""
    a = circles()
    b = turned_band(a, angle_deg, right_mm, up_mm)
    alignments = likely_alignments(CoarseViews(a), CoarseViews(b))
    assert len(alignments) <= 2
    true = rigid(a, b, np.deg2rad(angle_deg), right_mm, -up_mm)
    corners = np.array([[60, 60, 1], [120, 60, 1], [60, 140, 1]])
    np.testing.assert_allclose(corners @ alignments[0].T, corners @ true.T, atol=2.0)


def circles() -> RidgeBand:
    """Ridges around a centre that is off the middle, some of them broken."""
    y, x = np.mgrid[:200, :180]
    phase = 1.4 * np.hypot(x - 70, 0.7 * (y - 120)) + np.arctan2(y - 60, x - 110)
    value = 1.4 * np.sin(phase)
    return RidgeBand(value.astype(np.float32), np.ones(value.shape, bool), 0.1)


@pytest.mark.parametrize(
    ("rows", "columns", "turn"), [((30, 91), (95, 160), 0), ((100, 171), (20, 90), 22)]
)
def test_every_pose_of_a_part_is_tried(
    rows: tuple[int, int], columns: tuple[int, int], turn: int
) -> None:
    whole = texture(6, 200, 180)
    part = replace(
        whole,
        value=whole.value[slice(*rows), slice(*columns)],
        valid=whole.valid[slice(*rows), slice(*columns)],
    )
    part = turned_band(part, 4.0 * turn, 0, 0)
    poses = every_pose(CoarseViews(whole), CoarseViews(part))
    assert len(poses) == POSES
    middle = np.array([(np.diff(columns)[0] - 1) / 2, (np.diff(rows)[0] - 1) / 2])
    cos, sin = np.cos(np.deg2rad(4 * turn)), np.sin(np.deg2rad(4 * turn))
    for place in middle + np.array([[0, 0], [20, 0], [0, 20]]):
        right, down = place - middle
        expected = (
            middle[0] + columns[0] + cos * right - sin * down,
            middle[1] + rows[0] + sin * right + cos * down,
        )
        np.testing.assert_allclose(poses[0] @ np.append(place, 1), expected, atol=1.5)
    for number, pose in enumerate(poses):
        assert abs(np.linalg.det(pose[:, :2]) - 1) < 1e-9
        for better in poses[:number]:
            assert np.abs(pose - better).max() > 0.05


def test_pictures_of_a_small_print_hold_all_of_it_in_every_pose() -> None:
    band = texture(6, 61, 80)
    poses = CoarseViews(band).poses
    side = int(np.ceil(np.hypot(61, 80) / 1.5)) + 2
    assert poses.shape == (2, 90, side, side)
    np.testing.assert_allclose(poses[1].sum(axis=(1, 2)), 61 * 80 / 1.5**2, rtol=0.02)
    np.testing.assert_allclose(
        poses[0, 10],
        coarse._turned(CoarseViews(band)._soft, np.deg2rad(40), 1.5, (side, side)),
        atol=1e-6,
    )
    upright = CoarseViews(band).upright
    assert upright.shape == (2, 41, 54)
    np.testing.assert_allclose(
        upright[0], coarse._turned(CoarseViews(band)._soft, 0, 1.5, (41, 54)), atol=1e-6
    )


def test_the_inverse_leads_back() -> None:
    affine = np.array([[0.9, 0.2, 3.0], [-0.25, 1.1, -4.0]])
    place = np.array([7.0, -2.0])
    there = affine @ np.append(place, 1)
    np.testing.assert_allclose(inverse(affine) @ np.append(there, 1), place)


def test_a_part_that_occurs_twice_is_found_twice() -> None:
    """Two peaks of each rotation count."""
    whole = texture(6, 200, 180)
    value = whole.value.copy()
    value[120:181, 20:85] = value[30:91, 95:160]
    part = replace(whole, value=value[30:91, 95:160], valid=whole.valid[30:91, 95:160])
    poses = every_pose(CoarseViews(replace(whole, value=value)), CoarseViews(part))
    corners = sorted(tuple(np.round(pose[:, 2]).astype(int)) for pose in poses[:2])
    np.testing.assert_allclose(corners, [(20, 120), (95, 30)], atol=2)
    for pose in poses[:2]:
        np.testing.assert_allclose(pose[:, :2], np.eye(2), atol=1e-9)
