"""Stripes, lines, focus and stereo on surfaces whose pictures are exact."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput

with scripts_of(VALIDATION / "scanners") as script:
    cloud, focus, laser, stereo, structured_light = map(
        script, ("cloud", "focus", "laser", "stereo", "structured_light")
    )
    View, cloud_of, on_planes = (
        getattr(script("views"), name) for name in ("View", "cloud_of", "on_planes")
    )

SHAPE = (60, 80)


def view(deg: float, about: int, focal: float = 1400.0, shape: tuple[int, int] = SHAPE) -> View:
    """A pinhole 140 mm from the origin, turned about x (0) or y (1), looking at it from above."""
    angle = np.zeros(3)
    angle[about] = np.deg2rad(deg)
    rotation = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(angle)[0]
    matrix = np.array([[focal, 0, (shape[1] - 1) / 2], [0, focal, (shape[0] - 1) / 2], [0, 0, 1.0]])
    return View(matrix, rotation, np.array([0, 0, 140.0]))


def hill(camera: View, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Points where a camera's rays meet z = -0.02 (x^2 + y^2)."""
    rays, centre = camera.directions(shape), camera.centre_mm
    points = np.zeros((*shape, 3))
    for _ in range(30):
        z = -0.02 * (points[..., 0] ** 2 + points[..., 1] ** 2)
        points = centre + ((z - centre[2]) / rays[..., 2])[..., None] * rays
    return points


def test_phases_of_three_periods_give_points_and_their_uncertainty() -> None:
    camera, projector = view(0, 0), view(25, 0, 4000.0, (600, 600))
    truth = hill(camera)
    row = projector.pixels(truth)[1]
    periods = (600.0, 120.0, 30.0)
    rng = np.random.default_rng(0)
    shots = [[structured_light.fringes(row, p, k, 5) for k in range(5)] for p in periods]
    images = np.array(shots) + 0.002 * rng.standard_normal((3, 5, *SHAPE))
    images[:, :, :5] = 0.3  # no fringes
    decoded = structured_light.decode(images, periods)
    assert np.isnan(decoded.row[:5]).all()
    error = (decoded.row - row)[5:]
    assert error.std() < 0.05
    assert decoded.sigma[5:].mean() == pytest.approx(error.std(), rel=0.2)
    points, sigma = structured_light.scan(camera, projector, decoded)
    away = np.linalg.norm(points - truth[5:].reshape(-1, 3), axis=1)
    assert np.sqrt((away**2).mean()) == pytest.approx(
        float(np.sqrt((sigma[5:] ** 2).mean())), rel=0.2
    )


def test_a_ray_meets_the_plane_of_its_row() -> None:
    camera, projector = view(3, 1), view(-20, 0, 4000.0)
    truth = hill(camera)
    row = projector.pixels(truth)[1]
    points, slope = on_planes(camera, projector, row)
    np.testing.assert_allclose(points, truth, atol=1e-8)
    moved = on_planes(camera, projector, row + 1e-3)[0]
    np.testing.assert_allclose(np.linalg.norm(moved - points, axis=-1), 1e-3 * slope, rtol=1e-4)


def test_a_line_that_passes_is_timed_between_frames() -> None:
    camera, scanner = view(0, 0), view(25, 0, 4000.0, (600, 600))
    truth = hill(camera)
    row = scanner.pixels(truth)[1]
    first, step = row.min() - 20.0, 5.0
    count = int((np.ptp(row) + 40) / step)
    frames = (np.exp(-0.5 * ((row - first - k * step) / 6.0) ** 2) for k in range(count))
    points = laser.scan(camera, scanner, laser.peaks(frames), (first, step))
    np.testing.assert_allclose(points, truth.reshape(-1, 3), atol=2e-3)


def test_the_sharpest_picture_tells_the_depth() -> None:
    shape = (120, 120)
    texture = np.random.default_rng(1).random(shape).astype(np.float32)
    depth = np.linspace(3, 16, shape[1])[None, :].repeat(shape[0], axis=0)
    stack = []
    for k in range(20):
        columns = [
            cv2.GaussianBlur(texture, (0, 0), 0.4 + 0.5 * abs(k - d))[:, i]
            for i, d in enumerate(depth[0])
        ]
        stack.append(np.stack(columns, axis=1))
    number, sharp = focus.depth(np.array(stack), 6.0)
    inner = (slice(10, -10), slice(10, -10))
    assert np.nanstd((number - depth)[inner]) < 0.3
    assert sharp.std() > np.mean(stack, axis=0).std()
    camera = view(0, 0, shape=shape)
    assert np.ptp(focus.scan(camera, number, (1.0, -0.5))[:, 2]) == pytest.approx(6.5, abs=0.8)


