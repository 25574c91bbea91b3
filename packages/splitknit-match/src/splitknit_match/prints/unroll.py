"""Unrolling a finger: where its skin lies when it is laid flat.

``free``: along the skin, then relaxed until nothing is stretched more than it must be; ``arc``: along the skin, row by
row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.settings import Checked, Limits
from splitknit_match.prints.unroll_grid import SurfaceGrid

# How far a flat map of the skin stretches it: two principal stretches everywhere, as maps and as numbers.


@dataclass(frozen=True, slots=True, eq=False)
class _Distortion:
    """Distortion of the cells between the nodes; NaN where there is no surface."""

    area: Array
    """(n - 1, m - 1) area on the map over area of the skin, minus one."""
    anisotropy: Array
    """(n - 1, m - 1) larger over smaller principal stretch, minus one."""
    largest: Array
    """(n - 1, m - 1) larger principal stretch."""
    smallest: Array
    """(n - 1, m - 1) smaller principal stretch."""
    slant_deg: Array
    """(n - 1, m - 1) slant of the skin."""
    skin_mm2: Array
    """(n - 1, m - 1) area of the skin."""

    def figures(self) -> dict[str, float | None]:
        """Percent, weighted by the skin's area: medians, 95th percentiles, and by zones of slant."""
        zones = {
            "": np.isfinite(self.area),
            "_centre": self.slant_deg < 20.0,
            "_slant_60": np.abs(self.slant_deg - 60.0) < 5.0,
        }
        result: dict[str, float | None] = {}
        worst = np.maximum(np.abs(self.largest - 1.0), np.abs(self.smallest - 1.0))
        for zone, slanted in zones.items():
            where = slanted & np.isfinite(self.area)
            for name, values in (("area", np.abs(self.area)), ("anisotropy", self.anisotropy), ("length", worst)):
                for word, fraction in (("median", 0.5), ("p95", 0.95)):
                    found = _percentile(values[where], self.skin_mm2[where], fraction)
                    result[f"{name}{zone}_{word}_percent"] = None if found is None else round(100.0 * found, 3)
        return result


def distortion(points_mm: Array, flat_mm: Array, inside: NDArray[np.bool_]) -> _Distortion:
    """Compare a flat map with the surface, cell by cell.

    `points_mm`: (n, m, 3) surface points of the nodes; `flat_mm`: (n, m, 2) where the map lays them; `inside`: (n, m)
    bool, cells with four corners inside count. Source: the stretches are the roots of the eigenvalues of J G^-1 J^T, J
    the map's and G the surface's first derivatives over the grid (Floater and Hormann 2005, Surface parameterization,
    section 2).
    """
    right, down = _differences(points_mm)
    flat_right, flat_down = _differences(flat_mm)
    e, f, g = (right * right).sum(2), (right * down).sum(2), (down * down).sum(2)
    a, b, c = (flat_right**2).sum(2), (flat_right * flat_down).sum(2), (flat_down**2).sum(2)
    determinant = np.maximum(e * g - f * f, 1e-18)
    # eigenvalues of G^-1 A, A the map's own metric
    trace = (g * a - 2.0 * f * b + e * c) / determinant
    product = np.maximum(a * c - b * b, 0.0) / determinant
    root = np.sqrt(np.maximum(0.25 * trace * trace - product, 0.0))
    largest = np.sqrt(np.maximum(0.5 * trace + root, 1e-18))
    smallest = np.sqrt(np.maximum(0.5 * trace - root, 1e-18))
    normal = np.cross(right, -down)
    size = np.linalg.norm(normal, axis=2)
    slant = np.rad2deg(np.arccos(np.clip(np.abs(normal[..., 2]) / np.maximum(size, 1e-18), 0.0, 1.0)))
    cell = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    cell &= np.isfinite(trace)
    fields = [largest * smallest - 1.0, largest / smallest - 1.0, largest, smallest, slant, size]
    return _Distortion(*(np.where(cell, field, np.nan) for field in fields))


def _differences(values: Array) -> tuple[Array, Array]:
    """Differences to the right and down at the middles of the cells."""
    right = 0.5 * (values[:-1, 1:] - values[:-1, :-1] + values[1:, 1:] - values[1:, :-1])
    down = 0.5 * (values[1:, :-1] - values[:-1, :-1] + values[1:, 1:] - values[:-1, 1:])
    return right, down


def _percentile(values: Array, weights: Array, fraction: float) -> float | None:
    if values.size == 0:
        return None
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(total, fraction * total[-1])), values.size - 1)])


# Nonparametric unrolling: distances along the skin, laid flat.
#
# First each cross-section is measured along the skin from the finger's central line, and the central line along itself
# (`arc`). On a doubly curved tip that stretches what lies beside the line; so the sheet is then relaxed until every
# small triangle is as nearly its true size and shape as the others allow (`free`).
#
# Source: L. Liu, L. Zhang, Y. Xu, C. Gotsman and S. Gortler 2008, A local/global approach to mesh parameterization,
# eqs. 5-8 (as-rigid-as-possible).

