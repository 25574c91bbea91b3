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
from splitknit.settings import Checked, Limits
from splitknit_match.evaluation import rates
from splitknit_match.evaluation.rates import CONFIDENCE, Ranked, Values, error_bound, rank
from splitknit_match.evaluation.scores import Scores

TARGETS = (0.01, 0.001, 0.0001)
METHODS = ("plain", "finger", "subject")
FEW = 5  # fingers (subjects, comparisons) below which percentiles of replicates are not trusted alone


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
    """``eer``, ``gar@0.01`` and so on, ``auc``, ``d_prime`` (where scores vary); with ``_made`` failures left out."""
    curve_far: Values  # (P,) and the band of the GAR there:
    curve_low: Values
    curve_high: Values


def bootstrap(scores: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS) -> Intervals:
    """All figures of `scores` with percentile intervals of 95 %. Raises BadInput if `method` lacks its ids."""
    falling = scores.taken(np.argsort(-scores.score, kind="stable"))
    curve = _curve(scores, settings.curve_points)
    ((values, rows),) = _resampled([falling], method, settings, curve)
    lows, highs = _limits(rows)
    bounds = _bounds(falling, method, settings.targets)
    names = figure_names(settings.targets)
    figures = {
        name: _holding(value, low, high, *bounds.get(name, ()))
        for name, value, low, high in zip(names, values, lows, highs, strict=False)
        if np.isfinite(value)
    }
    band = slice(len(names), None)
    return Intervals(method, _drawn(falling, method)[1], figures, np.array(curve), lows[band], highs[band])


def differences(
    first: Scores, second: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS
) -> dict[str, Interval]:
    """Figures of `first` minus figures of `second`, which scored the same pairs in the same order. Both get the same
    replicates, so that what is hard for both cancels; a difference is beyond chance where its interval leaves out zero.
    Raises BadInput if the systems differ in number or labels, or `method` lacks its ids.
    """
    same = np.array_equal(first.label, second.label)
    require(same, f"'{first.name}' and '{second.name}' did not score the same pairs; their labels differ.")
    (one, rows), (other, more) = _resampled([first, second], method, settings)
    ends = zip(figure_names(settings.targets), one - other, *_limits(rows - more), strict=True)
    return {name: _holding(value, low, high) for name, value, low, high in ends if np.isfinite(value)}


def figure_names(targets: Sequence[float]) -> list[str]:
    """Names of the figures, in the order of :func:`_figures`."""
    gars = [f"gar@{target:g}" for target in targets]
    return ["eer", *gars, "eer_made", *(f"{name}_made" for name in gars), "auc", "d_prime"]


def _figures(
    ranked: Ranked, weights: Sequence[Values], targets: Sequence[float], curve: Sequence[float]
) -> list[float]:
    """Figures where the comparisons of each class, falling, count `weights` times; NaN where a class is missing."""
    roc = ranked.roc(weights)
    made = roc.made()
    if min(made.tried) <= 0:
        return [float("nan")] * (2 * len(targets) + len(curve) + 4)
    whole = [roc.equal_error().value, *roc.gars(targets)]
    of_made = [made.equal_error().value, *made.gars(targets)]
    return [*whole, *of_made, roc.auc(), ranked.d_prime(weights), *roc.gars(curve)]


def _resampled(
    systems: Sequence[Scores], method: str, settings: BootstrapSettings, curve: Sequence[float] = ()
) -> list[tuple[Values, Values]]:
    """Figures (F,) of each system, and (replicates, F) those of the same replicates for all systems."""
    ranks = [rank(one.genuine, one.impostor) for one in systems]
    once = [np.ones(order.size) for order in ranks[0].order]
    values = [np.array(_figures(ranked, once, settings.targets, curve)) for ranked in ranks]
    rows = [np.empty((settings.replicates, one.size)) for one in values]
    for done, weights in enumerate(_weights(systems[0], method, settings)):
        for ranked, table in zip(ranks, rows, strict=True):
            falling = [weight[order] for weight, order in zip(weights, ranked.order, strict=True)]
            table[done] = _figures(ranked, falling, settings.targets, curve)
    return list(zip(values, rows, strict=True))


