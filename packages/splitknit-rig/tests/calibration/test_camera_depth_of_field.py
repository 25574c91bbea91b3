"""Depth of field against the textbook's formulas, and against rays through a thin lens."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit_rig.calibration.plane import depth_of_field


@pytest.mark.parametrize(
    ("focal_px", "f_number", "focus"), [(10598.0, 2.0, 140.0), (2714.0, 2.0, 140.0), (10598.0, 16.0, 90.0)]
)
def test_limits_are_the_textbooks(focal_px, f_number, focus):
    field = depth_of_field(focal_px, 1.12, f_number, focus)
    behind = focal_px * 1.12e-3
    focal = 1 / (1 / behind + 1 / focus)
    assert field.focal_length_mm == pytest.approx(focal)
    assert field.confusion_um == pytest.approx(1.12)
    hyperfocal = focal**2 / (f_number * 1.12e-3) + focal
    assert field.near_mm == pytest.approx(focus * (hyperfocal - focal) / (hyperfocal + focus - 2 * focal))
    assert field.far_mm == pytest.approx(focus * (hyperfocal - focal) / (hyperfocal - focus))
    assert field.near_mm < focus < field.far_mm


def disc_px(field, at_mm, pixel_um):
    """Diameter of a point's disc: rays from the lens's rims meet behind it and are cut by the sensor."""
    focal, opening = field.focal_length_mm, field.focal_length_mm / field.f_number
    sensor = 1 / (1 / focal - 1 / field.focus_mm)
    sharp = 1 / (1 / focal - 1 / at_mm)
    return opening * abs(sharp - sensor) / sharp / (pixel_um / 1000)


def test_at_the_limits_a_point_is_one_pixel_wide():
    field = depth_of_field(10598.0, 1.12, 2.0, 140.0)
    assert disc_px(field, field.near_mm, 1.12) == pytest.approx(1)
    assert disc_px(field, field.far_mm, 1.12) == pytest.approx(1)
    assert disc_px(field, 140 - 4, 1.12) == pytest.approx(field.blur_px)
    assert not field.fits


def test_the_f_number_that_is_needed_is_enough():
    field = depth_of_field(10598.0, 1.12, 2.0, 140.0, finger_depth_mm=8.0)
    assert 20 < field.needed_f_number < 28
    stopped = depth_of_field(10598.0, 1.12, field.needed_f_number, 140.0, finger_depth_mm=8.0)
    assert stopped.blur_px == pytest.approx(1)
    assert stopped.fits
    assert stopped.near_mm == pytest.approx(136)
    airy = 2.44 * 0.550e-3 * field.needed_f_number * (10598 * 1.12e-3 / field.focal_length_mm)
    assert field.diffraction_px == pytest.approx(airy / 1.12e-3)
    best = depth_of_field(10598.0, 1.12, field.best_f_number, 140.0)
    assert best.blur_px == pytest.approx(field.diffraction_px * field.best_f_number / field.needed_f_number)


def test_binned_pixels_are_larger():
    whole = depth_of_field(10598.0, 1.12, 2.0, 140.0)
    binned = depth_of_field(10598.0 / 4, 4.48, 2.0, 140.0)
    assert binned.focal_length_mm == pytest.approx(whole.focal_length_mm)
    assert binned.depth_mm == pytest.approx(4 * whole.depth_mm, rel=1e-3)
    assert binned.blur_px == pytest.approx(whole.blur_px / 4)


def test_beyond_the_hyperfocal_distance_all_is_sharp():
    field = depth_of_field(500.0, 5.6, 8.0, 3000.0)
    assert field.far_mm == np.inf
    assert field.fits
