"""The thesis's protocol, pairing of systems, checks of a set of scores."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.evaluation.protocol import (
    average_sessions,
    comparisons,
    pair_up,
    scores_of_comparisons,
)
from splitknit_match.evaluation.scores import Ids, Scores, ids_of


def small(score=None):
    """Fingers x and y in sessions 1, 2, 3; twelve comparisons."""
    finger, session = ["x", "y"] * 3, [1, 1, 2, 2, 3, 3]
    pairs = comparisons(finger, session)
    values = np.arange(12.0) if score is None else np.array(score)
    return scores_of_comparisons(pairs, values, finger, session, ["p"] * 6)


def test_the_thesis_has_six_pairs_of_sessions():
    finger, session = np.tile(np.arange(170), 4), np.repeat(np.arange(4), 170)
    pairs = comparisons(finger, session)
    assert (int(pairs.genuine.sum()), int((~pairs.genuine).sum())) == (1020, 172_380)
    assert (session[pairs.a] < session[pairs.b]).all()
    assert len(set(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True))) == pairs.a.size
    scores = scores_of_comparisons(pairs, np.zeros(pairs.a.size), finger, session)
    averaged = average_sessions(scores)
    assert (int(averaged.label.sum()), int((~averaged.label).sum())) == (170, 28_730)


def test_impostors_of_one_session_are_compared_once():
    finger, session = ["x", "y", "z"] * 2, [1] * 3 + [2] * 3
    plain, every = comparisons(finger, session), comparisons(finger, session, within=True)
    assert every.a.size == plain.a.size + 6
    assert every.genuine.sum() == plain.genuine.sum()
    unordered = {frozenset(pair) for pair in zip(every.a.tolist(), every.b.tolist(), strict=True)}
    assert len(unordered) == every.a.size == 6 * 5 // 2  # all pairs of six captures
    scores = scores_of_comparisons(every, np.arange(15.0), finger, session)
    alone = scores_of_comparisons(plain, np.arange(9.0), finger, session)
    assert np.array_equal(average_sessions(scores).score, average_sessions(alone).score)


def test_a_finger_that_is_missing_in_a_session_is_compared_with_the_others():
    pairs = comparisons(["x", "y", "x"], [1, 1, 2])
    assert pairs.a.tolist() == [0, 1]
    assert pairs.b.tolist() == [2, 2]
    assert pairs.genuine.tolist() == [True, False]


def test_one_capture_a_finger_and_session_and_two_sessions_are_needed():
    with bad_input("two captures"):
        comparisons(["x", "x"], [1, 1])
    with bad_input("two sessions"):
        comparisons(["x", "y"], [1, 1])


def test_two_fingers_are_drawn_once_for_all_sessions():
    asked = []

    def drawn(finger_a, finger_b):
        asked.append({finger_a, finger_b})
        return asked[-1] == {"x", "z"}

    finger, session = ["x", "y", "z"] * 3, np.repeat([1, 2, 3], 3)
    few, every = comparisons(finger, session, drawn), comparisons(finger, session)
    assert len(asked) == 3
    kept = [
        finger[a] == finger[b] or "y" not in (finger[a], finger[b])
        for a, b in zip(every.a, every.b, strict=True)
    ]
    for name in ("a", "b", "genuine"):
        assert getattr(few, name).tolist() == getattr(every, name)[kept].tolist()


def test_scores_of_two_fingers_are_averaged_over_pairs_of_sessions():
    # session pairs (1,2), (1,3), (2,3), each xx, xy, yx, yy
    averaged = average_sessions(small())
    assert averaged.subject is not None
    names = np.array(averaged.finger.names)[averaged.finger.codes]
    by_fingers = dict(zip(map("".join, names), averaged.score.tolist(), strict=True))
    assert by_fingers == {"xx": 4.0, "xy": 5.0, "yx": 6.0, "yy": 7.0}
    assert averaged.label.tolist() == [True, False, False, True]
    with bad_input("sessions are needed"):
        average_sessions(replace(small(), session=None))


def test_averages_do_not_depend_on_which_session_stands_first():
    scores = small()
    turn = np.arange(12) % 2 == 0

    def turned(ids):
        return Ids(np.where(turn[:, None], ids.codes[:, ::-1], ids.codes), ids.names)

    mixed = replace(scores, finger=turned(scores.finger), session=turned(scores.session))
    np.testing.assert_array_equal(average_sessions(mixed).score, average_sessions(scores).score)


def test_failures_are_left_out_of_an_average():
    nan = float("nan")
    averaged = average_sessions(small([nan, nan, 2, 3, nan, nan, 6, 7, 8, nan, 10, 11]))
    np.testing.assert_array_equal(averaged.score, [8.0, np.nan, 6.0, 7.0])


def test_systems_are_paired_by_their_ids():
    first = small()
    second = replace(first.taken(np.random.default_rng(0).permutation(12)), name="other")
    # other codes, same names
    renamed = replace(second, finger=Ids(1 - second.finger.codes, second.finger.names[::-1]))
    for system in (second, renamed):
        paired = pair_up(first, system)
        assert paired.name == "other"
        np.testing.assert_array_equal(paired.score, first.score)
    stranger = replace(second, finger=Ids(second.finger.codes, ("x", "q")))
    words = r"same pairs: .* lacks, or has more than once, .*finger [xy]"
    for system in (stranger, first.taken(np.arange(11))):
        with bad_input(words):
            pair_up(first, system)


def test_systems_without_ids_are_paired_by_place():
    label, twice = np.array([True, False, False]), ids_of(["x", "x", "x"], ["x", "y", "y"])
    for finger in (None, twice):  # two pairs of the same fingers differ by their place alone
        first = Scores(label, np.array([3.0, 1.0, 2.0]), finger=finger)
        second = Scores(label, np.array([5.0, 0.0, 1.0]), finger=finger)
        assert pair_up(first, second) is second
        with bad_input("same pairs"):
            pair_up(first, second.taken([1, 0, 2]))


@pytest.mark.parametrize(
    ("label", "score", "words"),
    [
        ([True, False], [1.0, np.inf], "finite"),
        ([True, True], [1.0, 2.0], r"no impostor \(label 0\)"),
        ([False, False], [1.0, 2.0], r"no genuine \(label 1\)"),
        ([True, False], [np.nan, 2.0], "all 1 are failures"),
    ],
)
def test_scores_need_both_classes_and_finite_values(label, score, words):
    with bad_input(words):
        Scores(np.array(label), np.array(score))


def test_ids_that_contradict_labels_are_refused():
    label, score = np.array([True, False]), np.array([1.0, 0.0])
    subject = ids_of(["s", "s"], ["s", "s"])
    Scores(label, score, finger=ids_of(["x", "x"], ["x", "y"]), subject=subject)
    for ids in (
        {"finger": ids_of(["x", "x"], ["y", "y"])},
        {"finger": ids_of(["x", "x"], ["x", "x"])},
        {"subject": ids_of(["s", "s"], ["t", "s"])},
    ):
        with bad_input("contradict"):
            Scores(label, score, **ids)
