"""Minutiae and ridges of pressed prints joined into one score, with constants from simulated presses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from splitknit.settings import Checked, Limits


@dataclass(frozen=True, slots=True)
class JoinedSettings(Checked):
    """Means and deviations of both scores over genuine and impostor pairs of simulated presses.

    Fitted by validation/match/real_prints.py (``fitted`` in its ``real_prints.json``): 12 fingers, 4 presses of each,
    72 genuine and 600 impostor pairs.
    """

    minutiae_mean: float = 12.7902
    """Mean of bozorth3's score."""
    minutiae_deviation: Annotated[float, Limits(0, above=True)] = 23.7006
    """Standard deviation of bozorth3's score, positive."""
    ridge_mean: float = 0.2081
    """Mean of the ridges' similarity."""
    ridge_deviation: Annotated[float, Limits(0, above=True)] = 0.0874
    """Standard deviation of the ridges' similarity, positive."""


def joined_similarity(minutiae: float, ridge: float, settings: JoinedSettings | None = None) -> float:
    """Mean of the z-scores of bozorth3's score and the ridges' similarity; NaN stands for a method that failed.

    Higher is more alike; other fingers lie about 0. Where one method failed the other one speaks alone, where both did
    the result is NaN.

    Examples
    --------
    >>> round(joined_similarity(40, 0.5), 2) > 1 > round(joined_similarity(6, 0.22), 2)
    True

    References
    ----------
    A. Ross and A. Jain, "Information fusion in biometrics", Pattern Recognition Letters 24, 2003 (sum rule); R. Snelick
    et al., IEEE TPAMI 27, 2005 (z-score).
    """
    s = settings or JoinedSettings()
    scores = np.array([(minutiae - s.minutiae_mean) / s.minutiae_deviation, (ridge - s.ridge_mean) / s.ridge_deviation])
    known = scores[~np.isnan(scores)]
    return float(known.mean()) if known.size else float("nan")
