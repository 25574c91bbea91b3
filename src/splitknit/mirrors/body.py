"""The finger as a body: oval sections along a bent axis, with smooth half axes, that end in a rounded tip.

Finger frame, mm: u level along the finger, growing to the tip; t to the right of it; z to the camera. The section at u
is the oval of points (t + a X + sigma b Z, z + b Z) with X = sin w, Z = cos w (1 + kappa sin^2 w): an ellipse for
kappa = 0, with a flatter pad and rounder shoulders above; it is smooth, and upright at its sides. The shear sigma
stands for roll and for pads that lie to a side. Half axes are a = s A(s), b = s B(s) with s^2 the distance from the tip
over the length: near its tip any smooth body is like that. Centre lines, A and B are cubic splines.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Array = NDArray[np.float64]

OVAL_NODES = 400
MOST_SQUARE = 0.45
"""Beyond, the oval is no longer convex."""


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
    _lines: tuple[Array, Array] = field(init=False, repr=False)
    """The splines of the centre and of the half axes, (N, 2) each, at the nodes of the table of their basis."""

    def __post_init__(self) -> None:
        table = _basis_table(self.coefficients.shape[1])
        lines = table @ self.coefficients[:2].T, table @ self.coefficients[2:].T
        object.__setattr__(self, "_lines", lines)

    @property
    def across(self) -> Array:
        """(2,) direction of t."""
        return np.array([self.axis[1], -self.axis[0]])

    def to_frame(self, vectors: Array, *, place: bool) -> Array:
        """Vectors (or places) of the rig's frame (n, 3) as t, u, z (n, 3)."""
        level = vectors[:, :2] - self.origin_mm if place else vectors[:, :2]
        return np.column_stack([level @ self.across, level @ self.axis, vectors[:, 2]])

    def share(self, u: Array) -> Array:
        """Distance from the tip over the length, just above zero beyond the tip, at most one."""
        return np.asarray(np.minimum(np.maximum((self.tip_mm - u) / self.length_mm, 1e-6), 1.0))

    def sections(self, u: Array) -> Sections:
        """Centre, half axes and shear at `u` (n,)."""
        w = self.share(u)
        s = np.sqrt(w)
        along, root = _between(self._lines[0], w), _between(self._lines[1], s)
        shear = self.shear + self.shear_slope * (w - 0.5)
        return Sections(along[..., 0], along[..., 1], s * root[..., 0], s * root[..., 1], shear, self.squareness)

    def grown(self, step: Array) -> Body:
        """With `step` (4 K,) added to the coefficients."""
        return replace(self, coefficients=self.coefficients + step.reshape(self.coefficients.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Sections:
    """Sections of a body at n places."""

    t: Array
    z: Array
    a: Array
    b: Array
    shear: Array
    squareness: float

    def support(self, normal_t: Array, normal_z: Array) -> tuple[Array, Array, Array]:
        """How far the section reaches along (normal_t, normal_z), and its derivatives by a and b."""
        x, rise, turned = self._touched(normal_t, normal_z)
        by_a, by_b = normal_t * x, turned * rise
        return self.t * normal_t + self.z * normal_z + self.a * by_a + self.b * by_b, by_a, by_b

    def contact(self, normal_t: Array, normal_z: Array) -> tuple[Array, Array]:
        """Point (t, z) of the section at which its outward normal is along (normal_t, normal_z)."""
        x, rise, _ = self._touched(normal_t, normal_z)
        return self.t + self.a * x + self.shear * self.b * rise, self.z + self.b * rise

    def _touched(self, normal_t: Array, normal_z: Array) -> tuple[Array, Array, Array]:
        """X and Z where a line of that normal touches, and the normal's second part after the shear."""
        turned = normal_z + self.shear * normal_t
        steepness = np.arctan2(np.abs(self.a * normal_t), np.abs(self.b * turned))
        angle = oval_angle(steepness, self.squareness)
        sine, cosine = np.sin(angle), np.cos(angle)
        rise = cosine * (1.0 + self.squareness * sine * sine)
        return np.copysign(sine, normal_t), np.copysign(rise, turned), turned


def oval_angle(steepness: Array, squareness: float) -> Array:
    """w at which the oval X = sin w, Z = cos w (1 + k sin^2 w) has its normal `steepness` away from Z, radians."""
    return np.asarray(np.interp(steepness, *_oval_table(squareness)))


@lru_cache(maxsize=64)
def _oval_table(squareness: float) -> tuple[Array, Array]:
    """Steepness of the oval's normal at nodes w, and these."""
    node = np.linspace(0.0, 0.5 * np.pi, OVAL_NODES)
    sine, cosine = np.sin(node), np.cos(node)
    normal_x = sine * (1.0 + squareness * (sine * sine - 2.0 * cosine * cosine))
    return np.asarray(np.arctan2(normal_x, cosine)), node


def basis(x: Array, count: int) -> Array:
    """(n, count) cubic B-splines on [0, 1] with evenly spaced knots, to 1e-6."""
    return _between(_basis_table(count), x)


def _between(table: Array, x: Array) -> Array:
    """(..., K) columns of a table (N, K) of values at evenly spaced places on [0, 1], at places `x` (...)."""
    place = np.minimum(np.maximum(x, 0.0), 1.0) * (len(table) - 1)
    below = np.minimum(place.astype(np.intp), len(table) - 2)
    share = (place - below)[..., None]
    return np.asarray(table.take(below, axis=0) * (1.0 - share) + table.take(below + 1, axis=0) * share)


@cache
def _basis_table(count: int) -> Array:
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])
    return np.asarray(BSpline.design_matrix(np.linspace(0.0, 1.0, 4001), knots, 3).toarray())
