"""Skin that has moved over the finger's body, a little and smoothly."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from splitknit.errors import require
from splitknit.model import Array
from splitknit_simulator.finger.master_print import MasterPrint


@dataclass(frozen=True, slots=True, eq=False)
class Deformation:
    """Where points of the skin go: p becomes (1 + stretch) p + shift((1 + stretch) p), in the
    chart, about its origin.

    The shift is given where the skin arrives, so that a map of the ridges is pulled back without
    solving anything.
    """

    u_mm: Array  # (W,) grid, rising
    v_mm: Array  # (H,) grid, rising
    shift_mm: Array  # (2, H, W) along u and v
    stretch: float = 0.0  # relative stretch of a swollen finger's skin
    _splines: tuple[RectBivariateSpline, RectBivariateSpline] = field(init=False)

    def __post_init__(self) -> None:
        splines = tuple(RectBivariateSpline(self.v_mm, self.u_mm, part) for part in self.shift_mm)
        object.__setattr__(self, "_splines", splines)

    def shift_at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """(N,) shifts along u and v at points (N,) where the skin arrives; beyond the grid as on
        its border."""
        u, v = np.clip(u, self.u_mm[0], self.u_mm[-1]), np.clip(v, self.v_mm[0], self.v_mm[-1])
        return self._splines[0].ev(v, u), self._splines[1].ev(v, u)

    def shift_on(self, u: Array, v: Array) -> tuple[Array, Array]:
        """(H, W) shifts along u and v on the grid of columns `u` (W,) and rows `v` (H,), in any
        order."""
        rows, columns = np.argsort(v), np.argsort(u)
        shifts = []
        for spline in self._splines:
            values = np.empty((v.size, u.size))
            low, high = self.v_mm[[0, -1]], self.u_mm[[0, -1]]
            values[np.ix_(rows, columns)] = spline(
                np.clip(v[rows], *low), np.clip(u[columns], *high)
            )
            shifts.append(values)
        return shifts[0], shifts[1]

    def moved(self, points: Array) -> Array:
        """(N, 2) places of the skin's points (N, 2) after the deformation."""
        start = (1.0 + self.stretch) * points
        here = start.copy()
        # a contraction: the shift changes by less than a third over its own length
        for _ in range(12):
            here = start + np.stack(self.shift_at(here[:, 0], here[:, 1]), 1)
        return here


_SAMPLES_PER_SIGMA = 4
"""Grid points for each standard deviation of the smoothing: a cubic spline through them is less
than a thousandth off. Chosen on: speed."""


def draw_deformation(
    rng: np.random.Generator,
    master: MasterPrint,
    amplitude_mm: float,
    smooth_mm: float = 5.0,
    stretch: float = 0.0,
) -> Deformation:
    """Draw a smooth shift over the whole map of a print, of `amplitude_mm` at most; BadInput if it
    could fold the skin.

    `smooth_mm`: standard deviation of its Gaussian; the shift's correlation falls to exp(-1/4) over
    that length.
    """
    require(
        0 <= amplitude_mm <= 0.15 * smooth_mm,
        f"a shift of {amplitude_mm} mm that is smooth over {smooth_mm} mm could fold the skin; at"
        f" most {0.15 * smooth_mm:.2f} mm go.",
    )
    step = smooth_mm / _SAMPLES_PER_SIGMA
    u, v = (
        np.arange(axis.min() - step, axis.max() + 2 * step, step)
        for axis in (master.u_mm, master.v_mm)
    )
    white = rng.standard_normal(
        (2, v.size + 8 * _SAMPLES_PER_SIGMA, u.size + 8 * _SAMPLES_PER_SIGMA)
    )
    inner = slice(4 * _SAMPLES_PER_SIGMA, -4 * _SAMPLES_PER_SIGMA)
    shift = np.stack(
        [ndimage.gaussian_filter(part, _SAMPLES_PER_SIGMA)[inner, inner] for part in white]
    )
    shift *= amplitude_mm / float(np.hypot(*shift).max())
    return Deformation(u, v, shift, stretch)


def deformed(master: MasterPrint, deformation: Deformation) -> MasterPrint:
    """Return the print as it lies on the body after the deformation: ridges, pores, cores, deltas
    and minutiae."""
    du, dv = deformation.shift_on(master.u_mm, master.v_mm)
    grown = 1.0 + deformation.stretch
    pitch = float(master.u_mm[1] - master.u_mm[0])
    columns = ((master.u_mm[None, :] - du) / grown - master.u_mm[0]) / pitch
    rows = (master.v_mm[0] - (master.v_mm[:, None] - dv) / grown) / pitch

    def pulled(values: NDArray[np.float32]) -> NDArray[np.float32]:
        x, y = columns.astype(np.float32), rows.astype(np.float32)
        there = cv2.remap(values, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(np.clip(there, values.min(), values.max()), dtype=np.float32)

    return replace(
        master,
        ridge=pulled(master.ridge),
        pores=pulled(master.pores),
        cores_mm=_points(deformation, master.cores_mm),
        deltas_mm=_points(deformation, master.deltas_mm),
        minutiae=deformed_minutiae(master.minutiae, deformation),
    )


def _points(
    deformation: Deformation, points: tuple[tuple[float, float], ...]
) -> tuple[tuple[float, float], ...]:
    moved = deformation.moved(np.asarray(points, dtype=np.float64).reshape(-1, 2))
    return tuple((float(u), float(v)) for u, v in moved)


def deformed_minutiae(minutiae: Array, deformation: Deformation) -> Array:
    """Places and directions (N, 3: u_mm, v_mm, rad) of minutiae after a deformation of the skin."""
    moved = np.array(minutiae, dtype=np.float64).reshape(-1, 3)
    if len(moved):
        step = 0.05 * np.stack([np.cos(moved[:, 2]), np.sin(moved[:, 2])], 1)
        places = deformation.moved(moved[:, :2])
        ahead = deformation.moved(moved[:, :2] + step) - places
        moved = np.column_stack([places, np.arctan2(ahead[:, 1], ahead[:, 0])])
    return moved
