"""Focus: peaks when sharp, whatever brightness and noise."""

import itertools

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit_rig.capture.exposure import grey_light, measure_focus

PX = 40.0


def skin(blur_px=0.0, noise=0.0, light=0.5, seed=0):
    rng = np.random.default_rng(seed)
    x = np.arange(400) / PX
    ridges = 1 + 0.02 * np.sin(2 * np.pi * x / 0.45)[None, :] * np.ones((400, 1))
    texture = sum(
        size * cv2.GaussianBlur(rng.standard_normal((400, 400)), (0, 0), size)
        for size in (1.5, 3.0, 6.0)
    )
    image = (light * ridges * (1 + 0.02 * texture)).astype(np.float32)
    if blur_px:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    return image + rng.normal(0, noise, image.shape).astype(np.float32)


EVERYWHERE = np.ones((400, 400), dtype=bool)


def test_sharpness_falls_with_blur():
    values = [
        measure_focus(skin(blur), EVERYWHERE, PX).sharpness for blur in (0.0, 0.7, 1.5, 3.0, 6.0)
    ]
    assert all(a > 1.1 * b for a, b in itertools.pairwise(values))


@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_noise_and_brightness_hardly_change_the_sharpness(blur):
    quiet = measure_focus(skin(blur), EVERYWHERE, PX).sharpness
    noisy = measure_focus(skin(blur, noise=0.003), EVERYWHERE, PX)
    dim = measure_focus(skin(blur, light=0.1), EVERYWHERE, PX).sharpness
    assert noisy.sharpness == pytest.approx(quiet, rel=0.12)
    assert dim == pytest.approx(quiet, rel=0.02)
    assert noisy.snr < 1e6


def test_noise_alone_is_no_detail():
    focus = measure_focus(skin(40.0, noise=0.01), EVERYWHERE, PX)
    assert focus.snr < 0.1
    assert focus.sharpness < 0.4 * measure_focus(skin(), EVERYWHERE, PX).sharpness


def test_sharpness_is_that_of_the_region():
    image = skin()
    image[:, :200] = 0.5
    region = EVERYWHERE.copy()
    region[:, 190:] = False
    assert measure_focus(image, region, PX).sharpness < 0.01
    with bad_input("empty"):
        measure_focus(image, np.zeros_like(region), PX)


def test_grey_light_is_the_mean_above_black():
    pixels = np.full((2, 3, 3), (10, 20, 30), dtype=np.uint8)
    np.testing.assert_allclose(grey_light(pixels, 4.0), 16 / 255, rtol=1e-6)
    np.testing.assert_allclose(grey_light(np.full((2, 2, 1), 65535, dtype=np.uint16)), 1.0)
