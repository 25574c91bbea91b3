"""Least-squares integration over any mask: the height whose differences are nearest to the
integrated gradients."""

from __future__ import annotations

import logging
from typing import Any, TypeVar

import cv2
import numpy as np
import scipy

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import Window
from splitknit.integration.conjugate_gradients import conjugate_gradients, dot, rms
from splitknit.integration.frankot_chellappa import check_fields, zero_mean
from splitknit.model import Array, BoolArray, FloatArray

_LOG = logging.getLogger(__name__)

# Differences between neighbouring pixels, their adjoint, and the difference that a gradient field
# predicts. Edges are stored at their upper or left pixel in arrays (H, W): `right[i, j]` joins
# (i, j) and (i, j + 1), `down[i, j]` joins (i, j) and (i + 1, j). The last column of `right` and
# the last row of `down` are zero.

Floats = TypeVar("Floats", FloatArray, Array)
_Edges = tuple[FloatArray, FloatArray]
"""Values of the edges to the right, and downwards."""


def _difference(height: Floats) -> tuple[Floats, Floats]:
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


def _edge_weights(weights: FloatArray) -> _Edges:
    """Mean weight of an edge's two pixels, zero unless both lie in the mask, where weights are
    positive."""
    mask = weights > 0
    right, down = np.zeros_like(weights), np.zeros_like(weights)
    both_right, both_down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    right[:, :-1] = 0.5 * (weights[:, 1:] + weights[:, :-1]) * both_right
    down[:-1] = 0.5 * (weights[1:] + weights[:-1]) * both_down
    return right, down


_WEIGHT_FLOOR = 1e-3
"""Minimum weight, so that a hole in the data is bridged smoothly instead of cut out."""


def _on_edges(of_right: FloatArray, of_down: FloatArray, weights: FloatArray) -> _Edges:
    """Weighted means of an edge's two pixels, zero where both weigh nothing: of one field (H, W)
    to the right, of another downwards."""
    right, down = np.zeros_like(weights), np.zeros_like(weights)
    flow, fall, floor = of_right * weights, of_down * weights, np.float32(1e-12)
    beside, below = weights[:, 1:] + weights[:, :-1], weights[1:] + weights[:-1]
    right[:, :-1] = (flow[:, 1:] + flow[:, :-1]) / np.maximum(beside, floor)
    down[:-1] = (fall[1:] + fall[:-1]) / np.maximum(below, floor)
    return right, down


def _predicted_differences(slope_x: FloatArray, slope_y: FloatArray, weights: FloatArray) -> _Edges:
    """Integral of the slopes (y up) along every edge, by the trapezoidal rule.

    It is the mean of the two pixels' slopes; a slope of weight zero is not used. The mean is not
    weighted: with weights that fall with the slope, steep sides would come out too low.
    """
    return _on_edges(slope_x, -slope_y, (weights > _WEIGHT_FLOOR).astype(np.float32))


# Multigrid for the graph Laplacian of a masked, weighted pixel grid.
#
# A pixel of a coarse grid stands for 2 x 2 finer ones and belongs to the surface if one of them
# does. The weight of a coarse edge is half the sum of the fine edges that it replaces, which keeps
# the Dirichlet energy of a smooth surface. Heights are carried to the finer grid by blocks of
# pixels and one Jacobi step (smoothed aggregation: P. Vanek, J. Mandel and M. Brezina, Computing
# 56, 1996), which carries no height across a weak edge, and residuals to the coarser grid by the
# exact adjoint; the smoother is a Chebyshev polynomial of degree two in damped Jacobi steps. One
# V-cycle is therefore a symmetric operator, as the conjugate gradients around it need. The coarsest
# grid is solved directly. Source: U. Trottenberg, C. Oosterlee and A. Schueller, "Multigrid",
# Academic Press 2001, chapters 2 and 5 (cell-centred grids).

_STEPS = (0.5618, 1.3894)
"""Damping of the two Jacobi steps: the reciprocal Chebyshev roots on [0.5, 2], the upper end of the
spectrum; as polynomials of one operator the steps commute, so that the same order before and after
stays symmetric. Source: derived."""
_SMOOTHED = 2.0 / 3.0
"""Damping of the Jacobi step of interpolation: 4 / 3 over the upper end of the spectrum. Source:
derived."""
_MOST_FACTORISED = 3_000
"""Unknowns of the coarsest grid. Chosen on: speed."""


