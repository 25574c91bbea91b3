"""The finger's shape on a coarse grid of nodes, and how it is laid flat.

A node every few tenths of a millimetre carries the surface point there (x to the right, y to the
tip, z to the camera, mm). Heights are local quadratic fits, weighted by a Gaussian and by the mask,
so that neither ridges nor the one-sided windows at the outline bend them. A few rings of nodes
outside the mask are extrapolated, so that maps can be read and inverted up to the outline.
``free``: laid flat along the skin, then relaxed until nothing is stretched more than it must be;
``arc``: along the skin, row by row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import bin_mean
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.prints.curvature import normal_matrices, windowed

KINDS = ("free", "arc")
_POWERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
"""Exponents of x and y of the local quadratic. Source: definition."""
_TOO_SMALL = "the mask is too small to be unrolled: it must be some millimetres wide."


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceGrid:
    """Surface points on nodes of the upright frame."""

    points_mm: Array
    """(n, m, 3) x to the right, y to the tip, z to the camera, in the upright finger's frame; NaN
    where unknown."""
    inside: BoolArray
    """(n, m) on the finger; elsewhere points are extrapolated or unknown."""
    input_from_grid: Array
    """(3, 3) on (column, row, 1): where a node lies in the input."""
    pitch_mm: float
    """Distance of the nodes on the finger plane."""

    @property
    def known(self) -> BoolArray:
        """(n, m) nodes with a point, measured or extrapolated."""
        return np.asarray(np.isfinite(self.points_mm).all(axis=2))


NODES_MM = 0.5  # distance of the nodes on the finger plane
_FINEST_MM = 1e-3  # smallest pitch of a surface that is laid flat
_LONGEST_SURFACE_MM = 200.0  # length of a surface that can be a finger's
RINGS = 3  # rings of nodes outside the mask that are extrapolated


def surface_grid(
    shape_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    input_from_upright: Array,
    upright_size: tuple[int, int],
    *,
    xy_mm: tuple[FloatArray, FloatArray] | None = None,
    node_mm: float = NODES_MM,
) -> SurfaceGrid:
    """Return the smooth surface on a coarse upright grid.

    Raises BadInput if the mask is empty, too small for a surface, or the pitch is not positive.

    `shape_mm`: (H, W) height without ridges, ignored outside `mask`; `xy_mm`: x and y (H, W) of the
    surface points, for perspective cameras; without them pixels lie at their pitch; `node_mm`:
    distance of the nodes. The upright frame has `upright_size` rows and columns.
    """
    require(
        _FINEST_MM <= pitch_mm < _LONGEST_SURFACE_MM,
        f"pitch_mm must be a number from {_FINEST_MM:g} to {_LONGEST_SURFACE_MM:g}, not"
        f" {pitch_mm}.",
    )
    mask = check_mask(mask, shape_mm.shape)
    fields = [shape_mm, *(xy_mm or ())]
    mask = mask & (np.abs(fields) < 1e6).all(axis=0)  # no coordinate of a finger, and no NaN
    require(
        mask.any(),
        "the surface has no finite height inside its mask; reconstruct the capture again.",
    )
    step = node_mm / pitch_mm
    upright_from_input = np.linalg.inv(input_from_upright)
    # left and top, right and bottom in the upright frame, from every fourth pixel; clipped to the
    # frame
    places = moved(upright_from_input, 4.0 * np.argwhere(mask[::4, ::4])[:, ::-1])
    require(len(places) > 0, _TOO_SMALL)
    beyond = 0.1 * max(upright_size)
    low = np.maximum(places.min(axis=0) - 4.0, -beyond)
    high = np.minimum(places.max(axis=0) + 4.0, np.array(upright_size[::-1]) - 1 + beyond)
    longest = float((high - low).max()) * pitch_mm
    require(
        longest < _LONGEST_SURFACE_MM,
        f"the surface is {longest:.0f} mm long, more than any finger; check its scale.",
    )
    margin = (RINGS + 1) * step
    size = np.ceil((high - low + 2 * margin) / step) + 1
    upright_from_grid = np.array(
        [[step, 0.0, low[0] - margin], [0.0, step, low[1] - margin], [0.0, 0.0, 1.0]]
    )
    input_from_grid = input_from_upright @ upright_from_grid
    node = np.stack(np.meshgrid(*map(np.arange, size)), axis=2)
    place = moved(input_from_grid, node)
    (height, *xy), inside = _fits(fields, mask, pitch_mm, place)
    require(int(inside.sum()) >= 16, _TOO_SMALL)
    rig_x, rig_y = xy or (
        (place[..., 0] - 0.5 * (mask.shape[1] - 1)) * pitch_mm,
        (0.5 * (mask.shape[0] - 1) - place[..., 1]) * pitch_mm,
    )
    turn = upright_from_input[:2, :2] / np.sqrt(abs(np.linalg.det(upright_from_input[:2, :2])))
    x = turn[0, 0] * rig_x - turn[0, 1] * rig_y  # rows run down, y runs up
    y = -turn[1, 0] * rig_x + turn[1, 1] * rig_y
    points = np.where(inside[..., None], np.stack([x, y, height], axis=2), np.nan)
    return SurfaceGrid(extrapolated(points, RINGS), inside, input_from_grid, node_mm)


def moved(matrix: FloatArray, points: NDArray[Any]) -> Array:
    """Points (..., 2; column, row) by a matrix (3, 3) on (column, row, 1)."""
    return points @ matrix[:2, :2].T + matrix[:2, 2]


def extrapolated(values: Array, rings: int) -> Array:
    """Continue (n, m, C) straight on into its NaN nodes, `rings` nodes far: the mean over the
    directions that can."""
    steps = [step for step in product((-1, 0, 1), repeat=2) if any(step)]
    result = values
    for _ in range(rings):
        wide = np.pad(result, ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
        guesses = np.stack(
            [
                2.0 * np.roll(wide, (y, x), (0, 1)) - np.roll(wide, (2 * y, 2 * x), (0, 1))
                for y, x in steps
            ]
        )[:, 2:-2, 2:-2]
        weights = np.array([1.0 if 0 in step else 0.5 for step in steps])[:, None, None, None]
        weights = weights * np.isfinite(guesses).all(axis=3, keepdims=True)
        total = np.where(weights > 0, weights * guesses, 0.0).sum(axis=0)
        new = ~np.isfinite(result).all(axis=2, keepdims=True) & (weights.sum(axis=0) > 0)
        result = np.where(new, total / np.maximum(weights.sum(axis=0), 0.5), result)
    return result


def _fits(
    fields: list[FloatArray], mask: BoolArray, pitch_mm: float, place: Array
) -> tuple[list[Array], BoolArray]:
    """Local quadratic fits of the fields at places (n, m, 2), and where the mask supports them (n,
    m)."""
    factor = max(1, int(0.1 / pitch_mm))
    rows, columns = (  # its sides multiples of the factor where the image allows
        slice(box.start, min(side, box.start + -(-(box.stop - box.start) // factor) * factor))
        for box, side in zip(bounding_box(mask), mask.shape, strict=True)
    )
    inside = mask[rows, columns]
    require(min(inside.shape) >= factor, _TOO_SMALL)
    # whole blocks only: no shifted means
    weight = bin_mean(inside.astype(np.float32), factor) > 0.99
    sigma = 0.3 / (pitch_mm * factor)  # standard deviation of the Gaussian window of the local fits
    reach = int(np.ceil(3.0 * sigma))
    offset = np.arange(-reach, reach + 1) / sigma
    window = np.exp(-0.5 * offset**2)
    taps = [window * offset**k for k in range(5)]
    # places of the nodes in the reduced image
    small = (place - [columns.start, rows.start] + 0.5) / factor - 0.5
    nearest = np.rint(small).astype(np.intp)
    usable = ((nearest >= 0) & (nearest < weight.shape[::-1])).all(axis=2)
    usable[usable] = weight[nearest[usable, 1], nearest[usable, 0]]
    at = nearest[usable, 1], nearest[usable, 0]
    normal = normal_matrices(weight.astype(np.float32), taps, _POWERS, at)
    support = normal[:, 0, 0] / float(window.sum()) ** 2
    normal += 1e-6 * normal[:, :1, :1] * np.eye(6)
    rest = (small[usable] - nearest[usable]) / sigma
    monomials = np.stack([rest[:, 0] ** i * rest[:, 1] ** j for i, j in _POWERS], axis=1)
    supported = usable.copy()
    supported[usable] = support > 0.25
    results = []
    for field in fields:
        values = np.where(
            weight,
            bin_mean(np.where(inside, field[rows, columns], 0.0).astype(np.float32), factor),
            0.0,
        )
        middle = float(values[weight].mean()) if weight.any() else 0.0
        values = np.where(weight, values - middle, 0.0)
        right = np.stack([windowed(values, taps[i], taps[j])[at] for i, j in _POWERS], axis=1)
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        smooth = np.full(usable.shape, np.nan)
        smooth[usable] = (solved * monomials).sum(axis=1) + middle
        results.append(np.where(supported, smooth, np.nan))
    return results, supported


# How far a flat map of the skin stretches it.


def distortion(points_mm: Array, flat_mm: Array, inside: BoolArray) -> dict[str, float]:
    """By how much lengths are off where a map lays nodes flat, percent, the worse direction of each
    cell: median and 95th percentile, weighted by the skin's area; empty without a cell.

    `points_mm`: (n, m, 3) surface points of the nodes; `flat_mm`: (n, m, 2) where the map lays
    them; `inside`: (n, m) bool, cells with four corners inside count. Source: the stretches are the
    singular values of the map's derivatives over the surface's (Floater and Hormann 2005, Surface
    parameterization, section 2).
    """
    jacobian, skin = _derivatives(flat_mm), _derivatives(points_mm)
    cell = (
        _whole_cells(inside)
        & np.isfinite(jacobian).all(axis=(2, 3))
        & np.isfinite(skin).all(axis=(2, 3))
    )
    if not cell.any():
        return {}
    skin = skin[cell]
    stretches = np.linalg.svd(jacobian[cell] @ np.linalg.pinv(skin), compute_uv=False)
    worst = np.abs(stretches[:, :2] - 1.0).max(axis=1)
    area = np.linalg.norm(np.cross(skin[..., 0], skin[..., 1]), axis=1)
    halves = np.quantile(100.0 * worst, [0.5, 0.95], weights=area, method="inverted_cdf")
    median, p95 = halves.round(3).tolist()
    return {"length_median_percent": median, "length_p95_percent": p95}


def _whole_cells(nodes: BoolArray) -> BoolArray:
    """(n - 1, m - 1) cells of which all four corners are in `nodes` (n, m)."""
    return nodes[:-1, :-1] & nodes[:-1, 1:] & nodes[1:, :-1] & nodes[1:, 1:]


def _derivatives(values: Array) -> Array:
    """(n - 1, m - 1, C, 2) differences of (n, m, C) to the right and down, at the middles of the
    cells."""
    right = 0.5 * (values[:-1, 1:] - values[:-1, :-1] + values[1:, 1:] - values[1:, :-1])
    down = 0.5 * (values[1:, :-1] - values[:-1, :-1] + values[1:, 1:] - values[:-1, 1:])
    return np.stack([right, down], axis=-1)


# Nonparametric unrolling: distances along the skin, laid flat.
#
# First each cross-section is measured along the skin from the finger's central line, and the
# central line along itself (`arc`). On a doubly curved tip that stretches what lies beside the
# line; so the sheet is then relaxed until every small triangle is as nearly its true size and shape
# as the others allow (`free`).
#
# Source: L. Liu, L. Zhang, Y. Xu, C. Gotsman and S. Gortler 2008, A local/global approach to mesh
# parameterization, eqs. 5-8 (as-rigid-as-possible).


def _arc_lengths(grid: SurfaceGrid) -> Array:
    """Return (n, m, 2) u to the right and v to the tip, mm along the skin; NaN where nothing is
    known.

    u is the length of a cross-section (a row of nodes) from the central line, v the length of the
    central line. The central line is straight in the upright frame: the median of the rows'
    middles.
    """
    points = grid.points_mm
    known = grid.known
    rows = np.flatnonzero(grid.inside.any(axis=1))
    middle = round(
        float(np.median([0.5 * (np.flatnonzero(grid.inside[row])[[0, -1]]).sum() for row in rows]))
    )
    across = _lengths(points, known)
    u = across - across[:, middle : middle + 1]
    # rows whose line lies outside the sheet are anchored at their own middle below
    along = _lengths(points.swapaxes(0, 1), known.T)[middle]
    v = -(along - along[round(float(rows.mean()))])
    good = np.isfinite(v)
    require(
        int(good.sum()) >= 4, "the finger's central line is not on its mask; mark the whole finger."
    )
    place = np.arange(len(points))
    v = np.where(good, v, np.polyval(np.polyfit(place[good], v[good], 1), place))
    for row in np.flatnonzero(~np.isfinite(u).any(axis=1) & known.any(axis=1)):
        first = int(np.flatnonzero(known[row])[0])
        u[row] = across[row] - across[row, first] + (first - middle) * grid.pitch_mm
    flat = np.stack([u, np.broadcast_to(v[:, None], u.shape)], axis=2)
    return np.where(known[..., None], flat, np.nan)


def longest_run(nodes: BoolArray) -> NDArray[np.intp]:
    """Places (N,) of the longest run of true ones in a line."""
    places = np.flatnonzero(nodes)
    return max(np.split(places, np.flatnonzero(np.diff(places) > 1) + 1), key=len)


def _lengths(points: Array, known: BoolArray) -> Array:
    """(n, m) length along each row from its first node; NaN before and after the longest run of
    known nodes."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)
    result = np.full(known.shape, np.nan)
    for row, nodes in enumerate(known):
        run = longest_run(nodes)
        if run.size > 1:
            result[row, run] = np.r_[0.0, np.cumsum(step[row, run[:-1]])]
    return result


