"""A matt finger under near LEDs: Lambert's law."""

import numpy as np
import pytest

from splitknit.model import Camera, Led
from splitknit_simulator.light.lighting import cut_out, irradiance, white_card
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


def _lit(surface, led):
    patch = cut_out(surface)
    return patch.window, irradiance(led, patch.points, patch.normal) / np.pi


def test_a_flat_plane_is_a_white_card():
    window, light = _lit(_plane(), LED)
    np.testing.assert_allclose(light, white_card(CAMERA, LED, step=1)[window], rtol=2e-5)


def test_light_follows_the_cosine_and_ends_in_the_attached_shadow():
    distant = Led("white", direction=(0.6, 0.0, 0.8), intensity=2.0)
    assert _lit(_plane((0.6, 0.0, 0.8)), distant)[1] == pytest.approx(2.0 / np.pi)
    assert _lit(_plane(), distant)[1] == pytest.approx(2.0 / np.pi * 0.8)
    assert not _lit(_plane((-0.9, 0.0, np.sqrt(0.19))), distant)[1].any()
