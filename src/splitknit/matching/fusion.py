"""Ridges and minutiae of two prints as one score: a log-likelihood ratio, with constants from simulated presses."""

from __future__ import annotations

import math
from dataclasses import dataclass

from splitknit.matching.minutiae import installed, minutiae_match
from splitknit.matching.ridge import Prepared, RidgeMatch, ridge_match
from splitknit.matching.template import Template

# Slopes and offsets of logistic regressions, both classes of equal weight, on simulated presses: `fitted` in
# validation/match/real_prints.json, made by validation/match/real_prints.py.
_BOTH = (0.1917, 22.2986, -9.8619)
"""Of bozorth3's score, of the similarity of ridges, offset."""
_MINUTIAE_ALONE = (0.2274, -4.7266)
_RIDGES_ALONE = (30.7494, -8.0142)


@dataclass(frozen=True, slots=True)
class _FusedMatch:
    """How similar two prints are."""

    similarity: float
    """Natural logarithm of the likelihood ratio; that of the lowest scores where neither method could compare."""
    minutiae: float | None
    """Score of bozorth3; None where a side has fewer than ten minutiae."""
    ridge: RidgeMatch

    @property
    def compared(self) -> bool:
        """False where neither method could compare."""
        return self.ridge.compared or self.minutiae is not None


def fused_similarity(minutiae: float, ridge: float) -> float:
    """Log-likelihood ratio (natural logarithm) of bozorth3's score and the ridges' similarity.

    Parameters
    ----------
    minutiae : score of :func:`splitknit.matching.minutiae.minutiae_match`, NaN where there is none
    ridge : similarity of :func:`splitknit.matching.ridge.ridge_match`, NaN where there is none

    Returns
    -------
    float
        Positive where simulated presses of one finger give such scores more often than those of two. Where one score
        is missing the other counts alone, where both are the result is NaN.

    References
    ----------
    A. Ross, K. Nandakumar and A. Jain, "Handbook of Multibiometrics", Springer 2006, chapter 4 (fusion by logistic
    regression); N. Brummer and J. du Preez, "Application-independent evaluation of speaker detection", Computer Speech
    and Language 20, 2006 (scores as log-likelihood ratios).

    Examples
    --------
    >>> fused_similarity(40, 0.5) > 0 > fused_similarity(6, 0.22)
    True
    """
    if math.isnan(minutiae):
        return _RIDGES_ALONE[0] * ridge + _RIDGES_ALONE[1]
    if math.isnan(ridge):
        return _MINUTIAE_ALONE[0] * minutiae + _MINUTIAE_ALONE[1]
    return _BOTH[0] * minutiae + _BOTH[1] * ridge + _BOTH[2]


def can_fuse(*templates: Template) -> bool:
    """Whether all have minutiae and these can be compared here (nbis-py is installed)."""
    return all(one.minutiae is not None for one in templates) and installed()


def fused_match(a: Template | Prepared, b: Template | Prepared) -> _FusedMatch:
    """Compare two prints by their ridges and their minutiae.

    Parameters
    ----------
    a, b : Template or Prepared
        With minutiae, as :func:`splitknit.matching.inputs.print_template` makes them.

    Raises
    ------
    BadInput
        As :func:`splitknit.matching.ridge.ridge_match`, or if `nbis-py` is not installed.
    """
    found = ridge_match(a, b)
    sides = [(side.template if isinstance(side, Prepared) else side).minutiae for side in (a, b)]
    first, second = sides
    score = None
    if first is not None and second is not None and first.acquired and second.acquired:
        score = minutiae_match(first, second)
    if score is None and not found.compared:
        return _FusedMatch(fused_similarity(0.0, found.similarity), None, found)
    missing = float("nan")
    joined = fused_similarity(missing if score is None else score, found.similarity if found.compared else missing)
    return _FusedMatch(joined, score, found)