_ENDS = ((1, 2), (2, 0), (0, 1))
"""Edge k of a triangle lies opposite corner k."""


def _arc_lengths(grid: SurfaceGrid) -> Array:
    """Return (n, m, 2) u to the right and v to the tip, mm along the skin; NaN where nothing is known.

    u is the length of a cross-section (a row of nodes) from the central line, v the length of the central line. The
    central line is straight in the upright frame: the median of the rows' middles.
    """
    points, inside, known = grid.points_mm, grid.inside, grid.known
    columns = np.arange(points.shape[1])
    rows = np.flatnonzero(inside.any(axis=1))
    middles = [0.5 * (columns[inside[row]][0] + columns[inside[row]][-1]) for row in rows]
    middle = round(float(np.median(middles)))
    across = _lengths(points, known, axis=1)
    u = across - across[:, middle : middle + 1]
    # rows whose line lies outside the sheet are anchored at their own middle below
    along = _lengths(points, known, axis=0)[:, middle]
    v_line = -(along - along[round(float(rows.mean()))])
    good = np.isfinite(v_line)
    require(int(good.sum()) >= 4, "the finger's central line is not on its mask; mark the whole finger.")
    places = np.arange(points.shape[0])
    slope = np.polyfit(places[good], v_line[good], 1)
    v_line = np.where(good, v_line, np.polyval(slope, places))
    for row in np.flatnonzero(~np.isfinite(u).any(axis=1) & known.any(axis=1)):
        first = int(np.flatnonzero(known[row])[0])
        offset = (first - middle) * grid.pitch_mm
        u[row] = across[row] - across[row, first] + offset
    v = np.broadcast_to(v_line[:, None], u.shape)
    flat = np.stack([u, v], axis=2)
    flat[~known] = np.nan
    return np.asarray(flat)


def _lengths(points: Array, known: NDArray[np.bool_], axis: int) -> Array:
    """Length along `axis` from the first node; NaN before and after the longest run of known nodes."""
    step = np.linalg.norm(np.diff(points, axis=axis), axis=2)
    step = np.moveaxis(step, axis, 1)
    run = np.moveaxis(known, axis, 1)
    result = np.full(run.shape, np.nan)
    for line in range(len(run)):
        places = np.flatnonzero(run[line])
        if places.size < 2:
            continue
        cuts = np.flatnonzero(np.diff(places) > 1)
        starts, stops = np.r_[0, cuts + 1], np.r_[cuts, places.size - 1]
        best = int(np.argmax(stops - starts))
        first, last = places[starts[best]], places[stops[best]]
        result[line, first : last + 1] = np.r_[0.0, np.cumsum(step[line, first:last])]
    return np.moveaxis(result, 1, axis)


