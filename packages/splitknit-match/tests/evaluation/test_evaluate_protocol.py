"""The thesis's protocol, fingers left out, systems paired, and what a set of scores must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.evaluation.protocol import (
    Exclusion,
    average_sessions,
    comparisons,
    exclude,
    pair_up,
    scores_of_comparisons,
)
from splitknit_match.evaluation.rates import histograms
from splitknit_match.evaluation.scores import Ids, Scores, ids_of
from splitknit_match.evaluation.study import _fingers_of_subjects


def small(score: list[float] | None = None) -> Scores:
    """Fingers x and y in sessions 1, 2, 3; twelve comparisons."""
    finger, session = ["x", "y"] * 3, [1, 1, 2, 2, 3, 3]
    pairs = comparisons(finger, session)
    values = np.arange(12.0) if score is None else np.array(score)
    return scores_of_comparisons(pairs, values, finger, session, ["p"] * 6)


def test_the_thesis_has_six_pairs_of_sessions() -> None:
    finger, session = np.tile(np.arange(170), 4), np.repeat(np.arange(4), 170)
    pairs = comparisons(finger, session)
    assert (int(pairs.genuine.sum()), int((~pairs.genuine).sum())) == (1020, 172_380)
    assert (session[pairs.a] < session[pairs.b]).all()
    assert len(set(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True))) == pairs.a.size
    averaged = average_sessions(scores_of_comparisons(pairs, np.zeros(pairs.a.size), finger, session))
    assert (int(averaged.label.sum()), int((~averaged.label).sum())) == (170, 28_730)


def test_impostors_of_one_session_are_compared_once() -> None:
    finger, session = ["x", "y", "z"] * 2, [1] * 3 + [2] * 3
    plain, every = comparisons(finger, session), comparisons(finger, session, within=True)
    assert every.a.size == plain.a.size + 6
    assert every.genuine.sum() == plain.genuine.sum()
    found = {frozenset(pair) for pair in zip(every.a.tolist(), every.b.tolist(), strict=True)}
    assert len(found) == every.a.size == 6 * 5 // 2  # all pairs of six captures
    scores = scores_of_comparisons(every, np.arange(15.0), finger, session)
    alone = scores_of_comparisons(plain, np.arange(9.0), finger, session)
    assert np.array_equal(average_sessions(scores).score, average_sessions(alone).score)


def test_a_finger_that_is_missing_in_a_session() -> None:
    pairs = comparisons(["x", "y", "x"], [1, 1, 2])
    assert pairs.a.tolist() == [0, 1] and pairs.b.tolist() == [2, 2] and pairs.genuine.tolist() == [True, False]
    with pytest.raises(BadInput, match="two captures"):
        comparisons(["x", "x"], [1, 1])
    with pytest.raises(BadInput, match="two sessions"):
        comparisons(["x", "y"], [1, 1])


def test_two_fingers_are_drawn_once_for_all_sessions() -> None:
    asked: list[tuple[str, str]] = []

    def drawn(one: str, other: str) -> bool:
        asked.append((one, other))
        return {one, other} == {"x", "z"}

    finger, session = ["x", "y", "z"] * 3, [k for k in (1, 2, 3) for _ in range(3)]
    few, every = comparisons(finger, session, drawn), comparisons(finger, session)
    assert len(asked) == 3
    kept = [finger[a] == finger[b] or "y" not in (finger[a], finger[b]) for a, b in zip(every.a, every.b, strict=True)]
    assert few.a.tolist() == every.a[kept].tolist() and few.b.tolist() == every.b[kept].tolist()
    assert few.genuine.tolist() == every.genuine[kept].tolist()


def test_averages_by_hand() -> None:
    # session pairs (1,2), (1,3), (2,3), each xx, xy, yx, yy
    averaged = average_sessions(small())
    assert averaged.finger is not None and averaged.subject is not None
    got = {
        tuple(averaged.finger.names[k] for k in codes): value
        for codes, value in zip(averaged.finger.codes, averaged.score, strict=True)
    }
    assert got == {("x", "x"): 4.0, ("x", "y"): 5.0, ("y", "x"): 6.0, ("y", "y"): 7.0}
    assert averaged.label.tolist() == [True, False, False, True]
    both = average_sessions(small(), ordered=False)
    assert both.score.tolist() == [4.0, 5.5, 7.0]


def test_the_earlier_session_comes_first_whatever_the_file_says() -> None:
    scores = small()
    assert scores.finger is not None and scores.session is not None
    turn = np.arange(12) % 2 == 0

    def turned(ids: Ids) -> Ids:
        return Ids(np.where(turn[:, None], ids.codes[:, ::-1], ids.codes), ids.names)

    other = replace(scores, finger=turned(scores.finger), session=turned(scores.session))
    np.testing.assert_array_equal(average_sessions(other).score, average_sessions(scores).score)


def test_failures_are_left_out_of_an_average() -> None:
    nan = float("nan")
    averaged = average_sessions(small([nan, nan, 2, 3, nan, nan, 6, 7, 8, nan, 10, 11]))
    np.testing.assert_array_equal(averaged.score, [8.0, np.nan, 6.0, 7.0])


def test_exclusions() -> None:
    left, gone, unknown = exclude(small(), [Exclusion("x", "3", "roll"), Exclusion("z")])
    assert gone == 4  # xx and yx of the session pairs (1, 3) and (2, 3)
    assert left.score.tolist() == [0, 1, 2, 3, 5, 7, 9, 11]
    assert [one.finger for one in unknown] == ["z"]
    assert left.name == "scores, without 1 excluded"
    with pytest.raises(BadInput, match="no impostor"):
        exclude(small(), [Exclusion("x")])
    with pytest.raises(BadInput, match="sessions"):
        exclude(replace(small(), session=None), [Exclusion("x", "3")])
    with pytest.raises(BadInput, match="finger_a"):
        exclude(replace(small(), finger=None), [Exclusion("x")])
    with pytest.raises(BadInput, match="sessions are needed"):
        average_sessions(replace(small(), session=None))


def test_systems_are_paired_by_their_ids() -> None:
    first = small()
    shuffled = np.random.default_rng(0).permutation(12)
    second = replace(first.taken(shuffled), name="other")
    paired = pair_up(first, second)
    assert paired is not None and paired.name == "other"
    np.testing.assert_array_equal(paired.score, first.score)
    assert second.finger is not None
    renamed = replace(second, finger=Ids(1 - second.finger.codes, second.finger.names[::-1]))  # other codes, same names
    again = pair_up(first, renamed)
    assert again is not None
    np.testing.assert_array_equal(again.score, first.score)
    assert pair_up(first, replace(second, finger=Ids(second.finger.codes, ("x", "q")))) is None
    assert pair_up(first, first.taken(np.arange(11))) is None


def test_systems_without_ids_are_paired_by_place() -> None:
    first = Scores(np.array([True, False, False]), np.array([3.0, 1.0, 2.0]))
    second = Scores(np.array([True, False, False]), np.array([5.0, 0.0, 1.0]))
    assert pair_up(first, second) is second
    assert pair_up(first, second.taken([1, 0, 2])) is None
    twice = ids_of(["x", "x", "x"], ["x", "y", "y"])  # a pair that is named twice has but its place
    named = replace(first, finger=twice), replace(second, finger=twice)
    assert pair_up(*named) is named[1]
    assert pair_up(named[0], named[1].taken([1, 0, 2])) is None


def test_fingers_are_named_within_subjects() -> None:
    finger, subject = ids_of(["thumb", "thumb"], ["thumb", "index"]), ids_of(["s", "s"], ["t", "s"])
    named = _fingers_of_subjects(finger, subject)
    assert [tuple(named.names[k] for k in codes) for codes in named.codes] == [
        ("s/thumb", "t/thumb"),
        ("s/thumb", "s/index"),
    ]


@pytest.mark.parametrize(
    ("label", "score", "words"),
    [
        ([True, False], [1.0], "one length"),
        ([1, 0], [1.0, 2.0], "boolean"),
        ([True, False], [1.0, np.inf], "finite"),
        ([True, True], [1.0, 2.0], r"no impostor \(label 0\)"),
        ([False, False], [1.0, 2.0], r"no genuine \(label 1\)"),
        ([True, False], [np.nan, 2.0], "all 1 are failures"),
    ],
)
def test_bad_sets_of_scores(label: list[bool], score: list[float], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        Scores(np.array(label), np.array(score))


def test_ids_that_contradict_labels() -> None:
    label, score = np.array([True, False]), np.array([1.0, 0.0])
    Scores(label, score, finger=ids_of(["x", "x"], ["x", "y"]), subject=ids_of(["s", "s"], ["s", "s"]))
    for finger, subject in (
        (ids_of(["x", "x"], ["y", "y"]), None),
        (ids_of(["x", "x"], ["x", "x"]), None),
        (None, ids_of(["s", "s"], ["t", "s"])),
    ):
        with pytest.raises(BadInput, match="contradict"):
            Scores(label, score, finger=finger, subject=subject)
    with pytest.raises(BadInput, match="differ in number"):
        Scores(label, score, finger=ids_of(["x"], ["x"]))
    with pytest.raises(BadInput, match="places"):
        Ids(np.array([[0, 2]]), ("x",))
    with pytest.raises(BadInput, match="shape"):
        Ids(np.array([0, 2]), ("x",))


def test_histograms() -> None:
    edges, genuine, impostor = histograms(np.array([1.0, 2.0, np.nan]), np.array([0.0, 0.0, 1.0, 1.0]))
    assert edges.tolist() == [-0.5, 0.5, 1.5, 2.5]
    assert genuine.tolist() == [0.0, 0.5, 0.5] and impostor.tolist() == [0.5, 0.5, 0.0]
    edges, genuine, impostor = histograms(np.array([0.1, 0.9]), np.array([0.0, 0.5]), bins=10)
    assert edges.size == 11 and genuine.sum() == pytest.approx(1) and impostor.sum() == pytest.approx(1)
    for close in (1.0, np.nextafter(1.0, 2.0)):
        _, genuine, impostor = histograms(np.array([1.0]), np.array([close]))
        assert genuine.sum() == 1 and impostor.sum() == 1
