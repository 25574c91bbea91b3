"""Least-squares integration over any mask: the height whose differences are nearest to the
integrated gradients."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.integration.frankot_chellappa import check_fields, zero_mean
from splitknit.integration.parameters import (
    COARSEST,
    COARSEST_SWEEPS,
    ENERGY_EXCESS,
    ENERGY_ROUNDING,
    GROUND,
    LONGEST_SWEPT,
    MAX_ITERATIONS,
    MOST_DIRECT,
    MOST_FACTORISED,
    RESTARTS,
    TOLERANCE,
    WEIGHT_FLOOR,
    WELDED,
    WORKERS,
)
from splitknit.model import Array, BoolArray, FloatArray

_LOG = logging.getLogger(__name__)

# Geometric multigrid for the graph Laplacian of a masked, weighted pixel grid.
#
# A pixel of a coarse grid stands for 2 x 2 finer ones and belongs to the surface if one of them
# does. The weight of a coarse edge is half the sum of the fine edges that it replaces, which keeps
# the Dirichlet energy of a smooth surface. Heights are carried to the finer grid by bilinear
# interpolation that ignores what lies outside the mask; where edges are weighted, by blocks of
# pixels and one Jacobi step (smoothed aggregation: P. Vanek, J. Mandel and M. Brezina, Computing
# 56, 1996), which carries no height across a weak edge. Residuals go to the coarser grid by the
# exact adjoint; the smoother is a Chebyshev polynomial of degree two in damped Jacobi steps. One
# V-cycle is therefore a symmetric operator, as the conjugate gradients around it need. Where parts
# of the surface lie closer to each other than a coarse pixel and are not joined there (a comb, a
# spiral), a coarser grid would weld them together: such a grid is solved directly instead, once it
# is small enough. Source: U. Trottenberg, C. Oosterlee and A. Schueller, "Multigrid", Academic
# Press 2001, chapters 2 and 5 (cell-centred grids).


# Differences between neighbouring pixels, their adjoint, and the difference that a gradient field
# predicts. Edges are stored at their upper or left pixel in arrays (H, W): `right[i, j]` joins (i,
# j) and (i, j + 1), `down[i, j]` joins (i, j) and (i + 1, j). The last column of `right` and the
# last row of
# `down` are zero.

Floats = TypeVar("Floats", FloatArray, Array)


def _difference(height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height of the right neighbour, and of the lower neighbour, less the pixel's own."""
    right, down = np.zeros_like(height), np.zeros_like(height)
    np.subtract(height[:, 1:], height[:, :-1], out=right[:, :-1])
    np.subtract(height[1:], height[:-1], out=down[:-1])
    return right, down


def _difference_adjoint(right: Floats, down: Floats) -> Floats:
    """Adjoint of :func:`_difference`: what flows into a pixel less what flows out of it."""
    result = -right - down
    result[:, 1:] += right[:, :-1]
    result[1:] += down[:-1]
    return result


