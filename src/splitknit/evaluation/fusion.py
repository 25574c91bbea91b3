"""Fusion of the scores of several systems, cross-validated so that nobody is trained on who is tested on.

Subjects (where they are not named: fingers) are dealt to folds. A comparison of somebody of fold i with somebody of
fold j is scored by a model that saw comparisons among the other folds only. There is so one model for each pair of
folds, and a comparison of two people is never scored by a model that knew one of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.evaluation.fusion_models import (
    NORMALISATIONS,
    LinearModel,
    LogisticModel,
    Table,
    fit_linear,
    fit_logistic,
)
from splitknit.evaluation.pairing import pair_up
from splitknit.evaluation.scores import Ids, Scores

METHODS = ("linear", "trained")


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """How scores are fused."""

    method: str = "trained"
    """``linear``: weighted sum of normalised scores; ``trained``: logistic regression."""
    normalisation: str = "z"
    """Of ``linear``: ``z`` or ``minmax``, with what the training folds give."""
    weights: tuple[float, ...] = ()
    """Of ``linear``, one for each system; none: equal ones (the thesis does not say its own)."""
    penalty: float = 1e-3
    """Of ``trained``: on half the sum of the squared weights."""
    folds: int = 5
    """At most; fewer where there are fewer subjects."""
    seed: int = 0
    """By which subjects are dealt to folds."""

    def __post_init__(self) -> None:
        require(self.method in METHODS, f"scores are fused by {' or '.join(METHODS)}, not by '{self.method}'.")
        known = self.normalisation in NORMALISATIONS
        require(known, f"scores are normalised by 'z' or 'minmax', not by '{self.normalisation}'.")
        require(self.penalty > 0, f"fusion.penalty must be positive, but it is {self.penalty}.")
        require(self.folds >= 3, f"a fusion needs three folds at least, but there are {self.folds}.")
        require(self.seed >= 0, f"the seed must not be negative, but it is {self.seed}.")


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """Fused scores, and how they came about."""

    scores: Scores
    """In the order of the first system; NaN where no system gave a score."""
    systems: tuple[str, ...]
    by: str
    """``subject`` or ``finger``: what was dealt to folds."""
    fold: NDArray[np.int64]
    """(names,) of each subject (finger)."""
    models: dict[tuple[int, int], LinearModel | LogisticModel]
    """By the two folds, the smaller first, whose comparisons it scored and of which it saw none."""
    missing: tuple[int, ...]
    """Of each system, how many scores were missing."""

    def mean_weights(self) -> dict[str, float]:
        """Weight of each system's normalised score, averaged over the models."""
        mean = np.mean([model.weight for model in self.models.values()], axis=0)
        return {name: float(weight) for name, weight in zip(self.systems, mean, strict=True)}


def fuse(systems: Sequence[Scores], settings: FusionSettings | None = None, *, name: str | None = None) -> Fused:
    """Make one system of several that scored the same pairs.

    Parameters
    ----------
    systems : two or more Scores
        Of the same pairs (in any order, if their ids tell them apart), with subjects or at least fingers.
    settings : FusionSettings, optional
    name : str, optional
        Of the result.

    Returns
    -------
    Fused
        `linear`: the weighted mean of the normalised scores that are there. `trained`: log-odds; a missing score counts
        as the mean, and its being missing as a feature of its own. Where all are missing, so is the fused one.

    Raises
    ------
    BadInput
        If the systems scored other pairs, nobody is named, there are fewer than three subjects (fingers), or a training
        part lacks a class.

    References
    ----------
    A. Ross and A. Jain, "Information fusion in biometrics", Pattern Recognition Letters 24, 2003; A. Ross,
    K. Nandakumar and A. Jain, "Handbook of Multibiometrics", Springer 2006, chapter 4; R. Snelick et al., IEEE TPAMI
    27, 2005.

    Examples
    --------
    >>> import numpy as np
    >>> from splitknit.evaluation import comparisons, scores_of_comparisons
    >>> finger, session = np.tile(np.arange(12), 2), np.repeat([1, 2], 12)
    >>> pairs, rng = comparisons(finger, session), np.random.default_rng(0)
    >>> noisy = [pairs.genuine + rng.normal(0, 0.4, pairs.a.size) for _ in range(2)]
    >>> two = [scores_of_comparisons(pairs, score, finger, session, finger) for score in noisy]
    >>> fuse(two, FusionSettings(method="linear")).scores.score.shape
    (144,)
    """
    settings = settings or FusionSettings()
    aligned = _aligned(systems)
    first = aligned[0]
    require(
        settings.weights == () or len(settings.weights) == len(aligned),
        f"{len(aligned)} systems need as many weights, but there are {len(settings.weights)}.",
    )
    table = np.stack([one.score for one in aligned], axis=1)
    by, ids = _named(first)
    fold = deal(ids, settings.folds, settings.seed)
    models, fused = cross_fit(table, first.label, fold[ids.codes], _fitter(settings))
    title = name or f"{' + '.join(one.name for one in aligned)}, {settings.method}"
    scores = Scores(first.label, fused, first.finger, first.subject, first.session, title)
    missing = tuple(int(np.isnan(column).sum()) for column in table.T)
    return Fused(scores, tuple(one.name for one in aligned), by, fold, models, missing)


