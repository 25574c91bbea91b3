"""Specks are found whatever the camera's scale; valleys, wrinkles, hairs, pores, glare and scars
are none."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, zoom

from splitknit.finger.quality import capture_quality, quality_findings

SIZE_MM = (14.0, 12.0)
FINE = 44.0


@lru_cache
def skin(px_per_mm):
    """Four images of ridges, 0.45 mm apart, with two ends and with pores; the flanks' shading turns
    with the light."""
    rng = np.random.default_rng(0)
    y, x = (np.arange(round(side * FINE)) / FINE for side in SIZE_MM)
    bend = 1.5 * np.sin(x / 3.0)[None, :]
    phase = 2 * np.pi * (y[:, None] + bend) / 0.45
    for row, column, sense in ((5.0, 4.0, 1), (10.0, 8.0, -1)):
        phase = phase + sense * np.arctan2(y[:, None] - row, x[None, :] - column)
    pores = np.zeros(phase.shape)
    pores[rng.integers(0, len(y), 300), rng.integers(0, len(x), 300)] = 1.0
    pores = 0.1 * 2 * np.pi * (0.05 * FINE) ** 2 * gaussian_filter(pores, 0.05 * FINE)
    images = [
        0.4 * (1 + 0.05 * np.cos(phase) + 0.06 * np.sin(phase + turn) - pores)
        for turn in (-0.3, 0.3, 2.8, 3.4)
    ]
    return np.stack([at_scale(image, px_per_mm) for image in images]).astype(np.float32)


def at_scale(image, px_per_mm):
    return zoom(gaussian_filter(image, 0.35 * FINE / px_per_mm), px_per_mm / FINE, order=1)


def marked(px_per_mm, number, diameter_mm, factor):
    """The patch with discs of `factor` times its brightness, the same in every image."""
    rng = np.random.default_rng(3)
    rows, columns = (round(side * FINE) for side in SIZE_MM)
    cover = np.ones((rows, columns))
    reach = int(0.5 * diameter_mm * FINE) + 1
    at = np.arange(-reach, reach + 1)
    disc = np.hypot(*np.meshgrid(at, at)) <= 0.5 * diameter_mm * FINE
    for _ in range(number):
        row, column = rng.integers(reach, rows - reach), rng.integers(reach, columns - reach)
        cover[row - reach : row + reach + 1, column - reach : column + reach + 1][disc] = factor
    return skin(px_per_mm) * at_scale(cover, px_per_mm).astype(np.float32)


def fractions(stack, px_per_mm):
    quality = capture_quality(stack, np.ones(stack.shape[1:], bool), px_per_mm)
    return quality["dark_specks"], quality["bright_specks"]


@pytest.mark.parametrize("px_per_mm", [12.0, 17.0, 26.0, 44.0])
def test_dark_specks_are_measured_at_every_scale(px_per_mm):
    clean = fractions(skin(px_per_mm), px_per_mm)
    assert max(clean) < 0.0005
    little = fractions(marked(px_per_mm, 300, 0.1, 0.3), px_per_mm)
    more = fractions(marked(px_per_mm, 900, 0.1, 0.3), px_per_mm)
    assert little[0] > 0.01
    assert 1.7 * little[0] < more[0] < 0.1
    assert little[1] < 0.0005


def test_the_fraction_of_specks_hardly_depends_on_the_scale():
    dark = [fractions(marked(px, 600, 0.12, 0.3), px)[0] for px in (12.0, 18.0, 26.0, 44.0)]
    assert max(dark) < 1.35 * min(dark)


def test_bright_specks_are_measured_apart_from_dark_ones():
    dark, bright = fractions(marked(24.0, 120, 0.25, 1.5), 24.0)
    assert bright > 0.01
    assert dark < 0.001


def test_long_marks_are_no_specks():
    y, x = (np.arange(round(side * 24.0)) / 24.0 for side in SIZE_MM)
    stack = skin(24.0)
    for slope, offset, width, depth in (
        (0.3, 2.0, 0.05, 0.8),
        (-1.2, 9.0, 0.06, 0.8),
        (0.02, 7.0, 0.3, 0.5),
    ):
        away = np.abs(y[:, None] - offset - slope * x[None, :]) / np.hypot(1.0, slope)
        stack = stack * (1 - depth * np.clip(1.5 - away / width, 0, 1)).astype(np.float32)
    assert fractions(stack, 24.0)[0] < 0.002


def test_glare_that_turns_with_the_light_is_no_speck():
    # other places in every image
    glints = np.random.default_rng(1).random(skin(24.0).shape) < 0.003
    glary = skin(24.0) + 3.0 * gaussian_filter(glints.astype(np.float32), (0, 1, 1))
    assert fractions(glary, 24.0)[1] < 0.001
    same = skin(24.0) + 3.0 * gaussian_filter(glints[:1].astype(np.float32), (0, 1, 1))
    assert fractions(same, 24.0)[1] > 0.01


def test_coarse_images_are_not_measured():
    quality = capture_quality(skin(11.0), np.ones((154, 132), bool), 11.0)
    assert quality["dark_specks"] is None and quality["bright_specks"] is None
    assert not any("specks" in str(text) for text in quality_findings(quality))


def test_specks_do_not_depend_on_the_brightness():
    stack = marked(24.0, 300, 0.1, 0.3)
    uneven = stack * np.array([0.2, 1.0, 0.5, 0.8], np.float32)[:, None, None]
    assert fractions(uneven, 24.0) == pytest.approx(fractions(stack, 24.0), abs=1e-5)


def test_specks_are_named_once_with_a_remedy():
    for marks, code, remedy in (
        ((300, 0.1, 0.3), "dark-specks", "wipe the finger"),
        ((120, 0.25, 1.5), "bright-specks", "moisten"),
    ):
        quality = capture_quality(marked(24.0, *marks), np.ones((336, 288), bool), 24.0)
        (finding,) = (each for each in quality_findings(quality) if "specks" in each.code)
        assert finding.code == code and remedy in str(finding)
