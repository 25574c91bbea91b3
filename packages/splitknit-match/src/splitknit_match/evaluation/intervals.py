"""Confidence intervals by the bootstrap, and of differences between systems on the same pairs.

``finger``, ``subject``: fingers (or subjects) are drawn with replacement, and a comparison counts
as often as the product of how often its finger, or each of its two fingers, was drawn: w_a for a
genuine pair of finger a, w_a w_b for an impostor pair of a and b. (Two fingers of one subject,
drawn by subject, count w_s: they come along together.) Impostor scores that share either finger
thus rise and fall together. Copies of one finger in a replicate are not compared with each other:
there is no score for it.

``plain``: comparisons are drawn, genuine and impostor ones apart. Right only if they are
independent, which they are not where a finger takes part in several.

Source: T. A. B. Snijders, S. P. Borgatti, "Non-parametric standard errors and tests for network
statistics", Connections 22(2), 1999 (the vertex bootstrap). A. B. Owen, "The pigeonhole bootstrap",
Annals of Applied Statistics 1(2), 2007 (two-way; the variance is right or a little large). R.
Fogliato, P. Patil, P. Perona, "Confidence intervals for error rates in 1:1 matching tasks",
International Journal of Computer Vision, 2024 (a review: bootstraps cover too often or too rarely
where errors are few).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray
from splitknit.settings import Checked, Limits
from splitknit_match.evaluation.parameters import CONFIDENCE, FEW
from splitknit_match.evaluation.rates import Roc, Values, error_bound, rank, roc
from splitknit_match.evaluation.scores import Scores

TARGETS = (0.01, 0.001, 0.0001)
"""FARs at which the GAR is given. Source: default of the setting `targets`."""
METHODS = ("plain", "finger", "subject")


@dataclass(frozen=True, slots=True)
class BootstrapSettings(Checked):
    """How intervals are made."""

    replicates: Annotated[int, Limits(20, 1_000_000)] = 1000
    """Resampled sets of comparisons."""
    seed: Annotated[int, Limits(0)] = 0
    """What the sets are drawn from, 0 or more."""
    targets: Annotated[tuple[float, ...], Limits(0, 1, above=True)] = TARGETS
    """FARs at which the GAR is given."""
    curve_points: Annotated[int, Limits(0, 1000)] = 41
    """FARs of the band around the ROC, evenly spaced in the logarithm; 0: no band."""


DEFAULTS = BootstrapSettings()
_NO_FARS: Values = np.zeros(0)
"""No points of the band around the ROC. Source: definition."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure and between what it lies; low <= value <= high."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """All figures of one system."""

    method: str  # ``plain``, ``finger`` or ``subject``
    drawn: int  # comparisons of the smaller class, fingers or subjects
    figures: Mapping[str, Interval]
    """``eer``, ``gar@0.01`` and so on, ``auc``, ``d_prime`` (where scores vary); ``gar@0.01_made``:
    no failures."""
    curve_far: Values  # (P,) and the band of the GAR there:
    curve_low: Values
    curve_high: Values


def bootstrap(
    scores: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS
) -> Intervals:
    """All figures of `scores` with percentile intervals of 95 %. Raises BadInput if `method` lacks
    its ids."""
    falling = scores.taken(np.argsort(-scores.score, kind="stable"))
    lowest = min(0.1, 1.0 / falling.impostor.size)
    curve_far = (
        np.geomspace(lowest, 1.0, settings.curve_points) if settings.curve_points else np.zeros(0)
    )
    ((values, replicates),) = _resampled([falling], method, settings, curve_far)
    lows, highs = _percentiles(replicates)
    bounds = _bounds(falling, method, settings.targets)
    names = figure_names(settings.targets)
    figures = {
        name: _interval(value, low, high, *bounds.get(name, ()))
        for name, value, low, high in zip(names, values, lows, highs, strict=False)
        if np.isfinite(value)
    }
    _, clusters = _clusters(falling, method)
    return Intervals(method, clusters, figures, curve_far, lows[len(names) :], highs[len(names) :])


