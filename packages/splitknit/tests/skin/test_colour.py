"""Telling relief from glare by colour: limits of the weights, noise of known fields."""

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.skin.grid import Grid
from splitknit.skin.relief import noise_power, unmixing_weights

OMEGA = np.linspace(0, 40, 60)
TRANSFER = np.stack([1 / (1 + OMEGA / s) for s in (2.0, 4.0, 8.0)])
GLARE = np.array([1.0, 1.5, 2.0])
ONES = np.ones(OMEGA.size)


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
GRID = Grid(
    np.ones(SHAPE, bool),
    PITCH * np.arange(SHAPE[1]),
    -PITCH * np.arange(SHAPE[0]),
    PITCH,
    (False,) * 4,
)
WINDOW = np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in SHAPE)).astype(
    np.float32
)


def white_noise(sigma):
    rng = np.random.default_rng(1)
    return tuple((sigma * rng.standard_normal(SHAPE)).astype(np.float32) for _ in range(2))


def wave(turn_deg, frequency=18.0):
    """Slopes of a wave in this direction."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH
    ux, uy = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    swing = np.cos(frequency * (ux * x - uy * y)).astype(np.float32)  # y up
    return np.float32(ux) * swing, np.float32(uy) * swing


def test_white_noise_has_its_variance_in_every_channel():
    sigma = np.array([0.1, 0.3])
    power = noise_power([white_noise(s) for s in sigma], WINDOW, GRID)
    np.testing.assert_allclose(power, sigma**2, rtol=0.06)


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, 120.0])
@pytest.mark.parametrize("frequency", [18.0, 55.0])
def test_a_surface_is_no_noise(turn_deg, frequency):
    slopes = wave(turn_deg, frequency)
    noisy = tuple(a + b for a, b in zip(slopes, white_noise(0.1), strict=True))
    clean, power = noise_power([slopes, noisy], WINDOW, GRID)
    assert clean < 1e-3 * 0.5  # of the power of the wave
    assert power == pytest.approx(0.01, rel=0.1)


def test_slopes_with_nan_are_refused(capfd):
    x, y = white_noise(0.1)
    with pytest.raises(BadInput, match="check the images"):
        noise_power([(x * np.nan, y)], WINDOW, GRID)
    assert capfd.readouterr().err == ""