class _Grid:
    """One level: edge weights, and the operators on heights that are zero outside the surface."""

    def __init__(self, right: FloatArray, down: FloatArray) -> None:
        """Take the edge weights (H, W)."""
        self.right, self.down = right, down
        degree = right + down
        degree[:, 1:] += right[:, :-1]
        degree[1:] += down[:-1]
        self.inside = degree > 0
        self.inverse = np.where(self.inside, 1 / np.maximum(degree, 1e-30), 0).astype(np.float32)
        self.direct: _DirectSolver | None = None
        if np.count_nonzero(self.inside) <= _MOST_FACTORISED:
            self.direct = _DirectSolver(self)
            return
        self.even = [(0, side % 2) for side in right.shape]
        right, down = np.pad(right, self.even), np.pad(down, self.even)
        self.coarser = _Grid(
            0.5 * (right[::2, 1::2] + right[1::2, 1::2]), 0.5 * (down[1::2, ::2] + down[1::2, 1::2])
        )

    def apply(self, height: Floats) -> Floats:
        """Laplacian (positive semidefinite) of `height`, in the precision of `height`.

        Weights act on differences: a degree less weighted neighbours has a rounding error that
        grows with the height, and makes the operator indefinite once weights differ by a thousand.
        """
        step_right, step_down = _difference(height)
        step_right *= self.right
        step_down *= self.down
        return _difference_adjoint(step_right, step_down)

    def _smooth(self, height: FloatArray, right_side: FloatArray) -> None:
        """Damped Jacobi steps in place."""
        for step in _STEPS:
            height += step * self.inverse * (right_side - self.apply(height))

    def cycle(self, right_side: FloatArray) -> FloatArray:
        """One V-cycle from zero: an approximate solution of `apply`(height) = right_side."""
        if self.direct is not None:
            return self.direct(right_side)
        height = np.zeros_like(right_side)
        self._smooth(height, right_side)
        residual = right_side - self.apply(height)
        height += self.prolong(self.coarser.cycle(self.restrict(residual)))
        self._smooth(height, right_side)
        return height

    def precondition(self, residual: Array) -> Array:
        """The cycle in single precision, of and in double precision."""
        return self.cycle(residual.astype(np.float32)).astype(np.float64)

    def prolong(self, coarse: FloatArray) -> FloatArray:
        """Interpolate heights of the coarser grid to this one."""
        rows, columns = self.inside.shape
        blocks = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[:rows, :columns] * self.inside
        return blocks - _SMOOTHED * self.inverse * self.apply(blocks)

    def restrict(self, residual: FloatArray) -> FloatArray:
        """Adjoint of :meth:`prolong`."""
        smooth = residual - _SMOOTHED * self.apply(self.inverse * residual)
        smooth = np.pad(smooth * self.inside, self.even)
        pairs = smooth[::2] + smooth[1::2]
        return np.asarray(pairs[:, ::2] + pairs[:, 1::2])


class _DirectSolver:
    """Pseudo-inverse of one grid's Laplacian by sparse factorisation: every connected part keeps a
    zero mean."""

    def __init__(self, grid: _Grid) -> None:
        """Factorise."""
        from scipy.sparse.csgraph import connected_components  # slow to import
        from scipy.sparse.linalg import splu  # slow to import

        self.pixels = np.flatnonzero(grid.inside)
        count = self.pixels.size
        index = np.full(grid.inside.size, -1)
        index[self.pixels] = np.arange(count)
        starts = [np.flatnonzero(weight) for weight in (grid.right, grid.down)]
        first = index[np.concatenate(starts)]
        second = index[np.concatenate([starts[0] + 1, starts[1] + grid.inside.shape[1]])]
        weights = np.concatenate([grid.right.ravel()[starts[0]], grid.down.ravel()[starts[1]]])
        half = scipy.sparse.coo_array((weights.astype(np.float64), (first, second)), (count, count))
        graph = (half + half.T).tocsc()
        parts, self.part = connected_components(graph, directed=False)
        self.size = np.bincount(self.part, minlength=parts)
        degree = graph.sum(axis=0)
        ground = 1e-9 * degree.mean()  # fixes the free constant of every part
        matrix = scipy.sparse.diags_array(degree + ground) - graph
        self.factor = splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
        )

    def __call__(self, right_side: Floats) -> Floats:
        """Solve for one right side (H, W), in its precision."""
        height = np.zeros(right_side.size, dtype=right_side.dtype)
        balanced = self._balance(right_side.ravel()[self.pixels].astype(np.float64))
        height[self.pixels] = self._balance(self.factor.solve(balanced))
        return height.reshape(right_side.shape)

    def _balance(self, values: Array) -> Array:
        mean = np.bincount(self.part, weights=values, minlength=self.size.size) / self.size
        return values - mean[self.part]


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
    if weights is None and inside.all():
        ones = np.ones_like(slope_x)
        right, down = _predicted_differences(slope_x, slope_y, ones)
        return zero_mean(_solve_rectangle(_difference_adjoint(right, down)), inside)
    trust = _check_weights(inside if weights is None else weights, inside)
    window = bounding_box(inside)
    height = _solve_masked(slope_x[window], slope_y[window], trust[window])
    return _zero_mean_by_component(height, inside, window)


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
    return np.where(mask, np.maximum(trust, _WEIGHT_FLOOR), 0.0)


