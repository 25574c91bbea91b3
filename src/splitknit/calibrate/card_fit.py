"""Robust least squares for the model of a white card: Levenberg and Marquardt's steps, Cauchy's weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.calibrate.card_model import Answer, CardModel, Order

Array = NDArray[np.float64]
_STEPS, _STAGES = 40, 8


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
    scale : residual (relative) beyond which a cell counts less and less
    """
    low, high = model.bounds(order)
    vector = np.clip(model.vector(start, order), low, high)
    width = np.inf
    for _ in range(_STAGES):  # wide first, so that what is not fitted yet does not pass for dust
        residual = np.abs(model.logarithm(model.answer(vector, order)) - logarithm)
        wanted = max(scale, 3.0 * 1.4826 * float(np.median(residual)))
        last, width = width, min(width, wanted)
        if width > 0.99 * last:
            break
        vector = _descend(model, vector, order, logarithm, width)
    normal, _ = _equations(model, vector, order, logarithm, scale)
    return CardFit(order, model.answer(vector, order), normal + np.diag(model.prior(order)[1] ** 2))


def _descend(model: CardModel, vector: Array, order: Order, logarithm: Array, scale: float) -> Array:
    """Lower Cauchy's cost of the given scale as far as it goes."""
    low, high = model.bounds(order)
    middle, inverse = model.prior(order)

    def cost(values: Array) -> float:
        fitted = (model.logarithm(model.answer(values, order)) - logarithm) / scale
        return float(np.log1p(fitted * fitted).sum() + (((values - middle) * inverse) ** 2).sum())

    damping, least = 1e-4, cost(vector)
    for _ in range(_STEPS):
        normal, slope = _equations(model, vector, order, logarithm, scale)
        normal += np.diag(inverse**2)
        slope += (vector - middle) * inverse**2
        for _ in range(12):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -slope)
            moved = np.clip(vector + step, low, high)
            value = cost(moved)
            if value <= least:
                break
            damping *= 8.0
        else:
            break
        gain, vector, least, damping = least - value, moved, value, max(damping / 8.0, 1e-12)
        if gain < 1e-7 * least + 1e-9:
            break
    return vector


def _equations(model: CardModel, vector: Array, order: Order, logarithm: Array, scale: float) -> tuple[Array, Array]:
    """Weighted normal matrix (P, P) and gradient (P,) at `vector`."""
    answer = model.answer(vector, order)
    residual = (model.logarithm(answer) - logarithm) / scale
    weight = 1.0 / (1.0 + residual * residual)
    normal, slope = np.zeros((len(vector), len(vector))), np.zeros(len(vector))
    for k in range(model.count):
        places, rows = model.slopes(answer, order, k)
        weighted = rows * (weight[k] / scale)
        normal[np.ix_(places, places)] += weighted @ rows.T / scale
        slope[places] += weighted @ residual[k]
    return normal, slope
