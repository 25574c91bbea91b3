"""Gains of LEDs from any matt surface: what can be detected is, what cannot is left out, and skin does not mislead."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.finger.led_drift import drift_words, led_drift
from splitknit.imaging.band import linear_stack
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import view_of
from splitknit.model import Rig, default_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

NAMES = [f"white {k}" for k in range(7)]
AZIMUTH = 2 * np.pi * np.arange(7) / 7
FIRST_ORDER = np.stack([np.ones(7), np.cos(AZIMUTH), np.sin(AZIMUTH)])


class Scene:
    """A dome (or a plane) under the default rig's white LEDs, with texture and noise."""

    def __init__(self, radius_mm: float | None) -> None:
        whole = default_rig(0.08)
        rig = Rig(whole.camera, whole.leds[:7])
        rows, columns = rig.camera.image_size
        x = (np.arange(columns) - (columns - 1) / 2) / rig.camera.px_per_mm
        y = ((rows - 1) / 2 - np.arange(rows)) / rig.camera.px_per_mm
        x, y = np.meshgrid(x, y)
        self.mask = x**2 + y**2 < 10**2
        if radius_mm is None:
            z, self.normals = 0 * x, np.broadcast_to([0.0, 0.0, 1.0], (rows, columns, 3))
        else:
            up = np.sqrt(np.maximum(radius_mm**2 - x**2 - y**2, 1e-6))
            z, self.normals = up - radius_mm, np.stack([x, y, up], axis=-1) / radius_mm
        self.lights = light_vectors_at(rig, *view_of(rig.camera).points(z.astype(np.float32)))
        albedo = 0.5 + 0.2 * np.random.default_rng(1).random((rows, columns))
        self.clean = albedo * np.maximum(np.einsum("lchw,hwc->lhw", self.lights, self.normals), 0)

    def stack(self, gains, seed=0, noise=0.004):
        images = self.clean * np.asarray(gains)[:, None, None]
        return (images + noise * np.random.default_rng(seed).standard_normal(images.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def dome():
    return Scene(14.0)


@pytest.fixture(scope="module")
def plane():
    return Scene(None)


def without_first_order(gains):
    """What is left of ln(gains) when a common factor and a tilt are taken off."""
    basis = np.linalg.qr(FIRST_ORDER.T)[0]
    departure = np.log(gains)
    return departure - basis @ (basis.T @ departure)


@pytest.mark.parametrize("scene", ["dome", "plane"])
def test_patterns_that_a_tilt_cannot_make_are_found(scene, request):
    surface = request.getfixturevalue(scene)
    gains = 1 + 0.08 * np.random.default_rng(5).standard_normal(7)
    found = led_drift(surface.stack(gains), surface.lights, surface.mask)
    assert found.observable.shape == (4, 7)
    assert np.abs(found.observable @ np.log(found.gain / gains)).max() < 0.01
    assert np.abs(np.log(found.gain) - without_first_order(gains)).max() < 0.015
    assert found.error.max() < 0.01
    departure = np.log(found.gain)
    assert np.abs(found.observable.T @ (found.observable @ departure) - departure).max() < 1e-9


@pytest.mark.parametrize("scene", ["dome", "plane"])
def test_a_first_order_pattern_is_a_tilt(scene, request):
    """It leaves no trace on a plane and hardly one on a dome: it is not called a drift."""
    surface = request.getfixturevalue(scene)
    found = led_drift(surface.stack(1 + 0.06 * np.cos(AZIMUTH)), surface.lights, surface.mask)
    assert np.abs(found.gain - 1).max() < 0.004
    assert found.suspect is None
    assert drift_words(found, NAMES) == []
    limits = (1e-3, 1e-3, 1e-3) if scene == "plane" else (1e-3, 0.05, 0.05)
    assert (found.information[:3] < limits).all()
    assert found.information[3] > 0.7
    hidden = FIRST_ORDER / np.linalg.norm(FIRST_ORDER, axis=1, keepdims=True)
    assert np.linalg.norm(found.observable @ hidden.T, axis=0).max() < 0.05


@pytest.mark.parametrize("led", [0, 3])
@pytest.mark.parametrize("gain", [0.88, 1.07])
def test_a_single_led_is_named(dome, led, gain):
    found = led_drift(dome.stack(np.where(np.arange(7) == led, gain, 1.0), seed=led), dome.lights, dome.mask)
    assert found.suspect == led
    assert found.suspect_gain == pytest.approx(gain, abs=0.01)
    assert found.explained > 0.98
    change = "12 % darker" if gain < 1 else "7 % brighter"
    assert drift_words(found, NAMES)[0].startswith(f"LED white {led} is {change} than at the calibration")


def test_calibrated_leds_raise_no_alarm(dome):
    found = led_drift(dome.stack(np.ones(7)), dome.lights, dome.mask)
    assert np.abs(found.gain - 1).max() < 0.005
    assert found.suspect is None and drift_words(found, NAMES) == []
    assert found.residual_percent < 1.5


def test_several_leds_are_no_single_one(dome):
    gains = np.array([1.0, 0.85, 1.0, 1.15, 1.0, 0.85, 1.15])
    found = led_drift(dome.stack(gains), dome.lights, dome.mask)
    assert found.suspect is None
    assert "several LEDs depart" in drift_words(found, NAMES)[0]


def test_shadows_and_gloss_do_not_count(dome):
    images = dome.stack(np.ones(7))
    images[2, :60] *= 0.02  # a cast shadow
    images[4, 90:100, 120:130] *= 3  # a highlight
    found = led_drift(images, dome.lights, dome.mask)
    assert np.abs(found.gain - 1).max() < 0.01
    assert found.suspect is None


@pytest.mark.slow
@pytest.mark.parametrize("lights", ["near", "distant"])
def test_skin_does_not_mislead(lights):
    """A simulated finger with gloss, wandering light and shadows; the surface that the lights meet is known or not."""
    capture, truth = simulate_capture(2, "whorl", TwinSettings(scale=0.1))
    band = capture.bands["white"]
    rig = capture.rig.select(band.leds)
    mask = np.asarray(truth["mask"])
    z = np.where(mask, truth["shape_mm"], 0).astype(np.float32)
    vectors = rig.light_vectors()
    if lights == "near":
        vectors = light_vectors_at(rig, *view_of(rig.camera).points(z))
    stack = linear_stack(band, capture.encoding)
    calm = led_drift(stack, vectors, mask)
    assert calm.suspect is None and drift_words(calm, NAMES) == []
    gains = np.where(np.arange(7) == 5, 0.93, 1.0).astype(np.float32)
    found = led_drift(stack * gains[:, None, None], vectors, mask)
    assert found.suspect == 5
    # lamps that are taken for distant ones cost a little more
    assert found.suspect_gain == pytest.approx(0.93, abs=0.012 if lights == "near" else 0.015)


def test_the_order_of_the_lights_does_not_matter(dome):
    gains = np.array([1.0, 1.1, 1.0, 0.95, 1.0, 1.0, 1.0])
    order = np.array([3, 0, 6, 1, 5, 2, 4])
    found = led_drift(dome.stack(gains), dome.lights, dome.mask)
    turned = led_drift(dome.stack(gains)[order], dome.lights[order], dome.mask)
    assert np.abs(turned.gain - found.gain[order]).max() < 1e-4


def test_bad_input_is_refused(dome):
    stack = dome.stack(np.ones(7))
    with pytest.raises(BadInput, match="at least 5 images"):
        led_drift(stack[:4], dome.lights[:4])
    with pytest.raises(BadInput, match=r"\(7, 3\)"):
        led_drift(stack, dome.lights[:6])
    with pytest.raises(BadInput, match="only 0 pixels"):
        led_drift(0 * stack, dome.lights)
