"""Slopes that the lights hardly show stay near the shape's."""

import numpy as np
import pytest

from splitknit.skin.grid import Grid
from splitknit.skin.light import Lighting
from splitknit_match.rolled.views import _held_normals

SHAPE, PITCH = (24, 24), 0.05


def tilted(slant_deg, held, lights, ridge=0.2):
    """Measured slopes (across, along) on a plane of that slant; a ridge turns the skin by `ridge`
    (rad) both ways."""
    x = PITCH * np.arange(SHAPE[1])
    grid = Grid(np.ones(SHAPE, bool), x, PITCH * np.arange(SHAPE[0])[::-1], PITCH, (False,) * 4)
    smooth = np.broadcast_to(-np.tan(np.deg2rad(slant_deg)) * x, SHAPE).astype(np.float32)
    slant = np.deg2rad(slant_deg)
    across = np.array([np.cos(slant), 0.0, -np.sin(slant)])
    turned = np.array([np.sin(slant), ridge, np.cos(slant)]) + ridge * across
    count = len(lights)
    light = (lights @ turned)[None, :, None, None]
    images = np.broadcast_to(light, (1, count, *SHAPE)).astype(np.float32)
    vectors = np.broadcast_to(lights[:, :, None, None], (count, 3, *SHAPE)).astype(np.float32)
    ones = np.ones((count, *SHAPE), np.float32)
    normal = _held_normals(images, Lighting(vectors, ones, ones), smooth, grid, held)[0, 12, 12]
    return np.array([normal @ across, normal[1]])


@pytest.fixture
def ring():
    azimuth = 2 * np.pi * np.arange(7) / 7
    return np.stack([0.4 * np.cos(azimuth), 0.4 * np.sin(azimuth), np.full(7, 0.9)], axis=1)


@pytest.mark.parametrize("slant_deg", [5.0, 48.0])
def test_slopes_are_held_as_much_as_is_asked_for(ring, slant_deg):
    assert tilted(slant_deg, 0.0, ring) == pytest.approx([0.2, 0.2], abs=2e-3)
    some, more = (np.abs(tilted(slant_deg, held, ring)) for held in (0.5, 2.0))
    assert some.max() < 0.19
    assert (more < 0.8 * some).all()


def test_a_slope_that_the_lights_show_well_is_held_less(ring):
    flat = ring * [1.0, 0.2, 1.0]  # these lights hardly show the slope along
    across, along = tilted(5.0, 0.1, flat)
    assert across > 0.15
    assert along < 0.5 * across
