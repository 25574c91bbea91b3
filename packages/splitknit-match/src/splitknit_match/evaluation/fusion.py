"""Fusion of the scores of several systems, cross-validated so that nobody is trained on who is tested on.

Subjects (where they are not named: fingers) are dealt to folds. A comparison of somebody of fold i with somebody of
fold j is scored by a model that saw comparisons among the other folds only. There is so one model for each pair of
folds, and a comparison of two people is never scored by a model that knew one of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize
from scipy.special import expit

from splitknit import BadInput
from splitknit.errors import require
from splitknit.settings import Checked, Limits
from splitknit_match.evaluation.protocol import mismatch, pair_up
from splitknit_match.evaluation.scores import Ids, Scores

_PENALTY = 1e-3  # weight of the penalty of ``trained``, half the sum of the squared weights


@dataclass(frozen=True, slots=True)
class FusionSettings(Checked):
    """How scores are fused."""

    method: Literal["linear", "trained", "llr"] = "trained"
    """``linear``: mean of normalised scores; ``trained``: logistic regression; ``llr``: sum of log-likelihood
    ratios."""
    normalisation: Literal["z", "minmax"] = "z"
    """How ``linear`` normalises scores: ``z`` or ``minmax``, fitted on the training folds."""
    folds: Annotated[int, Limits(3)] = 5
    """At most; fewer where there are fewer subjects."""
    seed: Annotated[int, Limits(0)] = 0
    """By which subjects are dealt to folds."""


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """Fused scores, and how they came about."""

    scores: Scores  # in the order of the first system; NaN where no system gave a score
    systems: tuple[str, ...]
    by: str  # ``subject`` or ``finger``: what was dealt to folds
    fold: NDArray[np.int64]  # (names,) of each subject (finger)
    models: dict[tuple[int, int], _Model]  # by the two folds, the smaller first, that it scored and saw none of
    missing: tuple[int, ...]  # how many scores of each system were missing

    @property
    def folds(self) -> int:
        """How many folds hold a subject (finger)."""
        return len(set(self.fold.tolist()) - {-1})

    def mean_weights(self) -> dict[str, float]:
        """Weight of each system's normalised score (log-likelihood ratios: 1), averaged over the models."""
        mean = np.mean([model.weight for model in self.models.values()], axis=0)
        return {name: float(weight) for name, weight in zip(self.systems, mean, strict=True)}


