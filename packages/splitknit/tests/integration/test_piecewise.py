"""Integration that keeps steps: exact on planes, close on spheres, one side does not pull the
other."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit.integration.poisson import piecewise, poisson


def rms_error(height, truth):
    return float(np.std(height - truth))


@pytest.mark.parametrize("mask", [None, np.hypot(*(np.mgrid[0:40, 0:60] - 20)) < 18])
def test_a_plane_is_exact(mask):
    i, j = np.mgrid[0:40, 0:60]
    height = piecewise(np.full((40, 60), 0.5), np.full((40, 60), -0.25), mask)
    error = height - (0.5 * j + 0.25 * i)
    assert np.nanmax(error) - np.nanmin(error) < 1e-3


@pytest.mark.parametrize("noise_deg", [0, 1, 5])
def test_a_smooth_surface_is_that_of_least_squares(noise_deg):
    i, j = np.mgrid[0:80, 0:80] - 39.5
    mask = np.hypot(i, j) < 36
    dome = np.sqrt(45**2 - np.minimum(i**2 + j**2, 40**2))
    noise = np.random.default_rng(1).normal(size=(2, 80, 80)) * np.deg2rad(noise_deg)
    slopes = (-j / dome + noise[0], i / dome + noise[1])
    errors = [
        float(np.std((integrate(*slopes, mask) - dome)[mask])) for integrate in (piecewise, poisson)
    ]
    assert errors[0] < 1.25 * errors[1] + 0.02


@pytest.mark.parametrize("noise_deg", [0, 2])
def test_a_step_that_ends_does_not_pull(noise_deg):
    """Two plates, joined above, part along a line below, which is shorter than their width."""
    i, j = np.mgrid[0:80, 0:160].astype(float)
    truth = np.where(j >= 80, 10 * np.clip((i - 50) / 15, 0, 1), 0.0)
    noise = np.random.default_rng(2).normal(size=(2, 80, 160)) * np.deg2rad(noise_deg)
    slope_y = np.where((j >= 80) & (i > 50) & (i < 65), -10 / 15, 0.0)
    slopes = (noise[0], slope_y + noise[1])
    assert rms_error(piecewise(*slopes), truth) < 0.3 * rms_error(poisson(*slopes), truth)


def test_nan_inside_the_mask_is_refused():
    with bad_input("inside the mask"):
        piecewise(np.full((4, 4), np.nan), np.zeros((4, 4)))


def test_pixels_without_neighbours_have_height_zero():
    mask = np.zeros((5, 5), dtype=bool)
    mask[1, 1] = mask[3, 3] = True
    height = piecewise(np.ones((5, 5)), np.ones((5, 5)), mask)
    assert (height[mask] == 0).all()
    assert np.isnan(height[~mask]).all()
