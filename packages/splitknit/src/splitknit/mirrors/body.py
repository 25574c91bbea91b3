"""The finger as a body: oval sections along a bent axis, with smooth half axes, that end in a
rounded tip.

Finger frame, mm: u level along the finger, growing to the tip; t to the right of it; z to the
camera. The section at u is the oval of points (t + a X + sigma b Z, z + b Z) with X = sin w, Z =
cos w (1 + kappa sin^2 w): an ellipse for kappa = 0, with a flatter pad and rounder shoulders above;
it is smooth, and upright at its sides. The shear sigma stands for roll and for pads that lie to a
side. Half axes are a = s A(s), b = s B(s) with s^2 the distance from the tip over the length: near
its tip any smooth body is like that. Centre lines, A and B are cubic splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from splitknit.imaging.geometry import sampled_at
from splitknit.imaging.view import view_of
from splitknit.model import Array, BoolArray, Camera, FloatArray

SeenHeights = tuple[FloatArray, FloatArray, FloatArray, BoolArray, BoolArray]
"""x, y and z (h, w), mm, finite everywhere, of the surface on the rays of a window's pixels;
whether they meet it; and which lie in rows of the finger that the outlines reach."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """One finger."""

    origin_mm: Array
    """(2,) of the finger's frame on the finger plane."""
    axis: Array
    """(2,) direction of u."""
    tip_mm: float
    """u of the tip."""
    length_mm: float
    """From the tip to where the splines end."""
    coefficients: Array
    """(4, K) of centre t and z, and of A and B."""
    squareness: float = 0.0
    """kappa."""
    shear: float = 0.0
    """sigma in the middle of the length."""
    shear_slope: float = 0.0
    """Its growth from the tip to the base."""

    @property
    def across(self) -> Array:
        """(2,) direction of t."""
        return np.array([self.axis[1], -self.axis[0]])

    def to_frame(self, vectors: Array, *, place: bool) -> Array:
        """Vectors (or places) of the rig's frame (n, 3) as t, u, z (n, 3)."""
        level = vectors[:, :2] - self.origin_mm if place else vectors[:, :2]
        return np.column_stack([level @ self.across, level @ self.axis, vectors[:, 2]])

    def fraction(self, u: Array) -> Array:
        """Distance from the tip over the length, just above zero beyond the tip, at most one."""
        return np.minimum(np.maximum((self.tip_mm - u) / self.length_mm, 1e-6), 1.0)

    def sections(self, u: Array) -> _Sections:
        """Centre, half axes and shear at `u` (n,)."""
        w = self.fraction(u)
        s = np.sqrt(w)
        centre = _spline(self.coefficients[:2])(w)
        half_axes = s[..., None] * _spline(self.coefficients[2:])(s)
        shear = self.shear + self.shear_slope * (w - 0.5)
        t, z = np.moveaxis(centre, -1, 0)
        a, b = np.moveaxis(half_axes, -1, 0)
        return _Sections(t, z, a, b, shear, self.squareness)

    def heights(self, camera: Camera, rows: slice, columns: slice, binning: int = 1) -> SeenHeights:
        """Heights where the rays of a window's pixels or blocks meet the body; beside the body, the
        z of its outline is continued."""
        view = view_of(camera, rows, columns, binning=binning)
        plane_x, plane_y = np.broadcast_arrays(*view.on_plane())
        table = _table_of(self)
        if view.apex_mm is None:
            return plane_x, plane_y, *_looked_up(self, table, plane_x, plane_y)
        apex = np.float32(view.apex_mm)
        nearer: Any = np.float32(1.0)
        z = np.zeros(plane_x.shape, dtype=np.float32)
        for _ in range(4):  # less than all the way each time: at steep skin whole steps overshoot
            z = 0.3 * z + 0.7 * _looked_up(self, table, plane_x * nearer, plane_y * nearer)[0]
            nearer = 1.0 - z / apex
        x = plane_x * nearer
        y = plane_y * nearer
        return x, y, *_looked_up(self, table, x, y)


@dataclass(frozen=True, slots=True, eq=False)
class _Sections:
    """Sections of a body at n places."""

    t: Array
    z: Array
    a: Array
    b: Array
    shear: Array
    squareness: float

    def contact(self, normal_t: Array, normal_z: Array) -> tuple[Array, Array]:
        """Point (t, z) of the section at which its outward normal is along (normal_t, normal_z)."""
        turned = normal_z + self.shear * normal_t  # the normal's second part after the shear
        steepness = np.arctan2(np.abs(self.a * normal_t), np.abs(self.b * turned))
        angle = np.interp(steepness, *_oval_table(self.squareness))
        sine = np.sin(angle)
        rise = np.copysign(np.cos(angle) * (1.0 + self.squareness * sine * sine), turned)
        across = self.a * np.copysign(sine, normal_t) + self.shear * self.b * rise
        return self.t + across, self.z + self.b * rise