def test_two_cameras_find_a_hill_with_texture() -> None:
    shape = (200, 240)
    views = [view(deg, 1, 4200.0, shape) for deg in (-8.0, 8.0)]
    texture = cv2.GaussianBlur(
        np.random.default_rng(2).random((600, 600)).astype(np.float32), (0, 0), 2.0
    )
    texture = (texture - texture.min()) / np.ptp(texture)
    pictures = []
    for camera in views:
        places = hill(camera, shape)
        u, v = (300 + 50 * places[..., k].astype(np.float32) for k in (0, 1))
        pictures.append(cv2.remap(texture, u, v, cv2.INTER_LINEAR) + 0.1)
    points = stereo.scan(pictures, views, np.zeros(3), 2.0)
    x, y, z = points.T
    error = z + 0.02 * (x**2 + y**2)
    assert len(z) > 0.5 * shape[0] * shape[1]
    assert np.median(np.abs(error)) < 0.02


def test_silhouettes_of_a_cylinder_enclose_it() -> None:
    shape, radius = (100, 200), 5.0
    views = [view(deg, 1, 1000.0, shape) for deg in range(-75, 90, 30)]
    masks = []
    for camera in views:
        ray, centre = camera.directions(shape)[..., [0, 2]], camera.centre_mm[[0, 2]] + [0, 5.0]
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        masks.append(np.abs(ray[..., 0] * centre[1] - ray[..., 1] * centre[0]) < radius)
    points = stereo.hull(masks, views, np.array([[-6.0, -3.0, -6.0], [6.0, 3.0, 2.0]]), 0.2)
    x, _, z = points.T
    over = np.hypot(x, z + 5.0)[z > -3.0] - radius
    assert over.min() > -0.1
    assert over.max() < 0.4


def test_scattered_points_are_fitted_and_the_hole_stays() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-6, 6, 200_000), rng.uniform(-8, 8, 200_000)

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        shape = np.sqrt(np.maximum(81.0 - x**2 - np.maximum(y - 5, 0) ** 2, 0.0)) - 4.0
        return shape + 0.02 * np.cos(2 * np.pi * np.hypot(x, y - 2) / 0.5)

    away = np.hypot(x - 1, y + 3) > 1
    points = np.stack([x, y, height(x, y)], axis=1)[away].astype(np.float32)
    below = points * np.float32([1, 1, -1]) - np.float32([0, 0, 3])
    result = cloud.result_of_points(np.concatenate([points, below]))
    rows, columns = np.nonzero(result.mask)
    x_mm, y_mm = (
        points[:, 0].min() + columns * result.pitch_mm,
        points[:, 1].max() - rows * result.pitch_mm,
    )
    error = result.height_mm[result.mask] - height(x_mm, y_mm)
    assert np.sqrt((error**2).mean()) < 0.0015
    assert np.hypot(x_mm - 1, y_mm + 3).min() > 0.9
    with pytest.raises(BadInput, match="16 at least"):
        cloud.result_of_points(points[:9])
    with pytest.raises(BadInput, match="is not a surface"):
        cloud.result_of_points(rng.uniform(0, 10, (5000, 3)).astype(np.float32))


@pytest.mark.parametrize(("up", "turn"), [("x", [2, 0, 1]), ("-y", [0, 2, 1]), ("y", [0, 2, 1])])
def test_points_are_seen_from_the_axis_that_is_named(
    up: str, turn: list[int], tmp_path: Path
) -> None:
    points = np.random.default_rng(1).uniform(0, 1, (99, 3))
    points[:, 2] = points[:, 0] + 3
    stored = points[:, turn] * ([1, -1, 1] if up == "-y" else [1, 1, 1])
    np.savetxt(tmp_path / "a.xyz", stored / 25.4)
    read = cloud.points_of(tmp_path / "a.xyz", up, 25.4)
    np.testing.assert_allclose(
        read[:, 2] - read[:, 2].mean(), points[:, 2] - points[:, 2].mean(), atol=1e-5
    )
