"""Fit the detector of presentation attacks, and measure it on species that it was not fitted to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import beta
from sklearn.covariance import LedoitWolf
from sklearn.linear_model import LogisticRegression

from splitknit.pad import distances, judge

GROUPS = {
    "relief": ("relief_rms", "relief_fine", "relief_skew", "relief_coherence"),
    "shape": ("shape_across", "shape_along", "shape_rest"),
    "colour": ("colour_red", "colour_blue", "colour_nir"),
    "spread": (
        "spread_red", "spread_green", "spread_nir", "spread_blue", "spread_fixed", "spread_fixed_nir",
        "spread_fixed_red",
    ),
    "gloss": ("gloss_white", "gloss_nir", "gloss_rest_white", "gloss_rest_nir", "gloss_tail_white", "gloss_tail_nir"),
}  # fmt: skip
GROUPS["all"] = tuple(name for names in GROUPS.values() for name in names)
GROUPS["optics"] = (*GROUPS["colour"], "spread_red", "spread_green", "spread_nir")  # blood and scattering change both
FOLDS = 10
POINTS = (0.006, 0.01, 0.03)
"""BPCER at which is measured."""
MODEL = Path(__file__).parents[2] / "src" / "splitknit" / "pad_model.json"
Row = dict


def read(out: Path) -> list[Row]:
    rows = [json.loads(path.read_text()) for path in sorted(out.glob("*.json"))]
    for row in rows:
        if "features" in row:
            row["features"] = {k: v for k, v in row["features"].items() if v is not None and np.isfinite(v)}
    return rows


def fit(live: Sequence[Row], attacks: Sequence[Row], groups: dict = GROUPS) -> dict:
    """Live skin's mean and covariance (Ledoit and Wolf 2004), then a logistic regression on the distances to it."""
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    table = np.array([[row["features"].get(name, np.nan) for name in names] for row in live])
    mean = np.nanmean(table, axis=0)
    table = np.where(np.isnan(table), mean, table)
    scale = table.std(axis=0)
    covariance = LedoitWolf(assume_centered=True).fit((table - mean) / scale).covariance_ * np.outer(scale, scale)
    model = {
        "groups": {name: list(members) for name, members in groups.items()},
        "names": names,
        "mean": mean.tolist(),
        "covariance": covariance.tolist(),
    }
    rows = [*live, *attacks]
    found = [distances(model, row["features"]) for row in rows]
    away = np.array([[one.get(name, np.nan) for name in groups] for one in found])
    usual = np.nanmean(away[: len(live)], axis=0)
    away = np.where(np.isnan(away), usual, away) - usual
    truth = np.arange(len(rows)) < len(live)
    used = np.ones(len(groups), dtype=bool)
    while True:  # a group that lies farther is never more likely to be skin
        logistic = LogisticRegression(C=1.0, class_weight="balanced", max_iter=1000).fit(away[:, used], truth)
        weights = np.zeros(len(groups))
        weights[used] = -logistic.coef_[0]
        if (weights >= 0).all():
            break
        used &= weights > 0
    return model | {
        "usual": dict(zip(groups, usual.tolist(), strict=True)),
        "weights": dict(zip(groups, weights.tolist(), strict=True)),
        "offset": float(logistic.intercept_[0]),
        "threshold": 0.5,
    }


def odds(model: dict, row: Row) -> float:
    """Log odds of live skin."""
    probability = judge(row["features"], model).probability
    return float(np.log(max(probability, 1e-26)) - np.log(max(1 - probability, 1e-26)))


def interval(hits: int, tried: int) -> tuple[float, float]:
    """95 % interval of Clopper and Pearson."""
    low = beta.ppf(0.025, hits, tried - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, tried - hits) if hits < tried else 1.0
    return float(low), float(high)


def leave_out(rows: list[Row], species: str, groups: dict = GROUPS) -> tuple[np.ndarray, np.ndarray]:
    """Log odds of every live finger, by models that saw neither it nor the species; and of the species' instruments."""
    live = [row for row in rows if row["name"] == "live" and "features" in row]
    others = [row for row in rows if row["name"] not in ("live", species) and "features" in row]
    own = [row for row in rows if row["name"] == species and "features" in row]
    scores = np.zeros(len(live))
    for fold in range(FOLDS):
        model = fit([row for k, row in enumerate(live) if k % FOLDS != fold], others, groups)
        for k in range(fold, len(live), FOLDS):
            scores[k] = odds(model, live[k])
    model = fit(live, others, groups)
    return scores, np.array([odds(model, row) for row in own])


def threshold_at(live: np.ndarray, bpcer: float) -> float:
    """The highest threshold that rejects at most this fraction of live fingers."""
    return float(np.sort(live)[int(bpcer * len(live))])


def rates(rows: list[Row], groups: dict = GROUPS) -> list[dict]:
    """Of every species, left out in its turn: rates at both operating points."""
    found = []
    for species in sorted({row["name"] for row in rows} - {"live"}):
        live, own = leave_out(rows, species, groups)
        silent = sum(row["name"] == species and "failed" in row for row in rows)
        entry = {"species": species, "live": len(live), "tried": len(own) + silent, "silent": silent}
        for bpcer in POINTS:
            limit = threshold_at(live, bpcer)
            entry[str(bpcer)] = (int((own >= limit).sum()), int((live < limit).sum()))
        found.append(entry)
    return sorted(found, key=lambda one: (-one["0.006"][0] / one["tried"], -one["0.01"][0] / one["tried"]))


def words(hits: int, tried: int) -> str:
    low, high = interval(hits, tried)
    return f"{hits} of {tried}: {100 * hits / tried:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def table(rows: list[Row]) -> list[str]:
    """Rows of the page's table, and what stands below it."""
    found = rates(rows)
    lines = []
    for one in found:
        cells = [words(one[str(point)][0], one["tried"]) for point in POINTS]
        lines.append(f"| {' | '.join([one['species'], *cells, str(one['silent'])])} |")
    live = [one for one in found if one["tried"]]
    for point in map(str, POINTS):
        worst = max(one[point][1] for one in live)
        total = words(sum(one[point][0] for one in found), sum(one["tried"] for one in found))
        lines.append(f"BPCER {point}: {words(worst, live[0]['live'])} live rejected at most; all species {total}")
    states = [row["state"] for row in rows if row["name"] == "live"]
    silent = sum("failed" in row for row in rows if row["name"] == "live")
    lines.append(f"live: {len(states)}, not clean {sum(one != 'clean' for one in states)}, no result {silent}")
    return lines


def ship(rows: list[Row]) -> str:
    """Fit to everything, set the threshold at a BPCER of 0.6 % on live fingers left out, and write the model."""
    good = [row for row in rows if "features" in row]
    live, attacks = ([row for row in good if (row["name"] == "live") is what] for what in (True, False))
    scores, _ = leave_out(rows, "none")
    model = fit(live, attacks)
    model["threshold"] = float(1 / (1 + np.exp(-threshold_at(scores, 0.006))))

    def rounded(value: object) -> object:
        if isinstance(value, float):
            return float(f"{value:.6g}")
        if isinstance(value, list):
            return [rounded(one) for one in value]
        return {k: rounded(v) for k, v in value.items()} if isinstance(value, dict) else value

    MODEL.write_text(json.dumps(rounded(model)) + "\n")
    return f"{MODEL}: threshold {model['threshold']:.3g}, weights {model['weights']}"
