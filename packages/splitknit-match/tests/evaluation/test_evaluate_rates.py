"""Rates: by hand, by definition, by mathematics, and by their symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr, ndtri

import rates_by_definition as reference
from splitknit.errors import BadInput
from splitknit_match.evaluation.rates import error_bound, roc

GENUINE = [3.0, 5.0, 5.0, 6.0]
IMPOSTOR = [0.0, 1.0, 2.0, 5.0]

whole = st.lists(st.integers(-6, 6).map(float), min_size=1, max_size=14)
"""Many ties."""
real = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=14)
either = st.one_of(st.tuples(whole, whole), st.tuples(real, real))
missing = st.tuples(
    st.lists(
        st.one_of(st.integers(-4, 4).map(float), st.just(float("nan"))), min_size=1, max_size=12
    ),
    st.lists(
        st.one_of(st.integers(-4, 4).map(float), st.just(float("nan"))), min_size=1, max_size=12
    ),
).filter(lambda both: not any(np.isnan(side).all() for side in both))


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
def test_gar_at_far_by_hand_with_ties(
    target: float, gar: float, far: float, threshold: float
) -> None:
    point = roc(GENUINE, IMPOSTOR).at_far(target)
    assert (point.gar, point.far, point.threshold) == (gar, far, threshold)
    assert point.resolved == (target >= 0.25)
    assert point.false_accepts == 4 * far
    assert point.far_upper == (0.75 if far == 0 else None)


def test_tied_impostors_are_accepted_together_or_not_at_all() -> None:
    point = roc([4, 5, 6], [1, 5, 5, 5]).at_far(0.5)  # two of the three fives would be allowed
    assert (point.gar, point.far, point.false_accepts) == (pytest.approx(1 / 3), 0.0, 0)
    assert point.resolved


def test_a_target_is_met_whatever_the_last_bit_of_it_says() -> None:
    impostor = np.arange(100.0)
    for target in (0.01, 0.07, 0.29, 0.57, 0.58):  # 100 * 0.29 is 28.999999999999996
        assert roc([-1.0], impostor).at_far(target).false_accepts == round(100 * target)


def test_nobody_is_accepted_where_impostors_score_highest() -> None:
    point = roc([1.0], [2.0, 3.0]).at_far(0.001)
    assert (point.gar, point.far, point.threshold) == (0.0, 0.0, None)


def test_rule_of_three() -> None:
    assert error_bound(0.0, 300) == 0.01
    assert error_bound(0.0, 2) == 1.0
    assert roc([1.0], np.zeros(1000)).at_far(0.0001).far_upper == 0.003


@pytest.mark.parametrize(
    ("genuine", "impostor", "value"),
    [
        ([0.9, 0.8, 0.7, 0.3], [0.1, 0.2, 0.4, 0.5], 0.25),
        ([2.0, 3.0], [0.0, 1.0], 0.0),
        ([0.0, 1.0], [2.0, 3.0], 1.0),
        ([1.0], [1.0], 0.5),
        ([1.0, 1.0, 2.0], [1.0, 1.0], 1 / 3),  # at t = 2: FAR 0, FRR 2/3; at t = 1: FAR 1, FRR 0
        (GENUINE, IMPOSTOR, 0.25),  # t = 5: both 1/4, so that they meet
        # t = 4: FAR 1/2, FRR 1/3; t = 5: FAR 1/2, FRR 2/3
        ([3.0, 4.0, 6.0], [0.0, 1.0, 5.0, 5.0], 5 / 12),
    ],
)
def test_equal_error_by_hand(genuine: list[float], impostor: list[float], value: float) -> None:
    assert roc(genuine, impostor).equal_error().value == pytest.approx(value)


def test_roc_by_hand() -> None:
    found = roc([1.0, 2.0], [0.0, 1.0, 1.5])
    corners = list(zip(found.far.tolist(), found.gar.tolist(), strict=True))
    assert corners == [(0, 0), (0, 0.5), (1 / 3, 0.5), (2 / 3, 1), (1, 1)]
    assert found.ranked.threshold.tolist() == [np.inf, 2.0, 1.5, 1.0, 0.0]


@given(either)
def test_as_by_definition(sides: tuple[list[float], list[float]]) -> None:
    genuine, impostor = sides
    assert roc(genuine, impostor).equal_error().value == reference.equal_error(genuine, impostor)
    assert roc(genuine, impostor).auc() == pytest.approx(reference.auc(genuine, impostor))
    for target in (0.0001, 0.1, 0.25, 1 / 3, 0.5, 1.0):
        point = roc(genuine, impostor).at_far(target)
        assert (point.gar, point.far) == reference.gar_at_far(genuine, impostor, target)


@given(missing)
def test_failures_are_rejections_or_left_out(sides: tuple[list[float], list[float]]) -> None:
    genuine, impostor = sides
    assert roc(genuine, impostor).equal_error().value == reference.equal_error(genuine, impostor)
    made = [[s for s in side if not np.isnan(s)] for side in sides]
    left_out = roc(genuine, impostor).scored().equal_error()
    assert left_out == roc(*made).equal_error()
    for target in (0.1, 0.3, 0.5):
        point = roc(genuine, impostor).at_far(target)
        assert (point.gar, point.far) == reference.gar_at_far(genuine, impostor, target)
        assert roc(genuine, impostor).scored().at_far(target) == roc(*made).at_far(target)
    assert roc(genuine, impostor).auc() == roc(*made).auc()
    # ISO/IEC 19795-1: FAR = FMR (1 - FTA), FRR = FTA + FNMR (1 - FTA)
    every, some = roc(genuine, impostor), roc(genuine, impostor).scored()
    fractions = [1 - len(few) / len(all_) for few, all_ in zip(made, sides, strict=True)]
    np.testing.assert_allclose(every.far, some.far * (1 - fractions[1]))
    np.testing.assert_allclose(
        1 - every.gar, fractions[0] + (1 - some.gar) * (1 - fractions[0]), atol=1e-12
    )


@given(either)
def test_the_roc_rises_and_holds_every_point(sides: tuple[list[float], list[float]]) -> None:
    genuine, impostor = sides
    found = roc(genuine, impostor)
    assert (np.diff(found.far) >= 0).all() and (np.diff(found.gar) >= 0).all()
    assert (found.far[0], found.gar[0], found.far[-1], found.gar[-1]) == (0, 0, 1, 1)
    assert (np.diff(found.ranked.threshold) <= 0).all()
    for t, far, gar in zip(found.ranked.threshold, found.far, found.gar, strict=True):
        assert far == np.mean(np.array(impostor) >= t) and gar == np.mean(np.array(genuine) >= t)
    # on a corner, or between two on a line along an axis
    for _, far, frr in reference.points(genuine, impostor):
        x, y = float(far), float(1 - frr)
        on = (
            (found.far[:-1] <= x)
            & (x <= found.far[1:])
            & (found.gar[:-1] <= y)
            & (y <= found.gar[1:])
        )
        assert (
            on & ((found.far[:-1] == found.far[1:]) | (found.gar[:-1] == found.gar[1:]))
        ).any() or ((found.far == x) & (found.gar == y)).any()


@given(st.tuples(whole, whole))
def test_order_is_all_that_counts(sides: tuple[list[float], list[float]]) -> None:
    genuine, impostor = map(np.array, sides)

    def bent(s: np.ndarray) -> np.ndarray:
        return np.exp(s / 3) - 100 * np.exp(-s)

    assert (
        roc(bent(genuine), bent(impostor)).equal_error().value
        == roc(genuine, impostor).equal_error().value
    )
    assert roc(bent(genuine), bent(impostor)).auc() == roc(genuine, impostor).auc()
    np.testing.assert_array_equal(
        roc(bent(genuine), bent(impostor)).gar, roc(genuine, impostor).gar
    )
    assert (
        roc(bent(genuine), bent(impostor)).at_far(0.1).gar == roc(genuine, impostor).at_far(0.1).gar
    )


@given(st.tuples(whole, whole))
def test_exchanging_the_classes_exchanges_the_errors(
    sides: tuple[list[float], list[float]],
) -> None:
    genuine, impostor = map(np.array, sides)
    assert (
        roc(-impostor, -genuine).equal_error().value == roc(genuine, impostor).equal_error().value
    )
    assert roc(-impostor, -genuine).auc() == pytest.approx(roc(genuine, impostor).auc())
    assert roc(impostor, genuine).auc() == pytest.approx(1 - roc(genuine, impostor).auc())
    assert roc(-impostor, -genuine).d_prime() == pytest.approx(
        roc(genuine, impostor).d_prime(), nan_ok=True
    )


@given(st.tuples(whole, whole), st.randoms(use_true_random=False))
def test_order_of_the_scores_does_not_count(
    sides: tuple[list[float], list[float]], random: object
) -> None:
    genuine, impostor = (list(side) for side in sides)
    before = roc(genuine, impostor).equal_error(), roc(genuine, impostor).at_far(0.2)
    random.shuffle(genuine)  # type: ignore[attr-defined]
    random.shuffle(impostor)  # type: ignore[attr-defined]
    assert (roc(genuine, impostor).equal_error(), roc(genuine, impostor).at_far(0.2)) == before


@pytest.mark.parametrize("distance", [0.5, 1.5, 3.0])
def test_two_normal_distributions(distance: float) -> None:
    quantiles = (np.arange(40_000) + 0.5) / 40_000
    impostor = ndtri(quantiles)
    genuine = impostor[::4] + distance
    assert roc(genuine, impostor).equal_error().value == pytest.approx(
        ndtr(-distance / 2), abs=2e-4
    )
    assert roc(genuine, impostor).auc() == pytest.approx(ndtr(distance / np.sqrt(2)), abs=1e-4)
    assert roc(genuine, impostor).d_prime() == pytest.approx(distance, abs=2e-3)
    for target in (0.01, 0.001):
        expected = ndtr(distance + ndtri(target))
        assert roc(genuine, impostor).at_far(target).gar == pytest.approx(expected, abs=5e-3)


def test_d_prime_by_hand() -> None:
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
def test_bad_scores(genuine: list[float], impostor: list[float], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        roc(genuine, impostor)


@pytest.mark.parametrize("target", [0.0, -0.1, 1.1, float("nan")])
def test_bad_targets(target: float) -> None:
    with pytest.raises(BadInput, match="target"):
        roc([1.0], [0.0]).at_far(target)
