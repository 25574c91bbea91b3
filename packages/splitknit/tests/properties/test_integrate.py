"""Integration: what must hold whatever the field."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelet_response, shapelets

quick = settings(max_examples=20, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
sides = st.integers(1, 40)


def blob(seed, shape):
    """A random mask of several parts, true somewhere."""
    rng = np.random.default_rng(seed)
    mask = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), 2.5) > -0.02
    mask[tuple(int(rng.integers(n)) for n in shape)] = True
    return mask


def waves(seed, rows=64, columns=80):
    """A surface of mirrored cosines, which all integrators take for periodic or free, and its y-up
    slopes."""
    rng = np.random.default_rng(seed)
    i, j = np.arange(rows)[:, None] + 0.5, np.arange(columns)[None] + 0.5
    height, slope_x, slope_y = np.zeros((3, rows, columns))
    for _ in range(4):
        k, m, a = rng.integers(0, 4), rng.integers(1, 4), rng.normal()
        u, v = np.pi * m / columns, np.pi * k / rows
        height += a * np.cos(u * j) * np.cos(v * i)
        slope_x -= a * u * np.sin(u * j) * np.cos(v * i)
        slope_y += a * v * np.cos(u * j) * np.sin(v * i)
    return height - height.mean(), slope_x, slope_y


@quick
@given(seeds, sides, sides)
def test_any_mask_gives_finite_heights_inside_and_nan_outside(seed, rows, columns):
    mask = blob(seed, (rows, columns))
    slope_x, slope_y = np.random.default_rng(seed).normal(size=(2, rows, columns))
    for height in (
        poisson(slope_x, slope_y, mask),
        frankot_chellappa(slope_x, slope_y, mask),
        shapelets(slope_x, slope_y, mask),
    ):
        assert np.array_equal(np.isfinite(height), mask)


@quick
@given(seeds)
def test_plane_is_recovered_on_any_mask(seed):
    mask = blob(seed, (33, 47))
    a, b = np.random.default_rng(seed).normal(size=2)
    height = poisson(np.full(mask.shape, a), np.full(mask.shape, b), mask)
    i, j = np.mgrid[0:33, 0:47]
    rest = height - (a * j - b * i)
    _, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=4)
    for part in np.unique(labels[mask]):
        assert np.ptp(rest[labels == part]) < 2e-3 * (1 + abs(a) + abs(b))


@quick
@given(seeds)
def test_integrators_agree_on_an_integrable_field(seed):
    height, slope_x, slope_y = waves(seed)
    scale = np.abs(height).max()
    assert (
        np.abs(frankot_chellappa(slope_x, slope_y, padding="mirror") - height).max() < 1e-3 * scale
    )
    bank = ShapeletSettings(scales=20, sigma_px=0.05)
    assert np.abs(shapelets(slope_x, slope_y, settings=bank) - height).max() < 0.03 * scale


@quick
@given(seeds, st.sampled_from([0.25, -1.0, 64.0]))
def test_heights_scale_with_gradients(seed, factor):
    mask = blob(seed, (30, 34))
    slope_x, slope_y = np.random.default_rng(seed).normal(size=(2, 30, 34))
    for integrate in (poisson, frankot_chellappa, shapelets):
        height = integrate(slope_x, slope_y, mask)
        scaled = integrate(factor * slope_x, factor * slope_y, mask)
        assert np.allclose(
            scaled[mask],
            factor * height[mask],
            atol=1e-4 * abs(factor) * (1 + np.nanmax(abs(height))),
        )


@quick
@given(seeds)
def test_turning_the_image_turns_the_heights(seed):
    """A quarter turn counter-clockwise takes (dz/dx, dz/dy) to (-dz/dy, dz/dx)."""
    mask = blob(seed, (31, 40))
    slope_x, slope_y = np.random.default_rng(seed).normal(size=(2, 31, 40))
    for integrate in (
        poisson,
        lambda p, q, m: frankot_chellappa(p, q, m, padding="mirror"),
        shapelets,
    ):
        height = integrate(slope_x, slope_y, mask)
        turned = integrate(-np.rot90(slope_y), np.rot90(slope_x), np.rot90(mask))
        assert np.allclose(turned, np.rot90(height), atol=2e-3, equal_nan=True)


@quick
@given(st.integers(4, 60), st.integers(1, 6), st.floats(0.6, 2.0), st.floats(1.4, 3.0))
def test_shapelet_gain_is_the_response(cycles, scales, sigma, factor):
    chosen = ShapeletSettings(scales=scales, sigma_px=sigma, factor=factor)
    omega = np.pi * cycles / 128
    j = np.arange(128) + 0.5
    slope = np.tile(-omega * np.sin(omega * j), (3, 1))
    height = shapelets(slope, np.zeros_like(slope), settings=chosen)
    expected = float(shapelet_response(omega, chosen)) * np.cos(omega * j)
    assert np.abs(height[1] - expected).max() < 2e-4
