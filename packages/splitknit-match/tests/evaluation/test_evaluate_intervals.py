"""Intervals: replicates agree with the rates themselves, clusters hang together, and the truth is
covered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import betainc, ndtr

from splitknit.errors import BadInput
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap, differences
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.rates import Roc, error_bound, rank, roc
from splitknit_match.evaluation.scores import Scores, ids_of

FEW = BootstrapSettings(replicates=100, curve_points=5)
scores_1d = st.lists(
    st.one_of(
        st.integers(-5, 5).map(float),
        st.floats(-3, 3).map(lambda s: round(s, 6)),
        st.just(float("nan")),
    ),
    min_size=1,
    max_size=15,
)
sides = st.tuples(scores_1d, scores_1d).filter(
    lambda both: not any(np.isnan(side).all() for side in both)
)


def figures(curve: Roc) -> list[float]:
    """Rates, failures counted and left out."""
    rates = [
        (one.equal_error().value, *one.gars((0.5, 0.1, 0.01))) for one in (curve, curve.made())
    ]
    return [*rates[0], *rates[1], curve.auc()]


def plain_scores(genuine: np.ndarray, impostor: np.ndarray, name: str = "scores") -> Scores:
    label = np.repeat([True, False], [genuine.size, impostor.size])
    return Scores(label, np.concatenate([genuine, impostor]), name=name)


def population(seed: int, fingers: int = 30, sessions: int = 3, spread: float = 0.8) -> Scores:
    """Scores with an effect of each finger, of 3 + spread q_a and spread (q_a + q_b) / 2, noise of
    one."""
    generator = np.random.default_rng(seed)
    finger, session = np.tile(np.arange(fingers), sessions), np.repeat(np.arange(sessions), fingers)
    pairs = comparisons(finger, session)
    effect = spread * generator.normal(size=fingers)
    a, b = effect[finger[pairs.a]], effect[finger[pairs.b]]
    score = np.where(pairs.genuine, 3 + a, (a + b) / 2) + generator.normal(size=pairs.a.size)
    return scores_of_comparisons(pairs, score, finger, session, finger // 3)


@given(sides, st.integers(0, 1000))
def test_a_weight_counts_as_often_as_a_score_that_is_repeated(
    both: tuple[list[float], list[float]], seed: int
) -> None:
    genuine, impostor = map(np.array, both)
    times = [np.random.default_rng(seed).integers(0, 3, side.size) for side in (genuine, impostor)]
    drawn = [
        np.repeat(side, number) for side, number in zip((genuine, impostor), times, strict=True)
    ]
    if any(np.isnan(side).all() for side in drawn):  # an empty side too
        return
    ranked = rank(genuine, impostor)
    weights = [
        number[order].astype(np.float64) for number, order in zip(times, ranked.order, strict=True)
    ]
    assert figures(ranked.roc(weights)) == pytest.approx(figures(roc(*drawn)))
    assert ranked.roc(weights).d_prime() == pytest.approx(roc(*drawn).d_prime(), nan_ok=True)


@pytest.mark.parametrize("method", ["finger", "subject"])
def test_clusters_weigh_as_often_as_they_are_drawn(method: str) -> None:
    """The vertex bootstrap by definition; fingers of one subject come along together."""
    scores = population(5, fingers=12)
    ids = getattr(scores, method)
    names, generator, areas = len(ids.names), np.random.default_rng(0), []
    for _ in range(FEW.replicates):
        drawn = np.bincount(generator.integers(0, names, names), minlength=names)
        times = np.array([drawn[a] if a == b else drawn[a] * drawn[b] for a, b in ids.codes])
        areas.append(
            roc(
                *(np.repeat(scores.score[one], times[one]) for one in (scores.label, ~scores.label))
            ).auc()
        )
    found = bootstrap(scores, method, FEW).figures["auc"]
    assert [found.low, found.high] == pytest.approx(np.quantile(areas, [0.025, 0.975]))


def test_the_seed_is_all_that_differs() -> None:
    scores = population(0)
    for method in ("plain", "finger", "subject"):
        first, again = bootstrap(scores, method, FEW), bootstrap(scores, method, FEW)
        assert first.figures == again.figures
        np.testing.assert_array_equal(first.curve_low, again.curve_low)
        other = bootstrap(scores, method, replace(FEW, seed=1))
        assert other.figures["eer"] != first.figures["eer"]
        assert other.figures["eer"].value == first.figures["eer"].value
        for figure in first.figures.values():
            assert figure.low <= figure.value <= figure.high


@pytest.mark.parametrize("seed", range(3))
def test_clusters_give_wider_intervals_where_fingers_differ(seed: int) -> None:
    scores = population(seed, sessions=4, spread=1.5)
    widths = {}
    for method in ("plain", "finger"):
        found = bootstrap(scores, method, FEW).figures
        widths[method] = [
            found[name].high - found[name].low for name in ("eer", "gar@0.01", "auc", "d_prime")
        ]
    assert (np.array(widths["finger"]) > np.array(widths["plain"])).all()
    assert widths["finger"][-1] > 1.25 * widths["plain"][-1]


def test_clusters_change_little_where_fingers_do_not_differ() -> None:
    scores = population(4, fingers=60, spread=0.0)
    widths = [
        np.ptp([one.low, one.high])
        for one in (bootstrap(scores, m, FEW).figures["auc"] for m in _BOTH)
    ]
    assert 0.6 < widths[1] / widths[0] < 1.6


_BOTH = ("plain", "finger")


@pytest.mark.slow
def test_plain_intervals_cover() -> None:
    generator = np.random.default_rng(11)
    truth = {
        "eer": ndtr(-1.0),
        "auc": ndtr(np.sqrt(2.0)),
        "d_prime": 2.0,
        "gar@0.1": ndtr(2 - 1.2815515655446004),
    }
    settings = BootstrapSettings(replicates=100, targets=(0.1,), curve_points=0)
    hits = dict.fromkeys(truth, 0)
    for trial in range(100):
        scores = plain_scores(generator.normal(2, 1, 150), generator.normal(0, 1, 300))
        found = bootstrap(scores, "plain", replace(settings, seed=trial)).figures
        for name, value in truth.items():
            hits[name] += found[name].low <= value <= found[name].high
    assert min(hits.values()) >= 87, hits
    assert max(hits.values()) < 100


@pytest.mark.slow
def test_clustered_intervals_cover_and_plain_ones_do_not() -> None:
    spread = 1.5
    wide, narrow = np.sqrt(1 + spread**2), np.sqrt(1 + spread**2 / 2)
    threshold = brentq(lambda t: ndtr((t - 3) / wide) - ndtr(-t / narrow), 0, 3)
    truth = ndtr(-threshold / narrow)
    settings = BootstrapSettings(replicates=100, targets=(0.1,), curve_points=0)
    hits = dict.fromkeys(_BOTH, 0)
    for trial in range(60):
        scores = population(1000 + trial, fingers=40, sessions=4, spread=spread)
        for method in _BOTH:
            found = bootstrap(scores, method, replace(settings, seed=trial)).figures["eer"]
            hits[method] += found.low <= truth <= found.high
    assert hits["finger"] >= 52, hits
    assert hits["plain"] <= 50, hits


def test_no_error_is_not_certainty() -> None:
    generator = np.random.default_rng(0)
    scores = plain_scores(generator.normal(50, 1, 60), generator.normal(0, 1, 300))
    found = bootstrap(scores, "plain", FEW).figures
    assert (found["eer"].value, found["eer"].low, found["eer"].high) == (0.0, 0.0, 0.05)
    assert (found["gar@0.01"].value, found["gar@0.01"].low, found["gar@0.01"].high) == (
        1.0,
        0.95,
        1.0,
    )
    turned = plain_scores(generator.normal(-50, 1, 60), generator.normal(0, 1, 300))
    found = bootstrap(turned, "plain", FEW).figures
    assert (found["gar@0.01"].low, found["gar@0.01"].high) == (0.0, 0.05)
    by_finger = population(1, fingers=30, spread=0.0)
    easy = Scores(by_finger.label, by_finger.score + 50 * by_finger.label, finger=by_finger.finger)
    # 30 fingers, not 90 pairs
    assert bootstrap(easy, "finger", FEW).figures["eer"].high == pytest.approx(0.1)


def test_few_errors_are_no_certainty_either() -> None:
    generator = np.random.default_rng(3)
    genuine = np.append(generator.normal(50, 1, 59), -50.0)
    found = bootstrap(plain_scores(genuine, generator.normal(0, 1, 300)), "plain", FEW).figures[
        "gar@0.01"
    ]
    assert found.value == pytest.approx(59 / 60)
    # one error of 60, Clopper and Pearson
    assert betainc(2, 59, 1 - found.low) == pytest.approx(0.95)
    assert error_bound(0.0, 300) == 0.01 and error_bound(1.0, 5) == 1.0
    # it starts at the rule of three
    assert error_bound(1e-12, 300) == pytest.approx(0.01, rel=0.01)
    many = plain_scores(
        np.append(generator.normal(50, 1, 300), np.full(100, -50.0)), generator.normal(0, 1, 300)
    )
    found = bootstrap(many, "plain", FEW).figures["gar@0.01"]
    assert found.high - found.low == pytest.approx(2 * 1.96 * np.sqrt(0.25 * 0.75 / 400), rel=0.3)


def test_failures_are_no_few_errors_of_the_matcher() -> None:
    generator = np.random.default_rng(4)
    genuine = np.append(generator.normal(50, 1, 40), np.full(20, np.nan))
    found = bootstrap(plain_scores(genuine, generator.normal(0, 1, 300)), "plain", FEW).figures
    assert found["gar@0.01_made"].low == pytest.approx(1 - 3 / 40)
    assert found["gar@0.01"].value == pytest.approx(2 / 3) and found["gar@0.01"].high < 0.85


def test_failures_widen_nothing_but_count() -> None:
    scores = population(2)
    score = scores.score.copy()
    score[np.flatnonzero(scores.label)[:9]] = np.nan
    found = bootstrap(replace(scores, score=score), "finger", FEW).figures
    assert found["gar@0.01"].value == pytest.approx(found["gar@0.01_made"].value * 0.9)
    assert found["gar@0.01"].high <= found["gar@0.01_made"].high


@pytest.mark.parametrize("method", ["plain", "finger", "subject"])
def test_differences_of_like_systems(method: str) -> None:
    first = population(3)
    noise = np.random.default_rng(9).normal(size=first.score.size)
    second = replace(first, score=first.score + 0.3 * noise, name="noisier")
    none = differences(first, first, method, FEW)
    for name in ("auc", "d_prime"):
        assert (none[name].value, none[name].low, none[name].high) == (0, 0, 0)
    clusters = bootstrap(first, method, FEW).drawn if method != "plain" else first.genuine.size
    for name in ("eer", "gar@0.01"):  # nothing differs: the rule of three
        assert none[name].value == 0
        assert (none[name].low, none[name].high) == pytest.approx((-3 / clusters, 3 / clusters))
    found = differences(first, second, method, FEW)
    single = bootstrap(first, method, FEW).figures
    for name in ("auc", "d_prime"):
        assert found[name].low <= found[name].value <= found[name].high
        assert found[name].high - found[name].low < single[name].high - single[name].low
    back = differences(second, first, method, FEW)
    assert back["eer"].value == -found["eer"].value
    assert (back["eer"].low, back["eer"].high) == pytest.approx(
        (-found["eer"].high, -found["eer"].low)
    )
    assert found["auc"].value > 0
    much = replace(first, score=first.score + 2 * noise, name="much noisier")
    assert differences(first, much, method, FEW)["auc"].low > 0  # beyond chance


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"replicates": 5}, "replicates"),
        ({"seed": -1}, "seed"),
        ({"targets": (0.0,)}, "targets"),
        ({"curve_points": -1}, "curve_points"),
    ],
)
def test_bad_settings(settings: dict[str, object], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        BootstrapSettings(**settings)  # type: ignore[arg-type]


def test_bad_requests() -> None:
    scores = plain_scores(np.array([2.0, 3.0]), np.array([0.0, 1.0]))
    with pytest.raises(BadInput, match="columns finger_a and finger_b"):
        bootstrap(scores, "finger", FEW)
    with pytest.raises(BadInput, match="draws by"):
        bootstrap(scores, "hand", FEW)
    with pytest.raises(BadInput, match="same pairs"):
        differences(scores, plain_scores(np.array([2.0]), np.array([0.0, 1.0])), "plain", FEW)
    two = Scores(
        np.array([True, True, False]),
        np.arange(3.0),
        finger=ids_of(["a", "b", "a"], ["a", "b", "b"]),
    )
    with pytest.raises(BadInput, match="three of them"):
        bootstrap(two, "finger", FEW)
