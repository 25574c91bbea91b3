"""The rig as drawn and as built: what calibration is given, and what it has to find."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit.nominal import default_rig, lobe_exponent, nominal_rig
from splitknit_simulator.rigs import built_rig


def positions(rig):
    return np.array([led.position_mm for led in rig.leds])


def axes(rig):
    return np.array([led.axis for led in rig.leds])


def test_the_nominal_rig_is_that_of_the_thesis_with_a_perspective_camera():
    rig = nominal_rig(0.25)
    assert np.array_equal(positions(rig), positions(default_rig(0.25)))
    camera = rig.camera
    assert camera.model == "perspective"
    assert camera.image_size == (550, 800)
    assert camera.matrix[0, 0] == pytest.approx(75.7 * 0.25 * 140)
    assert camera.matrix[0, 0] / camera.height_mm == pytest.approx(camera.px_per_mm)
    assert np.allclose(camera.matrix[:2, 2], (399.5, 274.5))
    assert {led.intensity for led in rig.leds} == {1.0}
    white, nir = rig.leds[0], rig.leds[7]
    assert np.cos(np.deg2rad(30)) ** white.lobe_exponent == pytest.approx(0.5)
    assert np.cos(np.deg2rad(20)) ** nir.lobe_exponent == pytest.approx(0.5)


def test_a_seed_gives_one_rig_at_every_scale():
    small, large, another = (
        built_rig(5, scale=0.1),
        built_rig(5, scale=0.4),
        built_rig(6, scale=0.1),
    )
    assert small.leds == large.leds
    assert large.camera.matrix[0, 0] == pytest.approx(4 * small.camera.matrix[0, 0])
    assert large.camera.distortion == pytest.approx(small.camera.distortion)
    assert small.camera.shading == pytest.approx(large.camera.shading)
    assert built_rig(5, scale=0.1).leds == small.leds
    assert another.leds != small.leds
    assert another.camera.height_mm != small.camera.height_mm


def test_built_rigs_scatter_by_their_tolerances():
    drawn = nominal_rig(0.1)
    rigs = [built_rig(seed, scale=0.1) for seed in range(200)]
    # against the middle of a rig's LEDs, which the camera's seat moves
    offset = np.array([positions(rig) - positions(rig).mean(axis=0) for rig in rigs])
    offset -= positions(drawn) - positions(drawn).mean(axis=0)
    assert offset.std(axis=(0, 1)) == pytest.approx(0.7, rel=0.1)
    cosines = np.sum(np.array([axes(rig) for rig in rigs]) * axes(drawn), axis=-1)
    assert np.sqrt(np.mean(np.arccos(cosines) ** 2) / 2) == pytest.approx(np.deg2rad(2), rel=0.06)
    assert np.std([[led.intensity for led in rig.leds] for rig in rigs]) == pytest.approx(
        0.1, rel=0.06
    )
    for band, angle in (("white", 30), ("nir", 20)):
        lobes = [led.lobe_exponent for rig in rigs for led in rig.leds if led.band == band]
        assert np.median(lobes) == pytest.approx(lobe_exponent(angle), rel=0.05)
    focal = np.array([rig.camera.matrix[0, 0] for rig in rigs]) / drawn.camera.matrix[0, 0] - 1
    assert focal.std() == pytest.approx(0.01, rel=0.2)
    heights = np.array([rig.camera.height_mm for rig in rigs])
    assert heights.std() == pytest.approx(0.5, rel=0.2)
    centres = np.array([rig.camera.matrix[:2, 2] for rig in rigs]) - drawn.camera.matrix[:2, 2]
    assert centres.std(axis=0) == pytest.approx(0.005 * 320, rel=0.2)


def test_distortion_and_fall_off_of_lenses_stay_in_their_ranges():
    shifts, fractions = [], []
    for seed in range(100):
        camera = built_rig(seed, scale=0.1).camera
        corner2 = np.sum((np.array(camera.image_size) / 2) ** 2) / camera.matrix[0, 0] ** 2
        shifts.append(camera.distortion[0] * corner2)
        fractions.append(1 + sum(camera.shading))
        assert camera.px_per_mm == pytest.approx(camera.matrix[0, 0] / camera.height_mm)
    assert -0.005 <= min(shifts) < -0.003
    assert 0.003 < max(shifts) <= 0.005
    # cos^4 leaves 93 to 94 % at the corners, vignetting takes 10 to 20 % more
    assert 0.72 < min(fractions) < 0.77
    assert 0.80 < max(fractions) < 0.85


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: built_rig(-1), "seed must not be negative"),
        (lambda: built_rig(0, scale=2.0), "scale must lie in"),
        (lambda: lobe_exponent(0.0), "half_angle_deg must lie between"),
    ],
)
def test_impossible_rigs_are_refused(call, words):
    with bad_input(words):
        call()
