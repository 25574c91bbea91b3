"""Intervals: replicates agree with the rates, clusters are drawn whole, the truth is covered."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import betainc, ndtr

from refusals import bad_input
from splitknit_match.evaluation.intervals import BootstrapSettings, Interval, bootstrap, differences
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.rates import error_bound, rank, roc
from splitknit_match.evaluation.scores import Scores, ids_of

FEW = BootstrapSettings(replicates=100, curve_points=5)
PLAIN_AND_FINGER = ("plain", "finger")
METHODS = (*PLAIN_AND_FINGER, "subject")
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


def figures(curve):
    """Rates, failures counted and left out."""
    eers = [part.equal_error().value for part in (curve, curve.scored())]
    gars = [part.gars((0.5, 0.1, 0.01)) for part in (curve, curve.scored())]
    return [*eers, *gars[0], *gars[1], curve.auc()]


def plain_scores(genuine, impostor, name="scores"):
    label = np.repeat([True, False], [genuine.size, impostor.size])
    return Scores(label, np.concatenate([genuine, impostor]), name=name)


def impostors(generator):
    return generator.normal(0, 1, 300)


def width(interval):
    return interval.high - interval.low


def population(seed, fingers=30, sessions=3, spread=0.8):
    """Scores with an effect of each finger: 3 + spread q_a and spread (q_a + q_b) / 2, unit
    noise."""
    generator = np.random.default_rng(seed)
    finger, session = np.tile(np.arange(fingers), sessions), np.repeat(np.arange(sessions), fingers)
    pairs = comparisons(finger, session)
    effect = spread * generator.normal(size=fingers)
    a, b = effect[finger[pairs.a]], effect[finger[pairs.b]]
    score = np.where(pairs.genuine, 3 + a, (a + b) / 2) + generator.normal(size=pairs.a.size)
    return scores_of_comparisons(pairs, score, finger, session, finger // 3)


@given(sides, st.integers(0, 1000))
def test_a_weight_counts_as_often_as_a_score_that_is_repeated(both, seed):
    genuine, impostor = map(np.array, both)
    times = [np.random.default_rng(seed).integers(0, 3, side.size) for side in (genuine, impostor)]
    drawn = [np.repeat(genuine, times[0]), np.repeat(impostor, times[1])]
    if any(np.isnan(side).all() for side in drawn):  # an empty side too
        return
    ranked, repeated = rank(genuine, impostor), roc(*drawn)
    weights = [number[order] * 1.0 for number, order in zip(times, ranked.order, strict=True)]
    weighted = ranked.roc(weights)
    assert figures(weighted) == pytest.approx(figures(repeated))
    assert weighted.d_prime() == pytest.approx(repeated.d_prime(), nan_ok=True)


@pytest.mark.parametrize("method", METHODS[1:])
def test_clusters_count_as_often_as_they_are_drawn(method):
    """The vertex bootstrap by definition; fingers of one subject come along together."""
    scores = population(5, fingers=12)
    ids = getattr(scores, method)
    names, generator, areas = len(ids.names), np.random.default_rng(0), []
    for _ in range(FEW.replicates):
        drawn = np.bincount(generator.integers(0, names, names), minlength=names)
        times = np.array([drawn[a] if a == b else drawn[a] * drawn[b] for a, b in ids.codes])
        sides = (scores.label, ~scores.label)
        repeated = [np.repeat(scores.score[side], times[side]) for side in sides]
        areas.append(roc(*repeated).auc())
    auc = bootstrap(scores, method, FEW).figures["auc"]
    assert [auc.low, auc.high] == pytest.approx(np.quantile(areas, [0.025, 0.975]))


@pytest.mark.parametrize("method", METHODS)
def test_only_the_seed_changes_an_interval(method):
    scores = population(0)
    first, again = bootstrap(scores, method, FEW), bootstrap(scores, method, FEW)
    assert first.figures == again.figures
    np.testing.assert_array_equal(first.curve_low, again.curve_low)
    reseeded = bootstrap(scores, method, replace(FEW, seed=1)).figures["eer"]
    assert reseeded != first.figures["eer"]
    assert reseeded.value == first.figures["eer"].value
    assert all(figure.low <= figure.value <= figure.high for figure in first.figures.values())


@pytest.mark.slow
def test_plain_intervals_cover_the_truth():
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
        scores = plain_scores(generator.normal(2, 1, 150), impostors(generator))
        intervals = bootstrap(scores, "plain", replace(settings, seed=trial)).figures
        for name, value in truth.items():
            hits[name] += intervals[name].low <= value <= intervals[name].high
    assert min(hits.values()) >= 87, hits
    assert max(hits.values()) < 100


@pytest.mark.slow
def test_clustered_intervals_cover_and_plain_ones_do_not():
    spread = 1.5
    wide, narrow = np.sqrt(1 + spread**2), np.sqrt(1 + spread**2 / 2)
    threshold = brentq(lambda t: ndtr((t - 3) / wide) - ndtr(-t / narrow), 0, 3)
    truth = ndtr(-threshold / narrow)
    settings = BootstrapSettings(replicates=100, targets=(0.1,), curve_points=0)
    hits = dict.fromkeys(PLAIN_AND_FINGER, 0)
    for trial in range(60):
        scores = population(1000 + trial, fingers=40, sessions=4, spread=spread)
        for method in PLAIN_AND_FINGER:
            eer = bootstrap(scores, method, replace(settings, seed=trial)).figures["eer"]
            hits[method] += eer.low <= truth <= eer.high
    assert hits["finger"] >= 52, hits
    assert hits["plain"] <= 50, hits


def test_no_error_is_not_certainty():
    generator = np.random.default_rng(0)
    perfect = plain_scores(generator.normal(50, 1, 60), impostors(generator))
    figures = bootstrap(perfect, "plain", FEW).figures
    assert figures["eer"] == Interval(0.0, 0.0, 0.05)
    assert figures["gar@0.01"] == Interval(1.0, 0.95, 1.0)
    reversed_ = plain_scores(generator.normal(-50, 1, 60), impostors(generator))
    assert bootstrap(reversed_, "plain", FEW).figures["gar@0.01"] == Interval(0.0, 0.0, 0.05)
    by_finger = population(1, fingers=30, spread=0.0)
    easy = Scores(by_finger.label, by_finger.score + 50 * by_finger.label, finger=by_finger.finger)
    # 30 fingers, not 90 pairs
    assert bootstrap(easy, "finger", FEW).figures["eer"].high == pytest.approx(0.1)


def test_few_errors_are_no_certainty_either():
    generator = np.random.default_rng(3)
    one_of_60 = plain_scores(np.append(generator.normal(50, 1, 59), -50.0), impostors(generator))
    gar = bootstrap(one_of_60, "plain", FEW).figures["gar@0.01"]
    assert gar.value == pytest.approx(59 / 60)
    # Clopper and Pearson
    assert betainc(2, 59, 1 - gar.low) == pytest.approx(0.95)
    assert error_bound(0.0, 300) == 0.01
    assert error_bound(1.0, 5) == 1.0
    # it starts at the rule of three
    assert error_bound(1e-12, 300) == pytest.approx(0.01, rel=0.01)
    genuine = np.append(generator.normal(50, 1, 300), np.full(100, -50.0))
    many = bootstrap(plain_scores(genuine, impostors(generator)), "plain", FEW)
    normal = 2 * 1.96 * np.sqrt(0.25 * 0.75 / 400)
    assert width(many.figures["gar@0.01"]) == pytest.approx(normal, rel=0.3)


def test_failures_are_not_errors_of_the_matcher():
    generator = np.random.default_rng(4)
    genuine = np.append(generator.normal(50, 1, 40), np.full(20, np.nan))
    figures = bootstrap(plain_scores(genuine, impostors(generator)), "plain", FEW).figures
    assert figures["gar@0.01_made"].low == pytest.approx(1 - 3 / 40)
    assert figures["gar@0.01"].value == pytest.approx(2 / 3)
    assert figures["gar@0.01"].high < 0.85


@pytest.mark.parametrize("method", METHODS)
def test_differences_of_similar_systems_are_narrower_than_their_rates(method):
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
    noisier = differences(first, second, method, FEW)
    single = bootstrap(first, method, FEW).figures
    for name in ("auc", "d_prime"):
        assert noisier[name].low <= noisier[name].value <= noisier[name].high
        assert width(noisier[name]) < width(single[name])
    eer, back = noisier["eer"], differences(second, first, method, FEW)["eer"]
    assert back.value == -eer.value
    assert (back.low, back.high) == pytest.approx((-eer.high, -eer.low))
    assert noisier["auc"].value > 0
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
def test_bad_settings_are_refused(settings, words):
    with bad_input(words):
        BootstrapSettings(**settings)  # type: ignore[arg-type]


def test_scores_without_enough_clusters_are_refused():
    scores = plain_scores(np.array([2.0, 3.0]), np.array([0.0, 1.0]))
    with bad_input("columns finger_a and finger_b"):
        bootstrap(scores, "finger", FEW)
    with bad_input("draws by"):
        bootstrap(scores, "hand", FEW)
    with bad_input("same pairs"):
        differences(scores, plain_scores(np.array([2.0]), np.array([0.0, 1.0])), "plain", FEW)
    label, fingers = np.array([True, True, False]), ids_of(["a", "b", "a"], ["a", "b", "b"])
    two = Scores(label, np.arange(3.0), finger=fingers)
    with bad_input("three of them"):
        bootstrap(two, "finger", FEW)
