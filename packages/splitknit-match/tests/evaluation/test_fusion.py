"""Fusion of scores: its gain, folds by subject, missing scores, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from refusals import bad_input
from splitknit_match.evaluation.fusion import PENALTY, fit_linear, fit_logistic, fit_minmax, fuse
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.rates import roc
from splitknit_match.evaluation.scores import Scores, ids_of


def systems(count=3, subjects=30, seed=0, noise=0.6):
    """Systems of independent errors on different scales; two fingers a subject, two sessions."""
    finger = np.tile(np.arange(2 * subjects), 2)
    session = np.repeat([1, 2], 2 * subjects)
    pairs, rng = comparisons(finger, session), np.random.default_rng(seed)
    built = []
    for k in range(count):
        score = 10.0**k * (pairs.genuine + rng.normal(0, noise, pairs.a.size)) - 5 * k
        scores = scores_of_comparisons(pairs, score, finger, session, finger // 2, name=f"s{k}")
        built.append(scores)
    return built


def separation(scores):
    return roc(scores.genuine, scores.impostor).d_prime()


@pytest.mark.parametrize("method", ["trained", "linear", "minmax"])
def test_three_independent_systems_are_better_than_the_best(method):
    three = systems()
    fused = fuse(three, method).scores
    best = max(map(separation, three))
    assert separation(fused) > 1.5 * best  # sqrt(3) with many comparisons


def test_trained_fusion_leaves_a_useless_system_out():
    good, useless = systems(2)
    noise = replace(useless, score=np.random.default_rng(5).normal(size=useless.score.size))
    trained = fuse([good, noise])
    # it pools 15 models, each of some 20 genuine pairs
    assert separation(trained.scores) > 0.9 * separation(good)
    assert separation(fuse([good, noise], "linear").scores) < 0.8 * separation(good)
    assert abs(trained.weights[1]) < 0.2 * trained.weights[0]


def test_nobody_is_trained_on_who_is_tested_on():
    """Spoil every score of one subject: only the models that score its fold stay as they were."""
    two = systems(2)
    of_subject = (two[0].subject.codes == 3).any(axis=1)
    table = np.stack([system.score for system in two], axis=1)
    wrong = 1e3 * np.sin(np.arange(of_subject.size))
    spoilt = [replace(system, score=np.where(of_subject, wrong, system.score)) for system in two]
    plain, changed = fuse(two).models, fuse(spoilt).models
    same = {key for key in plain if np.array_equal(plain[key](table), changed[key](table))}
    assert len(plain) == 15
    assert any(same == {key for key in plain if fold in key} for fold in range(5))


def test_a_system_without_a_score_is_replaced_by_the_rest():
    two, rng = systems(2), np.random.default_rng(7)
    holes = np.where(rng.random(two[0].score.size) < 0.3, np.nan, two[0].score)
    second = np.where(rng.random(two[0].score.size) < 0.2, np.nan, two[1].score)
    broken = [replace(two[0], score=holes), replace(two[1], score=second)]
    for method in ("linear", "trained"):
        fused = fuse(broken, method)
        assert np.array_equal(np.isnan(fused.scores.score), np.isnan(holes) & np.isnan(second))
        assert fused.missing == (int(np.isnan(holes).sum()), int(np.isnan(second).sum()))
        assert separation(fused.scores) > separation(broken[0])


def test_trained_fusion_learns_that_missing_scores_are_impostors():
    """A gate rejects impostors alone."""
    two = systems(2, noise=1.5)
    gated = np.where(two[0].label, two[0].score, np.nan)
    gated[np.flatnonzero(~two[0].label)[:400]] = 0.0
    fused = fuse([replace(two[0], score=gated), two[1]])
    missing = np.isnan(gated)
    assert fused.scores.score[missing].max() < np.median(fused.scores.genuine)
    usual = np.array([[np.nanmean(gated), 0.0], [np.nan, 0.0]])
    assert all(np.diff(model(usual)) < -1 for model in fused.models.values())


def test_scores_are_normalised_as_defined():
    table = np.array([[0.0, 10.0], [1.0, 30.0], [2.0, np.nan], [5.0, 20.0]])
    z = fit_linear(table, np.ones(4, bool))[1](table)
    expected = ((table[0] - [2.0, 20.0]) / [np.sqrt(3.5), np.sqrt(200 / 3)]).mean()
    assert z[0] == pytest.approx(expected)
    assert z[2] == pytest.approx(0.0)  # the second is missing, the first is the mean
    minmax = fit_minmax(table, np.ones(4, bool))[1](table)
    assert minmax == pytest.approx([0.0, 0.5 * 0.2 + 0.5, 0.4, 0.5 + 0.25])


def test_newton_reaches_the_minimum_of_a_general_minimiser():
    rng = np.random.default_rng(2)
    genuine = np.arange(400) % 5 == 0
    scores = genuine + rng.normal(0, 0.8, 400), 3 * genuine + rng.normal(0, 4, 400)
    table = np.stack(scores, axis=1)
    table[rng.random(table.shape) < 0.1] = np.nan
    table = table[~np.isnan(table).all(axis=1)]
    genuine = genuine[: len(table)]
    weight, model = fit_logistic(table, genuine)
    known, mean = ~np.isnan(table), np.nanmean(table, axis=0)
    normal = np.where(known, (table - mean) / np.nanstd(table, axis=0), 0)
    x, y = np.hstack([normal, ~known, np.ones((len(table), 1))]), np.where(genuine, 1, -1)
    fraction = np.where(genuine, 0.5 / genuine.sum(), 0.5 / (~genuine).sum())

    def loss(w):
        return fraction @ np.logaddexp(0, -y * (x @ w)) + 0.5 * PENALTY * (w[:-1] ** 2).sum()

    best = minimize(loss, np.zeros(5), method="BFGS", tol=1e-12)
    intercept, *without = model(np.array([mean, [np.nan, mean[1]], [mean[0], np.nan]]))
    fitted = np.concatenate([weight, without - intercept, [intercept]])
    assert loss(fitted) <= best.fun + 1e-9
    assert fitted == pytest.approx(best.x, abs=2e-3)


def test_separable_scores_stay_finite():
    fused = fuse(systems(2, noise=0.01)).scores
    assert np.isfinite(fused.score).all()
    assert fused.genuine.min() > fused.impostor.max()


def test_other_traits_pair_up_by_subject_and_session():
    """One finger a subject; the face has no fingers, other sides and another order."""
    system = systems(1)[0]
    finger = system.taken((system.finger.codes % 2 == 0).all(axis=1))
    order = np.random.default_rng(1).permutation(finger.label.size)
    face = replace(finger, finger=None, name="face").taken(order)
    ids = {name: getattr(face, name) for name in ("subject", "session")}
    turned = {name: replace(side, codes=side.codes[:, ::-1]) for name, side in ids.items()}
    expected = fuse([finger, replace(finger, name="again")], "linear").scores.score
    for trait in (face, replace(face, **turned)):
        assert np.allclose(fuse([finger, trait], "linear").scores.score, expected)


def test_the_pair_at_fault_is_named():
    first, second = systems(2, subjects=6)
    places = np.arange(second.label.size)
    words = "'s1' lacks, or has more than once, finger 1, subject 0, session 1 with"
    for taken in (places != 20, np.append(places, 20)):
        with bad_input(words):
            fuse([first, second.taken(taken)])
    with bad_input("did not score the same pairs"):
        fuse([first, replace(second, finger=None)])


def test_folds_are_of_fingers_where_there_are_no_subjects():
    fused = fuse([replace(system, subject=None) for system in systems(2)])
    assert (fused.by, fused.folds) == ("finger", 5)


def test_the_seed_decides_the_folds():
    two = systems(2)
    a, b, c = (fuse(two, seed=seed).scores.score for seed in (0, 0, 1))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


def test_systems_that_cannot_be_fused_are_refused():
    two = systems(2)
    with bad_input("two systems at least"):
        fuse(two[:1])
    with bad_input("did not score the same pairs"):
        fuse([two[0], systems(1, subjects=9)[0]])
    with bad_input("subject_a and subject_b"):
        fuse([replace(system, subject=None, finger=None) for system in two])
    with bad_input("do not vary"):
        fuse([two[0], replace(two[1], score=np.ones(two[1].score.size))])
    label, subject = np.array([True, False]), ids_of(["a", "b"], ["a", "a"])
    with bad_input("three subjects"):
        fuse([Scores(label, np.array([1.0, 0.0]), subject=subject, name=name) for name in "xy"])
    small = [replace(system, subject=None) for system in systems(2, subjects=2)]
    with bad_input("left to learn from"):
        fuse([system.taken((system.finger.codes < 3).all(axis=1)) for system in small])
