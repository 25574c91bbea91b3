"""Gains of LEDs from any matt surface: what can be detected is, what cannot is left out, and skin does not mislead."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.finger.led_drift import drift_words, led_drift
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import view_of
from splitknit.model import Rig, default_rig

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


def test_shadows_and_gloss_do_not_count(dome):
    images = dome.stack(np.ones(7))
    images[2, :60] *= 0.02  # a cast shadow
    images[4, 90:100, 120:130] *= 3  # a highlight
    found = led_drift(images, dome.lights, dome.mask)
    assert np.abs(found.gain - 1).max() < 0.01
    assert found.suspect is None
