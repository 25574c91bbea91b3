"""The joint fit: exact on exact shadows, within its own intervals on noisy ones, not led astray by
a wrong tip."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.model import Camera
from splitknit_rig.calibration.lights import Circle, Tip
from splitknit_rig.calibration.nail import Nail, by_joint_fit
from splitknit_simulator.camera.lens import pixels_of_points

ORTHOGRAPHIC = Camera(px_per_mm=75.7, image_size=(2200, 3200))
FOCAL = 140 * 75.7
PERSPECTIVE = replace(
    ORTHOGRAPHIC,
    model="perspective",
    matrix=np.array([[FOCAL, 0, 1612.0], [0, FOCAL, 1085.0], [0, 0, 1.0]]),
    distortion=(-0.05, 0.02, 0.001, 0.0, 0.0),
)
CIRCLE = Circle(52.5, 140.0)
FOUR = ((-6, -4), (6, -4), (6, 4), (-6, 4))


def rig(seed, sd=0.7):
    """(14, 3) LEDs near the circle."""
    angles = np.pi * np.arange(14) / 7
    exact = np.column_stack([52.5 * np.cos(angles), 52.5 * np.sin(angles), np.full(14, 140.0)])
    return exact + np.random.default_rng(seed).normal(0, sd, (14, 3))


def seen(leds, camera, places=FOUR, *, height=20.0, tip_px=0.0, nail_mm=0.0, seed=0):
    """Tips by the twin's lens, by hand otherwise; LED k of the 14 is white 0, NIR 0, white 1,
    ..."""
    rng = np.random.default_rng([seed, 7])
    tips = []
    for number, (x, y) in enumerate(places, start=1):
        moved = rng.normal(0, nail_mm * 75.7, 2)
        nail = np.array(pixels_of_points(camera, *map(np.array, (x, y, height)))) + moved
        for k, (px, py, pz) in enumerate(leds):
            far = pz / (pz - height)
            end = pixels_of_points(
                camera, *map(np.array, (px + (x - px) * far, py + (y - py) * far, 0.0))
            )
            tip = np.array(end) + rng.normal(0, tip_px, 2)
            band = "nir" if k % 2 else "white"
            tips.append(Tip(band, k // 2, number, tuple(nail.tolist()), tuple(tip.tolist())))
    return sorted(tips, key=lambda tip: (tip.band != "white", tip.led, tip.nail))


def in_order(leds):
    return np.concatenate([leds[0::2], leds[1::2]])


def places(fit):
    return np.array([led.position_mm for led in fit.leds])


def errors_deg(fit, leds):
    estimated, truth = (
        a / np.linalg.norm(a, axis=1, keepdims=True) for a in (places(fit), in_order(leds))
    )
    return np.degrees(np.linalg.norm(estimated - truth, axis=1))


@pytest.mark.parametrize("camera", [ORTHOGRAPHIC, PERSPECTIVE], ids=["orthographic", "perspective"])
def test_exact_shadows_give_exact_places(camera):
    leds = rig(0, sd=0.0)
    fit = by_joint_fit(seen(leds, camera), camera, CIRCLE)
    assert places(fit) == pytest.approx(in_order(leds), abs=1e-3)
    assert fit.nail_height_mm == pytest.approx(20.0, abs=1e-3)
    assert np.abs(fit.residual_px).max() < 0.01
    assert fit.outliers == () and fit.strays == frozenset()
    assert max(led.disagreement_deg for led in fit.leds) < 1e-3


def test_a_known_nail_needs_no_circle():
    """The circle is wrong by a tenth in radius and by a twentieth in height, and the LEDs come out
    all the same."""
    leds = rig(1, sd=1.0)
    wrong = Circle(57.0, 147.0, (3.0, -2.0))
    fit = by_joint_fit(seen(leds, PERSPECTIVE), PERSPECTIVE, wrong, Nail(height_mm=20.0))
    assert np.abs(places(fit) - in_order(leds)).max() < 0.3
    free = by_joint_fit(seen(leds, PERSPECTIVE), PERSPECTIVE, wrong)
    assert np.abs(places(free) - in_order(leds)).max() > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("camera", [ORTHOGRAPHIC, PERSPECTIVE], ids=["orthographic", "perspective"])
def test_errors_by_noise_stay_within_the_intervals(camera):
    """One pixel on the tips, a tenth of a millimetre on the nail, on three rigs."""
    errors, inside = [], []
    for seed in range(3):
        leds = rig(seed)
        fit = by_joint_fit(seen(leds, camera, tip_px=1.0, nail_mm=0.1, seed=seed), camera, CIRCLE)
        errors.append(errors_deg(fit, leds))
        inside.append(errors[-1] < [led.interval_deg for led in fit.leds])
        used = np.delete(fit.residual_px, fit.outliers, axis=0)
        assert 0.3 < np.sqrt(np.mean(used**2)) < 1.3
    assert np.mean(errors) < 0.4
    assert np.mean(inside) > 0.9


def test_a_wrong_tip_is_named_and_hardly_changes_the_fit():
    leds = rig(2)
    tips = seen(leds, ORTHOGRAPHIC, tip_px=0.5, nail_mm=0.02, seed=2)
    clean = by_joint_fit(tips, ORTHOGRAPHIC, CIRCLE)
    x, y = tips[9].tip_px
    wrong = [*tips[:9], replace(tips[9], tip_px=(x + 60.0, y - 40.0)), *tips[10:]]
    fit = by_joint_fit(wrong, ORTHOGRAPHIC, CIRCLE)
    assert fit.outliers == (9,)
    assert np.abs(errors_deg(fit, leds) - errors_deg(clean, leds)).max() < 0.1
    assert fit.leds[2].disagreement_deg > 1.0 and fit.leds[3].disagreement_deg < 0.5
    assert clean.outliers == ()


def test_an_led_off_its_circle_is_named():
    leds = rig(3)
    leds[4] *= (1.4, 1.4, 1.0)  # white 2
    fit = by_joint_fit(seen(leds, ORTHOGRAPHIC), ORTHOGRAPHIC, CIRCLE)
    assert fit.strays == {("white", 2)}


def test_the_nail_may_stand_elsewhere_under_the_other_band():
    leds = rig(5, sd=0.0)
    elsewhere = [(-5, 3), (4, 4), (2, -5), (-3, -3)]
    tips = [
        tip
        for band, places in (("white", FOUR), ("nir", elsewhere))
        for tip in seen(leds, ORTHOGRAPHIC, places)
        if tip.band == band
    ]
    fit = by_joint_fit(tips, ORTHOGRAPHIC, CIRCLE)
    assert errors_deg(fit, leds).max() < 1e-3


def test_one_nail_position_is_refused():
    with bad_input("two nail positions"):
        by_joint_fit(seen(rig(0), ORTHOGRAPHIC, [(3, 3)]), ORTHOGRAPHIC, CIRCLE)
