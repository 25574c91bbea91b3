"""The finger plane: scale, height and tilt from marks, and the disc's dots from a picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from camera_views import BOARD, MATRIX, seen, turned
from splitknit.errors import BadInput
from splitknit_rig.calibration.plane import mean_pose, plane_pose, plane_scale
from splitknit_rig.calibration.targets import find_disc

MARKS = BOARD.points_mm - BOARD.points_mm.mean(axis=0)


def base(tilt_x_deg, tilt_y_deg):
    """A plane turned by small angles about x and y of the rig's frame (x right, y up), in the camera's frame."""
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
    """Turned right-handed about x, the plane's upper part comes up to the camera; about y, its right part goes down."""
    rotation = base(*tilt)
    middle = rotation @ (2.0, 1.0, 0.0) + (0, 0, 139.5)
    distortion = (0.1, 0, 0.001, 0, 0)
    pose = plane_pose(BOARD.points_mm, seen(MARKS, rotation, middle, distortion=distortion), MATRIX, distortion)
    assert pose.height_mm == pytest.approx(139.5, abs=1e-3)
    assert pose.px_per_mm == pytest.approx(2650 / 139.5, rel=1e-5)
    assert pose.tilt_deg == pytest.approx(np.hypot(*tilt), abs=2e-3)
    assert pose.tilt_xy_deg == pytest.approx(tilt, abs=2e-3)
    assert pose.nearer_side == side
    assert pose.rms_px < 1e-3


def test_height_is_along_the_axis_wherever_the_marks_lie():
    rotation = base(2.0, -3.0)
    for shift in ((8.0, 0.0, 0.0), (-5.0, 6.0, 0.0)):
        places = seen(MARKS, rotation, rotation @ shift + (0, 0, 140.0))
        assert plane_pose(BOARD.points_mm, places, MATRIX).height_mm == pytest.approx(140, abs=1e-3)


def test_deviations_are_what_repetition_gives():
    rotation = base(0.6, -0.4)
    exact = seen(MARKS, rotation, (0, 0, 140.0))
    rng = np.random.default_rng(0)
    poses = [plane_pose(BOARD.points_mm, exact + rng.normal(0, 0.05, exact.shape), MATRIX) for _ in range(60)]
    promised = np.mean([[p.deviations["height_mm"], p.deviations["tilt_deg"]] for p in poses], axis=0)
    heights = np.std([p.height_mm for p in poses], ddof=1)
    tilts = np.std([p.tilt_xy_deg for p in poses], axis=0, ddof=1).max()
    assert heights == pytest.approx(promised[0], rel=0.3)
    assert tilts == pytest.approx(promised[1], rel=0.3)
    mean = mean_pose(poses, 2650.0)
    assert mean.deviations["height_mm"] == pytest.approx(promised[0] / np.sqrt(60), rel=0.1)
    assert abs(mean.height_mm - 140) < 4 * mean.deviations["height_mm"]
    assert mean.px_per_mm == pytest.approx(2650 / mean.height_mm)
    assert np.abs(np.subtract(mean.tilt_xy_deg, (0.6, -0.4))).max() < 4 * mean.deviations["tilt_deg"]


def test_scale_of_an_orthographic_camera():
    angle = np.deg2rad(33)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    rng = np.random.default_rng(1)
    for flip in (1, -1):
        places = 18.9 * (MARKS * (1, flip)) @ turn + (400, 300)
        found = plane_scale(BOARD.points_mm, places)
        assert found.px_per_mm == pytest.approx(18.9)
        assert found.rms_px < 1e-9
        assert found.anisotropy < 1e-9
        noisy = [plane_scale(BOARD.points_mm, places + rng.normal(0, 0.1, places.shape)) for _ in range(60)]
        spread = np.std([one.px_per_mm for one in noisy], ddof=1)
        assert spread == pytest.approx(np.mean([one.deviation for one in noisy]), rel=0.3)
    assert plane_scale(BOARD.points_mm, MARKS * (20, 18)).anisotropy == pytest.approx(20 / 18 - 1)


