"""Fusion of scores: what it gives, that it never sees whom it is tested on, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from splitknit.errors import BadInput
from splitknit_match.evaluation.fusion import fit_linear, fit_logistic, fit_minmax, fuse
from splitknit_match.evaluation.parameters import PENALTY
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.rates import roc
from splitknit_match.evaluation.scores import Scores, ids_of


def systems(count: int = 3, subjects: int = 30, seed: int = 0, noise: float = 0.6) -> list[Scores]:
    """Systems of independent errors, two fingers of each subject in two sessions, on scales of
    their own."""
    finger = np.tile(np.arange(2 * subjects), 2)
    session = np.repeat([1, 2], 2 * subjects)
    pairs, rng = comparisons(finger, session), np.random.default_rng(seed)
    found = []
    for k in range(count):
        score = 10.0**k * (pairs.genuine + rng.normal(0, noise, pairs.a.size)) - 5 * k
        found.append(
            scores_of_comparisons(pairs, score, finger, session, finger // 2, name=f"s{k}")
        )
    return found


def separation(scores: Scores) -> float:
    return roc(scores.genuine, scores.impostor).d_prime()


@pytest.mark.parametrize("method", ["trained", "linear", "minmax"])
def test_three_independent_systems_are_better_than_the_best(method: str) -> None:
    three = systems()
    fused = fuse(three, method).scores
    best = max(separation(one) for one in three)
    assert separation(fused) > 1.5 * best  # sqrt(3), less what so few comparisons cost


def test_the_trained_one_leaves_a_useless_system_out() -> None:
    good, useless = systems(2)
    noise = replace(useless, score=np.random.default_rng(5).normal(size=useless.score.size))
    trained = fuse([good, noise])
    # it pools 15 models, each of some 20 genuine pairs
    assert separation(trained.scores) > 0.9 * separation(good)
    assert separation(fuse([good, noise], "linear").scores) < 0.8 * separation(good)
    assert abs(trained.weights[1]) < 0.2 * trained.weights[0]


def test_nobody_is_trained_on_who_is_tested_on() -> None:
    """Spoil all that one subject took part in: only the models that score its fold stay as they
    were."""
    two = systems(2)
    assert two[0].subject is not None
    mine = (two[0].subject.codes == 3).any(axis=1)
    spoilt = [
        replace(one, score=np.where(mine, 1e3 * np.sin(np.arange(mine.size)), one.score))
        for one in two
    ]
    plain, other = fuse(two), fuse(spoilt)
    table = np.stack([one.score for one in two], axis=1)
    same = {
        key
        for key, model in plain.models.items()
        if np.array_equal(model(table), other.models[key](table))
    }
    assert len(plain.models) == 15
    assert any(same == {key for key in plain.models if fold in key} for fold in range(5))


def test_missing_scores_are_made_up_for_by_the_others() -> None:
    two, rng = systems(2), np.random.default_rng(7)
    holes = np.where(rng.random(two[0].score.size) < 0.3, np.nan, two[0].score)
    second = np.where(rng.random(two[0].score.size) < 0.2, np.nan, two[1].score)
    broken = [replace(two[0], score=holes), replace(two[1], score=second)]
    for method in ("linear", "trained"):
        fused = fuse(broken, method)
        assert np.array_equal(np.isnan(fused.scores.score), np.isnan(holes) & np.isnan(second))
        assert fused.missing == (int(np.isnan(holes).sum()), int(np.isnan(second).sum()))
        assert separation(fused.scores) > separation(broken[0])


def test_a_missing_score_can_tell_something() -> None:
    """Where impostors are gated and genuine pairs are not, the trained fusion learns that."""
    two = systems(2, noise=1.5)
    gated = np.where(two[0].label, two[0].score, np.nan)
    gated[np.flatnonzero(~two[0].label)[:400]] = 0.0
    fused = fuse([replace(two[0], score=gated), two[1]])
    missing = np.isnan(gated)
    assert fused.scores.score[missing].max() < np.median(fused.scores.genuine)
    usual = np.array([[np.nanmean(gated), 0.0], [np.nan, 0.0]])
    assert all(np.diff(model(usual)) < -1 for model in fused.models.values())


def test_normalisation_is_as_defined() -> None:
    table = np.array([[0.0, 10.0], [1.0, 30.0], [2.0, np.nan], [5.0, 20.0]])
    z = fit_linear(table, np.ones(4, bool))[1](table)
    expected = ((table[0] - [2.0, 20.0]) / [np.sqrt(3.5), np.sqrt(200 / 3)]).mean()
    assert z[0] == pytest.approx(expected)
    assert z[2] == pytest.approx(0.0)  # the second is missing, the first is the mean
    minmax = fit_minmax(table, np.ones(4, bool))[1](table)
    assert minmax == pytest.approx([0.0, 0.5 * 0.2 + 0.5, 0.4, 0.5 + 0.25])


def test_newton_finds_the_least_loss() -> None:
    """Against a general minimiser on the loss as it is defined."""
    rng = np.random.default_rng(2)
    genuine = np.arange(400) % 5 == 0
    table = np.stack(
        [genuine + rng.normal(0, 0.8, 400), 3 * genuine + rng.normal(0, 4, 400)], axis=1
    )
    table[rng.random(table.shape) < 0.1] = np.nan
    table = table[~np.isnan(table).all(axis=1)]
    genuine = genuine[: len(table)]
    weight, model = fit_logistic(table, genuine)
    known = ~np.isnan(table)
    normal = np.where(known, (table - np.nanmean(table, axis=0)) / np.nanstd(table, axis=0), 0)
    x, y = np.hstack([normal, ~known, np.ones((len(table), 1))]), np.where(genuine, 1, -1)
    fraction = np.where(genuine, 0.5 / genuine.sum(), 0.5 / (~genuine).sum())

    def loss(w):
        return fraction @ np.logaddexp(0, -y * (x @ w)) + 0.5 * PENALTY * (w[:-1] ** 2).sum()

    best = minimize(loss, np.zeros(5), method="BFGS", tol=1e-12)
    mean = np.nanmean(table, axis=0)
    intercept, *without = model(np.array([mean, [np.nan, mean[1]], [mean[0], np.nan]]))
    mine = np.concatenate([weight, without - intercept, [intercept]])
    assert loss(mine) <= best.fun + 1e-9
    assert mine == pytest.approx(best.x, abs=2e-3)


def test_separable_scores_stay_finite() -> None:
    fused = fuse(systems(2, noise=0.01)).scores
    assert np.isfinite(fused.score).all()
    assert fused.genuine.min() > fused.impostor.max()


def test_other_traits_pair_up_by_subject_and_session() -> None:
    """One finger a subject; the face has no fingers, other sides and another order."""
    two = systems(2, subjects=30)
    one = two[0].taken((two[0].finger.codes % 2 == 0).all(axis=1))  # type: ignore[union-attr]
    order = np.random.default_rng(1).permutation(one.label.size)
    face = replace(one, finger=None, name="face").taken(order)
    turned = replace(
        face,
        subject=replace(face.subject, codes=face.subject.codes[:, ::-1]),  # type: ignore[type-var]
        session=replace(face.session, codes=face.session.codes[:, ::-1]),  # type: ignore[type-var]
    )  # fmt: skip
    expected = fuse([one, replace(one, name="again")], "linear").scores.score
    for other in (face, turned):
        assert np.allclose(fuse([one, other], "linear").scores.score, expected)


def test_the_pair_at_fault_is_named() -> None:
    one, other = systems(2, subjects=6)
    fewer = other.taken(np.arange(other.label.size) != 20)
    again = other.taken(np.append(np.arange(other.label.size), 20))
    for wrong in (fewer, again):
        with pytest.raises(
            BadInput, match="'s1' lacks, or has more than once, finger 1, subject 0, session 1 with"
        ):
            fuse([one, wrong])
    with pytest.raises(BadInput, match="did not score the same pairs"):
        fuse([one, replace(other, finger=None)])


def test_the_order_of_pairs_does_not_matter() -> None:
    two = systems(2)
    order = np.random.default_rng(1).permutation(two[0].label.size)
    shuffled = two[1].taken(order)
    assert np.array_equal(fuse([two[0], shuffled]).scores.score, fuse(two).scores.score)


def test_fingers_where_there_are_no_subjects() -> None:
    fused = fuse([replace(one, subject=None) for one in systems(2)])
    assert (fused.by, fused.folds) == ("finger", 5)


def test_the_seed_decides_the_folds() -> None:
    two = systems(2)
    a, b, c = (fuse(two, seed=seed).scores.score for seed in (0, 0, 1))
    assert np.array_equal(a, b) and not np.array_equal(a, c)


def test_what_cannot_be_fused_is_refused() -> None:
    two = systems(2)
    with pytest.raises(BadInput, match="two systems at least"):
        fuse(two[:1])
    with pytest.raises(BadInput, match="did not score the same pairs"):
        fuse([two[0], systems(1, subjects=9)[0]])
    with pytest.raises(BadInput, match="subject_a and subject_b"):
        fuse([replace(one, subject=None, finger=None) for one in two])
    with pytest.raises(BadInput, match="do not vary"):
        fuse([two[0], replace(two[1], score=np.ones(two[1].score.size))])
    few = ids_of(["a", "b"], ["a", "a"])
    with pytest.raises(BadInput, match="three subjects"):
        fuse(
            [
                Scores(np.array([True, False]), np.array([1.0, 0.0]), subject=few, name=name)
                for name in "xy"
            ]
        )
    with pytest.raises(BadInput, match="left to learn from"):
        fuse(
            [
                replace(one, subject=None).taken((one.finger.codes < 3).all(axis=1))
                for one in systems(2, subjects=2)
            ]
        )
