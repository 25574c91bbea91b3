"""A matt finger under near LEDs: Lambert's law."""

import numpy as np
import pytest

from splitknit.model import Camera, Led
from splitknit_simulator.light.lighting import render_opaque, white_card
from splitknit_simulator.surface import SimulatedSurface

CAMERA = Camera(px_per_mm=2.0, image_size=(40, 60))
LED = Led(
    "white",
    position_mm=(52.5, 10.0, 140.0),
    intensity=0.8,
    lobe_exponent=4.8,
    aim=(-0.3, 0.0, -1.0),
)


def _plane(normal=(0.0, 0.0, 1.0), mask=None):
    shape = CAMERA.image_size
    flat = np.zeros(shape, np.float32)
    normals = np.broadcast_to(np.asarray(normal, np.float32), (*shape, 3)).copy()
    seen = np.ones(shape, bool) if mask is None else mask
    return SimulatedSurface(
        CAMERA, flat, flat, normals, normals, flat, seen, np.ones(shape, np.float32)
    )


def test_a_flat_opaque_plane_is_a_white_card():
    window, light = render_opaque(_plane(), [LED], albedo=0.5)
    card = white_card(CAMERA, LED, step=1)
    np.testing.assert_allclose(light[0], 0.5 * card[window], rtol=2e-5)


def test_light_follows_the_cosine_and_ends_in_the_attached_shadow():
    distant = Led("white", direction=(0.6, 0.0, 0.8), intensity=2.0)
    _, facing = render_opaque(_plane((0.6, 0.0, 0.8)), [distant], albedo=1.0)
    assert facing == pytest.approx(2.0 / np.pi)
    _, level = render_opaque(_plane(), [distant], albedo=1.0)
    assert level == pytest.approx(2.0 / np.pi * 0.8)
    _, behind = render_opaque(_plane((-0.9, 0.0, np.sqrt(0.19))), [distant], albedo=1.0)
    assert not behind.any()