@lru_cache(maxsize=64)
def _oval_table(squareness: float) -> tuple[Array, Array]:
    """Steepness, away from Z, of the normal of the oval X = sin w, Z = cos w (1 + k sin^2 w) at
    nodes w, and these."""
    node = np.linspace(0.0, 0.5 * np.pi, 400)  # nodes of the table
    sine = np.sin(node)
    cosine = np.cos(node)
    normal_x = sine * (1.0 + squareness * (sine * sine - 2.0 * cosine * cosine))
    return np.arctan2(normal_x, cosine), node


def _spline(coefficients: Array) -> BSpline:
    """Lines of these coefficients (n, K)."""
    return BSpline(_knots(coefficients.shape[1]), coefficients.T, 3)


@cache
def _knots(count: int) -> Array:
    return np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])


# A body as seen from above: z over every pixel, and slopes.


_STATIONS = 120
"""Sections along the finger in the table of heights. Chosen on: speed. Range: 60 to 240
(validation/parameters)."""
_SECTION_NODES = 121
"""Places across each section in the table of heights. Chosen on: speed. Range: 60 to 242
(validation/parameters)."""


def _table_of(body: Body) -> tuple[FloatArray, FloatArray]:
    """The side of `body` that faces the camera, tabled evenly over s: t (2, S) of its outline on
    the left and right, and z (S, _SECTION_NODES), evenly over the arc sine of the place across,
    -pi/2 to pi/2.
    """
    s = np.linspace(0.0, 1.0, _STATIONS)
    s[0] = 1e-3
    sections = body.sections(body.tip_mm - body.length_mm * s**2)
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 181)[:, None]  # more than the table's nodes
    t, z = sections.contact(np.sin(turn), np.cos(turn))  # (angles, S), t grows with them
    middle = 0.5 * (t[0] + t[-1])
    half = np.maximum(0.5 * (t[-1] - t[0]), 1e-9)
    angle = np.arcsin(np.clip((t - middle) / half, -1.0, 1.0))
    node = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _SECTION_NODES)
    tabled = np.stack([np.interp(node, angle[:, k], z[:, k]) for k in range(_STATIONS)])
    return t[[0, -1]].astype(np.float32), tabled.astype(np.float32)


def _looked_up(
    body: Body, table: tuple[FloatArray, FloatArray], x: FloatArray, y: FloatArray
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """z at x and y, finite everywhere; whether (x, y) lies on the body; and whether its row lies
    within the outlines."""
    ends, tabled = table
    dx = x - np.float32(body.origin_mm[0])
    dy = y - np.float32(body.origin_mm[1])
    across = body.across.astype(np.float32)
    axis = body.axis.astype(np.float32)
    t = across[0] * dx + across[1] * dy
    u = axis[0] * dx + axis[1] * dy
    w = (body.tip_mm - u) / body.length_mm
    s = np.sqrt(np.clip(w, 0.0, 1.0)) * (_STATIONS - 1)
    left, right = (sampled_at(end[None], s, np.zeros_like(s)) for end in ends)
    half = np.maximum(0.5 * (right - left), 1e-6)
    place = (t - 0.5 * (left + right)) / half
    inside = (w > 0) & (w <= 1) & (np.abs(place) <= 1)
    node = (np.arcsin(np.clip(place, -1, 1)) / np.pi + 0.5) * (_SECTION_NODES - 1)
    return sampled_at(tabled, node, s), inside, w <= 1


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Measured slopes of the skin at places of the front view."""

    places_mm: Array  # (n, 2) on the finger plane
    x: Array  # (n,) dz/dx
    y: Array  # (n,) dz/dy


def slopes_across(body: Body, slopes: Slopes) -> Array:
    """Slope of the body across its axis minus the measured one (n,); NaN where it is steep or
    beside the body."""
    level = slopes.places_mm - body.origin_mm
    t = level @ body.across
    u = level @ body.axis
    measured = slopes.x * body.across[0] + slopes.y * body.across[1]
    limit = np.deg2rad(24.0)  # deg: steeper skin looks flatter than it is
    turn = np.linspace(-limit, limit, 33)
    reach, _ = body.sections(u).contact(np.sin(turn)[:, None], np.cos(turn)[:, None])  # (33, n)
    above = reach > t
    k = np.clip(np.argmax(above, axis=0), 1, turn.size - 1)
    low, high = np.take_along_axis(reach, np.stack([k - 1, k]), axis=0)
    angle = turn[k - 1] + (turn[k] - turn[k - 1]) * (t - low) / np.maximum(high - low, 1e-9)
    known = above.any(axis=0) & ~above[0]
    known &= (u < body.tip_mm - 3.0) & (u > body.tip_mm - body.length_mm)
    return np.where(known, -np.tan(angle) - measured, np.nan)
