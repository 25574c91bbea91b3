"""Curvatures of bodies that are known, edges, cameras."""

import numpy as np
import pytest

from bodies import PX_PER_MM, plane_points
from refusals import bad_input
from splitknit_match.prints.curvature import curvature, window_side

PITCH = 1 / PX_PER_MM
WIDE = 15.0 * 75.7 / PX_PER_MM / 2


def test_the_window_scales_with_the_resolution():
    assert [window_side(px_per_mm) for px_per_mm in (75.7, 37.85, 10.0)] == [15, 7, 5]


def test_a_quadric_is_exact_even_at_the_mask():
    """At its middle the curvatures are the coefficients, also by windows that the mask cuts."""
    x, y = plane_points((61, 61))
    angle = 0.5
    p, q = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    height = (0.5 * (0.3 * p**2 - 0.1 * q**2)).astype(np.float32)
    mask = np.ones((61, 61), bool)
    mask[:, 33:] = False  # the middle lies two pixels from the edge
    curvatures = curvature(height, mask, PITCH, window_px=9 * 75.7 / PX_PER_MM)
    assert curvatures.k_max[30, 30] == pytest.approx(0.3, abs=6e-3)
    assert curvatures.k_min[30, 30] == pytest.approx(-0.1, abs=6e-3)
    assert curvatures.k_max[30, 20] == pytest.approx(0.3, rel=0.05)
    assert np.isnan(curvatures.k_max[:, 33:]).all()


def test_a_cylinder_is_as_curved_at_its_side():
    """The Weingarten matrix, not the second derivative: at 55 deg of slant that is five times too
    large."""
    x, _ = plane_points((40, 260))
    height = np.sqrt(np.maximum(64.0 - x**2, 0.01)).astype(np.float32)
    mask = np.abs(x) < 8 * np.sin(np.deg2rad(60))
    curvatures = curvature(height, mask, PITCH, window_px=WIDE)
    inner = np.abs(x) < 8 * np.sin(np.deg2rad(55))
    inner[:8] = inner[-8:] = False
    assert np.allclose(curvatures.k_min[inner], -1 / 8, rtol=0.03)
    assert np.abs(curvatures.k_max[inner]).max() < 0.003
    assert np.allclose(curvatures.shape_index[inner], 0.75, atol=0.02)


def test_shape_index_names_the_forms():
    x, y = plane_points((41, 41))
    forms = {
        "cap": -(x**2) - y**2,
        "ridge": -(x**2),
        "saddle": x**2 - y**2,
        "valley": x**2,
        "cup": x**2 + y**2,
    }
    for (name, form), wanted in zip(forms.items(), (1.0, 0.75, 0.5, 0.25, 0.0), strict=True):
        height = (0.1 * form).astype(np.float32)
        curvatures = curvature(height, np.ones((41, 41), bool), PITCH, window_px=WIDE)
        assert curvatures.shape_index[20, 20] == pytest.approx(wanted, abs=0.01), name


def test_curvature_does_not_depend_on_the_camera():
    """A ball seen from 40 mm: every point has its curvature, as its x and y are used."""
    x, y = plane_points((200, 200))
    z = np.zeros_like(x)
    for _ in range(60):
        nearer = 1 - z / 40
        z = np.sqrt(np.maximum(64.0 - (x * nearer) ** 2 - (y * nearer) ** 2, 0.01)) - 8.0
    nearer = 1 - z / 40
    mask = np.hypot(x, y) < 5
    places = ((x * nearer).astype(np.float32), (y * nearer).astype(np.float32))
    curvatures = curvature(z.astype(np.float32), mask, PITCH, places, window_px=WIDE)
    inner = np.hypot(x, y) < 4
    assert np.allclose(curvatures.k_max[inner], -1 / 8, rtol=0.03)
    assert np.allclose(curvatures.k_min[inner], -1 / 8, rtol=0.03)
    plain = curvature(z.astype(np.float32), mask, PITCH, window_px=WIDE)
    assert np.abs(plain.k_min[inner] + 1 / 8).max() > 0.02


def test_a_cubic_is_noisier_only_where_the_mask_cuts_its_window():
    rng = np.random.default_rng(2)
    x, _ = plane_points((80, 80))
    ridges = 0.02 * np.cos(2 * np.pi * x / 1.5)
    mask = np.ones((80, 80), bool)
    mask[:, 41:] = False
    noisy = (ridges + 1e-3 * rng.standard_normal((80, 80))).astype(np.float32)
    two, three = (
        curvature(noisy, mask, PITCH, window_px=9 * 75.7 / PX_PER_MM, degree=d).k_min
        for d in (2, 3)
    )
    full = slice(10, -10), slice(10, 36)
    assert np.corrcoef(two[full].ravel(), three[full].ravel())[0, 1] > 0.999
    edge = slice(10, -10), slice(38, 39)
    assert np.nanstd(three[edge]) > np.nanstd(two[edge])


def test_an_empty_mask_is_refused():
    with bad_input("mask is empty"):
        curvature(np.zeros((20, 20), np.float32), np.zeros((20, 20), bool), 0.1)
