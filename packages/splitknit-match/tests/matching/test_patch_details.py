"""Patches against plain loops: their places, sums, correlations, supports, fits and bends."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit_match.matching import elastic
from splitknit_match.matching.elastic import Agreement, PatchGrid, compare_patches, patch_grid
from splitknit_match.matching.parameters import FIRM, MIN_CORRELATION, STILL
from splitknit_match.matching.ridge_band import RidgeBand

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def texture(seed: int, rows: int, columns: int, invalid: int = 0) -> RidgeBand:
    noise = np.random.default_rng(seed).normal(size=(rows, columns)).astype(np.float32)
    value = cv2.GaussianBlur(noise, (0, 0), 1.2) - cv2.GaussianBlur(noise, (0, 0), 3.0)
    valid = np.ones(value.shape, bool)
    valid[:, :invalid] = False
    return RidgeBand(np.where(valid, value / value.std(), np.float32(0)), valid, 0.1)


@pytest.fixture(scope="module")
def band() -> RidgeBand:
    return texture(8, 83, 67, invalid=11)


@pytest.fixture(scope="module")
def patches(band: RidgeBand) -> PatchGrid:
    return patch_grid(band)


def test_patches_lie_on_a_centred_grid(band: RidgeBand, patches: PatchGrid) -> None:
    assert (patches.side, patches.step, patches.reach) == (24, 16, 4)
    assert patches.grid == (4, 3)  # (83 - 24) // 16 + 1, (67 - 24) // 16 + 1
    np.testing.assert_array_equal(patches.origin, [5 + 11.5, 5 + 11.5])
    expected = [(r, c) for r in range(4) for c in range(3)]
    kept = [(r, c) for r, c in expected if band.valid[5:29, 5 + 16 * c : 29 + 16 * c].mean() >= 0.6]
    assert kept == expected  # 6 of the first patch's 24 columns are not valid
    np.testing.assert_array_equal(patches.cell, kept)
    np.testing.assert_array_equal(patches.corner, 5 + 16 * np.array(kept))
    np.testing.assert_allclose(
        patches.centres, patches.origin + 16.0 * np.array([(c, r) for r, c in kept])
    )
    for number, (row, column) in enumerate(patches.corner):
        square = np.s_[row : row + 24, column : column + 24]
        assert patches.fraction[number] == pytest.approx(band.valid[square].mean())
        assert patches.energy[number] == pytest.approx((band.value[square] ** 2).sum(), rel=1e-5)


def test_patches_with_too_little_skin_are_left_out() -> None:
    patches = patch_grid(texture(8, 83, 67, invalid=16))
    assert set(patches.cell[:, 1]) == {1, 2}


def test_a_band_smaller_than_a_patch_has_one() -> None:
    small = texture(2, 20, 23)
    patches = patch_grid(small)
    assert patches.grid == (1, 1)
    np.testing.assert_array_equal(patches.corner, [[0, 0]])
    assert patches.fraction[0] == pytest.approx(20 * 23 / 24**2)
    assert patches.energy[0] == pytest.approx((small.value**2).sum(), rel=1e-5)
    agreement = compare_patches(patches, small, IDENTITY)
    assert agreement.correlation[0] == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(("pitch_mm", "sizes"), [(2.0, (4, 1, 1)), (0.05, (48, 32, 8))])
def test_sizes_of_patches_follow_the_pitch(pitch_mm: float, sizes: tuple[int, ...]) -> None:
    patches = patch_grid(replace(texture(2, 60, 60), pitch_mm=pitch_mm))
    assert (patches.side, patches.step, patches.reach) == sizes
    assert patches.pitch_mm == pitch_mm


def test_positions_belong_to_the_nearest_patch(patches: PatchGrid) -> None:
    position = patches.origin + 16 * np.array([[1.4, 2.6], [-3.0, 9.0], [9.0, -2.0], [0.0, 1.0]])
    rows, columns = patches.nearest(position)
    np.testing.assert_array_equal(rows, [3, 3, 0, 1])
    np.testing.assert_array_equal(columns, [1, 0, 2, 0])


def test_sums_are_of_squares_that_begin_at_each_pixel(band: RidgeBand) -> None:
    sums = elastic._sums(band.value, 7)
    padded = np.pad(band.value.astype(float), (0, 6))
    for row, column in ((0, 0), (12, 40), (82, 66), (79, 3)):
        assert sums[row, column] == pytest.approx(
            padded[row : row + 7, column : column + 7].sum(), abs=1e-4
        )


def test_patches_correlate_as_plain_sums_do(band: RidgeBand, patches: PatchGrid) -> None:
    """One patch alone, where no neighbour has a say."""
    alone = replace(
        patches,
        **{
            name: getattr(patches, name)[5:6]
            for name in ("cell", "corner", "spectrum", "energy", "fraction")
        },
    )
    a = RidgeBand(texture(9, 83, 67).value, np.ones((83, 67), bool), 0.1)
    agreement = compare_patches(alone, a, IDENTITY)
    row, column = alone.corner[0]
    patch = band.value[row : row + 24, column : column + 24].astype(float)
    table = np.zeros((9, 9))
    for down in range(-4, 5):
        for right in range(-4, 5):
            part = a.value[row + down :, column + right :][:24, :24].astype(float)
            table[down + 4, right + 4] = (patch * part).sum() / np.sqrt(
                (patch * patch).sum() * (part * part).sum()
            )
    down, right = np.array(np.unravel_index(table.argmax(), table.shape)) - 4
    assert 0 < abs(down) < 4
    np.testing.assert_allclose(agreement.shift, [[-right, -down]], atol=0.5)
    assert agreement.correlation[0] == pytest.approx(table.max(), abs=0.03)
    assert agreement.correlation[0] >= table.max() - 1e-5
    assert agreement.weight[0] == pytest.approx(alone.fraction[0])


def test_flat_patches_do_not_count_for_more_than_they_show(patches: PatchGrid) -> None:
    """What is nearly without contrast is divided by a twentieth of the usual power."""
    faint = replace(patches, energy=np.full_like(patches.energy, 1e-6))
    zero = RidgeBand(np.full((83, 67), 1e-4, np.float32), np.ones((83, 67), bool), 0.1)
    assert np.abs(compare_patches(faint, zero, IDENTITY).correlation).max() < 0.01


def test_neighbours_support_a_shift_by_half_each() -> None:
    rng = np.random.default_rng(3)
    cell = np.array([(r, c) for r in range(3) for c in range(4) if (r, c) != (1, 1)])
    surface = rng.normal(size=(len(cell), 3, 3))
    weight = rng.uniform(0.6, 1, len(cell))
    support = elastic._supported(surface, cell, (3, 4), weight)
    for number, (row, column) in enumerate(cell):
        expected = np.zeros((3, 3))
        for k, (r, c) in enumerate(cell):
            factor = (
                {0: 4, 1: 2, 2: 1}[abs(r - row) + abs(c - column)]
                if (max(abs(r - row), abs(c - column)) <= 1)
                else 0
            )
            expected += factor * weight[k] * surface[k]
        np.testing.assert_allclose(support[number], expected, atol=1e-5)


def test_a_parabola_has_its_peak_between_pixels() -> None:
    down, right = np.mgrid[-4:5, -4:5]
    surface = np.stack(
        [
            0.9 - 0.02 * (right - 1.3) ** 2 - 0.03 * (down + 2.2) ** 2,
            0.7 - 0.02 * (right - 6.0) ** 2 - 0.03 * (down - 0.4) ** 2,  # beyond the search
            np.zeros((9, 9)),
        ]
    )
    shift, correlation = elastic._peak(surface.astype(np.float32), surface.astype(np.float32))
    np.testing.assert_allclose(shift[0], [-1.3, 2.2], atol=1e-4)
    assert correlation[0] == pytest.approx(0.9, abs=1e-4)
    np.testing.assert_allclose(shift[1], [-4, -0.4], atol=1e-4)
    assert correlation[1] == pytest.approx(0.7 - 0.02 * 4, abs=1e-4)
    np.testing.assert_array_equal(shift[2], [4, 4])
    assert correlation.dtype == np.float32
    # the place is that of the support, the height that of the correlation there
    _, height = elastic._peak(surface[:1].astype(np.float32), 2 * surface[:1].astype(np.float32))
    assert height[0] == 1.0
    _, height = elastic._peak(surface[:1].astype(np.float32), -2 * surface[:1].astype(np.float32))
    assert height[0] == -1.0


def agreement_of(shift: np.ndarray, correlation: np.ndarray | float = 0.8) -> Agreement:
    count = len(shift)
    full = np.full(count, correlation, np.float32)
    return Agreement(np.arange(count), full, shift, np.ones(count, np.float32))


def test_weights_of_an_agreement() -> None:
    agreement = Agreement(
        np.arange(4),
        np.array([0.1, 0.2, 0.5, 0.8], np.float32),
        np.zeros((4, 2)),
        np.array([1.0, 1.0, 0.6, 0.8], np.float32),
    )
    mean = (0.1 + 0.2 + 0.5 * 0.6 + 0.8 * 0.8) / 3.4
    assert agreement.mean == pytest.approx(mean)
    assert agreement.evidence == pytest.approx(2 * mean)
    np.testing.assert_allclose(
        agreement.firmness,
        [0, 0, (0.5 - MIN_CORRELATION) ** 2 * 0.6, (0.8 - MIN_CORRELATION) ** 2 * 0.8],
        atol=1e-7,
    )


def test_an_affine_fit_solves_the_penalised_equations() -> None:
    """Solved again by one system of all unknowns, step by step."""
    patches = patch_grid(texture(1, 150, 130))
    rng = np.random.default_rng(5)
    position = patches.centres
    shift = 0.03 * (position - 60) @ np.array([[1, 0.4], [-0.5, 0.7]]) + [1, -2]
    shift += rng.normal(0, 0.5, shift.shape)
    shift[3] += 9
    agreement = agreement_of(shift, rng.uniform(0.3, 0.9, len(shift)).astype(np.float32))
    start = np.array([[0.9, 0.2, 3.0], [-0.2, 0.9, -4.0]])
    fitted = elastic.better_affine(patches, agreement, start)
    weight = (agreement.correlation.astype(float) - 0.2) ** 2
    centre = position.mean(axis=0)
    design = np.column_stack([(position - centre) / 50, np.ones(len(position))])
    robust = weight
    for _ in range(4):
        held = np.sqrt(robust.sum()) * np.diag([0.3, 0.3])
        rows = np.vstack([np.sqrt(robust)[:, None] * design, np.column_stack([held, np.zeros(2)])])
        wanted = np.vstack([np.sqrt(robust)[:, None] * shift, np.zeros((2, 2))])
        solution = np.linalg.lstsq(rows, wanted, rcond=None)[0]
        distance = np.hypot(*(design @ solution - shift).T)
        robust = weight / (1 + (distance / 2) ** 2)
    for place in (np.array([10.0, 20.0]), np.array([100.0, 90.0])):
        moved = place - (np.append((place - centre) / 50, 1) @ solution)
        np.testing.assert_allclose(
            fitted @ np.append(place, 1), start @ np.append(moved, 1), atol=1e-4
        )


def test_an_affine_fit_needs_six_patches_that_correlate() -> None:
    patches = patch_grid(texture(1, 150, 130))
    correlation = np.zeros(len(patches.cell), np.float32)
    shift = np.ones((len(correlation), 2))
    correlation[:6] = 0.31  # (0.31 - 0.2)^2 > 0.01
    fitted = elastic.better_affine(patches, agreement_of(shift, correlation), IDENTITY)
    np.testing.assert_allclose(fitted[:, 2], [-1, -1], atol=1e-6)
    correlation[5] = 0.29
    assert elastic.better_affine(patches, agreement_of(shift, correlation), IDENTITY) is IDENTITY


def test_bends_are_weighted_means_that_fade_out() -> None:
    patches = patch_grid(texture(1, 150, 130))
    shift = np.tile([2.0, -1.0], (len(patches.cell), 1))
    agreement = agreement_of(shift, 0.6)
    bend = elastic.bent(patches, agreement)
    assert bend.shape == (*patches.grid, 2)
    firm = (0.6 - MIN_CORRELATION) ** 2
    np.testing.assert_allclose(
        bend[3, 3], np.array([2, -1]) * firm / (firm + STILL * FIRM), rtol=1e-2
    )
    np.testing.assert_allclose(elastic.bent(patches, agreement, bend), 2 * bend, rtol=1e-6)
    position = patches.centres[[0, 0, 17]] + 1
    by = elastic.bent_by(patches, position, np.array([[1.0, 0], [3.0, 0], [0, 5.0]]))
    row, column = patches.cell[0]
    assert by[row, column, 0] == pytest.approx(2 * 0.32 / (0.32 + 0.05 * 0.16 / 0.1592), rel=0.02)
    row, column = patches.cell[17]
    assert by[row, column, 1] == pytest.approx(5 * 0.16 / (0.16 + 0.05 * 0.16 / 0.1592), rel=0.02)
    assert abs(by[row, column, 0]) < 0.05
    assert np.abs(by[-1, -1]).max() < 0.01


def test_bent_places_are_interpolated_between_patches() -> None:
    patches = patch_grid(texture(1, 150, 130))
    rng = np.random.default_rng(2)
    bend = rng.normal(size=(*patches.grid, 2)).astype(np.float32)
    affine = np.array([[0.9, 0.2, 3.0], [-0.2, 0.9, -4.0]])
    places = elastic.bent_places(patches, (150, 130), affine, bend)
    assert places.shape == (150, 130, 2)
    origin = patches.origin
    for row, column in ((2, 3), (5, 1), (0, 0)):
        x, y = origin + 16 * np.array([column, row])
        left, top = int(x), int(y)
        if (x, y) == (left, top):
            moved = np.array([x, y]) - bend[row, column]
        else:
            x, y = left, top
            part = (np.array([x, y]) - origin) / 16
            c, r = (np.clip(np.floor(p), 0, None).astype(int) for p in part)
            fx, fy = np.clip(part - [c, r], 0, 1)
            moved = np.array([x, y]) - (
                (1 - fy) * ((1 - fx) * bend[r, c] + fx * bend[r, c + 1])
                + fy * ((1 - fx) * bend[r + 1, c] + fx * bend[r + 1, c + 1])
            )
        np.testing.assert_allclose(places[top, left], affine @ np.append(moved, 1), atol=0.05)
    # beyond the grid its border goes on
    np.testing.assert_allclose(
        places[149, 129], affine @ np.append([129, 149] - bend[-1, -1], 1), atol=1e-3
    )
    inside = elastic.bent_places(patches, (170, 150), affine, bend, border=10)
    shifted = affine[:, :2] @ np.array([10, 10])
    np.testing.assert_allclose(inside[10:160, 10:140] - shifted, places, atol=0.02)


def test_places_of_b_are_found_in_a_along_the_bend() -> None:
    patches = patch_grid(texture(1, 150, 130))
    bend = np.random.default_rng(2).normal(size=(*patches.grid, 2)).astype(np.float32)
    affine = np.array([[0.9, 0.2, 3.0], [-0.2, 0.9, -4.0]])
    position = patches.centres[[4, 11]]
    plain = elastic.shown_in_a(patches, affine, None, position)
    np.testing.assert_allclose(plain, position @ affine[:, :2].T + affine[:, 2])
    moved = elastic.shown_in_a(patches, affine, bend, position)
    for number, k in enumerate((4, 11)):
        row, column = patches.cell[k]
        np.testing.assert_allclose(
            moved[number], affine @ np.append(position[number] - bend[row, column], 1), atol=1e-5
        )


def test_bent_patches_are_compared_where_the_bend_takes_them() -> None:
    """A uniform bend does what the same shift of the affine map does."""
    b = texture(4, 120, 110)
    a = texture(4, 120, 110)
    patches = patch_grid(b)
    bend = np.tile(np.float32([2.0, -3.0]), (*patches.grid, 1))
    turn = elastic.rigid(a, b, 0.03, 0.1, 0.2)
    moved = turn.copy()
    moved[:, 2] -= turn[:, :2] @ [2, -3]
    by_bend = compare_patches(patches, a, turn, bend)
    by_map = compare_patches(patches, a, moved)
    np.testing.assert_array_equal(by_bend.used, by_map.used)
    assert np.median(np.abs(by_bend.correlation - by_map.correlation)) < 1e-3
    assert np.median(np.abs(by_bend.shift - by_map.shift)) < 0.01


def test_all_that_overlaps_is_correlated() -> None:
    a, b = texture(4, 120, 110, invalid=20), texture(4, 120, 110)
    b = replace(b, value=0.7 * b.value + 0.3 * texture(5, 120, 110).value)
    patches = patch_grid(b)
    bend = np.zeros((*patches.grid, 2), np.float32)
    shifted = np.array([[1.0, 0, 5], [0, 1, 2]])  # B's (column, row) shows A's (+5, +2)
    correlation, area_mm2 = elastic.overlap_correlation(patches, a, b, shifted, bend)
    in_a, in_b = a.value[2:, 20:], b.value[:118, 15:105]
    assert area_mm2 == pytest.approx(118 * 90 * 0.01)
    expected = (in_a * in_b).sum() / np.sqrt((in_a**2).sum() * (in_b**2).sum())
    assert correlation == pytest.approx(expected, abs=1e-4)
    far = np.array([[1.0, 0, 500], [0, 1, 0]])
    assert elastic.overlap_correlation(patches, a, b, far, bend) == (0, 0)


def test_spectra_are_over_the_root_of_the_number() -> None:
    values = np.random.default_rng(1).normal(size=(2, 6, 8))
    spectrum = elastic.spectrum_of(values)
    assert spectrum.dtype == np.complex64
    np.testing.assert_allclose(spectrum, np.fft.rfft2(values) / np.sqrt(48), atol=1e-5)
    assert elastic.spectrum_of(values, (10, 12)).shape == (2, 10, 7)


def test_a_bend_is_laid_where_its_patches_lie() -> None:
    """Where the bend grows across the finger, the search finds what takes it back."""
    b = texture(4, 150, 130)
    patches = patch_grid(b)
    grown = 0.06 * (patches.origin[0] + 16 * np.arange(patches.grid[1]) - 65)
    bend = np.zeros((*patches.grid, 2), np.float32)
    bend[..., 0] = grown
    agreement = compare_patches(patches, b, IDENTITY, bend)
    expected = -grown[patches.cell[agreement.used, 1]]
    assert abs(np.median(agreement.shift[:, 0] - expected)) < 0.08
    assert abs(np.median(agreement.shift[:, 1])) < 0.05
    inner = np.abs(expected) < 2
    np.testing.assert_allclose(agreement.shift[inner, 0], expected[inner], atol=0.2)


def test_windows_of_odd_sides_are_searched_too() -> None:
    b = replace(texture(4, 150, 130), pitch_mm=0.096)
    patches = patch_grid(b)
    assert (patches.side, patches.reach) == (25, 4)
    a = replace(b, value=np.roll(b.value, (3, -2), axis=(0, 1)))
    agreement = compare_patches(patches, a, IDENTITY)
    inner = agreement.used[10:-10]
    np.testing.assert_allclose(agreement.shift[inner], np.tile([2, -3], (len(inner), 1)), atol=0.05)


def test_nothing_in_common_is_an_agreement_of_none(band: RidgeBand, patches: PatchGrid) -> None:
    agreement = compare_patches(patches, replace(band, valid=np.zeros_like(band.valid)), IDENTITY)
    assert agreement.shift.shape == (0, 2)
    assert len(agreement.used) == len(agreement.correlation) == len(agreement.weight) == 0
    assert agreement.mean == agreement.evidence == 0
