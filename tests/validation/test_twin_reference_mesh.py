"""The triangles that the reference's walks wander under."""

import importlib
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from script_folder import VALIDATION
from splitknit.model import Camera
from splitknit_simulator.surface import SimulatedSurface

sys.path.append(str(VALIDATION / "twin"))
scene: Any = importlib.import_module("reference_scene")
LEDGE_MM, _skin_mesh = scene.LEDGE_MM, scene._skin_mesh


def bump(size: int = 41, pitch_mm: float = 0.1, outline: bool = False) -> SimulatedSurface:
    """A half ellipsoid seen from above, cut by its outline, or a wavy patch."""
    along = (np.arange(size) - (size - 1) / 2) * pitch_mm
    x, y = np.meshgrid(along, -along)
    z = 0.1 * np.cos(3.0 * x) * np.cos(2.0 * y)
    mask = np.ones(x.shape, dtype=np.bool_)
    if outline:
        inside = 1.0 - (x / 1.5) ** 2 - (y / 1.8) ** 2
        mask = inside > 0.02
        z = np.where(mask, np.sqrt(np.maximum(inside, 0.0)), np.nan)
    height = z.astype(np.float32)
    normals = np.zeros((*x.shape, 3), dtype=np.float32)
    one = np.ones(x.shape, dtype=np.float32)
    return SimulatedSurface(Camera(1.0 / pitch_mm, x.shape), height, height, normals, normals, 0 * one, mask, one)


WINDOW = (slice(15, 25), slice(15, 25))


def test_patch_faces_up_and_covers_crop_margin_and_ledge() -> None:
    mesh = _skin_mesh(bump(), WINDOW, margin_mm=4.0)
    normals = mesh.normals()
    assert not mesh.closed
    assert (normals[:, 2] > 0.0).all()
    # the map reaches 1.5 and 1.6 mm beyond the crop, the rest of the 4 mm is mirrored
    low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
    np.testing.assert_allclose(high - low, 1.0 - 0.1 + 8.0 + 2 * LEDGE_MM, atol=1e-9)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    flat = np.abs(np.cross(b - a, c - a)[:, 2]).sum() / 2
    np.testing.assert_allclose(flat, np.prod(high - low), rtol=1e-9)


def test_vertices_lie_where_the_camera_sees_the_pixels() -> None:
    surface = bump()
    mesh = _skin_mesh(surface, WINDOW, margin_mm=0.0)
    row, column = 17, 22
    x, y = (column - 20.0) * 0.1, (20.0 - row) * 0.1
    found = np.argmin(np.hypot(mesh.vertices[:, 0] - x, mesh.vertices[:, 1] - y))
    np.testing.assert_allclose(mesh.vertices[found], [x, y, surface.height_mm[row, column]], atol=1e-6)


def test_steepest_slope_of_a_ramp() -> None:
    surface = bump()
    ramp = np.broadcast_to(np.arange(41) * 0.1 * 0.7, (41, 41)).astype(np.float32)
    mesh = _skin_mesh(replace(surface, height_mm=ramp), WINDOW, margin_mm=0.0)
    np.testing.assert_allclose(mesh.steepest(), 0.7, rtol=1e-5)


def test_finger_with_an_outline_is_closed() -> None:
    surface = bump(outline=True)
    mesh = _skin_mesh(surface, WINDOW, margin_mm=4.0)
    assert mesh.closed
    edges = np.concatenate([mesh.faces[:, [i, (i + 1) % 3]] for i in range(3)]).astype(np.int64)
    there, back = (set(map(tuple, e)) for e in (edges, edges[:, ::-1]))
    assert len(there) == len(edges)
    assert there == back
    # triangles that face out enclose a positive volume: twice what lies above the outline
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6
    above = surface.height_mm[surface.mask]
    expected = 2 * (above - np.percentile(above, 1)).sum() * 0.1**2
    assert 0.9 < volume / expected < 1.05
