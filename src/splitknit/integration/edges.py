"""Differences between neighbouring pixels, their adjoint, and the difference that a gradient field predicts.

Edges are stored at their upper or left pixel in arrays (H, W): `right[i, j]` joins (i, j) and (i, j + 1), `down[i, j]`
joins (i, j) and (i + 1, j). The last column of `right` and the last row of `down` are zero.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, FloatArray

Floats = TypeVar("Floats", NDArray[np.float32], NDArray[np.float64])


def difference(height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height of the right neighbour, and of the lower neighbour, less the pixel's own."""
    right, down = np.zeros_like(height), np.zeros_like(height)
    np.subtract(height[:, 1:], height[:, :-1], out=right[:, :-1])
    np.subtract(height[1:], height[:-1], out=down[:-1])
    return right, down


def difference_adjoint(right: Floats, down: Floats) -> Floats:
    """Adjoint of :func:`difference`: what flows into a pixel less what flows out of it."""
    result = -right - down
    result[:, 1:] += right[:, :-1]
    result[1:] += down[:-1]
    return result


def edge_weights(mask: BoolArray, weights: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Mean weight of an edge's two pixels, zero unless both lie in the mask."""
    own = mask.astype(np.float32) if weights is None else np.where(mask, weights, np.float32(0.0))
    right, down = np.zeros_like(own), np.zeros_like(own)
    both_right, both_down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    right[:, :-1] = np.float32(0.5) * (own[:, 1:] + own[:, :-1]) * both_right
    down[:-1] = np.float32(0.5) * (own[1:] + own[:-1]) * both_down
    return right, down


def predicted_differences(
    slope_x: FloatArray, slope_y: FloatArray, mask: BoolArray, weights: FloatArray | None, quadrature: str
) -> tuple[FloatArray, FloatArray]:
    """Integral of the slopes (y up) along every edge; what lies outside the mask is never used.

    ``trapezoidal`` is the mean of the two pixels' slopes, weighted where there are weights. ``cubic`` integrates the
    parabola-exact rule (-1, 13, 13, -1) / 24 where an edge has two more pixels of the surface in line, and falls back
    to the mean elsewhere and wherever there are weights.
    """
    right, down = np.zeros_like(slope_x), np.zeros_like(slope_x)
    cubic = quadrature == "cubic" and weights is None
    right[:, :-1] = _edge_integral(slope_x.T, mask.T, None if weights is None else weights.T, cubic).T
    down[:-1] = -_edge_integral(slope_y, mask, weights, cubic)
    return right, down


def _edge_integral(slope: FloatArray, mask: BoolArray, weights: FloatArray | None, cubic: bool) -> FloatArray:
    """Integral between successive rows, (H - 1, W)."""
    if weights is not None:
        weighted = slope * weights
        total = np.maximum(weights[1:] + weights[:-1], np.float32(1e-12))
        return np.asarray((weighted[1:] + weighted[:-1]) / total)
    mean = np.float32(0.5) * (slope[1:] + slope[:-1])
    if cubic and slope.shape[0] > 3:
        # (13 (b + c) - (a + d)) / 24 = (b + c) / 2 + (b + c - a - d) / 24
        inner = mean[1:-1] - np.float32(0.5) * (slope[3:] + slope[:-3])
        inner *= mask[3:] & mask[:-3]
        inner *= np.float32(1.0 / 12.0)
        mean[1:-1] += inner
    return mean
