"""The grids: Fourier transforms with margins, means inside a region, coarse and fine."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from splitknit.skin.grid import Grid, coarsen, refine, smooth_step

PITCH = 0.1


def grid_of(mask, cut=(False, False, False, False)):
    rows, columns = mask.shape
    x = (np.arange(columns) - (columns - 1) / 2) * PITCH
    y = ((rows - 1) / 2 - np.arange(rows)) * PITCH
    return Grid(mask, x, y, PITCH, cut)


def full(shape=(50, 63), **kwargs):
    return grid_of(np.ones(shape, dtype=np.bool_), **kwargs)


def noise(shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


@pytest.mark.parametrize("extend", [False, True])
def test_the_inverse_transform_restores_the_field(extend):
    grid = full(cut=(True, False, True, True))
    field = noise((2, 3, 50, 63))
    back = grid.inverse(grid.forward(field, extend))
    assert_allclose(back, field, atol=1e-5)
    assert back.dtype == np.float32
    assert grid.forward(field).dtype == np.complex64


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 50.0])
def test_frequencies_differentiate_with_y_up(turn_deg):
    grid = full((60, 70))
    ux, uy = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    radius2 = x * x + y * y
    bell = np.exp(-radius2 / 0.8).astype(np.float32)
    wx, wy, omega = grid.omega
    slope = grid.inverse(1j * (ux * wx + uy * wy) * grid.forward(bell))
    assert_allclose(slope, -2 * (ux * x + uy * y) / 0.8 * bell, atol=1e-3)
    assert_allclose(omega, np.sqrt(wx**2 + wy**2), rtol=1e-5)


@pytest.mark.parametrize("side", range(4))
def test_a_field_continues_beyond_a_cut_side_only(side):
    """A blur at the middle of each side: as if the finger went on there, and half dark
    elsewhere."""
    grid = full(cut=tuple(k == side for k in range(4)))
    gain = np.exp(-0.5 * (grid.omega[2] * 0.4) ** 2)
    ones = np.ones(grid.shape, dtype=np.float32)
    blurred = grid.inverse(gain * grid.forward(ones, extend=True))
    ends = [blurred[0, 31], blurred[-1, 31], blurred[25, 0], blurred[25, -1]]
    assert ends[side] == pytest.approx(1.0, abs=0.01)
    for k in {0, 1, 2, 3} - {side}:
        assert ends[k] == pytest.approx(0.55, abs=0.05)
    plain = grid.inverse(gain * grid.forward(ones))
    assert [plain[0, 31], plain[-1, 31], plain[25, 0], plain[25, -1]][side] == pytest.approx(
        0.55, abs=0.05
    )


def test_a_blur_does_not_wrap_around():
    grid = full()
    field = np.zeros(grid.shape, dtype=np.float32)
    field[:, 0] = field[0] = 1.0
    blurred = grid.inverse(np.exp(-0.5 * (grid.omega[2] * 0.5) ** 2) * grid.forward(field))
    assert np.abs(blurred[30:, 40:]).max() < 1e-3


def test_radial_gain_is_sampled_at_the_length_of_the_frequency():
    grid = full()
    omega = np.linspace(0, 50, 500)
    gain = grid.radial(omega, omega**2)
    assert_allclose(gain, grid.omega[2] ** 2, atol=0.01)
    assert gain.dtype == np.float32


@pytest.mark.parametrize("sigma_mm", [0.2, 0.9])  # at full size, and on a reduced copy
def test_the_mean_ignores_values_outside_the_mask(sigma_mm):
    mask = np.zeros((80, 90), dtype=np.bool_)
    mask[15:70, 20:81] = True
    grid = grid_of(mask)
    field = np.where(mask, np.float32(3.0), np.float32(np.nan))
    mean = grid.smooth(field, mask, sigma_mm)
    assert_allclose(mean[mask], 3.0, rtol=1e-4)
    spoilt = np.where(mask, noise(mask.shape), np.float32(1e6))
    assert_array_equal(
        grid.smooth(spoilt, mask, sigma_mm)[mask],
        grid.smooth(np.where(mask, spoilt, 0), mask, sigma_mm)[mask],
    )


@pytest.mark.parametrize("sigma_mm", [0.2, 0.9])
def test_the_mean_has_the_stated_sigma(sigma_mm):
    grid = full((120, 130))
    x, _ = np.meshgrid(grid.x_mm, grid.y_mm)
    wave = np.cos(x / sigma_mm).astype(np.float32)
    mean = grid.smooth(wave, grid.mask, sigma_mm)
    inner = np.s_[40:-40, 40:-40]
    gain = (mean * wave)[inner].sum() / (wave * wave)[inner].sum()
    assert gain == pytest.approx(np.exp(-0.5), rel=0.08)


def test_depth_is_the_distance_from_the_outline():
    mask = np.zeros((41, 61), dtype=np.bool_)
    mask[5:36, 5:56] = True
    depth = grid_of(mask).depth_mm
    assert depth[20, 30] == pytest.approx(16 * PITCH, rel=0.03)
    assert depth[5, 30] == pytest.approx(PITCH, rel=0.1)
    assert not depth[~mask].any()


def test_coarse_blocks_lie_wholly_inside_the_mask():
    mask = np.zeros((62, 71), dtype=np.bool_)
    mask[3:50, 4:60] = True
    mask[55:57, 65:67] = True  # a speck
    grid = grid_of(mask, cut=(False, True, False, False))
    low = coarsen(grid, 4)
    assert low.shape == (15, 17)
    assert low.pitch_mm == pytest.approx(4 * PITCH)
    assert low.cut == grid.cut
    assert low.mask.any()
    large = np.kron(low.mask, np.ones((4, 4), dtype=np.bool_))
    assert mask[: large.shape[0], : large.shape[1]][large].all()
    assert_array_equal(np.flatnonzero(low.mask[5]), np.arange(1, 15))
    assert_allclose(low.x_mm[:2], [grid.x_mm[:4].mean(), grid.x_mm[4:8].mean()])
    assert_allclose(low.y_mm[:2], [grid.y_mm[:4].mean(), grid.y_mm[4:8].mean()])


def test_the_coarse_mask_keeps_the_largest_part_only():
    mask = np.zeros((64, 64), dtype=np.bool_)
    mask[2:18, 2:18] = True
    mask[28:60, 20:60] = True
    low = coarsen(grid_of(mask), 4)
    assert not low.mask[:6].any()
    assert low.mask[7:15].any()


def test_a_refined_field_interpolates_inside_and_continues_outside():
    factor = 4
    rows, columns = np.mgrid[:20, :24]
    mask = np.hypot(rows - 10, columns - 12) < 8
    field = np.where(mask, 0.3 * columns - 0.1 * rows, np.nan).astype(np.float32)
    large = refine(field, mask, factor, (83, 99))
    assert large.shape == (83, 99)
    assert np.isfinite(large).all()
    r, c = np.mgrid[:83, :99]
    truth = 0.3 * ((c + 0.5) / factor - 0.5) - 0.1 * ((r + 0.5) / factor - 0.5)
    inner = np.hypot(r - 41.5, c - 49.5) < 24
    assert_allclose(large[inner], truth[inner], atol=0.02)
    assert large.max() <= field[mask].max() + 0.1


def test_the_smooth_step_is_cubic_and_clamped():
    step = smooth_step(np.array([-1, 0, 0.25, 0.5, 1, 2], dtype=np.float32))
    assert_allclose(step, [0, 0, 0.15625, 0.5, 1, 1])
