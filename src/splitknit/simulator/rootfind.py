"""Root finding along many rays at once: the first crossing, never a later one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Gap = Callable[[NDArray[np.intp], Array], Array]
"""Gap of the rays with the given indices at the given depths; positive outside."""


def first_root(gap: Gap, start: Array, bound: Array, *, careful: int) -> tuple[Array, NDArray[np.bool_]]:
    """Find where `gap` (positive at `start`) first falls to zero with growing depth.

    `careful` steps of gap / bound come first, then secants, never shorter than a growing micrometre, so that a ridge
    that is only touched is passed. Once the sign has changed: regula falsi and, every third time, bisection.

    Parameters
    ----------
    gap
        Function to search, for (N,) rays.
    start
        (N,) depths outside.
    bound
        (N,) how fast the gap can fall, per depth.

    Returns
    -------
    (N,) depths, and where a root was found.
    """
    result, met = start.copy(), np.zeros(start.size, dtype=np.bool_)
    active = np.arange(start.size)
    nowhere = np.full(start.size, np.nan)
    state = np.stack([start, gap(active, start), nowhere, nowhere, bound, bound])
    for k in range(64):
        outer, outer_gap, inner, inner_gap, slope, limit = state
        bracketed = np.isfinite(inner)
        inside = 0.5 * (inner - outer) if k % 3 == 2 else (inner - outer) * outer_gap / (outer_gap - inner_gap)
        trial = outer + np.where(bracketed, inside, np.clip(outer_gap / slope, np.minimum(1e-3 * 1.15**k, 0.3), 0.3))
        now = gap(active, trial)
        done = np.abs(now) < 1e-6
        result[active[done]], met[active[done]] = trial[done], True
        outside = now > 0
        fall = (outer_gap - now) / np.maximum(trial - outer, 1e-12)
        slope = np.where(outside & (k >= careful), np.clip(fall, 0.3 * limit, limit), limit)
        state = np.stack(
            [
                np.where(outside, trial, outer), np.where(outside, now, outer_gap),
                np.where(outside, inner, trial), np.where(outside, inner_gap, now),
                slope, limit,
            ]
        )  # fmt: skip
        keep = ~done & (np.abs(trial) < 4.0)
        active, state = active[keep], state[:, keep]
        if active.size == 0:
            break
    return result, met


def polish(gap: Gap, depth: Array, facing: Array, met: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Refine roots by up to three secants on `gap`; returns (N,) depths and where they settled.

    Parameters
    ----------
    facing
        (N,) typical slope of the gap, for the first step.
    met
        (N,) which entries of `depth` to refine.
    """
    result, close = depth.copy(), np.zeros(depth.size, dtype=np.bool_)
    active = np.nonzero(met)[0]
    state = np.stack([depth[active], gap(active, depth[active]), np.maximum(facing[active], 0.05)])
    for _ in range(4):
        before, before_gap, slope = state
        done = np.abs(before_gap) < 2e-6
        result[active[done]], close[active[done]] = before[done], True
        active, state = active[~done], state[:, ~done]
        if active.size == 0:
            break
        before, before_gap, slope = state
        trial = before + np.clip(before_gap / slope, -0.05, 0.05)
        now = gap(active, trial)
        fall = (before_gap - now) / np.where(trial == before, 1.0, trial - before)
        state = np.stack([trial, now, np.where(fall > 0.05 * slope, fall, slope)])
    return result, close
