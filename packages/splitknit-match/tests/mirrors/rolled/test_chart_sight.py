"""The chart around a finger, and how views see it."""

from dataclasses import replace

import numpy as np
import pytest

from splitknit.imaging.geometry import sampled_at
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.mirrors.reflection import Plane, shade_of
from splitknit.model import Camera, Led, Rig
from splitknit_match.rolled.chart import Chart, Sight, heights, surface_normals
from splitknit_match.rolled.finger import _angles, _lengths, _sampled

CAMERA = Camera(12.0, (420, 900))
FOCAL = 12.0 * 140.0
MATRIX = np.array([[FOCAL, 0.0, 449.5], [0.0, FOCAL, 209.5], [0.0, 0.0, 1.0]])
A, B, CAP = 8.0, 6.5, 8.0
LEAN = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
RIGHT = Sight("right", CAMERA, Plane(np.array([20.0, 0.0, -8.0]), LEAN))
FRONT = Sight("front", CAMERA)


def near_camera(distortion):
    """140 mm above the finger plane."""
    return Camera(12.0, (420, 900), 140.0, "perspective", MATRIX, distortion)


def capsule_chart(pitch=0.25, half_angle_deg=170.0):
    angles, lengths = _angles(half_angle_deg, A, pitch), _lengths(-14.0, 10.0, pitch)
    return Chart(np.zeros(3), np.eye(3), angles, lengths, CAP)


def off_ellipsoid(x, y, z):
    return np.sqrt((x / A) ** 2 + (np.maximum(y, 0) / CAP) ** 2 + (z / B) ** 2) - 1


def capsule_radius(chart):
    """Distance of x^2/A^2 + max(y,0)^2/CAP^2 + z^2/B^2 = 1 along the rays."""
    _, rays = chart.rays()
    fan = rays * np.where(chart.length_mm[:, None, None] > 0, 1.0, np.array([1.0, 0.0, 1.0]))
    return 1.0 / np.sqrt((fan[..., 0] / A) ** 2 + (fan[..., 1] / CAP) ** 2 + (fan[..., 2] / B) ** 2)


def test_points_of_a_chart_are_located_where_they_lie():
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    axes = turn * np.sign(np.linalg.det(turn))
    angles, lengths = _angles(120.0, 8.0, 0.5), _lengths(-12.0, 9.0, 0.5)
    chart = Chart(np.array([3.0, -2.0, 1.0]), axes, angles, lengths, 8.0)
    radius = np.random.default_rng(0).uniform(5, 8, chart.shape)
    angle, length, distance = chart.locate(chart.points(radius))
    assert np.allclose(angle, chart.angle_rad[None], atol=1e-9)
    assert np.allclose(length, chart.length_mm[:, None], atol=1e-9)
    assert np.allclose(distance, radius)
    column, row = chart.places(angle, length)
    assert np.allclose(column, np.arange(chart.shape[1])[None], atol=1e-3)
    assert np.allclose(row, np.arange(chart.shape[0])[:, None], atol=1e-3)


def test_normals_point_outwards():
    chart = capsule_chart()
    points = chart.points(capsule_radius(chart))
    on_the_cap = np.where(points[..., 1:2] > 0, 1.0, np.array([1.0, 0.0, 1.0]))
    expected = points / np.array([A, CAP, B]) ** 2 * on_the_cap
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    assert np.abs(surface_normals(points) - expected)[2:-2, 2:-2].max() < 0.02


def test_a_surface_goes_from_chart_to_chart():
    coarse, fine = capsule_chart(0.5), capsule_chart(0.1, half_angle_deg=90.0)
    radius = _sampled(coarse, capsule_radius(coarse), fine)
    # the second derivative jumps where the cap begins
    assert np.abs(radius - capsule_radius(fine)).max() < 5e-3


