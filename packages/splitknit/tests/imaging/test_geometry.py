import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.imaging.geometry import (
    gradients_from_normals,
    height_gradients,
    normals_from_gradients,
    rotation_about,
    warp,
)
from splitknit.imaging.view import view_of
from splitknit.model import Camera


def axes_mm(camera):
    """x of the columns and y of the rows under parallel rays."""
    view = view_of(camera)
    return view.x_mm, view.y_mm


@pytest.mark.parametrize("size", [(4, 6), (5, 7)])
def test_pixels_lie_around_the_middle_with_y_up(size):
    x, y = axes_mm(Camera(px_per_mm=4.0, image_size=size))
    assert (x.size, y.size) == (size[1], size[0])
    assert x[-1] == -x[0] == pytest.approx((size[1] - 1) / 8)
    assert y[0] == -y[-1] == pytest.approx((size[0] - 1) / 8)
    assert x[1] - x[0] == pytest.approx(0.25)
    assert y[1] - y[0] == pytest.approx(-0.25)


def test_gradients_and_normals_of_a_plane_follow_its_slopes():
    camera = Camera(px_per_mm=10.0, image_size=(8, 9))
    x, y = axes_mm(camera)
    height = (0.3 * x[None, :] + 0.7 * y[:, None]).astype(np.float32)
    gradient_x, gradient_y = height_gradients(height, camera.pitch_mm)
    assert_allclose(gradient_x, 0.3, atol=1e-5)
    assert_allclose(gradient_y, 0.7, atol=1e-5)
    normals = normals_from_gradients(gradient_x, gradient_y)
    assert_allclose(normals[2, 3], np.array([-0.3, -0.7, 1.0]) / np.sqrt(1.58), atol=1e-5)


def test_gradients_are_one_sided_beside_gaps_and_never_nan():
    """Zero where a pixel stands alone."""
    height = np.array([[np.nan, 1.0, 3.0, 7.0, np.nan, 5.0]], dtype=np.float32)
    gradient_x, gradient_y = height_gradients(height, 0.5)
    assert_allclose(gradient_x, [[0.0, 4.0, 6.0, 8.0, 0.0, 0.0]])
    assert_array_equal(gradient_y, 0.0)


def test_normals_give_back_their_gradients():
    rng = np.random.default_rng(0)
    gradient_x, gradient_y = rng.uniform(-4, 4, (2, 5, 6)).astype(np.float32)
    normals = normals_from_gradients(gradient_x, gradient_y)
    assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, rtol=1e-6)
    back = gradients_from_normals(normals)
    assert_allclose(back, (gradient_x, gradient_y), rtol=1e-4, atol=1e-5)


def test_steep_slopes_are_shortened_in_their_direction():
    normals = np.array([[[-0.6, -0.8, 0.001], [0.6, 0.8, -0.2], [0.0, 0.0, 1.0]]], dtype=np.float32)
    gradient_x, gradient_y = gradients_from_normals(normals, max_slope=5.0)
    assert_allclose(gradient_x, [[3.0, -3.0, 0.0]], rtol=1e-5)
    assert_allclose(gradient_y, [[4.0, -4.0, 0.0]], rtol=1e-5)
    mask = np.array([[False, True, True]])
    assert gradients_from_normals(normals, mask)[0][0, 0] == 0.0


def test_rotations_are_counter_clockwise_in_the_image():
    turn = rotation_about((10.0, 20.0), np.pi / 2)
    assert_allclose(turn @ [10.0, 20.0, 1.0], [10.0, 20.0, 1.0], atol=1e-12)
    # right goes up
    assert_allclose(turn @ [13.0, 20.0, 1.0], [10.0, 17.0, 1.0], atol=1e-12)
    assert_allclose(turn @ rotation_about((10.0, 20.0), -np.pi / 2), np.eye(3), atol=1e-12)


def test_warp_shifts_and_turns_and_refuses_a_singular_matrix():
    image = np.random.default_rng(1).normal(size=(6, 8)).astype(np.float32)
    # source is right of and below the target
    shift = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    moved = warp(image, shift, (4, 9))
    assert moved.shape == (4, 9)
    assert_allclose(moved[:, :6], image[1:5, 2:8], atol=1e-6)
    assert (moved[:, 8] == 0.0).all()
    turned = warp(np.dstack([image, image]), rotation_about((2.5, 2.5), np.pi / 2), (6, 6))
    assert_allclose(turned[..., 1], np.rot90(image[:, :6], -1), atol=1e-6)
    with bad_input("singular"):
        warp(image, np.zeros((3, 3)), (4, 4))
