"""A capture by a calibrated rig says which LED is no longer as bright as it was."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from splitknit.model import Capture
from splitknit.pipeline import reconstruct


def warnings_of(capture: Capture, changes: dict[int, float], provenance: dict[str, Any]) -> list[str]:
    """Warnings of a capture whose rig file has other intensities than the LEDs had."""
    leds = tuple(replace(led, intensity=led.intensity * changes.get(k, 1.0)) for k, led in enumerate(capture.rig.leds))
    rig = replace(capture.rig, leds=leds, provenance=provenance)
    result = reconstruct(replace(capture, rig=rig), "ea")
    return [text for text in result.warnings if "calibration" in text]


def test_an_led_that_got_darker_is_named(twin_capture: Capture) -> None:
    words = warnings_of(twin_capture, {9: 1 / 0.9}, {"radiometry": {"calibrated": True}})
    assert len(words) == 1
    assert twin_capture.bands["nir"].image_names[2] in words[0]
    assert "darker than at the calibration" in words[0]


def test_nothing_is_said_of_a_rig_that_holds_or_was_never_calibrated(twin_capture: Capture) -> None:
    assert warnings_of(twin_capture, {}, {"radiometry": {"calibrated": True}}) == []
    assert warnings_of(twin_capture, {9: 1 / 0.9}, {}) == []
