"""Dark frames and noise: levels, hot pixels and electrons that were put in come out."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_rig.calibration.sensor import dark_frames, noise_model, noise_samples
from splitknit_simulator.camera.sensor import SensorSettings, record

SIZE = (150, 220)
FULL = 65535
PATTERN = 0.002 * np.random.default_rng(9).standard_normal((*SIZE, 3))
COLUMNS = 0.001 * np.random.default_rng(8).standard_normal((1, SIZE[1], 1))


def frame(seed, *, sigma=0.004, pattern=0.0, columns=0.0, hot=(), level=0.06):
    values = level + sigma * np.random.default_rng(seed).standard_normal((*SIZE, 3))
    values = values + pattern * PATTERN + columns * COLUMNS
    for row, column in hot:
        values[row, column, 1] += 0.2
    return np.round(np.clip(values, 0, 1) * FULL).astype(np.uint16)


def test_level_and_noise():
    found = dark_frames([frame(0)])
    assert found.black_level == pytest.approx([0.06] * 3, abs=1e-4)
    assert found.read_noise == pytest.approx([0.004] * 3, rel=0.03)
    assert found.hot_pixels == 0
    assert found.row_noise < 1e-4 and found.column_noise < 1e-4
    assert found.fixed_pattern is None


def test_hot_pixels_are_counted_and_do_not_raise_the_level():
    places = [(3, 4), (70, 100), (149, 219)]
    found = dark_frames([frame(1, hot=places)])
    assert found.hot_pixels == 3
    assert found.hot_share == pytest.approx(3 / (SIZE[0] * SIZE[1]))
    assert found.black_level == pytest.approx([0.06] * 3, abs=1e-4)


def test_several_frames_tell_pattern_from_noise():
    frames = [frame(seed, pattern=1.0) for seed in range(4)]
    found = dark_frames(frames)
    assert found.frames == 4
    assert found.read_noise == pytest.approx([0.004] * 3, rel=0.03)
    assert found.fixed_pattern == pytest.approx(0.002, rel=0.1)
    assert dark_frames(frames[:1]).read_noise == pytest.approx([np.hypot(0.004, 0.002)] * 3, rel=0.05)


def test_stripes():
    found = dark_frames([frame(2, columns=1.0)])
    assert found.column_noise == pytest.approx(0.001, rel=0.2)
    assert found.row_noise < 2e-4


def test_levels_that_are_cut_off_hide_the_noise():
    assert dark_frames([frame(3, level=0.0)]).read_noise is None


def test_light_on_a_dark_frame_is_refused():
    lit = frame(4)
    lit[:, 150:] += 4000
    with pytest.raises(BadInput, match=r"dark\.png is not dark: .* differs by 6\.. % across .*; cover the lens"):
        dark_frames([lit], name="dark.png")
    with pytest.raises(BadInput, match=r"level is 60\.0 %"):
        dark_frames([frame(5, level=0.6)])
    with pytest.raises(BadInput, match="differ in size"):
        dark_frames([frame(5), frame(5)[:-1]])


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
