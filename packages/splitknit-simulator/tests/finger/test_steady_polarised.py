"""A finger that moved between its two polarised series."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import splitknit_simulator
from splitknit.finger.steady import find_steady_finger
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings
from splitknit.settings import override

METRIC = preset_settings("metric")
MOVED_MM = (0.15, -0.1)
"""Right and up."""


def moved(capture, right_mm, up_mm):
    """With the crossed images shifted."""
    px = capture.rig.camera.px_per_mm
    turn = np.array([[1.0, 0.0, right_mm * px], [0.0, 1.0, -up_mm * px]])
    band = capture.bands["white_crossed"]
    size = capture.shape[::-1]
    pixels = [
        cv2.warpAffine(image, turn, size, flags=cv2.INTER_CUBIC, borderMode=1)
        for image in band.pixels
    ]
    crossed = replace(band, pixels=np.stack(pixels).reshape(band.pixels.shape))
    return replace(capture, bands={**capture.bands, "white_crossed": crossed})


@pytest.fixture(scope="module")
def polarised():
    """A finger without specular reflection, as crossed films show it, and with it."""
    glossy, matt = (
        splitknit_simulator.simulate_capture(
            3, settings={"scale": 0.2, "skin.glare": [strength, strength]}
        )[0]
        for strength in (1.0, 0.0)
    )
    white, dark = glossy.bands["white"], matt.bands["white"]
    polarised = {
        "white": replace(white, polarisation="parallel"),
        "white_crossed": replace(dark, name="white_crossed", polarisation="crossed"),
    }
    return replace(glossy, bands={**polarised, "nir": glossy.bands["nir"]})


def test_a_still_finger_is_unchanged(polarised):
    light = observe(polarised)
    steady, finger = find_steady_finger(light, METRIC)
    assert steady is light
    assert finger.facts["motion"]["most_mm"] < 0.01
    assert len(finger.facts["motion_white_crossed"]["moved_mm"]) == 7
    assert not any("moved" in finding.code for finding in finger.findings)


@pytest.mark.slow
def test_motion_between_the_series_is_undone(polarised):
    apart = observe(moved(polarised, *MOVED_MM))
    steady, finger = find_steady_finger(apart, METRIC)
    shift_mm = np.array(finger.facts["motion_white_crossed"]["shift_mm"])
    np.testing.assert_allclose(shift_mm, np.broadcast_to(MOVED_MM, shift_mm.shape), atol=0.01)
    assert any(
        "between the parallel and the crossed series; that was undone" in str(note)
        for note in finger.findings
    )
    assert steady.bands["white"] is apart.bands["white"]
    assert "motion_white" not in finger.facts
    still, *pixels = (
        each.bands["white_crossed"].grey[0] for each in (observe(polarised), apart, steady)
    )
    before, after = (np.abs(each - still)[finger.mask].mean() for each in pixels)
    assert after < 0.3 * before


@pytest.mark.slow
def test_motion_is_measured_where_correction_is_off(polarised):
    apart = observe(moved(polarised, *MOVED_MM))
    steady, finger = find_steady_finger(apart, override(METRIC, {"motion.correct": "off"}))
    assert steady is apart
    assert finger.facts["motion"]["most_mm"] == pytest.approx(np.hypot(*MOVED_MM), abs=0.01)
    assert any(
        str(note).endswith("between the parallel and the crossed series.")
        for note in finger.findings
    )
