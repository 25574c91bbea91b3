"""Which candidates are worth a second look: the best, those as good, and the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from splitknit.errors import require

Array = NDArray[np.float64]
OBJECTIVES = {
    "hausdorff": "hausdorff_mm",
    "hausdorff95": "hausdorff95_mm",
    "rms": "rms_mm",
    "whole": "whole_mm",
    "normals": "normals_deg",
}
"""Names on the command line, and of the figures; all are minimised."""


def pareto_front(costs: Array) -> NDArray[np.bool_]:
    """(N,) true where no other row of (N, K) `costs` is at most as large everywhere and smaller somewhere.

    Raises
    ------
    BadInput
        If `costs` is not (N, K) or not finite.
    """
    require(costs.ndim == 2 and costs.shape[1] > 0, f"costs must have the shape (N, K), but it has {costs.shape}.")
    require(bool(np.isfinite(costs).all()), "costs must be finite.")
    front = np.ones(len(costs), dtype=np.bool_)
    for k, row in enumerate(costs):
        front[k] = not bool(((costs <= row).all(axis=1) & (costs < row).any(axis=1)).any())
    return front


def mean_interval(values: Sequence[float] | Array, share: float = 0.95) -> tuple[float, float, float]:
    """Mean of `values` and Student's interval about it; one value alone has no interval: (value, -inf, inf)."""
    numbers = np.asarray(values, dtype=np.float64)
    require(numbers.size > 0, "an interval needs one value at least.")
    mean = float(numbers.mean())
    if numbers.size == 1:
        return mean, -np.inf, np.inf
    half = float(stats.t.ppf(0.5 + 0.5 * share, numbers.size - 1) * numbers.std(ddof=1) / np.sqrt(numbers.size))
    return mean, mean - half, mean + half


def compare_with_best(records: Sequence[dict[str, Any]], objective: str) -> dict[str, dict[str, Any]]:
    """How much worse than the best every candidate is, finger by finger.

    Parameters
    ----------
    records : of :func:`splitknit.rig.evaluate_rig.evaluate`, all of them done and of the same fingers
    objective : name of the figure, as ``hausdorff_mm``

    Returns
    -------
    By name of the candidate: ``value`` and ``low``, ``high`` (95 % interval of the mean over the fingers; None for one
    finger), ``worse_by`` and ``worse_low``, ``worse_high`` (the same of the paired difference from the best), and
    ``as_good``: the interval of the difference holds zero.
    """
    values = {one["candidate"]["name"]: np.array([f[objective] for f in one["fingers"]]) for one in records}
    best = min(values, key=lambda name: (float(values[name].mean()), name))
    compared = {}
    for name, own in values.items():
        mean, low, high = mean_interval(own)
        worse, worse_low, worse_high = mean_interval(own - values[best])
        compared[name] = {
            "value": mean,
            "low": _finite(low),
            "high": _finite(high),
            "worse_by": worse,
            "worse_low": _finite(worse_low),
            "worse_high": _finite(worse_high),
            "as_good": bool(worse_low <= 0.0),
            "best": name == best,
        }
    return compared


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
