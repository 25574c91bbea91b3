"""Reflected points and lights, and where they reach."""

import numpy as np
import pytest

from splitknit.mirrors.reflection import (
    Plane,
    facing_fraction,
    led_image,
    mirrored_fraction,
    reflect_points,
    reflect_vectors,
)
from splitknit.model import Led, Mirror

LEAN = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
RIGHT = Plane(np.array([20.0, 0.0, -8.0]), LEAN)
CORNERS = np.array(
    [[13.0, -10.0, -15.0], [27.0, -10.0, -1.0], [27.0, 10.0, -1.0], [13.0, 10.0, -15.0]]
)


def test_reflecting_twice_changes_nothing_and_points_of_the_mirror_stay():
    points = np.random.default_rng(0).normal(size=(5, 7, 3)) * 10
    assert np.allclose(reflect_points(reflect_points(points, RIGHT), RIGHT), points)
    assert np.allclose(reflect_points(CORNERS, RIGHT), CORNERS)


def test_a_mirror_of_45_deg_exchanges_height_and_breadth_and_changes_the_hand():
    # x - z = 28 on the mirror: (x, y, z) is seen at (z + 28, y, x - 28)
    assert np.allclose(reflect_points(np.array([7.0, 3.0, -4.0]), RIGHT), [24.0, 3.0, -21.0])
    turned = reflect_vectors(np.eye(3), RIGHT)
    assert np.linalg.det(turned) == pytest.approx(-1.0)


def test_an_led_and_its_image_are_symmetric_about_the_mirror():
    led = Led("white", position_mm=(52.5, 10.0, 140.0), lobe_exponent=2.0, intensity=2.0)
    image = led_image(led, RIGHT, 0.9)
    assert image.intensity == pytest.approx(1.8)
    assert image.reflected
    there = np.array([20.0, 4.0, -8.0])
    distances = [np.linalg.norm(np.array(each.position_mm) - there) for each in (led, image)]
    assert distances[0] == pytest.approx(distances[1])
    along = [np.dot(each.axis, there - np.array(each.position_mm)) for each in (led, image)]
    assert along[0] == pytest.approx(along[1])
    distant = led_image(Led("white", direction=(0.0, 0.0, 1.0)), RIGHT)
    assert np.allclose(distant.direction, [1.0, 0.0, 0.0])


def test_skin_facing_away_from_an_led_gets_no_light():
    led = Led("white", position_mm=(0.0, 0.0, 140.0))
    angle = np.deg2rad([0.0, 80.0, 89.9, 90.1, 150.0])
    normals = np.stack([np.sin(angle), np.zeros(5), np.cos(angle)], axis=-1)
    fraction = facing_fraction(np.zeros((5, 3)), normals, led)
    assert np.allclose(fraction[[0, 1]], 1.0)
    assert 0.0 < fraction[2] < 0.1
    assert np.array_equal(fraction[3:], [0.0, 0.0])


def test_reflected_light_ends_at_the_outline_of_the_mirror():
    led = Led("white", position_mm=(0.0, 0.0, 140.0))
    image = led_image(led, RIGHT)
    points = np.stack([np.full(41, 7.0), np.linspace(-16, 16, 41), np.full(41, -8.0)], axis=-1)
    fraction = mirrored_fraction(points, image, RIGHT, CORNERS)
    # from the image at distance D of the mirror, a point at d in front of it: the ray meets the
    # mirror at y D / (D + d)
    towards = np.array(image.position_mm) - points
    way = (points @ LEAN - RIGHT.offset_mm) / -(towards @ LEAN)
    met = points[:, 1] + way * towards[:, 1]
    assert np.array_equal(fraction > 0.5, np.abs(met) < 10.0)
    assert fraction.max() == 1.0
    # behind the mirror
    assert mirrored_fraction(points - 100 * LEAN, image, RIGHT, CORNERS).max() == 0.0
    assert np.array_equal(fraction, mirrored_fraction(points, image, RIGHT, CORNERS[::-1]))


def test_a_moved_plane_shifts_and_turns_by_the_stated_amounts():
    mirror = Mirror("right", tuple(tuple(float(v) for v in corner) for corner in CORNERS))
    plane = Plane(mirror.point_mm, mirror.normal)
    assert np.allclose(plane.normal, LEAN)
    moved = plane.moved((0.0, 0.0), 0.5)
    assert moved.offset_mm - plane.offset_mm == pytest.approx(0.5)
    turned = plane.moved((0.01, 0.0), 0.0)
    assert np.arccos(np.dot(turned.normal, plane.normal)) == pytest.approx(0.01, rel=1e-3)
    assert abs(np.dot(turned.normal - plane.normal, plane.axes()[0])) < 1e-9
