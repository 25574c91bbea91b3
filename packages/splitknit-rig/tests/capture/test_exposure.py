"""Exposure is found on the brightest LED, clipping handled, within what the camera can."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit.devices import ExposureRange, Frame
from splitknit_rig.capture.exposure import ExposureSettings, find_exposure, survey

CAMERA = ExposureRange(1e-4, 0.2, 1.0, 8.0)
SETTINGS = ExposureSettings()
REGION = np.zeros((20, 20), dtype=bool)
REGION[5:15, 5:15] = True


class Bench:
    """A grey patch that LED k lights with `light[k]` a second; counts what is looked at."""

    def __init__(self, light, room=0.0):
        self.light, self.room, self.looks = light, room, []

    def __call__(self, led, exposure_s, gain):
        self.looks.append((led, exposure_s, gain))
        value = np.clip(255 * (self.light[led] + self.room) * exposure_s * gain, 0, 255)
        pixels = np.zeros((20, 20, 3), dtype=np.uint8)
        pixels[REGION] = np.rint(value * np.array([1.0, 0.8, 0.5]))
        return Frame(pixels, exposure_s, gain)

    def find(self, settings=SETTINGS):
        seen = survey(self, list(self.light), CAMERA, settings)
        room = self.room * seen.exposure_s * seen.gain
        dark = Frame(np.zeros((20, 20, 3), dtype=np.uint8), seen.exposure_s, seen.gain)
        dark.pixels[REGION] = np.rint(255 * room * np.array([1.0, 0.8, 0.5]))
        return find_exposure(self, seen, REGION, CAMERA, settings).promising(seen, dark)


@pytest.mark.parametrize("strength", [0.35, 2.0, 20.0, 200.0, 2000.0])
def test_the_brightest_led_reaches_the_target_at_any_strength(strength):
    bench = Bench({4: strength, 5: 1.4 * strength, 6: 0.5 * strength})
    exposure = bench.find()
    assert exposure.brightest == 5
    reached = 1.4 * strength * exposure.exposure_s * exposure.gain
    if strength > 1.0:
        # a step lower where the survey, whose frames must not look alike, had this exposure
        assert reached == pytest.approx(0.7, rel=0.08) or reached == pytest.approx(0.6, rel=0.08)
        assert exposure.level == pytest.approx(reached, abs=0.01)
    else:  # all that the camera can
        assert (exposure.exposure_s, exposure.gain) == (0.066, 8.0)
    assert exposure.light[4].mean() == pytest.approx(exposure.light[5].mean() / 1.4, rel=0.1)
    assert len(bench.looks) < 40


def test_light_beyond_the_range_of_exposures_is_refused():
    with bad_input(r"overexposed even with the shortest.*lid"):
        Bench({0: 5e4, 1: 5e4}).find()
    with bad_input("nothing is seen under any LED"):
        Bench({0: 1e-3, 1: 1e-3}).find()
    with bad_input("too dark: with 66 ms at gain 8"):
        Bench({0: 0.3, 1: 0.3}).find()


def test_the_target_is_reached_and_ambient_light_subtracted_from_expectations():
    exposure = Bench({0: 10.0, 1: 9.0}, room=2.0).find(ExposureSettings(target=0.4))
    assert exposure.level == pytest.approx(0.4, rel=0.07)
    assert exposure.light[0].max(axis=(0, 1)) == pytest.approx([10.0, 8.0, 5.0], rel=0.07)


@pytest.mark.parametrize("wrong", [{"target": 0.0}, {"target": 0.99}, {"longest_s": 0}])
def test_exposure_settings_out_of_range_are_refused(wrong):
    with bad_input("exposure"):
        ExposureSettings(**wrong)
