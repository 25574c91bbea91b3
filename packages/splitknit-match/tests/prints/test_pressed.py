"""Enhancement of pressed prints: ridges come out of noise, and nothing comes out of nothing."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit_match.prints.pressed import pressed_ridges


def waves(angle_deg: float, period_px: float, shape: tuple[int, int] = (160, 180)) -> np.ndarray:
    """Ridges of one direction: 1 on valleys, -1 on ridges, in a round patch (0 outside)."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    along = np.deg2rad(angle_deg)
    wave = np.cos(2 * np.pi * (np.cos(along) * x + np.sin(along) * y) / period_px)
    return np.where(np.hypot(x - 90, y - 80) < 60, wave, 0.0)


@pytest.mark.parametrize("angle_deg", [0, 35, 90, 150])
@pytest.mark.parametrize("period_px", [7.0, 9.0, 12.0])
def test_ridges_come_out_of_noise(angle_deg: float, period_px: float) -> None:
    wave = waves(angle_deg, period_px)
    inside = wave != 0
    noise = np.random.default_rng(0).normal(0, 80, wave.shape)
    image = np.clip(np.where(inside, 130 + 60 * wave, 250) + noise * inside, 0, 255).astype(
        np.uint8
    )
    better = pressed_ridges(image).image.astype(float)
    core = np.hypot(*(np.mgrid[0:160, 0:180] - np.array([80, 90])[:, None, None])) < 45
    before = np.corrcoef(image[core], wave[core])[0, 1]
    after = np.corrcoef(better[core], wave[core])[0, 1]
    assert before < 0.65
    assert after > 0.9


def test_a_print_on_its_side_is_the_same() -> None:
    noise = np.random.default_rng(1).normal(0, 60, (160, 160))
    image = np.clip(130 + 60 * waves(0, 9.0, (160, 160)) + noise, 0, 255).astype(np.uint8)
    upright, lying = pressed_ridges(image), pressed_ridges(np.ascontiguousarray(np.rot90(image)))
    core = np.s_[30:130, 40:130]
    there = np.rot90(lying.confidence, -1)[core]
    assert upright.confidence[core].mean() == pytest.approx(there.mean(), rel=0.01)


def test_gaps_close() -> None:
    wave = waves(20, 9.0)
    image = np.where(wave != 0, 140 + 90 * wave, 250)
    image[78:82] = 250  # a scratch of 0.2 mm
    better = pressed_ridges(image.astype(np.uint8)).image.astype(float)
    across = np.s_[78:82, 50:130]
    assert np.corrcoef(better[across].ravel(), wave[across].ravel())[0, 1] > 0.85


@pytest.mark.parametrize("level", [0, 128, 255])
def test_nothing_comes_out_of_nothing(level: int) -> None:
    assert pressed_ridges(np.full((70, 90), level, np.uint8)).image.min() > 245


def test_paper_stays_white() -> None:
    image = np.where(waves(0, 9.0) != 0, 140 + 90 * waves(0, 9.0), 250).astype(np.uint8)
    better = pressed_ridges(image).image
    y, x = np.mgrid[0:160, 0:180]
    assert better[np.hypot(x - 90, y - 80) > 85].min() > 200


def test_the_same_bytes_each_time() -> None:
    image = np.random.default_rng(3).integers(0, 256, (200, 170)).astype(np.uint8)
    assert np.array_equal(pressed_ridges(image).image, pressed_ridges(image).image)


def patch(wave: np.ndarray) -> np.ndarray:
    return np.where(wave != 0, 140 + 90 * wave, 250)


def test_the_sensors_frame_is_no_ridge() -> None:
    rows, columns = np.mgrid[0:300, 0:260]
    window = np.abs(columns - 130) < 60 + 0.2 * rows
    print_ = np.where(
        np.hypot(columns - 130, rows - 130) < 55, 150 - 50 * np.cos(2 * np.pi * rows / 9), 190
    )
    image = (
        np.where(window, print_, 255) + np.random.default_rng(1).normal(0, 3, window.shape) * window
    )
    found = pressed_ridges(np.clip(image, 0, 255).astype(np.uint8))
    away = np.hypot(columns - 130, rows - 130) > 80
    assert found.inside[130, 130]
    assert not found.inside[away].any()
    assert found.image[away].min() == 255


def test_the_direction_that_continues_the_surroundings_is_taken() -> None:
    """In a patch of 2 mm ridges are a sixth as high as in the surroundings, and strong scratches
    cross them."""
    rows, columns = np.mgrid[0:240, 0:240]
    wave = np.cos(2 * np.pi * (0.8 * columns + 0.6 * rows) / 9)
    spot = np.hypot(columns - 120, rows - 120) < 20
    scratches = 100 * np.clip(np.cos(2 * np.pi * (0.6 * columns - 0.8 * rows) / 11) - 0.2, 0, 1)
    image = np.where(spot, 90 + 12 * wave + scratches, 140 + 70 * wave)
    image = np.clip(image + np.random.default_rng(2).normal(0, 6, wave.shape), 0, 255).astype(
        np.uint8
    )
    better = pressed_ridges(image)
    assert np.corrcoef(better.image[spot], wave[spot])[0, 1] > 0.9
    assert better.confidence[spot].mean() < 0.75 * better.confidence[~spot & better.inside].mean()


def test_traces_of_another_print_are_left_out() -> None:
    wave = waves(20, 9.0, (160, 400))
    trace = np.where(np.arange(400) > 200, 6 * np.cos(2 * np.pi * np.mgrid[0:160, 0:400][0] / 9), 0)
    found = pressed_ridges(np.round(patch(wave) - 8 + trace).astype(np.uint8))
    assert found.inside[80, 90]
    assert not found.inside[:, 230:].any()


@pytest.mark.parametrize("sigma", [0, 160])
def test_confidence_is_that_of_ridges(sigma: float) -> None:
    wave = waves(50, 9.0)
    noise = np.random.default_rng(4).normal(0, sigma, wave.shape) * (wave != 0)
    sure = pressed_ridges(np.clip(patch(wave) + noise, 0, 255).astype(np.uint8)).confidence[
        60:100, 70:110
    ]
    assert (sure.min() > 0.9) if sigma == 0 else (0.2 < sure.mean() < 0.7)


def test_a_border_of_plain_paper_changes_no_ridges() -> None:
    noise = np.random.default_rng(2).normal(0, 110, (200, 200))
    inside = np.pad(np.ones((160, 160), np.bool_), 20)
    image = np.clip(
        np.where(inside, 130 + 60 * waves(30, 9.0, (200, 200)) + noise, 232 + noise / 50), 0, 255
    )
    alone, bordered = (
        pressed_ridges(np.pad(image.astype(np.uint8), size, constant_values=240))
        for size in (0, 80)
    )
    core = np.s_[50:150, 50:150]
    one, other = alone.image[core].astype(float), bordered.image[80:-80, 80:-80][core].astype(float)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.95
