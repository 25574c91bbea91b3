"""The finger's surface: heights, normals, chart, pose, scale."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage

from refusals import bad_input
from splitknit.model import Camera
from splitknit_simulator.finger.finger import (
    FREQUENCIES,
    FingerPose,
    draw_finger,
    finger_surface,
    placement_of,
)
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.finger.shape import FingerBody, FingerShape
from splitknit_simulator.finger.skin_map import FlexionCrease, SkinRelief

SHORT = MasterPrintSettings(proximal_mm=12.0)
POSE = FingerPose(
    yaw_rad=0.2, pitch_rad=-0.1, roll_rad=0.25, x_mm=1.5, insertion_mm=33.0, height_mm=0.5
)
CAMERA = Camera(20.0, (840, 580))
SMALL = Camera(10.0, (420, 290))


@pytest.fixture(scope="module")
def finger():
    drawn = draw_finger(2, "left_loop", print_settings=SHORT)
    return replace(drawn, printed=drawn.master())


@pytest.fixture(scope="module")
def seen(finger):
    return finger_surface(finger, POSE, CAMERA)


def window(camera, row, column, factor, size):
    """A camera of `factor` times the scale for `size` pixels, and where the old pixel lies in its
    frame."""
    x = (column - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
    y = ((camera.image_size[0] - 1) / 2 - row) / camera.px_per_mm
    return Camera(camera.px_per_mm * factor, (size, size)), x, y


def test_the_gradient_of_the_body_agrees_with_differences():
    body = FingerBody(FingerShape(sideways_mm=0.5, skew=0.03, arching_per_mm=0.003))
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(-8, 8, 500), rng.uniform(-20, 25, 500), rng.uniform(0.5, 8, 500)
    value, *gradient = body.value_and_gradient(x, y, z)
    step = 1e-6
    for axis in range(3):
        shifted = [x, y, z]
        shifted[axis] = shifted[axis] + step
        numeric = (body.value_and_gradient(*shifted)[0] - value) / step
        assert_allclose(numeric, gradient[axis], atol=1e-5)


def test_the_chart_keeps_lengths_to_sixty_degrees():
    """Small steps on the skin against steps in the chart: within 3 % around the finger, 14 % on the
    cap's shoulders."""
    body = FingerBody(FingerShape())
    x, y = np.meshgrid(np.linspace(-8, 8, 81), np.linspace(-12, 24.5, 180))

    def at(x, y):
        points = np.stack([x, y, body.top(x, y)], -1)
        return points, np.stack(
            body.distance_and_chart(*(points[..., k] for k in range(3)))[1:], -1
        )

    step = 1e-4
    points, chart = at(x, y)
    beside, chart_beside = at(x + step, y)
    above, chart_above = at(x, y + step)
    tangent_x, tangent_y = (beside - points) / step, (above - points) / step
    normal = np.cross(tangent_x, tangent_y)
    slant = np.rad2deg(np.arccos(normal[..., 2] / np.linalg.norm(normal, axis=-1)))
    for angle in np.deg2rad(np.arange(0, 180, 15)):
        way = np.cos(angle) * tangent_x / np.linalg.norm(tangent_x, axis=-1, keepdims=True)
        way = way + np.sin(angle) * tangent_y / np.linalg.norm(tangent_y, axis=-1, keepdims=True)
        cx = np.cos(angle) / np.linalg.norm(tangent_x, axis=-1)
        cy = np.sin(angle) / np.linalg.norm(tangent_y, axis=-1)
        laid = (
            cx[..., None] * (chart_beside - chart) / step
            + cy[..., None] * (chart_above - chart) / step
        )
        stretch = np.linalg.norm(laid, axis=-1) / np.linalg.norm(way, axis=-1)
        straight = (slant < 60) & (y < 13)
        cap = (slant < 60) & (y >= 13)
        assert np.abs(stretch[straight] - 1).max() < 0.035
        assert -0.035 < (stretch[cap] - 1).min() < (stretch[cap] - 1).max() < 0.16
        assert np.median(np.abs(stretch[cap] - 1)) < 0.03
    middle = np.abs(x) < 0.2
    assert_allclose(chart[middle & (y < 13), 1], y[middle & (y < 13)], atol=0.05)


def test_every_pixel_lies_on_the_skin(seen, finger):
    """Relief is the distance from the smooth shape: on flat parts, the difference of heights times
    the cosine."""
    assert not (ndimage.binary_fill_holes(seen.mask) & ~seen.mask).any()
    assert np.array_equal(np.isfinite(seen.height_mm), seen.mask)
    assert np.array_equal(np.isfinite(seen.shape_mm), seen.mask)
    facing = seen.mask & (seen.shape_normals[..., 2] > 0.9) & (seen.relief_um > -80)
    drop = 1e3 * (seen.height_mm - seen.shape_mm)[facing] * seen.shape_normals[facing][:, 2]
    assert_allclose(drop, seen.relief_um[facing], atol=1.5)
    rows, columns = np.nonzero(seen.mask & (seen.normals[..., 2] > 0.25))
    body = FingerBody(finger.shape)
    x, y = (columns - 289.5) / 20.0, (419.5 - rows) / 20.0
    distance, _, _ = body.distance_and_chart(
        *placement_of(body, POSE, CAMERA).to_finger(x, y, seen.height_mm[rows, columns])
    )
    assert_allclose(1e3 * distance, seen.relief_um[rows, columns], atol=0.02)
    ridges = seen.relief_um[facing]
    assert ridges.max() < 2.0
    assert (
        -1.4 * finger.skin.ridge_depth_um
        < np.percentile(ridges, 3)
        < -0.6 * finger.skin.ridge_depth_um
    )