def _relaxed(grid: SurfaceGrid, start: Array, centre_weight: float) -> Array:
    """As-rigid-as-possible flattening of the sheet of nodes, from `start` (n, m, 2).

    Triangles weigh with their area times the cosine of their slant to the power `centre_weight`;
    extrapolated ones hardly weigh. Stops when no node moves by more than 0.2 um. The result is
    turned back to the mean direction of `start`.
    """
    triangles, weight = _triangles(grid, start, centre_weight)
    nodes, index = np.unique(triangles, return_inverse=True)
    corner = index.reshape(triangles.shape)
    count = nodes.size

    # triangles in a plane of complex numbers, and half the cotangents of their angles
    local = _laid_flat(grid.points_mm.reshape(-1, 3)[triangles])
    after = np.roll(local, -1, axis=1)
    before = np.roll(local, 1, axis=1)
    product = (after - local).conj() * (before - local)
    cotangent = 0.5 * product.real / np.maximum(np.abs(product.imag), 1e-9) * weight[:, None]

    # the Laplacian, and at each corner the sum of the triangle's weighted edges that meet there
    i = np.roll(corner, -1, axis=1).ravel()
    j = np.roll(corner, 1, axis=1).ravel()
    c = cotangent.ravel()
    entries = np.r_[c, c, -c, -c], (np.r_[i, j, i, j], np.r_[i, j, j, i])
    laplacian = scipy.sparse.coo_array(entries, shape=(count, count)).tocsc()
    edge = cotangent * (after - before)
    sums = np.roll(edge, 1, axis=1) - np.roll(edge, -1, axis=1)
    places = corner.ravel(), np.repeat(np.arange(len(corner)), 3)
    edges = scipy.sparse.coo_array((sums.ravel(), places), shape=(count, len(corner))).tocsr()
    back = edges.conj().T

    flat = start.reshape(-1, 2)[nodes]
    plane = flat.view(complex)[:, 0]
    pinned = int(np.argmin(np.linalg.norm(flat - np.median(flat, axis=0), axis=1)))
    free = np.delete(np.arange(count), pinned)
    from scipy.sparse.linalg import splu  # slow to import

    solver = splu(
        laplacian[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )  # fmt: skip
    pull = laplacian[free][:, [pinned]].toarray() * flat[[pinned]]
    for _ in range(10):  # at most
        turn = back @ plane  # of each triangle, as fits the nodes best
        turn /= np.maximum(np.abs(turn), 1e-12)
        right = (edges @ turn).view(float).reshape(-1, 2)
        solution = solver.solve(right[free] - pull)
        step = float(np.abs(solution - flat[free]).max())
        flat[free] = solution
        if step < 2e-4:
            break

    # turned and shifted so that it lies on `start` as well as a rigid sheet can
    wanted = start[..., 0] + 1j * start[..., 1]
    result = np.full(wanted.shape, complex(np.nan, np.nan))
    result.ravel()[nodes] = plane
    both = grid.inside & np.isfinite(result) & np.isfinite(wanted)
    middle = result[both].mean()
    target = wanted[both].mean()
    overlap = np.vdot(result[both] - middle, wanted[both] - target)
    result = (result - middle) * (overlap / abs(overlap)) + target
    return np.stack([result.real, result.imag], axis=2)


def _triangles(
    grid: SurfaceGrid, start: Array, centre_weight: float
) -> tuple[NDArray[np.intp], Array]:
    """Both ways to cut each cell of four known nodes into triangles (T, 3), and the weights of the
    triangles (T,)."""
    number = np.arange(grid.inside.size).reshape(grid.inside.shape)
    cell = _whole_cells(grid.known & np.isfinite(start).all(axis=2))
    a = number[:-1, :-1][cell]
    b = number[:-1, 1:][cell]
    c = number[1:, :-1][cell]
    d = number[1:, 1:][cell]
    # counter-clockwise as seen from the camera (rows run down)
    triangles = np.concatenate(
        [np.stack(t, axis=1) for t in ((a, c, b), (b, c, d), (a, c, d), (a, d, b))]
    )
    corners = grid.points_mm.reshape(-1, 3)[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosine = np.abs(normal[:, 2]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    inside = grid.inside.ravel()[triangles].all(axis=1)
    return triangles, np.where(inside, np.maximum(cosine, 0.05) ** centre_weight, 1e-3)


def _laid_flat(corners: Array) -> NDArray[np.complex128]:
    """Triangles (T, 3, 3) in space as congruent ones in a plane, (T, 3) x + i y of the corners,
    counter-clockwise."""
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    area = np.linalg.norm(np.cross(first, second), axis=1)
    return np.stack(
        [0.0 * length, length, ((first * second).sum(axis=1) + 1j * area) / length], axis=1
    )


@dataclass(frozen=True, slots=True, eq=False)
class Unrolled:
    """The nodes of a surface, laid flat."""

    grid: SurfaceGrid
    flat_mm: Array
    """(n, m, 2) u to the right and v to the tip, as the camera sees them; NaN where unknown."""
    distortion: dict[str, float]


_CENTRE_WEIGHT = 4.0
"""Weight of the skin as a power of the cosine of its slant: 0 spreads the distortion evenly, larger
values keep the middle undistorted at the cost of the sides."""


def unroll(
    grid: SurfaceGrid, kind: str = "free", centre_weight: float = _CENTRE_WEIGHT
) -> Unrolled:
    """Lay a surface flat, by one of :data:`KINDS`. Raises BadInput if there is too little surface.

    `grid`: from :func:`surface_grid`.
    """
    flat = _arc_lengths(grid)
    if kind == "free":
        flat = _relaxed(grid, flat, centre_weight)
    # what the map does not reach is not known
    grid = replace(grid, inside=grid.inside & np.isfinite(flat).all(axis=2))
    return Unrolled(grid, flat, distortion(grid.points_mm, flat, grid.inside))
