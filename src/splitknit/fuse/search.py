"""The first guess of surface and pose: a handful of numbers for which all ridges of two views meet at once.

Single squares of ridges look alike a period on; the whole overlap does not.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from splitknit.check import require
from splitknit.fuse.chart import Chart
from splitknit.fuse.register import shifts_by
from splitknit.fuse.sight import Sight
from splitknit.types import BoolArray, FloatArray

Array = NDArray[np.float64]


FEW = 6000
"""So many pixels tell which of many guesses is best."""


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Ranges in which the views are brought together: (reach, step)."""

    bulge_mm: tuple[float, float] = (0.6, 0.06)
    """Of the surface, half-way between front and side."""
    shift_mm: tuple[float, float] = (0.9, 0.15)
    """Of the mirror along its normal."""
    turn_deg: tuple[float, float] = (1.4, 0.2)
    """Of the mirror about the axis that moves its view along the finger."""
    doubt: float = 0.02
    """Correlation that a pose must gain to be believed one standard deviation from where the outlines have it."""
    deviations: tuple[float, float] = (0.25, 0.4)
    """Standard deviations of the outlines' pose: shift (mm) and turn (deg)."""
    least: float = 0.2
    """Correlation below which nothing is changed."""

    def __post_init__(self) -> None:
        for name in ("bulge_mm", "shift_mm", "turn_deg"):
            reach, step = getattr(self, name)
            require(0.0 <= reach <= 5.0 and step > 0.0, f"rolled.search.{name} must be (reach, step), both small.")
        require(0.0 <= self.least < 1.0, "rolled.search.least must lie in [0, 1).")
        require(self.doubt >= 0.0, "rolled.search.doubt must not be negative.")
        require(min(self.deviations) > 0.0, "rolled.search.deviations must be positive.")


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What makes two views meet."""

    radius_mm: Array
    """(n, m) to be added to the surface."""
    pose: tuple[float, float, float]
    """Turns (rad) and shift (mm) of the mirror."""
    correlation: float
    """Of the ridges in the overlap."""


def search(  # noqa: PLR0917
    chart: Chart,
    radius_mm: Array,
    front: Sight,
    mirror: Sight,
    first: FloatArray,
    second: FloatArray,
    both: BoolArray,
    settings: SearchSettings | None = None,
) -> Found:
    """Find how the surface bulges and where the mirror lies.

    Parameters
    ----------
    chart, radius_mm : surface (n, m)
    first, second : (n, m) ridge bands of the front and of the mirror's view on the chart, zero where not seen
    both : (n, m) where both see the finger
    """
    chosen = settings or SearchSettings()
    nothing = Found(np.zeros(chart.shape), (0.0, 0.0, 0.0), 0.0)
    rows, columns = np.nonzero(both)
    if rows.size < 500:
        return nothing
    points = chart.points(radius_mm)
    _, rays = chart.rays()
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    steps = right[rows, columns], down[rows, columns]
    of_front, _ = shifts_by(front, chart, points[rows, columns], rays[rows, columns], steps)
    of_mirror, by_pose = shifts_by(mirror, chart, points[rows, columns], rays[rows, columns], steps)
    angle = chart.angle_rad[columns]
    side = np.sign(float(np.median(angle)))
    hump = np.sin(2 * angle) ** 2
    along = (chart.length_mm[rows] - float(chart.length_mm[rows].mean())) / 10.0
    by_bulge = (of_mirror - of_front) * hump[:, None]
    modes = np.stack(
        [by_bulge, by_pose[:, :, 2], by_pose[:, :, 0], by_pose[:, :, 1], by_bulge * along[:, None]], axis=-1
    ).astype(np.float32)  # (K, 2, 5)
    target = first[rows, columns]
    place = np.stack([columns, rows], axis=1).astype(np.float32)

    def score(values: Array, some: slice = slice(None)) -> float:
        seen = _read(second, place[some] + modes[some] @ values.astype(np.float32))
        there = target[some] - target[some].mean()
        seen = seen - seen.mean()
        power = float((seen**2).sum()) * float((there**2).sum())
        return float((seen * there).sum()) / float(np.sqrt(max(power, 1e-24)))

    spread = np.array([chosen.deviations[0], *np.deg2rad([chosen.deviations[1]] * 2)])

    def worth(values: Array, some: slice = slice(None)) -> float:
        return score(values, some) - chosen.doubt * float(((values[1:4] / spread) ** 2).sum())

    turn = np.deg2rad(chosen.turn_deg[0]), np.deg2rad(chosen.turn_deg[1])
    best, at = -1.0, np.zeros(5)
    few = slice(None, None, max(1, rows.size // FEW))
    for values in itertools.product(*(_range(*pair) for pair in (chosen.bulge_mm, chosen.shift_mm, turn))):
        trial = np.array([*values, 0.0, 0.0])
        here = worth(trial, few)
        if here > best:
            best, at = here, trial
    scale = np.array([0.03, 0.06, 0.002, 0.004, 0.05])
    simplex = np.vstack([np.zeros(5), np.eye(5)])
    options: Any = {"initial_simplex": simplex, "maxfev": 300, "xatol": 0.02, "fatol": 1e-4}
    minimize: Any = optimize.minimize
    done = minimize(lambda x: -worth(at + x * scale), np.zeros(5), method="Nelder-Mead", options=options)
    at = at + done.x * scale
    best = score(at)
    if best < chosen.least:
        return Found(nothing.radius_mm, nothing.pose, best)
    there = (
        (np.sign(chart.angle_rad) == side) * np.sin(2 * chart.angle_rad) ** 2 * (np.abs(chart.angle_rad) < np.pi / 2)
    )
    rising = (chart.length_mm - float(chart.length_mm[rows].mean())) / 10.0
    rising = np.clip(rising, float(along.min()), float(along.max()))
    radius = there[None] * (at[0] + at[4] * rising[:, None])
    return Found(radius, (float(at[2]), float(at[3]), float(at[1])), best)


def _range(reach: float, step: float) -> Array:
    count = int(np.floor(reach / step + 1e-9))
    return np.asarray(np.arange(-count, count + 1) * step, dtype=np.float64)


def _read(field: FloatArray, places: FloatArray) -> FloatArray:
    """(K,) values at places (K, 2), zero outside."""
    values = np.empty(len(places), dtype=np.float32)
    for start in range(0, len(places), 30_000):
        part = places[start : start + 30_000]
        x, y = (np.ascontiguousarray(part[:, axis : axis + 1]) for axis in range(2))
        values[start : start + 30_000] = cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)[:, 0]
    return values
