"""Thresholds of stated rates, and misses by the number of enrolled impressions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from script_folder import VALIDATION, Script

FOLDER = VALIDATION / "match"


def impostors(unseen, rng, fingers=12, prints=6):
    """Pairs of different fingers, scores exponential with mean 1, less 3."""
    finger = np.repeat(np.arange(fingers), prints)
    a, b = np.triu_indices(len(finger), 1)
    other = finger[a] != finger[b]
    a, b = a[other], b[other]
    score = rng.exponential(size=len(a)) - 3
    return unseen.Pairs(finger[a], finger[b], a, b, score, np.zeros(len(a), bool))


@pytest.mark.parametrize("shape", [-0.2, 0.0, 0.2])
def test_a_generalised_pareto_tail_is_found(script: Script, shape: float) -> None:
    unseen = script("unseen")
    u = 1 - np.random.default_rng(3).random(20_000)
    score = -2 * np.log(u) if shape == 0 else 2 * (u**-shape - 1) / shape
    tail = unseen.fitted_tail(score, np.ones(len(score)), 0.0)
    assert tail.shape == pytest.approx(shape, abs=0.03)
    assert tail.scale == pytest.approx(2, abs=0.08)
    assert tail.fraction == 1
    doubled = unseen.fitted_tail(np.repeat(score, 2), np.ones(2 * len(score)), 0.0)
    assert unseen.fitted_tail(score, np.full(len(score), 2.0), 0.0) == tail
    assert doubled.threshold(1e-4) == pytest.approx(tail.threshold(1e-4), rel=1e-6)


def test_stated_rates_hold(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    unseen = script("unseen")
    monkeypatch.setattr(unseen, "REPLICATES", 60)
    rng = np.random.default_rng(1)
    rates = (0.1, 1e-3, 1e-4)
    true = -np.log(rates) - 3
    ends, fits = [], []
    for _ in range(30):
        tail, end = unseen.thresholds(impostors(unseen, rng), rates)
        ends.append(end)
        fits.append(tail.threshold(1e-3))
    held = (np.array(ends) >= true).mean(axis=0)
    assert (held > 0.85).all()
    assert np.median(fits) == pytest.approx(true[1], abs=0.3)
    table = unseen.table(impostors(unseen, rng), "drawn scores", "this test")
    assert (np.diff(table["similarity"]) >= 0).all()
    assert table["fmr"][0] == 1
    assert table["fmr"][-1] * (table["impostors"] + 1) == pytest.approx(1, rel=0.01)


def test_misses_by_the_number_of_impressions_are_counted(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    unseen = script("unseen")
    monkeypatch.setattr(unseen, "FINGERS", 1)
    score = np.triu(np.random.default_rng(2).normal(size=(8, 8)), 1)
    a, b = np.triu_indices(8, 1)
    none = np.zeros(len(a), int)
    pairs = unseen.Pairs(none, none, a, b, score[a, b], none.astype(bool))
    score += score.T
    for most in unseen.IMPRESSIONS:
        missed = [
            score[probe, list(chosen)].max() < 0.4
            for probe in range(8)
            for chosen in itertools.combinations([k for k in range(8) if k != probe], most)
        ]
        share = unseen.misses(pairs, {0: 0.4}, [0], most)[0]
        assert share == pytest.approx(100 * np.mean(missed), abs=0.001)


def test_of_two_tables_the_larger_rate_is_stated(script: Script) -> None:
    at_least = script("impostors").at_least
    one = {"what": "a", "impostors": 9, "similarity": [0.0, 2.0, 5.0], "fmr": [1.0, 0.5, 0.1]}
    other = {"what": "b", "impostors": 99, "similarity": [1.0, 3.0], "fmr": [0.9, 0.2]}
    both = at_least(one, other)
    assert both["similarity"] == [0, 1, 2, 3, 5]
    assert both["fmr"] == [1, 1, 0.9, 0.5, 0.2]
    assert (both["impostors"], both["what"]) == (108, "of them 9 a; b")
    assert both["measured"] is one
