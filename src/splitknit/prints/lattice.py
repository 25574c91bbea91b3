"""Smooth functions on coarse grids: read anywhere, read densely, and inverted.

References
----------
E. Catmull and R. Rom 1974, A class of local interpolating splines: straight lines are read exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray

Array = NDArray[np.float64]


def linear(values: FloatArray, size: tuple[int, int], step: float) -> FloatArray:
    """Read a coarse grid, its first pixel two steps before the fine one's, linearly at every pixel of a fine grid."""
    down, across = (weights(np.arange(n) / step + 2.0, m, linear=True) for n, m in zip(size, values.shape, strict=True))
    return np.asarray(down @ values @ across.T, dtype=np.float32)


def weights(places: Array, count: int, linear: bool = False) -> FloatArray:
    """(N, count) matrix that interpolates a line of `count` values at `places`: Catmull-Rom, or linear."""
    first = np.floor(places).astype(np.intp)
    rest = places - first
    parts = [1.0 - rest, rest] if linear else _catmull_rom(rest)
    shift = 0 if linear else -1
    matrix = np.zeros((len(places), count), dtype=np.float32)
    line = np.arange(len(places))
    for k, part in enumerate(parts):
        matrix[line, np.clip(first + shift + k, 0, count - 1)] += part
    return matrix


def _catmull_rom(t: Array) -> list[Array]:
    return [
        0.5 * (-t + 2 * t**2 - t**3), 0.5 * (2 - 5 * t**2 + 3 * t**3), 0.5 * (t + 4 * t**2 - 3 * t**3),
        0.5 * (-(t**2) + t**3),
    ]  # fmt: skip


def _catmull_rom_slope(t: Array) -> list[Array]:
    return [
        0.5 * (-1 + 4 * t - 3 * t**2), 0.5 * (-10 * t + 9 * t**2), 0.5 * (1 + 8 * t - 9 * t**2),
        0.5 * (-2 * t + 3 * t**2),
    ]  # fmt: skip


def cubic(values: Array, places: Array, slopes: bool = False) -> tuple[Array, Array]:
    """Values (N, 2) of a grid (n, m, 2) at `places` (N, 2; column, row), and their slopes (N, 2, 2); NaN outside."""
    n, m = values.shape[:2]
    result = np.full((len(places), 2), np.nan)
    slope = np.full((len(places), 2, 2), np.nan)
    with np.errstate(invalid="ignore"):
        good = (places[:, 0] >= 1) & (places[:, 0] <= m - 2) & (places[:, 1] >= 1) & (places[:, 1] <= n - 2)
    where = places[good]
    first = np.minimum(np.floor(where).astype(np.intp), [m - 3, n - 3])
    rest = where - first
    around = np.arange(-1, 3)
    patch = values[(first[:, 1, None] + around)[:, :, None], (first[:, 0, None] + around)[:, None, :]]  # (N, 4, 4, 2)
    across, down = (np.stack(_catmull_rom(rest[:, d]), axis=1) for d in range(2))
    along = np.einsum("nijk,nj->nik", patch, across)
    result[good] = np.einsum("nik,ni->nk", along, down)
    if slopes:
        across_slope, down_slope = (np.stack(_catmull_rom_slope(rest[:, d]), axis=1) for d in range(2))
        slope[good] = np.stack(
            [
                np.einsum("nik,ni->nk", np.einsum("nijk,nj->nik", patch, across_slope), down),
                np.einsum("nik,ni->nk", along, down_slope),
            ],
            axis=2,
        )
    return result, slope


def inverted(values: Array, targets: Array, start: Array, rounds: int = 8) -> Array:
    """Places (N, 2) at which the grid has the values `targets`, by Newton steps from `start`; NaN where none is."""
    places = start.copy()
    error = np.full(len(targets), np.inf)
    live = np.flatnonzero(np.isfinite(places).all(axis=1))
    for _ in range(rounds):
        here, slope = cubic(values, places[live], slopes=True)
        miss = targets[live] - here
        error[live] = np.abs(miss).max(axis=1)
        keep = error[live] > 1e-5  # NaN is dropped too
        live, miss, slope = live[keep], miss[keep], slope[keep]
        if live.size == 0:
            break
        determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
        determinant = np.where(np.abs(determinant) > 1e-12, determinant, 1e-12)
        right = (miss[:, 0] * slope[:, 1, 1] - miss[:, 1] * slope[:, 0, 1]) / determinant
        down = (slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0]) / determinant
        places[live] += np.clip(np.stack([right, down], axis=1), -1.5, 1.5)
    here, _ = cubic(values, places)
    with np.errstate(invalid="ignore"):
        good = np.abs(here - targets).max(axis=1) < 1e-3
    places[~good] = np.nan
    return places
