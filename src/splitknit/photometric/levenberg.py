"""Levenberg and Marquardt's method for many small problems at once: every pixel has its own damping and its own end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from splitknit.settings import Checked, Limits

Array = NDArray[Any]


_DAMPING = 1e-3
"""At the start, relative to the diagonal of the normal equations."""


@dataclass(frozen=True, slots=True)
class LevenbergSettings(Checked):
    """When a pixel's fit ends, and how it is damped."""

    _group = "fit"
    iterations: Annotated[int, Limits(1, 1000)] = 30
    """At most, of which rejected steps are some."""
    step: Annotated[float, Limits(0, 1, above=True, below=True)] = 1e-3
    """A pixel has converged when all its parameters move by less than this; directions then turn by 0.1 deg at most."""
    gain: Annotated[float, Limits(0, 1, above=True, below=True)] = 1e-5
    """It has also when its cost falls by less than this part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Cost (n,), gradient J^T r (P, n) and J^T J (P (P + 1) / 2, n), its upper triangle row by row."""

    cost: Array
    gradient: Array
    moments: Array


class Problem(Protocol):
    """n least-squares problems of P parameters each."""

    def equations(self, parameters: Array) -> NormalEquations:
        """Cost and normal equations at `parameters` (P, n)."""

    def moved(self, parameters: Array, step: Array) -> Array:
        """Parameters after `step`, shortened so that they stay where the model is defined."""

    def take(self, kept: Array) -> Self:
        """The problems of some indices."""


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the fits ended."""

    parameters: Array
    cost: Array
    iterations: Array
    converged: Array


_STEEPER, _FLATTER = 8.0, 0.15
_LEAST, _MOST = 1e-7, 1e7


def levenberg_marquardt(problem: Problem, start: Array, settings: LevenbergSettings) -> Minimum:
    """Minimise every problem from `start` (P, n).

    All arithmetic is elementwise over n: a problem's result depends on nothing but itself.

    References
    ----------
    D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", SIAM J. Appl. Math. 11 (1963);
    the damping scales the diagonal, as he has it.
    """
    best, pixels = start.copy(), np.arange(start.shape[1])
    count = np.full(start.shape[1], settings.iterations, dtype=np.int16)
    done = np.zeros(start.shape[1], dtype=np.bool_)
    here = start.copy()
    known = problem.equations(here)
    cost = known.cost.copy()
    damping = np.full(pixels.size, _DAMPING, dtype=start.dtype)
    for turn in range(1, settings.iterations + 1):
        trial = problem.moved(here, -solved(known.moments, known.gradient, damping))
        new = problem.equations(trial)
        better = new.cost < known.cost
        moved = np.abs(trial - here).max(axis=0)
        fallen = known.cost - new.cost
        ended = (moved < settings.step) | (better & (fallen < settings.gain * known.cost)) | (damping >= _MOST)
        here = np.where(better, trial, here)
        known = NormalEquations(
            np.where(better, new.cost, known.cost),
            np.where(better, new.gradient, known.gradient),
            np.where(better, new.moments, known.moments),
        )
        factor = np.where(better, np.asarray(_FLATTER, start.dtype), np.asarray(_STEEPER, start.dtype))
        damping = np.clip(damping * factor, _LEAST, _MOST)
        if ended.any():
            over = pixels[ended]
            best[:, over], cost[over], count[over], done[over] = here[:, ended], known.cost[ended], turn, True
            on = np.flatnonzero(~ended)
            if not on.size:
                break
            pixels, here, damping, problem = pixels[on], here[:, on], damping[on], problem.take(on)
            known = NormalEquations(known.cost[on], known.gradient[:, on], known.moments[:, on])
    else:
        best[:, pixels], cost[pixels] = here, known.cost
    return Minimum(best, cost, count, done)


def solved(moments: Array, gradient: Array, damping: Array) -> Array:
    """(M + damping diag M)^-1 g for every column, by elimination without pivoting (M is positive definite)."""
    size = gradient.shape[0]
    matrix: dict[tuple[int, int], Array] = {}
    index = 0
    for i in range(size):
        for j in range(i, size):
            matrix[i, j] = moments[index] * (1.0 + damping) + 1e-20 if i == j else moments[index]
            index += 1
    right = list(gradient)
    inverse: list[Array] = []
    for i in range(size):
        # rounding must not make a pivot vanish or turn it round
        least = matrix[i, i] if i == 0 else np.maximum(matrix[i, i], 1e-6 * moments[_diagonal(i, size)] + 1e-20)
        inverse.append(1.0 / least)
        for j in range(i + 1, size):
            factor = matrix[i, j] * inverse[i]
            for k in range(j, size):
                matrix[j, k] = matrix[j, k] - factor * matrix[i, k]
            right[j] = right[j] - factor * right[i]
    result = np.empty_like(gradient)
    for i in reversed(range(size)):
        total = right[i]
        for j in range(i + 1, size):
            total = total - matrix[i, j] * result[j]
        np.multiply(total, inverse[i], out=result[i])
    return result


def _diagonal(i: int, size: int) -> int:
    """Where (i, i) stands in the upper triangle."""
    return i * size - i * (i - 1) // 2