def _edge_weights(mask: BoolArray, weights: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Mean weight of an edge's two pixels, zero unless both lie in the mask."""
    own = mask.astype(np.float32) if weights is None else np.where(mask, weights, 0.0)
    right, down = np.zeros_like(own), np.zeros_like(own)
    both_right, both_down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    right[:, :-1] = 0.5 * (own[:, 1:] + own[:, :-1]) * both_right
    down[:-1] = 0.5 * (own[1:] + own[:-1]) * both_down
    return right, down


def _predicted_differences(
    slope_x: FloatArray, slope_y: FloatArray, weights: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Integral of the slopes (y up) along every edge, by the trapezoidal rule.

    It is the mean of the two pixels' slopes; a slope of weight zero is not used. Weights do not
    shift the mean: where they fall with the slope, as trust does, steep sides would come out too
    low.
    """
    right, down = np.zeros_like(slope_x), np.zeros_like(slope_x)
    right[:, :-1] = _edge_integral(slope_x.T, None if weights is None else weights.T).T
    down[:-1] = -_edge_integral(slope_y, weights)
    return right, down


def _edge_integral(slope: FloatArray, weights: FloatArray | None) -> FloatArray:
    """Integral between successive rows, (H - 1, W)."""
    if weights is not None:
        used = (weights > WEIGHT_FLOOR).astype(np.float32)
        kept = slope * used
        return np.asarray((kept[1:] + kept[:-1]) / np.maximum(used[1:] + used[:-1], 1))
    return 0.5 * (slope[1:] + slope[:-1])


_CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=np.float32)
"""Sum of the four neighbours. Source: definition."""
_SPREAD = np.array([0.25, 0.75, 0.75, 0.25], dtype=np.float32)
"""Weights of a coarse cell's height in the four finer cells along an axis. Source: bilinear
interpolation between centres of cells."""
_STEPS = (0.5618, 1.3894)
"""Damping of the two Jacobi steps: the reciprocal Chebyshev roots on [0.5, 2], the upper end of the
spectrum; as polynomials of one operator the steps commute, so that the same order before and after
stays symmetric. Source: derived."""
_SMOOTHED = 2.0 / 3.0
"""Damping of the Jacobi step of interpolation: 4 / 3 over the upper end of the spectrum. Source:
derived."""


class _Grid:
    """One level: edge weights, and the operators on heights that are zero outside the surface."""

    def __init__(self, right: FloatArray, down: FloatArray, unit: bool, even: bool) -> None:
        """Take the edge weights (H, W); `unit` states that they are zero or one, and one inside the
        mask; `even` that they are so on the finest grid."""
        self.right, self.down, self.unit, self.even = right, down, unit, even
        degree = right + down
        degree[:, 1:] += right[:, :-1]
        degree[1:] += down[:-1]
        self.degree = degree
        self.inverse = np.where(degree > 0, 1 / np.maximum(degree, 1e-30), 0).astype(np.float32)
        self.inside = (degree > 0).astype(np.float32)
        self.coarser: _Grid | None = None
        self.direct: _DirectSolver | None = None
        self.fraction = self.inside  # replaced where there is a coarser grid

    def neighbours(self, height: FloatArray) -> FloatArray:
        """Weighted sum of the four neighbours (not masked on a unit grid)."""
        if self.unit:
            return np.asarray(cv2.filter2D(height, -1, _CROSS, borderType=cv2.BORDER_CONSTANT))
        right, down = self.right[:, :-1], self.down[:-1]
        total = np.zeros_like(height)
        np.multiply(right, height[:, 1:], out=total[:, :-1])
        total[:, 1:] += right * height[:, :-1]
        total[:-1] += down * height[1:]
        total[1:] += down * height[:-1]
        return total

    def apply(self, height: Floats) -> Floats:
        """Laplacian (positive semidefinite) of `height`, in the precision of `height`.

        Unequal weights act on differences: a degree less weighted neighbours has a rounding error
        that grows with the height, and makes the operator indefinite once weights differ by a
        thousand.
        """
        if self.unit:
            return self.degree * height - self.neighbours(height) * self.inside
        result = np.zeros_like(height)
        flow = self.right[:, :-1] * (height[:, 1:] - height[:, :-1])
        result[:, :-1] -= flow
        result[:, 1:] += flow
        flow = self.down[:-1] * (height[1:] - height[:-1])
        result[:-1] -= flow
        result[1:] += flow
        return result

    def _smooth(self, height: FloatArray, right_side: FloatArray, step: float) -> None:
        """One damped Jacobi step in place."""
        target = self.neighbours(height)
        target += right_side
        target *= self.inverse
        cv2.addWeighted(height, 1 - step, target, step, 0, dst=height)

    def cycle(self, right_side: FloatArray) -> FloatArray:
        """One V-cycle from zero: an approximate solution of `apply`(height) = right_side."""
        if self.direct is not None:
            return self.direct(right_side)
        height = self.inverse * right_side
        height *= _STEPS[0]
        self._smooth(height, right_side, _STEPS[1])
        if self.coarser is None:
            for _ in range(COARSEST_SWEEPS):
                for step in _STEPS:
                    self._smooth(height, right_side, step)
        else:
            residual = right_side - self.apply(height)
            height += self.prolong(self.coarser.cycle(self.restrict(residual)))
        for step in _STEPS:
            self._smooth(height, right_side, step)
        return height

    def solve_nested(self, right_side: FloatArray) -> FloatArray:
        """Full multigrid: the coarse solution as the start of one V-cycle."""
        if self.coarser is None or self.direct is not None:
            return self.cycle(right_side)
        height = self.prolong(self.coarser.solve_nested(self.restrict(right_side)))
        height += self.cycle(right_side - self.apply(height))
        return height

    def prolong(self, coarse: FloatArray) -> FloatArray:
        """Interpolate heights of the coarser grid to this one."""
        if not self.even:
            blocks = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1) * self.inside
            blocks -= _SMOOTHED * self.inverse * self.apply(blocks)
            return blocks
        rows, columns = self.inside.shape
        fine = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR)
        return fine * self.fraction

    def restrict(self, residual: FloatArray) -> FloatArray:
        """Adjoint of :meth:`prolong`."""
        assert self.coarser is not None
        if not self.even:
            smooth = residual - _SMOOTHED * self.apply(self.inverse * residual)
            smooth *= self.inside
            pairs = smooth[::2] + smooth[1::2]
            return (pairs[:, ::2] + pairs[:, 1::2]) * self.coarser.inside
        spread = cv2.sepFilter2D(
            residual * self.fraction,
            -1,
            _SPREAD,
            _SPREAD,
            anchor=(1, 1),
            borderType=cv2.BORDER_REPLICATE,
        )
        return np.ascontiguousarray(spread[::2, ::2]) * self.coarser.inside


class _DirectSolver:
    """Pseudo-inverse of one grid's Laplacian by sparse factorisation: every connected part keeps a
    zero mean."""

    def __init__(self, grid: _Grid) -> None:
        """Factorise."""
        self.pixels = np.flatnonzero(grid.inside)
        index = np.full(grid.inside.size, -1)
        index[self.pixels] = np.arange(self.pixels.size)
        columns = grid.inside.shape[1]
        ends, values = [], []
        for weight, stride in ((grid.right, 1), (grid.down, columns)):
            start = np.flatnonzero(weight)
            ends.append((index[start], index[start + stride]))
            values.append(weight.ravel()[start].astype(np.float64))
        first, second = np.concatenate([e[0] for e in ends]), np.concatenate([e[1] for e in ends])
        value = -np.concatenate(values)
        degree = -np.bincount(
            np.concatenate([first, second]), np.tile(value, 2), minlength=self.pixels.size
        )
        own = np.arange(self.pixels.size)
        from scipy.sparse.csgraph import connected_components  # slow to import
        from scipy.sparse.linalg import splu  # slow to import

        matrix = scipy.sparse.csc_matrix(
            (
                np.concatenate([value, value, degree + GROUND * degree.mean()]),
                (np.concatenate([first, second, own]), np.concatenate([second, first, own])),
            )
        )
        parts, self.part = connected_components(matrix, directed=False)
        self.size = np.bincount(self.part, minlength=parts)
        self.factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def __call__(self, right_side: Floats) -> Floats:
        """Solve for one right side (H, W), in its precision."""
        height = np.zeros(right_side.size, dtype=right_side.dtype)
        balanced = self._balance(right_side.ravel()[self.pixels].astype(np.float64))
        height[self.pixels] = self._balance(self.factor.solve(balanced))
        return height.reshape(right_side.shape)

    def _balance(self, values: Array) -> Array:
        mean = np.bincount(self.part, weights=values, minlength=self.size.size) / self.size
        return values - mean[self.part]


def _build_grids(right: FloatArray, down: FloatArray, unit: bool) -> _Grid:
    """Finest grid with all coarser ones; both sides must be divisible by two as often as
    :func:`_padded_size` gives."""
    finest = _Grid(right, down, unit, even=unit)
    grid = finest
    while min(grid.inside.shape) > COARSEST and not (
        grid.inside.shape[0] % 2 or grid.inside.shape[1] % 2
    ):
        coarse = _Grid(
            0.5 * (grid.right[::2, 1::2] + grid.right[1::2, 1::2]),
            0.5 * (grid.down[1::2, ::2] + grid.down[1::2, 1::2]),
            unit=False,
            even=unit,
        )
        small = np.count_nonzero(grid.inside) <= MOST_DIRECT
        if small and max(_welded_fraction(grid), _welded_fraction(coarse)) > WELDED:
            break
        cover = cv2.resize(coarse.inside, grid.inside.shape[::-1], interpolation=cv2.INTER_LINEAR)
        grid.fraction = np.where(cover > 0, grid.inside / np.maximum(cover, 1e-6), 0).astype(
            np.float32
        )
        grid.coarser = coarse
        grid = coarse
    if max(grid.inside.shape) > LONGEST_SWEPT and np.count_nonzero(grid.inside) <= MOST_DIRECT:
        grid.direct = _DirectSolver(grid)
    return finest


def _welded_fraction(grid: _Grid) -> float:
    """Fraction of the 2 x 2 blocks whose pixels the edges inside the block do not join (a path
    needs n - 1 edges)."""
    rows, columns = (side // 2 * 2 for side in grid.inside.shape)
    inside = grid.inside[:rows, :columns]
    members = inside[::2, ::2] + inside[::2, 1::2] + inside[1::2, ::2] + inside[1::2, 1::2]
    right, down = grid.right[:rows, :columns] > 0, grid.down[:rows, :columns] > 0
    edges = np.add(right[::2, ::2], right[1::2, ::2], dtype=np.float32)
    edges += down[::2, ::2]
    edges += down[::2, 1::2]
    return int(np.count_nonzero(edges < members - 1)) / max(int(np.count_nonzero(members)), 1)


def _padded_size(rows: int, columns: int) -> tuple[int, int]:
    """Smallest size not below the given one that halves until its smaller side is at most four."""
    halvings = 0
    while min(rows, columns) / 2**halvings > COARSEST:
        halvings += 1
    block = 2**halvings
    return -(-rows // block) * block, -(-columns // block) * block


def poisson(gradient_x: Any, gradient_y: Any, mask: Any = None, weights: Any = None) -> FloatArray:
    """Height whose neighbour differences are nearest, in the (weighted) least-squares sense, to the
    gradients.

    Only differences between pixels of the mask count, so that the surface may end steeply, be cut
    by the image border, have holes, or fall into several parts. A whole rectangle without weights
    is solved directly by cosine transforms; everything else by conjugate gradients with a multigrid
    preconditioner.

    Parameters
    ----------
    gradient_x, gradient_y, mask
        As of :func:`splitknit.integration.frankot_chellappa`.
    weights : (H, W), optional
        Trust in each pixel's gradient, in [0, 1].

    Returns
    -------
    (H, W) float32
        Height in pixels, NaN outside the mask. The mean is zero over every 4-connected part of the
        mask: gradients fix nothing about the height of one part over another.

    Raises
    ------
    BadInput
        If shapes differ, the mask is empty, or a gradient or weight inside the mask is not finite
        or out of range.

    References
    ----------
    B. K. P. Horn and M. J. Brooks, "The variational approach to shape from shading", CVGIP 33
    (1986); Y. Queau, J.-D. Durou and J.-F. Aujol, "Normal integration: a survey", JMIV 60 (2018),
    section 3; the thesis, (3.35) to (3.39).

    Examples
    --------
    >>> import numpy as np
    >>> rows, columns = np.mgrid[0:40, 0:60]
    >>> inside = np.hypot(rows - 20, columns - 30) < 18
    >>> height = poisson(np.full((40, 60), 0.5), np.full((40, 60), -0.25), inside)
    >>> round(float(height[20, 40] - height[20, 20]), 3)
    10.0
    >>> round(float(height[10, 30] - height[30, 30]), 3)
    -5.0
    """
    slope_x, slope_y, inside = check_fields(gradient_x, gradient_y, mask)
    trust = None if weights is None else _check_weights(weights, inside)
    if trust is None and inside.all():
        right, down = _predicted_differences(slope_x, slope_y, None)
        return zero_mean(_solve_rectangle(_difference_adjoint(right, down)), inside)
    window = bounding_box(inside)
    height = _solve_masked(
        slope_x[window], slope_y[window], inside[window], None if trust is None else trust[window]
    )
    result = np.full(inside.shape, np.nan, dtype=np.float32)
    result[window] = _zero_mean_by_component(height, np.ascontiguousarray(inside[window]))
    return result


def _check_weights(weights: Any, mask: BoolArray) -> FloatArray:
    array = np.asarray(weights)
    require(
        array.shape == mask.shape,
        f"weights must have the shape {mask.shape}, but it has {array.shape}.",
    )
    trust = np.where(mask, array, 0.0).astype(np.float32)
    require(
        np.isfinite(trust).all() and float(trust.min()) >= 0 and float(trust.max()) <= 1,
        "weights must lie between 0 and 1 inside the mask.",
    )
    return np.maximum(trust, WEIGHT_FLOOR)


def _zero_mean_by_component(height: FloatArray, mask: BoolArray) -> FloatArray:
    """Return `height` with a zero mean over every 4-connected component of the mask, NaN outside
    it."""
    count, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    if count <= 2:
        return zero_mean(height, mask)
    flat = labels.ravel()
    size = np.bincount(flat, minlength=count)
    total = np.bincount(flat, weights=height.ravel(), minlength=count)
    mean = (total / np.maximum(size, 1)).astype(np.float32)
    return np.where(mask, height - mean[labels], np.nan)


def _solve_rectangle(right_side: FloatArray) -> FloatArray:
    """Laplacian with free borders, inverted in its eigenbasis, the cosines."""
    rows, columns = right_side.shape
    row_value = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)
    column_value = 2 - 2 * np.cos(np.pi * np.arange(columns) / columns)
    eigenvalues = (row_value[:, None] + column_value[None, :]).astype(np.float32)
    eigenvalues[0, 0] = 1.0
    spectrum = scipy.fft.dctn(right_side, type=2, workers=WORKERS)
    spectrum /= eigenvalues
    spectrum[0, 0] = 0.0
    return np.asarray(
        scipy.fft.idctn(spectrum, type=2, workers=WORKERS, overwrite_x=True), dtype=np.float32
    )


def _solve_masked(
    slope_x: FloatArray, slope_y: FloatArray, mask: BoolArray, weights: FloatArray | None
) -> FloatArray:
    rows, columns = mask.shape
    size = _padded_size(rows, columns)
    frame = ((0, size[0] - rows), (0, size[1] - columns))
    inside = np.pad(mask, frame)
    trust = None if weights is None else np.pad(weights, frame)
    weight_right, weight_down = _edge_weights(inside, trust)
    target_right, target_down = _predicted_differences(
        np.pad(slope_x, frame), np.pad(slope_y, frame), trust
    )
    edges = _Edges(weight_right, weight_down, target_right, target_down)
    if weights is not None and np.count_nonzero(mask) <= MOST_FACTORISED:
        return _factorised(_Grid(weight_right, weight_down, unit=False, even=False), edges)[
            :rows, :columns
        ]
    grid = _build_grids(weight_right, weight_down, unit=weights is None)
    height = grid.solve_nested(
        _difference_adjoint(weight_right * target_right, weight_down * target_down)
    )
    if weights is None:
        height += _conjugate_gradients(grid, edges, height)[0].astype(np.float32)
        return height[:rows, :columns]
    exact = height.astype(np.float64)
    for _ in range(RESTARTS):
        correction, eigenvalue = _conjugate_gradients(grid, edges, exact)
        exact += correction
        residual, energy = edges.residual(exact)
        excess = _dot(residual, grid.cycle(residual.astype(np.float32))) / eigenvalue
        if excess <= edges.tolerated(energy):
            return exact[:rows, :columns].astype(np.float32)
    if np.count_nonzero(mask) <= MOST_DIRECT:
        return _factorised(grid, edges)[:rows, :columns]
    _LOG.warning(
        "the weighted integration has not converged; heights may be off where the surface is steep."
    )
    return exact[:rows, :columns].astype(np.float32)


def _factorised(grid: _Grid, edges: _Edges) -> FloatArray:
    """Height by sparse factorisation in double precision, refined once."""
    solver = _DirectSolver(grid)
    height = solver(edges.residual(np.zeros(grid.inside.shape))[0])
    return np.asarray(height + solver(edges.residual(height)[0]), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Weights of the edges, and the differences of height that the gradients predict along them;
    (H, W) each."""

    weight_right: FloatArray
    weight_down: FloatArray
    target_right: FloatArray
    target_down: FloatArray

    def residual(self, height: NDArray[Any]) -> tuple[Array, float]:
        """Half the negative gradient of the energy, and the energy: the weighted sum of squared
        residuals of edges.

        Differences of neighbouring heights are exact in single precision, differences of their
        Laplacian are not.
        """
        step_right, step_down = _difference(height)
        left_right, left_down = self.target_right - step_right, self.target_down - step_down
        flow_right = (self.weight_right * left_right).astype(np.float64)
        flow_down = (self.weight_down * left_down).astype(np.float64)
        energy = _dot(flow_right, left_right) + _dot(flow_down, left_down)
        return _difference_adjoint(flow_right, flow_down), energy

    def tolerated(self, energy: float) -> float:
        """How far an energy may lie above its minimum: a part of it, or what the targets' precision
        makes of zero."""
        power = _dot(self.weight_right, self.target_right**2) + _dot(
            self.weight_down, self.target_down**2
        )
        return ENERGY_EXCESS * energy + ENERGY_ROUNDING * power


def _conjugate_gradients(grid: _Grid, edges: _Edges, height: NDArray[Any]) -> tuple[Array, float]:
    """Correction of the height, until its rms error and the excess of the energy are small; the
    smallest eigenvalue.

    Double precision around a single-precision preconditioner: two halves of a surface that hang
    together by a few pixels shift against each other by the rounding of the residual, divided by a
    very small stiffness. For the same reason the preconditioned residual is divided by the smallest
    eigenvalue of the preconditioned operator that the iteration has met (Lanczos). With the
    residual r and the preconditioner M the energy exceeds its minimum by r^T A^-1 r, at most r^T
    M^-1 r over that eigenvalue.
    """
    residual, left = edges.residual(height)
    small, tolerated = TOLERANCE * _rms(height), edges.tolerated(left)
    correction = np.zeros_like(residual)
    direction = np.zeros_like(residual)
    lengths: list[float] = []
    ratios: list[float] = []
    energy, eigenvalue = 1.0, 1.0
    for _ in range(MAX_ITERATIONS):
        estimate = grid.cycle(residual.astype(np.float32))
        previous, energy = energy, _dot(residual, estimate)
        if energy <= 0:
            break
        ratios.append(energy / previous)
        if lengths:
            eigenvalue = _smallest_eigenvalue(lengths, ratios)
            if _rms(estimate) <= small * eigenvalue and energy <= tolerated * eigenvalue:
                correction += estimate
                break
        direction *= ratios[-1]
        direction += estimate
        image = grid.apply(direction)
        curvature = _dot(direction, image)
        if curvature <= 0:
            break
        lengths.append(energy / curvature)
        image *= lengths[-1]
        residual -= image
        correction += np.multiply(direction, lengths[-1], out=image)
    return correction, eigenvalue


def _smallest_eigenvalue(lengths: list[float], ratios: list[float]) -> float:
    """Smallest Ritz value of the preconditioned operator, from the coefficients of conjugate
    gradients so far.

    The tridiagonal Lanczos matrix has 1 / a_k + b_k / a_(k-1) on its diagonal and sqrt(b_k) /
    a_(k-1) beside it (Y. Saad, "Iterative methods for sparse linear systems", 2nd edition, eq.
    6.82).
    """
    step, ratio = np.array(lengths), np.array(ratios[1 : len(lengths)])
    diagonal = 1 / step
    diagonal[1:] += ratio / step[:-1]
    beside = np.sqrt(ratio) / step[:-1]
    # it reads the lower triangle
    return float(np.linalg.eigvalsh(np.diag(diagonal) + np.diag(beside, -1))[0])


def _dot(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Inner product whose bytes do not depend on threads: along the rows, then their sum in double
    precision."""
    return float(np.sum(np.einsum("ij,ij->i", a, b), dtype=np.float64))


def _rms(a: NDArray[Any]) -> float:
    return float(np.sqrt(_dot(a, a) / a.size))
