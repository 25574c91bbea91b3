"""The thesis's protocol: every session against every other, averaged over them or not; and which comparison of one
system is which of another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import require
from splitknit_match.evaluation.scores import KINDS, Ids, Scores, ids_of


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Which captures to compare, as places in the list of captures."""

    a: NDArray[np.int64]  # (N,) the capture of the earlier session
    b: NDArray[np.int64]  # (N,)
    genuine: NDArray[np.bool_]


def comparisons(
    finger: Sequence[Any],
    session: Sequence[Any],
    drawn: Callable[[Any, Any], bool] | None = None,
    *,
    within: bool = False,
) -> Comparisons:
    """Every finger of a session with every finger of every later session, ordered by session pair, then by capture.

    170 fingers in four sessions give 1,020 genuine and 172,380 impostor comparisons. A finger that is missing in a
    session is missing in its comparisons. Raises BadInput if a finger has two captures in one session.

    finger, session : of each capture, one capture for each finger and session
    drawn : whether two fingers are compared, in all sessions; None: all are; asked once, before comparisons are listed
    within : whether different fingers of one session are compared, too, each two once, after all others
    """
    fingers, sessions = np.asarray(finger), np.asarray(session)
    require(fingers.ndim == 1 and fingers.shape == sessions.shape, "fingers and sessions must be lists of one length.")
    captures = list(zip(fingers.tolist(), sessions.tolist(), strict=True))
    require(len(set(captures)) == len(captures), "a finger has two captures in one session; keep one of them.")
    pairs = list(combinations(sorted(set(sessions.tolist())), 2))  # the earlier first: six of four
    require(pairs, "captures of two sessions at least are needed.")
    names, number = np.unique(fingers, return_inverse=True)
    wanted = np.ones((names.size, names.size), dtype=bool)
    if drawn is not None:
        for row, name in enumerate(names.tolist()):
            wanted[row, :row] = wanted[:row, row] = [drawn(name, other) for other in names[:row].tolist()]
    a, b = [], []
    for early, late in [*pairs, *((same, same) for same in np.unique(sessions) if within)]:
        first, second = np.flatnonzero(sessions == early), np.flatnonzero(sessions == late)
        chosen = wanted[np.ix_(number[first], number[second])]
        at_first, at_second = np.nonzero(np.triu(chosen, 1) if early == late else chosen)
        a.append(first[at_first])
        b.append(second[at_second])
    at_a, at_b = np.concatenate(a), np.concatenate(b)
    return Comparisons(at_a, at_b, fingers[at_a] == fingers[at_b])


def scores_of_comparisons(
    pairs: Comparisons,
    score: NDArray[np.float64],
    finger: Sequence[Any],
    session: Sequence[Any],
    subject: Sequence[Any] | None = None,
    *,
    name: str = "scores",
) -> Scores:
    """Scores (N,) of `pairs`, NaN where there is none, with the names of fingers, sessions and subjects."""

    def ids(of_captures: Sequence[Any]) -> Ids:
        names = np.asarray(of_captures)
        return ids_of(names[pairs.a], names[pairs.b])

    who = None if subject is None else ids(subject)
    values = np.asarray(score, dtype=float)
    return Scores(pairs.genuine, values, finger=ids(finger), subject=who, session=ids(session), name=name)


