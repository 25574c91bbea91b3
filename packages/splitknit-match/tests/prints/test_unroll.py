"""Unrolling: bodies whose flat form is known, and the twin's finger."""

import numpy as np
import pytest

from bodies import PX_PER_MM, body_grid, plane_points
from refusals import bad_input
from splitknit.imaging.geometry import rotation_about
from splitknit_match.prints.unroll import KINDS, distortion, surface_grid, unroll

RADIUS = 8.0


def _cylinder():
    x, _ = plane_points((320, 260))
    mask = np.abs(x) < RADIUS * np.sin(np.deg2rad(70))
    return np.sqrt(np.maximum(RADIUS**2 - x**2, 0.01)), mask


def _off_arc(grid, flat_mm, slant_deg):
    """Largest difference of u from the cylinder's arc length, to the right, where it is no steeper
    than this."""
    x = grid.points_mm[..., 0][grid.inside]
    difference = flat_mm[..., 0][grid.inside] - RADIUS * np.arcsin(np.clip(x / RADIUS, -1, 1))
    difference = difference[np.abs(x) < RADIUS * np.sin(np.deg2rad(slant_deg))]
    return float(np.abs(difference - np.median(difference)).max())


def _cap():
    x, y = plane_points((300, 300))
    r2 = x**2 + y**2
    return np.sqrt(np.maximum(RADIUS**2 - r2, 0.01)), r2 < (RADIUS * np.sin(np.deg2rad(62))) ** 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_cylinder_unrolls_without_distortion(kind):
    grid = body_grid(*_cylinder())
    laid = unroll(grid, kind)
    assert laid.distortion["length_p95_percent"] < 1.5
    flat = laid.flat_mm[laid.grid.inside]
    assert _off_arc(laid.grid, laid.flat_mm, 62) < 0.03
    y = grid.points_mm[..., 1][laid.grid.inside]
    assert np.corrcoef(flat[:, 1], y)[0, 1] > 0.9999  # v is to the tip


def test_a_dome_is_relaxed():
    """No map of a dome is free of distortion; relaxing removes much of it."""
    grid = body_grid(*_cap())
    arc = unroll(grid, "arc").distortion
    free = unroll(grid, "free").distortion
    assert free["length_p95_percent"] < 0.7 * arc["length_p95_percent"]
    assert free["length_p95_percent"] > 3.0  # Gauss's theorem: something must give


def test_distortion_is_that_of_a_known_stretch():
    grid = body_grid(np.zeros((200, 200)), np.ones((200, 200), bool))
    flat = grid.points_mm[..., :2] * [1.1, 1.0]
    wanted = {"length_median_percent": 10.0, "length_p95_percent": 10.0}
    assert distortion(grid.points_mm, flat, grid.inside) == pytest.approx(wanted, abs=1e-3)
    turned = grid.points_mm[..., :2] @ np.array([[0.6, 0.8], [-0.8, 0.6]])
    assert distortion(grid.points_mm, turned, grid.inside)["length_p95_percent"] < 1e-3
    assert distortion(grid.points_mm, flat, grid.inside & False) == {}


def test_relaxing_keeps_the_ridge_spacing_of_a_finger(twin):
    """The distortion of the worst direction bounds the error of a ridge's period."""
    figures = unroll(twin.grid()).distortion
    assert figures["length_median_percent"] < 2.0
    arc = unroll(twin.grid(), "arc").distortion
    assert figures["length_p95_percent"] < 0.7 * arc["length_p95_percent"]


def test_a_cylinder_turned_by_20_deg_unrolls_to_its_arc():
    x, y = plane_points((360, 360))
    angle = np.deg2rad(20.0)
    across = x * np.cos(angle) + y * np.sin(angle)
    along = y * np.cos(angle) - x * np.sin(angle)
    turned_mask = (np.abs(across) < RADIUS * np.sin(np.deg2rad(70))) & (np.abs(along) < 8)
    height = np.sqrt(np.maximum(RADIUS**2 - across**2, 0.01))
    turned = np.where(turned_mask, height, np.nan).astype(np.float32)
    frame = rotation_about((179.5, 179.5), angle)
    grid = surface_grid(turned, turned_mask, 1 / PX_PER_MM, frame, (360, 360), node_mm=0.4)
    laid = unroll(grid)
    assert laid.distortion["length_p95_percent"] < 1.5
    assert _off_arc(grid, laid.flat_mm, 55) < 0.05


def test_a_cylinder_seen_from_60_mm_unrolls_to_its_arc():
    """Points lie nearer to the axis than their pixels."""
    _, mask = _cylinder()
    x, y = plane_points((320, 260))
    z = np.zeros_like(x)
    for _ in range(60):
        z = np.sqrt(np.maximum(RADIUS**2 - (x * (1 - z / 60)) ** 2, 0.01)) - RADIUS
    xy_mm = tuple((axis * (1 - z / 60)).astype(np.float32) for axis in (x, y))
    view = z.astype(np.float32), mask & (np.abs(x) < 7), 1 / PX_PER_MM, np.eye(3), mask.shape
    grid = surface_grid(*view, xy_mm=xy_mm, node_mm=0.4)
    assert _off_arc(grid, unroll(grid).flat_mm, 55) < 0.05


def test_surfaces_of_no_finger_are_refused():
    flat = np.zeros((40, 40), np.float32)
    mask = np.zeros((40, 40), bool)
    mask[:4, :4] = True
    with bad_input("too small"):
        surface_grid(flat, mask, 0.06, np.eye(3), (40, 40))
    with bad_input("pitch_mm"):
        surface_grid(flat, ~mask, float("nan"), np.eye(3), (40, 40))
    wide = np.zeros((300, 300), np.float32)
    # else a grid of gigabytes
    with bad_input("1520 mm long, more than any finger"):
        surface_grid(wide, wide == 0, 5.0, np.eye(3), wide.shape)
    with bad_input("pitch_mm"):
        surface_grid(wide, wide == 0, 1e-4, np.eye(3), wide.shape)
    with bad_input("too small"):
        surface_grid(flat, np.ones_like(mask), 0.001, np.eye(3), flat.shape)
    nan = wide * np.float32(np.nan)
    with bad_input("no finite height"):
        surface_grid(wide, wide == 0, 0.05, np.eye(3), wide.shape, xy_mm=(nan, wide))
