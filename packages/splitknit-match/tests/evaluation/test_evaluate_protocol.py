"""The thesis's protocol, systems paired, and what a set of scores must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.evaluation.protocol import (
    average_sessions,
    comparisons,
    pair_up,
    scores_of_comparisons,
)
from splitknit_match.evaluation.scores import Ids, Scores, ids_of


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
    averaged = average_sessions(
        scores_of_comparisons(pairs, np.zeros(pairs.a.size), finger, session)
    )
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
    assert (
        pairs.a.tolist() == [0, 1]
        and pairs.b.tolist() == [2, 2]
        and pairs.genuine.tolist() == [True, False]
    )
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
    kept = [
        finger[a] == finger[b] or "y" not in (finger[a], finger[b])
        for a, b in zip(every.a, every.b, strict=True)
    ]
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
    with pytest.raises(BadInput, match="sessions are needed"):
        average_sessions(replace(small(), session=None))


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


def test_systems_are_paired_by_their_ids() -> None:
    first = small()
    second = replace(first.taken(np.random.default_rng(0).permutation(12)), name="other")
    assert second.finger is not None
    # other codes, same names
    renamed = replace(second, finger=Ids(1 - second.finger.codes, second.finger.names[::-1]))
    for other in (second, renamed):
        paired = pair_up(first, other)
        assert paired.name == "other"
        np.testing.assert_array_equal(paired.score, first.score)
    stranger = replace(second, finger=Ids(second.finger.codes, ("x", "q")))
    for other in (stranger, first.taken(np.arange(11))):
        with pytest.raises(
            BadInput, match=r"same pairs: .* lacks, or has more than once, .*finger [xy]"
        ):
            pair_up(first, other)


def test_systems_without_ids_are_paired_by_place() -> None:
    first = Scores(np.array([True, False, False]), np.array([3.0, 1.0, 2.0]))
    second = Scores(np.array([True, False, False]), np.array([5.0, 0.0, 1.0]))
    twice = ids_of(["x", "x", "x"], ["x", "y", "y"])  # a pair that is named twice has but its place
    for one, other in (
        (first, second),
        (replace(first, finger=twice), replace(second, finger=twice)),
    ):
        assert pair_up(one, other) is other
        with pytest.raises(BadInput, match="same pairs"):
            pair_up(one, other.taken([1, 0, 2]))


@pytest.mark.parametrize(
    ("label", "score", "words"),
    [
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
    Scores(
        label, score, finger=ids_of(["x", "x"], ["x", "y"]), subject=ids_of(["s", "s"], ["s", "s"])
    )
    for finger, subject in (
        (ids_of(["x", "x"], ["y", "y"]), None),
        (ids_of(["x", "x"], ["x", "x"]), None),
        (None, ids_of(["s", "s"], ["t", "s"])),
    ):
        with pytest.raises(BadInput, match="contradict"):
            Scores(label, score, finger=finger, subject=subject)