def _zero_mean_by_component(height: FloatArray, mask: BoolArray, window: Window) -> FloatArray:
    """Return `height` of a window with a zero mean over every 4-connected component of the mask (H,
    W), NaN outside it."""
    inside = mask[window].astype(np.uint8)
    count, labels = cv2.connectedComponents(inside, connectivity=4, ltype=cv2.CV_32S)
    size = np.bincount(labels.ravel(), minlength=count)
    total = np.bincount(labels.ravel(), weights=height.ravel(), minlength=count)
    mean = (total / np.maximum(size, 1)).astype(np.float32)
    result = np.full(mask.shape, np.nan, dtype=np.float32)
    np.copyto(result[window], height - mean[labels], where=mask[window])
    return result


def _solve_rectangle(right_side: FloatArray) -> FloatArray:
    """Laplacian with free borders, inverted in its eigenbasis, the cosines."""
    rows, columns = right_side.shape
    row_value = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)
    column_value = 2 - 2 * np.cos(np.pi * np.arange(columns) / columns)
    eigenvalues = (row_value[:, None] + column_value[None, :]).astype(np.float32)
    eigenvalues[0, 0] = 1.0
    spectrum = scipy.fft.dctn(right_side, type=2, workers=2)
    spectrum /= eigenvalues
    spectrum[0, 0] = 0.0
    return np.asarray(
        scipy.fft.idctn(spectrum, type=2, workers=2, overwrite_x=True), dtype=np.float32
    )


_MOST_DIRECT = 300_000
"""Up to so many unknowns, a system that does not converge (a large maze) is factorised. Chosen on:
speed."""
_MAX_ITERATIONS = 100
"""Iterations of conjugate gradients in a round at most; a finger needs five."""
_TOLERANCE = 1e-5
"""Stop when the estimated rms error of the solver falls below this part of the rms height."""
_ROUNDS = 3
"""Runs of conjugate gradients at most: each starts from the true residual, from which its own
drifts. Chosen on: speed."""


def _solve_masked(slope_x: FloatArray, slope_y: FloatArray, weights: FloatArray) -> FloatArray:
    """Height (H, W) for weights that are zero outside the mask.

    Double precision around a single-precision preconditioner: two halves of a surface that hang
    together by a few pixels shift against each other by the rounding of the residual, divided by a
    very small stiffness. For the same reason the preconditioned residual is divided by the smallest
    eigenvalue.
    """
    edges = _edge_weights(weights)
    targets = _predicted_differences(slope_x, slope_y, weights)
    height = np.zeros(weights.shape)
    if not any(edge.any() for edge in edges):  # no pixel has a neighbour
        return height.astype(np.float32)
    grid = _Grid(*edges)
    height = grid.precondition(_residual(height, edges, targets)[0])
    residual, excess = _residual(height, edges, targets)
    for _ in range(_ROUNDS):
        correction, eigenvalue = conjugate_gradients(
            grid.apply,
            grid.precondition,
            residual,
            most=_MAX_ITERATIONS,
            error=_TOLERANCE * rms(height),
            excess=excess,
        )
        height += correction
        residual, excess = _residual(height, edges, targets)
        estimate = grid.precondition(residual) / eigenvalue
        settled = rms(estimate) <= _TOLERANCE * rms(height)
        if settled and dot(residual, estimate) <= excess:
            break
        if np.count_nonzero(weights) <= _MOST_DIRECT:
            grid.direct = _DirectSolver(grid)
    else:
        _LOG.warning("the integration has not converged; heights may be off where it is steep.")
    return height.astype(np.float32)


def _residual(height: Array, weights: _Edges, targets: _Edges) -> tuple[Array, float]:
    """Half the negative gradient of the energy, the weighted sum of squared residuals of edges; and
    the tolerated excess of the energy over its minimum: a part of it, plus the rounding error of
    the targets, the predicted differences.

    Differences of neighbouring heights are exact in single precision, differences of their
    Laplacian are not.
    """
    energy, power = 0.0, 0.0
    flows = []
    for weight, target, step in zip(weights, targets, _difference(height), strict=True):
        left = target - step
        flows.append(weight * left)
        energy += dot(flows[-1], left)
        power += dot(weight, target**2)
    return _difference_adjoint(*flows), 1e-4 * energy + 1e-12 * power


