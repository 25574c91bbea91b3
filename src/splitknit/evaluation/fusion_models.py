"""How the scores of several systems become one: a weighted sum of normalised scores, and a logistic regression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

Table = NDArray[np.float64]
NORMALISATIONS = ("z", "minmax")


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """Weighted mean of normalised scores."""

    offset: Table
    """(S,) subtracted from each system's scores."""
    scale: Table
    """(S,) then divided by."""
    weight: Table
    """(S,) not negative, sum 1."""

    def __call__(self, scores: Table) -> Table:
        """(N,) from scores (N, S); a missing score's weight goes to the others, NaN where all are missing."""
        known = ~np.isnan(scores)
        normal = np.where(known, (scores - self.offset) / self.scale, 0.0)
        there = known @ self.weight
        return np.asarray(np.where(there > 0, normal @ self.weight / np.where(there > 0, there, 1.0), np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class LogisticModel:
    """Log-odds that a pair is genuine, where both kinds are equally likely beforehand."""

    offset: Table
    """(S,) mean of each system's scores."""
    scale: Table
    """(S,) and their standard deviation."""
    weight: Table
    """(S,) of the standardised scores."""
    missing: Table
    """(S,) added where a system's score is missing."""
    intercept: float

    def __call__(self, scores: Table) -> Table:
        """(N,) from scores (N, S); NaN where all are missing."""
        known = ~np.isnan(scores)
        odds = _design(scores, self.offset, self.scale) @ np.concatenate([self.weight, self.missing, [self.intercept]])
        return np.asarray(np.where(known.any(axis=1), odds, np.nan))


def fit_linear(scores: Table, weights: Table | None = None, normalisation: str = "z") -> LinearModel:
    """Normalise by what is known of a training part.

    Parameters
    ----------
    scores : (N, S) float64
        Of S systems, NaN where there is none.
    weights : (S,), optional
        Equal without; only their ratio matters.
    normalisation : ``z`` or ``minmax``
        z: mean 0 and standard deviation 1 of the training part; minmax: its least score 0, its largest 1.

    Raises
    ------
    BadInput
        If a system's scores do not vary, or weights are negative or of another number.

    References
    ----------
    A. Ross and A. Jain, "Information fusion in biometrics", Pattern Recognition Letters 24, 2003 (sum rule); R. Snelick
    et al., "Large-scale evaluation of multimodal biometric authentication using state-of-the-art systems", IEEE TPAMI
    27, 2005 (min-max and z-score).
    """
    require(normalisation in NORMALISATIONS, f"scores are normalised by 'z' or 'minmax', not by '{normalisation}'.")
    systems = scores.shape[1]
    weight = np.ones(systems) if weights is None else np.asarray(weights, dtype=np.float64)
    fits = weight.shape == (systems,) and bool(np.isfinite(weight).all()) and bool((weight >= 0).all())
    require(fits and weight.sum() > 0, f"{systems} systems need as many weights, none negative and not all zero.")
    offset, scale = _spread(scores)
    if normalisation == "minmax":
        offset = np.nanmin(scores, axis=0)
        scale = np.nanmax(scores, axis=0) - offset
    return LinearModel(offset, scale, weight / weight.sum())


def fit_logistic(scores: Table, genuine: NDArray[np.bool_], penalty: float = 1e-3) -> LogisticModel:
    """Fit a logistic regression of the label on standardised scores, by Newton's method.

    Both classes weigh the same, however many comparisons they have. A missing score counts as the mean, and that it
    is missing is a feature of its own.

    Parameters
    ----------
    scores : (N, S) float64
        Of S systems, NaN where there is none.
    genuine : (N,) bool
    penalty : float
        On half the sum of the squared weights (not on the intercept), where the mean loss of both classes is 1.

    Raises
    ------
    BadInput
        If a class has no score, or a system's scores do not vary.

    References
    ----------
    A. Ross, K. Nandakumar and A. Jain, "Handbook of Multibiometrics", Springer 2006, chapter 4 (classifier-based
    fusion); C. Bishop, "Pattern Recognition and Machine Learning", 2006, (4.92) to (4.100) (Newton steps).
    """
    require(penalty > 0, f"the penalty must be positive, but it is {penalty}.")
    offset, scale = _spread(scores)
    usable = ~np.isnan(scores).all(axis=1)
    label = genuine[usable]
    require(bool(label.any()) and not bool(label.all()), "a fusion learns from genuine and impostor scores of both.")
    x = _design(scores[usable], offset, scale)
    y = np.where(label, 1.0, -1.0)
    share = np.where(label, 0.5 / label.sum(), 0.5 / (~label).sum())
    hold = np.append(np.full(x.shape[1] - 1, penalty), 0.0)
    answer = _newton(x, y, share, hold)
    systems = scores.shape[1]
    return LogisticModel(offset, scale, answer[:systems], answer[systems : 2 * systems], float(answer[-1]))


def _newton(x: Table, y: Table, share: Table, hold: Table) -> Table:
    """Weights that make the penalised logistic loss least; steps are halved until it falls."""
    answer = np.zeros(x.shape[1])

    def loss(w: Table) -> float:
        return float(share @ np.logaddexp(0.0, -y * (x @ w)) + 0.5 * hold @ w**2)

    least = loss(answer)
    for _ in range(200):
        rate = 0.5 * (1.0 - np.tanh(0.5 * y * (x @ answer)))  # of the wrong class
        slope = -x.T @ (share * y * rate) + hold * answer
        bend = (x * (share * rate * (1 - rate))[:, None]).T @ x + np.diag(hold + 1e-12)
        step = np.linalg.solve(bend, slope)
        factor = 1.0
        while factor > 1e-8 and loss(answer - factor * step) > least - 1e-4 * factor * float(slope @ step):
            factor /= 2
        if factor <= 1e-8 or float(np.abs(step).max()) < 1e-9:
            break
        answer = answer - factor * step
        least = loss(answer)
    return answer


def _spread(scores: Table) -> tuple[Table, Table]:
    """Mean and standard deviation of each system's scores (S,)."""
    require(scores.ndim == 2, f"scores must have the shape (N, S), but they have {scores.shape}.")
    known = ~np.isnan(scores)
    number = known.sum(axis=0)
    filled = np.where(known, scores, 0.0)
    mean = filled.sum(axis=0) / np.maximum(number, 1)
    spread = np.sqrt(np.where(known, (filled - mean) ** 2, 0.0).sum(axis=0) / np.maximum(number, 1))
    flat = spread <= 1e-12 * np.maximum(1.0, np.abs(mean))
    require(
        not bool(flat.any()),
        f"the scores of system {int(np.argmax(flat)) + 1} of {scores.shape[1]} do not vary in the part to learn from; "
        "leave it out of the fusion.",
    )
    return mean, spread


def _design(scores: Table, offset: Table, scale: Table) -> Table:
    """(N, 2 S + 1): standardised scores, which are missing, and ones."""
    known = ~np.isnan(scores)
    normal = np.where(known, (scores - offset) / scale, 0.0)
    return np.hstack([normal, ~known, np.ones((len(scores), 1))])
