"""Checkerboards on the skin."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.model import Led
from splitknit_simulator.light.lighting import cut_out
from splitknit_simulator.light.separation import Checkerboard, _projected, pattern_states
from surfaces import plane, ridged_egg

ABOVE = Led("white", direction=(0.0, 0.0, 1.0))
ASIDE = Led("white", position_mm=(52.5, -10.0, 140.0))
PITCH = 0.1


def _grid(size=400):
    axis = (np.arange(size) - (size - 1) / 2) * PITCH
    return axis[None, :] + 0 * axis[:, None], axis[:, None] + 0 * axis[None, :]


def test_half_a_checkerboard_is_lit_and_a_shift_by_one_check_is_its_complement():
    pattern = Checkerboard(0.8)
    x, y = _grid()
    first, second = (pattern.state(x, y, shift, PITCH) for shift in ((0.1, 0.0), (0.9, 0.0)))
    np.testing.assert_allclose(first + second, 1.0, atol=1e-6)
    assert first.mean() == pytest.approx(0.5, abs=0.002)
    assert ((first == 0) | (first == 1)).mean() > 0.7  # the rest is edges of one pixel
    np.testing.assert_allclose(pattern.state(x, y, (0.9, 0.8), PITCH), first, atol=1e-6)


def test_every_point_is_lit_by_its_share_of_a_fine_grid_of_shifts():
    pattern = Checkerboard(0.8, steps=16)
    x, y = _grid(20)
    states = np.stack([pattern.state(x, y, shift, PITCH) for shift in pattern.shifts_mm()])
    np.testing.assert_allclose(states.mean(axis=0), 0.5, atol=0.02)
    assert states.min() == 0.0 and states.max() == 1.0


def test_twenty_five_shifts_cover_one_period_evenly():
    shifts = Checkerboard(0.5).shifts_mm()
    assert shifts.shape == (25, 2)
    np.testing.assert_allclose(np.unique(shifts[:, 0].round(9)), 0.2 * np.arange(5))
    assert len(np.unique(shifts.round(9), axis=0)) == 25


def test_the_pattern_lies_on_the_surface_along_the_projectors_rays():
    patch = cut_out(ridged_egg(size=(200, 180), px_per_mm=12.0))
    x, y = _projected(patch, ASIDE)
    px, py, pz = ASIDE.position_mm
    top = np.unravel_index(np.argmax(patch.z), patch.z.shape)
    z = float(patch.z[top])
    # projector, surface point and the point of the finger plane lie on one line
    here = np.array([float(patch.x[0, top[1]]), float(patch.y[top[0], 0]), z])
    ray = np.array([x[top], y[top], 0.0]) - np.array([px, py, pz])
    assert np.linalg.norm(np.cross(ray, here - np.array([px, py, pz]))) < 1e-3
    assert x[top] - here[0] == pytest.approx(-(px - here[0]) * z / (pz - z), rel=1e-4)
    far_x, far_y = _projected(patch, ABOVE)
    np.testing.assert_allclose(far_x - patch.x, 0, atol=1e-9)
    np.testing.assert_allclose(far_y - patch.y, 0, atol=1e-9)


def test_a_distant_projector_is_the_limit_of_a_near_one():
    patch = cut_out(ridged_egg(size=(100, 90), px_per_mm=6.0))
    near = _projected(patch, Led("white", position_mm=(0.3e6, 0.1e6, 1e6)))
    distant = _projected(patch, Led("white", direction=(0.3, 0.1, 1.0)))
    for a, b in zip(near, distant, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-3)


def test_states_are_on_the_frame_and_zero_beside_the_surface():
    egg = ridged_egg(size=(220, 200), px_per_mm=12.0)
    states = pattern_states(egg, ASIDE, Checkerboard(0.5, steps=2))
    assert states.shape == (4, 220, 200) and states.dtype == np.float32
    assert not states[:, ~egg.mask].any()
    assert states[:, egg.mask].max() == 1.0 and states[:, egg.mask].min() == 0.0
    flat = pattern_states(plane((40, 50), 10.0), ASIDE, Checkerboard(0.5, steps=2))
    assert np.array_equal(flat, pattern_states(plane((40, 50), 10.0), ABOVE, Checkerboard(0.5, steps=2)))


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"check_mm": 0.0}, "check_mm"),
        ({"check_mm": np.nan}, "check_mm"),
        ({"check_mm": 0.4, "steps": 1}, "steps"),
    ],
)
def test_impossible_patterns_are_refused(wrong, word):
    with pytest.raises(BadInput, match=word):
        Checkerboard(**wrong)


def test_projectors_that_cannot_be_are_refused():
    patch = cut_out(plane((8, 8), 10.0))
    with pytest.raises(BadInput, match="one projector"):
        _projected(patch, Led("white", position_mm=(0, 0, 100), also=(ASIDE,)))
    with pytest.raises(BadInput, match="from above"):
        _projected(patch, Led("white", direction=(1.0, 0.0, 0.0)))
    egg = cut_out(ridged_egg(size=(60, 60), px_per_mm=4.0))
    with pytest.raises(BadInput, match="reaches up"):
        _projected(egg, Led("white", position_mm=(30.0, 0.0, 2.0)))
