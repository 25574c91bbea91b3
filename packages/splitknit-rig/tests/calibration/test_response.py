"""Linear, sRGB or neither: exposures tell, noise or none, and what they cannot tell is refused with
the reason."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit_rig.calibration.sensor import fit_response

TIMES = np.array([1.0, 2.0, 4.0, 8.0])
LIGHT = np.random.default_rng(0).uniform(0.01, 0.12, 400)
TRUE = TIMES[:, None] * LIGHT


def srgb(light):
    return np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055
    )


def noisy(values, sigma=0.0015, seed=1):
    return values + sigma * np.random.default_rng(seed).standard_normal(values.shape)


@pytest.mark.parametrize("black", [0.0, 0.06])
def test_a_linear_response_is_recognised(black):
    response = fit_response(noisy(black + (0.95 - black) * TRUE), TIMES)
    assert response.encoding == "linear"
    assert response.linear_percent < 0.4
    assert response.srgb_percent > 5
    assert response.residual_percent == pytest.approx(0.13, abs=0.04)


def test_an_srgb_response_is_recognised():
    response = fit_response(noisy(srgb(0.95 * TRUE)), TIMES)
    assert response.encoding == "srgb"
    assert response.srgb_percent < 0.3
    assert response.linear_percent > 10


@pytest.mark.parametrize("bend", [0.0, 0.01, 0.02, 0.04])
def test_the_departure_from_linear_is_measured(bend):
    """v = L + b 4 L (1 - L), as a well that fills: a parabola departs from its best line by a third
    to two thirds."""
    response = fit_response(
        noisy(TRUE + bend * 4 * TRUE * (1 - TRUE), 0.0005), TIMES, limit_percent=5
    )
    assert response.linear_percent == pytest.approx(100 * bend * 0.6, abs=0.15 + 20 * bend)
    if bend:
        assert response.linear_percent > 100 * bend * 0.35


def test_a_response_that_is_neither_linear_nor_srgb_is_refused():
    bent = TRUE + 0.03 * np.sin(2 * np.pi * TRUE)
    with bad_input(r"neither linear \(it departs by 2\.\d .* nor sRGB .*; switch off the camera's"):
        fit_response(noisy(bent), TIMES)


def test_a_scene_that_moved_is_refused():
    moved = TRUE * (1 + 0.05 * np.random.default_rng(2).standard_normal(TRUE.shape))
    with bad_input(r"contradicts itself by 1\.. % of full scale: the scene moved"):
        fit_response(moved, TIMES)


def test_automatic_exposure_is_refused():
    with bad_input("automatic exposure or gain was on"):
        fit_response(noisy(4 * TRUE / TIMES[:, None] ** 0.95), TIMES)


def test_series_that_do_not_determine_the_response_are_refused():
    with bad_input("3 different exposures, but at least 4"):
        fit_response(TRUE, [1.0, 2.0, 4.0, 4.0])
    with bad_input(r"ratio of 1\.6"):
        fit_response(TRUE, [5.0, 6.0, 7.0, 8.0])
    with bad_input("covers 9 % of full scale"):
        fit_response(0.1 * TRUE, TIMES)
    with bad_input("0 places that are unclipped"):
        fit_response(np.ones_like(TRUE), TIMES)
