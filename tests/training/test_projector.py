"""Checkerboards on the skin."""

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from refusals import bad_input

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from projector import Checkerboard

PITCH = 0.1


def _grid(size=400):
    axis = (np.arange(size) - (size - 1) / 2) * PITCH
    return axis[None, :] + 0 * axis[:, None], axis[:, None] + 0 * axis[None, :]


def test_half_a_checkerboard_is_lit_and_a_shift_by_a_check_inverts_it():
    pattern = Checkerboard(0.8)
    x, y = _grid()
    first, second = (pattern.state(x, y, shift, PITCH) for shift in ((0.1, 0.0), (0.9, 0.0)))
    assert_allclose(first + second, 1.0, atol=1e-6)
    assert first.mean() == pytest.approx(0.5, abs=0.002)
    assert ((first == 0) | (first == 1)).mean() > 0.7  # the rest is edges of one pixel
    assert_allclose(pattern.state(x, y, (0.9, 0.8), PITCH), first, atol=1e-6)


def test_every_point_is_lit_in_half_of_all_shifts():
    pattern = Checkerboard(0.8, steps=16)
    x, y = _grid(20)
    states = np.stack([pattern.state(x, y, shift, PITCH) for shift in pattern.shifts_mm()])
    assert_allclose(states.mean(axis=0), 0.5, atol=0.02)
    assert states.min() == 0.0 and states.max() == 1.0


def test_twenty_five_shifts_cover_one_period_evenly():
    shifts = Checkerboard(0.5).shifts_mm()
    assert shifts.shape == (25, 2)
    assert_allclose(np.unique(shifts[:, 0].round(9)), 0.2 * np.arange(5))
    assert len(np.unique(shifts.round(9), axis=0)) == 25


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"check_mm": 0.0}, "check_mm"),
        ({"check_mm": np.nan}, "check_mm"),
        ({"check_mm": 0.4, "steps": 1}, "steps"),
    ],
)
def test_impossible_patterns_are_refused(wrong, word):
    with bad_input(word):
        Checkerboard(**wrong)
