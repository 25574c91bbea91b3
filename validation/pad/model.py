"""Fit the detector of presentation attacks, and measure it on species and captures that it was not
fitted to."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from detector import MODEL, deviations, distance, judge, suspicious
from scipy.stats import beta
from sklearn.covariance import LedoitWolf
from sklearn.linear_model import LogisticRegression

SIDES = {
    "relief_rms": (0, 1),
    "relief_coherence": (0, 1),
    "shape_across": (1, 0),
    "shape_along": (1, 0),
    "shape_rest": (0, 1),
    "spread_fixed": (1, 1),
    "spread_nir": (1, 0),
    "spread_fixed_nir": (1, 0),
}
"""Whether more and less of a feature than live skin's is suspicious: copies are flatter, their
relief is weaker, their ridges are printed (fixed) or cast of what spreads light more evenly over
the wavelengths."""
FOLDS = 5
VARIANTS: dict[str, Callable[[Row], bool]] = {
    "usual optics, rig and camera": lambda row: row["variant"] == "plain",
    "refraction above 0.3": lambda row: row.get("refraction", 0) > 0.3,
    "lights 12 % nearer or farther": lambda row: abs(np.log(row.get("ring", 1))) > 0.12,
    "lights 12 % lower or higher": lambda row: abs(np.log(row.get("height", 1))) > 0.12,
    "camera of 19 px/mm": lambda row: row.get("scale", 0.2) > 0.22,
    "skin that is not clean": lambda row: row["state"] != "clean",
}
"""Simulator's variants that are left out in turn."""
BPCER = 0.01
"""Fraction of live fingers that the thresholds may call attacks."""
UNKNOWN_RATE = 0.12
"""Fraction of live fingers that the thresholds may call unknown because of their odds."""
UNCOVERED_MARGIN = 1.5
"""By how much the log odds of what training did not cover must lie below those of an attack to be
called one."""
Row = dict
Model = dict


def read(out: Path) -> list[Row]:
    return [json.loads(path.read_text()) for path in sorted(out.glob("*.json"))]


def fit(live: Sequence[Row], attacks: Sequence[Row]) -> Model:
    """Logistic regression on one-sided deviations from live skin; kinds, their spread; thresholds
    by folds of live."""
    model = _fit(live, attacks)
    odds, far = held_out(live, attacks)
    # the worst of some dozens is not a quantile of 1 %: the lower of it and of a normal
    # distribution's
    low = min(float(odds.min()), float(odds.mean() - 2.33 * odds.std()))
    reached = float(np.quantile(far, 0.98)) * 1.1
    return model | {
        "covered": reached,
        "live": float(np.quantile(odds, UNKNOWN_RATE)),
        "attack": low,
        "far": low - UNCOVERED_MARGIN,
    }


def _fit(live: Sequence[Row], attacks: Sequence[Row]) -> Model:
    names = list(SIDES)
    table = np.array([[row["features"][name] for name in names] for row in (*live, *attacks)])
    truth = np.arange(len(table)) < len(live)
    mean = table[truth].mean(axis=0)
    scale = table[truth].std(axis=0)
    away = (table - mean) / scale
    parts = suspicious(away).reshape(len(away), -1)
    used = np.array(list(SIDES.values()), dtype=bool).ravel()
    while True:  # what lies farther is never more likely to be skin
        logistic = LogisticRegression(C=0.3, class_weight="balanced", max_iter=2000).fit(
            parts[:, used], truth
        )
        weights = np.zeros(len(used))
        weights[used] = -logistic.coef_[0]
        if (weights >= 0).all():
            break
        used &= weights > 0
    model = {
        "names": names,
        "mean": mean.tolist(),
        "scale": scale.tolist(),
        "weights": weights.reshape(-1, 2).tolist(),
        "offset": float(logistic.intercept_[0]),
    }
    features = np.array([deviations(model, row["features"]) for row in (*live, *attacks)])
    species = np.array(["live"] * len(live) + [row["name"] for row in attacks])
    kinds = {kind: features[species == kind].mean(axis=0) for kind in dict.fromkeys(species)}
    rest = features - np.array([kinds[kind] for kind in species])
    covariance = LedoitWolf(assume_centered=True).fit(rest).covariance_
    return model | {
        "kinds": [kind.tolist() for kind in kinds.values()],
        "precision": np.linalg.inv(covariance).tolist(),
    }


def odds_of(model: Model, row: Row) -> tuple[float, float]:
    """Log odds of live skin, and distance to the nearest kind."""
    limits = {"covered": np.inf, "live": 0.0, "attack": 0.0, "far": 0.0}
    probability = judge(row["features"], model | limits).probability
    return float(np.log(probability / (1 - probability))), distance(
        model, deviations(model, row["features"])
    )