def differences(
    first: Scores, second: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS
) -> dict[str, Interval]:
    """Figures of `first` minus figures of `second`, which scored the same pairs in the same order.
    Both get the same replicates, so that what is hard for both cancels; a difference is beyond
    chance where its interval leaves out zero. Where few fingers tell both apart, the limit is that
    of single figures: of 12 fingers none of which does, up to 3 / 12 either way. Raises BadInput if
    the systems differ in number or labels, or `method` lacks its ids.
    """
    same = np.array_equal(first.label, second.label)
    require(
        same,
        f"'{first.name}' and '{second.name}' did not score the same pairs; their labels differ.",
    )
    (values, replicates), (values_2, replicates_2) = _resampled([first, second], method, settings)
    ends = _percentiles(replicates - replicates_2)
    rows = zip(figure_names(settings.targets), values - values_2, *ends, strict=True)
    bounds = _difference_bounds(first, second, method, settings.targets)
    return {
        name: _interval(value, low, high, *(value + end for end in bounds.get(name, ())))
        for name, value, low, high in rows
        if np.isfinite(value)
    }


def figure_names(targets: Sequence[float]) -> list[str]:
    """Names of the figures, in the order of :func:`_figures`."""
    gars = [f"gar@{target:g}" for target in targets]
    return ["eer", *gars, *(f"{name}_made" for name in gars), "auc", "d_prime"]


def _figures(curve: Roc, targets: Sequence[float], fars: Values) -> list[float]:
    """Figures of a ROC, and its GAR at some FARs; NaN where a class is missing."""
    known = curve.scored()
    if min(known.tried) <= 0:
        return [float("nan")] * (2 * len(targets) + len(fars) + 3)
    rates = [curve.equal_error().value, *curve.gars(targets), *known.gars(targets)]
    return [*rates, curve.auc(), curve.d_prime(), *curve.gars(fars)]


def _resampled(
    systems: Sequence[Scores], method: str, settings: BootstrapSettings, fars: Values = _NO_FARS
) -> list[tuple[Values, Values]]:
    """Figures (F,) of each system, and (replicates, F) those of the same replicates for all
    systems."""
    ranks = [rank(system.genuine, system.impostor) for system in systems]
    replicates: list[list[list[float]]] = [[] for _ in systems]
    for weights in _weights(systems[0], method, settings):
        for ranked, figures in zip(ranks, replicates, strict=True):
            falling = [weight[order] for weight, order in zip(weights, ranked.order, strict=True)]
            figures.append(_figures(ranked.roc(falling), settings.targets, fars))
    values = [
        _figures(roc(system.genuine, system.impostor), settings.targets, fars) for system in systems
    ]
    return [(np.array(own), np.array(rows)) for own, rows in zip(values, replicates, strict=True)]


def _weights(
    scores: Scores, method: str, settings: BootstrapSettings
) -> Iterator[Sequence[Values]]:
    """How often each genuine (N,) and impostor comparison (M,) counts in each replicate."""
    generator = np.random.default_rng(settings.seed)

    def draw(count: int) -> Values:
        return np.bincount(generator.integers(0, count, count), minlength=count).astype(float)

    codes, clusters = _clusters(scores, method)
    a, b = codes.T
    b = np.where(a == b, clusters, b)  # which counts once
    for _ in range(settings.replicates):
        if method == "plain":
            yield draw(scores.genuine.size), draw(scores.impostor.size)
        else:
            times = np.append(draw(clusters), 1.0)
            weight = times[a] * times[b]
            yield weight[scores.label], weight[~scores.label]


def _clusters(scores: Scores, method: str) -> tuple[NDArray[np.int64], int]:
    """(N, 2) what each comparison is drawn with, and how many of them there are; of ``plain`` those
    of the smaller class limit what is known.
    """
    require(method in METHODS, f"the bootstrap draws by {', '.join(METHODS)}, not by '{method}'.")
    if method == "plain":
        places = np.arange(scores.label.size)
        return np.stack([places, places], axis=1), min(scores.genuine.size, scores.impostor.size)
    ids = getattr(scores, method)
    require(
        ids is not None,
        f"{scores.name}: to draw by {method}, columns {method}_a and {method}_b are needed.",
    )
    used, codes = np.unique(ids.codes, return_inverse=True)
    require(
        used.size >= 3,
        f"{scores.name}: a bootstrap by {method} needs three of them at least, but there are"
        f" {used.size}.",
    )
    return codes.reshape(ids.codes.shape), int(used.size)


