"""Noise: the electrons that were put in come out."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit_rig.calibration.sensor import noise_model, noise_samples
from splitknit_simulator.camera.sensor import SensorSettings, record


@pytest.mark.parametrize("bits", [8, 16])
def test_noise_tells_the_electrons(bits):
    """A ramp of light through the twin's sensor; green is neither amplified nor damped by the white balance."""
    sensor = SensorSettings(bits=bits, raw_bits=14 if bits == 16 else 10)
    light = np.repeat(np.tile(np.linspace(0.05, 0.85, 480, dtype=np.float32), (320, 1))[..., None], 3, axis=2)
    shot = record(light, "white", np.random.SeedSequence(1), sensor)
    found = noise_model(*noise_samples(shot, 1))
    assert found is not None
    assert found.electrons == pytest.approx(sensor.full_well_e, rel=0.08)
    assert found.span[1] > 0.7
    blue = noise_model(*noise_samples(shot, 2))
    assert blue is not None
    assert blue.electrons == pytest.approx(0.47 * sensor.full_well_e, rel=0.08)


def test_noise_without_a_range_of_light_tells_nothing():
    flat = np.full((240, 240, 3), 0.4, dtype=np.float32)
    shot = record(flat, "white", np.random.SeedSequence(2), SensorSettings())
    assert noise_model(*noise_samples(shot, 1)) is None
    assert noise_model([0.1], [0.1]) is None
