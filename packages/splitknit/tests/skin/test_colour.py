"""Slopes from several channels with specular reflection: limits of the weights."""

import numpy as np
from numpy.testing import assert_allclose

from splitknit.skin.shape import unmixing_weights

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
    assert_allclose((weights_of(1e6, 10) * TRANSFER).sum(axis=0), 1.0, atol=1e-4)


def test_noise_shrinks_relief_and_never_amplifies_it():
    gain = (weights_of(1, 0.1, 0.05) * TRANSFER).sum(axis=0)
    assert gain.min() > 0 and gain.max() < 1
    assert gain[-1] < gain[1]


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
    assert_allclose(weights[:, 0], brute, atol=0.01)
