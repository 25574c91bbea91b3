"""Fingers whose light was traced through the volume of their skin by nobody on this project."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import splitknit
from forty_lines import BLOCK, blocks, forty_lines, surface_rms_mm
from script_folder import VALIDATION, scripts_of
from splitknit.capture import Capture
from splitknit.observation.observe import observe

pytestmark = pytest.mark.slow

FINGERS = ("loop", "print")
EDGE_MM = 0.33


@dataclass(frozen=True, eq=False)
class Traced:
    """A capture, its truth, and the figures of what `metric` makes of it."""

    name: str
    capture: Capture
    truth: dict[str, np.ndarray]
    score: dict[str, float]


@pytest.fixture(scope="module", params=FINGERS)
def traced(request, data_dir):
    folder = data_dir / "path_traced" / request.param
    with np.load(folder.with_name(f"{request.param}_truth.npz")) as file:
        truth = {name: file[name] for name in file.files}
    capture = splitknit.read_capture(folder)
    result = splitknit.reconstruct(capture)
    fields = {name: getattr(result, name) for name in ("height_mm", "mask", "uncertainty_um")}
    with scripts_of(VALIDATION / "path_traced") as script:
        score = script("score").score(fields, truth)
    return Traced(request.param, capture, truth, score)


def baseline_rms_mm(traced):
    """Root mean square error of the forty lines."""
    mask, rig = traced.truth["mask"], traced.capture.rig
    whole = (slice(0, mask.shape[0]), slice(0, mask.shape[1]))
    red = observe(traced.capture).white.at(1, whole).stack[0]
    leds = [rig.leds[k] for k in range(len(red))]
    places, powers = (
        np.array([led.position_mm for led in leds]),
        np.array([led.intensity for led in leds]),
    )
    pitch = rig.camera.pitch_mm
    height, inside = forty_lines(red, places, powers, mask, pitch)
    true = blocks(traced.truth["height_mm"].astype(float))
    return surface_rms_mm(height, true, inside, EDGE_MM, pitch * BLOCK)


@pytest.mark.slow
def test_the_surface_is_better_than_forty_lines(traced, request):
    if traced.name == "loop":
        why = "0.064 mm where the forty lines have 0.062: see docs/experiments/accuracy.md"
        request.applymarker(pytest.mark.xfail(strict=True, reason=why))
    assert traced.score["surface_rms_mm"] < baseline_rms_mm(traced)


def test_the_surface_error_is_below_0_09_mm(traced):
    assert traced.score["surface_rms_mm"] < 0.09


def test_ridges_are_right_on_flanks_too_and_their_stated_error_holds(traced):
    score = traced.score
    assert (
        score["ridge_corr"] > 0.9 and 0.8 < score["ridge_gain"] < 1.2 and score["ridge_rms_um"] < 12
    )
    if traced.name == "loop":  # the print ends before
        assert score["ridge_corr_45_60"] > 0.8 and score["ridge_rms_um_45_60"] < 25
    else:
        assert score["false_relief_um"] < 6
    assert 0.7 < score["error_over_stated"] < 1.3
