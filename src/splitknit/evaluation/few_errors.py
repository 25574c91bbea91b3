"""Rates that rest on a few fingers: how far off they may be.

A bootstrap repeats what was seen. Where only some fingers (subjects, comparisons) were ever rejected, it knows too
little of those that are, and nothing where none was. The limit is then that of Clopper and Pearson for as many
independent trials as there are fingers, as if all comparisons of a finger failed together: cautious, and where nothing
failed the rule of three.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitknit.evaluation import rates
from splitknit.evaluation.error_bounds import error_bound
from splitknit.evaluation.scores import Scores
from splitknit.evaluation.sides import Counting

FEW = 5
"""Fingers (subjects, comparisons) below which percentiles of replicates are not trusted alone."""


def bounds(scores: Scores, method: str, targets: Sequence[float]) -> dict[str, tuple[float, float]]:
    """How low and how high each rate of :class:`splitknit.evaluation.intervals.Layout` may lie for that reason.

    Both are the rate itself where enough fingers (``method``) were rejected and enough accepted.
    """
    genuine, impostor = scores.genuine, np.sort(scores.impostor)
    ordered, drawn = np.sort(genuine), _drawn(scores, method)
    countings: tuple[tuple[Counting, str], ...] = (("all", ""), ("made", "_made"))
    limits = {}
    for counting, ending in countings:
        known = np.ones(genuine.shape, dtype=np.bool_) if counting == "all" else ~np.isnan(genuine)
        tried = drawn[known]
        equal = rates.equal_error(ordered, impostor, counting=counting)
        rejected = known & ~_accepted(genuine, equal.threshold)
        limits[f"eer{ending}"] = equal.value, _upper(equal.value, drawn[rejected], tried)
        for target in targets:
            point = rates.gar_at_far(ordered, impostor, target, counting=counting)
            accepted = _accepted(genuine, point.threshold)
            low = 1.0 - _upper(1.0 - point.gar, drawn[known & ~accepted], tried)
            limits[f"gar@{target:g}{ending}"] = low, _upper(point.gar, drawn[accepted], tried)
    return limits


def _accepted(scores: NDArray[np.float64], threshold: float | None) -> NDArray[np.bool_]:
    return np.asarray(scores >= (np.inf if threshold is None else threshold))


def _upper(rate: float, hit: NDArray[np.int64], tried: NDArray[np.int64]) -> float:
    """Bound of a rate that `hit` of what was `tried` contribute to; the rate itself where they are enough."""
    return error_bound(rate, np.unique(tried).size) if np.unique(hit).size < FEW else rate


def _drawn(scores: Scores, method: str) -> NDArray[np.int64]:
    """(N,) what each genuine comparison is drawn with."""
    ids = {"finger": scores.finger, "subject": scores.subject}.get(method)
    return np.arange(int(scores.label.sum())) if ids is None else ids.codes[scores.label, 0]
