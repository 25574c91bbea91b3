"""How often a finger is among the best k of a gallery that is larger than any that was simulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, binomtest

FRACTION = 0.02
"""Of the impostors' scores, the highest, that the tail is fitted to."""


def tail_probability(impostors: NDArray[np.float32], score: float) -> float:
    """Chance that one more impostor scores at least `score`, given the scores (N,) of many with the same probe.

    Below the highest `FRACTION` it is counted; above, exceedances are taken as exponential (the tail of a normal
    distribution falls faster, so that the chance is rather too high than too low).
    """
    edge = float(np.quantile(impostors, 1.0 - FRACTION))
    if score <= edge:
        return float(np.mean(impostors >= score))
    beyond = impostors[impostors > edge] - edge
    return float(len(beyond) / len(impostors) * np.exp(-(score - edge) / max(float(beyond.mean()), 1e-6)))


def hit_rates(
    chances: NDArray[np.float64], owners: list[str], size: int, ranks: tuple[int, ...], seed: int = 1
) -> dict[str, list[float]]:
    """Mean chance that the right finger is among the best k of a gallery of `size`, and its interval of 95 %.

    Parameters
    ----------
    chances : (N,) for each probe, that one impostor is before the right finger
    owners : (N,) fingers; the bootstrap draws fingers with all their probes
    size : of the gallery
    ranks : k
    seed : of the bootstrap
    """
    names = sorted(set(owners))
    groups = [np.flatnonzero(np.array(owners) == name) for name in names]
    draws = np.random.default_rng(seed).integers(len(groups), size=(1000, len(groups)))
    found = {}
    for k in ranks:
        hit = binom.cdf(k - 1, size - 1, chances)
        sums, counts = (np.array([f(hit[group]) for group in groups]) for f in (np.sum, len))
        means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
        found[str(k)] = [round(float(value), 4) for value in (hit.mean(), *np.quantile(means, [0.025, 0.975]))]
    return found


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Interval of 95 % of a fraction of independent trials, by Wilson's score."""
    found = binomtest(hits, count).proportion_ci(method="wilson")
    return float(found.low), float(found.high)
