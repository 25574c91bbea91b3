"""How far from the truth an estimate may be: from a covariance to one number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2


def radius_95(covariance: NDArray[np.float64]) -> float:
    """Radius about the estimate within which the truth lies with 95 % probability.

    Parameters
    ----------
    covariance : (D, D) of a normal error, singular ones too

    Notes
    -----
    The squared length of the error is a sum of squared normal numbers of unequal variance. Its quantile is that of a
    scaled chi-squared number of the same mean and variance (Satterthwaite 1946, Patnaik 1949), right
    within 4 % of the radius.

    Examples
    --------
    >>> round(radius_95(np.eye(2)), 3)
    2.448
    """
    values = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    total = float(values.sum())
    if total <= 0:
        return 0.0
    squares = float((values**2).sum())
    return float(np.sqrt(squares / total * chi2.ppf(0.95, total * total / squares)))
