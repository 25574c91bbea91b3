"""A body as seen from above: z over every pixel, and slopes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.view import view_of
from splitknit.mirrors.body import Body
from splitknit.mirrors.state import Slopes
from splitknit.model import BoolArray, Camera, FloatArray

Array = NDArray[np.float64]

STATIONS, ANGLES, NODES = 120, 181, 121
STEEPEST_DEG = 24.0
"""Slopes of the skin are believed up to here: steeper skin looks flatter than it is."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The upper side of a body, tabled evenly over s and the arc sine of the place across."""

    left: NDArray[np.float32]
    """(S,) t of the outline as seen from above, at s = 0 to 1."""
    right: NDArray[np.float32]
    z: NDArray[np.float32]
    """(S, NODES) over -pi/2 to pi/2."""


def table_of(body: Body) -> Table:
    """Table the side of `body` that faces the camera."""
    s = np.linspace(0.0, 1.0, STATIONS)
    s[0] = 1e-3
    u = body.tip_mm - body.length_mm * s**2
    sections = body.sections(u)
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ANGLES)
    normal_t, normal_z = np.sin(turn)[:, None], np.cos(turn)[:, None]
    t, z = sections.contact(normal_t, normal_z)  # (ANGLES, S), t grows with the angle
    left, right = t[0], t[-1]
    node = np.linspace(-0.5 * np.pi, 0.5 * np.pi, NODES)
    middle, half = 0.5 * (left + right), np.maximum(0.5 * (right - left), 1e-9)
    angle = np.arcsin(np.clip((t - middle) / half, -1.0, 1.0))
    tabled = np.stack([np.interp(node, angle[:, k], z[:, k]) for k in range(STATIONS)])
    return Table(left.astype(np.float32), right.astype(np.float32), tabled.astype(np.float32))


def heights_on(
    body: Body, camera: Camera, rows: slice, columns: slice, binning: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray, BoolArray]:
    """Where the rays of a window's pixels meet the body.

    Returns
    -------
    x_mm, y_mm, z_mm : (h, w)
        Finite everywhere; beside the body its outline's z goes on.
    on_body : (h, w)
    known : (h, w)
        Rows of the finger that the outlines reach.
    """
    view = view_of(camera, rows, columns, binning=binning)
    plane_x, plane_y = view.on_plane()
    shape = np.broadcast_shapes(plane_x.shape, plane_y.shape)
    plane_x, plane_y = np.broadcast_to(plane_x, shape), np.broadcast_to(plane_y, shape)
    table = table_of(body)
    if view.apex_mm is None:
        z, inside, known = _looked_up(body, table, plane_x, plane_y)
        return np.asarray(plane_x), np.asarray(plane_y), z, inside, known
    apex = np.float32(view.apex_mm)
    z = np.zeros(shape, dtype=np.float32)
    for _ in range(4):  # less than all the way each time: at steep skin whole steps overshoot
        nearer = np.float32(1.0) - z / apex
        found, _, _ = _looked_up(body, table, plane_x * nearer, plane_y * nearer)
        z = np.float32(0.3) * z + np.float32(0.7) * found
    nearer = np.float32(1.0) - z / apex
    z, inside, known = _looked_up(body, table, plane_x * nearer, plane_y * nearer)
    return plane_x * nearer, plane_y * nearer, z, inside, known


def _looked_up(body: Body, table: Table, x: FloatArray, y: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
    dx, dy = x - np.float32(body.origin_mm[0]), y - np.float32(body.origin_mm[1])
    across, axis = body.across.astype(np.float32), body.axis.astype(np.float32)
    t, u = across[0] * dx + across[1] * dy, axis[0] * dx + axis[1] * dy
    w = (np.float32(body.tip_mm) - u) / np.float32(body.length_mm)
    s = np.sqrt(np.clip(w, 0.0, 1.0)) * np.float32(STATIONS - 1)
    ends = np.stack([table.left, table.right])
    row = np.zeros_like(s)
    left = cv2.remap(ends[:1], s, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    right = cv2.remap(ends[1:], s, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    half = np.maximum(np.float32(0.5) * (right - left), np.float32(1e-6))
    place = (t - np.float32(0.5) * (left + right)) / half
    inside = (w > 0) & (w <= 1) & (np.abs(place) <= 1)
    node = (np.arcsin(np.clip(place, -1, 1)) / np.float32(np.pi) + np.float32(0.5)) * np.float32(NODES - 1)
    z = cv2.remap(table.z, node, s, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(z, dtype=np.float32), np.asarray(inside), np.asarray(w <= 1)


def nearest(values: FloatArray, known: BoolArray) -> FloatArray:
    """`values` (h, w), where they are not `known` those of the nearest place where they are."""
    away = (~known).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.zeros(int(labels.max()) + 1, dtype=np.float32)
    table[labels[known]] = values[known]
    return np.asarray(table[labels])


def slopes_across(body: Body, slopes: Slopes) -> Array:
    """Slope of the body across its axis minus the measured one (n,); NaN where it is steep or beside the body."""
    level = slopes.places_mm - body.origin_mm
    t, u = level @ body.across, level @ body.axis
    measured = slopes.x * body.across[0] + slopes.y * body.across[1]
    limit = np.deg2rad(STEEPEST_DEG)
    turn = np.linspace(-limit, limit, 33)
    reach, _ = body.sections(u).contact(np.sin(turn)[:, None], np.cos(turn)[:, None])  # (33, n)
    above = reach > t
    k = np.clip(np.argmax(above, axis=0), 1, turn.size - 1)
    column = np.arange(t.size)
    low, high = reach[k - 1, column], reach[k, column]
    angle = turn[k - 1] + (turn[k] - turn[k - 1]) * (t - low) / np.maximum(high - low, 1e-9)
    known = above.any(axis=0) & ~above[0] & (u < body.tip_mm - 3.0) & (u > body.tip_mm - body.length_mm)
    return np.where(known, -np.tan(angle) - measured, np.nan)
