"""The twin's camera and LEDs: timing, light, noise, faults, and scenes of any kind."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.nominal import default_rig
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.camera import device
from splitknit_simulator.camera.device import Clock, TwinCamera, TwinLightBank
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import FingerScene, simulate_capture

QUIET = SensorSettings(noise=False, bits=16, raw_bits=16)


@pytest.fixture(scope="module")
def finger():
    return FingerScene(5, None, TwinSettings(scale=0.08))


def devices(scene, **camera):
    clock = Clock()
    lights = TwinLightBank(scene, clock)
    return TwinCamera(scene, lights, clock, **camera), lights, clock


def test_a_finger_scene_has_the_light_of_simulate_capture(finger):
    """Light of each LED against the twin's own capture of the same finger, exact but for half
    floats."""
    exact = TwinSettings(scale=0.08, sensor=QUIET)
    capture, truth = simulate_capture(5, None, exact)
    assert np.array_equal(np.isfinite(truth["height_mm"]), finger.surface.mask)
    for band, first in (("white", 0), ("nir", 7)):
        exposure = float(truth[f"exposure_{band}"])
        for k in (0, 4):
            images = capture.bands[band]
            stored = images.pixels[k] / 65535 - images.ambient.pixels / 65535
            light = (finger.light([first + k]) - finger.light([])) * exposure
            fits = (images.pixels[k] < 65000).all(axis=-1)
            assert_allclose(light[fits], stored[fits], atol=1e-3)


def test_light_of_leds_adds_over_ambient_light(finger):
    room = finger.light([])
    assert room.min() >= 0
    assert room[finger.surface.mask].mean() > 0
    both = finger.light([2, 9])
    assert_allclose(both - room, finger.light([2]) + finger.light([9]) - 2 * room, atol=1e-5)
    assert finger.light([2])[finger.surface.mask].mean() > 50 * room[finger.surface.mask].mean()
    assert_array_equal(finger.light([]), room)  # asking changes nothing
    with bad_input("no LED 14"):
        finger.light([14])


def test_another_impression_changes_the_pose_alone():
    settings = TwinSettings(scale=0.05)
    first, again, second = (FingerScene(5, None, settings, impression=k) for k in (0, 0, 1))
    assert_array_equal(first.light([0]), again.light([0]))
    assert first.skin == second.skin
    assert not np.array_equal(first.surface.mask, second.surface.mask)


def test_a_finger_scene_has_its_truth(finger):
    truth = finger.truth()
    for name in ("height_mm", "shape_mm", "mask", "normals", "led_intensity", "skin_melanin"):
        assert name in truth


def test_exposure_time_and_gain_scale_the_pixels(finger):
    camera, lights, _ = devices(finger, sensor=QUIET)
    with lights, camera:
        lights.on(3)
        levels = []
        for exposure_s, gain in ((0.002, 1.0), (0.004, 1.0), (0.002, 3.0)):
            camera.lock(exposure_s, gain)
            frame = camera.capture()
            levels.append(
                frame.pixels[finger.surface.mask].mean() / (frame.exposure_s * frame.gain)
            )
        assert levels == pytest.approx([levels[0]] * 3, rel=2e-3)


def test_noise_differs_between_frames_and_repeats_between_runs(finger):
    def run(seed):
        camera, lights, _ = devices(finger, seed=seed)
        with lights, camera:
            lights.on(0)
            return [camera.capture().pixels for _ in range(2)]

    first, second = run(7)
    assert not np.array_equal(first, second)
    for frame, repeated in zip((first, second), run(7), strict=True):
        assert_array_equal(frame, repeated)
    assert not np.array_equal(first, run(8)[0])


def test_a_picture_taken_before_the_led_has_settled_is_dimmer(finger, monkeypatch):
    monkeypatch.setattr(device, "SETTLE_S", 2.0)
    camera, lights, clock = devices(finger, sensor=QUIET)
    with lights, camera:
        camera.capture()
        monkeypatch.setattr(lights, "_wait", lambda seconds: clock.advance(0.5))  # impatient
        lights.on(1)
        early = camera.capture().pixels.mean()
        clock.advance(3.0)
        assert 0.1 < early / camera.capture().pixels.mean() < 0.5


def test_a_frame_takes_settling_exposure_and_readout_time():
    card = CardScene(camera=default_rig(0.05).camera, leds=default_rig(0.05).leds)
    camera, lights, clock = devices(card)
    with lights, camera:
        camera.lock(0.1, 1.0)
        camera.capture()
        before = clock.now_s
        lights.on(0)
        frame = camera.capture()
        # settle, at most a frame to wait, exposure, readout, transfer
        least = 0.02 + 0.1 + 0.0466 + 0.07
        assert least <= clock.now_s - before <= least + 0.101 + 1e-6
        assert frame.at_s == pytest.approx(clock.now_s - 0.07)
    with bad_input("backwards"):
        clock.advance(-1.0)


def test_a_camera_that_is_not_linear_is_refused(finger):
    with bad_input("linear"):
        devices(finger, sensor=SensorSettings(encoding="srgb"))
