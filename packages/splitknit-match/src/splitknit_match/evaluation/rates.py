"""Error rates of a matcher from its genuine and impostor scores: ROC, EER, GAR at FAR, d', AUC.

A higher score means more similar, and a pair is accepted if score >= t. A rate is a step function
of t that changes only at scores, so that every figure here is exact and nothing is interpolated. A
comparison counts as often as its weight says: once in the figures, as often as it was drawn in a
replicate of the bootstrap.

NaN stands for a comparison that gave no score, a *failure to acquire*. It is a rejection, as a user
at the door sees it (FAR and FRR = 1 - GAR, over all attempts). :meth:`Roc.scored` leaves it out and
judges the matcher alone (FMR and FNMR of ISO/IEC 19795-1). With the fraction f of failures on a
side, FAR = FMR (1 - f) and FRR = f + FNMR (1 - f).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from splitknit.errors import require
from splitknit.model import Array

Values = Array
Indices = NDArray[np.int64]
Counts = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class EqualError:
    """Where FAR and FRR meet."""

    value: float  # (FAR + FRR) / 2 at `threshold`
    far: float
    frr: float
    threshold: float | None  # None where accepting nobody comes closest


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """Genuine accept rate at the largest FAR not above a target."""

    target: float
    gar: float
    far: float  # the FAR that is reached, at most the target
    threshold: float | None  # lowest score that is accepted there; None if none is
    false_accepts: int
    resolved: bool  # whether there are impostors enough for one false accept at the target
    # where no impostor was accepted: what the FAR may still be, at 95 % (rule of three)
    far_upper: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Ranked:
    """Scores of both classes in falling order, failures last, so that weights make a ROC without
    sorting."""

    order: tuple[Indices, Indices]  # (N,) and (M,) places of genuine and impostor comparisons
    # mean of each class, lowest of all scores 0 and highest 1
    mean: tuple[float, float]
    # (2, N) and (2, M) distances of the scores that there are, falling, from it, and their squares
    powers: tuple[Values, Values]
    threshold: Values  # (K,) falling; the first is infinite: nobody is accepted
    accepted: Indices  # (2, K) how many genuine and impostor comparisons each threshold accepts
    corners: Indices  # thresholds that accept more genuine comparisons than the one before

    def roc(self, weights: Sequence[Counts]) -> Roc:
        """ROC where the comparisons of each class, falling, count `weights` (N,) and (M,) times."""
        sums = [np.zeros(weight.size + 1, dtype=np.int32) for weight in weights]
        for weight, total in zip(weights, sums, strict=True):
            np.cumsum(weight, out=total[1:])
        genuine, impostor = sums
        return Roc(self, weights, (genuine, impostor), (float(genuine[-1]), float(impostor[-1])))


_SLACK = 1e-12
"""Relative slack of rates: 0.001 of 1000 impostors is one, whatever the last bit of 0.001 is."""


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """What each threshold accepts. From each to the next FAR rises, or GAR, or both where scores
    tie."""

    ranked: Ranked
    weights: Sequence[Counts]  # (N,) and (M,)
    # (N + 1,) and (M + 1,) weight of the highest 0, 1, 2 ... comparisons of each class
    sums: tuple[NDArray[np.int32], NDArray[np.int32]]
    tried: tuple[float, float]  # genuine and impostor comparisons that a rate is relative to

    def accepted(self, side: int, places: Any = slice(None)) -> Any:
        """Weight of the genuine (0) or impostor (1) comparisons that thresholds accept."""
        return self.sums[side][self.ranked.accepted[side, places]]

    @property
    def gar(self) -> Values:
        """(K,) genuine accept rate."""
        return np.asarray(self.accepted(0) / self.tried[0])

    @property
    def far(self) -> Values:
        """(K,) false accept rate."""
        return np.asarray(self.accepted(1) / self.tried[1])

    def scored(self) -> Roc:
        """Rates of the comparisons that gave a score: 1 - FNMR over FMR."""
        return replace(self, tried=(float(self.accepted(0, -1)), float(self.accepted(1, -1))))

    def equal_error(self) -> EqualError:
        """Equal error rate.

        The two thresholds beside the crossing of FAR and FRR are compared, and that where FAR + FRR
        is smaller is taken; where rates meet, it is that threshold. Source: D. Maio et al.,
        "FVC2000: Fingerprint Verification Competition", IEEE Transactions on Pattern Analysis and
        Machine Intelligence 24(3), 2002, section 3.2.

        >>> roc([0.9, 0.8, 0.7, 0.3], [0.1, 0.2, 0.4, 0.5]).equal_error().value
        0.25
        """
        # rates are compared as products of whole numbers, which are exact
        genuine, impostor = self.tried

        def errors(place: int) -> tuple[float, float]:
            return self.accepted(1, place) * genuine, (genuine - self.accepted(0, place)) * impostor

        def crossed(place: int) -> bool:
            false_accepts, false_rejects = errors(place)
            return bool(false_rejects <= false_accepts)

        last = self.ranked.threshold.size - 1
        place = min(bisect_left(range(last + 1), True, key=crossed), last)
        far, frr = errors(place)
        if far > frr and sum(errors(place - 1)) < far + frr:
            place -= 1
            far, frr = errors(place)
        whole = genuine * impostor
        value = float((far + frr) / (2 * whole))
        return EqualError(value, float(far / whole), float(frr / whole), self._threshold(place))

    def places(self, targets: Sequence[float] | Values) -> Indices:
        """Last threshold whose FAR is not above each target. Ties are accepted together or not at
        all."""
        allowed = np.array(targets) * self.tried[1] * (1 + _SLACK)
        most = np.searchsorted(self.sums[1], allowed.astype(np.int32), side="right") - 1
        return np.searchsorted(self.ranked.accepted[1], most, side="right") - 1

    def gars(self, targets: Sequence[float] | Values) -> list[float]:
        """Genuine accept rate at the largest FAR not above each target."""
        return [float(gar) for gar in self.accepted(0, self.places(targets)) / self.tried[0]]

    def at_far(self, target: float) -> OperatingPoint:
        """Operating point at the largest FAR that is not above `target`, in (0, 1].

        With fewer than 1 / target impostors the target cannot be resolved; what comes is the GAR at
        FAR 0. Where none of M impostors is accepted the FAR may still be 3 / M. Source: J. A.
        Hanley, A. Lippman-Hand, "If nothing goes wrong, is everything all right?", JAMA 249(13),
        1983.

        >>> roc([3, 5, 5, 6], [0, 1, 2, 5]).at_far(0.5).gar
        1.0
        """
        require(
            0 < target <= 1, f"a FAR target must lie above 0 and not above 1, but it is {target}."
        )
        place = int(self.places([target])[0])
        accepted = int(self.accepted(1, place))
        return OperatingPoint(
            target=float(target),
            gar=float(self.accepted(0, place) / self.tried[0]),
            far=accepted / self.tried[1],
            threshold=self._threshold(place),
            false_accepts=accepted,
            resolved=target * self.tried[1] * (1 + _SLACK) >= 1,
            far_upper=error_bound(0.0, int(self.tried[1])) if accepted == 0 else None,
        )

    def _threshold(self, place: int) -> float | None:
        return float(self.ranked.threshold[place]) if place else None

    def auc(self) -> float:
        """Area under the ROC of the comparisons made: how likely a genuine score exceeds an
        impostor one, ties half."""
        at, before = self.ranked.corners, self.ranked.corners - 1
        more = self.accepted(0, at) - self.accepted(0, before)
        above = self.accepted(1, at) + self.accepted(1, before)
        genuine, impostor = self.scored().tried
        return float(np.sum(more * (2 * impostor - above)) / (2 * genuine * impostor))

    def d_prime(self) -> float:
        """Distance of the means over the root mean square of the standard deviations; NaN if no
        score varies.

        d' = (m_g - m_i) / sqrt((s_g^2 + s_i^2) / 2), of the comparisons made. Unlike the other
        figures it depends on the scores' scale. Source: J. Daugman, "Biometric decision
        landscapes", technical report 482, University of Cambridge, 2000.
        """
        moments = [
            powers @ weight[: powers.shape[1]].astype(float) / tried
            for powers, weight, tried in zip(
                self.ranked.powers, self.weights, self.scored().tried, strict=True
            )
        ]
        (shift_g, square_g), (shift_i, square_i) = moments
        variance = (square_g - shift_g**2 + square_i - shift_i**2) / 2
        if variance < 1e-14 * (square_g + square_i) or variance < 1e-18:  # no more than rounding
            return float("nan")
        mean_g, mean_i = self.ranked.mean
        return float((mean_g + shift_g - mean_i - shift_i) / np.sqrt(variance))


def rank(genuine: Values, impostor: Values) -> Ranked:
    """Sort scores (N,) and (M,); NaN is a failure to acquire."""
    orders = np.argsort(-genuine, kind="stable"), np.argsort(-impostor, kind="stable")  # NaN last
    falling = [
        side[order][: np.count_nonzero(~np.isnan(side))]
        for side, order in zip((genuine, impostor), orders, strict=True)
    ]
    threshold = np.union1d(*falling)[::-1]
    counts = [np.searchsorted(-side, -threshold, side="right") for side in falling]
    accepted = np.vstack(counts)
    accepted = np.insert(accepted, 0, 0, axis=1)
    corners = 1 + np.flatnonzero(np.diff(accepted[0]))
    low, span = threshold[-1], float(np.ptp(threshold)) or 1.0
    scaled = [(side - low) / span for side in falling]
    mean = float(scaled[0].mean()), float(scaled[1].mean())
    first, second = (side - middle for side, middle in zip(scaled, mean, strict=True))
    powers = np.stack([first, first**2]), np.stack([second, second**2])
    return Ranked(orders, mean, powers, np.append(np.inf, threshold), accepted, corners)


def roc(genuine: Any, impostor: Any) -> Roc:
    """Receiver operating characteristic of scores (N,) and (M,), NaN = failure to acquire. Raises
    BadInput if a side has no score, or one is infinite.
    """
    sides = [np.asarray(side, dtype=float) for side in (genuine, impostor)]
    for side, name in zip(sides, ("genuine", "impostor"), strict=True):
        require(
            not np.isnan(side).all() and not np.isinf(side).any(),
            f"{name} scores must be finite numbers, or NaN where there is none; one is needed at"
            " least.",
        )
    return rank(*sides).roc([np.ones(side.size, dtype=np.uint16) for side in sides])


CONFIDENCE = 0.95  # confidence of all intervals


def error_bound(rate: float, trials: int) -> float:
    """95 % upper bound of a rate from ``rate * trials`` errors in independent trials: of none 3 / n
    (the rule of three), else that of C. J. Clopper and E. S. Pearson, "The use of confidence or
    fiducial limits illustrated in the case of the binomial", Biometrika 26(4), 1934.
    """
    errors = rate * trials
    if errors >= trials:
        return 1.0
    return (
        min(1.0, 3.0 / trials)
        if errors == 0
        else float(betaincinv(errors + 1, trials - errors, CONFIDENCE))
    )
