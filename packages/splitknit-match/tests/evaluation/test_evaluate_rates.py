"""Rates: by hand, by definition, by mathematics, and by their symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import rates_by_definition as reference
from refusals import bad_input
from splitknit_match.evaluation.rates import error_bound, roc

GENUINE = [3.0, 5.0, 5.0, 6.0]
IMPOSTOR = [0.0, 1.0, 2.0, 5.0]

whole = st.lists(st.integers(-6, 6).map(float), min_size=1, max_size=14)
"""Many ties."""
real = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=14)
either = st.one_of(st.tuples(whole, whole), st.tuples(real, real))
whole_or_failed = st.one_of(st.integers(-4, 4).map(float), st.just(float("nan")))
some_failed = st.lists(whole_or_failed, min_size=1, max_size=12)
missing = st.tuples(some_failed, some_failed).filter(
    lambda both: not any(np.isnan(side).all() for side in both)
)


@pytest.mark.parametrize(
    ("target", "gar", "far", "threshold"),
    [
        (1.0, 1.0, 1.0, 0.0),
        (0.99, 1.0, 0.75, 1.0),
        (0.75, 1.0, 0.75, 1.0),
        (0.5, 1.0, 0.5, 2.0),
        (0.25, 1.0, 0.25, 3.0),
        (0.2499, 0.25, 0.0, 6.0),
        (0.0001, 0.25, 0.0, 6.0),
    ],
)
def test_gar_at_far_with_ties_is_that_counted_by_hand(target, gar, far, threshold):
    point = roc(GENUINE, IMPOSTOR).at_far(target)
    assert (point.gar, point.far, point.threshold) == (gar, far, threshold)
    assert point.resolved == (target >= 0.25)
    assert point.false_accepts == 4 * far
    assert point.far_upper == (0.75 if far == 0 else None)


def test_a_target_is_met_whatever_the_last_bit_of_it_says():
    impostor = np.arange(100.0)
    for target in (0.01, 0.07, 0.29, 0.57, 0.58):  # 100 * 0.29 is 28.999999999999996
        assert roc([-1.0], impostor).at_far(target).false_accepts == round(100 * target)


def test_nobody_is_accepted_where_impostors_score_highest():
    point = roc([1.0], [2.0, 3.0]).at_far(0.001)
    assert (point.gar, point.far, point.threshold) == (0.0, 0.0, None)


def test_no_error_is_bounded_by_the_rule_of_three():
    assert error_bound(0.0, 300) == 0.01
    assert error_bound(0.0, 2) == 1.0
    assert roc([1.0], np.zeros(1000)).at_far(0.0001).far_upper == 0.003


@given(either)
def test_rates_are_those_of_their_definition(sides):
    curve = roc(*sides)
    assert curve.equal_error().value == reference.equal_error(*sides)
    assert curve.auc() == pytest.approx(reference.auc(*sides))
    for target in (0.0001, 0.1, 0.25, 1 / 3, 0.5, 1.0):
        point = curve.at_far(target)
        assert (point.gar, point.far) == reference.gar_at_far(*sides, target)


@given(missing)
def test_failures_are_rejections_or_left_out(sides):
    compared = [[s for s in side if not np.isnan(s)] for side in sides]
    every, left_out, alone = roc(*sides), roc(*sides).scored(), roc(*compared)
    assert every.equal_error().value == reference.equal_error(*sides)
    assert left_out.equal_error() == alone.equal_error()
    for target in (0.1, 0.3, 0.5):
        point = every.at_far(target)
        assert (point.gar, point.far) == reference.gar_at_far(*sides, target)
        assert left_out.at_far(target) == alone.at_far(target)
    assert every.auc() == alone.auc()
    # ISO/IEC 19795-1: FAR = FMR (1 - FTA), FRR = FTA + FNMR (1 - FTA)
    genuine, impostor = (len(compared[k]) / len(sides[k]) for k in (0, 1))  # 1 - FTA
    assert_allclose(every.far, left_out.far * impostor)
    frr = 1 - genuine + (1 - left_out.gar) * genuine
    assert_allclose(1 - every.gar, frr, atol=1e-12)


@given(either)
def test_the_roc_rises_and_holds_every_point(sides):
    genuine, impostor = map(np.array, sides)
    curve = roc(genuine, impostor)
    fars, gars, thresholds = curve.far, curve.gar, curve.ranked.threshold
    assert (np.diff(fars) >= 0).all()
    assert (np.diff(gars) >= 0).all()
    assert (np.diff(thresholds) <= 0).all()
    assert (fars[0], gars[0], fars[-1], gars[-1]) == (0, 0, 1, 1)
    assert_array_equal(fars, [np.mean(impostor >= t) for t in thresholds])
    assert_array_equal(gars, [np.mean(genuine >= t) for t in thresholds])
    # on a corner, or between two on a line along an axis
    along_an_axis = (fars[:-1] == fars[1:]) | (gars[:-1] == gars[1:])
    for _, far, frr in reference.points(*sides):
        x, y = float(far), float(1 - frr)
        between = (fars[:-1] <= x) & (x <= fars[1:]) & (gars[:-1] <= y) & (y <= gars[1:])
        assert (between & along_an_axis).any() or ((fars == x) & (gars == y)).any()


def test_d_prime_is_that_of_its_formula_and_nan_without_spread():
    assert roc([4.0, 6.0], [0.0, 2.0]).d_prime() == pytest.approx(4.0)
    assert roc([0.0, 2.0], [4.0, 6.0]).d_prime() == pytest.approx(-4.0)
    for sides in (([1.0, 1.0], [1.0]), ([2.0], [1.0]), ([0.1] * 3, [0.3] * 3)):
        assert np.isnan(roc(*sides).d_prime())


@pytest.mark.parametrize(
    ("genuine", "impostor", "words"),
    [
        ([], [1.0], "genuine scores must be finite"),
        ([1.0], [np.nan], "impostor scores must be finite"),
        ([np.inf], [1.0], "genuine scores must be finite"),
        ([1.0], [-np.inf, 2.0], "impostor scores must be finite"),
    ],
)
def test_empty_or_infinite_scores_are_refused(genuine, impostor, words):
    with bad_input(words):
        roc(genuine, impostor)


@pytest.mark.parametrize("target", [0.0, -0.1, 1.1, float("nan")])
def test_targets_that_are_no_rate_are_refused(target):
    with bad_input("target"):
        roc([1.0], [0.0]).at_far(target)
