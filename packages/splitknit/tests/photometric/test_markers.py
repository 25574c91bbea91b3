"""Printed dots on a gel: found where they are, and bridged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from gel_frames import SIZE, cap, dots, frame, places
from splitknit.errors import BadInput
from splitknit.photometric.shading import bridge, find_markers


def light_of(pixels):
    return np.moveaxis(pixels, 2, 0) / np.float32(255)


@pytest.mark.parametrize("diameter", [5, 9])
def test_all_of_a_dot_is_found_and_little_else(diameter: int) -> None:
    height = cv2.GaussianBlur(cap(80, 60, 40, 25), (0, 0), 1.0)
    marks = dots(26, diameter, 9)
    found = find_markers(light_of(frame(height, marks)), diameter)
    assert found[marks].all()
    around = cv2.dilate(marks.astype(np.uint8), np.ones((diameter + 4, diameter + 4))) > 0
    assert not found[~around].any()


def test_slopes_noise_and_a_scratch_are_no_dots() -> None:
    height = cv2.GaussianBlur(cap(50, 60, 40, 30), (0, 0), 1.0)
    x, y = places()
    scratch = (np.abs(y - 110) < 1.5) & (np.abs(x - 100) < 40)
    assert not find_markers(light_of(frame(height, scratch, noise=0.01)), 6).any()


def test_a_plane_is_bridged_and_the_rest_kept() -> None:
    x, y = places()
    field = np.stack([0.01 * x - 0.02 * y, 0.3 + 0 * x])
    hole = dots(26, 9, 13)
    filled = bridge(np.where(hole, 1e3, field), hole, 4.5)
    assert np.array_equal(filled[:, ~hole], field.astype(np.float32)[:, ~hole])
    whole = hole & (x > 12) & (x < SIZE[1] - 12) & (y > 12) & (y < SIZE[0] - 12)
    assert np.abs(filled - field)[:, whole].max() < 0.003


def test_a_hole_much_larger_than_the_reach_is_closed() -> None:
    hole = np.zeros((60, 60), bool)
    hole[10:50, 10:50] = True
    assert np.allclose(bridge(np.where(hole, np.nan, 2.0)[None], hole, 1.5), 2.0, atol=1e-4)


@pytest.mark.parametrize("diameter", [1, 40, float("nan")])
def test_impossible_markers_are_refused(diameter: float) -> None:
    with pytest.raises(BadInput, match="marker's"):
        find_markers(np.ones((3, 60, 80), np.float32), diameter)


def test_nothing_left_is_refused() -> None:
    with pytest.raises(BadInput, match="no pixel is left"):
        bridge(np.ones((1, 4, 4)), np.ones((4, 4), bool), 2.0)