def _relaxed(grid: SurfaceGrid, start: Array, iterations: int, centre_weight: float) -> Array:
    """As-rigid-as-possible flattening of the sheet of nodes, from `start` (n, m, 2).

    Triangles weigh with their area times the cosine of their slant to the power `centre_weight`; extrapolated ones
    hardly weigh. Stops when no node moves by more than 0.2 um. The result is turned back to the mean direction of
    `start`.
    """
    triangles, weight = _triangles(grid, start, centre_weight)
    nodes = np.unique(triangles)
    index = np.full(start.shape[0] * start.shape[1], -1)
    index[nodes] = np.arange(nodes.size)
    corner = index[triangles]
    flat = start.reshape(-1, 2)[nodes]
    local = _laid_flat(grid.points_mm.reshape(-1, 3)[triangles])
    cotangent = _cotangents(local) * weight[:, None]
    i = np.concatenate([corner[:, a] for a, _ in _ENDS])
    j = np.concatenate([corner[:, b] for _, b in _ENDS])
    c = np.concatenate([cotangent[:, k] for k in range(3)])
    count = nodes.size
    ones = scipy.sparse.coo_array(
        (np.r_[c, c, -c, -c], (np.r_[i, j, i, j], np.r_[i, j, j, i])), shape=(count, count)
    ).tocsc()
    pinned = int(np.argmin(np.linalg.norm(flat - np.median(flat, axis=0), axis=1)))
    free = np.delete(np.arange(count), pinned)
    from scipy.sparse.linalg import splu  # slow to import

    solver = splu(
        ones[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    across, along = _edge_sums(corner, local, cotangent, count)
    pin = flat[pinned].copy()
    pull = ones[free][:, [pinned]].toarray() * pin[None]
    for _ in range(iterations):
        cos = across.T @ flat[:, 0] + along.T @ flat[:, 1]
        sin = across.T @ flat[:, 1] - along.T @ flat[:, 0]
        length = np.maximum(np.hypot(cos, sin), 1e-12)
        cos, sin = cos / length, sin / length
        right = np.stack([across @ cos - along @ sin, across @ sin + along @ cos], axis=1)
        moved = solver.solve(right[free] - pull)
        step = float(np.abs(moved - flat[free]).max())
        flat[free] = moved
        if step < 2e-4:
            break
    result = np.full((start.shape[0] * start.shape[1], 2), np.nan)
    result[nodes] = flat
    return _turned_back(result.reshape(start.shape), start, grid.inside)


def _triangles(grid: SurfaceGrid, start: Array, centre_weight: float) -> tuple[NDArray[np.intp], Array]:
    """Both ways to cut each cell of four known nodes into triangles (T, 3), and the weights of the triangles (T,)."""
    n, m = grid.inside.shape
    number = np.arange(n * m).reshape(n, m)
    known = grid.known & np.isfinite(start).all(axis=2)
    cell = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    a, b, c, d = (part[cell] for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
    triangles = np.concatenate(
        [np.stack(t, axis=1) for t in ((a, c, b), (b, c, d), (a, c, d), (a, d, b))]
    )  # counter-clockwise as seen from the camera (rows run down)
    corners = grid.points_mm.reshape(-1, 3)[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosine = np.abs(normal[:, 2]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    inside = grid.inside.ravel()[triangles].all(axis=1)
    return triangles, np.where(inside, np.maximum(cosine, 0.05) ** centre_weight, 1e-3)


def _laid_flat(corners: Array) -> Array:
    """Triangles (T, 3, 3) in space as congruent triangles (T, 3, 2) in a plane, counter-clockwise."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    along = (first * second).sum(axis=1) / length
    beside = np.linalg.norm(np.cross(first, second), axis=1) / length
    zero = np.zeros_like(length)
    return np.stack([np.stack([zero, zero], 1), np.stack([length, zero], 1), np.stack([along, beside], 1)], axis=1)


def _cotangents(local: Array) -> Array:
    """(T, 3) half the cotangent of the angle at each corner."""
    result = np.empty(local.shape[:2])
    for k in range(3):
        first, second = local[:, (k + 1) % 3] - local[:, k], local[:, (k + 2) % 3] - local[:, k]
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        result[:, k] = 0.5 * (first * second).sum(axis=1) / np.maximum(np.abs(cross), 1e-9)
    return result


def _edge_sums(
    corner: NDArray[np.intp], local: Array, cotangent: Array, count: int
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Sparse (count, T): at each corner the sum of the triangle's weighted edges that meet there, along x and y.

    Turning all triangles and adding up their edges at the nodes, and finding the turn that fits the nodes best, are
    products with these two.
    """
    sums = np.zeros((*corner.shape, 2))
    for k, (a, b) in enumerate(_ENDS):
        edge = cotangent[:, k, None] * (local[:, a] - local[:, b])
        sums[:, a] += edge
        sums[:, b] -= edge
    triangle = np.repeat(np.arange(len(corner)), 3)
    shape = (count, len(corner))
    parts = [
        scipy.sparse.coo_array((sums[..., d].ravel(), (corner.ravel(), triangle)), shape=shape).tocsr()
        for d in range(2)
    ]
    return parts[0], parts[1]


def _turned_back(flat: Array, start: Array, inside: NDArray[np.bool_]) -> Array:
    """Turn and shift `flat` so that it lies on `start` as well as a rigid sheet can."""
    both = inside & np.isfinite(flat).all(axis=2) & np.isfinite(start).all(axis=2)
    middle, target = flat[both].mean(axis=0), start[both].mean(axis=0)
    a, b = flat[both] - middle, start[both] - target
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray((flat - middle) @ turn + target)


Array = NDArray[np.float64]
KINDS = ("free", "arc")

_ITERATIONS = 10
"""Rounds of relaxation at most."""
CENTRE_WEIGHT = 4.0
"""Weight of the skin as a power of the cosine of its slant: 0 spreads the distortion evenly, larger values keep the
middle undistorted at the cost of the sides."""
NODES_MM = 0.5
"""Distance of the nodes on the finger plane."""


@dataclass(frozen=True, slots=True)
class UnrollSettings(Checked):
    """How the skin is laid flat."""

    slant_deg: Annotated[float, Limits(10, 85)] = 70.0
    """Skin steeper than this is left out of the print: the camera hardly sees it."""


@dataclass(frozen=True, slots=True, eq=False)
class Unrolled:
    """The nodes of a surface, laid flat."""

    grid: SurfaceGrid
    flat_mm: Array
    """(n, m, 2) u to the right and v to the tip, as the camera sees them; NaN where unknown."""
    distortion: _Distortion


def unroll(grid: SurfaceGrid, kind: str = "free", centre_weight: float = CENTRE_WEIGHT) -> Unrolled:
    """Lay a surface flat, by one of :data:`KINDS`. Raises BadInput if there is too little surface.

    `grid`: from :func:`splitknit_match.prints.unroll_grid.surface_grid`.
    """
    flat = _arc_lengths(grid)
    if kind == "free":
        flat = _relaxed(grid, flat, _ITERATIONS, centre_weight)
    # what the map does not reach is not known
    reached = np.isfinite(flat).all(axis=2)
    grid = replace(grid, inside=grid.inside & reached)
    return Unrolled(grid, flat, distortion(grid.points_mm, flat, grid.inside))