def test_marks_that_do_not_do():
    with pytest.raises(BadInput, match="on one line"):
        plane_pose(BOARD.points_mm[:9], seen(MARKS, np.eye(3), (0, 0, 140.0))[:9], MATRIX)
    with pytest.raises(BadInput, match="at least 5 marks"):
        plane_pose(MARKS[:4], MARKS[:4], MATRIX)


def disc(rotation, middle, *, extra=(), shade=0.6, noise=0.004, size=(550, 800)):
    """Picture of dots of 1.5 mm every 10 mm, and where their centres are."""
    u, v = np.meshgrid(np.arange(-30, 31, 10.0), np.arange(-30, 31, 10.0))
    dots = np.column_stack([u.ravel(), v.ravel()])
    places = seen(dots, rotation, np.asarray(middle))
    sub = 8
    image = np.full((size[0] * sub, size[1] * sub), 215, np.uint8)
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = 0.75 * np.column_stack([np.cos(angle), np.sin(angle)])
    for dot in [*dots, *extra]:
        outline = (seen(rim + dot, rotation, np.asarray(middle)) + 0.5) * sub - 0.5
        cv2.fillPoly(image, [np.round(outline * 64).astype(np.int32)], 20, cv2.LINE_8, 6)
    image = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA) / 255
    ramp = np.linspace(1, shade, size[1])[None] * np.linspace(shade, 1, size[0])[:, None]
    image = cv2.GaussianBlur(image * ramp, (0, 0), 1.0)
    return np.clip(image + np.random.default_rng(2).normal(0, noise, image.shape), 0, 1), places


@pytest.mark.parametrize("spin", [0, 20, 44, 75])
def test_dots_of_the_disc(spin):
    rotation = base(1.5, -1.0) @ turned(0, 0, spin)
    image, truth = disc(rotation, (0.8, -0.5, 140.0))
    places_mm, centres = find_disc(np.round(255 * image).astype(np.uint8), 10.0)
    whole, surely = (np.all((truth > rim) & (truth < np.array([799, 549]) - rim), axis=1).sum() for rim in (14, 18))
    assert 8 <= surely <= len(centres) <= whole
    misses = np.linalg.norm(centres[:, None] - truth, axis=2).min(axis=1)
    assert misses.max() < 0.15
    pose = plane_pose(places_mm, centres, MATRIX)
    assert pose.height_mm == pytest.approx(140, rel=5e-4)
    assert pose.tilt_deg == pytest.approx(np.hypot(1.5, 1.0), abs=0.15)
    assert np.allclose(places_mm % 10, 0)


def test_what_is_no_dot_is_passed_over():
    """A scratch, a large spot, specks and a dot off the grid."""
    image, _ = disc(np.eye(3), (1.0, 0.5, 140.0))
    plain, _ = find_disc(image, 10.0)
    image[200:204, 300:380] = 0.1
    cv2.circle(image, (500, 250), 26, 0.1, -1)
    for k in range(20):
        image[40 + 3 * k, 150 + 5 * k] = 0.1
    cv2.circle(image, (330, 330), 14, 0.1, -1, cv2.LINE_AA)
    soiled, centres = find_disc(image, 10.0)
    assert len(soiled) == len(plain)
    assert np.ptp(soiled, axis=0).tolist() == np.ptp(plain, axis=0).tolist()
    assert plane_pose(soiled, centres, MATRIX).rms_px < 0.1


def test_pictures_without_a_disc():
    flat = 0.6 + np.random.default_rng(3).normal(0, 0.01, (300, 400))
    with pytest.raises(BadInput, match="black dots on a grid were found, but six are needed"):
        find_disc(flat, 10.0)
    with pytest.raises(BadInput, match="spacing must be"):
        find_disc(flat, 0.0)
