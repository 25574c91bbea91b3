"""Checks of meshes, on bodies whose answers are known; no CAD needed."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit_rig.rig.assembly import PartKind
from splitknit_rig.rig.part_reports import (
    _check_soundness,
    _first_hits,
    _overhang,
    _slice_mask,
    _thinnest_wall,
    report_part,
)
from splitknit_rig.rig.part_settings import PrinterSettings

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def block(low, high):
    low, high = np.array(low, dtype=np.float32), np.array(high, dtype=np.float32)
    corners = low + CORNERS * (high - low)
    faces = [face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))]
    return corners[np.array(faces)].astype(np.float32)


def hollow(outside, wall):
    inside = block((wall,) * 3, tuple(value - wall for value in outside))[:, ::-1]
    return np.concatenate([block((0, 0, 0), outside), inside])


def prism(outline, length):
    """A polygon (x, z), convex, counter-clockwise seen from -y, extruded along y."""
    count = len(outline)
    front = np.array([(x, 0.0, z) for x, z in outline])
    back = front + np.array([0.0, length, 0.0])
    faces = [(front[0], front[k], front[k + 1]) for k in range(1, count - 1)]
    faces += [(back[0], back[k + 1], back[k]) for k in range(1, count - 1)]
    for k in range(count):
        n = (k + 1) % count
        faces += [(front[k], back[n], front[n]), (front[k], back[k], back[n])]
    return np.array(faces, dtype=np.float32)


def test_a_block_is_watertight():
    edges, faults, volume_mm3 = _check_soundness(block((1, 2, 3), (4, 6, 8)))
    assert (edges, faults) == (18, 0)
    assert volume_mm3 == pytest.approx(60)


def test_holes_and_turned_triangles_are_found():
    mesh = block((0, 0, 0), (1, 1, 1))
    assert _check_soundness(mesh[1:])[1] == 3
    turned = mesh.copy()
    turned[0] = turned[0, ::-1]
    assert _check_soundness(turned)[1] == 3
    assert _check_soundness(mesh[:, ::-1])[2] < 0  # inside out
    assert _check_soundness(np.concatenate([mesh, mesh]))[1] == 18


def test_the_wall_of_a_box_is_measured():
    thickness, place, _ = _thinnest_wall(hollow((30, 20, 12), 1.5))
    assert thickness == pytest.approx(1.5, abs=1e-3)
    thin = hollow((30, 20, 12), 1.5)
    thin[12:][thin[12:] == 30 - 1.5] = 30 - 0.7
    thickness, place, _ = _thinnest_wall(thin)
    assert thickness == pytest.approx(0.7, abs=1e-3)
    assert place[0] > 29


def test_an_edge_is_no_wall():
    wedge = prism([(0, 0), (6, 0), (0, 6)], 5.0)
    assert _check_soundness(wedge)[1] == 0
    assert _thinnest_wall(wedge)[0] > 4.9  # between its two ends, not at its 45 deg edges


def test_rays_agree_with_solving_each_triangle():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(40, 3, 3)) * 3
    origins = rng.normal(size=(150, 3)) * 4
    directions = rng.normal(size=(150, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = np.full(len(origins), np.inf)
    for ray in range(len(origins)):
        for a, b, c in corners:
            t, u, v = np.linalg.solve(np.stack([-directions[ray], b - a, c - a], axis=1), origins[ray] - a)
            if t > 1e-6 and u >= 0 and v >= 0 and u + v <= 1 and t <= 6:
                expected[ray] = min(expected[ray], t)
    distance, triangle = _first_hits(corners, origins, directions, 6.0)
    assert np.isfinite(expected).sum() > 20
    assert np.array_equal(np.isfinite(distance), np.isfinite(expected))
    assert np.allclose(distance[np.isfinite(distance)], expected[np.isfinite(expected)])
    assert np.array_equal(triangle >= 0, np.isfinite(expected))


def test_a_slice_shows_the_inside():
    mesh = hollow((30, 20, 12), 2.0)
    mask = _slice_mask(mesh.astype(float), 6.05, np.array([-1.0, -1.0]), (44, 64), 0.5)
    rows, columns = np.indices(mask.shape)
    x, y = columns * 0.5 - 1, rows * 0.5 - 1
    outside = (x > 0) & (x < 30) & (y > 0) & (y < 20)
    inside = (x > 2) & (x < 28) & (y > 2) & (y < 18)
    clear = np.ones_like(mask)
    for edge in (0, 2, 28, 30):
        clear &= np.abs(x - edge) > 0.01
    for edge in (0, 2, 18, 20):
        clear &= np.abs(y - edge) > 0.01
    assert np.array_equal(mask[clear], (outside & ~inside)[clear])
    assert not _slice_mask(mesh.astype(float), 15.0, np.array([-1.0, -1.0]), (44, 64), 0.5).any()


def test_a_bridge_is_as_long_as_the_gap():
    """A table with two legs: its top spans 8 mm; a ledge that is held on one side counts twice."""
    legs = [block((0, 0, 0), (2, 10, 6)), block((10, 0, 0), (12, 10, 6))]
    table = np.concatenate([*legs, block((0, 0, 6), (12, 10, 8))])
    found = _overhang(table)
    assert found[2:] == (pytest.approx(8, abs=0.6), pytest.approx(6, abs=0.21))
    ledge = np.concatenate([block((0, 0, 0), (4, 10, 6)), block((0, 0, 6), (7, 10, 8))])
    assert _overhang(ledge)[2] == pytest.approx(6, abs=0.6)
    assert _overhang(block((0, 0, 0), (4, 4, 4)))[2] == 0


@pytest.mark.parametrize(("lean", "steep"), [(40.0, False), (45.0, False), (50.0, True)])
def test_leaning_faces_are_judged_by_their_angle(lean, steep):
    shift = 10 * np.tan(np.deg2rad(lean))
    body = prism([(0, 0), (5, 0), (5 + shift, 10), (0, 10)], 20.0)
    assert _check_soundness(body)[1] == 0
    found = _overhang(body)
    expected = 20 * 10 / np.cos(np.deg2rad(lean)) if steep else 0.0
    assert found[0] == pytest.approx(expected, rel=1e-5)
    assert _overhang(body, limit_deg=60.0)[0] == 0


def test_what_is_outside_a_limit_is_said():
    kind = PartKind("thing", "Thing", quantity=2)
    thin = hollow((30, 20, 12), 0.5)
    report = report_part(kind, thin, PrinterSettings(bed_x_mm=25.0))
    assert [report["checks"][name]["ok"] for name in ("watertight", "wall", "bed", "overhang")] == [
        True,
        False,
        False,
        False,
    ]
    text = " ".join(report["findings"])
    for words in ("larger than the printer's bed", "measures 0.50 mm", "print it with support"):
        assert words in text
    assert report["volume_cm3"] == pytest.approx(7.2 - 29 * 19 * 11 / 1000, abs=1e-3)
    assert report["mass_g"] == pytest.approx(1.24 * report["volume_cm3"], abs=0.06)
    good = report_part(kind, block((0, 0, 0), (10, 10, 10)), PrinterSettings())
    assert good["findings"] == []
    assert good["checks"]["wall"]["smallest_mm"] == 8
    with pytest.raises(RuntimeError, match="not closed"):
        report_part(kind, thin[1:], PrinterSettings())
