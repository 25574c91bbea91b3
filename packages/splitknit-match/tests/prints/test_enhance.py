"""Directions, frequencies, enhancement."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.prints.enhance import gabor_enhance
from splitknit_match.prints.ridge_field import ridge_field


def _waves(period, angle_deg, size=300):
    """Phase of ridges that run at an angle counter-clockwise from the right, and the print, ridges
    dark."""
    row, column = np.mgrid[0:size, 0:size].astype(float)
    angle = np.deg2rad(angle_deg)
    phase = 2 * np.pi * (column * np.sin(angle) + row * np.cos(angle)) / period
    return phase, np.round(127.5 - 110 * np.tanh(1.5 * np.cos(phase))).astype(np.uint8)


def _rings(size=300, period=9.0):
    row, column = np.mgrid[0:size, 0:size].astype(float)
    phase = 2 * np.pi * np.hypot(row - 150.3, column - 149.1) / period
    return phase, np.round(127.5 - 100 * np.cos(phase)).astype(np.uint8)


@pytest.mark.parametrize(("period", "angle"), [(6, 30), (8.5, 120), (9.7, 77), (11, 0), (11, 90)])
def test_direction_and_period_of_waves_are_measured(period, angle):
    field = ridge_field(_waves(period, angle)[1])
    inner = (slice(10, -10),) * 2
    assert field.mask[inner].all()
    assert np.median(field.frequency_px[inner]) * period == pytest.approx(1.0, abs=0.003)
    off = 0.5 * np.angle(np.exp(2j * (field.orientation_rad[inner] - np.deg2rad(angle))))
    assert np.abs(off).max() < np.deg2rad(0.5)
    twice = ridge_field(np.kron(_waves(period, angle, 150)[1], np.ones((2, 2), np.uint8)), 1000.0)
    period_mm = np.median(twice.period_mm(1000.0)[8:-8, 8:-8])
    assert period_mm == pytest.approx(period * 25.4 / 500, rel=0.01)


def test_ridges_are_enhanced_under_noise():
    phase, image = _rings()
    rng = np.random.default_rng(5)
    noisy = np.clip(image + 90 * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)
    enhanced = gabor_enhance(noisy)
    row, column = np.mgrid[0:300, 0:300]
    radius = np.hypot(row - 150, column - 149)
    ring = (radius > 45) & (radius < 130)
    assert enhanced.mask[ring].all()
    assert np.corrcoef(enhanced.wave[ring], -np.cos(phase)[ring])[0, 1] > 0.93
    assert np.corrcoef(noisy[ring], -np.cos(phase)[ring])[0, 1] < 0.75
    assert np.corrcoef(enhanced.image[ring], image[ring])[0, 1] > 0.9  # dark stays dark


def test_enhancement_is_that_of_a_gabor_filter_for_every_pixel():
    _, image = _rings(size=300, period=8.0)
    enhanced = gabor_enhance(image)
    field = enhanced.field
    padded = np.pad(image.astype(float), 12, mode="reflect")
    offset = np.arange(-12, 13)
    fast, slow = [], []
    for row in range(60, 250, 23):
        for column in range(60, 250, 19):
            i, j = row // field.step_px, column // field.step_px
            # across rings
            frequency, angle = field.frequency_px[i, j], np.arctan2(-(row - 150.3), column - 149.1)
            x, y = np.meshgrid(offset, -offset)
            envelope = np.exp(-0.5 * (x**2 + y**2) * (frequency / 0.5) ** 2)
            wave = np.cos(2 * np.pi * frequency * (x * np.cos(angle) + y * np.sin(angle)))
            kernel = envelope * (wave - (envelope * wave).sum() / envelope.sum())
            slow.append((padded[row : row + 25, column : column + 25] * kernel).sum())
            fast.append(enhanced.wave[row, column])
    assert np.corrcoef(fast, slow)[0, 1] > 0.985


def test_nothing_is_printed_beside_the_finger():
    _, image = _waves(9, 20)
    inside = np.zeros(image.shape, bool)
    inside[60:240, 60:240] = True
    assert (gabor_enhance(image, inside=inside).image[:50] == 255).all()
    enhanced = gabor_enhance(np.where(inside, image, 255).astype(np.uint8))
    assert (enhanced.image[:40] == 255).all()
    assert enhanced.mask[80:220, 80:220].all()


@pytest.mark.parametrize("enhance", [gabor_enhance, ridge_field])
def test_images_without_ridges_or_of_2_mm_are_refused(enhance):
    with bad_input("no ridges"):
        enhance(np.full((200, 200), 255, np.uint8))
    with bad_input("2 mm"):
        enhance(np.zeros((20, 200), np.uint8))
