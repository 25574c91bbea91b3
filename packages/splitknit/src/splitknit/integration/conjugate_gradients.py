"""Preconditioned conjugate gradients on images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Array

Image = NDArray[Any]


def conjugate_gradients(
    apply: Callable[[Image], Image],
    precondition: Callable[[Image], Image],
    right_side: Image,
    *,
    most: int,
    error: float = 0.0,
    excess: float = 0.0,
) -> tuple[Image, float]:
    """Solve `apply`(x) = `right_side`, from zero.

    `apply` and `precondition`: symmetric, positive semidefinite. Stops after `most` iterations, or
    when x is known to an rms `error` and its energy exceeds the minimum by `excess` at most. The
    energy exceeds it by r^T A^-1 r, with the residual r. That is at most r^T M r over the smallest
    eigenvalue of M A, with the preconditioner M, of those that the iterations have met (Lanczos).
    Returns x, in the precision of `right_side`, and this eigenvalue.

    References
    ----------
    Y. Saad, "Iterative methods for sparse linear systems", 2nd edition, algorithm 9.1.
    """
    residual = right_side.copy()
    solution = np.zeros_like(residual)
    direction = np.zeros_like(residual)
    lengths: list[float] = []
    ratios: list[float] = []
    energy, eigenvalue = 1.0, 1.0
    for _ in range(most):
        estimate = precondition(residual)
        previous, energy = energy, dot(residual, estimate)
        if energy <= 0:
            break
        ratios.append(energy / previous)
        if lengths and error > 0:
            eigenvalue = _smallest_eigenvalue(lengths, ratios)
            if rms(estimate) <= error * eigenvalue and energy <= excess * eigenvalue:
                solution += estimate
                break
        direction *= ratios[-1]
        direction += estimate
        image = apply(direction)
        curvature = dot(direction, image)
        if curvature <= 0:
            break
        lengths.append(energy / curvature)
        image *= lengths[-1]
        residual -= image
        solution += np.multiply(direction, lengths[-1], out=image)
    return solution, eigenvalue


def dot(a: Image, b: Image) -> float:
    """Inner product in double precision."""
    return float(np.sum(a * b, dtype=np.float64))


def rms(a: Image) -> float:
    """Root mean square."""
    return float(np.sqrt(dot(a, a) / a.size))


def _smallest_eigenvalue(lengths: list[float], ratios: list[float]) -> float:
    """Smallest Ritz value of the preconditioned operator.

    The tridiagonal Lanczos matrix has 1 / a_k + b_k / a_(k-1) on its diagonal and sqrt(b_k) /
    a_(k-1) beside it (Saad, eq. 6.82).
    """
    step, ratio = np.array(lengths), np.array(ratios[1 : len(lengths)])
    diagonal: Array = 1 / step
    diagonal[1:] += ratio / step[:-1]
    beside = np.sqrt(ratio) / step[:-1]
    # it reads the lower triangle
    return float(np.linalg.eigvalsh(np.diag(diagonal) + np.diag(beside, -1))[0])
