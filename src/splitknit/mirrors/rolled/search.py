"""The first guess of surface and pose: a handful of numbers for which all ridges of two views meet at once.

Single squares of ridges look the same a period on; the whole overlap does not.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from splitknit.errors import require
from splitknit.mirrors.rolled.chart import Chart, Sight, read
from splitknit.mirrors.rolled.register import ridge_moves
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits, check_fields

Array = NDArray[np.float64]


FEW = 6000
"""So many pixels show which of many guesses is best."""
APART_MM = 0.15
"""Moves that differ by less than this lead to the same place."""
OUTER = 0.9
"""Of the bulge's standard deviation: by how much more the surface bulges for each 20 deg towards the side."""
LIKE_PLACES, MOVE_MM = 20.0, 0.05
"""A move counts as so many measured ones, each with this standard deviation."""


_DOUBT = 0.01
"""Correlation that a number must gain to be believed one standard deviation from where the outlines have it."""
MIN_CORRELATION = 0.2
"""Correlation below which nothing is changed."""


@dataclass(frozen=True, slots=True)
class SearchSettings(Checked):
    """Ranges in which the views are brought together: (reach, step)."""

    _group = "rolled.search"
    across_mm: tuple[float, float] = (1.6, 0.05)
    """By which the mirror's ridges may lie beside the front's around the finger: reach and step."""
    along_mm: tuple[float, float] = (0.3, 0.05)
    """The same along the finger."""
    deviations: Annotated[tuple[float, float, float], Limits(0, above=True)] = (0.2, 0.06, 0.2)
    """Standard deviations of what the outlines determine: the surface's bulge half-way between front and side (mm), the
    mirror's place along its normal (mm), and its turns (deg)."""
    candidates: Annotated[int, Limits(1, 50)] = 6
    """So many of the best guesses are followed up."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("across_mm", "along_mm"):
            reach, step = getattr(self, name)
            require(0.0 <= reach <= 5.0 and step > 0.0, f"rolled.search.{name} must be (reach, step), both small.")


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
    moved = ridge_moves(chart, radius_mm, (front, mirror), (rows, columns))
    angle = chart.angle_rad[columns]
    side = np.sign(float(np.median(angle)))
    hump = np.sin(2 * angle) ** 2
    along = (chart.length_mm[rows] - float(chart.length_mm[rows].mean())) / 10.0
    by_bulge = moved[..., 0] * hump[:, None]
    outer = (np.abs(angle) - np.pi / 4) / np.deg2rad(20.0)
    by_bulges = by_bulge, by_bulge * along[:, None], by_bulge * outer[:, None]
    modes = np.stack([*np.moveaxis(moved[..., 1:], 2, 0), *by_bulges], axis=-1).astype(np.float32)  # (K, 2, 6)
    target = first[rows, columns]
    place = np.stack([columns, rows], axis=1).astype(np.float32)

    def score(moves: FloatArray, some: slice) -> float:
        seen = read(second, *(place[some] + moves).T, empty=0.0)
        there = target[some] - target[some].mean()
        seen = seen - seen.mean()
        power = float((seen**2).sum()) * float((there**2).sum())
        return float((seen * there).sum()) / float(np.sqrt(max(power, 1e-24)))

    bulge, shift, turn = chosen.deviations[0], chosen.deviations[1], float(np.deg2rad(chosen.deviations[2]))
    spread = np.array([turn, turn, shift, bulge, bulge, OUTER * bulge])

    def worth(values: Array, some: slice = slice(None)) -> float:
        return score(modes[some] @ values.astype(np.float32), some) - _DOUBT * float(((values / spread) ** 2).sum())

    few = slice(None, None, max(1, rows.size // FEW))
    # what the outlines may be wrong by, as one move of all ridges
    typical = np.sqrt(((np.median(modes, axis=0) * spread) ** 2).sum(axis=1)) + 1e-9
    guesses = []
    for move in itertools.product(*(_range(*pair) / chart.pitch_mm for pair in (chosen.across_mm, chosen.along_mm))):
        far = float(((np.array(move) / typical) ** 2).sum())
        guesses.append((score(np.array([move], dtype=np.float32), few) - _DOUBT * far, np.array(move)))
    scale = np.array([0.003, 0.001, 0.03, 0.03, 0.05, 0.03])
    simplex = np.vstack([np.zeros(6), np.eye(6)])
    options: Any = {"initial_simplex": simplex, "maxfev": 200, "xatol": 0.02, "fatol": 1e-4}
    minimize: Any = optimize.minimize

    def refined(start: Array, some: slice) -> tuple[float, Array]:
        done = minimize(lambda x: -worth(start + x * scale, some), np.zeros(6), method="Nelder-Mead", options=options)
        return -float(done.fun), start + done.x * scale

    starts = [
        _explained(modes[few], move, spread, chart.pitch_mm)
        for move in _apart(guesses, chart.pitch_mm, chosen.candidates)
    ]
    _, at = max((refined(start, few) for start in starts), key=lambda item: item[0])
    _, at = refined(at, slice(None))
    best = score(modes @ at.astype(np.float32), slice(None))
    if best < MIN_CORRELATION:
        return Found(nothing.radius_mm, nothing.pose, best)
    there = (
        (np.sign(chart.angle_rad) == side) * np.sin(2 * chart.angle_rad) ** 2 * (np.abs(chart.angle_rad) < np.pi / 2)
    )
    rising = (chart.length_mm - float(chart.length_mm[rows].mean())) / 10.0
    rising = np.clip(rising, float(along.min()), float(along.max()))
    further = (np.abs(chart.angle_rad) - np.pi / 4) / np.deg2rad(20.0)
    radius = there[None] * (at[3] + at[4] * rising[:, None] + at[5] * further[None])
    return Found(radius, (float(at[0]), float(at[1]), float(at[2])), best)


def _explained(modes: FloatArray, move: Array, spread: Array, pitch_mm: float) -> Array:
    """(6,) turns, shift and bulges that move all ridges by about `move` (2,), as likely as they can be."""
    weight = LIKE_PLACES / len(modes) / (MOVE_MM / pitch_mm) ** 2
    flat = modes.reshape(-1, modes.shape[2]).astype(np.float64)
    matrix = weight * flat.T @ flat + np.diag(1.0 / spread**2)
    return np.asarray(np.linalg.solve(matrix, weight * flat.T @ np.tile(move, len(modes))))


def _apart(guesses: list[tuple[float, Array]], pitch_mm: float, count: int) -> list[Array]:
    """The best moves (2,) of which no two are nearly the same."""
    found: list[Array] = []
    for _, move in sorted(guesses, key=lambda item: -item[0]):
        if all(float(np.abs(move - other).max()) * pitch_mm > APART_MM for other in found):
            found.append(move)
        if len(found) == count:
            break
    return found


def _range(reach: float, step: float) -> Array:
    count = int(np.floor(reach / step + 1e-9))
    return np.asarray(np.arange(-count, count + 1) * step, dtype=np.float64)
