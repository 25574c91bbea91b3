"""Quality figures follow their causes, and every warning names a remedy."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from splitknit.finger.quality import capture_quality, quality_findings


@pytest.fixture(scope="module")
def scene(draw_finger):
    return draw_finger("medium", px_per_mm=24.0, ridges=0.05)


def test_a_good_capture_has_no_warnings(scene):
    quality = capture_quality(
        scene.stack, scene.mask, 24.0, lights=scene.lights, ambient=0 * scene.grey
    )
    assert not list(quality_findings(quality))
    json.dumps(quality)
    assert quality["area_mm2"] == pytest.approx(scene.mask.sum() / 24.0**2)
    assert quality["width_mm"] == pytest.approx(16.0, abs=0.2)
    assert quality["borders"] == ["bottom"]
    assert quality["frame_share"] == pytest.approx(scene.mask.mean())
    assert quality["led_relative"] == pytest.approx([1.0] * 7, abs=0.15)


def test_defocus_lowers_ridge_contrast(scene):
    sharp = capture_quality(scene.stack, scene.mask, 24.0)
    soft = np.stack([cv2.GaussianBlur(image, (0, 0), 0.25 * 24) for image in scene.stack])
    blurred = capture_quality(soft, scene.mask, 24.0)
    assert blurred["ridge_contrast"] < 0.2 * sharp["ridge_contrast"]
    assert blurred["sharpness"] < 0.5 * sharp["sharpness"]
    assert any("focus" in str(text) for text in quality_findings(blurred))


def test_led_faults_are_named(scene):
    stack = scene.stack.copy()
    stack[2] *= 0.3
    stack[5] *= 0.01
    words = [
        str(finding)
        for finding in quality_findings(
            capture_quality(stack, scene.mask, 24.0, lights=scene.lights)
        )
    ]
    assert any(text.startswith("image 2 is 0.") and "calibrate" in text for text in words)
    assert any(text.startswith("image 5") and "dead" in text for text in words)
    dimmed = scene.lights * np.where(np.arange(7) == 2, 0.3, 1.0)[:, None]
    stack[5] = scene.stack[5]
    assert not list(quality_findings(capture_quality(stack, scene.mask, 24.0, lights=dimmed)))


def test_exposure_and_ambient(scene):
    bright = capture_quality(np.minimum(scene.stack * 6, 1.0), scene.mask, 24.0)
    assert any("saturated" in str(text) for text in quality_findings(bright))
    allowed = capture_quality(
        np.minimum(scene.stack * 6, 1.0), scene.mask, 24.0, saturation=np.full(7, 6.0)
    )
    assert max(allowed["saturated_per_image"]) == 0.0
    dark = capture_quality(scene.stack * np.float32(0.02), scene.mask, 24.0)
    assert any("dark" in str(text) for text in quality_findings(dark))
    lit = capture_quality(scene.stack, scene.mask, 24.0, ambient=scene.grey)
    assert lit["ambient_share"] == pytest.approx(1.0, abs=0.01)
    assert any("ambient" in str(text) for text in quality_findings(lit))


def test_coverage(scene):
    whole = np.zeros_like(scene.mask)
    whole[:, 200:500] = True
    assert any(
        "crosses the whole image" in str(t)
        for t in quality_findings(capture_quality(scene.stack, whole, 24.0))
    )
    short = np.zeros_like(scene.mask)
    short[-200:, 200:500] = True
    assert any(
        "push it further in" in str(t)
        for t in quality_findings(capture_quality(scene.stack, short, 24.0))
    )
