"""Noise, levels and encodings of the simulated sensor."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit.observation.stored import decode_table
from splitknit_simulator.camera.sensor import RESPONSE, SensorSettings, record


def _grey(value, size=128):
    return np.full((size, size, 3), value, dtype=np.float32)


def _ramp(levels):
    return np.linspace(0, 1, levels, dtype=np.float32)[None, :, None].repeat(3, axis=2)


def _stored(light, seed=0, band="white", **settings):
    return record(light, band, np.random.SeedSequence(seed), SensorSettings(**settings))


def test_without_noise_the_light_is_only_quantised():
    stored = _stored(_ramp(256), noise=False)
    assert stored.dtype == np.uint8
    assert np.abs(stored.astype(int) - np.arange(256)[None, :, None]).max() <= 1
    assert np.unique(_stored(_ramp(256), noise=False, bits=16)).size > 256


def test_raw_bits_limit_the_levels_of_16_bit_images():
    stored = _stored(_ramp(5000), noise=False, bits=16)
    assert np.unique(stored[..., 1]).size == 1024
    assert np.unique(stored[..., 2]).size < 600  # blue pixels fill less than half of their range


@pytest.mark.parametrize("level", [0.01, 0.6])
def test_noise_is_shot_and_read_noise(level):
    settings = SensorSettings(bits=16, raw_bits=16)
    stored = record(_grey(level), "white", np.random.SeedSequence(1), settings) / 65535.0
    for c, response in enumerate(RESPONSE["white"]):
        electrons = level * response * settings.full_well_e
        expected = np.sqrt(electrons + settings.read_noise_e**2) / (response * settings.full_well_e)
        assert stored[..., c].std() == pytest.approx(expected, rel=0.05)
        assert stored[..., c].mean() == pytest.approx(level, rel=0.02)
    assert stored[..., 2].std() > stored[..., 1].std()
    pair = np.corrcoef(stored[..., 0].ravel(), stored[..., 1].ravel())[0, 1]
    assert abs(pair) < 0.05


def test_binned_pixels_are_less_noisy():
    settings = SensorSettings(bits=16, raw_bits=16)
    full = record(_grey(0.5), "nir", np.random.SeedSequence(1), settings).std()
    half = record(_grey(0.5), "nir", np.random.SeedSequence(1), settings, scale=0.5).std()
    assert half == pytest.approx(full / 2, rel=0.1)


def test_overexposure_clips_to_white():
    assert (_stored(_grey(3.0), 2) == 255).all()


def test_srgb_decodes_to_the_same_light():
    light = _grey(0.2)
    linear, srgb = (_stored(light, 3, bits=16, encoding=code) for code in ("linear", "srgb"))
    table = decode_table(srgb.dtype, "srgb")
    np.testing.assert_allclose(table[srgb], linear / 65535.0, atol=2e-5)


def test_noise_depends_on_the_seed():
    first, again, different = (_stored(_grey(0.5), seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != different).mean() > 0.3


def test_wrong_settings_and_shapes_are_refused():
    for bad in ({"bits": 12}, {"encoding": "rec709"}, {"exposure": 0.0}, {"full_well_e": 1.0}):
        with bad_input(f"sensor.{next(iter(bad))}"):
            SensorSettings(**bad)
    with bad_input(r"\(H, W, 3\)"):
        record(np.zeros((4, 4), np.float32), "white", np.random.SeedSequence(0))
