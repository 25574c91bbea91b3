"""Least-squares integration over any mask: the height whose differences are nearest to the integrated gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.integration.edges import difference, difference_adjoint, edge_weights, predicted_differences
from splitknit.integration.gradient_field import check_gradients, zero_mean, zero_mean_by_component
from splitknit.integration.multigrid import Grid, build_grids, padded_size
from splitknit.integration.spectral import WORKERS
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

_TOLERANCE = 1e-5
"""Stop when the estimated rms error of the solver falls below this part of the rms height."""
_WEIGHT_FLOOR = 1e-3
"""Smaller weights are raised to this, so that a hole in the data is bridged smoothly and not cut out."""


@dataclass(frozen=True, slots=True)
class PoissonSettings(Checked):
    """Accuracy and limits of the masked solver."""

    max_iterations: Annotated[int, Limits(0, above=True)] = 300
    """Conjugate-gradient iterations at most; a finger needs three to five, a maze a few dozen."""
    quadrature: Literal["trapezoidal", "cubic"] = "trapezoidal"
    """Integral between neighbours: ``trapezoidal`` or ``cubic`` (exact for slopes up to a cubic)."""


def poisson(
    gradient_x: Any,
    gradient_y: Any,
    mask: Any = None,
    weights: Any = None,
    settings: PoissonSettings | None = None,
) -> FloatArray:
    """Height whose neighbour differences are nearest, in the (weighted) least-squares sense, to the gradients.

    Only differences between pixels of the mask count, so that the surface may end steeply, be cut by the image border,
    have holes, or fall into several parts. A whole rectangle without weights is solved directly by cosine transforms;
    everything else by conjugate gradients with a multigrid preconditioner.

    Parameters
    ----------
    gradient_x, gradient_y : (H, W)
        dz/dx and dz/dy, y up, dimensionless. Values outside the mask are ignored.
    mask : (H, W) bool, optional
        The surface; everything by default.
    weights : (H, W), optional
        Trust in each pixel's gradient, in [0, 1].
    settings : PoissonSettings, optional

    Returns
    -------
    (H, W) float32
        Height in pixels, NaN outside the mask. The mean is zero over every 4-connected part of the mask: gradients say
        nothing about the height of one part over another.

    Raises
    ------
    BadInput
        If shapes differ, the mask is empty, or a gradient or weight inside the mask is not finite or out of range.

    References
    ----------
    B. K. P. Horn and M. J. Brooks, "The variational approach to shape from shading", CVGIP 33 (1986); Y. Queau,
    J.-D. Durou and J.-F. Aujol, "Normal integration: a survey", JMIV 60 (2018), section 3; the thesis, (3.35) to
    (3.39).

    Examples
    --------
    >>> import numpy as np
    >>> from splitknit.integration import poisson
    >>> rows, columns = np.mgrid[0:40, 0:60]
    >>> inside = np.hypot(rows - 20, columns - 30) < 18
    >>> height = poisson(np.full((40, 60), 0.5), np.full((40, 60), -0.25), inside)
    >>> round(float(height[20, 40] - height[20, 20]), 3), round(float(height[10, 30] - height[30, 30]), 3)
    (10.0, -5.0)
    """
    chosen = settings if settings is not None else PoissonSettings()
    slope_x, slope_y, inside = check_gradients(gradient_x, gradient_y, mask)
    trust = None if weights is None else _check_weights(weights, inside)
    if trust is None and bool(inside.all()):
        right, down = predicted_differences(slope_x, slope_y, inside, None, chosen.quadrature)
        return zero_mean(_solve_rectangle(difference_adjoint(right, down)), inside)
    window = _bounding_box(inside)
    height = _solve_masked(
        slope_x[window], slope_y[window], inside[window], None if trust is None else trust[window], chosen
    )
    result = np.full(inside.shape, np.nan, dtype=np.float32)
    result[window] = zero_mean_by_component(height, np.ascontiguousarray(inside[window]))
    return result


def _check_weights(weights: Any, mask: BoolArray) -> FloatArray:
    array = np.asarray(weights)
    require(array.shape == mask.shape, f"weights must have the shape {mask.shape}, but it has {array.shape}.")
    trust = np.where(mask, array, 0.0).astype(np.float32)
    require(
        bool(np.isfinite(trust).all()) and float(trust.min()) >= 0 and float(trust.max()) <= 1,
        "weights must lie between 0 and 1 inside the mask.",
    )
    return np.maximum(trust, np.float32(_WEIGHT_FLOOR))


def _bounding_box(mask: BoolArray) -> tuple[slice, slice]:
    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    return slice(top, top + height), slice(left, left + width)


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
    return np.asarray(scipy.fft.idctn(spectrum, type=2, workers=WORKERS, overwrite_x=True), dtype=np.float32)


def _solve_masked(
    slope_x: FloatArray, slope_y: FloatArray, mask: BoolArray, weights: FloatArray | None, settings: PoissonSettings
) -> FloatArray:
    rows, columns = mask.shape
    size = padded_size(rows, columns)
    frame = ((0, size[0] - rows), (0, size[1] - columns))
    inside = np.pad(mask, frame)
    trust = None if weights is None else np.pad(weights, frame)
    weight_right, weight_down = edge_weights(inside, trust)
    target_right, target_down = predicted_differences(
        np.pad(slope_x, frame), np.pad(slope_y, frame), inside, trust, settings.quadrature
    )
    grid = build_grids(weight_right, weight_down, unit=weights is None)
    height = grid.solve_nested(difference_adjoint(weight_right * target_right, weight_down * target_down))
    # The residual of edges, not of heights: differences of neighbouring heights are exact in single precision.
    step_right, step_down = difference(height)
    residual = difference_adjoint(
        (weight_right * (target_right - step_right)).astype(np.float64),
        (weight_down * (target_down - step_down)).astype(np.float64),
    )
    del target_right, target_down, step_right, step_down
    height += _conjugate_gradients(grid, residual, _rms(height), settings)
    return height[:rows, :columns]


def _conjugate_gradients(
    grid: Grid, residual: NDArray[np.float64], scale: float, settings: PoissonSettings
) -> FloatArray:
    """Solve for the correction until the estimated rms error is small.

    Double precision around a single-precision preconditioner: two halves of a surface that hang together by a few
    pixels shift against each other by the rounding of the residual, divided by a very small stiffness. For the same
    reason the preconditioned residual is divided by the smallest eigenvalue that the iteration has met (Lanczos).
    """
    correction = np.zeros(residual.shape, dtype=np.float32)
    direction = np.zeros_like(residual)
    lengths: list[float] = []
    ratios: list[float] = []
    energy = 1.0
    for _ in range(settings.max_iterations):
        estimate = grid.cycle(residual.astype(np.float32))
        previous, energy = energy, _dot(residual, estimate)
        if energy <= 0:
            break
        ratios.append(energy / previous)
        if lengths and _rms(estimate) <= _TOLERANCE * scale * _smallest_eigenvalue(lengths, ratios):
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
    return correction


def _smallest_eigenvalue(lengths: list[float], ratios: list[float]) -> float:
    """Smallest Ritz value of the preconditioned operator, from the coefficients of conjugate gradients so far.

    The tridiagonal Lanczos matrix has 1 / a_k + b_k / a_(k-1) on its diagonal and sqrt(b_k) / a_(k-1) beside it (Y.
    Saad, "Iterative methods for sparse linear systems", 2nd edition, eq. 6.82).
    """
    step, ratio = np.array(lengths), np.array(ratios[1 : len(lengths)])
    diagonal = 1 / step
    diagonal[1:] += ratio / step[:-1]
    return float(scipy.linalg.eigvalsh_tridiagonal(diagonal, np.sqrt(ratio) / step[:-1])[0])


def _dot(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Inner product whose bytes do not depend on threads: along the rows, then their sum in double precision."""
    return float(np.sum(np.einsum("ij,ij->i", a, b), dtype=np.float64))


def _rms(a: NDArray[Any]) -> float:
    return float(np.sqrt(_dot(a, a) / a.size))
