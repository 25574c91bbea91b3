"""Shapelets: the transfer function against explicit correlations, and what the poorer variants can still tell."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from splitknit.errors import BadInput
from splitknit.integration.shapelets import ShapeletSettings, shapelet_response, shapelets

VARIANTS = ("slant_tilt", "ambiguous_tilt", "slant_only", "tilt_only")


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
    """Scale by scale, correlation with sampled slant and tilt fields of Gaussians, as the equations read."""
    steepness, tilt = np.hypot(slope_x, slope_y), np.arctan2(slope_y, slope_x)
    total = np.zeros(slope_x.shape)
    reach = int(np.ceil(6 * settings.sigmas_px[-1]))
    x, y = np.meshgrid(np.arange(-reach, reach + 1), np.arange(reach, -reach - 1, -1))
    for sigma in settings.sigmas_px:
        bump = np.exp(-(x**2 + y**2) / (2 * sigma**2))
        kernel_x, kernel_y = -x / sigma**2 * bump, -y / sigma**2 * bump
        kernel, kernel_tilt = np.hypot(kernel_x, kernel_y), np.arctan2(kernel_y, kernel_x)

        def correlate(field, kernel):
            return scipy.signal.correlate(field, kernel, mode="same", method="fft")

        if settings.variant == "slant_tilt":
            total += correlate(slope_x, kernel_x) + correlate(slope_y, kernel_y)
        elif settings.variant == "ambiguous_tilt":
            total += correlate(steepness * np.cos(2 * tilt), kernel * np.cos(2 * kernel_tilt)) / 2
            total += correlate(steepness * np.sin(2 * tilt), kernel * np.sin(2 * kernel_tilt)) / 2
            total += correlate(steepness, kernel) / 2
        elif settings.variant == "slant_only":
            total += correlate(steepness, kernel)
        else:
            near = (np.hypot(x, y) <= 3 * sigma) & (np.hypot(x, y) > 0)
            flat = steepness == 0
            total += correlate(np.where(flat, 0, np.cos(tilt)), near * np.cos(kernel_tilt))
            total += correlate(np.where(flat, 0, np.sin(tilt)), near * np.sin(kernel_tilt))
    total /= 4 * np.pi / np.log(settings.factor**2)
    return total - total.mean()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("scales", "sigma", "factor"), [(3, 1.5, 2.0), (2, 2.0, 1.5)])
def test_equals_the_explicit_correlations(variant, scales, sigma, factor):
    _, slope_x, slope_y = ridged_bump()
    settings = ShapeletSettings(scales, sigma, factor, variant, padding="zero")
    got, expected = shapelets(slope_x, slope_y, settings=settings), explicit(slope_x, slope_y, settings)
    assert np.abs(got - expected).max() < 2e-3 * np.abs(expected).max()


@pytest.mark.parametrize("padding", ["zero", "mirror"])
@pytest.mark.parametrize("scales", [3, 4, 6])
def test_gain_on_a_sinusoid_is_the_response(scales, padding):
    settings = ShapeletSettings(scales=scales, padding=padding)
    j = np.arange(512)
    omega = np.pi * 32 / 512
    slope = np.tile(-omega * np.sin(omega * (j + 0.5)), (4 if padding == "mirror" else 512, 1))
    got = shapelets(slope, np.zeros_like(slope), settings=settings)
    middle = got[got.shape[0] // 2, 128:384]
    amplitude = 2 * np.mean(middle * np.cos(omega * (j[128:384] + 0.5)))
    assert amplitude == pytest.approx(float(shapelet_response(omega, settings)), abs=3e-3)


def test_pass_band_has_unit_gain():
    settings = ShapeletSettings(scales=12)
    gain = shapelet_response(np.geomspace(0.002, 0.12, 200), settings)
    assert np.abs(gain - 1).max() < 0.015
    assert abs(gain.mean() - 1) < 0.003
    assert shapelet_response(0.0, settings) == 0
    third = ShapeletSettings(scales=12, factor=3.0)
    assert np.abs(shapelet_response(np.geomspace(1e-3, 0.1, 99), third) - 1).max() < 0.12


def test_response_of_the_thesis_at_the_ridges():
    """Three scales pass 33 px ridges with a gain well below one (reading note 8), four with more."""
    omega = 2 * np.pi / 33
    assert 0.3 < shapelet_response(omega) < 0.75
    assert shapelet_response(omega, ShapeletSettings(scales=4)) > shapelet_response(omega)


def test_extra_gain_multiplies_the_spectrum():
    _, slope_x, slope_y = ridged_bump()
    settings = ShapeletSettings(scales=4)
    plain = shapelets(slope_x, slope_y, settings=settings)
    assert np.allclose(shapelets(slope_x, slope_y, settings=settings, gain=lambda w: 2 + 0 * w), 2 * plain, atol=1e-5)

    def low_pass(omega):
        return np.exp(-((4 * omega) ** 2))

    smooth = shapelets(slope_x, slope_y, settings=settings, gain=low_pass)
    assert np.std(smooth) < 0.5 * np.std(plain)
    for variant in VARIANTS[1:]:
        other = ShapeletSettings(scales=4, variant=variant)
        plain = shapelets(slope_x, slope_y, settings=other)
        doubled = shapelets(slope_x, slope_y, settings=other, gain=lambda w: 2 + 0 * w)
        assert np.allclose(doubled, 2 * plain, atol=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
def test_nothing_wraps_around(variant):
    """A slope at the left border leaves the right border flat."""
    slope = np.zeros((100, 125))
    slope[40:60, :5] = 1
    got = shapelets(slope, slope, settings=ShapeletSettings(scales=3, variant=variant, padding="zero"))
    assert np.ptp(got[:, 60:]) < 2e-3 * np.ptp(got[:, :20])
    turned = shapelets(slope.T, slope.T, settings=ShapeletSettings(scales=3, variant=variant, padding="zero"))
    assert np.ptp(turned[60:]) < 2e-3 * np.ptp(turned[:20])


def test_bad_gain_is_refused():
    _, slope_x, slope_y = ridged_bump()
    with pytest.raises(BadInput, match="transfer function"):
        shapelets(slope_x, slope_y, gain=lambda w: w * np.nan)


def test_enough_scales_recover_the_surface():
    height, slope_x, slope_y = ridged_bump(128)
    got = shapelets(slope_x, slope_y, settings=ShapeletSettings(scales=8, sigma_px=0.5))
    assert np.std(got - height) < 0.03 * np.std(height)


def correlation(a, b):
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def hill(size=96):
    i, j = np.mgrid[0:size, 0:size].astype(float)
    x, y = j - size / 2, size / 2 - i
    height = 20 * np.exp(-(x**2 + (1.3 * y) ** 2) / (2 * 14**2))
    return height, -x / 14**2 * height, -(1.3**2) * y / 14**2 * height


@pytest.mark.parametrize(
    ("variant", "least"), [("slant_tilt", 0.999), ("ambiguous_tilt", 0.9), ("slant_only", 0.7), ("tilt_only", 0.8)]
)
def test_every_variant_sees_a_hill(variant, least):
    height, slope_x, slope_y = hill()
    settings = ShapeletSettings(scales=7, variant=variant)
    assert correlation(shapelets(slope_x, slope_y, settings=settings), height) > least


def test_sign_is_lost_exactly_where_it_is_not_known():
    _, slope_x, slope_y = hill()
    for variant, odd in (("slant_tilt", True), ("tilt_only", True), ("ambiguous_tilt", False), ("slant_only", False)):
        settings = ShapeletSettings(scales=5, variant=variant)
        up = shapelets(slope_x, slope_y, settings=settings)
        down = shapelets(-slope_x, -slope_y, settings=settings)
        assert np.allclose(down, -up if odd else up, atol=1e-4), variant


@pytest.mark.parametrize("variant", VARIANTS[1:])
def test_mirror_padding_continues_the_fields(variant):
    """Half of a symmetric hill, cut through its middle, gives half of the whole one's result."""
    _, slope_x, slope_y = hill(97)
    i, j = np.mgrid[0:96, 0:96].astype(float)
    x, y = j - 47.5, 47.5 - i
    height = 20 * np.exp(-(x**2 + y**2) / (2 * 14**2))
    slope_x, slope_y = -x / 14**2 * height, -y / 14**2 * height
    settings = ShapeletSettings(scales=3, variant=variant)
    whole = shapelets(slope_x, slope_y, settings=settings)
    half = shapelets(slope_x[:, 48:], slope_y[:, 48:], settings=settings)
    assert np.allclose(half - half.mean(), whole[:, 48:] - whole[:, 48:].mean(), atol=1e-3)


@pytest.mark.parametrize(
    "field",
    [{"scales": 0}, {"sigma_px": 0}, {"factor": 1.0}, {"variant": "both"}, {"padding": "wrap"}, {"sigma_px": np.nan}],
)
def test_bad_settings_are_refused(field):
    with pytest.raises(BadInput, match="shapelets"):
        ShapeletSettings(**field)
