"""Error rates of a matcher from its genuine and impostor scores: ROC, EER, GAR at FAR, d', AUC.

A higher score means more similar and a pair is accepted if score >= t. A rate is a step function of t that changes
only at scores, so that every figure here is exact and nothing is interpolated. NaN stands for a
comparison that gave no score, a *failure to acquire*, and there are two conventions for counting it:

- ``all``: it is a rejection, as a user at the door sees it. FAR and FRR = 1 - GAR, over all attempts.
- ``made``: it is left out, which judges the matcher alone. FMR and FNMR of ISO/IEC 19795-1, over comparisons made.

With the fraction f of failures on a side, FAR = FMR (1 - f) and FRR = f + FNMR (1 - f).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from splitknit.errors import require

# What the rate of a rare thing may still be.


def rule_of_three(trials: int) -> float:
    """95 % upper bound of the rate of what never happened in so many independent trials, 3 / n."""
    return min(1.0, 3.0 / max(trials, 1))


def error_bound(rate: float, trials: int) -> float:
    """95 % upper bound of a rate from ``rate * trials`` errors in independent trials: the rule of three, then that of
    C. J. Clopper and E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial",
    Biometrika 26(4), 1934.
    """
    errors = rate * trials
    if errors >= trials:
        return 1.0
    return rule_of_three(trials) if errors == 0 else float(betaincinv(errors + 1, trials - errors, 0.95))


# The scores of one class in rising order, and its failures to acquire.


Scores1D = NDArray[np.float64]
Counting = Literal["all", "made"]  # whether failures count as rejections or are left out; see the module's docstring


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """The scores of one class."""

    scores: Scores1D  # (n,) rising, without failures
    failures: int

    def attempts(self, counting: Counting) -> int:
        """What a rate is relative to."""
        return self.scores.size + (self.failures if counting == "all" else 0)


def _sort_scores(scores: Any, name: str = "scores") -> _Side:
    """Scores in rising order, NaN counted and left out; what is sorted already costs next to nothing."""
    array = np.asarray(scores, dtype=np.float64)
    require(array.ndim == 1, f"{name} scores must have the shape (N,), but they have {array.shape}.")
    if array.size and not bool((array[1:] >= array[:-1]).all() and array[-1] == array[-1]):
        array = np.sort(array)  # NaN last
    known = int(np.searchsorted(array, np.nan))
    require(known > 0, f"there is no {name} score: both genuine and impostor scores are needed.")
    require(bool(np.isfinite(array[[0, known - 1]]).all()), f"{name} scores must be finite, but one is infinite.")
    return _Side(array[:known], array.size - known)


SLACK = 1e-12  # relative; 0.001 of 1000 impostors is one, whatever the last bit of 0.001 is


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """Corners of the ROC's staircase from (0, 0) up, (K,) each. From each to the next FAR rises, or GAR, or both at
    once where genuine and impostor scores tie.
    """

    threshold: Scores1D  # falling, the first infinite: nobody is accepted
    far: Scores1D
    gar: Scores1D

    @property
    def frr(self) -> Scores1D:
        """False reject rate, 1 - GAR: over FAR it is the DET curve."""
        return 1.0 - self.gar


@dataclass(frozen=True, slots=True)
class _EqualError:
    """Where FAR and FRR meet."""

    value: float  # (FAR + FRR) / 2 at `threshold`
    far: float
    frr: float
    threshold: float | None  # None where accepting nobody comes closest


@dataclass(frozen=True, slots=True)
class _OperatingPoint:
    """Genuine accept rate at the largest FAR not above a target."""

    target: float
    gar: float
    far: float  # the FAR that is reached, at most the target
    threshold: float | None  # lowest score that is accepted there; None if none is
    false_accepts: int
    resolved: bool  # whether there are impostors enough for one false accept at the target
    far_upper: float | None  # where no impostor was accepted: what the FAR may still be, at 95 % (rule of three)


def roc(genuine: Any, impostor: Any, *, counting: Counting = "all") -> Roc:
    """Corners of the receiver operating characteristic, 2 min(N, M) + 2 at most; axis-parallel lines between them.

    `genuine`, `impostor`: (N,) and (M,) scores, NaN = failure to acquire; `counting`: ``all`` (FAR and GAR) or ``made``
    (FMR and 1 - FNMR). Raises BadInput if a side has no score, or one is infinite.
    """
    g, i = _sort_scores(genuine, "genuine"), _sort_scores(impostor, "impostor")
    fewer = g.scores if g.scores.size <= i.scores.size else i.scores
    anchor = fewer[np.concatenate([[True], fewer[1:] > fewer[:-1]])][::-1]
    # a corner at each anchor score and just above it; then everybody is accepted
    accepted_g, accepted_i = (_around(side.scores, anchor) for side in (g, i))
    lowest = min(g.scores[0], i.scores[0])
    threshold = np.stack([np.nextafter(anchor, np.inf), anchor], axis=1).ravel()
    return Roc(
        np.concatenate([[np.inf], threshold, [lowest]]),
        np.concatenate([[0], accepted_i, [i.scores.size]]) / i.attempts(counting),
        np.concatenate([[0], accepted_g, [g.scores.size]]) / g.attempts(counting),
    )


def equal_error(genuine: Any, impostor: Any, *, counting: Counting = "all") -> _EqualError:
    """Equal error rate, exactly, for step functions.

    With t over all scores and infinity, t1 the largest with FRR(t) <= FAR(t) and t2 the smallest with FRR(t) >= FAR(t),
    that of the two where FAR + FRR is smaller (t1 if neither) is taken, and EER = (FAR + FRR) / 2 there. Where rates
    meet, t1 = t2. Where failures keep FRR above FAR everywhere there is no t1. `genuine`, `impostor`: (N,) and (M,)
    scores, NaN = failure to acquire; `counting`: ``all`` or ``made``. Source: D. Maio et al., "FVC2000: Fingerprint
    Verification Competition", IEEE Transactions on Pattern Analysis and Machine Intelligence 24(3), 2002, section 3.2.

    >>> equal_error([0.9, 0.8, 0.7, 0.3], [0.1, 0.2, 0.4, 0.5]).value
    0.25
    """
    g, i = _sort_scores(genuine, "genuine"), _sort_scores(impostor, "impostor")

    def point(t: float) -> tuple[Fraction, Fraction]:
        far = Fraction(i.scores.size - _below(i.scores, t), i.attempts(counting))
        missed = g.attempts(counting) - g.scores.size
        return far, Fraction(missed + _below(g.scores, t), g.attempts(counting))

    def crossed(t: float) -> bool:
        far, frr = point(t)
        return frr >= far

    t2 = min(_first(g.scores, crossed), _first(i.scores, crossed))
    lower = [side.scores[_below(side.scores, t2) - 1] for side in (g, i) if _below(side.scores, t2) > 0]
    far2, frr2 = point(t2)
    t1 = t2 if far2 == frr2 or not lower else float(max(lower))
    far1, frr1 = point(t1)
    t, far, frr = (t1, far1, frr1) if far1 + frr1 <= far2 + frr2 else (t2, far2, frr2)
    return _EqualError(float((far + frr) / 2), float(far), float(frr), t if np.isfinite(t) else None)


def gar_at_far(genuine: Any, impostor: Any, target: float, *, counting: Counting = "all") -> _OperatingPoint:
    """Genuine accept rate at the largest FAR that is not above `target`, in (0, 1], as fractions; and the threshold.

    k = floor(target M) of M impostors may be accepted. The threshold is the lowest score above the (k + 1)-th largest
    impostor score: ties are accepted together or not at all, so that the FAR may stay below the target. If k = 0 the
    target cannot be resolved; what comes is the GAR at FAR 0. Where no impostor is accepted the FAR may still be 3 / M
    (at 95 %, the rule of three). `genuine`, `impostor`: (N,) and (M,) scores, NaN = failure to acquire; `counting`:
    ``all``, or ``made`` for 1 - FNMR at an FMR. Raises BadInput if `target` lies outside (0, 1], or a class has no
    score. Source: J. A. Hanley, A. Lippman-Hand, "If nothing goes wrong, is everything all right?", JAMA 249(13), 1983.

    >>> gar_at_far([3, 5, 5, 6], [0, 1, 2, 5], 0.5).gar
    1.0
    >>> gar_at_far([3, 5, 5, 6], [0, 1, 2, 5], 0.1).gar
    0.25
    """
    require(0 < target <= 1, f"a FAR target must lie above 0 and not above 1, but it is {target}.")
    g, i = _sort_scores(genuine, "genuine"), _sort_scores(impostor, "impostor")
    attempts = i.attempts(counting)
    allowed = int(target * attempts * (1 + SLACK))
    refused = -np.inf if allowed >= i.scores.size else i.scores[i.scores.size - 1 - allowed]
    starts = [int(np.searchsorted(side.scores, refused, side="right")) for side in (g, i)]
    next_ones = [float(side.scores[k]) for side, k in zip((g, i), starts, strict=True) if k < side.scores.size]
    accepted = int(i.scores.size - starts[1])
    return _OperatingPoint(
        target=float(target),
        gar=(g.scores.size - starts[0]) / g.attempts(counting),
        far=accepted / attempts,
        threshold=min(next_ones, default=None),
        false_accepts=accepted,
        resolved=allowed >= 1,
        far_upper=rule_of_three(attempts) if accepted == 0 else None,
    )


def auc(genuine: Any, impostor: Any) -> float:
    """Area under the ROC of the comparisons made: how likely a genuine score exceeds an impostor one, ties half."""
    g, i = _sort_scores(genuine, "genuine"), _sort_scores(impostor, "impostor")
    few, many, turned = (g, i, False) if g.scores.size <= i.scores.size else (i, g, True)
    twice = np.searchsorted(many.scores, few.scores, side="left").sum(dtype=np.int64)
    twice += np.searchsorted(many.scores, few.scores, side="right").sum(dtype=np.int64)
    fraction = int(twice) / (2 * g.scores.size * i.scores.size)
    return 1.0 - fraction if turned else fraction


def d_prime(genuine: Any, impostor: Any) -> float | None:
    """Distance of the means over the root mean square of the standard deviations; None if no score varies.

    d' = (m_g - m_i) / sqrt((s_g^2 + s_i^2) / 2), of the comparisons made. Unlike the other figures it depends on the
    scores' scale, and it is negative if genuine scores are the lower ones. Source: J. Daugman, "Biometric decision
    landscapes", technical report 482, University of Cambridge, 2000.
    """
    g, i = _sort_scores(genuine, "genuine").scores, _sort_scores(impostor, "impostor").scores
    largest = max(abs(g[0]), abs(g[-1]), abs(i[0]), abs(i[-1]))
    if min(g[0], i[0]) == max(g[-1], i[-1]) or largest == 0:
        return None
    g, i = g / largest, i / largest
    variances = [0.0 if side[0] == side[-1] else float(np.var(side)) for side in (g, i)]
    spread = float(np.sqrt(sum(variances) / 2))
    return float((np.mean(g) - np.mean(i)) / spread) if spread > 0 else None


def _around(scores: Scores1D, anchor: Scores1D) -> NDArray[np.int64]:
    """Number of scores above each anchor, and not below it, in turns: (2 K,)."""
    above = scores.size - np.searchsorted(scores, anchor, side="right")
    least = scores.size - np.searchsorted(scores, anchor, side="left")
    return np.stack([above, least], axis=1).ravel()


def _below(scores: Scores1D, t: float) -> int:
    return int(np.searchsorted(scores, t, side="left"))


def _first(scores: Scores1D, holds: Callable[[float], bool]) -> float:
    """The lowest score for which a condition holds that, once true, stays true; infinity if there is none."""
    k = bisect_left(range(scores.size), True, key=lambda index: holds(float(scores[index])))
    return float(scores[k]) if k < scores.size else float("inf")


# Score histograms of both classes over one set of bins.


def histograms(genuine: Scores1D, impostor: Scores1D, bins: int = 60) -> tuple[Scores1D, Scores1D, Scores1D]:
    """Histograms of scores (N,) and (M,), NaN left out: edges (B + 1,) of the bins, and the fraction of each class in
    each, (B,). Bins are of equal width; few distinct whole numbers get a bin each, centred on them.
    """
    sides = [side[~np.isnan(side)] for side in (genuine, impostor)]
    low, high = min(float(side.min()) for side in sides), max(float(side.max()) for side in sides)
    whole = high - low < bins and all(bool((side == np.round(side)).all()) for side in sides)
    if whole:
        edges = np.arange(low - 0.5, high + 1.0)
    elif high > low:
        edges = low + (high - low) * np.linspace(0.0, 1.0, bins + 1)
        edges[-1] = high
    else:
        edges = np.array([low - 0.5, low + 0.5])
    if not bool((np.diff(edges) > 0).all()):  # scores so close that their bins have no width
        edges = np.unique(np.concatenate([edges, [np.nextafter(edges[-1], np.inf)]]))
    counts = [np.histogram(side, edges)[0] / side.size for side in sides]
    return edges, counts[0], counts[1]
