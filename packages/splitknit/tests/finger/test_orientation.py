"""Yaw, its sign, and the upright frame."""

import numpy as np
import pytest

from splitknit.finger.orientation import find_upright
from splitknit.imaging.geometry import warp


@pytest.mark.parametrize(
    ("yaw", "tip"),
    [
        (0.0, (0.0, 15.0)),
        (3.0, (0.0, 14.0)),
        (-12.0, (3.0, 13.0)),
        (30.0, (-6.0, 10.0)),
        (-45.0, (9.0, 6.0)),
        (60.0, (-9.0, 0.0)),
        (-60.0, (9.0, 0.0)),
    ],
)
def test_yaw_tip_and_upright_frame_follow_the_finger(draw_finger, yaw, tip):
    scene = draw_finger("medium", yaw_deg=yaw, tip_at=tip, noise=0.0, taper=0.05)
    upright = find_upright(scene.mask)
    assert upright.reliable
    assert upright.note == ""
    # positive: the tip leans to the left
    assert np.rad2deg(upright.yaw_rad) == pytest.approx(yaw, abs=0.5)
    assert (
        np.hypot(upright.tip[0] - scene.tip[0], upright.tip[1] - scene.tip[1])
        < 0.5 * scene.px_per_mm
    )
    turned = warp(scene.mask.astype(np.float32), upright.input_from_upright, upright.size) > 0.5
    assert turned.sum() == pytest.approx(scene.mask.sum(), rel=0.01)  # all of it is in the frame
    rows = np.flatnonzero(turned.any(axis=1))
    assert upright.tip_row == pytest.approx(rows[0], abs=2.0)
    width = turned[rows[0] + len(rows) // 2].sum()
    assert upright.width_px == pytest.approx(width, rel=0.12)
    narrow = turned[rows[0] + 5].sum()
    assert narrow < 0.6 * width  # the tip is up
    np.testing.assert_allclose(
        upright.upright_from_input @ upright.input_from_upright, np.eye(3), atol=1e-9
    )


@pytest.mark.parametrize("yaw", [20.0, 35.0, -45.0])
def test_the_yaw_of_a_short_finger_cut_by_the_border_is_right(draw_finger, yaw):
    scene = draw_finger(
        "medium", yaw_deg=yaw, tip_at=(-0.1 * yaw, 0.0), size_mm=(29.0, 42.0), noise=0.0
    )
    assert np.rad2deg(find_upright(scene.mask).yaw_rad) == pytest.approx(yaw, abs=0.5)


@pytest.mark.parametrize("turn", [90.0, 180.0, -90.0])
def test_a_stated_tip_direction_is_followed(draw_finger, turn):
    scene = draw_finger("medium", yaw_deg=10.0, tip_at=(-2.0, 12.0), noise=0.0)
    mask = np.rot90(scene.mask, int(turn // 90))  # counter-clockwise
    upright = find_upright(np.ascontiguousarray(mask), turn)
    assert upright.reliable
    difference = np.rad2deg(upright.yaw_rad) - (turn + 10.0)
    assert (difference + 180) % 360 - 180 == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("yaw", [0.0, 30.0, -45.0])
def test_any_tip_direction_is_found(draw_finger, quarters, yaw):
    scene = draw_finger("medium", yaw_deg=yaw, tip_at=(0.0, 8.0), noise=0.0, taper=0.05)
    upright = find_upright(np.ascontiguousarray(np.rot90(scene.mask, quarters)))
    assert upright.clear
    assert upright.reliable
    assert upright.note == ""
    error = np.rad2deg(upright.yaw_rad) - (90.0 * quarters + yaw)
    assert (error + 180) % 360 - 180 == pytest.approx(0.0, abs=0.5)


def test_a_finger_cut_off_inside_the_picture_points_with_its_round_end(draw_finger):
    mask = draw_finger("medium", noise=0.0).mask
    mask[int(np.flatnonzero(mask.any(axis=1))[0]) + 300 :] = False
    down = find_upright(np.ascontiguousarray(mask[::-1]))
    assert down.clear
    assert abs(np.rad2deg(down.yaw_rad)) == pytest.approx(180.0, abs=0.5)


@pytest.mark.parametrize("quarters", range(4))
def test_without_the_tip_in_view_the_direction_is_unclear(draw_finger, quarters):
    mask = draw_finger("medium", tip_at=(0.0, 15.0), noise=0.0, taper=0.05).mask[200:420]
    upright = find_upright(np.ascontiguousarray(np.rot90(mask, quarters)))
    assert not upright.clear
    assert "does not show which way" in upright.note
    assert "`tip_direction_deg`" in upright.note
    assert abs(np.rad2deg(upright.yaw_rad)) < 95.0  # what is nearest to up


def test_a_notch_and_a_slanting_base_do_not_change_the_yaw(draw_finger):
    scene = draw_finger("medium", noise=0.0)
    mask = scene.mask.copy()
    height, width = mask.shape
    mask[250:275, : width // 2 - 60] = False
    # base cut at a slant
    mask &= np.arange(height)[:, None] < height - 0.6 * np.arange(width)[None, :] + 120
    assert np.rad2deg(find_upright(mask).yaw_rad) == pytest.approx(0.0, abs=1.0)


def test_a_disc_is_reported_as_having_no_axis():
    y, x = np.mgrid[0:300, 0:300]
    upright = find_upright((x - 150) ** 2 + (y - 150) ** 2 < 100**2)
    assert abs(upright.yaw_rad) < np.deg2rad(20)
    assert not upright.clear
    assert upright.note != ""
    low = np.zeros((300, 300), dtype=bool)
    low[-6:, 50:250] = True
    flat = find_upright(low)
    assert not flat.reliable
    assert "no axis" in flat.note
    assert flat.yaw_rad == 0.0
