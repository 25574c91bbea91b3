"""Several fingers in one view: one is reconstructed, with a doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.capture import Band, Capture
from splitknit.finger.locate import find_finger
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings

PX_PER_MM, SHAPE, HALF_MM = 8.0, (320, 400), 7.0


def view(middles_mm: tuple[float, ...]) -> Capture:
    """Flat bright fingers with round tips, under seven near lights."""
    rig = replace(default_rig(1.0, 0), camera=Camera(PX_PER_MM, SHAPE))
    rng = np.random.default_rng(0)
    row, column = np.indices(SHAPE)
    x, up = (column - (SHAPE[1] - 1) / 2) / PX_PER_MM, (SHAPE[0] - row) / PX_PER_MM
    inside = np.zeros(SHAPE, bool)
    for middle in middles_mm:
        inside |= np.hypot(x - middle, np.maximum(up - 25.0, 0)) < HALF_MM
    colours = np.where(inside[..., None], [150.0, 100.0, 80.0], 6.0)
    pixels = np.stack(
        [colours * (0.8 + 0.05 * k) + rng.normal(0, 1.0, colours.shape) for k in range(7)]
    )
    leds = tuple((k,) for k in range(7))
    band = Band("white", pixels.clip(0, 255).astype(np.uint8), leds, np.ones(7), np.zeros(7))
    return Capture(rig, {"white": band})


@pytest.mark.parametrize(("middles_mm", "doubted"), [((0.0,), False), ((-12.0, 12.0), True)])
def test_a_second_finger_in_view_is_a_doubt(middles_mm, *, doubted):
    finger = find_finger(observe(view(middles_mm)), preset_settings("metric").finding())
    sentences = [str(each) for each in finger.findings if each.code == "several-fingers"]
    assert bool(sentences) == doubted
    if doubted:
        assert "shows 2 fingers" in sentences[0] and "mark it in a mask" in sentences[0]


def test_a_mask_says_which_of_the_fingers_is_meant():
    capture = view((-12.0, 12.0))
    mask = capture.bands["white"].pixels[0, ..., 0] > 60
    mask[:, SHAPE[1] // 2 :] = False
    marked = observe(replace(capture, mask=mask))
    finger = find_finger(marked, preset_settings("metric").finding())
    assert "several-fingers" not in {each.code for each in finger.findings}
