"""Shapelets: the transfer function against explicit correlations."""

import numpy as np
import pytest
import scipy.signal

from refusals import bad_input
from splitknit.integration.shapelets import ShapeletSettings, shapelet_response, shapelets


def ridged_bump(size=96):
    i, j = np.mgrid[0:size, 0:size].astype(float)
    x, y = j - size / 2, size / 2 - i
    envelope = np.exp(-(x**2 + y**2) / (2 * 10**2))
    wave = 2 * np.pi / 12
    height = 3 * envelope * np.cos(wave * x + 0.3 * wave * y)
    ripple = 3 * envelope * np.sin(wave * x + 0.3 * wave * y)
    slope_x = -x / 100 * height - wave * ripple
    slope_y = -y / 100 * height - 0.3 * wave * ripple
    return height, slope_x, slope_y


def explicit(slope_x, slope_y, settings):
    """Scale by scale, correlation with sampled slant and tilt fields of Gaussians, as the equations
    read."""
    total = np.zeros(slope_x.shape)
    reach = int(np.ceil(6 * settings.sigmas_px[-1]))
    x, y = np.meshgrid(np.arange(-reach, reach + 1), np.arange(reach, -reach - 1, -1))
    for sigma in settings.sigmas_px:
        bump = np.exp(-(x**2 + y**2) / (2 * sigma**2))
        kernel_x, kernel_y = -x / sigma**2 * bump, -y / sigma**2 * bump
        for slope, kernel in ((slope_x, kernel_x), (slope_y, kernel_y)):
            total += scipy.signal.correlate(slope, kernel, mode="same", method="fft")
    total /= 4 * np.pi / np.log(settings.factor**2)
    return total - total.mean()


@pytest.mark.parametrize(("scales", "sigma", "factor"), [(3, 1.5, 2.0), (2, 2.0, 1.5)])
def test_equals_the_explicit_correlations(scales, sigma, factor):
    _, slope_x, slope_y = ridged_bump()
    settings = ShapeletSettings(scales, sigma, factor)
    got, expected = (
        shapelets(slope_x, slope_y, settings=settings),
        explicit(slope_x, slope_y, settings),
    )
    assert np.abs(got - expected).max() < 2e-3 * np.abs(expected).max()


def test_pass_band_has_unit_gain():
    settings = ShapeletSettings(scales=12)
    gain = shapelet_response(np.geomspace(0.002, 0.12, 200), settings)
    assert np.abs(gain - 1).max() < 0.015
    assert abs(gain.mean() - 1) < 0.003
    assert shapelet_response(0, settings) == 0
    third = ShapeletSettings(scales=12, factor=3.0)
    assert np.abs(shapelet_response(np.geomspace(1e-3, 0.1, 99), third) - 1).max() < 0.12


def test_response_of_the_thesis_at_the_ridges():
    """Three scales pass 33 px ridges with a gain well below one (reading note 8), four with
    more."""
    omega = 2 * np.pi / 33
    assert 0.3 < shapelet_response(omega) < 0.75
    assert shapelet_response(omega, ShapeletSettings(scales=4)) > shapelet_response(omega)


@pytest.mark.parametrize(
    "field", [{"scales": 0}, {"sigma_px": 0}, {"factor": 1.0}, {"sigma_px": np.nan}]
)
def test_bad_settings_are_refused(field):
    with bad_input("shapelets"):
        ShapeletSettings(**field)
