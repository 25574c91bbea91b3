"""What ridges do to the mean normal and the glare: brute-force means over fine ridged surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.imaging.geometry import normals_from_gradients
from splitknit.skin.colour import SpectralFit, cross_spectra, fit_spectra
from splitknit.skin.facets import (
    MOST_SPREAD,
    Facets,
    _each_facet,
    _ridge_power,
    at,
    facet_normals,
    mean_glare,
    measure_facets,
    ridged_normals,
    spread_of,
)
from splitknit.skin.glare import microfacet_glare
from splitknit.skin.grid import Grid, coarsen

PITCH = 0.04


def facets_of(slopes, shape=(1, 1), across_deg=0.0):
    a = np.deg2rad(across_deg)
    ones = np.ones(shape, dtype=np.float32)
    return Facets(np.asarray(slopes, dtype=np.float64), np.float32(np.cos(a)) * ones, np.float32(np.sin(a)) * ones)


def slope_field(x, y, shape=(1, 1)):
    return np.full(shape, x, dtype=np.float32), np.full(shape, y, dtype=np.float32)


def brute_force(tilt_x, tilt_y, across_deg, slopes):
    """Mean unit normal that a camera along z sees of facets on a plane, from their areas and normals in double.

    The surface is built from strips: on a plane with normal n, ridges run along t (whose picture is perpendicular to
    `across`) and lean by `slopes` about t against the plane.
    """
    n = np.array([-tilt_x, -tilt_y, 1.0])
    n /= np.linalg.norm(n)
    a = np.deg2rad(across_deg)
    picture = np.array([-np.sin(a), np.cos(a)])
    t = np.array([*picture, -(n[:2] @ picture) / n[2]])
    t /= np.linalg.norm(t)
    b = np.cross(n, t)
    total, seen = np.zeros(3), 0.0
    for s in slopes:
        # a strip of unit length along t, of unit width on the plane across: its edge vector climbs by s
        area = np.cross(b + s * n, t)
        area *= np.sign(area @ n)
        visible = max(area[2], 0.0)
        total += visible * area / np.linalg.norm(area)
        seen += visible
    return total / seen


def test_without_slopes_the_normals_are_the_shapes():
    x, y = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1.5, 1, 4))
    x, y = x.astype(np.float32), y.astype(np.float32)
    found = facet_normals(x, y, facets_of(np.zeros(6), x.shape, 30.0))
    np.testing.assert_allclose(found, normals_from_gradients(x, y), atol=1e-6)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.8, 0.0), (0.5, -1.2), (2.5, 0.5)])
@pytest.mark.parametrize("across_deg", [0.0, 65.0, 160.0])
def test_mean_normal_is_that_of_strips_of_surface(tilt, across_deg):
    slopes = [-0.9, -0.5, -0.1, 0.1, 0.5, 0.9, 0.3]
    found = facet_normals(*slope_field(*tilt), facets_of(slopes, across_deg=across_deg))[0, 0]
    np.testing.assert_allclose(found, brute_force(*tilt, across_deg, slopes), atol=2e-6)


@pytest.mark.parametrize("tilt", [0.3, 1.0])
def test_mean_normal_is_that_of_a_fine_ridged_height_field(tilt):
    """Small waves on a slope, height above the picture plane: every pixel of the camera counts alike."""
    position = np.arange(4000) / 4000
    for across_deg in (0.0, 90.0):
        swing = 0.25 * np.cos(2 * np.pi * position)  # slopes of the relief against the sloping shape's normal
        angle = np.arctan(tilt * (across_deg == 0.0))
        # rotate the slope of each facet by the shape's slope, along and across the ridge
        leaning = np.tan(angle + np.arctan(swing)) if across_deg == 0.0 else None
        if leaning is not None:
            # each facet covers cos(total) / cos(own) of the picture for its fraction of the shape
            fraction = np.cos(angle + np.arctan(swing)) / np.cos(np.arctan(swing))
            normal = np.stack([-leaning, 0 * leaning, np.ones_like(leaning)])
        else:
            length = np.sqrt(1 + tilt**2)  # dz along x is the tilt, the ridges climb along y
            normal = np.stack([-tilt * np.ones_like(swing), -swing * length, np.ones_like(swing)])
            fraction = np.ones_like(swing)
        normal /= np.linalg.norm(normal, axis=0)
        expected = (normal * fraction).sum(axis=1) / fraction.sum()
        found = facet_normals(*slope_field(tilt, 0.0), facets_of(swing[::40], across_deg=across_deg))[0, 0]
        np.testing.assert_allclose(found, expected, atol=2e-3)


def test_symmetrical_ridges_flatten_a_slope_across_them_and_shorten_the_normal():
    x, y = slope_field(0.9, 0.0)
    facets = facets_of([-1.2, -0.4, 0.4, 1.2])
    found = facet_normals(x, y, facets)[0, 0]
    assert np.linalg.norm(found) < 0.93
    assert 0 < -found[0] / found[2] < 0.75
    level = facet_normals(*slope_field(0.0, 0.0), facets)[0, 0]
    np.testing.assert_allclose(level[:2], 0, atol=1e-6)


def test_facets_that_turn_away_are_not_seen():
    normals = normals_from_gradients(*slope_field(2.0, 0.0))
    seen = [float(weight[0, 0]) for _, weight in _each_facet(normals, facets_of([-2.0, -0.2, 0.2, 2.0]))]
    assert sorted(seen)[0] == 0.0
    assert sorted(seen)[1] > 0
    for normal, _ in _each_facet(normals, facets_of([-2.0, 0.2])):
        np.testing.assert_allclose((normal**2).sum(axis=-1), 1.0, atol=1e-5)
    assert len(list(_each_facet(normals, facets_of(range(12)), step=2))) == 6


def test_direction_of_the_ridges_has_no_sign():
    tilt, slopes = slope_field(0.6, -0.3), [-0.5, 0.1, 0.5, -0.1]
    one, other = (facet_normals(*tilt, facets_of(slopes, across_deg=a)) for a in (40.0, 220.0))
    np.testing.assert_allclose(one, other, atol=1e-6)


def lamps(tilts_deg):
    t = np.deg2rad(np.asarray(tilts_deg, dtype=np.float32))
    return np.stack([np.sin(t), 0 * t, np.cos(t)], axis=1).astype(np.float32)[:, :, None, None]


def test_glare_without_facets_is_the_shapes_and_level_ridges_change_nothing():
    normals = normals_from_gradients(*slope_field(0.2, 0.1))
    lights = lamps([0.0, 20.0, 50.0])
    plain = microfacet_glare(normals, lights, 0.2)
    np.testing.assert_array_equal(mean_glare(normals, None, lights, 0.2), plain)
    np.testing.assert_allclose(mean_glare(normals, facets_of(np.zeros(12)), lights, 0.2), plain, rtol=1e-4)


def test_ridges_spread_a_highlight_across_them_not_along():
    normals = normals_from_gradients(*slope_field(0.0, 0.0))
    lights = lamps([0.0, 30.0])  # leaning along x
    plain = microfacet_glare(normals, lights, 0.1)[:, 0, 0]
    slopes = np.linspace(-0.6, 0.6, 12)
    across = mean_glare(normals, facets_of(slopes, across_deg=0.0), lights, 0.1)[:, 0, 0]
    along = mean_glare(normals, facets_of(slopes, across_deg=90.0), lights, 0.1)[:, 0, 0]
    assert across[0] < 0.6 * plain[0]
    assert across[1] > 2 * plain[1]
    assert along[1] < 1.5 * plain[1]


def test_facets_of_a_region():
    facets = Facets(np.zeros(2), *np.random.default_rng(0).random((2, 4, 5)).astype(np.float32))
    region = np.zeros((4, 5), dtype=np.bool_)
    region[1, 2] = region[3, 4] = True
    part = at(facets, region)
    np.testing.assert_array_equal(part.across_x, [[facets.across_x[1, 2], facets.across_x[3, 4]]])
    np.testing.assert_array_equal(part.across_y, [[facets.across_y[1, 2], facets.across_y[3, 4]]])
    assert at(None, region) is None


def ridges(across_deg, depth=0.06, period=0.48, shape=(160, 180)):
    mask = np.ones(shape, dtype=np.bool_)
    x = (np.arange(shape[1]) - (shape[1] - 1) / 2) * PITCH
    y = ((shape[0] - 1) / 2 - np.arange(shape[0])) * PITCH
    a = np.deg2rad(across_deg)
    k = 2 * np.pi / period
    relief = depth / 2 * np.cos(k * (np.cos(a) * x[None, :] + np.sin(a) * y[:, None]))
    return Grid(mask, x, y, PITCH, (False,) * 4), relief.astype(np.float32)


def spectrum_of(grid, relief, region):
    wx, wy, _ = grid.omega
    spectrum = grid.forward(relief * region)
    slopes = [(grid.inverse(1j * wx * spectrum), grid.inverse(1j * wy * spectrum))]
    centres, along, across = cross_spectra(slopes, np.ones_like(region) * region, grid.pitch_mm)
    return fit_spectra(centres, along, 0 * across, np.ones((1, len(centres))), np.ones(1))


@pytest.mark.parametrize("across_deg", [0.0, 60.0, 110.0])
def test_slopes_and_direction_are_those_of_the_relief(across_deg):
    grid, relief = ridges(across_deg)
    low = coarsen(grid, 3)
    nothing = SpectralFit(np.array([9.0, 12.0]), np.zeros(2), np.zeros(2), np.ones(1))
    inner = np.ones(grid.shape, dtype=np.float32)
    zero = measure_facets(relief, np.zeros_like(relief), grid, low, 3, spread_of(relief, grid, nothing, inner))
    assert not zero.slopes.any()  # a spectrum without ridges has no facets
    true_mean_square = (0.03 * 2 * np.pi / 0.48) ** 2 / 2
    powers = SpectralFit(np.geomspace(5, 70, 30), np.zeros(30), np.zeros(30), np.ones(1))
    powers.signal[:] = true_mean_square / _ridge_power(
        SpectralFit(powers.omega_per_mm, np.ones(30), np.zeros(30), np.ones(1)), PITCH
    )
    facets = measure_facets(relief, np.zeros_like(relief), grid, low, 3, spread_of(relief, grid, powers, inner))
    assert np.sqrt((facets.slopes**2).mean()) == pytest.approx(np.sqrt(true_mean_square), rel=0.08)
    assert facets.slopes.max() == pytest.approx(0.03 * 2 * np.pi / 0.48, rel=0.08)
    assert (np.diff(facets.slopes) >= 0).all()
    a = np.deg2rad(across_deg)
    along = np.abs(facets.across_x * np.cos(a) + facets.across_y * np.sin(a))
    assert facets.across_x.shape == low.shape
    assert along[5:-5, 5:-5].min() > 0.99


def test_slopes_are_those_against_the_sloping_surface():
    """The relief is measured along the line of sight: on a slope across the ridges its facets lean less."""
    grid, relief = ridges(0.0)
    low = coarsen(grid, 3)
    powers = SpectralFit(np.geomspace(5, 70, 30), np.full(30, 1.0), np.zeros(30), np.ones(1))
    tilt = 0.45
    inner = np.ones(grid.shape, dtype=np.float32)
    level = measure_facets(relief, 0 * relief, grid, low, 3, spread_of(relief, grid, powers, inner))
    plane = (tilt * grid.x_mm[None, :] * np.ones((grid.shape[0], 1))).astype(np.float32)
    sloping = measure_facets(relief, plane, grid, low, 3, spread_of(relief, grid, powers, inner))
    assert sloping.slopes.std() == pytest.approx(level.slopes.std() / (1 + tilt**2), rel=1e-3)
    along = measure_facets(
        relief,
        (tilt * grid.y_mm[:, None] * np.ones((1, grid.shape[1]))).astype(np.float32),
        grid,
        low,
        3,
        spread_of(relief, grid, powers, inner),
    )
    assert along.slopes.std() == pytest.approx(level.slopes.std() / np.sqrt(1 + tilt**2), rel=1e-3)


def test_power_of_the_ridges_is_their_mean_square_slope():
    grid, relief = ridges(30.0)
    window = np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) for n in grid.shape)).astype(np.float32)
    x, y = (g / np.float32(PITCH) for g in (np.gradient(relief, axis=1), -np.gradient(relief, axis=0)))
    centres, along, across = cross_spectra([(x, y)], window, PITCH)
    fit = fit_spectra(centres, along, 0 * across, np.ones((1, len(centres))), np.ones(1))
    assert _ridge_power(fit, PITCH) == pytest.approx(float((x * x + y * y).mean()), rel=0.1)


def test_resolved_normals_count_in_the_middle_and_facets_at_the_side():
    grid, _ = ridges(0.0)
    low = coarsen(grid, 3)
    shape = (-0.35 * low.x_mm[None, :] ** 2 * np.ones((low.shape[0], 1))).astype(np.float32)
    resolved = np.zeros((*low.shape, 3), dtype=np.float32)
    resolved[..., 2] = 0.9
    facets = facets_of([-0.8, -0.3, 0.3, 0.8], low.shape)
    assert ridged_normals(resolved, shape, low, None) is resolved
    found = ridged_normals(resolved, shape, low, facets)
    slant = np.rad2deg(np.arctan(np.abs(0.7 * low.x_mm)))
    row = low.shape[0] // 2
    middle = low.mask[row] & (slant < 14)
    side = low.mask[row] & (slant > 32)
    assert middle.any()
    assert side.any()
    np.testing.assert_array_equal(found[row, middle], resolved[row, middle])
    slope = (-0.7 * low.x_mm * np.ones((low.shape[0], 1))).astype(np.float32)
    expected = facet_normals(slope, 0 * slope, facets)
    edge = slice(1, -1)
    np.testing.assert_allclose(found[row, edge][side[edge]], expected[row, edge][side[edge]], atol=0.01)
    assert not found[~low.mask].any()


def test_spread_multiplies_the_slopes_and_is_limited():
    grid, relief = ridges(0.0)
    low = coarsen(grid, 3)
    plain = measure_facets(relief, 0 * relief, grid, low, 3)
    wider = measure_facets(relief, 0 * relief, grid, low, 3, 1.2)
    np.testing.assert_allclose(wider.slopes, 1.2 * plain.slopes)
    much = SpectralFit(np.geomspace(5, 70, 30), np.full(30, 1e6), np.zeros(30), np.ones(1))
    assert spread_of(relief, grid, much, np.ones(grid.shape, np.float32)) == MOST_SPREAD
