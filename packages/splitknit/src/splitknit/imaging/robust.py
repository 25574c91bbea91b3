"""Robust scale and weights of residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Array


def deviation(residual: NDArray[Any]) -> float:
    """Standard deviation of a normal distribution with this median absolute value."""
    return 1.4826 * float(np.median(np.abs(residual)))


def huber(residual: NDArray[Any], limit: float) -> NDArray[Any]:
    """Huber's weights: one up to `limit` (usual: 1.345 to 1.5 deviations), then falling as one over
    the residual's size."""
    return np.asarray(1.0 / np.maximum(1.0, np.abs(residual) / limit))


def cauchy(residual: NDArray[Any], limit: float) -> NDArray[Any]:
    """Cauchy's weights: one at zero, a half at `limit` (usual: 2.385 deviations)."""
    return 1.0 / (1.0 + np.square(residual / limit))


def tukey(residual: Array, limit: float) -> Array:
    """Tukey's biweight: one at zero, zero from `limit` on (usual: 4.685 deviations)."""
    return np.maximum(1.0 - (residual / limit) ** 2, 0.0) ** 2


def robust_line(x: Array, y: Array, floor: float) -> tuple[float, float]:
    """Slope and offset of the straight line through points (n,), by Tukey's biweight; the deviation
    of the points is at least `floor`.

    >>> import numpy as np
    >>> x = np.arange(9.0)
    >>> slope, offset = robust_line(x, np.where(x == 7, 90.0, 2 * x + 1), 0.1)
    >>> round(slope, 6), round(offset, 6)
    (2.0, 1.0)
    """
    weight = np.ones_like(y)
    for _ in range(12):
        slope, offset = np.polyfit(x, y, 1, w=np.sqrt(weight))
        residual = y - slope * x - offset
        weight = tukey(residual, 4.685 * max(deviation(residual), floor))
    return float(slope), float(offset)
