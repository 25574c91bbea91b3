"""How genuine scores depend on roll, glare, moisture and partial views, from the truth of the
captures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from measure import allowed
from trials import Pairs, Table, Trial, Values
from variants import PLAIN, Known, judged

from splitknit_match.evaluation.rates import roc
from splitknit_match.evaluation.scores import Scores

TARGETS = (0.01, 0.001)
Truth = Mapping[str, Mapping[str, Any]]
"""``impression.json`` of each capture, by its name."""


@dataclass(frozen=True, slots=True)
class Factor:
    """One thing that a comparison's difficulty may depend on."""

    words: str
    unit: str
    field: str
    of_two: Callable[[Values], Values]
    """From (N, 2) values of both captures to (N,)."""
    edges: tuple[float, ...]
    """Fixed before results were seen."""


def _difference(both: Values) -> Values:
    return np.asarray(np.abs(both[:, 0] - both[:, 1]))


def _larger(both: Values) -> Values:
    return np.asarray(both.max(axis=1))


def _number(both: Values) -> Values:
    return np.asarray(both.sum(axis=1))


FACTORS: Mapping[str, Factor] = {
    "roll": Factor(
        "difference of the two rolls", "deg", "roll_deg", _difference, (0, 3, 6, 10, 15, 90)
    ),
    "glare": Factor(
        "glare, the stronger of the two", "", "glare", _larger, (0, 0.8, 0.95, 1.1, 1.2, 2)
    ),
    "moisture": Factor(
        "difference of the two moistures (0 dry, 1 moist)",
        "",
        "moisture",
        _difference,
        (0, 0.1, 0.2, 0.35, 0.5, 1),
    ),
    "partial": Factor("partial views among the two", "", "partial", _number, (-0.5, 0.5, 1.5, 2.5)),
}


def sensitivity_rows(  # noqa: PLR0917
    table: Table, trials: tuple[Trial, ...], truth: Truth, known: Known, replicates: int, seed: int
) -> list[dict[str, Any]]:
    """One row for each trial, factor and bin: median genuine score, and GAR at the trial's
    thresholds.

    Thresholds are those of all impostor comparisons (no gate, not averaged); intervals are drawn by
    finger.
    """
    rows = []
    genuine = table.pairs.genuine
    own = table.pairs.taken(genuine)
    fingers = np.unique(own.captures.finger[own.a], return_inverse=True)[1]
    weights = _draws(int(fingers.max()) + 1, replicates, seed)
    for trial in trials:
        scores = judged(table.pairs, trial, PLAIN, known, genuine)
        if scores is None:
            continue
        thresholds = {target: _threshold(scores, target) for target in TARGETS}
        similarity = trial.similarity[genuine]
        for name, factor in FACTORS.items():
            values = _values(own, factor, truth)
            for low, high in zip(factor.edges[:-1], factor.edges[1:], strict=True):
                inside = (values >= low) & (values < high)
                if not inside.any():
                    continue
                row = {
                    "case": trial.case,
                    "matcher": trial.matcher,
                    "attribute": trial.attribute,
                    "factor": name,
                    "from": low,
                    "to": high,
                    "genuine": int(inside.sum()),
                    "fingers": int(np.unique(fingers[inside]).size),
                    "failures": int(np.isnan(similarity[inside]).sum()),
                    "mean_factor": float(values[inside].mean()),
                    "median_similarity": _median(similarity[inside]),
                }
                for target, threshold in thresholds.items():
                    accepted = (
                        np.zeros(inside.sum())
                        if threshold is None
                        else similarity[inside] >= threshold
                    )
                    value, limits = _fraction(accepted.astype(np.float64), fingers[inside], weights)
                    supported = allowed(target, int(np.sum(~scores.label))) >= 1
                    row[f"gar@{target:g}"] = value if supported else None
                    row[f"gar@{target:g}_low"], row[f"gar@{target:g}_high"] = (
                        limits if supported else (None, None)
                    )
                rows.append(row)
    return rows


def _threshold(scores: Scores, target: float) -> float | None:
    return roc(scores.genuine, scores.impostor).at_far(target).threshold


def _values(pairs: Pairs, factor: Factor, truth: Truth) -> Values:
    of_captures = np.array(
        [float(truth.get(str(name), {}).get(factor.field, np.nan)) for name in pairs.captures.names]
    )
    return factor.of_two(pairs.of_both(of_captures))


def _draws(fingers: int, replicates: int, seed: int) -> Values:
    """(replicates, fingers) how often each finger is drawn."""
    fraction = np.full(fingers, 1.0 / fingers)
    return (
        np.random.default_rng(seed)
        .multinomial(fingers, fraction, size=replicates)
        .astype(np.float64)
    )


def _fraction(accepted: Values, fingers: Any, weights: Values) -> tuple[float, tuple[float, float]]:
    """A rate and its limits where fingers are drawn; of no error, or nothing else, the rule of
    three."""
    count = weights.shape[1]
    hits = np.bincount(fingers, weights=accepted, minlength=count)
    tried = np.bincount(fingers, minlength=count).astype(np.float64)
    of_each = weights @ tried
    rates = (weights @ hits)[of_each > 0] / of_each[of_each > 0]
    value, seen = float(accepted.mean()), int(np.count_nonzero(tried))
    low, high = (float(limit) for limit in np.quantile(rates, [0.025, 0.975]))
    if value == 1.0:
        low = max(0.0, 1.0 - 3.0 / seen)
    if value == 0.0:
        high = min(1.0, 3.0 / seen)
    return value, (min(low, value), max(high, value))


def _median(values: Values) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
