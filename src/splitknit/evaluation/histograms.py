"""Score histograms of both classes over one set of bins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Histograms:
    """Share of the comparisons made in each bin."""

    edges: NDArray[np.float64]
    """(B + 1,)"""
    genuine: NDArray[np.float64]
    """(B,), sums to one."""
    impostor: NDArray[np.float64]


def histograms(genuine: NDArray[np.float64], impostor: NDArray[np.float64], bins: int = 60) -> Histograms:
    """Histograms of scores (N,) and (M,), NaN left out.

    Bins are of equal width; few distinct whole numbers get a bin each, centred on them.
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
    return Histograms(edges, counts[0], counts[1])
