"""Denoising by patches: keeps waves, takes noise, knows what is left."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.skin import relief as relief_module
from splitknit.skin.relief import _OVERLAP, _local_wiener, _window_power, _window_px

PITCH = 0.05
SIDE = _window_px(PITCH)
SHAPE = (190, 210)
INNER = np.s_[SIDE // 2 : -SIDE // 2, SIDE // 2 : -SIDE // 2]


def white(seed, sigma=1.0, shape=SHAPE):
    return (sigma * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32)


def wave(amplitude=1.0):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH
    return (amplitude * np.sin(14.0 * (0.8 * x + 0.6 * y) + 0.3 * np.sin(x))).astype(np.float32)


def test_window_covers_the_stated_length_in_whole_steps():
    assert SIDE == 32
    assert SIDE % _OVERLAP == 0
    assert abs(_window_px(0.01) - 170) <= 2
    assert _window_px(1.0) == 16


def test_window_power_of_white_noise_is_flat_and_that_of_the_window():
    hann = np.sin(np.pi * (np.arange(SIDE) + 0.5) / SIDE) ** 2
    power = _window_power(white(0, 2.0, (900, 900)), SIDE)
    assert power.shape == (SIDE, SIDE // 2 + 1)
    assert power.dtype == np.float32
    assert power.mean() == pytest.approx(4.0 * hann.sum() ** 2, rel=0.03)
    assert power.std() / power.mean() < 0.15


def test_a_strong_wave_passes():
    noise = _window_power(white(0, 0.05, (500, 500)), SIDE)
    clean, deviation = _local_wiener(wave(), noise)
    true, found = wave()[INNER], clean[INNER]
    assert (true * found).sum() / (true * true).sum() > 0.97
    assert np.sqrt(((true - found) ** 2).mean()) < 0.05
    assert deviation.min() >= 0


def test_white_noise_of_known_power_goes(monkeypatch):
    noise = _window_power(white(0, 1.0, (500, 500)), SIDE)
    clean, _ = _local_wiener(white(5), noise)
    assert clean[INNER].std() < 0.2
    monkeypatch.setattr(relief_module, "_CAUTION", 0.0)
    bold, _ = _local_wiener(white(5), noise)
    assert clean[INNER].std() < 0.6 * bold[INNER].std()


def test_noise_around_a_wave_goes():
    sigma = 0.3
    noise = _window_power(white(0, sigma, (500, 500)), SIDE)
    clean, _ = _local_wiener(wave() + white(6, sigma), noise)
    assert np.sqrt(((clean - wave())[INNER] ** 2).mean()) < sigma / 2


def test_without_noise_nothing_changes():
    relief = wave() + white(3, 0.2)
    clean, deviation = _local_wiener(relief, np.zeros((SIDE, SIDE // 2 + 1), np.float32))
    np.testing.assert_allclose(clean, relief, atol=1e-4)
    assert deviation.max() == 0


@pytest.mark.parametrize("sigma", [0.1, 0.5, 2.0])
def test_nothing_is_amplified(sigma):
    noise = _window_power(white(0, sigma, (500, 500)), SIDE)
    relief = wave(0.7) + white(8, 0.4)
    clean, _ = _local_wiener(relief, noise)
    assert clean[INNER].std() <= relief[INNER].std()
    spectrum = np.abs(np.fft.rfft2(clean[INNER])) ** 2
    assert spectrum.sum() <= (np.abs(np.fft.rfft2(relief[INNER])) ** 2).sum()


@pytest.mark.parametrize("sigma", [0.1, 0.3, 0.6])
def test_deviation_is_the_error_that_is_left(sigma):
    noise = _window_power(white(0, sigma, (500, 500)), SIDE)
    errors, told = [], []
    for seed in (11, 12):
        clean, deviation = _local_wiener(wave() + white(seed, sigma), noise)
        errors.append(((clean - wave())[INNER] ** 2).mean())
        told.append((deviation[INNER] ** 2).mean())
    assert np.sqrt(np.mean(told)) == pytest.approx(np.sqrt(np.mean(errors)), rel=0.3)


def test_same_bytes_every_time():
    noise = _window_power(white(0, 0.3), SIDE)
    relief = wave() + white(2, 0.3)
    first, again = (_local_wiener(relief, noise) for _ in range(2))
    assert first[0].tobytes() == again[0].tobytes()
    assert first[1].tobytes() == again[1].tobytes()
    assert first[0].dtype == first[1].dtype == np.float32
    assert first[0].shape == first[1].shape == SHAPE


@pytest.mark.parametrize("shape", [(20, 90), (33, 33), (53, 61)])
def test_any_size_of_image_works(shape):
    noise = _window_power(white(0, 0.3), SIDE)
    clean, deviation = _local_wiener(wave()[: shape[0], : shape[1]], noise)
    assert clean.shape == deviation.shape == shape
    assert np.isfinite(clean).all()
    assert np.isfinite(deviation).all()


def test_image_smaller_than_the_window_has_no_spectrum():
    with pytest.raises(BadInput, match="at least 32 pixels"):
        _window_power(np.zeros((40, 30), np.float32), SIDE)
