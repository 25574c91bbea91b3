"""Frankot-Chellappa: true scale, both rectangles."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit.integration.frankot_chellappa import frankot_chellappa


def bump(rows=96, columns=128, sigma=9.0):
    i, j = np.mgrid[0:rows, 0:columns].astype(float)
    x, y = j - columns / 2, rows / 2 - i
    height = 8 * np.exp(-(x**2 + y**2) / (2 * sigma**2))
    return height, -x / sigma**2 * height, -y / sigma**2 * height


@pytest.mark.parametrize("shape", [(96, 128), (97, 131)])
@pytest.mark.parametrize("padding", ["zero", "mirror"])
def test_a_bump_inside_the_rectangle_has_its_true_height(padding, shape):
    height, slope_x, slope_y = bump(*shape)
    got = frankot_chellappa(slope_x, slope_y, padding=padding)
    assert np.abs(got - (height - height.mean())).max() < 1e-3


def test_zero_filling_bends_a_surface_that_ends_steeply():
    """What the thesis's method does, and why the masked solver is the default."""
    i, j = np.mgrid[0:64, 0:64].astype(float)
    mask = np.hypot(i - 32, j - 32) < 20
    ramp = frankot_chellappa(np.ones((64, 64)), np.zeros((64, 64)), mask)
    assert np.isnan(ramp[~mask]).all()
    assert abs(ramp[mask].mean()) < 1e-4
    assert 0.3 < (ramp[32, 45] - ramp[32, 19]) / 26 < 0.8


@pytest.mark.parametrize("axis", [0, 1])
def test_slopes_that_alternate_from_pixel_to_pixel_have_no_height(axis):
    """A sine of the highest frequency is zero at every sample, so no surface has these slopes."""
    slopes, places = np.zeros((2, 16, 16)), np.indices((16, 16))
    slopes[1 - axis] = (-1.0) ** places[axis] * np.cos(np.pi / 4 * places[1 - axis])
    assert np.abs(frankot_chellappa(*slopes)).max() < 1e-6


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (1, 1), (2, 3)])
@pytest.mark.parametrize("padding", ["zero", "mirror"])
def test_tiny_images_do_not_fail(shape, padding):
    assert np.isfinite(frankot_chellappa(np.ones(shape), np.ones(shape), padding=padding)).all()


def test_unknown_padding_is_refused():
    with bad_input("padding"):
        frankot_chellappa(np.zeros((4, 4)), np.zeros((4, 4)), padding="wrap")
