"""Where pixels look, and surfaces along their rays."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from refusals import bad_input
from splitknit.imaging.geometry import height_gradients
from splitknit.imaging.view import pixels_of, plane_points, view_of
from splitknit.model import Camera

SIZE = (180, 240)
LENS = (-0.15, 0.02, 0.001, -0.0015, 0.0)


def camera(distortion=LENS, size=SIZE):
    rows, columns = size
    focal = 5.0 * 60.0  # a wide view, so that what spreads is seen
    matrix = np.array([[focal, 0, columns / 2 + 6.0], [0, 1.01 * focal, rows / 2 - 4.0], [0, 0, 1]])
    return Camera(5.0, size, 60.0, "perspective", matrix, distortion)


def sphere(lens, radius=14.0, low=-9.0):
    """(H, W, 3) points of a sphere that every pixel sees (NaN beside it), normals, and the distance
    from the camera."""
    rows, columns = lens.image_size
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    plane = np.concatenate([plane_points(lens, grid), np.zeros((len(grid), 1))], axis=1)
    start = np.array([0.0, 0.0, lens.height_mm])
    rays = plane - start
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    centre = np.array([2.0, -1.0, low])
    along = (rays * (centre - start)).sum(axis=1)
    below = along**2 - ((centre - start) ** 2).sum() + radius**2
    far = along - np.sqrt(np.where(below > 4.0, below, np.nan))
    points = start + far[:, None] * rays
    normals = (points - centre) / radius
    return (
        points.reshape(rows, columns, 3),
        normals.reshape(rows, columns, 3),
        far.reshape(rows, columns),
    )


def log_height(lens, far):
    """Heights along rays whose slopes over equal steps are those of the pixels' frames."""
    return (lens.height_mm * np.log(lens.height_mm / far)).astype(np.float32)


def own_frames(view, normals):
    """(3, H, W) normals in the frame of each pixel."""
    return view.turned(np.moveaxis(normals, -1, 0)[None].astype(np.float32))[0]


@pytest.mark.parametrize("lens", [Camera(5.0, SIZE, 60.0), camera(None), camera()])
def test_pixels_survive_the_way_over_the_finger_plane(lens):
    pixels = np.random.default_rng(0).uniform(0, [SIZE[1] - 1, SIZE[0] - 1], (50, 2))
    plane = plane_points(lens, pixels)
    back = pixels_of(lens, np.concatenate([plane, np.zeros((50, 1))], axis=1))
    assert_allclose(back, pixels, atol=1e-5)


def test_a_higher_point_appears_further_out():
    lens = camera(None)
    low, high = pixels_of(lens, [[10.0, 0.0, 0.0], [10.0, 0.0, 6.0]]) - pixels_of(
        lens, [[0.0, 0.0, 0.0]]
    )
    assert high[0] / low[0] == pytest.approx(60 / 54, rel=1e-6)


def test_the_view_of_a_window_is_part_of_the_whole_view():
    lens = camera()
    whole = view_of(lens)
    part = view_of(lens, slice(20, 141), slice(33, 200), binning=4)
    assert part.x_mm.shape == (30, 41)
    expected = whole.x_mm[20:140, 33:197].reshape(30, 4, 41, 4).mean(axis=(1, 3))
    assert_allclose(part.x_mm, expected, atol=2e-3)
    exact = plane_points(lens, np.array([[100.0, 50.0], [0.0, 0.0], [239.0, 179.0]]))
    assert_allclose(
        exact[:, 1], [whole.y_mm[50, 100], whole.y_mm[0, 0], whole.y_mm[179, 239]], atol=1e-5
    )


def test_turned_vectors_are_rotated_so_that_the_camera_is_overhead():
    lens = camera()
    view = view_of(lens, along_rays=True)
    vectors = np.random.default_rng(1).standard_normal((2, 3, *SIZE)).astype(np.float32)
    turned = view.turned(vectors)
    assert_allclose((turned**2).sum(axis=1), (vectors**2).sum(axis=1), rtol=1e-4)
    assert_allclose(
        view.in_rig(np.moveaxis(turned[0], 0, -1)), np.moveaxis(vectors[0], 0, -1), atol=1e-5
    )
    x, y = view.on_plane()
    towards = np.stack([-x, -y, np.full(SIZE, 60.0)])[None].astype(np.float32)
    own = view.turned(towards)[0]
    assert np.abs(own[:2]).max() < 1e-4
    assert (own[2] > 59).all()


def test_log_heights_along_rays_give_the_points_of_a_sphere():
    lens = camera()
    points, _, far = sphere(lens)
    view = view_of(lens, along_rays=True)
    x, y, z = view.points(log_height(lens, far))
    seen = np.isfinite(far)
    assert_allclose(np.stack([x, y, z], axis=-1)[seen], points[seen], atol=2e-4)


def test_slopes_along_rays_agree_with_the_normals():
    lens = camera()
    _, normals, far = sphere(lens)
    height = log_height(lens, far)
    right, up = height_gradients(height, lens.pitch_mm)
    view = view_of(lens, along_rays=True)
    own = own_frames(view, normals)
    slope_x, slope_y = -own[0] / own[2], -own[1] / own[2]
    x_x, x_y, y_x, y_y = view.stretch(lens.pitch_mm, SIZE)
    inner = np.isfinite(height) & (np.hypot(slope_x, slope_y) < 1.0)
    error_right = (right - (slope_x * x_x + slope_y * y_x))[inner]
    assert np.abs(error_right).max() < 5e-3
    assert np.abs(up - (slope_x * x_y + slope_y * y_y))[inner].max() < 5e-3
    # without the stretch the error is seen
    assert error_right.std() < 0.3 * (right - slope_x)[inner].std()


def test_a_regular_grid_is_not_stretched():
    x_x, x_y, y_x, y_y = view_of(Camera(5.0, SIZE), along_rays=True).stretch(0.2, SIZE)
    assert np.allclose(x_x, 1) and np.allclose(y_y, 1) and not x_y.any() and not y_x.any()


def test_points_not_below_the_camera_are_refused():
    with bad_input("below the camera"):
        pixels_of(camera(), [[0.0, 0.0, 60.0]])
