"""Quality figures follow their causes, and every warning names a remedy."""

import json

import cv2
import numpy as np
import pytest

from splitknit.finger.quality import capture_quality, quality_findings

PX_PER_MM = 24.0


@pytest.fixture(scope="module")
def scene(draw_finger):
    return draw_finger("medium", px_per_mm=PX_PER_MM, ridges=0.05)


def messages(quality):
    return [str(finding) for finding in quality_findings(quality)]


def test_a_good_capture_has_no_warnings(scene):
    quality = capture_quality(
        scene.stack, scene.mask, PX_PER_MM, lights=scene.lights, ambient=0 * scene.grey
    )
    assert not messages(quality)
    json.dumps(quality)
    assert quality["area_mm2"] == pytest.approx(scene.mask.sum() / 24.0**2)
    assert quality["width_mm"] == pytest.approx(16.0, abs=0.2)
    assert quality["borders"] == ["bottom"]
    assert quality["frame_share"] == pytest.approx(scene.mask.mean())
    assert quality["led_relative"] == pytest.approx([1.0] * 7, abs=0.15)


def test_defocus_lowers_ridge_contrast(scene):
    sharp = capture_quality(scene.stack, scene.mask, PX_PER_MM)
    soft = np.stack([cv2.GaussianBlur(image, (0, 0), 0.25 * PX_PER_MM) for image in scene.stack])
    blurred = capture_quality(soft, scene.mask, PX_PER_MM)
    assert blurred["ridge_contrast"] < 0.2 * sharp["ridge_contrast"]
    assert blurred["sharpness"] < 0.5 * sharp["sharpness"]
    assert "focus" in str(messages(blurred))


def test_dim_and_dead_leds_are_named(scene):
    stack = scene.stack.copy()
    stack[2] *= 0.3
    stack[5] *= 0.01
    texts = messages(capture_quality(stack, scene.mask, PX_PER_MM, lights=scene.lights))
    assert any(text.startswith("image 2 is 0.") and "calibrate" in text for text in texts)
    assert any(text.startswith("image 5") and "dead" in text for text in texts)
    dimmed = scene.lights * np.where(np.arange(7) == 2, 0.3, 1.0)[:, None]
    stack[5] = scene.stack[5]
    assert not messages(capture_quality(stack, scene.mask, PX_PER_MM, lights=dimmed))


def test_exposure_and_ambient_light_are_judged(scene):
    clipped = np.minimum(scene.stack * 6, 1.0)
    assert "saturated" in str(messages(capture_quality(clipped, scene.mask, PX_PER_MM)))
    allowed = capture_quality(clipped, scene.mask, PX_PER_MM, saturation=np.full(7, 6.0))
    assert max(allowed["saturated_per_image"]) == 0.0
    dark = capture_quality(scene.stack * np.float32(0.02), scene.mask, PX_PER_MM)
    assert "dark" in str(messages(dark))
    lit = capture_quality(scene.stack, scene.mask, PX_PER_MM, ambient=scene.grey)
    assert lit["ambient_share"] == pytest.approx(1.0, abs=0.01)
    assert "ambient" in str(messages(lit))


def test_a_finger_across_the_image_or_too_short_gets_a_remedy(scene):
    for part, remedy in (
        (np.s_[:, 200:500], "crosses the whole image"),
        (np.s_[-200:, 200:500], "push it further in"),
    ):
        mask = np.zeros_like(scene.mask)
        mask[part] = True
        assert remedy in str(messages(capture_quality(scene.stack, mask, PX_PER_MM)))