def deal(ids: Ids, folds: int, seed: int) -> NDArray[np.int64]:
    """Fold of each name (names,): as even as can be, in an order that the seed decides.

    Raises
    ------
    BadInput
        If fewer than three names occur: with two folds apart for testing, nothing is left to learn from.
    """
    used = np.unique(ids.codes)
    require(used.size >= 3, f"a fusion needs three subjects (or fingers) at least, but there are {used.size}.")
    fold = np.full(len(ids.names), -1, dtype=np.int64)
    fold[np.random.default_rng([seed, 0xF05E]).permutation(used)] = np.arange(used.size) % min(folds, used.size)
    return fold


def cross_fit(
    table: Table,
    genuine: NDArray[np.bool_],
    fold: NDArray[np.int64],
    fit: Callable[[Table, NDArray[np.bool_]], LinearModel | LogisticModel],
) -> tuple[dict[tuple[int, int], LinearModel | LogisticModel], Table]:
    """Score every comparison by a model that saw nobody of either side's fold.

    Parameters
    ----------
    table : (N, S) scores
    genuine : (N,)
    fold : (N, 2) of both sides
    fit : makes a model from scores and labels

    Returns
    -------
    models by pair of folds, and (N,) scores
    """
    low, high = fold.min(axis=1), fold.max(axis=1)
    models: dict[tuple[int, int], LinearModel | LogisticModel] = {}
    fused = np.full(len(table), np.nan)
    for i, j in combinations_with_replacement(range(int(high.max()) + 1), 2):
        chosen = (low == i) & (high == j)
        if not bool(chosen.any()):
            continue
        seen = ~np.isin(fold, (i, j)).any(axis=1)
        known = ~np.isnan(table[seen]).all(axis=1)
        both = genuine[seen][known]
        require(
            both.size > 0 and bool(both.any()) and not bool(both.all()),
            "without the subjects of two folds no genuine or no impostor scores are left to learn from; give more "
            "subjects, or fewer folds.",
        )
        models[i, j] = fit(table[seen], genuine[seen])
        fused[chosen] = models[i, j](table[chosen])
    return models, fused


def _fitter(settings: FusionSettings) -> Callable[[Table, NDArray[np.bool_]], LinearModel | LogisticModel]:
    if settings.method == "trained":
        return lambda table, genuine: fit_logistic(table, genuine, settings.penalty)
    weights = np.array(settings.weights) if settings.weights else None
    return lambda table, genuine: fit_linear(table, weights, settings.normalisation)


def _aligned(systems: Sequence[Scores]) -> list[Scores]:
    require(len(systems) >= 2, f"a fusion needs two systems at least, but there is {len(systems)}.")
    aligned = [systems[0]]
    for other in systems[1:]:
        paired = pair_up(systems[0], other)
        if paired is None:
            raise BadInput(
                f"'{systems[0].name}' and '{other.name}' did not score the same pairs, so that they cannot be fused; "
                "give scores of one list of comparisons."
            )
        aligned.append(paired)
    return aligned


def _named(scores: Scores) -> tuple[str, Ids]:
    if scores.subject is not None:
        return "subject", scores.subject
    if scores.finger is not None:
        return "finger", scores.finger
    raise BadInput(
        f"{scores.name}: a fusion needs columns subject_a and subject_b (or finger_a and finger_b), so as never to be "
        "trained on those that it is tested on."
    )
