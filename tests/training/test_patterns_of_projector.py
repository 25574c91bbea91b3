"""Separation of the twin's skin, in which light spreads: against its noise-free truth at the same
check size."""

import sys
from pathlib import Path

import numpy as np
import pytest

from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import SkinOptics

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from patterns import checkerboard
from projector import Checkerboard, checkerboard_stack, pattern_states, separate_truth

CHECK_MM, PX_PER_MM = 0.4, 20.0
"""Radiance in the rig's units does not clip."""


@pytest.fixture(scope="module")
def skin():
    """25 images (N, H, W, 3) of 5 x 4 mm of a finger's pad, the states of its pixels, and the
    truth, white = 1."""
    camera = Camera(PX_PER_MM, (80, 100))
    pad = finger_surface(draw_finger(11, "whorl"), FingerPose(insertion_mm=10.0), camera, workers=1)
    led, pattern = default_rig().leds[1], Checkerboard(CHECK_MM)
    options = {"settings": RenderSettings(reach_mm=3.0)}
    truth = separate_truth(pad, led, SkinOptics(), check_mm=CHECK_MM, **options)
    white = float(truth.white.max())
    stack = (
        checkerboard_stack(pad, led, SkinOptics(), pattern, **options).transpose(0, 2, 3, 1) / white
    )
    direct, global_ = (part.transpose(1, 2, 0) / white for part in (truth.direct, truth.global_))
    return stack, pattern_states(pad, led, pattern), direct, global_


def decibels(estimated, truth):
    return 10 * np.log10(1 / np.mean(np.square(estimated - truth), axis=(0, 1)))


def test_noise_free_light_of_skin_is_separated(skin):
    stack, _, direct, global_ = skin
    parts = checkerboard(stack, clip_level=None)
    assert decibels(parts.direct, direct).min() > 46  # 49.5 to 50.8 measured on a larger patch
    assert decibels(parts.global_, global_).min() > 40
