"""The twin's lens against OpenCV's, and what it lets through."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.imaging.view import lens_shading
from splitknit.model import Camera
from splitknit_simulator.camera.lens import (
    fall_off,
    picture_on_plane,
    pixels_of_points,
    slopes_of_pixels,
)

MATRIX = np.array([[2650.0, 0.0, 412.3], [0.0, 2610.0, 266.8], [0.0, 0.0, 1.0]])
DISTORTION = (0.3, -2.0, 4e-3, -3e-3, 5.0)
CAMERA = Camera(18.9, (550, 800), 140.0, "perspective", MATRIX, DISTORTION)


def _grid(camera):
    rows, columns = camera.image_size
    across, down = np.meshgrid(
        np.linspace(0.0, columns - 1.0, 23), np.linspace(0.0, rows - 1.0, 17)
    )
    return across.ravel(), down.ravel()


def test_pixels_survive_the_way_over_points_at_any_height():
    columns, rows = _grid(CAMERA)
    across, up = slopes_of_pixels(CAMERA, columns, rows)
    for z in (-20.0, 0.0, 12.5):
        depth = 140.0 - z
        there = pixels_of_points(CAMERA, across * depth, up * depth, np.full(columns.shape, z))
        assert_allclose(there[0], columns, atol=1e-7)
        assert_allclose(there[1], rows, atol=1e-7)


def test_rays_and_pixels_agree_with_opencv():
    columns, rows = _grid(CAMERA)
    pixels = np.stack([columns, rows], 1)[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rays = cv2.undistortPointsIter(
        pixels, MATRIX, np.array(DISTORTION), np.eye(3), np.eye(3), criteria
    )[:, 0]
    across, up = slopes_of_pixels(CAMERA, columns, rows)
    assert_allclose(np.stack([across, -up], 1), rays, atol=1e-8)
    points = np.random.default_rng(0).uniform((-18, -12, -15), (18, 12, 5), (200, 3))
    # OpenCV: y down, z away from the camera
    seen = np.stack([points[:, 0], -points[:, 1], 140.0 - points[:, 2]], 1)
    expected, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), MATRIX, np.array(DISTORTION))
    assert_allclose(np.stack(pixels_of_points(CAMERA, *points.T), 1), expected[:, 0], atol=1e-8)


def test_x_points_right_and_y_up():
    across, up = slopes_of_pixels(
        CAMERA, np.array([412.3, 500.0, 412.3]), np.array([266.8, 266.8, 100.0])
    )
    assert_allclose([across[0], up[0]], 0.0, atol=1e-12)
    assert across[1] > 0.03
    assert up[2] > 0.05


def test_the_edges_of_the_picture_are_found_on_the_finger_plane():
    x, lower, upper = picture_on_plane(CAMERA)
    column, row = pixels_of_points(CAMERA, np.full(2, x), np.array([lower, upper]), np.zeros(2))
    assert_allclose(row, [549.5, -0.5], atol=0.05)
    assert_allclose(column, 399.5, atol=0.6)  # the lens bends the middle column a little
    assert x == pytest.approx((399.5 - 412.3) / 18.9, abs=0.05)


def test_the_fall_off_equals_the_shading_that_reconstruction_divides_out():
    camera = Camera(18.9, (55, 80), shading=(-0.3, 0.12, -0.05))
    fraction = fall_off(camera)
    assert_allclose(fraction, lens_shading(camera.shading, camera.image_size), rtol=1e-6)
    assert fraction[27, 39] == pytest.approx(1.0, abs=1e-3)
    corner = (27.0**2 + 39.5**2) / (27.5**2 + 40.0**2)  # of half the diagonal, squared
    assert fraction[0, 0] == pytest.approx(
        1 - 0.3 * corner + 0.12 * corner**2 - 0.05 * corner**3, rel=1e-6
    )
    assert_array_equal(fall_off(Camera(18.9, (5, 8))), 1.0)


def test_lenses_that_cannot_be_inverted_are_refused():
    folding = Camera(18.9, (550, 800), 140.0, "perspective", MATRIX, (-40.0, 0.0, 0.0, 0.0, 0.0))
    with bad_input("folds the picture"):
        slopes_of_pixels(folding, *_grid(folding))
    rational = Camera(18.9, (550, 800), 140.0, "perspective", MATRIX, (0.1,) * 8)
    with bad_input("five coefficients"):
        slopes_of_pixels(rational, *_grid(rational))
    with bad_input("perspective"):
        slopes_of_pixels(Camera(18.9, (550, 800)), *_grid(CAMERA))
