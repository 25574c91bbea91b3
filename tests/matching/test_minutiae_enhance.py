"""Enhancement of pressed prints: ridges come out of noise, and nothing comes out of nothing."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.matching.minutiae import enhance_print


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
    image = np.clip(np.where(inside, 130 + 60 * wave, 250) + noise * inside, 0, 255).astype(np.uint8)
    better = enhance_print(image).astype(float)
    core = np.hypot(*(np.mgrid[0:160, 0:180] - np.array([80, 90])[:, None, None])) < 45
    before = np.corrcoef(image[core], wave[core])[0, 1]
    after = np.corrcoef(better[core], wave[core])[0, 1]
    assert before < 0.65
    assert after > 0.9


def test_gaps_close() -> None:
    wave = waves(20, 9.0)
    image = np.where(wave != 0, 140 + 90 * wave, 250)
    image[78:82] = 250  # a scratch of 0.2 mm
    better = enhance_print(image.astype(np.uint8)).astype(float)
    across = np.s_[78:82, 50:130]
    assert np.corrcoef(better[across].ravel(), wave[across].ravel())[0, 1] > 0.85


@pytest.mark.parametrize("level", [0, 128, 255])
def test_nothing_comes_out_of_nothing(level: int) -> None:
    assert enhance_print(np.full((70, 90), level, np.uint8)).min() > 245


def test_paper_stays_white() -> None:
    image = np.where(waves(0, 9.0) != 0, 140 + 90 * waves(0, 9.0), 250).astype(np.uint8)
    better = enhance_print(image)
    y, x = np.mgrid[0:160, 0:180]
    assert better[np.hypot(x - 90, y - 80) > 85].min() > 200


def test_the_same_bytes_each_time() -> None:
    image = np.random.default_rng(3).integers(0, 256, (200, 170)).astype(np.uint8)
    assert np.array_equal(enhance_print.__wrapped__(image), enhance_print.__wrapped__(image))
