"""Fusion of the scores of several systems, cross-validated so that nobody is trained on who is
tested on.

Subjects (where they are not named: fingers) are dealt to folds. A comparison of somebody of fold i
with somebody of fold j is scored by a model that saw comparisons among the other folds only. There
is so one model for each pair of folds, and a comparison of two people is never scored by a model
that knew one of them.

A model is fitted to scores (N, S) of S systems, NaN where there is none, and labels (N,), and is a
function from scores to fused scores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from splitknit import BadInput
from splitknit.errors import require
from splitknit.model import BoolArray
from splitknit_match.evaluation.protocol import pair_up
from splitknit_match.evaluation.rates import Values
from splitknit_match.evaluation.scores import Scores

Labels = BoolArray
Model = Callable[[Values], Values]


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """Fused scores, and how they came about."""

    scores: Scores  # in the order of the first system; NaN where no system gave a score
    systems: tuple[str, ...]
    by: str  # ``subject`` or ``finger``: what was dealt to folds
    folds: int
    # by the two folds, the smaller first, that it scored and saw none of
    models: dict[tuple[int, int], Model]
    weights: Values  # (S,) of the systems' normalised scores, mean of all models
    missing: tuple[int, ...]  # how many scores of each system were missing


def fuse(systems: Sequence[Scores], method: str = "trained", seed: int = 0) -> Fused:
    """Make one system of several that scored the same pairs.

    `systems`: two or more, of the same pairs (in any order, if their ids distinguish them), with
    subjects or at least fingers. `method`: of :data:`FITS`: ``linear`` (mean of z-scores),
    ``minmax`` (mean of scores between the lowest and highest), ``trained`` (logistic regression,
    log-odds). `seed`: of the folds. Where all scores of a pair are missing,
    so is the fused one. Raises BadInput if the systems scored other pairs, nobody is named, there
    are fewer than three subjects (fingers), or a training part lacks a class.

    Source: A. Ross and A. Jain, "Information fusion in biometrics", Pattern Recognition Letters 24,
    2003; A. Ross, K. Nandakumar and A. Jain, "Handbook of Multibiometrics", Springer 2006, chapter
    4; R. Snelick et al., IEEE TPAMI 27, 2005; A. Jain, K. Nandakumar and A. Ross, Pattern
    Recognition 38, 2005 (normalisation).
    """
    require(len(systems) >= 2, "a fusion needs two systems at least; give several score files.")
    first = systems[0]
    aligned = [first, *(pair_up(first, system) for system in systems[1:])]
    by, ids = ("finger", first.finger) if first.subject is None else ("subject", first.subject)
    if ids is None:
        raise BadInput(
            f"{first.name}: a fusion needs columns subject_a and subject_b (or finger_a and"
            " finger_b), so as never to be trained on those that it is tested on."
        )
    used = np.unique(ids.codes)
    require(
        used.size >= 3,
        f"a fusion needs three subjects (or fingers) at least, but there are {used.size}.",
    )
    folds = min(5, used.size)  # folds of the cross-validation; fewer where there are fewer subjects
    fold_of = np.zeros(len(ids.names), dtype=np.int64)
    fold_of[np.random.default_rng([seed, 0xF05E]).permutation(used)] = np.arange(used.size) % folds
    table = np.stack([system.score for system in aligned], axis=1)
    models, weights, fused = _cross_fit(table, first.label, fold_of[ids.codes], FITS[method])
    return Fused(
        scores=replace(first, score=fused, name=f"fused, {method}"),
        systems=tuple(system.name for system in aligned),
        by=by,
        folds=folds,
        models=models,
        weights=weights,
        missing=tuple(np.isnan(table).sum(axis=0).tolist()),
    )


def _cross_fit(
    table: Values,
    genuine: Labels,
    fold: NDArray[np.int64],
    fit: Callable[[Values, Labels], tuple[Values, Model]],
) -> tuple[dict[tuple[int, int], Model], Values, Values]:
    """Score every comparison by a model that saw nobody of the folds (N, 2) of its sides: models by
    pair of folds, mean weights (S,), and scores (N,).
    """
    fold = np.sort(fold, axis=1)
    known = ~np.isnan(table).all(axis=1)
    fused = np.full(len(table), np.nan)
    models, weights = {}, []
    for low, high in np.unique(fold, axis=0).tolist():
        tested = (fold == (low, high)).all(axis=1) & known
        seen = known & ~np.isin(fold, (low, high)).any(axis=1)
        require(
            len(np.unique(genuine[seen])) == 2,
            "without the subjects of two folds no genuine or no impostor scores are left to learn"
            " from; give more subjects.",
        )
        weight, models[low, high] = fit(table[seen], genuine[seen])
        weights.append(weight)
        fused[tested] = models[low, high](table[tested])
    return models, np.mean(weights, axis=0), fused


def fit_linear(scores: Values, genuine: Labels) -> tuple[Values, Model]:
    """Mean of z-scores; a missing score's weight goes to the others. Source: A. Ross and A. Jain
    2003 (sum rule)."""
    return _mean(*spread(scores))


def fit_minmax(scores: Values, genuine: Labels) -> tuple[Values, Model]:
    """Mean of scores between the lowest (0) and highest (1) of the training part. Source: R.
    Snelick et al. 2005."""
    spread(scores)
    low, high = np.nanmin(scores, axis=0), np.nanmax(scores, axis=0)
    return _mean(low, high - low)


def _mean(offset: Values, scale: Values) -> tuple[Values, Model]:
    weight = np.full(scale.size, 1 / scale.size)
    return weight, lambda table: np.nanmean((table - offset) / scale, axis=1)


PENALTY = 1e-3
"""Penalty of the logistic regression: on half the sum of the squared weights, where the mean loss
is 1."""


def fit_logistic(scores: Values, genuine: Labels) -> tuple[Values, Model]:
    """Logistic regression on z-scores: log-odds that a pair is genuine, where both kinds are
    equally likely beforehand. A missing score counts as the mean and, being missing, as a feature
    of its own. Source: Handbook of Multibiometrics, chapter 4 (classifier-based fusion); C. Bishop,
    "Pattern Recognition and Machine Learning", 2006, (4.92) to (4.100).
    """
    offset, scale = spread(scores)

    def design(table: Values) -> Values:
        known = ~np.isnan(table)
        normal = np.where(known, (table - offset) / scale, 0.0)
        return np.hstack([normal, ~known, np.ones((len(table), 1))])

    x, sign = design(scores), np.where(genuine, 1.0, -1.0)
    fraction = np.where(genuine, 0.5 / genuine.sum(), 0.5 / (~genuine).sum())
    hold = np.append(np.full(x.shape[1] - 1, PENALTY), 0.0)  # not on the intercept

    def loss(w: Values) -> tuple[float, Values]:
        rate = fraction * sign * expit(-sign * (x @ w))
        return (
            float(fraction @ np.logaddexp(0.0, -sign * (x @ w)) + 0.5 * hold @ w**2),
            -x.T @ rate + hold * w,
        )

    start = np.zeros(x.shape[1])
    weights = minimize(loss, start, jac=True, method="BFGS", options={"gtol": 1e-9}).x
    return weights[: scores.shape[1]], lambda table: design(table) @ weights


FITS = {"minmax": fit_minmax, "linear": fit_linear, "trained": fit_logistic}


def spread(scores: Values) -> tuple[Values, Values]:
    """Mean and standard deviation (S,) of each system."""
    known = np.ma.masked_invalid(scores)
    mean, deviation = known.mean(axis=0).filled(0.0), known.std(axis=0).filled(0.0)
    flat = deviation <= 1e-12 * np.maximum(1.0, np.abs(mean))
    require(
        not flat.any(),
        f"the scores of system {int(np.argmax(flat)) + 1} of {flat.size} do not vary in the part to"
        " learn from; leave it out of the fusion.",
    )
    return mean, deviation
