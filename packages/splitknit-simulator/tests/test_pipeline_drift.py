"""A capture by a calibrated rig says which LED is no longer as bright as it was."""

from dataclasses import replace

import pytest

from splitknit.observation.observe import observe
from splitknit.pipeline import reconstruct


def drifts(capture, changes, provenance):
    """Drifts in a capture whose rig file has other intensities than the LEDs had."""
    leds = tuple(
        replace(led, intensity=led.intensity * changes.get(k, 1.0))
        for k, led in enumerate(capture.rig.leds)
    )
    rig = replace(capture.rig, leds=leds, provenance=provenance)
    result = reconstruct(replace(capture, rig=rig), "ea")
    return [finding for finding in result.findings if finding.code == "drifted-led"]


@pytest.mark.slow
def test_an_led_that_got_darker_is_named(twin_capture):
    drifted = drifts(twin_capture, {9: 1 / 0.9}, {"radiometry": {"calibrated": True}})
    assert [finding.files for finding in drifted] == [
        (observe(twin_capture).bands["nir"].image_names[2],)
    ]
    assert "darker than at the calibration" in str(drifted[0])


@pytest.mark.slow
def test_a_stable_or_uncalibrated_rig_gets_no_drift_finding(twin_capture):
    assert drifts(twin_capture, {}, {"radiometry": {"calibrated": True}}) == []
    assert drifts(twin_capture, {9: 1 / 0.9}, {}) == []