def test_values_beyond_the_border_are_nan_or_empty():
    field = np.arange(12.0, dtype=np.float32).reshape(3, 4)
    x, y = np.array([[1.5, -3.0]], np.float32), np.array([[1.0, 0.0]], np.float32)
    assert sampled_at(field, x, y, outside=np.nan)[0, 0] == pytest.approx(5.5)
    assert np.isnan(sampled_at(field, x, y, outside=np.nan)[0, 1])
    assert sampled_at(field, x, y, outside=0.0)[0, 1] == 0.0


def test_the_front_sees_the_top_and_the_mirror_the_side():
    chart = capsule_chart()
    radius = capsule_radius(chart)
    x, y = np.linspace(-6, 6, 25), np.linspace(4, -10, 29)
    seen = heights(FRONT, chart, radius, View(x, y))
    cap = np.maximum(y, 0)[:, None] / CAP
    expected = B * np.sqrt(1 - (x[None] / A) ** 2 - cap**2)
    assert np.abs(seen - expected).max() < 0.02
    # (x, y, z) is seen at (z + 28, y, x - 28): the side of +x
    z = np.linspace(-5, 5, 21)
    side = heights(RIGHT, chart, radius, View(z + 28.0, y))
    assert np.abs(side - (A * np.sqrt(1 - (z[None] / B) ** 2 - cap**2) - 28.0)).max() < 0.02
    assert np.isnan(heights(FRONT, chart, radius, View(np.array([9.0, 30.0]), y))).all()


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.15, 0.0, 0.0, 0.0, 0.0)])
def test_spreading_rays_meet_the_finger_where_their_pixels_show_it(distortion):
    chart, camera = capsule_chart(), near_camera(distortion)
    radius = capsule_radius(chart)
    for sight, columns in (
        (replace(FRONT, camera=camera), (380, 520)),
        (replace(RIGHT, camera=camera), (690, 802)),
    ):
        window = slice(180, 300), slice(*columns)
        view = view_of(camera, *window, binning=4)
        z = heights(sight, chart, radius, view)
        met = np.isfinite(z)
        assert met.mean() > 0.7
        points = sight.to_view(np.stack(view.points(np.nan_to_num(z)), axis=-1).astype(np.float64))
        assert np.abs(off_ellipsoid(*points[met].T)).max() < 0.01
        column, row = sight.pixels(points)
        at = np.meshgrid(np.arange(columns[0], columns[1], 4) + 1.5, np.arange(180, 300, 4) + 1.5)
        assert np.abs(column - at[0])[met].max() < 0.02
        assert np.abs(row - at[1])[met].max() < 0.02
        # heights along the rays of the view lead back to the same points
        rays = replace(view, along_rays=True)
        again = np.stack(rays.points(rays.along(np.nan_to_num(z))), axis=-1)
        assert np.abs(sight.to_view(again.astype(np.float64)) - points)[met].max() < 1e-3
        # the line of sight: towards the camera, by way of the mirror
        towards = np.array([0.0, 0.0, 140.0]) - sight.to_view(points[met])
        towards = sight.turned(towards / np.linalg.norm(towards, axis=-1, keepdims=True))
        assert np.allclose(sight.cosine(towards, points[met]), 1.0)


def test_a_shade_is_read_along_the_rays_of_a_lens():
    camera = near_camera((-0.15, 0.0, 0.0, 0.0, 0.0))
    view = view_of(camera, slice(100, 300), slice(600, 880), binning=4)
    x, y = view.on_plane()
    z = 10.0 * np.sin(0.3 * x) - 20.0
    lit = (np.sin(0.2 * x) * np.cos(0.3 * y)).astype(np.float32)  # of the pixel, whatever its depth
    led = Led("white", position_mm=(0.0, 0.0, 140.0))
    points = view.points(z.astype(np.float32))
    bare, shaded = (
        light_vectors_at(Rig(camera, (lamp,), {}), *points)
        for lamp in (led, replace(led, shade=shade_of(lit, view)))
    )
    assert np.abs(shaded - lit * bare)[..., 2:-2, 2:-2].max() < 0.01
