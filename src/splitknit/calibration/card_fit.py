"""Robust least squares for the model of a white card: Levenberg and Marquardt's steps, weights of the card's places.

Dust lies on the card: it darkens a place under every LED. What departs under one LED alone is no dust but that LED, and
must be fitted, or show in its residuals. So a place is trusted by the median of its residuals over all LEDs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.card_model import Answer, CardModel, Order

Array = NDArray[np.float64]
_STEPS, _STAGES = 30, 10


@dataclass(frozen=True, slots=True, eq=False)
class CardFit:
    """Best parameters of one order."""

    order: Order
    answer: Answer
    normal: Array
    """(P, P) weighted normal matrix, in units of the robust scale."""


def fit_order(model: CardModel, start: Answer, order: Order, logarithm: Array, scale: float) -> CardFit:
    """Fit `order` to ln of the images.

    Parameters
    ----------
    model : CardModel
    start : first guess
    order : which parameters are free
    logarithm : (L, N) ln of the images
    scale : residual (relative, common to all LEDs) beyond which a place counts less and less (Cauchy's weights)
    """
    vector = model.project(model.vector(start, order), order)
    weight = np.ones(logarithm.shape[1])
    for _ in range(_STAGES):
        problem = _Problem(model, order, logarithm, weight, scale)
        vector = _descend(problem, vector)
        common = np.median(logarithm - model.logarithm(model.answer(vector, order)), axis=0)
        width = max(scale, 3.0 * 1.4826 * float(np.median(np.abs(common))))
        last, weight = weight, 1.0 / (1.0 + (common / width) ** 2)
        if float(np.abs(weight - last).max()) < 0.01:
            break
    return CardFit(order, model.answer(vector, order), problem.equations(vector)[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Weighted least squares with the model's priors."""

    model: CardModel
    order: Order
    logarithm: Array
    weight: Array
    """(N,)."""
    scale: float

    def cost(self, vector: Array) -> float:
        middle, inverse = self.model.prior(self.order)
        residual = (self.model.logarithm(self.model.answer(vector, self.order)) - self.logarithm) / self.scale
        return float((residual * residual @ self.weight).sum() + (((vector - middle) * inverse) ** 2).sum())

    def equations(self, vector: Array) -> tuple[Array, Array]:
        """Normal matrix (P, P) and gradient (P,)."""
        model, order = self.model, self.order
        answer = model.answer(vector, order)
        residual = (model.logarithm(answer) - self.logarithm) / self.scale
        middle, inverse = model.prior(order)
        normal, slope = np.diag(inverse**2), (vector - middle) * inverse**2
        for k in range(model.count):
            places, rows = model.slopes(answer, order, k)
            weighted = rows * (self.weight / self.scale)
            normal[np.ix_(places, places)] += weighted @ rows.T / self.scale
            slope[places] += weighted @ residual[k]
        return normal, slope


def _descend(problem: _Problem, vector: Array) -> Array:
    """Lower the cost as far as it goes."""
    damping, least = 1e-4, problem.cost(vector)
    for _ in range(_STEPS):
        normal, slope = problem.equations(vector)
        for _ in range(12):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -slope)
            moved = problem.model.project(vector + step, problem.order)
            value = problem.cost(moved)
            if value <= least:
                break
            damping *= 8.0
        else:
            break
        gain, vector, least, damping = least - value, moved, value, max(damping / 8.0, 1e-12)
        if gain < 1e-7 * least + 1e-9:
            break
    return vector
