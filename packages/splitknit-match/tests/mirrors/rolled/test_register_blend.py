"""Ridges of two views brought together, and blended."""

import cv2
import numpy as np
import pytest

from splitknit.mirrors.reflection import Plane
from splitknit.model import Camera
from splitknit_match.prints.rolled import _coverage_deg
from splitknit_match.rolled.chart import Chart, Sight, surface_normals
from splitknit_match.rolled.finger import STEEPEST_DEG, _angles, _lengths, _view_weight, blend
from splitknit_match.rolled.register import ViewRidges, align, ridges_of, search

CAMERA = Camera(12.0, (420, 900))
LEAN = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
PLANE = Plane(np.array([20.0, 0.0, -8.0]), LEAN)
FRONT, RIGHT = Sight("front", CAMERA), Sight("right", CAMERA, PLANE)
LEFT = Sight("left", CAMERA, Plane(PLANE.point_mm * [-1, 1, 1], LEAN * [-1, 1, 1]))


def ridges(shape, seed=0):
    """Noise of one ridge period (6 px), whose directions wander."""
    noise = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5) - cv2.GaussianBlur(noise, (0, 0), 2.5)


def test_the_ridge_band_has_no_mean():
    relief = ridges((80, 80)) + 5.0
    band = ridges_of(relief, np.ones(relief.shape, bool), 0.1)
    assert abs(float(band.mean())) < 0.02
    assert np.corrcoef(band.ravel(), relief.ravel())[0, 1] > 0.95


def cylinder(radius):
    angles, lengths = _angles(100.0, 7.0, 0.1), _lengths(-14.0, 0.0, 0.1)
    chart = Chart(np.array([0.0, 0.0, -7.0]), np.eye(3), angles, lengths, 7.0)
    return chart, np.full(chart.shape, radius)


def bulged(chart, more, texture_seed=3):
    """Ridges of front and mirror on a chart of radius 7; the finger bulges by `more` in between."""
    fine = np.linspace(0.0, np.pi / 2, 4001)
    radius = 7.0 + more * np.sin(2 * fine) ** 2
    angle = np.clip(chart.angle_rad, 0.0, np.pi / 2)
    in_front = np.interp(7.0 * np.sin(angle), radius * np.sin(fine), fine)
    in_mirror = np.interp(-7.0 * np.cos(angle), -radius * np.cos(fine), fine)
    texture = ridges((chart.shape[0], 600), texture_seed)
    column, row = np.meshgrid(
        np.arange(chart.shape[1]), np.arange(chart.shape[0], dtype=np.float32)
    )
    views = []
    for seen in (in_front, in_mirror):
        place = (seen * 7.0 / 0.1)[column].astype(np.float32)
        views.append(cv2.remap(texture, place, row, cv2.INTER_CUBIC))
    degrees = np.rad2deg(chart.angle_rad)
    both = np.broadcast_to((degrees > 18) & (degrees < 72), chart.shape)
    return views[0] * both, views[1] * both, both, np.interp(angle, fine, radius) - 7.0


@pytest.mark.slow
@pytest.mark.parametrize("more", [0.3, -0.25])
def test_the_search_measures_a_bulge_by_the_ridges(more):
    chart, radius = cylinder(7.0)
    first, second, both, truth = bulged(chart, more)
    # ridges are shifted by more than a period
    assert np.corrcoef(first[both], second[both])[0, 1] < 0.3
    front = ViewRidges(FRONT, first, both)
    fit = search(chart, radius, front, ViewRidges(RIGHT, second, both))
    assert fit.correlations[0] > 0.8
    middle = np.abs(np.rad2deg(chart.angle_rad) - 45) < 15
    left = fit.radius_mm[70, middle] - truth[middle]
    # surface and mirror move the ridges in the same way: only their sum is measured
    assert np.abs(left + fit.poses[0][2] * np.sin(2 * chart.angle_rad[middle])).max() < 0.15
    unrelated = ViewRidges(RIGHT, ridges(chart.shape, 9) * both, both)
    assert not search(chart, radius, front, unrelated).radius_mm.any()


def test_alignment_bends_only_the_side_whose_ridges_are_shifted():
    chart, radius = cylinder(7.0)
    first, second, both, truth = bulged(chart, 0.04)
    # a left mirror's ridges lie where they should
    there = np.ascontiguousarray(both[:, ::-1])
    calm = ridges(chart.shape, 11) * there
    left, right = ViewRidges(LEFT, calm, there), ViewRidges(RIGHT, second, both)
    front = ViewRidges(FRONT, first + calm, both)
    aligned = align(chart, radius, front, (right, left))
    assert aligned.correlations[0] > 0.95
    assert aligned.correlations[1] > 0.99
    assert np.abs(aligned.radius_mm[:, there[70]]).max() < 0.005
    middle = np.abs(np.rad2deg(chart.angle_rad) - 45) < 15
    assert np.abs(aligned.radius_mm[30:110, middle] - truth[middle]).max() < 0.025
    # ridges that lie along the finger beside the front's are the turn of that mirror alone
    lower = ViewRidges(RIGHT, np.roll(second, 1, axis=0) * both, both)
    turned = align(chart, radius + truth, front, (left, lower))
    assert abs(turned.poses[1][1]) > 5 * abs(turned.poses[0][1])


def test_a_side_that_no_mirror_shows_stays_as_it_is():
    chart, radius = cylinder(7.0)
    first, second, both, _ = bulged(chart, 0.04)
    front = ViewRidges(FRONT, first, both)
    right_alone = align(chart, radius, front, (ViewRidges(RIGHT, second, both),))
    assert np.abs(right_alone.radius_mm[:, np.rad2deg(chart.angle_rad) < -25]).max() < 0.003
    empty = align(chart, radius, front, (ViewRidges(RIGHT, second, np.zeros_like(both)),))
    assert empty.radius_mm.max() == 0.0


def test_views_fade_into_each_other():
    chart, radius = cylinder(7.0)
    points = chart.points(radius)
    normals = surface_normals(points)
    known = np.ones(chart.shape, dtype=bool)
    deviation = np.full(chart.shape, 0.004, np.float32)
    cosines = [sight.cosine(normals, points) for sight in (FRONT, RIGHT)]
    weights = np.stack([_view_weight(cosine, known, deviation, 0.1) for cosine in cosines])
    degrees = np.rad2deg(chart.angle_rad)
    assert not weights[0][:, np.abs(degrees) > STEEPEST_DEG].any()
    assert not weights[1][:, degrees < 90 - STEEPEST_DEG].any()
    values = np.stack([np.zeros(chart.shape), np.ones(chart.shape)]).astype(np.float32)
    blended = blend(values, weights)
    assert np.allclose(blended.fractions.sum(axis=0)[blended.known], 1.0, atol=1e-5)
    rising = blended.relief_mm[70, (degrees > 18) & (degrees < 72)]
    assert (np.diff(rising) > -1e-6).all()
    assert np.abs(np.diff(rising)).max() < 0.2  # no jump between neighbours 0.1 mm apart
    assert blended.relief_mm[70, np.abs(degrees - 45).argmin()] == pytest.approx(0.5, abs=0.08)
    # from -72 deg of the front to the chart's end, less what fades out
    around = _coverage_deg(chart, blended.known, normals)
    assert np.median(around) == pytest.approx(72 + 100, abs=12)
