"""Enhancement of pressed prints: ridges come out of noise, and no ridges where there are none."""

import numpy as np
import pytest

from splitknit_match.prints.pressed import pressed_ridges

FROM_MIDDLE = np.hypot(*(np.mgrid[0:160, 0:180] - np.array([80, 90])[:, None, None]))


def patch(wave):
    return np.where(wave != 0, 140 + 90 * wave, 250)


def as_image(grey):
    return np.clip(grey, 0, 255).astype(np.uint8)


def waves(angle_deg, period_px, shape=(160, 180)):
    """Ridges of one direction: 1 on valleys, -1 on ridges, in a round patch (0 outside)."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    along = np.deg2rad(angle_deg)
    wave = np.cos(2 * np.pi * (np.cos(along) * x + np.sin(along) * y) / period_px)
    return np.where(np.hypot(x - 90, y - 80) < 60, wave, 0.0)


@pytest.mark.parametrize("angle_deg", [0, 35, 90, 150])
@pytest.mark.parametrize("period_px", [7.0, 9.0, 12.0])
def test_ridges_come_out_of_noise(angle_deg, period_px):
    wave = waves(angle_deg, period_px)
    inside = wave != 0
    noise = np.random.default_rng(0).normal(0, 80, wave.shape)
    image = as_image(np.where(inside, 130 + 60 * wave, 250) + noise * inside)
    better = pressed_ridges(image).image.astype(float)
    core = FROM_MIDDLE < 45
    assert np.corrcoef(image[core], wave[core])[0, 1] < 0.65
    assert np.corrcoef(better[core], wave[core])[0, 1] > 0.9


def test_a_scratch_of_0_2_mm_is_closed():
    wave = waves(20, 9.0)
    image = patch(wave)
    image[78:82] = 250
    better = pressed_ridges(image.astype(np.uint8)).image.astype(float)
    across = np.s_[78:82, 50:130]
    assert np.corrcoef(better[across].ravel(), wave[across].ravel())[0, 1] > 0.85


@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_plain_image_has_no_ridges(level):
    assert pressed_ridges(np.full((70, 90), level, np.uint8)).image.min() > 245


def test_the_frame_of_a_sensor_is_no_ridge():
    rows, columns = np.mgrid[0:300, 0:260]
    window = np.abs(columns - 130) < 60 + 0.2 * rows
    radius = np.hypot(columns - 130, rows - 130)
    finger = np.where(radius < 55, 150 - 50 * np.cos(2 * np.pi * rows / 9), 190)
    noise = np.random.default_rng(1).normal(0, 3, window.shape)
    better = pressed_ridges(as_image(np.where(window, finger, 255) + noise * window))
    assert better.inside[130, 130]
    assert not better.inside[radius > 80].any()
    assert better.image[radius > 80].min() == 255


def test_weak_ridges_under_scratches_continue_their_surroundings():
    """In a patch of 2 mm ridges are a sixth as high as around it."""
    rows, columns = np.mgrid[0:240, 0:240]
    wave = np.cos(2 * np.pi * (0.8 * columns + 0.6 * rows) / 9)
    spot = np.hypot(columns - 120, rows - 120) < 20
    scratches = 100 * np.clip(np.cos(2 * np.pi * (0.6 * columns - 0.8 * rows) / 11) - 0.2, 0, 1)
    image = np.where(spot, 90 + 12 * wave + scratches, 140 + 70 * wave)
    noise = np.random.default_rng(2).normal(0, 6, wave.shape)
    better = pressed_ridges(as_image(image + noise))
    assert np.corrcoef(better.image[spot], wave[spot])[0, 1] > 0.9
    assert better.confidence[spot].mean() < 0.75 * better.confidence[~spot & better.inside].mean()


def test_traces_of_another_print_are_left_out():
    wave = waves(20, 9.0, (160, 400))
    weak = 6 * np.cos(2 * np.pi * np.arange(160) / 9)[:, None]
    trace = np.where(np.arange(400) > 200, weak, 0)
    inside = pressed_ridges(np.round(patch(wave) - 8 + trace).astype(np.uint8)).inside
    assert inside[80, 90]
    assert not inside[:, 230:].any()


def test_confidence_falls_with_noise():
    wave = waves(50, 9.0)
    noise = np.random.default_rng(4).normal(0, 160, wave.shape) * (wave != 0)
    clean, noisy = (
        pressed_ridges(as_image(patch(wave) + added)).confidence[60:100, 70:110]
        for added in (0, noise)
    )
    assert clean.min() > 0.9
    assert 0.2 < noisy.mean() < 0.7


def test_a_border_of_plain_paper_changes_no_ridges():
    noise = np.random.default_rng(2).normal(0, 110, (200, 200))
    inside = np.pad(np.ones((160, 160), np.bool_), 20)
    ridges = 130 + 60 * waves(30, 9.0, (200, 200)) + noise
    image = as_image(np.where(inside, ridges, 232 + noise / 50))
    alone = pressed_ridges(image).image[50:150, 50:150]
    bordered = pressed_ridges(np.pad(image, 80, constant_values=240)).image[130:230, 130:230]
    assert np.corrcoef(alone.ravel().astype(float), bordered.ravel())[0, 1] > 0.95