def held_out(live: Sequence[Row], attacks: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Log odds and distances of every live finger, by models that did not see it."""
    odds = np.zeros((len(live), 2))
    for fold in range(FOLDS):
        model = _fit([row for k, row in enumerate(live) if k % FOLDS != fold], attacks)
        for k in range(fold, len(live), FOLDS):
            odds[k] = odds_of(model, live[k])
    return odds[:, 0], odds[:, 1]


def interval(hits: int, tried: int) -> tuple[float, float]:
    """95 % interval of Clopper and Pearson."""
    low = beta.ppf(0.025, hits, tried - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, tried - hits) if hits < tried else 1.0
    return float(low), float(high)


def words(hits: int, tried: int) -> str:
    low, high = interval(hits, tried)
    return (
        f"{hits} of {tried}: {100 * hits / max(tried, 1):.1f} % ({100 * low:.1f} to"
        f" {100 * high:.1f})"
    )


def parted(rows: Sequence[Row]) -> tuple[list[Row], list[Row], list[Row]]:
    """Live fingers and attacks to fit to, and captures that are not part of it (``NAME, how``)."""
    good = [row for row in rows if "features" in row and "," not in row["name"]]
    live, attacks = (
        [row for row in good if (row["name"] == "live") is what] for what in (True, False)
    )
    return live, attacks, [row for row in rows if "," in row["name"]]


def rates(rows: Sequence[Row]) -> list[Row]:
    """Answers for every species by a model that never saw it, for live fingers by folds and by what
    was drawn, and for what is not part of the fit. Thresholds are set anew for every model, on the
    live fingers that it saw.
    """
    live, attacks, others = parted(rows)
    counts: dict[str, Counter] = {}

    def count(group: str, model: Model, tried: Sequence[Row]) -> None:
        answers = (
            judge(row["features"], model).answer if "features" in row else "unknown"
            for row in tried
        )
        counts.setdefault(group, Counter()).update(answers)

    for species in sorted({row["name"] for row in rows if "," not in row["name"]} - {"live"}):
        model = fit(live, [row for row in attacks if row["name"] != species])
        count(species, model, [row for row in rows if row["name"] == species])
    for fold in range(FOLDS):
        model = fit([row for k, row in enumerate(live) if k % FOLDS != fold], attacks)
        count("live", model, live[fold::FOLDS])
    for words, out in VARIANTS.items():
        model = fit([row for row in live if not out(row)], attacks)
        count(f"live, never trained on: {words}", model, [row for row in live if out(row)])
    whole = fit(live, attacks)
    for row in others:
        count(row["name"], whole, [row])
    return [
        {
            "group": group,
            "tried": answers.total(),
            **{answer: answers[answer] for answer in ("live", "attack", "unknown")},
        }
        for group, answers in counts.items()
    ]


def summary(rows: Sequence[Row]) -> list[str]:
    """Rates over all species, and over live fingers, with intervals."""
    by_group = {rate["group"]: rate for rate in rates(rows)}
    species = [by_group[name] for name in sorted({row["name"] for row in parted(rows)[1]})]
    passed, caught, open_ = (
        sum(rates_of[answer] for rates_of in species) for answer in ("live", "attack", "unknown")
    )
    own = by_group["live"]
    lines = [
        f"APCER among decided: {words(passed, passed + caught)}",
        f"attacks unknown: {words(open_, passed + caught + open_)}",
        f"BPCER among decided: {words(own['attack'], own['attack'] + own['live'])}",
        f"live unknown: {words(own['unknown'], own['tried'])}",
        f"unknown of all: {words(own['unknown'] + open_, own['tried'] + passed + caught + open_)}",
    ]
    for start in ("live, never trained", "live, drawn anew", "live, JPEG", "path-traced"):
        groups = [rates_of for group, rates_of in by_group.items() if group.startswith(start)]
        if groups:
            tried = sum(rates_of["tried"] for rates_of in groups)
            called, open_ = (
                sum(rates_of[answer] for rates_of in groups) for answer in ("attack", "unknown")
            )
            lines.append(
                f"{start}: called attack {words(called, tried)}, unknown {words(open_, tried)}"
            )
    return lines


def ship(rows: Sequence[Row]) -> str:
    """Fit to everything and write the model."""

    def rounded(value: object) -> object:
        if isinstance(value, float):
            return float(f"{value:.6g}")
        if isinstance(value, list):
            return [rounded(item) for item in value]
        return {k: rounded(v) for k, v in value.items()} if isinstance(value, dict) else value

    model = rounded(fit(*parted(rows)[:2]))
    MODEL.write_text(json.dumps(model) + "\n")
    return f"{MODEL.name}: {[(key, model[key]) for key in ('live', 'attack', 'far', 'covered')]}"
