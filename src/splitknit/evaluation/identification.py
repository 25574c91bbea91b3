"""1:N identification: the cumulative match characteristic from the scores of probes with a whole gallery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.evaluation.intervals import FEW
from splitknit.evaluation.rates import error_bound
from splitknit.evaluation.scores import Scores


@dataclass(frozen=True, slots=True, eq=False)
class Cmc:
    """How often the right finger is among the best."""

    rate: NDArray[np.float64]
    """(G,) fraction of probes whose finger is among the first 1 ... G of the gallery."""
    rank: NDArray[np.int64]
    """(P,) of each probe; 0 where it gave no score with its own finger (a failure: never found)."""
    probe_finger: NDArray[np.int64]
    """(P,) code of its finger."""
    gallery: int
    """Fingers in the smallest gallery; ranks are given up to it."""
    left_out: int
    """Probes that were not compared with their whole gallery, or have no finger in it."""


def cmc(scores: Scores) -> Cmc | None:
    """Cumulative match characteristic, closed set; None where the scores are not those of probes with galleries.

    Side b of a comparison is the gallery, one for each session b (the fingers seen there); side a is the
    probe: a finger in session a. Of several scores of a probe with a finger the best counts. The rank of a probe
    is one and the number of *other* fingers with the same score or a higher one, so that ties count against us.

    References
    ----------
    ISO/IEC 19795-1:2021, closed-set identification rank.
    """
    if scores.finger is None:
        return None
    finger, fingers = scores.finger.codes, len(scores.finger.names)
    session = np.zeros_like(finger) if scores.session is None else scores.session.codes
    sessions = int(session.max()) + 1
    probe = (session[:, 0] * sessions + session[:, 1]) * fingers + finger[:, 0]
    score = np.where(np.isnan(scores.score), -np.inf, scores.score)
    order = np.lexsort((-score, finger[:, 1], probe))
    first = np.concatenate(
        [[True], (np.diff(probe[order]) != 0) | (np.diff(finger[order, 1]) != 0)]
    )  # the best of each probe and finger
    order = order[first]
    probe, other, score, label = probe[order], finger[order, 1], score[order], scores.label[order]
    gallery_of = session[order, 1]
    sizes = np.array([np.unique(other[gallery_of == k]).size for k in range(sessions)])
    starts = np.flatnonzero(np.concatenate([[True], np.diff(probe) != 0]))
    complete = np.add.reduceat(np.ones_like(probe), starts) == sizes[gallery_of[starts]]
    own = np.add.reduceat(label.astype(np.int64), starts) == 1
    used = complete & own & (sizes[gallery_of[starts]] > 1)
    if not bool(used.any()):
        return None
    owner = np.repeat(np.arange(starts.size), np.diff(np.append(starts, probe.size)))
    genuine = np.full(starts.size, -np.inf)
    genuine[owner[label]] = score[label]
    ahead = np.add.reduceat(((score >= genuine[owner]) & ~label).astype(np.int64), starts)
    rank = np.where(np.isfinite(genuine), 1 + ahead, 0)[used]
    smallest = int(sizes[gallery_of[starts]][used].min())
    found = np.bincount(rank[(rank > 0) & (rank <= smallest)], minlength=smallest + 1)[1:]
    return Cmc(
        rate=np.cumsum(found) / rank.size,
        rank=rank,
        probe_finger=finger[order, 0][starts][used],
        gallery=smallest,
        left_out=int(starts.size - rank.size),
    )


def rank_one_interval(
    result: Cmc, *, replicates: int = 1000, confidence: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Percentile interval of the fraction found at rank one; the probes' fingers are drawn, the gallery stays."""
    _, finger = np.unique(result.probe_finger, return_inverse=True)
    fingers = int(finger.max()) + 1
    found = np.bincount(finger, weights=result.rank == 1, minlength=fingers)
    number = np.bincount(finger, minlength=fingers)
    drawn = np.random.default_rng(seed).multinomial(fingers, np.full(fingers, 1 / fingers), size=replicates)
    tail = (1 - confidence) / 2
    low, high = np.quantile((drawn @ found) / (drawn @ number), [tail, 1 - tail])
    value = float(np.mean(result.rank == 1))
    if int(np.sum(found < number)) < FEW:  # fingers that were missed
        low = min(float(low), 1.0 - error_bound(1.0 - value, fingers))
    if int(np.sum(found > 0)) < FEW:
        high = max(float(high), error_bound(value, fingers))
    return min(float(low), value), max(float(high), value)