def _percentiles(rows: Values) -> Values:
    """(2, F) percentiles over replicates; those in which a class was not drawn at all are left
    out."""
    tail = (1 - CONFIDENCE) / 2
    limits = np.full((2, rows.shape[1]), np.nan)
    for limit, column in zip(limits.T, rows.T, strict=True):
        known = column[np.isfinite(column)]
        if known.size:
            limit[:] = np.quantile(known, [tail, 1 - tail])
    return limits


def _interval(value: float, *limits: float) -> Interval:
    known = [float(limit) for limit in (value, *limits) if np.isfinite(limit)]
    return Interval(float(value), min(known), max(known))


def _bounds(
    scores: Scores, method: str, targets: Sequence[float]
) -> dict[str, tuple[float, float]]:
    """How far off rates that rest on few fingers may be; the rate itself if enough were rejected
    and accepted.

    A bootstrap repeats what was seen. Where only some fingers (subjects, comparisons) were ever
    rejected, it knows too little of those that are, and nothing where none was. The limit is then
    that of Clopper and Pearson for as many independent trials as there are fingers, as if all
    comparisons of a finger failed together: cautious, and where nothing failed the rule of three.
    """
    genuine = scores.genuine
    curve = roc(genuine, scores.impostor)
    clusters = _clusters(scores, method)[0][scores.label, 0]

    def upper(rate: float, errors: BoolArray, tried: BoolArray) -> float:
        few = np.unique(clusters[errors & tried]).size < FEW
        return error_bound(rate, np.unique(clusters[tried]).size) if few else rate

    every = np.ones(genuine.size, dtype=bool)
    equal = curve.equal_error()
    limits = {"eer": (equal.value, upper(equal.value, ~_accepted(genuine, equal.threshold), every))}
    for part, tried, ending in ((curve, every, ""), (curve.scored(), ~np.isnan(genuine), "_made")):
        for target in targets:
            point = part.at_far(target)
            accepted = _accepted(genuine, point.threshold)
            low = 1.0 - upper(1.0 - point.gar, ~accepted, tried)
            limits[f"gar@{target:g}{ending}"] = low, upper(point.gar, accepted, tried)
    return limits


def _difference_bounds(
    first: Scores, second: Scores, method: str, targets: Sequence[float]
) -> dict[str, tuple[float, float]]:
    """How far below and above a difference may lie that rests on few fingers, as
    :func:`_bounds`: what one system accepts and the other does not are errors of independent
    trials, either way."""
    clusters = _clusters(first, method)[0][first.label, 0]
    trials = np.unique(clusters).size

    def more(differs: BoolArray) -> float:
        rate = float(differs.mean())
        few = np.unique(clusters[differs]).size < FEW
        return error_bound(rate, trials) - rate if few else 0.0

    limits = {}
    own, others = (_decided(system, targets) for system in (first, second))
    for name, accepted in own.items():
        gained, lost = more(accepted & ~others[name]), more(others[name] & ~accepted)
        limits[name] = (-gained, lost) if name == "eer" else (-lost, gained)
    return limits


def _decided(scores: Scores, targets: Sequence[float]) -> dict[str, BoolArray]:
    """Genuine comparisons (N,) that are accepted where each figure is read."""
    curve = roc(scores.genuine, scores.impostor)
    thresholds = {"eer": curve.equal_error().threshold}
    for part, ending in ((curve, ""), (curve.scored(), "_made")):
        for target in targets:
            thresholds[f"gar@{target:g}{ending}"] = part.at_far(target).threshold
    return {name: _accepted(scores.genuine, value) for name, value in thresholds.items()}


def _accepted(scores: Values, threshold: float | None) -> BoolArray:
    return scores >= (np.inf if threshold is None else threshold)
