"""Slopes that the lights hardly tell stay near the shape's."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.skin.grid import Grid
from splitknit.skin.light import Lighting
from splitknit_match.rolled.views import _held_normals

SHAPE, PITCH = (24, 24), 0.05


def tilted(slant_deg: float, held: float, lights: np.ndarray, ridge: float = 0.2) -> np.ndarray:
    """Normal, found on a plane of that slant, of skin whose ridge turns it by `ridge` (rad) across
    and along."""
    x = PITCH * np.arange(SHAPE[1])
    grid = Grid(np.ones(SHAPE, bool), x, PITCH * np.arange(SHAPE[0])[::-1], PITCH, (False,) * 4)
    smooth = np.broadcast_to(-np.tan(np.deg2rad(slant_deg)) * x, SHAPE).astype(np.float32)
    slant = np.deg2rad(slant_deg)
    normal = np.array([np.sin(slant), 0.0, np.cos(slant)])
    turned = (
        normal
        + ridge * np.array([np.cos(slant), 0.0, -np.sin(slant)])
        + ridge * np.array([0.0, 1.0, 0.0])
    )
    images = np.broadcast_to(
        (lights @ turned)[None, :, None, None], (1, len(lights), *SHAPE)
    ).astype(np.float32)
    vectors = np.broadcast_to(lights[:, :, None, None], (len(lights), 3, *SHAPE)).astype(np.float32)
    ones = np.ones((len(lights), *SHAPE), np.float32)
    found = _held_normals(images, Lighting(vectors, ones, ones), smooth, grid, held)[0, 12, 12]
    return np.array([found @ [np.cos(slant), 0.0, -np.sin(slant)], found[1]])  # across, along


@pytest.fixture
def ring() -> np.ndarray:
    azimuth = 2 * np.pi * np.arange(7) / 7
    return np.stack([0.4 * np.cos(azimuth), 0.4 * np.sin(azimuth), np.full(7, 0.9)], axis=1)


@pytest.mark.parametrize("slant_deg", [5.0, 48.0])
def test_slopes_are_held_as_much_as_is_asked_for(ring, slant_deg: float) -> None:
    assert tilted(slant_deg, 0.0, ring) == pytest.approx([0.2, 0.2], abs=2e-3)
    some, more = (np.abs(tilted(slant_deg, held, ring)) for held in (0.5, 2.0))
    assert some.max() < 0.19
    assert (more < 0.8 * some).all()


def test_what_the_lights_tell_well_is_held_less(ring) -> None:
    flat = ring * [1.0, 0.2, 1.0]  # next to nothing tells the slope along
    across, along = tilted(5.0, 0.1, flat)
    assert across > 0.15
    assert along < 0.5 * across