def _weights(scores: Scores, method: str, settings: BootstrapSettings) -> Iterator[Sequence[Values]]:
    """How often each genuine (N,) and impostor comparison (M,) counts in each replicate."""
    generator = np.random.default_rng(settings.seed)

    def draw(count: int) -> Values:
        return np.bincount(generator.integers(0, count, count), minlength=count).astype(float)

    if method != "plain":
        codes, clusters = _drawn(scores, method)
        a, b = codes.T
        b = np.where(a == b, clusters, b)  # which counts once
        sides = [(a[side], b[side]) for side in (scores.label, ~scores.label)]
        for _ in range(settings.replicates):
            times = np.append(draw(clusters), 1.0)
            yield [times[one] * times[other] for one, other in sides]
        return
    sizes = scores.genuine.size, scores.impostor.size
    batch = max(1, min(32, 1_000_000 // max(sizes)))
    for start in range(0, settings.replicates, batch):
        count = min(batch, settings.replicates - start)
        genuine, impostor = ([draw(size) for _ in range(count)] for size in sizes)
        yield from zip(genuine, impostor, strict=True)


def _drawn(scores: Scores, method: str) -> tuple[NDArray[np.int64], int]:
    """(N, 2) what each comparison is drawn with, and how many of them there are; of ``plain`` those
    of the smaller class limit what is known.
    """
    require(method in METHODS, f"the bootstrap draws by {', '.join(METHODS)}, not by '{method}'.")
    if method == "plain":
        genuine = int(scores.label.sum())
        places = np.arange(scores.label.size)
        return np.stack([places, places], axis=1), min(genuine, scores.label.size - genuine)
    ids = getattr(scores, method)
    require(ids is not None, f"{scores.name}: to draw by {method}, columns {method}_a and {method}_b are needed.")
    used, codes = np.unique(ids.codes, return_inverse=True)
    fault = f"{scores.name}: a bootstrap by {method} needs three of them at least,"
    require(used.size >= 3, f"{fault} but there are {used.size}.")
    return codes.reshape(ids.codes.shape), int(used.size)


def _curve(scores: Scores, points: int) -> tuple[float, ...]:
    lowest = min(0.1, 1.0 / int(np.sum(~scores.label)))
    return tuple(float(far) for far in np.geomspace(lowest, 1.0, points)) if points else ()


def _limits(rows: Values) -> Values:
    """(2, F) percentiles over replicates; those in which a class was not drawn at all are left out."""
    tail = (1 - CONFIDENCE) / 2
    limits = np.full((2, rows.shape[1]), np.nan)
    for place, column in enumerate(rows.T):
        known = column[np.isfinite(column)]
        if known.size:
            limits[:, place] = np.quantile(known, [tail, 1 - tail])
    return limits


def _holding(value: float, *limits: float) -> Interval:
    known = [float(limit) for limit in (value, *limits) if np.isfinite(limit)]
    return Interval(float(value), min(known), max(known))


def _bounds(scores: Scores, method: str, targets: Sequence[float]) -> dict[str, tuple[float, float]]:
    """How far off rates that rest on few fingers may be; the rate itself if enough were rejected and accepted.

    A bootstrap repeats what was seen. Where only some fingers (subjects, comparisons) were ever rejected, it knows too
    little of those that are, and nothing where none was. The limit is then that of Clopper and Pearson for as many
    independent trials as there are fingers, as if all comparisons of a finger failed together: cautious, and where
    nothing failed the rule of three.
    """
    genuine, roc = scores.genuine, rates.roc(scores.genuine, scores.impostor)
    drawn = _drawn(scores, method)[0][scores.label, 0]
    limits = {}
    for curve, known, ending in (
        (roc, np.ones_like(genuine, dtype=bool), ""),
        (roc.made(), ~np.isnan(genuine), "_made"),
    ):

        def upper(rate: float, hit: NDArray[np.bool_], tried: NDArray[np.int64] = drawn[known]) -> float:
            few = np.unique(drawn[hit]).size < FEW
            return error_bound(rate, np.unique(tried).size) if few else rate

        equal = curve.equal_error()
        limits[f"eer{ending}"] = equal.value, upper(equal.value, known & ~_accepted(genuine, equal.threshold))
        for target in targets:
            point = curve.at_far(target)
            accepted = _accepted(genuine, point.threshold)
            low = 1.0 - upper(1.0 - point.gar, known & ~accepted)
            limits[f"gar@{target:g}{ending}"] = low, upper(point.gar, accepted)
    return limits


def _accepted(scores: Values, threshold: float | None) -> NDArray[np.bool_]:
    return scores >= (np.inf if threshold is None else threshold)