def fuse(systems: Sequence[Scores], settings: FusionSettings | None = None, *, name: str | None = None) -> Fused:
    """Make one system of several that scored the same pairs.

    `systems`: two or more, of the same pairs (in any order, if their ids distinguish them), with subjects or at least
    fingers; `name`: of the result. Of scores that are there `linear` gives the weighted mean, normalised, and `llr` the
    sum of log-likelihood ratios; `trained` gives log-odds, a missing score counting as the mean and its being missing
    as a feature. Where all are missing, so is the fused one. Raises BadInput if the systems scored other pairs, nobody
    is named, there are fewer than three subjects (fingers), or a training part lacks a class.

    Source: A. Ross and A. Jain, "Information fusion in biometrics", Pattern Recognition Letters 24, 2003; A. Ross, K.
    Nandakumar and A. Jain, "Handbook of Multibiometrics", Springer 2006, chapter 4; R. Snelick et al., IEEE TPAMI 27,
    2005; A. Jain, K. Nandakumar and A. Ross, Pattern Recognition 38, 2005 (normalisation); K. Nandakumar et al., IEEE
    TPAMI 30, 2008 (likelihood ratios).

    >>> import numpy as np
    >>> from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
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
    table = np.stack([one.score for one in aligned], axis=1)
    by, ids = _named(first)
    fold = _deal(ids, settings.folds, settings.seed)
    models, fused = _cross_fit(table, first.label, fold[ids.codes], _fitter(settings))
    title = name or f"{' + '.join(one.name for one in aligned)}, {settings.method}"
    scores = Scores(first.label, fused, first.finger, first.subject, first.session, title)
    missing = tuple(int(np.isnan(column).sum()) for column in table.T)
    return Fused(scores, tuple(one.name for one in aligned), by, fold, models, missing)


def _deal(ids: Ids, folds: int, seed: int) -> NDArray[np.int64]:
    """Fold of each name (names,), as even as can be, dealt by the seed. Raises BadInput below three names: with two
    folds apart for testing, nothing is left to learn from.
    """
    used = np.unique(ids.codes)
    require(used.size >= 3, f"a fusion needs three subjects (or fingers) at least, but there are {used.size}.")
    fold = np.full(len(ids.names), -1, dtype=np.int64)
    fold[np.random.default_rng([seed, 0xF05E]).permutation(used)] = np.arange(used.size) % min(folds, used.size)
    return fold


def _cross_fit(
    table: Table, genuine: NDArray[np.bool_], fold: NDArray[np.int64], fit: Callable[[Table, NDArray[np.bool_]], _Model]
) -> tuple[dict[tuple[int, int], _Model], Table]:
    """Score every comparison by a model that saw nobody of either side's fold. `table`: (N, S) scores; `genuine`: (N,);
    `fold`: (N, 2) of both sides; `fit`: makes a model of scores and labels. Returns models by pair of folds, and (N,)
    scores.
    """
    low, high = fold.min(axis=1), fold.max(axis=1)
    models: dict[tuple[int, int], _Model] = {}
    fused = np.full(len(table), np.nan)
    for i, j in combinations_with_replacement(range(int(high.max()) + 1), 2):
        chosen = (low == i) & (high == j)
        if not bool(chosen.any()):
            continue
        seen = ~np.isin(fold, (i, j)).any(axis=1)
        known = ~np.isnan(table[seen]).all(axis=1)
        both = genuine[seen][known]
        fault = "without the subjects of two folds no genuine or no impostor scores are left to learn from"
        cure = "give more subjects, or fewer folds."
        require(both.size > 0 and bool(both.any()) and not bool(both.all()), f"{fault}; {cure}")
        models[i, j] = fit(table[seen], genuine[seen])
        fused[chosen] = models[i, j](table[chosen])
    return models, fused


def _fitter(settings: FusionSettings) -> Callable[[Table, NDArray[np.bool_]], _Model]:
    if settings.method == "llr":
        return fit_ratios
    if settings.method == "trained":
        return lambda table, genuine: fit_logistic(table, genuine, _PENALTY)
    return lambda table, genuine: fit_linear(table, settings.normalisation)


def _aligned(systems: Sequence[Scores]) -> list[Scores]:
    require(len(systems) >= 2, f"a fusion needs two systems at least, but there is {len(systems)}.")
    aligned = [systems[0]]
    for other in systems[1:]:
        paired = pair_up(systems[0], other)
        alike = (systems[0].finger is None) == (other.finger is None)  # else several fingers would count as one
        wrong = "" if alike and paired is not None else mismatch(systems[0], other)
        if wrong or paired is None:
            cure = "give every pair once in both, with a blank score where there is none."
            raise BadInput(f"'{systems[0].name}' and '{other.name}' did not score the same pairs: {wrong}; {cure}")
        aligned.append(paired)
    return aligned


def _named(scores: Scores) -> tuple[str, Ids]:
    if scores.subject is not None:
        return "subject", scores.subject
    if scores.finger is not None:
        return "finger", scores.finger
    fault = f"{scores.name}: a fusion needs columns subject_a and subject_b (or finger_a and finger_b),"
    raise BadInput(f"{fault} so as never to be trained on those that it is tested on.")


# How the scores of several systems become one: a weighted sum of normalised scores, and a logistic regression.

Table = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """What was learned of one training part."""

    weight: Table  # (S,) of the systems' normalised scores; ones where log-likelihood ratios count as they are
    scored: Callable[[Table], Table]  # (N,) from scores (N, S)

    def __call__(self, scores: Table) -> Table:
        """(N,) from scores (N, S), NaN where all are missing."""
        return np.where(np.isnan(scores).all(axis=1), np.nan, self.scored(scores))


_BINS = 1024  # bins of the densities of scores


def fit_ratios(scores: Table, genuine: NDArray[np.bool_]) -> _Model:
    """Estimate the densities of each system's genuine and impostor scores (N, S), NaN where there is none.

    By Gaussian kernels of Silverman's width; one observation spread over the whole range is added to each class, so
    that no ratio is infinite. Raises BadInput if a system lacks a class, or its scores do not vary. Source: K.
    Nandakumar, Y. Chen, S. Dass and A. Jain, "Likelihood ratio-based biometric score fusion", IEEE TPAMI 30, 2008, eq.
    5; B. Silverman, "Density Estimation", 1986, eq. 3.31.
    """
    _spread(scores)
    low, high = np.nanmin(scores, axis=0), np.nanmax(scores, axis=0)
    width = (high - low) / _BINS
    ratio = np.empty((scores.shape[1], _BINS))
    for k, column in enumerate(scores.T):
        logarithms = []
        for side in (column[genuine], column[~genuine]):
            known = side[~np.isnan(side)]
            one_kind = f"system {k + 1} has only genuine or only impostor scores in the part to learn from."
            require(known.size > 0, one_kind)
            counts = np.histogram(known, _BINS, (low[k], high[k]))[0].astype(np.float64)
            middle = np.subtract(*np.percentile(known, [75, 25])) / 1.34
            spread = min(float(known.std()), float(middle) or np.inf)
            kernel = max(0.9 * spread * known.size**-0.2 / width[k], 1.0)
            density = gaussian_filter1d(counts, kernel, mode="constant") + 1.0 / _BINS
            logarithms.append(np.log(density / density.sum()))
        ratio[k] = logarithms[0] - logarithms[1]

    def scored(table: Table) -> Table:  # held at the training part's ends; missing ones add nothing
        places = ((table - low) / width - 0.5).T
        found = [np.interp(place, np.arange(_BINS), one) for place, one in zip(places, ratio, strict=True)]
        return np.asarray(np.nansum(found, axis=0))

    return _Model(np.ones(len(ratio)), scored)


def fit_linear(scores: Table, normalisation: str = "z") -> _Model:
    """Normalise `scores` (N, S) of S systems, NaN where there is none, by what is known of a training part.

    `normalisation`: ``z`` (mean 0 and standard deviation 1 of the training part) or ``minmax`` (its least score 0, its
    largest 1). All systems weigh the same. Raises BadInput if a system's scores do not vary. Source: A. Ross and A.
    Jain, "Information fusion in biometrics", Pattern Recognition Letters 24, 2003 (sum rule); R. Snelick et al.,
    "Large-scale evaluation of multimodal biometric authentication using state-of-the-art systems", IEEE TPAMI 27, 2005.
    """
    offset, scale = _spread(scores)
    if normalisation == "minmax":
        offset = np.nanmin(scores, axis=0)
        scale = np.nanmax(scores, axis=0) - offset
    weight = np.full(scores.shape[1], 1 / scores.shape[1])

    def scored(table: Table) -> Table:  # a missing score's weight goes to the others
        known = ~np.isnan(table)
        there = known @ weight
        normal = np.where(known, (table - offset) / scale, 0.0)
        return np.where(there > 0, normal @ weight / np.where(there > 0, there, 1.0), np.nan)

    return _Model(weight, scored)


def fit_logistic(scores: Table, genuine: NDArray[np.bool_], penalty: float = 1e-3) -> _Model:
    """Fit a logistic regression of the label `genuine` (N,) on standardised scores, by Newton's method; the model gives
    log-odds that a pair is genuine, where both kinds are equally likely beforehand.

    `scores`: (N, S) of S systems; a missing one, NaN, counts as the mean and, being missing, as a feature of its own.
    Both classes weigh the same. `penalty`: on half the sum of the squared weights (not on the intercept), where the
    mean loss of both classes is 1. Raises BadInput if a class has no score, or a system's scores do not vary. Source:
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
    fraction = np.where(label, 0.5 / label.sum(), 0.5 / (~label).sum())
    hold = np.append(np.full(x.shape[1] - 1, penalty), 0.0)

    def loss(w: Table) -> tuple[float, Table]:
        rate = fraction * y * expit(-y * (x @ w))
        return float(fraction @ np.logaddexp(0.0, -y * (x @ w)) + 0.5 * hold @ w**2), -x.T @ rate + hold * w

    def bend(w: Table) -> Table:
        rate = expit(x @ w)
        return np.asarray((x * (fraction * rate * (1 - rate))[:, None]).T @ x + np.diag(hold + 1e-12))

    how: Any = {"jac": True, "hess": bend, "method": "trust-exact", "options": {"gtol": 1e-12}}
    answer = np.asarray(minimize(loss, np.zeros(x.shape[1]), **how).x)
    return _Model(answer[: scores.shape[1]], lambda table: _design(table, offset, scale) @ answer)


def _spread(scores: Table) -> tuple[Table, Table]:
    require(scores.ndim == 2, f"scores must have the shape (N, S), but they have {scores.shape}.")
    known: Any = np.ma.masked_invalid(scores)
    mean, spread = (np.asarray(found.filled(0.0)) for found in (known.mean(axis=0), known.std(axis=0)))
    flat = spread <= 1e-12 * np.maximum(1.0, np.abs(mean))
    one = f"the scores of system {int(np.argmax(flat)) + 1} of {scores.shape[1]} do not vary in the part to learn from"
    require(not bool(flat.any()), f"{one}; leave it out of the fusion.")
    return mean, spread


def _design(scores: Table, offset: Table, scale: Table) -> Table:
    """(N, 2 S + 1): standardised scores, which are missing, and ones."""
    known = ~np.isnan(scores)
    normal = np.where(known, (scores - offset) / scale, 0.0)
    return np.hstack([normal, ~known, np.ones((len(scores), 1))])
