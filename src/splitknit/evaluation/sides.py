"""The scores of one class in rising order, and its failures to acquire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

Scores1D = NDArray[np.float64]
Counting = Literal["all", "made"]
"""Whether failures count as rejections or are left out; see :mod:`splitknit.evaluation.rates`."""


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The scores of one class."""

    scores: Scores1D
    """(n,) rising, without failures."""
    failures: int

    def attempts(self, counting: Counting) -> int:
        """What a rate is relative to."""
        return self.scores.size + (self.failures if counting == "all" else 0)


def sort_scores(scores: Any, name: str = "scores") -> Side:
    """Scores in rising order, NaN counted and left out; what is sorted already costs next to nothing."""
    array = np.asarray(scores, dtype=np.float64)
    require(array.ndim == 1, f"{name} scores must have the shape (N,), but they have {array.shape}.")
    if array.size and not bool((array[1:] >= array[:-1]).all() and array[-1] == array[-1]):
        array = np.sort(array)  # NaN last
    known = int(np.searchsorted(array, np.nan))
    require(known > 0, f"there is no {name} score: both genuine and impostor scores are needed.")
    require(bool(np.isfinite(array[[0, known - 1]]).all()), f"{name} scores must be finite, but one is infinite.")
    return Side(array[:known], array.size - known)
