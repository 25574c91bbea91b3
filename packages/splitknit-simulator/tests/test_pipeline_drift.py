"""A capture by a calibrated rig says which LED is no longer as bright as it was."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.model import Capture
from splitknit.pipeline import reconstruct


def said(capture: Capture, changes: dict[int, float], provenance: dict[str, Any]) -> tuple[list[str], dict[str, Any]]:
    """Warnings of a capture whose rig file has other intensities than the LEDs had."""
    leds = tuple(replace(led, intensity=led.intensity * changes.get(k, 1.0)) for k, led in enumerate(capture.rig.leds))
    rig = replace(capture.rig, leds=leds, provenance=provenance)
    result = reconstruct(replace(capture, rig=rig), "ea")
    return [text for text in result.warnings if "calibration" in text], dict(result.quality)


def test_an_led_that_got_darker_is_named(twin_capture: Capture) -> None:
    words, quality = said(twin_capture, {9: 1 / 0.9}, {"radiometry": {"calibrated": True}})
    assert len(words) == 1
    assert words[0].startswith("nir band: LED nir 2 is")
    assert "darker than at the calibration" in words[0]
    assert np.argmin(quality["nir"]["light_drift"]["gain"]) == 2


def test_nothing_is_said_of_a_rig_that_holds_or_was_never_calibrated(twin_capture: Capture) -> None:
    words, quality = said(twin_capture, {}, {"radiometry": {"calibrated": True}})
    assert words == []
    assert np.abs(np.array(quality["white"]["light_drift"]["gain"]) - 1).max() < 0.03
    words, quality = said(twin_capture, {9: 1 / 0.9}, {})
    assert words == []
    assert "light_drift" not in quality["nir"]
