"""1:N identification: ranks by hand and by definition, and what is not such data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit_match.evaluation.facts import cmc, rank_one_interval
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.scores import Scores, ids_of


def matrix(values: list[list[float]]) -> Scores:
    """Probes (rows) with a gallery (columns) of the same fingers."""
    count = len(values)
    a, b = np.repeat(np.arange(count), count), np.tile(np.arange(count), count)
    return Scores(a == b, np.array(values, dtype=np.float64).ravel(), finger=ids_of(a.tolist(), b.tolist()))


def test_ranks_by_hand() -> None:
    found = cmc(matrix([[9, 1, 2], [5, 4, 3], [8, 7, 6]]))
    assert found is not None
    assert found.rank.tolist() == [1, 2, 3] and found.gallery == 3 and found.left_out == 0
    np.testing.assert_allclose(found.rate, [1 / 3, 2 / 3, 1])


def test_ties_count_against_us_and_failures_are_never_found() -> None:
    nan = float("nan")
    found = cmc(matrix([[5, 5, 1], [nan, 1, nan], [9, 1, nan]]))
    assert found is not None
    assert found.rank.tolist() == [2, 1, 0]
    np.testing.assert_allclose(found.rate, [1 / 3, 2 / 3, 2 / 3])


def test_the_best_of_several_scores_counts() -> None:
    one = matrix([[1, 3], [0, 5]])
    assert one.finger is not None
    twice = Scores(
        np.append(one.label, True),
        np.append(one.score, 4.0),
        finger=ids_of([0, 0, 1, 1, 0], [0, 1, 0, 1, 0]),
    )
    before, after = cmc(one), cmc(twice)
    assert before is not None and after is not None
    assert before.rank.tolist() == [2, 1] and after.rank.tolist() == [1, 1]


def test_against_the_definition() -> None:
    generator = np.random.default_rng(0)
    fingers, sessions = 12, 3
    finger, session = np.tile(np.arange(fingers), sessions), np.repeat(np.arange(sessions), fingers)
    pairs = comparisons(finger, session)
    score = generator.integers(0, 6, pairs.a.size) + 2.0 * pairs.genuine
    order = generator.permutation(pairs.a.size)
    found = cmc(scores_of_comparisons(pairs, score, finger, session).taken(order))
    ranks = []
    for probe in range(fingers * sessions):
        for gallery in range(session[probe] + 1, sessions):
            chosen = (pairs.a == probe) & (session[pairs.b] == gallery)
            own = score[chosen & pairs.genuine][0]
            ranks.append(1 + int(np.sum(score[chosen & ~pairs.genuine] >= own)))
    assert found is not None
    assert sorted(found.rank.tolist()) == sorted(ranks)
    np.testing.assert_allclose(found.rate, [np.mean(np.array(ranks) <= k) for k in range(1, fingers + 1)])


def test_probes_without_their_whole_gallery_are_left_out() -> None:
    scores = matrix([[9, 1, 2], [5, 4, 3], [8, 7, 6]])
    found = cmc(scores.taken(np.arange(8)))
    assert found is not None
    assert found.rank.tolist() == [1, 2] and found.left_out == 1


def test_what_is_no_identification() -> None:
    scores = matrix([[9, 1, 2], [5, 4, 3], [8, 7, 6]])
    assert cmc(replace(scores, finger=None)) is None
    triangle = scores.taken([0, 1, 2, 4, 5])  # each pair once: nobody meets a whole gallery but the first
    found = cmc(triangle)
    assert found is not None and found.left_out == 1
    assert cmc(matrix([[9, 1], [1, 9]]).taken([0, 2])) is None


def test_interval_of_rank_one() -> None:
    generator = np.random.default_rng(1)
    values = generator.normal(size=(40, 40)) + 2.5 * np.eye(40)
    found = cmc(matrix(values.tolist()))
    assert found is not None
    low, high = rank_one_interval(found, replicates=500)
    fraction = found.rate[0]
    assert low < fraction < high
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(fraction * (1 - fraction) / 40), rel=0.2)
    sure = cmc(matrix((9 * np.eye(30)).tolist()))
    assert sure is not None and rank_one_interval(sure) == (pytest.approx(0.9), 1.0)
