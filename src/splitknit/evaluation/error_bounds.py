"""What the rate of a rare thing may still be."""

from __future__ import annotations

from scipy.special import betaincinv


def rule_of_three(trials: int) -> float:
    """95 % upper bound of the rate of what never happened in so many independent trials, 3 / n."""
    return min(1.0, 3.0 / max(trials, 1))


def error_bound(rate: float, trials: int, confidence: float = 0.95) -> float:
    """Upper bound of a rate from a few errors in independent trials: the rule of three, continued.

    ``rate * trials`` errors were seen, not necessarily a whole number. The bound is that of Clopper and Pearson.

    References
    ----------
    C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial",
    Biometrika 26(4), 1934.
    """
    errors = rate * trials
    if errors >= trials:
        return 1.0
    return rule_of_three(trials) if errors == 0 else float(betaincinv(errors + 1, trials - errors, confidence))
