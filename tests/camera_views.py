"""Corners as a camera of known matrix sees them, projected here and not by the code under test."""

from __future__ import annotations

import numpy as np

from splitknit_rig.calibration.targets import Board

BOARD = Board(9, 6, 3.0)
SIZE = (550, 800)
MATRIX = np.array([[2650.0, 0, 405.0], [0, 2650.0, 268.0], [0, 0, 1]])


def turned(tilt_deg, towards_deg, spin_deg=0.0):
    """Rotation matrix: tilted about an axis in the picture, after a turn in the plane."""
    tilt, towards, spin = np.deg2rad([tilt_deg, towards_deg, spin_deg])
    axis = np.array([np.cos(towards), np.sin(towards), 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    lean = np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
    turn = np.array(
        [[np.cos(spin), -np.sin(spin), 0], [np.sin(spin), np.cos(spin), 0], [0, 0, 1.0]]
    )
    return lean @ turn


def seen(marks_mm, rotation, middle_mm, matrix=MATRIX, distortion=(0, 0, 0, 0, 0)):
    """Columns and rows (N, 2) of marks (N, 2), centred on the board, in the camera's frame (y down,
    z away)."""
    flat = np.column_stack([marks_mm, np.zeros(len(marks_mm))])
    x, y, z = (flat @ rotation.T + middle_mm).T
    u, v = x / z, y / z
    k1, k2, p1, p2, k3 = distortion
    r2 = u * u + v * v
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    a = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    b = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    return np.column_stack([matrix[0, 0] * a + matrix[0, 2], matrix[1, 1] * b + matrix[1, 2]])


def views(
    seed,
    count=10,
    *,
    tilts=(10, 35),
    noise_px=0.02,
    matrix=MATRIX,
    distortion=(0, 0, 0, 0, 0),
    distance=140.0,
):
    """Corner sets of a board held by hand."""
    rng = np.random.default_rng(seed)
    marks = BOARD.points_mm - BOARD.points_mm.mean(axis=0)
    sets = []
    for _ in range(count):
        rotation = turned(rng.uniform(*tilts), rng.uniform(0, 360), rng.uniform(-15, 15))
        middle = np.array([*rng.uniform(-4, 4, 2), distance + rng.uniform(-5, 5)])
        places = seen(marks, rotation, middle, matrix, distortion)
        sets.append(places + rng.normal(0, noise_px, places.shape))
    return sets
