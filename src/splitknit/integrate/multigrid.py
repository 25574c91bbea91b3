"""Geometric multigrid for the graph Laplacian of a masked, weighted pixel grid.

A pixel of a coarse grid stands for 2 x 2 finer ones and belongs to the surface if one of them does. The weight of a
coarse edge is half the sum of the fine edges that it replaces, which keeps the Dirichlet energy of a smooth surface.
Heights are carried to the finer grid by bilinear interpolation that ignores what lies outside the mask, and residuals to
the coarser grid by its exact adjoint; the smoother is a Chebyshev polynomial of degree two in damped Jacobi steps. One
V-cycle is therefore a symmetric operator, as the conjugate gradients around it need.

References
----------
U. Trottenberg, C. Oosterlee and A. Schueller, "Multigrid", Academic Press 2001, chapters 2 and 5 (cell-centred grids).
"""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.types import FloatArray

_CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=np.float32)
_SPREAD = np.array([0.25, 0.75, 0.75, 0.25], dtype=np.float32)
_STEPS = (0.5618, 1.3894)
"""Damping of the two Jacobi steps: the reciprocal Chebyshev roots on [0.5, 2], the upper end of the spectrum."""
_COARSEST = 4
_COARSEST_SWEEPS = 24


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
        self.coarser: Grid | None = None
        self.share = self.inside  # replaced where there is a coarser grid

    def neighbours(self, height: FloatArray) -> FloatArray:
        """Weighted sum of the four neighbours (not masked on a unit grid)."""
        if self.unit:
            return np.asarray(cv2.filter2D(height, -1, _CROSS, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
        total = np.zeros_like(height)
        right, down = self.right[:, :-1], self.down[:-1]
        total[:, :-1] = right * height[:, 1:]
        total[:, 1:] += right * height[:, :-1]
        total[:-1] += down * height[1:]
        total[1:] += down * height[:-1]
        return total

    def apply(self, height: FloatArray) -> FloatArray:
        """Laplacian (positive semidefinite) of `height`."""
        around = self.neighbours(height)
        if self.unit:
            around *= self.inside
        return self.degree * height - around

    def _smooth(self, height: FloatArray, right_side: FloatArray, step: float) -> FloatArray:
        target = self.neighbours(height)
        target += right_side
        target *= self.inverse
        return np.asarray(cv2.addWeighted(height, 1 - step, target, step, 0), dtype=np.float32)

    def cycle(self, right_side: FloatArray) -> FloatArray:
        """One V-cycle from zero: an approximate solution of `apply`(height) = right_side."""
        height = np.float32(_STEPS[0]) * self.inverse * right_side
        height = self._smooth(height, right_side, _STEPS[1])
        if self.coarser is None:
            for _ in range(_COARSEST_SWEEPS):
                for step in (*_STEPS, *_STEPS[::-1]):
                    height = self._smooth(height, right_side, step)
        else:
            residual = right_side - self.apply(height)
            height += self.prolong(self.coarser.cycle(self.restrict(residual)))
        for step in _STEPS[::-1]:
            height = self._smooth(height, right_side, step)
        return height

    def solve_nested(self, right_side: FloatArray) -> FloatArray:
        """Full multigrid: the coarse solution as the start of one V-cycle."""
        if self.coarser is None:
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
        cover = cv2.resize(coarse.inside, grid.inside.shape[::-1], interpolation=cv2.INTER_LINEAR)
        grid.share = np.where(cover > 0, grid.inside / np.maximum(cover, np.float32(1e-6)), 0).astype(np.float32)
        grid.coarser = coarse
        grid = coarse
    return finest


def padded_size(rows: int, columns: int) -> tuple[int, int]:
    """Smallest size not below the given one that halves until its smaller side is at most four."""
    halvings = 0
    while min(rows, columns) / 2**halvings > _COARSEST:
        halvings += 1
    block = 2**halvings
    return -(-rows // block) * block, -(-columns // block) * block
