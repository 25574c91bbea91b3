"""Geometric multigrid for the graph Laplacian of a masked, weighted pixel grid.

A pixel of a coarse grid stands for 2 x 2 finer ones and belongs to the surface if one of them does. The weight of a
coarse edge is half the sum of the fine edges that it replaces, which keeps the Dirichlet energy of a smooth surface.
Heights are carried to the finer grid by bilinear interpolation that ignores what lies outside the mask, and residuals
to the coarser grid by its exact adjoint; the smoother is a Chebyshev polynomial of degree two in damped Jacobi steps.
One V-cycle is therefore a symmetric operator, as the conjugate gradients around it need.

Where parts of the surface lie closer to each other than a coarse pixel and are not joined there (a comb, a spiral), a
coarser grid would weld them together: such a grid is solved directly instead, once it is small enough.

References
----------
U. Trottenberg, C. Oosterlee and A. Schueller, "Multigrid", Academic Press 2001, chapters 2 and 5 (cell-centred grids).
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg
from numpy.typing import NDArray

from splitknit.integration.edges import Floats
from splitknit.model import FloatArray

_CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=np.float32)
_SPREAD = np.array([0.25, 0.75, 0.75, 0.25], dtype=np.float32)
_STEPS = (0.5618, 1.3894)
"""Damping of the two Jacobi steps: the reciprocal Chebyshev roots on [0.5, 2], the upper end of the spectrum;
as polynomials of one operator the steps commute, so that the same order before and after stays symmetric."""
_COARSEST = 4
_COARSEST_SWEEPS = 48
_LONG = 16
"""A coarsest grid with a longer side is solved directly, not by sweeps."""
_WELDED = 0.02
"""Share of coarse pixels that may join what is not joined inside them."""
_DIRECT = 100_000
"""Unknowns that a direct solver is trusted with."""
_GROUND = 1e-9
"""Added to the diagonal of the direct system, relative to its mean: it fixes the free constant of every part."""


class Grid:
    """One level: edge weights, and the operators on heights that are zero outside the surface."""

    def __init__(self, right: FloatArray, down: FloatArray, unit: bool) -> None:
        """Take the edge weights (H, W); `unit` tells that they are zero or one, and one inside the mask."""
        self.right, self.down, self.unit = right, down, unit
        degree = right + down
        degree[:, 1:] += right[:, :-1]
        degree[1:] += down[:-1]
        self.degree = degree
        self.inverse = np.where(degree > 0, 1 / np.maximum(degree, np.float32(1e-30)), 0).astype(np.float32)
        self.inside = (degree > 0).astype(np.float32)
        self._target, self._term = np.empty_like(right), np.empty_like(right)
        self.coarser: Grid | None = None
        self.direct: DirectSolver | None = None
        self.share = self.inside  # replaced where there is a coarser grid

    def neighbours(self, height: Floats, out: Floats | None = None) -> Floats:
        """Weighted sum of the four neighbours (not masked on a unit grid)."""
        total = np.empty_like(height) if out is None else out
        if self.unit:
            cv2.filter2D(height, -1, _CROSS, dst=total, borderType=cv2.BORDER_CONSTANT)
            return total
        right, down = self.right[:, :-1], self.down[:-1]
        term = self._term if height.dtype == self._term.dtype else np.empty_like(height)
        np.multiply(right, height[:, 1:], out=total[:, :-1])
        total[:, -1] = 0
        np.multiply(right, height[:, :-1], out=term[:, 1:])
        total[:, 1:] += term[:, 1:]
        np.multiply(down, height[1:], out=term[:-1])
        total[:-1] += term[:-1]
        np.multiply(down, height[:-1], out=term[1:])
        total[1:] += term[1:]
        return total

    def apply(self, height: Floats) -> Floats:
        """Laplacian (positive semidefinite) of `height`, in the precision of `height`."""
        around = self.neighbours(height)
        if self.unit:
            around *= self.inside
        np.subtract(self.degree * height, around, out=around)
        return around

    def _smooth(self, height: FloatArray, right_side: FloatArray, step: float) -> None:
        """One damped Jacobi step in place."""
        target = self.neighbours(height, out=self._target)
        target += right_side
        target *= self.inverse
        cv2.addWeighted(height, 1 - step, target, step, 0, dst=height)

    def cycle(self, right_side: FloatArray) -> FloatArray:
        """One V-cycle from zero: an approximate solution of `apply`(height) = right_side."""
        if self.direct is not None:
            return self.direct(right_side)
        height = self.inverse * right_side
        height *= np.float32(_STEPS[0])
        self._smooth(height, right_side, _STEPS[1])
        if self.coarser is None:
            for _ in range(_COARSEST_SWEEPS):
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
        rows, columns = self.inside.shape
        fine = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(fine * self.share, dtype=np.float32)

    def restrict(self, residual: FloatArray) -> FloatArray:
        """Adjoint of :meth:`prolong`."""
        assert self.coarser is not None
        spread = cv2.sepFilter2D(
            residual * self.share, -1, _SPREAD, _SPREAD, anchor=(1, 1), borderType=cv2.BORDER_REPLICATE
        )
        return np.ascontiguousarray(spread[::2, ::2]) * self.coarser.inside


class DirectSolver:
    """Pseudo-inverse of one grid's Laplacian by sparse factorisation: every connected part keeps a zero mean."""

    def __init__(self, grid: Grid) -> None:
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
        degree = grid.degree.ravel()[self.pixels].astype(np.float64)
        own = np.arange(self.pixels.size)
        matrix = scipy.sparse.csc_matrix(
            (
                np.concatenate([value, value, degree + _GROUND * degree.mean()]),
                (np.concatenate([first, second, own]), np.concatenate([second, first, own])),
            )
        )
        parts, self.part = scipy.sparse.csgraph.connected_components(matrix, directed=False)
        self.size = np.bincount(self.part, minlength=parts)
        self.factor = scipy.sparse.linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def __call__(self, right_side: FloatArray) -> FloatArray:
        """Solve for one right side (H, W)."""
        height = np.zeros(right_side.size, dtype=np.float32)
        balanced = self._balance(right_side.ravel()[self.pixels].astype(np.float64))
        height[self.pixels] = self._balance(self.factor.solve(balanced))
        return height.reshape(right_side.shape)

    def _balance(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        mean = np.bincount(self.part, weights=values, minlength=self.size.size) / self.size
        return np.asarray(values - mean[self.part])


def build_grids(right: FloatArray, down: FloatArray, unit: bool) -> Grid:
    """Finest grid with all coarser ones; both sides must be divisible by two as often as :func:`padded_size` says."""
    finest = Grid(right, down, unit)
    grid = finest
    while min(grid.inside.shape) > _COARSEST and not (grid.inside.shape[0] % 2 or grid.inside.shape[1] % 2):
        coarse = Grid(
            np.float32(0.5) * (grid.right[::2, 1::2] + grid.right[1::2, 1::2]),
            np.float32(0.5) * (grid.down[1::2, ::2] + grid.down[1::2, 1::2]),
            unit=False,
        )
        small = np.count_nonzero(grid.inside) <= _DIRECT
        if small and max(_welded_share(grid), _welded_share(coarse)) > _WELDED:
            break
        cover = cv2.resize(coarse.inside, grid.inside.shape[::-1], interpolation=cv2.INTER_LINEAR)
        grid.share = np.where(cover > 0, grid.inside / np.maximum(cover, np.float32(1e-6)), 0).astype(np.float32)
        grid.coarser = coarse
        grid = coarse
    if max(grid.inside.shape) > _LONG and np.count_nonzero(grid.inside) <= _DIRECT:
        grid.direct = DirectSolver(grid)
    return finest


def _welded_share(grid: Grid) -> float:
    """Share of the 2 x 2 blocks whose pixels the edges inside the block do not join (a path needs n - 1 edges)."""
    rows, columns = (side // 2 * 2 for side in grid.inside.shape)
    inside = grid.inside[:rows, :columns]
    members = inside[::2, ::2] + inside[::2, 1::2] + inside[1::2, ::2] + inside[1::2, 1::2]
    right, down = grid.right[:rows, :columns] > 0, grid.down[:rows, :columns] > 0
    edges = np.add(right[::2, ::2], right[1::2, ::2], dtype=np.float32)
    edges += down[::2, ::2]
    edges += down[::2, 1::2]
    return int(np.count_nonzero(edges < members - 1)) / max(int(np.count_nonzero(members)), 1)


def padded_size(rows: int, columns: int) -> tuple[int, int]:
    """Smallest size not below the given one that halves until its smaller side is at most four."""
    halvings = 0
    while min(rows, columns) / 2**halvings > _COARSEST:
        halvings += 1
    block = 2**halvings
    return -(-rows // block) * block, -(-columns // block) * block
