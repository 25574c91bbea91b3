"""The camera's response to light, measured on half an ellipsoid of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.diagnosis.response import (
    Response,
    blue_over_red,
    colour_spread,
    height_over_half_width,
    image_gains,
    shading_exponent,
    tone_exponent,
)

ANGLES = 2 * np.pi * np.arange(7) / 7
DIRECTIONS = np.column_stack([0.5 * np.cos(ANGLES), 0.5 * np.sin(ANGLES), np.full(7, 0.866)])
BRIGHTNESS = np.array([1.0, 1.15, 0.9, 1.05, 0.85, 0.95, 1.1])
Y, X = np.mgrid[1:-1:81j, -1:1:81j]
INSIDE = X**2 + Y**2 < 0.8
HEIGHT = 0.8 * np.sqrt(np.maximum(1 - X**2 - Y**2, 0.0))


def scene(brightness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light (3, L, n) in red, green and blue, and light vectors (L, 3, n)."""
    z = HEIGHT[INSIDE] / 0.64
    normals = np.stack([X[INSIDE], Y[INSIDE], z])
    normals /= np.linalg.norm(normals, axis=0)
    lights = DIRECTIONS * brightness[:, None]
    light = np.clip(lights @ normals, 0.0, None) * np.linspace(0.4, 0.6, normals.shape[1])
    return np.stack([light, 0.7 * light, 0.5 * light]), np.repeat(
        lights[:, :, None], normals.shape[1], axis=2
    )


def test_gains_that_differ_between_colours_are_detected():
    """Equal gains are none; a gain of each colour and image is measured to a few per cent."""
    light, lights = scene(BRIGHTNESS)
    assert colour_spread(image_gains(light, lights)) < 1e-3
    gains = 1 + np.random.default_rng(3).uniform(-0.15, 0.15, (3, 7))
    assert colour_spread(image_gains(light * gains[..., None], lights)) > 0.03


@pytest.mark.parametrize("exponent", [0.45, 0.8, 1.0, 1.25])
def test_unequal_lights_give_the_tone_exponent(exponent):
    """Within 0.02, and far beyond its error where it is not one."""
    light, lights = scene(BRIGHTNESS)
    gains = image_gains(light**exponent, lights)
    estimated, significance = tone_exponent([Response(gains, DIRECTIONS, BRIGHTNESS, ())])
    assert estimated == pytest.approx(exponent, abs=0.02)
    assert (abs(significance) > 10) == (exponent != 1.0)


def test_ambient_light_lowers_the_exponent_and_equal_lights_give_none():
    """A lamp of 30 %."""
    light, lights = scene(BRIGHTNESS)
    gains = image_gains(light + 0.3 * light.mean(axis=1, keepdims=True), lights)
    estimated, significance = tone_exponent([Response(gains, DIRECTIONS, BRIGHTNESS, ())])
    assert estimated < 0.85
    assert significance < -10
    assert np.isnan(tone_exponent([Response(gains, DIRECTIONS, np.ones(7), ())])[0])


@pytest.mark.parametrize("exponent", [0.7, 0.8, 1.0, 1.3])
def test_shading_gives_the_exponent_under_equal_lights(exponent):
    """Within 0.05, though their brightness is 1 % off."""
    light, lights = scene(np.ones(7))
    assert shading_exponent(
        (light**exponent) * BRIGHTNESS[:, None] ** 0.1, lights
    ) == pytest.approx(exponent, abs=0.05)


def test_height_colour_and_clipping_are_measured():
    """Of the ellipsoid itself."""
    light, _ = scene(np.ones(7))
    assert height_over_half_width(
        HEIGHT, X**2 + Y**2 < 1, float(X[0, 1] - X[0, 0])
    ) == pytest.approx(0.8, abs=0.05)
    assert blue_over_red(light) == pytest.approx(0.5)
    assert blue_over_red(light[::-1]) == pytest.approx(2.0)
