"""One frame of three colours, many balls, no photograph of the flat gel: its light is taken from between the balls."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import pytest

from gel_frames import cap, frame
from splitknit.errors import BadInput
from splitknit.photometric.shading import BETWEEN, flat_of_fall_off, shading_slopes
from splitknit_rig.calibration.shading import ShadingFit, calibrate_shading
from splitknit_rig.capture.live import HeightMeter, linear_colours

SIZE, RADIUS, STEP = (260, 330), 24.0, 62.0
RADIUS_MM, SPACING_MM = 1.0, STEP / RADIUS
CENTRES = np.array([(40.0 + STEP * i, 38.0 + STEP * j, RADIUS) for j in range(4) for i in range(5)])


@pytest.fixture(scope="module")
def pressed() -> tuple[np.ndarray, np.ndarray]:
    height = sum(cap(x, y, RADIUS, 18.0, SIZE) for x, y, _ in CENTRES)
    assert isinstance(height, np.ndarray)
    return cv2.GaussianBlur(height, (0, 0), 0.8), frame(cv2.GaussianBlur(height, (0, 0), 0.8), noise=0.002)


@pytest.fixture(scope="module")
def fit(pressed: tuple[np.ndarray, np.ndarray]) -> ShadingFit:
    given = CENTRES + np.random.default_rng(2).normal(0, 0.4, CENTRES.shape) * [1, 1, 0]  # as clicked by hand
    return calibrate_shading([linear_colours(pressed[1], "linear")], None, RADIUS_MM, SPACING_MM, [given])


def test_the_light_between_the_balls_is_that_of_the_flat_gel(fit: ShadingFit) -> None:
    assert fit.shading.facts["flat"] == BETWEEN
    flat = linear_colours(frame(np.zeros(SIZE), noise=0.0), "linear")
    found = flat_of_fall_off(fit.shading.fall_off, SIZE)
    assert np.abs(found / flat - 1)[:, 20:-20, 20:-20].max() < 0.03


def test_the_balls_are_measured_and_their_centres_found(
    fit: ShadingFit, pressed: tuple[np.ndarray, np.ndarray]
) -> None:
    assert fit.used.all() and fit.shading.facts["cap_rms_um"] < 6  # of caps that are 200 um high
    off = fit.balls[:, 1:3] - CENTRES[:, :2]
    assert np.hypot(*(off - off.mean(axis=0)).T).max() < 0.5
    meter = HeightMeter(partial(shading_slopes, fit.shading), fit.shading.pitch_mm, SIZE)
    meter.divide_by(flat_of_fall_off(fit.shading.fall_off, SIZE))
    height_um = meter(pressed[1]).height_um
    truth_um = 1000 * fit.shading.pitch_mm * pressed[0]
    near = np.zeros(SIZE, bool)
    for x, y, _ in CENTRES:
        near[int(y) - 8 : int(y) + 9, int(x) - 8 : int(x) + 9] = True
    error = height_um[near] - truth_um[near]
    assert float(np.std(error)) < 20


def test_without_centres_or_without_gel_between_it_is_refused(pressed: tuple[np.ndarray, np.ndarray]) -> None:
    light = linear_colours(pressed[1], "linear")
    with pytest.raises(BadInput, match="give their `centres`"):
        calibrate_shading([light], None, RADIUS_MM, SPACING_MM)
    close = np.array([(160.0 + 40 * i, 130.0 + 40 * j, 100.0) for j in range(-1, 2) for i in range(-1, 2)])
    with pytest.raises(BadInput, match="leave no gel between them"):
        calibrate_shading([light], None, RADIUS_MM, SPACING_MM, [close])


def test_one_place_more_leaves_the_bend_as_it_is():
    """A bend is fitted to places on a grid: a pixel that turns steep does not shift all others."""
    from splitknit.methods.shaded import _bend

    rng = np.random.default_rng(0)
    height = (0.02 * np.linspace(-1, 1, 400)[:, None] ** 2 + rng.normal(0, 0.01, (400, 400))).astype(np.float32)
    gradient = np.zeros((2, 400, 400), dtype=np.float32)
    inside = np.ones((400, 400), dtype=bool)
    before = _bend(height, gradient, inside, 4)
    gradient[:, 0, 1] = 1.0
    assert np.abs(_bend(height, gradient, inside, 4) - before).max() < 1e-5
