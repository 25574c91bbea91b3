"""How well scores tell fingers apart: rates, confidence intervals, identification, protocols."""

from splitknit.evaluation.identification import Cmc, cmc
from splitknit.evaluation.intervals import BootstrapSettings, Interval, Intervals, bootstrap, differences
from splitknit.evaluation.protocol import (
    Comparisons,
    Exclusion,
    average_sessions,
    by_session_pair,
    comparisons,
    exclude,
    scores_of_comparisons,
    session_pairs,
)
from splitknit.evaluation.rates import (
    EqualError,
    Histograms,
    OperatingPoint,
    Roc,
    auc,
    d_prime,
    equal_error,
    gar_at_far,
    histograms,
    roc,
)
from splitknit.evaluation.scores import Ids, Scores, ids_of

__all__ = [
    "BootstrapSettings",
    "Cmc",
    "Comparisons",
    "EqualError",
    "Exclusion",
    "Histograms",
    "Ids",
    "Interval",
    "Intervals",
    "OperatingPoint",
    "Roc",
    "Scores",
    "auc",
    "average_sessions",
    "bootstrap",
    "by_session_pair",
    "cmc",
    "comparisons",
    "d_prime",
    "differences",
    "equal_error",
    "exclude",
    "gar_at_far",
    "histograms",
    "ids_of",
    "roc",
    "scores_of_comparisons",
    "session_pairs",
]