def average_sessions(scores: Scores) -> Scores:
    """One score for two fingers: the mean over the pairs of sessions in which they were compared.

    `scores` need fingers and sessions. Finger f of the earlier session with h of the later one, and
    h with f, stay two comparisons (170 fingers: 28,730 impostor scores). The thesis "averaged out
    the scores over the four sessions" (5.3.2). A user, with one finger to show, does not meet
    averages: they take six pairs of captures. Missing scores and comparisons within a session are
    left out of a mean; where all are missing, the mean is too.
    """
    named = scores.finger is not None and scores.session is not None
    require(named, f"{scores.name}: to average over sessions, columns for fingers and sessions are needed.")
    assert scores.session is not None
    scores = scores.taken(~scores.session.same)
    assert scores.finger is not None
    assert scores.session is not None
    finger, session, count = scores.finger.codes, scores.session.codes, len(scores.finger.names)
    turned = session[:, :1] > session[:, 1:]
    earlier, later = np.where(turned, finger[:, ::-1], finger).T
    keys, group = np.unique(earlier * count + later, return_inverse=True)
    known = ~np.isnan(scores.score)
    number = np.bincount(group, weights=known, minlength=keys.size)
    total = np.bincount(group[known], weights=scores.score[known], minlength=keys.size)
    mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    fingers = np.stack([keys // count, keys % count], axis=1)
    subject = None
    if scores.subject is not None:
        of_finger = np.zeros(count, dtype=np.int64)
        of_finger[finger.ravel()] = scores.subject.codes.ravel()
        subject = Ids(of_finger[fingers], scores.subject.names)
    pairs, name = Ids(fingers, scores.finger.names), f"{scores.name}, averaged over sessions"
    return Scores(fingers[:, 0] == fingers[:, 1], mean, finger=pairs, subject=subject, name=name)


def pair_up(first: Scores, second: Scores) -> Scores:
    """The comparisons of `second` in the order of `first`. Pairs are known by fingers, subjects and sessions where both
    have them, each pair once, in any order of sides; otherwise by their place, if labels agree. Raises BadInput if the
    pairs are not the same, naming one.
    """
    alike = (first.finger is None) == (second.finger is None)  # else several fingers would count as one
    for ordered in (True, False):
        keys = _keys(first, second, ordered=ordered)
        if alike and np.array_equal(*keys) and np.array_equal(first.label, second.label):
            return second
        mine, theirs = (np.argsort(side, kind="stable") for side in keys)
        rising = keys[0][mine]
        if np.array_equal(rising, keys[1][theirs]) and (np.diff(rising) > 0).all():
            places = np.empty(mine.size, dtype=np.int64)
            places[mine] = theirs
            if np.array_equal(first.label, second.label[places]):
                return second.taken(places)
    fault = f"'{first.name}' and '{second.name}' did not score the same pairs"
    for own, other, one, more in ((*keys, first, second), (*keys[::-1], second, first)):
        values, counts = np.unique(other, return_counts=True)
        lone = np.flatnonzero(~np.isin(own, values[counts == 1]))
        if lone.size:
            raise BadInput(f"{fault}: '{more.name}' lacks, or has more than once, {_names(one, int(lone[0]))}.")
    raise BadInput(f"{fault}: their labels differ, or one holds a pair twice.")


def _names(scores: Scores, place: int) -> str:
    named = [(kind, ids) for kind in KINDS if (ids := getattr(scores, kind)) is not None]
    sides = (", ".join(f"{kind} {ids.names[ids.codes[place, side]]}" for kind, ids in named) for side in (0, 1))
    return " with ".join(sides) or "what has no names"


def _keys(first: Scores, second: Scores, *, ordered: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """A number for each comparison of both, equal where all ids are that both have."""
    side = np.zeros((first.label.size + second.label.size, 2), dtype=np.int64)
    for kind in KINDS:
        mine, theirs = getattr(first, kind), getattr(second, kind)
        if mine is None or theirs is None:
            continue
        names, codes = np.unique([*mine.names, *theirs.names], return_inverse=True)
        own, other = np.split(codes.ravel(), [len(mine.names)])
        side = side * names.size + np.vstack([own[mine.codes], other[theirs.codes]])
    used, codes = np.unique(side, return_inverse=True)
    low, high = codes.reshape(side.shape).T if ordered else np.sort(codes.reshape(side.shape), axis=1).T
    keys = low * used.size + high
    return keys[: first.label.size], keys[first.label.size :]
