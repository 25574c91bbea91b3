"""The finger plane: height and tilt from marks."""

import numpy as np
import pytest

from camera_views import BOARD, MATRIX, seen
from refusals import bad_input
from splitknit_rig.calibration.plane import mean_pose, plane_pose

MARKS = BOARD.points_mm - BOARD.points_mm.mean(axis=0)


def base(tilt_x_deg, tilt_y_deg):
    """A plane turned by small angles about x and y of the rig's frame (x right, y up), in the
    camera's frame."""
    x, y = np.deg2rad([-tilt_x_deg, -tilt_y_deg])
    about_x = np.array([[1, 0, 0], [0, np.cos(x), np.sin(x)], [0, -np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    return about_y @ about_x


@pytest.mark.parametrize(
    ("tilt", "side"),
    [
        ((1.0, 0.0), "top"),
        ((-1.0, 0.0), "bottom"),
        ((0.0, 1.0), "left"),
        ((0.0, -1.0), "right"),
        ((1.0, 1.0), "upper left"),
    ],
)
def test_pose_and_direction_of_the_tilt(tilt, side):
    """Turned right-handed about x, the plane's upper part comes up to the camera; about y, its
    right part goes down."""
    rotation = base(*tilt)
    middle = rotation @ (2.0, 1.0, 0.0) + (0, 0, 139.5)
    distortion = (0.1, 0, 0.001, 0, 0)
    pose = plane_pose(
        BOARD.points_mm, seen(MARKS, rotation, middle, distortion=distortion), MATRIX, distortion
    )
    assert pose.height_mm == pytest.approx(139.5, abs=1e-3)
    assert pose.px_per_mm == pytest.approx(2650 / 139.5, rel=1e-5)
    assert pose.tilt_deg == pytest.approx(np.hypot(*tilt), abs=2e-3)
    assert pose.tilt_xy_deg == pytest.approx(tilt, abs=2e-3)
    assert pose.nearer_side == side
    assert pose.rms_px < 1e-3


def test_deviations_are_what_repetition_gives():
    rotation = base(0.6, -0.4)
    exact = seen(MARKS, rotation, (0, 0, 140.0))
    rng = np.random.default_rng(0)
    poses = [
        plane_pose(BOARD.points_mm, exact + rng.normal(0, 0.05, exact.shape), MATRIX)
        for _ in range(60)
    ]
    promised = np.mean(
        [[p.deviations["height_mm"], p.deviations["tilt_deg"]] for p in poses], axis=0
    )
    heights = np.std([p.height_mm for p in poses], ddof=1)
    tilts = np.std([p.tilt_xy_deg for p in poses], axis=0, ddof=1).max()
    assert heights == pytest.approx(promised[0], rel=0.3)
    assert tilts == pytest.approx(promised[1], rel=0.3)
    mean = mean_pose(poses, 2650.0)
    assert mean.deviations["height_mm"] == pytest.approx(promised[0] / np.sqrt(60), rel=0.1)
    assert abs(mean.height_mm - 140) < 4 * mean.deviations["height_mm"]
    assert mean.px_per_mm == pytest.approx(2650 / mean.height_mm)
    assert (
        np.abs(np.subtract(mean.tilt_xy_deg, (0.6, -0.4))).max() < 4 * mean.deviations["tilt_deg"]
    )


def test_marks_that_do_not_do():
    with bad_input("on one line"):
        plane_pose(BOARD.points_mm[:9], seen(MARKS, np.eye(3), (0, 0, 140.0))[:9], MATRIX)
    with bad_input("at least 5 marks"):
        plane_pose(MARKS[:4], MARKS[:4], MATRIX)
