"""From distances to scores, and from scores to rates.

The thesis's score (5.2) grows with distance; here it is called what it is, a dissimilarity, and
turned round at the edge: everywhere else a higher score means more similar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from splitknit.errors import refusing, require
from splitknit.io.fields import read_json
from splitknit.model import Array
from splitknit_match.matching.results import FmrBasis


def dissimilarity(ratio: float, distances: ArrayLike) -> float:
    """(5.2): exp(-ratio^4 / sum of distances), in [0, 1); 0 for distance 0.

    Raises BadInput if `ratio` is not in (0, 1] or a distance is negative or not finite.
    """
    total = float(np.sum(np.asarray(distances, dtype=float)))
    return math.exp(-(ratio**4) / total) if total > 0 else 0.0


TAIL = 50  # impostors by which rates are extrapolated, in impostors
FMR_ROUNDING = 1e-5
"""Similarities are lowered by this before a rate is looked up, so that none comes out too low by
rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class FmrTable:
    """False match rate as a function of the similarity, from impostor scores."""

    similarity: Array
    """(K,) rising."""
    fmr: Array
    """(K,) falling; rate of impostor scores at or above `similarity`."""
    impostors: int
    """Comparisons behind it: no rate below 1 / (impostors + 1) is ever stated."""
    population: str = ""
    """Whose fingers were compared."""
    rated_mm2: float = 0.0
    """Where less overlaps, no rate is stated."""
    excluded_mm2: float = 0.0
    """Where less overlaps, no finger is excluded."""
    method: str = ""
    """Of ``match``, whose scores were measured."""

    @property
    def smallest(self) -> float:
        """The smallest rate that it can state: none of its impostors is as similar."""
        return float(self.fmr.min())

    @property
    def basis(self) -> FmrBasis:
        """What the rates were measured on."""
        return FmrBasis(self.impostors, self.population, self.smallest)

    def threshold(self, fmr: float) -> float:
        """Smallest similarity (in steps of 1e-5) at which the rate of false matches is `fmr` or
        less.

        A smaller one than was measured is extrapolated. Raises BadInput if it is less than a
        hundredth of that.
        """
        limit = 0.01 * self.smallest
        require(
            fmr >= limit,
            f"rates below {limit:.2g} cannot be estimated from {self.impostors} impostors; choose"
            f" `fmr` >= {limit:.2g} (you gave {fmr:g}).",
        )
        measured = float(self.similarity[np.argmax(self.fmr <= fmr)])
        exact = measured if fmr >= self.smallest else self.beyond(fmr)[0]
        return (math.ceil(exact / FMR_ROUNDING) + 1) * FMR_ROUNDING

    def beyond(self, fmr: float) -> tuple[float, float]:
        """Similarity at which a smaller rate than was measured is reached, and the rate that is to
        be expected there.

        Beyond the most similar impostor the tail goes on as an exponential, whose mean is that of
        the `TAIL` impostors before. `fmr` is the upper limit of 95 %, of this mean and of the
        number of impostors there.
        """
        from scipy.stats import chi2  # measured rates need none of it

        first = int(np.searchsorted(-self.fmr * (self.impostors + 1), -(TAIL + 1.0)))
        first = min(first, len(self.fmr) - 2)
        count = max(float(self.fmr[first]) * (self.impostors + 1) - 1, 1.0)
        mean = float(self.fmr[first:-1] @ np.diff(self.similarity[first:])) / float(self.fmr[first])
        high = 2 * count * mean / float(chi2.ppf(0.025, 2 * count))
        last = float(self.similarity[-1])
        last_fmr = 1 - 0.025 ** (1 / self.impostors)
        similarity = last + high * max(math.log(last_fmr / fmr), 0.0)
        return similarity, self.smallest * math.exp((last - similarity) / mean)

    def __call__(self, similarity: float) -> float:
        """False match rate if this similarity were the threshold; never below what the table was
        measured on."""
        place = int(np.searchsorted(self.similarity, similarity, side="right")) - 1
        return float(self.fmr[place]) if place >= 0 else 1.0


def calibrate_scores(impostor: ArrayLike) -> FmrTable:
    """Table of false match rates from impostor similarities (N,).

    The rate at s is (k + 1) / (N + 1) with k scores at or above s: an upper estimate that is never
    zero. Raises BadInput if there are fewer than 100 scores or one is not finite.

    Source: ISO/IEC 19795-1 (false match rate); Phipson and Smyth 2010, Permutation p-values should
    never be zero.
    """
    scores = np.sort(np.asarray(impostor, dtype=float).ravel())
    require(
        scores.size >= 100,
        f"a calibration needs at least 100 impostor scores, but there are {scores.size}.",
    )
    require(np.isfinite(scores).all(), "impostor scores contain NaN or infinite values.")
    # thresholds whose rates are evenly spaced in their logarithm, and just above the largest score
    # entries of a table of false match rates, at most
    above = np.unique(np.round(np.geomspace(1, scores.size, 64)).astype(np.int64))[::-1]
    thresholds = np.concatenate([scores[scores.size - above], [np.nextafter(scores[-1], np.inf)]])
    thresholds = np.unique(thresholds)
    # between two entries the lower one's (larger) rate holds
    count = scores.size - np.searchsorted(scores, thresholds, side="left")
    return FmrTable(thresholds, (count + 1) / (scores.size + 1), scores.size)


DECISION_FORMAT = "splitknit-decision"


def own_rates_document(
    impostor: ArrayLike, what: str, method: str, least_mm2: float
) -> dict[str, Any]:
    """Content of a file of own rates; failures (NaN) are left out. Raises BadInput as
    :func:`calibrate_scores`."""
    scores = np.asarray(impostor, dtype=float)
    table = calibrate_scores(scores[~np.isnan(scores)])
    return {
        "format": DECISION_FORMAT,
        "version": 1,
        "method": method,
        "what": what,
        "least_mm2": least_mm2,
        "impostors": table.impostors,
        "similarity": table.similarity.tolist(),
        "fmr": table.fmr.tolist(),
    }


def read_own_rates(path: Path) -> FmrTable:
    """Rates of own prints, as ``evaluate --calibrate`` wrote them. Raises BadInput if it is
    something else."""
    wrong = (
        f"'{path}' is not a file of false match rates; name one that 'splitknit evaluate"
        " --calibrate' wrote."
    )
    document, _ = read_json(path)
    require(document.get("format") == DECISION_FORMAT, wrong)
    require(
        document.get("version") == 1,
        f"'{path}' is of a version that this program does not know; make it anew.",
    )
    with refusing(wrong):  # also integers beyond all floats
        scores, rates = (np.array(document[name], dtype=float) for name in ("similarity", "fmr"))
        table = FmrTable(
            scores,
            rates,
            int(float(document["impostors"])),
            str(document["what"]),
            float(document["least_mm2"]),
            method=str(document["method"]),
        )
    require(scores.ndim == 1 and scores.shape == rates.shape and scores.size > 1, wrong)
    require(table.rated_mm2 >= 0 and table.impostors < 1e12, wrong)
    require((np.diff(scores) > 0).all() and (np.diff(rates) <= 0).all(), wrong)
    require(
        ((rates > 0) & (rates <= 1)).all() and table.smallest * (table.impostors + 1) >= 1 - 1e-9,
        wrong,
    )
    return table
