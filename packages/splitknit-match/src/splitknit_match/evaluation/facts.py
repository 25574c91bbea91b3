"""One system of an evaluation: its intervals, 1:N identification (the CMC), and what a reader has to know of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit_match.evaluation import rates
from splitknit_match.evaluation.intervals import CONFIDENCE, FEW, Interval, Intervals
from splitknit_match.evaluation.rates import error_bound, rule_of_three
from splitknit_match.evaluation.scores import Scores


@dataclass(frozen=True, slots=True, eq=False)
class Cmc:
    """How often the right finger is among the best."""

    rate: NDArray[np.float64]  # (G,) fraction of probes whose finger is among the first 1 ... G of the gallery
    rank: NDArray[np.int64]  # (P,) of each probe; 0 where it gave no score with its own finger (a failure: never found)
    probe_finger: NDArray[np.int64]  # (P,) code of its finger
    gallery: int  # fingers in the smallest gallery; ranks are given up to it
    left_out: int  # probes that were not compared with their whole gallery, or have no finger in it


def cmc(scores: Scores) -> Cmc | None:
    """Cumulative match characteristic, closed set; None where the scores are not those of probes with galleries.

    Side b of a comparison is the gallery, one for each session b (the fingers seen there); side a is the probe: a
    finger in session a. Of several scores of a probe with a finger the best counts. The rank of a probe is one and the
    number of *other* fingers with the same score or a higher one, so that ties count against us. Source: ISO/IEC
    19795-1:2021, closed-set identification rank.
    """
    if scores.finger is None:
        return None
    if scores.session is not None and not bool((scores.session.same & scores.label).any()):
        scores = scores.taken(~scores.session.same)  # impostors within a session are not a search
    assert scores.finger is not None
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


def rank_one_interval(result: Cmc, *, replicates: int = 1000, seed: int = 0) -> tuple[float, float]:
    """Percentile interval of the fraction found at rank one; the probes' fingers are drawn, the gallery stays."""
    _, finger = np.unique(result.probe_finger, return_inverse=True)
    fingers = int(finger.max()) + 1
    found = np.bincount(finger, weights=result.rank == 1, minlength=fingers)
    number = np.bincount(finger, minlength=fingers)
    drawn = np.random.default_rng(seed).multinomial(fingers, np.full(fingers, 1 / fingers), size=replicates)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile((drawn @ found) / (drawn @ number), [tail, 1 - tail])
    value = float(np.mean(result.rank == 1))
    if int(np.sum(found < number)) < FEW:  # fingers that were missed
        low = min(float(low), 1.0 - error_bound(1.0 - value, fingers))
    if int(np.sum(found > 0)) < FEW:
        high = max(float(high), error_bound(value, fingers))
    return min(float(low), value), max(float(high), value)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One system with its intervals."""

    scores: Scores
    primary: str  # the scheme of drawing whose intervals stand in the first place
    by_method: Mapping[str, Intervals]

    @property
    def intervals(self) -> Intervals:
        """Those of the primary scheme."""
        return self.by_method[self.primary]

    @property
    def eer(self) -> Interval:
        """Equal error rate; failures to acquire count as rejections."""
        return self.intervals.figures["eer"]

    @property
    def auc(self) -> Interval:
        """Area under the ROC curve."""
        return self.intervals.figures["auc"]

    def gar_at(self, far: float) -> Interval:
        """Genuine accept rate at a FAR: 0.01, 0.001, 0.0001, or those that the bootstrap's settings name."""
        return self.intervals.figures[f"gar@{far:g}"]


def notes_of(result: Result, *, variant: bool) -> list[str]:
    """What a reader of a system's figures has to know; of a variant, only what its system's notes do not contain."""
    scores, name = result.scores, result.scores.name
    genuine, impostor = np.sort(scores.genuine), np.sort(scores.impostor)
    notes = []
    missing = int(np.isnan(scores.score).sum())
    if missing and not variant:
        none = f"{missing} of {scores.score.size} comparisons gave no score"
        counted = "FAR and GAR count them as rejections, FMR and FNMR leave them out."
        notes.append(f"{name}: {none}. {counted}")
    gars = [key for key in result.intervals.figures if key.startswith("gar@") and not key.endswith("_made")]
    points = {key: rates.gar_at_far(genuine, impostor, float(key[4:])) for key in gars}
    lost = [point.target for point in points.values() if not point.resolved]
    if lost:
        fars = " or ".join(f"{100 * target:g} %" for target in lost)
        needed = " or ".join(f"{int(np.ceil(1 / target)):,}" for target in lost)
        notes.append(
            f"{name}: {impostor.size} impostor comparisons cannot resolve a FAR of {fars} ({needed} are needed for one "
            "false accept). The GAR is that at FAR 0, where the FAR may in truth be up to "
            f"{100 * rule_of_three(impostor.size):.2g} % (95 %, rule of three)."
        )
    if variant:
        return notes
    if rates.auc(genuine, impostor) < 0.5:
        cure = "if they are distances, use `dissimilarity`."
        notes.append(f"{name}: genuine scores are lower than impostor ones; {cure}")
    notes += _width_note(result)
    drawn = result.intervals.drawn
    if drawn < 20:
        notes.append(f"{name}: only {drawn} to draw from ({result.primary}), so that its intervals are rough.")
    return notes


def _width_note(result: Result) -> list[str]:
    """Whether drawing by subject is less certain by far than what stands in the first place."""
    other = result.by_method.get("subject")
    if other is None or result.primary == "subject":
        return []
    widths = [found.figures["eer"].high - found.figures["eer"].low for found in (other, result.intervals)]
    if result.intervals.figures["eer"].value == 0 or widths[1] <= 0 or widths[0] < 1.3 * widths[1]:
        return []
    wider = f"drawn by subject the interval of the EER is {widths[0] / widths[1]:.1f} times as wide"
    alike = "so that fingers of one subject are similarly hard; trust the wider one."
    return [f"{result.scores.name}: {wider}, {alike}"]
