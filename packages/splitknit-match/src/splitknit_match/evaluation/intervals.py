"""Confidence intervals by the bootstrap, and of differences between systems on the same pairs.

``finger``, ``subject``: fingers (or subjects) are drawn with replacement, and a comparison counts
as often as the product of how often its finger, or each of its two fingers, was drawn: w_a for a
genuine pair of finger a, w_a w_b for an impostor pair of a and b. (Two fingers of one subject,
drawn by subject, count w_s: they come along together.) Impostor scores that share either finger
thus rise and fall together. Copies of one finger in a replicate are not compared with each other:
there is no score for it.

``plain``: each comparison counts 0 to 5 times, independently, with mean and variance one, as one of
many that is drawn does. Right only if they are independent, which they are not where a finger takes
part in several.

Source: T. A. B. Snijders, S. P. Borgatti, "Non-parametric standard errors and tests for network
statistics", Connections 22(2), 1999 (the vertex bootstrap). A. B. Owen, "The pigeonhole bootstrap",
Annals of Applied Statistics 1(2), 2007 (two-way; the variance is right or a little large). R.
Fogliato, P. Patil, P. Perona, "Confidence intervals for error rates in 1:1 matching tasks",
International Journal of Computer Vision, 2024 (a review: bootstraps cover too often or too rarely
where errors are few). J. Praestgaard, J. A. Wellner, "Exchangeably weighted bootstraps of the
general empirical process", Annals of Probability 21(4), 1993 (independent weights of mean and
variance one).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray
from splitknit.settings import Checked, Limits
from splitknit_match.evaluation.rates import CONFIDENCE, Counts, Roc, Values, error_bound, roc
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
    curve = roc(falling.genuine, falling.impostor)
    lowest = min(0.1, 1.0 / falling.impostor.size)
    curve_far = (
        np.geomspace(lowest, 1.0, settings.curve_points) if settings.curve_points else np.zeros(0)
    )
    ((values, replicates),) = _resampled(falling, [curve], method, settings, curve_far)
    lows, highs = _percentiles(replicates)
    bounds = _bounds(falling, curve, method, settings.targets)
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
    require(
        np.array_equal(first.label, second.label),
        f"'{first.name}' and '{second.name}' did not score the same pairs; their labels differ.",
    )
    curves = [roc(system.genuine, system.impostor) for system in (first, second)]
    (values, replicates), (values_2, replicates_2) = _resampled(first, curves, method, settings)
    ends = _percentiles(replicates - replicates_2)
    rows = zip(figure_names(settings.targets), values - values_2, *ends, strict=True)
    accepted = [
        _decided(system, curve, settings.targets)
        for system, curve in zip((first, second), curves, strict=True)
    ]
    bounds = _difference_bounds(first, accepted, method)
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
    pairs: Scores,
    curves: Sequence[Roc],
    method: str,
    settings: BootstrapSettings,
    fars: Values = _NO_FARS,
) -> list[tuple[Values, Values]]:
    """Figures (F,) of each system's ROC, and (replicates, F) those of the same replicates for all
    systems; `pairs`: what they scored."""
    codes, _ = _clusters(pairs, method)
    count = int(codes.max()) + 1
    others = np.where(codes[:, 1:] == codes[:, :1], count, codes[:, 1:])  # which counts once
    drawn_with = np.hstack([codes[:, :1], others])
    sides = drawn_with[pairs.label], drawn_with[~pairs.label]
    replicates: list[list[list[float]]] = [[] for _ in curves]
    in_order = [
        [side[order].T.copy() for side, order in zip(sides, curve.ranked.order, strict=True)]
        for curve in curves
    ]
    for times in _times(count, method, settings):
        for curve, falling, figures in zip(curves, in_order, replicates, strict=True):
            weights = [
                math.prod(times.take(part, mode="clip") for part in side) for side in falling
            ]
            figures.append(_figures(curve.ranked.roc(weights), settings.targets, fars))
    return [
        (np.array(_figures(curve, settings.targets, fars)), np.array(rows))
        for curve, rows in zip(curves, replicates, strict=True)
    ]


_TIMES_OF_BYTE = np.repeat(np.arange(6, dtype=np.uint8), (94, 95, 46, 16, 4, 1))
"""(256,) times that a comparison counts, by an equally likely byte: mean and variance are one, the
third moment is 0.98, nearly as of a Poisson variable. Source: derived."""


def _times(count: int, method: str, settings: BootstrapSettings) -> Iterator[Counts]:
    """How often each of `count` is drawn in each replicate, and one for what is not drawn."""
    generator = np.random.default_rng(settings.seed)
    times = np.ones(count + 1, dtype=np.uint16)
    for _ in range(settings.replicates):
        if method == "plain":
            drawn = np.frombuffer(generator.bytes(count), dtype=np.uint8)
            times[:-1] = cv2.LUT(drawn, _TIMES_OF_BYTE).ravel()
        else:
            times[:-1] = np.bincount(generator.integers(0, count, count), minlength=count)
        yield times


def _clusters(scores: Scores, method: str) -> tuple[NDArray[np.int64], int]:
    """(N, 1 or 2) what each comparison is drawn with, and how many of them there are; of ``plain``
    those of the smaller class limit what is known.
    """
    require(method in METHODS, f"the bootstrap draws by {', '.join(METHODS)}, not by '{method}'.")
    if method == "plain":
        places = np.arange(scores.label.size)
        return places[:, None], min(scores.genuine.size, scores.impostor.size)
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
    return codes.reshape(ids.codes.shape), used.size


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


_FEW = 5
"""Fingers (subjects, comparisons) below which percentiles of replicates are not trusted alone."""


def _bounds(
    scores: Scores, curve: Roc, method: str, targets: Sequence[float]
) -> dict[str, tuple[float, float]]:
    """How far off rates that rest on few fingers may be; the rate itself if enough were rejected
    and accepted.

    A bootstrap repeats what was seen. Where only some fingers (subjects, comparisons) were ever
    rejected, it knows too little of those that are, and nothing where none was. The limit is then
    that of Clopper and Pearson for as many independent trials as there are fingers, as if all
    comparisons of a finger failed together: cautious, and where nothing failed the rule of three.
    """
    clusters = _clusters(scores, method)[0][scores.label, 0]

    def upper(rate: float, errors: BoolArray, tried: BoolArray) -> float:
        few = np.unique(clusters[errors & tried]).size < _FEW
        return error_bound(rate, np.unique(clusters[tried]).size) if few else rate

    limits = {}
    for name, accepted in _decided(scores, curve, targets).items():
        tried = ~np.isnan(scores.genuine) | (not name.endswith("_made"))
        gar = float(accepted[tried].mean())
        limits[name] = 1.0 - upper(1.0 - gar, ~accepted, tried), upper(gar, accepted, tried)
        if name == "eer":
            equal = curve.equal_error().value
            limits[name] = equal, upper(equal, ~accepted, tried)
    return limits


def _difference_bounds(
    first: Scores, accepted: Sequence[dict[str, BoolArray]], method: str
) -> dict[str, tuple[float, float]]:
    """How far below and above a difference may lie that rests on few fingers, as
    :func:`_bounds`: what one system accepts and the other does not are errors of independent
    trials, either way."""
    clusters = _clusters(first, method)[0][first.label, 0]
    trials = np.unique(clusters).size

    def more(differs: BoolArray) -> float:
        rate = float(differs.mean())
        few = np.unique(clusters[differs]).size < _FEW
        return error_bound(rate, trials) - rate if few else 0.0

    limits = {}
    for name, own in accepted[0].items():
        others = accepted[1][name]
        gained, lost = more(own & ~others), more(others & ~own)
        limits[name] = (-gained, lost) if name == "eer" else (-lost, gained)
    return limits


def _decided(scores: Scores, curve: Roc, targets: Sequence[float]) -> dict[str, BoolArray]:
    """Genuine comparisons (N,) that are accepted where each figure is read."""
    thresholds = {"eer": curve.equal_error().threshold}
    for part, ending in ((curve, ""), (curve.scored(), "_made")):
        for target in targets:
            thresholds[f"gar@{target:g}{ending}"] = part.at_far(target).threshold
    return {
        name: scores.genuine >= (np.inf if value is None else value)
        for name, value in thresholds.items()
    }
