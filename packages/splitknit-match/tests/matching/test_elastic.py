"""Patches of two ridge bands: known shifts, plain sums, the affine fit, bends."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from splitknit_match.matching import elastic
from splitknit_match.matching.elastic import (
    Agreement,
    better_affine,
    compare_patches,
    patch_grid,
    rigid,
)
from splitknit_match.matching.ridge_band import RidgeBand

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def texture(seed, rows=160, columns=140, invalid=0):
    noise = np.random.default_rng(seed).normal(size=(rows, columns)).astype(np.float32)
    value = cv2.GaussianBlur(noise, (0, 0), 1.2) - cv2.GaussianBlur(noise, (0, 0), 3.0)
    valid = np.ones(value.shape, bool)
    valid[:, :invalid] = False
    return RidgeBand(np.where(valid, value / value.std(), np.float32(0)), valid, 0.1)


@pytest.mark.parametrize("shift", [(0, 0), (3, -2), (-4, 4), (2, 1)])
def test_shifts_of_patches_are_recovered(shift):
    b = texture(1)
    # A's content lies `shift` (columns, rows) further
    a = replace(b, value=np.roll(b.value, shift[::-1], axis=(0, 1)))
    agreement = compare_patches(patch_grid(b), a, IDENTITY)
    assert np.median(agreement.correlation[20:-20]) == pytest.approx(1.0, abs=0.02)
    # it must move back
    moved = np.median(agreement.shift, axis=0)
    assert_allclose(moved, [-shift[0], -shift[1]], atol=0.1)


def test_too_little_valid_skin_is_not_compared():
    b = texture(3)
    half = b.valid.copy()
    half[:, 70:] = False
    patches = patch_grid(b)
    a = replace(b, value=np.where(half, b.value, np.float32(0)), valid=half)
    used = compare_patches(patches, a, IDENTITY).used
    assert 0.3 < len(used) / len(patches.corner) < 0.6
    assert patches.corner[used, 1].max() + 0.6 * patches.side <= 71
    nothing = compare_patches(patches, replace(b, valid=np.zeros_like(half)), IDENTITY)
    assert nothing.mean == 0.0
    assert len(nothing.used) == 0


def test_affine_fit_follows_a_stretched_skin():
    b = texture(4, 220, 200)
    true = np.array([[1.03, 0.01, -4.0], [-0.015, 0.98, 3.0]])  # place in B to place in A
    # A at true(p) shows B at p
    a = replace(b, value=cv2.warpAffine(b.value, true, (200, 220), flags=cv2.INTER_CUBIC))
    patches = patch_grid(b, search_mm=0.8)
    agreement = compare_patches(patches, a, IDENTITY)
    fitted = better_affine(patches, agreement, IDENTITY)
    fitted = better_affine(patches, compare_patches(patches, a, fitted), fitted)
    corners = np.array([[30, 30, 1], [170, 30, 1], [30, 190, 1], [170, 190, 1]], float)
    assert_allclose(corners @ fitted.T, corners @ true.T, atol=0.5)


def test_a_rigid_map_takes_middle_to_middle_and_turns():
    turn = rigid(texture(0, 41, 61), texture(0, 101, 81), np.pi / 2, 0.5, -0.3)
    # B's middle, moved by the shift, shows A's middle
    assert_allclose(turn @ [40 + 5, 50 - 3, 1], [30, 20], atol=1e-9)
    # content to the right of A's middle is seen above (a smaller row)
    assert_allclose(turn @ [45, 47 - 10, 1], [40, 20], atol=1e-9)


def test_shifts_by_chance_have_no_support():
    """Dissimilar textures: each patch alone finds some shift that fits; its neighbours do not share
    it."""
    agreement = compare_patches(patch_grid(texture(6)), texture(5), IDENTITY)
    assert abs(agreement.mean) < 0.205  # 0.22 if every patch chose for itself


@pytest.fixture(scope="module")
def band():
    return texture(8, 83, 67, invalid=11)


@pytest.fixture(scope="module")
def patches(band):
    return patch_grid(band)


def test_patches_lie_on_a_centred_grid(band, patches):
    assert (patches.side, patches.step, patches.reach) == (24, 16, 4)
    assert patches.grid == (4, 3)  # (83 - 24) // 16 + 1, (67 - 24) // 16 + 1
    assert_array_equal(patches.origin, [5 + 11.5, 5 + 11.5])
    expected = [(r, c) for r in range(4) for c in range(3)]
    kept = [(r, c) for r, c in expected if band.valid[5:29, 5 + 16 * c : 29 + 16 * c].mean() >= 0.6]
    assert kept == expected  # 6 of the first patch's 24 columns are not valid
    assert_array_equal(patches.cell, kept)
    assert_array_equal(patches.corner, 5 + 16 * np.array(kept))
    assert_allclose(patches.centres, patches.origin + 16.0 * np.array([(c, r) for r, c in kept]))
    for number, (row, column) in enumerate(patches.corner):
        square = np.s_[row : row + 24, column : column + 24]
        assert patches.fraction[number] == pytest.approx(band.valid[square].mean())
        assert patches.energy[number] == pytest.approx((band.value[square] ** 2).sum(), rel=1e-5)


def test_a_band_smaller_than_a_patch_has_one():
    small = texture(2, 20, 23)
    patches = patch_grid(small)
    assert patches.grid == (1, 1)
    assert_array_equal(patches.corner, [[0, 0]])
    assert patches.fraction[0] == pytest.approx(20 * 23 / 24**2)
    assert patches.energy[0] == pytest.approx((small.value**2).sum(), rel=1e-5)
    agreement = compare_patches(patches, small, IDENTITY)
    assert agreement.correlation[0] == pytest.approx(1, abs=0.03)


def test_patches_correlate_as_plain_sums_do(band, patches):
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
    assert_allclose(agreement.shift, [[-right, -down]], atol=0.5)
    assert agreement.correlation[0] == pytest.approx(table.max(), abs=0.03)
    assert agreement.correlation[0] >= table.max() - 1e-5
    assert agreement.weight[0] == pytest.approx(alone.fraction[0])


def test_flat_patches_do_not_count_for_more_than_they_show(patches):
    """What is nearly without contrast is divided by a twentieth of the usual power."""
    faint = replace(patches, energy=np.full_like(patches.energy, 1e-6))
    zero = RidgeBand(np.full((83, 67), 1e-4, np.float32), np.ones((83, 67), bool), 0.1)
    assert np.abs(compare_patches(faint, zero, IDENTITY).correlation).max() < 0.01


def agreement_of(shift, correlation=0.8):
    count = len(shift)
    full = np.full(count, correlation, np.float32)
    return Agreement(np.arange(count), full, shift, np.ones(count, np.float32))


def test_an_affine_fit_needs_six_patches_that_correlate():
    patches = patch_grid(texture(1, 150, 130))
    correlation = np.zeros(len(patches.cell), np.float32)
    shift = np.ones((len(correlation), 2))
    correlation[:6] = 0.31  # (0.31 - 0.2)^2 > 0.01
    fitted = elastic.better_affine(patches, agreement_of(shift, correlation), IDENTITY)
    assert_allclose(fitted[:, 2], [-1, -1], atol=1e-6)
    correlation[5] = 0.29
    assert elastic.better_affine(patches, agreement_of(shift, correlation), IDENTITY) is IDENTITY


def test_bent_patches_are_compared_where_the_bend_takes_them():
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
    assert_array_equal(by_bend.used, by_map.used)
    assert np.median(np.abs(by_bend.correlation - by_map.correlation)) < 1e-3
    assert np.median(np.abs(by_bend.shift - by_map.shift)) < 0.01


def test_all_that_overlaps_is_correlated():
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


def test_a_bend_is_laid_where_its_patches_lie():
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
    assert_allclose(agreement.shift[inner, 0], expected[inner], atol=0.2)


def test_windows_of_odd_sides_are_searched_too():
    b = replace(texture(4, 150, 130), pitch_mm=0.096)
    patches = patch_grid(b)
    assert (patches.side, patches.reach) == (25, 4)
    a = replace(b, value=np.roll(b.value, (3, -2), axis=(0, 1)))
    agreement = compare_patches(patches, a, IDENTITY)
    inner = agreement.used[10:-10]
    assert_allclose(agreement.shift[inner], np.tile([2, -3], (len(inner), 1)), atol=0.05)
