"""Telling relief from glare by colour: limits of the weights, spectra of known fields."""

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.skin.relief import cross_spectra, fit_spectra, unmixing_weights

OMEGA = np.linspace(0, 40, 60)
TRANSFER = np.stack([1 / (1 + OMEGA / s) for s in (2.0, 4.0, 8.0)])
GLARE = np.array([1.0, 1.5, 2.0])
ONES = np.ones(OMEGA.size)
NOISE = np.array([0.01, 0.02, 0.015])


def weights_of(signal, glare_power, noise=1e-3):
    """Weights of three channels with the same noise power, for these powers at every frequency."""
    return unmixing_weights(TRANSFER, GLARE, signal * ONES, glare_power * ONES, np.full(3, noise))


def test_weights_cancel_strong_specular_reflection():
    assert np.abs(GLARE @ weights_of(1, 1e6)).max() < 1e-3
    assert np.abs(GLARE @ weights_of(1, 0)).max() > 0.5


def test_strong_relief_is_passed_without_bias():
    np.testing.assert_allclose((weights_of(1e6, 10) * TRANSFER).sum(axis=0), 1.0, atol=1e-4)


def test_noise_shrinks_relief_and_never_amplifies_it():
    gain = (weights_of(1, 0.1, 0.05) * TRANSFER).sum(axis=0)
    assert gain.min() > 0 and gain.max() < 1
    assert gain[-1] < gain[1]


def test_weights_of_one_channel_are_a_wiener_filter():
    signal, noise = 1 / (1 + OMEGA), 0.01
    m = TRANSFER[:1]
    weights = unmixing_weights(m, np.ones(1), signal, 0 * ONES, np.array([noise]))
    np.testing.assert_allclose(weights[0], signal * m[0] / (signal * m[0] ** 2 + noise), rtol=1e-10)
    sharp = unmixing_weights(m, np.ones(1), 1e9 * ONES, 0 * ONES, np.array([noise]))
    np.testing.assert_allclose(sharp[0], 1 / m[0], rtol=1e-5)


def test_weights_minimise_the_mean_square_error():
    """By simulation: least squares of the true slope on many draws of the channels, two glares
    among them."""
    rng = np.random.default_rng(0)
    glare = np.array([[1.0, 0.0], [1.5, 0.0], [0.0, 0.8]])
    transfer, signal, powers, noise = (
        np.array([[0.4], [0.7], [0.9]]),
        2.0,
        np.array([0.7]),
        np.array([0.1, 0.2, 0.05]),
    )
    draws = 400_000
    d = rng.standard_normal(draws) * np.sqrt(signal)
    s = rng.standard_normal((2, draws)) * np.sqrt(powers)
    p = (
        transfer * d
        + np.einsum("cg,gn->cn", glare, s)
        + rng.standard_normal((3, draws)) * np.sqrt(noise)[:, None]
    )
    brute = np.linalg.solve(p @ p.T, p @ d)
    weights = unmixing_weights(transfer, glare, np.array([signal]), powers, noise)
    np.testing.assert_allclose(weights[:, 0], brute, atol=0.01)


PITCH = 0.05
SHAPE = (150, 180)


def window():
    return np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in SHAPE)).astype(
        np.float32
    )


def test_white_noise_has_its_variance_in_every_band_and_channel():
    rng = np.random.default_rng(1)
    sigma = (0.1, 0.3)
    slopes = [
        tuple((s * rng.standard_normal(SHAPE)).astype(np.float32) for _ in range(2)) for s in sigma
    ]
    omega, along, across = cross_spectra(slopes, window(), PITCH)
    assert omega.shape == (28,)
    assert (np.diff(omega) > 0).all()
    wide = omega > 15
    for c, s in enumerate(sigma):
        np.testing.assert_allclose(along[wide, c, c], s**2, rtol=0.4)
        np.testing.assert_allclose(across[wide, c], s**2, rtol=0.4)
        assert along[wide, c, c].mean() == pytest.approx(s**2, rel=0.06)
    assert np.abs(along[wide, 0, 1]).max() < 0.3 * sigma[0] * sigma[1]
    np.testing.assert_array_equal(along[:, 0, 1], along[:, 1, 0])


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, 120.0])
def test_the_power_of_a_wave_is_along_its_vector_at_its_frequency(turn_deg):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH
    wave = 18.0
    ux, uy = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    swing = np.cos(wave * (ux * x - uy * y)).astype(np.float32)  # y up
    slope = (np.float32(ux) * swing, np.float32(uy) * swing)
    double = tuple(2 * s for s in slope)
    omega, along, across = cross_spectra([slope, double], window(), PITCH)
    peak = int(np.argmax(along[:, 0, 0]))
    assert omega[peak] == pytest.approx(wave, rel=0.08)
    assert across[:, 0].sum() < 0.02 * along[:, 0, 0].sum()
    np.testing.assert_allclose(along[peak, 0, 1], 2 * along[peak, 0, 0], rtol=1e-4)
    np.testing.assert_allclose(along[peak, 1, 1], 4 * along[peak, 0, 0], rtol=1e-4)


def synthetic(signal, glare_power, correlation=0.0):
    """Transfer of three channels, and spectra along and across the slope, with the power NOISE."""
    centres = np.geomspace(5, 60, 20)
    m = np.stack([1 / (1 + centres / s) for s in (4.0, 8.0, 16.0)])
    mixed = m.T[:, :, None] * GLARE + GLARE[:, None] * m.T[:, None, :]
    along = (
        signal * m.T[:, :, None] * m.T[:, None, :]
        + glare_power * np.multiply.outer(GLARE, GLARE)
        + correlation * mixed
        + np.diag(NOISE)
    )
    return m, along, np.tile(NOISE, (20, 1))


@pytest.mark.parametrize("correlation", [0.0, 0.15, -0.1])
def test_fit_recovers_relief_glare_and_noise(correlation):
    m, along, across = synthetic(0.5, 0.1, correlation)
    signal, glare, fitted_noise = fit_spectra(along, across, m, GLARE)
    np.testing.assert_allclose(signal, 0.5, rtol=1e-6)
    np.testing.assert_allclose(glare, 0.1, rtol=1e-6)
    np.testing.assert_allclose(fitted_noise, NOISE)


def test_two_channels_separate_relief_from_uncorrelated_specular_reflection():
    m, along, across = synthetic(0.5, 0.1)
    signal, glare, _ = fit_spectra(along[:, :2, :2], across[:, :2], m[:2], GLARE[:2])
    np.testing.assert_allclose(signal, 0.5, rtol=1e-6)
    np.testing.assert_allclose(glare, 0.1, rtol=1e-6)


def test_the_power_of_one_channel_is_all_relief():
    m, along, across = synthetic(0.5, 0.0)
    signal, glare, _ = fit_spectra(along[:, :1, :1], across[:, :1], m[:1], GLARE[:1])
    np.testing.assert_allclose(signal, 0.5, rtol=1e-6)
    assert not glare.any()


def test_fitted_powers_are_never_negative():
    m, along, across = synthetic(-0.005, -0.0005)
    signal, glare, noise = fit_spectra(along, across, m, GLARE)
    assert (signal >= 0).all()
    assert (glare >= 0).all()
    assert (noise > 0).all()


def test_spectra_with_nan_are_refused(capfd):
    m, along, across = synthetic(0.005, 0.0005)
    along[3] = np.nan
    with pytest.raises(BadInput, match="check the images"):
        fit_spectra(along, across, m, GLARE)
    assert capfd.readouterr().err == ""