_NOISE_RAD = 0.03
"""Assumed noise of a normal, a typical error of photometric stereo. Range: 0.01 to 0.03."""
_SCALES = 4.0 * 0.75 ** np.arange(15)
"""Scale of the robust weights in standard deviations, round after round, one at the least: a
minimum that is reached from wide scales cuts few edges. Range: 8 to 40 rounds."""


def piecewise(gradient_x: Any, gradient_y: Any, mask: Any = None) -> FloatArray:
    """Height of a surface with steps: one side of an edge does not pull the other.

    Least squares as :func:`poisson`, whose weights are 1 / (v + r^2) for a difference of heights
    with the residual r: a Cauchy density of the residuals, so that few large ones, the steps, carry
    little weight. The variance v is the noise of the two normals and the error of the trapezoidal
    rule, which is taken to be its difference from a second rule that is exact on spheres: where a
    pixel turns away at an outline, and at a crease, the difference counts less from the start. A
    part that is cut off all around keeps the height that its border suggests.

    Parameters
    ----------
    gradient_x, gradient_y, mask
        As of :func:`splitknit.integration.frankot_chellappa`. Under perspective: of -f log(depth),
        with the focal length f in pixels; the depth is then exp(-height / f), up to scale.

    Returns
    -------
    (H, W) float32
        As of :func:`poisson`.

    Raises
    ------
    BadInput
        If shapes differ, the mask is empty, or a gradient inside the mask is not finite.

    References
    ----------
    For the problem and the unit of perspective, X. Cao, H. Santo, B. Shi, F. Okura and Y.
    Matsushita, "Bilateral normal integration", ECCV 2022, whose weights are others; for the
    weights, P. J. Huber, "Robust statistics", Wiley 1981, section 7.8.

    Examples
    --------
    >>> import numpy as np
    >>> height = piecewise(np.full((40, 60), 0.5), np.full((40, 60), -0.25))
    >>> round(float(height[20, 40] - height[20, 20]), 3)
    10.0
    """
    slope_x, slope_y, inside = check_fields(gradient_x, gradient_y, mask)
    window = bounding_box(inside)
    slopes, mask_here = (slope_x[window], slope_y[window]), inside[window].astype(np.float32)
    edges, targets = _edge_weights(mask_here), _predicted_differences(*slopes, mask_here)
    facing = mask_here / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)  # z of the normals
    noise = _NOISE_RAD**2 / np.maximum(facing, 1e-3) ** 4  # of a slope: the normal's over n_z^4
    # differences of heights of chords at right angles to the mean of two normals: exact on spheres
    chords = _on_edges(slopes[0], -slopes[1], facing)
    variances = [
        np.maximum(of_mean / 2, _NOISE_RAD**2 / 2) + (target - chord) ** 2
        for of_mean, target, chord in zip(
            _on_edges(noise, noise, np.ones_like(noise)), targets, chords, strict=True
        )
    ]
    height = np.zeros(mask_here.shape)
    residuals = targets
    for turn, scale in enumerate(np.maximum(_SCALES, 1.0)):
        weights = [
            edge * np.float32(_NOISE_RAD**2) / (variance + (turn > 0) * (residual / scale) ** 2)
            for edge, variance, residual in zip(edges, variances, residuals, strict=True)
        ]
        height += _correction(height, (weights[0], weights[1]), targets)
        steps = _difference(height)
        residuals = (targets[0] - steps[0], targets[1] - steps[1])
    return _zero_mean_by_component(height.astype(np.float32), inside, window)


def _correction(height: Array, weights: _Edges, targets: _Edges) -> Array:
    """Change of the heights by one round of weights, solved to a thousandth of their rms."""
    if not any(weight.any() for weight in weights):  # no pixel has a neighbour
        return np.zeros_like(height)
    grid = _Grid(
        *(
            np.maximum(weight, np.float32(1e-7) * (weight > 0)).astype(np.float32)
            for weight in weights
        )
    )
    residual, _ = _residual(height, (grid.right, grid.down), targets)
    correction, _ = conjugate_gradients(
        grid.apply,
        grid.precondition,
        residual,
        most=_MAX_ITERATIONS,
        error=1e-3 * max(rms(height), 1.0),
        excess=np.inf,
    )
    return correction
