"""The ridge band: pitch, direction, contrast, unrolling, skin without ridges."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.imaging.geometry import rotation_about
from splitknit_match.matching.ridge_band import band_places, print_band, ridge_band

PITCH = 0.05


def stripes(turn, period_mm=0.45, side=300):
    """Ridges whose normal points `turn` counter-clockwise from x."""
    rows, columns = np.mgrid[0:side, 0:side]
    across = columns * np.cos(turn) - rows * np.sin(turn)
    return (0.03 * np.sin(2 * np.pi * PITCH / period_mm * across)).astype(np.float32)


def test_wide_shapes_are_taken_out():
    _, columns = np.mgrid[0:300, 0:300]
    hill = (0.5 * np.cos((columns - 150) / 100)).astype(np.float32)
    mask = np.ones((300, 300), np.bool_)
    plain, hilly = (
        ridge_band(stripes(0.4) + extra, mask, PITCH).value for extra in (0 * hill, hill)
    )
    inner = slice(25, -25), slice(25, -25)
    assert np.corrcoef(plain[inner].ravel(), hilly[inner].ravel())[0, 1] > 0.99


def test_prints_are_mirrored_and_inverted():
    ridge = stripes(0.5)
    # ink: ridges dark, mirrored
    picture = np.clip(128 - 3000 * ridge[:, ::-1], 0, 255).astype(np.uint8)
    from_print = print_band(picture, 25.4 / PITCH)
    band = ridge_band(ridge, np.ones((300, 300), np.bool_), PITCH)
    inner = slice(25, -25), slice(25, -25)
    assert np.corrcoef(from_print.value[inner].ravel(), band.value[inner].ravel())[0, 1] > 0.95


PITCH_MM = 0.05
SIDE = 240
INNER = np.s_[30:-30, 30:-30]
ALL = np.ones((SIDE, SIDE), bool)


def wave(angle_rad, period_mm=0.5):
    y, x = np.mgrid[:SIDE, :SIDE] * PITCH_MM
    across = x * np.cos(angle_rad) - y * np.sin(angle_rad)
    return np.sin(2 * np.pi / period_mm * across).astype(np.float32)


@pytest.mark.parametrize("angle_rad", [0.0, np.pi / 4, 1.0])
@pytest.mark.parametrize(("second", "valid"), [(0.75, True), (0.87, False)])
def test_skin_is_used_from_a_coherence_of_a_fifth(angle_rad, second, valid):
    """Of two crossed waves it is the difference of their powers over the sum."""
    crossed = wave(angle_rad) + second * wave(angle_rad + np.pi / 2)
    band = ridge_band(crossed, ALL, PITCH_MM)
    assert band.valid[INNER].mean() == pytest.approx(float(valid), abs=0.05)


@pytest.mark.parametrize(("contrast", "expected"), [(0.5, 1.0), (0.2, 0.67), (0.1, 0.0)])
def test_weak_contrast_is_raised_to_a_limit(contrast, expected):
    relief = wave(0.5)
    relief[:, :80] *= contrast
    band = ridge_band(relief, ALL, PITCH_MM)
    assert band.valid[30:-30, 8:25].mean() == (expected > 0)
    assert band.value[30:-30, 8:25].std() == pytest.approx(expected, abs=0.07)
    assert band.value[30:-30, 60:100].std() == pytest.approx(1, abs=0.05)


def test_pixels_of_a_flat_band_are_steps_of_its_pitch():
    transform = np.array([[0.8, 0.6, 5.0], [-0.6, 0.8, 7.0], [0, 0, 1]])
    columns, rows, slant_cos = band_places(ALL, None, transform, (31, 44), pitch_mm=0.05)
    assert columns.shape == rows.shape == slant_cos.shape == (16, 22)
    assert columns.dtype == rows.dtype == slant_cos.dtype == np.float32
    assert (slant_cos == 1).all()
    for row, column in ((0, 0), (15, 3), (4, 21)):
        x, y, _ = transform @ [2 * column, 2 * row, 1]
        assert columns[row, column] == pytest.approx(x, abs=1e-4)
        assert rows[row, column] == pytest.approx(y, abs=1e-4)
    finer = band_places(ALL, None, transform, (31, 44), pitch_mm=0.05, band_mm=0.05)
    assert finer[0].shape == (31, 44)
    assert band_places(ALL, None, transform, (1, 1), pitch_mm=0.05)[0].shape == (1, 1)


@pytest.mark.parametrize("angle_rad", [0.0, 0.6])
@pytest.mark.parametrize("middle_px", [119.5, 90.0])
def test_pixels_of_a_cylinder_are_steps_along_its_skin(angle_rad, middle_px):
    """The skin is measured from the middle of what is known; its axis may lie elsewhere."""
    radius_mm = 6.5
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    frame = rotation_about((119.5, 119.5), angle_rad)
    back = np.linalg.inv(frame)
    right_mm = (back[0, 0] * x + back[0, 1] * y + back[0, 2] - middle_px) * PITCH_MM
    along_mm = (back[1, 0] * x + back[1, 1] * y + back[1, 2] - 119.5) * PITCH_MM
    mask = (np.abs(right_mm) < 3.5) & (np.abs(along_mm) < 4)
    height = np.sqrt(radius_mm**2 - np.clip(right_mm, -5, 5) ** 2).astype(np.float32)
    columns, rows, slant_cos = band_places(mask, height, frame, (SIDE, SIDE), pitch_mm=PITCH_MM)
    upright = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(frame).T
    row = 60
    place_mm = (upright[row, :, 0] - middle_px) * PITCH_MM
    assert upright[row, :, 1] == pytest.approx(2 * row, abs=0.05)
    skin = np.abs(place_mm) < 2.8
    arc_mm = radius_mm * np.arcsin(place_mm[skin] / radius_mm)
    assert_allclose(np.diff(arc_mm), 0.1, atol=0.004)
    assert np.ptp(arc_mm) == pytest.approx(0.1 * (skin.sum() - 1), rel=0.01)
    assert_allclose(slant_cos[row, skin], np.sqrt(1 - (place_mm[skin] / radius_mm) ** 2), atol=0.02)
    # each row begins at the same place: at the middle of the known skin
    places = np.abs(upright[40:80, :, 0] - middle_px)
    assert np.ptp(np.argmin(places, axis=1)) <= 1


def test_slopes_along_the_finger_count_as_slant_only():
    slope = np.broadcast_to(-0.5 * PITCH_MM * np.arange(SIDE)[:, None], (SIDE, SIDE))
    columns, _, slant_cos = band_places(
        ALL, slope.astype(np.float32), np.eye(3), (SIDE, SIDE), pitch_mm=PITCH_MM
    )
    assert_allclose(np.diff(columns[60])[10:-10], 2, atol=1e-3)
    assert_allclose(slant_cos[40:-40, 40:-40], 1 / np.sqrt(1.25), atol=0.01)


def test_steep_skin_is_left_out():
    """Up to 60 degrees it is used."""
    for slant_deg, valid in ((57.0, True), (63.0, False)):
        slope = np.tan(np.deg2rad(slant_deg)) * PITCH_MM * np.arange(SIDE)[:, None]
        shape = np.broadcast_to(slope, (SIDE, SIDE)).astype(np.float32)
        band = ridge_band(wave(0.3), ALL, PITCH_MM, shape)
        assert band.valid[INNER].mean() == pytest.approx(float(valid), abs=0.01)


def test_what_lies_outside_the_mask_does_not_reach_in():
    relief = wave(0.4)
    mask = np.zeros((SIDE, SIDE), bool)
    mask[40:200, 50:190] = True
    wild = np.where(mask, relief, np.float32(1e6))
    missing = np.where(mask, relief, np.float32(np.nan))
    band = ridge_band(relief, mask, PITCH_MM)
    for outside in (wild, missing):
        again = ridge_band(outside, mask, PITCH_MM)
        assert_array_equal(again.valid, band.valid)
        assert_allclose(again.value, band.value, atol=1e-5)
    assert band.valid[23:97, 28:92].all()
    assert not band.valid[:, :24].any()
    assert not band.valid[:, 96:].any()
    assert not band.valid[:19].any()
    assert not band.value[~band.valid].any()
    assert band.area_mm2 == pytest.approx(8 * 7, rel=0.05)


def test_heights_that_are_not_finite_are_left_out():
    relief = wave(0.4)
    relief[:, 120:] = np.nan
    band = ridge_band(relief, ALL, PITCH_MM)
    assert band.valid[20:-20, 5:55].all()
    assert not band.valid[:, 63:].any()
    shape = np.zeros((SIDE, SIDE), np.float32)
    shape[:, 120:] = np.nan
    assert not ridge_band(wave(0.4), ALL, PITCH_MM, shape).valid[:, 66:].any()


def test_a_relief_without_ridges_has_none():
    band = ridge_band(np.zeros((SIDE, SIDE), np.float32), ALL, PITCH_MM)
    assert band.value.shape == band.valid.shape == (120, 120)
    assert not band.valid.any()
    assert not band.value.any()
    assert band.pitch_mm == 0.1


def test_bad_surfaces_are_refused_by_name():
    relief = np.zeros((20, 30), np.float32)
    mask = np.ones((20, 30), bool)
    cases = [
        ((relief[0], mask, 0.1), r"ridge_mm must have the shape \(H, W\), but it has \(30,\)\."),
        (
            (relief, mask, 0.1, relief[:5]),
            r"shape_mm must have the shape \(20, 30\), but .*\(5, 30",
        ),
        ((relief, mask, 0.1, relief * np.nan), r"shape_mm is NaN all over the mask\."),
        ((relief, mask, 0.1, relief - 501), r"shape_mm holds heights beyond 500 mm"),
        ((relief, mask, 10.1), r"pitch_mm must be a number from 0\.001 to 10, but it is 10\.1\."),
        ((relief, mask, np.nan), "pitch_mm"),
        ((relief, mask, 0.1, None, np.eye(3), (5001, 1)), r"is 500 mm long and shows 6 mm²"),
        ((relief, mask, 0.1, None, np.eye(3), (2001, 2001)), r"is 200 mm long"),
    ]
    for arguments, words in cases:
        with bad_input(words):
            ridge_band(*arguments)
    assert not ridge_band(relief, mask, 0.1, relief + 500).valid.any()
    assert ridge_band(relief, mask, 0.1, None, np.eye(3), (5000, 1)).valid.shape == (5000, 1)


def picture(contrast):
    """A print whose left third (right third, as a camera sees it) is weak."""
    ink = wave(0.5) * 100
    ink[:, :80] *= contrast
    return (128 + ink).astype(np.uint8)


@pytest.mark.parametrize(("contrast", "valid"), [(0.24, False), (0.37, True)])
def test_a_print_is_used_from_a_third_of_its_contrast(contrast, valid):
    band = print_band(picture(contrast), 25.4 / PITCH_MM)
    assert band.valid[30:-30, 90:110].mean() == pytest.approx(float(valid), abs=0.05)
    assert band.valid[30:-30, 20:70].all()


def test_a_print_is_used_inside_only():
    inside = np.zeros((SIDE, SIDE), bool)
    inside[:, :120] = True
    band = print_band(picture(1.0), 25.4 / PITCH_MM, inside)
    assert not band.valid[:, :57].any()
    assert band.valid[20:-20, 65:110].all()
    nothing = print_band(picture(1.0), 25.4 / PITCH_MM, np.zeros_like(inside))
    assert not nothing.valid.any()
    assert nothing.valid.shape == (120, 120)
    assert print_band(picture(1.0)).valid.shape == (122, 122)  # 240 pixels at 500 ppi


def test_a_ball_is_unrolled_from_the_middle_of_its_known_skin():
    """That column of the picture stays straight; every row is as long as its arc."""
    radius_mm = 7.0
    y, x = np.mgrid[:SIDE, :SIDE] * PITCH_MM
    squared = (x - 5) ** 2 + (y - 7) ** 2
    height = np.sqrt(radius_mm**2 - np.minimum(squared, 36)).astype(np.float32)
    mask = (np.abs(x - 4) < 3) & (np.abs(y - 7) < 4)
    columns, rows, slant_cos = band_places(mask, height, np.eye(3), (SIDE, SIDE), pitch_mm=PITCH_MM)
    inner = slice(35, 105)
    spread = np.ptp(columns[inner], axis=0)
    straight = int(np.argmin(np.where(columns[70] > 0, spread, np.inf)))
    assert np.ptp(columns[inner, straight]) < 0.1
    assert columns[70, straight] == pytest.approx(4 / PITCH_MM, abs=5)
    at_mm = columns * PITCH_MM, rows * PITCH_MM
    skin = (np.abs(at_mm[0] - 4) < 1.5) & (np.abs(at_mm[1] - 7) < 2.5)
    off_mm = np.hypot(at_mm[0] - 5, at_mm[1] - 7)[skin]
    expected = np.sqrt(1 - (off_mm / radius_mm) ** 2)
    assert_allclose(slant_cos[skin], expected, atol=0.02)
    # shifted by a step of the slopes' grid, one side would be too steep
    side = np.sign(at_mm[1] - 7)[skin]
    assert abs(((slant_cos[skin] - expected) * side).mean()) < 0.002


def test_steep_sides_are_unrolled_as_if_they_were_less_steep():
    """A roof whose slope is 3 beyond 2 mm: steps as at 60 degrees, on both sides."""
    x = (np.arange(SIDE) - 119.5) * PITCH_MM
    roof = np.broadcast_to(-3 * np.maximum(np.abs(x) - 2, 0), (SIDE, SIDE)).astype(np.float32)
    columns, _, _ = band_places(ALL, roof, np.eye(3), (SIDE, SIDE), pitch_mm=PITCH_MM)
    steps = np.diff(columns[60])
    for side in (columns[60, :-1] < 50) & (columns[60, :-1] > 20), columns[60, :-1] > 190:
        inner = side & (columns[60, :-1] < 220)
        assert_allclose(steps[inner], 1.0, atol=0.02)


def test_an_offset_of_the_relief_changes_nothing_up_to_the_edge():
    mask = np.zeros((SIDE, SIDE), bool)
    mask[40:200, 50:190] = True
    plain, offset = (ridge_band(wave(0.4) + add, mask, PITCH_MM) for add in (0, np.float32(20)))
    assert_array_equal(plain.valid, offset.valid)
    assert_allclose(plain.value, offset.value, atol=0.01)