@pytest.mark.slow
def test_normals_agree_with_differences_of_heights(seen, finger):
    """A camera of 100 times the scale looks at single spots: finite differences of its heights give
    the normals.

    The finger is shifted so that the spot lies on the small camera's axis.
    """
    rng = np.random.default_rng(1)
    steep = seen.normals[..., 2]
    for low, high in ((0.9, 1.0), (0.7, 0.9), (0.5, 0.7), (0.3, 0.5)):
        rows, columns = np.nonzero(seen.mask & (steep > low) & (steep < high))
        pick = rng.integers(len(rows), size=3)
        for row, column in zip(rows[pick], columns[pick], strict=True):
            near, x, y = window(CAMERA, row, column, 100, 7)
            border = POSE.insertion_mm + (-0.5 * CAMERA.image_size[0] / CAMERA.px_per_mm) - y
            pose = replace(POSE, x_mm=POSE.x_mm - x, insertion_mm=border + 0.5 * 7 / near.px_per_mm)
            spot = finger_surface(finger, pose, near)
            z = spot.height_mm.astype(np.float64)
            assert z[3, 3] == pytest.approx(seen.height_mm[row, column], abs=2e-5)
            slope_x = (z[3, 6] - z[3, 0]) / (6 * near.pitch_mm)
            slope_y = (z[0, 3] - z[6, 3]) / (6 * near.pitch_mm)
            normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1 + slope_x**2 + slope_y**2)
            angle = np.rad2deg(np.arccos(np.clip(normal @ seen.normals[row, column], -1, 1)))
            assert angle < 0.6, (row, column, angle)


@pytest.mark.slow
def test_a_finger_lies_at_its_pose(finger):
    for pose in (FingerPose(), FingerPose(roll_rad=-0.3, height_mm=-0.7, insertion_mm=28.0)):
        surface = finger_surface(finger, pose, SMALL)
        tip = SMALL.image_size[0] - pose.insertion_mm * SMALL.px_per_mm
        assert surface.landmarks["tip_px"][1] == pytest.approx(tip, abs=1.5)
        pad = surface.shape_mm[: int(tip + (finger.shape.length_mm - 1) * SMALL.px_per_mm)]
        assert np.nanmax(pad) == pytest.approx(pose.height_mm, abs=0.01)
        assert surface.mask[-1].any()
        assert not surface.mask[0].any()
    rows = np.arange(225, 300)

    def lean(surface):
        columns = np.arange(SMALL.image_size[1])
        middles = [columns[surface.mask[row]].mean() for row in rows]
        return float(np.arctan(np.polyfit(rows, middles, 1)[0]))

    straight = lean(finger_surface(finger, FingerPose(), SMALL))
    turned = lean(finger_surface(finger, FingerPose(yaw_rad=0.2), SMALL))
    # the tip turns left: columns grow with the row
    assert turned - straight == pytest.approx(0.2, abs=0.02)


def test_creases_are_grooves_at_their_landmarks(finger):
    pose = FingerPose(insertion_mm=58.0)
    camera = Camera(12.0, (744, 360))
    settings = SkinRelief(
        creases=(FlexionCrease(side_lines=0), FlexionCrease(v_mm=-11.5, depth_mm=0.5, side_lines=0))
    )
    surface = finger_surface(replace(finger, skin=settings), pose, camera)
    for line, crease in zip(surface.landmarks["crease_px"], settings.creases, strict=True):
        near = line[np.abs(line[:, 0] - 180) < 40]
        columns, rows = np.rint(near).astype(int).T
        assert surface.relief_um[rows, columns].mean() == pytest.approx(
            -1e3 * crease.depth_mm, rel=0.2
        )
        assert surface.pigment[rows, columns].mean() == pytest.approx(
            1 - crease.darkening, abs=0.05
        )
        assert np.abs(surface.relief_um[rows - 18, columns]).max() < 150
    first, second = (line[:, 1].mean() for line in surface.landmarks["crease_px"])
    assert first < second


def test_drawn_fingers_stay_in_their_ranges():
    fingers = [draw_finger(seed) for seed in range(200)]
    widths = np.array([f.shape.width_mm for f in fingers])
    lengths = np.array([f.shape.length_mm for f in fingers])
    depths = np.array([f.skin.ridge_depth_um for f in fingers])
    assert widths.min() >= 14 and widths.max() <= 20 and 1.0 < widths.std() < 1.8
    assert lengths.min() >= 22 and lengths.max() <= 28 and lengths.std() > 1.0
    assert depths.min() >= 40 and depths.max() <= 100
    assert np.corrcoef(widths, lengths)[0, 1] > 0.3
    assert {f.pattern for f in fingers} == set(FREQUENCIES)
    assert draw_finger(3) == draw_finger(3)
    assert draw_finger(3, "whorl").shape == draw_finger(3, "arch").shape


def test_cameras_and_poses_that_show_no_finger_are_refused(finger):
    wild = Camera(20.0, (840, 580), model="perspective", matrix=np.eye(3))
    with bad_input("sees nothing"):
        finger_surface(finger, FingerPose(), wild)
    with bad_input("height_mm"):
        finger_surface(finger, FingerPose(), replace(wild, height_mm=4.0))
    with bad_input("sees nothing"):
        finger_surface(finger, FingerPose(x_mm=200.0), CAMERA)
    with bad_input("insertion_mm"):
        FingerPose(insertion_mm=-1.0)
