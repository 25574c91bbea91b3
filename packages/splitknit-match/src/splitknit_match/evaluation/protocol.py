"""The thesis's protocol: every session against every other, averaged over them or not, with fingers left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import require
from splitknit_match.evaluation.scores import Ids, Scores


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
    require(len(pairs) > 0, "captures of two sessions at least are needed.")
    names, number = np.unique(fingers, return_inverse=True)
    wanted = np.ones((names.size, names.size), dtype=np.bool_)
    if drawn is not None:
        for row, name in enumerate(names.tolist()):
            wanted[row, :row] = wanted[:row, row] = [drawn(name, other) for other in names[:row].tolist()]
    a, b = [], []
    for early, late in pairs:
        first, second = np.flatnonzero(sessions == early), np.flatnonzero(sessions == late)
        at_first, at_second = np.nonzero(wanted[np.ix_(number[first], number[second])])
        a.append(first[at_first])
        b.append(second[at_second])
    for one in np.unique(sessions) if within else ():
        here = np.flatnonzero(sessions == one)
        at_first, at_second = np.nonzero(np.triu(wanted[np.ix_(number[here], number[here])], 1))
        a.append(here[at_first])
        b.append(here[at_second])
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
        names, codes = np.unique(np.asarray(of_captures).astype(str), return_inverse=True)
        both = np.stack([codes[pairs.a], codes[pairs.b]], axis=1).astype(np.int64)
        return Ids(both, tuple(str(one) for one in names))

    who = None if subject is None else ids(subject)
    values = np.asarray(score, dtype=np.float64)
    return Scores(pairs.genuine, values, finger=ids(finger), subject=who, session=ids(session), name=name)


def average_sessions(scores: Scores, *, ordered: bool = True) -> Scores:
    """One score for two fingers: the mean over the pairs of sessions in which they were compared.

    `scores` need fingers and sessions. `ordered`: finger f of the earlier session with h of the later one, and h with
    f, stay two comparisons (170 fingers: 28,730 impostor scores); otherwise they are averaged as well (14,365). The
    thesis "averaged out the scores over the four sessions" (5.3.2) and does not say which; the former is the default. A
    user, with one finger to show, does not meet averages: they take six pairs of captures. Missing scores and
    comparisons within a session are left out of a mean; where all are missing, the mean is too.
    """
    if scores.finger is None or scores.session is None:
        raise BadInput(f"{scores.name}: to average over sessions, columns for fingers and sessions are needed.")
    scores = scores.taken(~scores.session.same)
    assert scores.finger is not None
    assert scores.session is not None
    finger, session = scores.finger.codes, scores.session.codes
    turned = session[:, 0] > session[:, 1] if ordered else finger[:, 0] > finger[:, 1]
    first, second = np.where(turned, finger[:, 1], finger[:, 0]), np.where(turned, finger[:, 0], finger[:, 1])
    keys, group = np.unique(first * len(scores.finger.names) + second, return_inverse=True)
    known = ~np.isnan(scores.score)
    number = np.bincount(group, weights=known, minlength=keys.size)
    total = np.bincount(group[known], weights=scores.score[known], minlength=keys.size)
    mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    fingers = np.stack([keys // len(scores.finger.names), keys % len(scores.finger.names)], axis=1)
    subject = None
    if scores.subject is not None:
        of_finger = np.zeros(len(scores.finger.names), dtype=np.int64)
        of_finger[finger.ravel()] = scores.subject.codes.ravel()
        subject = Ids(of_finger[fingers], scores.subject.names)
    name = f"{scores.name}, averaged over sessions"
    pairs = Ids(fingers, scores.finger.names)
    return Scores(fingers[:, 0] == fingers[:, 1], mean, finger=pairs, subject=subject, name=name)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A finger, or its capture of one session, that is left out, and by which rule."""

    finger: str
    session: str | None = None  # None: of all sessions
    reason: str = ""


def exclude(scores: Scores, exclusions: Sequence[Exclusion]) -> tuple[Scores, int, tuple[Exclusion, ...]]:
    """Leave out comparisons with an excluded side (for instance, as its roll differs too much). Returns what is left,
    how many comparisons went, and the entries of the list that no comparison has. Raises BadInput if the scores have no
    fingers (or no sessions, where the list names some), or nothing is left.
    """
    if scores.finger is None:
        raise BadInput(f"{scores.name}: to leave fingers out, columns finger_a and finger_b are needed.")
    place = {name: k for k, name in enumerate(scores.finger.names)}
    when = {} if scores.session is None else {name: k for k, name in enumerate(scores.session.names)}
    gone = np.zeros(scores.label.shape, dtype=np.bool_)
    unknown = []
    for one in exclusions:
        fault = f"{scores.name}: the list of exclusions names sessions,"
        require(one.session is None or scores.session is not None, f"{fault} but there are no columns for them.")
        hit = scores.finger.codes == place.get(one.finger, -1)
        if one.session is not None and scores.session is not None:
            hit &= scores.session.codes == when.get(one.session, -1)
        here = hit.any(axis=1)
        gone |= here
        if not bool(here.any()):
            unknown.append(one)
    kept = scores.taken(~gone, f"{scores.name}, without {len(exclusions) - len(unknown)} excluded")
    return kept, int(gone.sum()), tuple(unknown)


# Which comparison of one system is which of another.


def pair_up(first: Scores, second: Scores) -> Scores | None:
    """The comparisons of `second` in the order of `first`, or None if they are not of the same pairs. Pairs are known
    by fingers (or subjects) and sessions where both have them, each pair once, in any order of sides; otherwise by
    their place, if labels, and ids where both have them, agree.
    """
    if first.label.size != second.label.size:
        return None
    for ordered in (True, False):
        mine, theirs = _keys(first, second, ordered=ordered)
        if bool((mine == theirs).all()) and bool((first.label == second.label).all()):
            return second
        order_mine, order_theirs = np.argsort(mine, kind="stable"), np.argsort(theirs, kind="stable")
        sorted_mine = mine[order_mine]
        if bool((np.diff(sorted_mine) == 0).any()) or not bool((sorted_mine == theirs[order_theirs]).all()):
            continue
        places = np.empty(mine.size, dtype=np.int64)
        places[order_mine] = order_theirs
        paired = second.taken(places)
        if bool((paired.label == first.label).all()):
            return paired
    return None


def mismatch(first: Scores, second: Scores) -> str:
    """Which pair is missing, doubled, or of another label, without a full stop; empty where none is."""
    kinds = _shared(first, second)
    if not kinds:
        return "no columns of subjects, fingers or sessions are in both"
    keys = _keys(first, second, ordered=False)
    for mine, theirs, one, other in (
        (keys[0], keys[1], first, second), (keys[1], keys[0], second, first),
    ):  # fmt: skip
        lost = np.flatnonzero(~np.isin(mine, theirs))
        if lost.size:
            return f"'{other.name}' lacks {_pairs(one, lost, kinds)}"
        again = np.flatnonzero(~np.isin(np.arange(mine.size), np.unique(mine, return_index=True)[1]))
        if again.size:
            return f"'{one.name}' holds twice {_pairs(one, again, kinds)}"
    place = np.argsort(keys[1])[np.searchsorted(np.sort(keys[1]), keys[0])]
    other_label = np.flatnonzero(second.label[place] != first.label)
    return f"their labels differ in {_pairs(first, other_label, kinds)}" if other_label.size else ""


def _pairs(scores: Scores, which: NDArray[np.int64], kinds: Sequence[str]) -> str:
    named = [(kind, ids) for kind in kinds if (ids := getattr(scores, kind)) is not None]
    sides = [
        ", ".join(f"{kind} {ids.names[ids.codes[which[0], side]]}" for kind, ids in named) for side in (0, 1)
    ]  # fmt: skip
    return f"{which.size} pair{'s' if which.size > 1 else ''}, first ({sides[0]}) with ({sides[1]})"


def _shared(first: Scores, second: Scores) -> list[str]:
    return [k for k in ("subject", "finger", "session") if None not in (getattr(first, k), getattr(second, k))]


def _keys(first: Scores, second: Scores, *, ordered: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """A number for each comparison of both, equal where all ids are that both have."""
    side = np.zeros((first.label.size + second.label.size, 2), dtype=np.int64)
    for kind in _shared(first, second):
        mine, theirs = getattr(first, kind), getattr(second, kind)
        names, codes = np.unique([*mine.names, *theirs.names], return_inverse=True)
        own, other = np.split(codes.ravel(), [len(mine.names)])
        side = side * names.size + np.vstack([own[mine.codes], other[theirs.codes]])
    used, codes = np.unique(side, return_inverse=True)
    side = codes.reshape(side.shape)
    low, high = side.T if ordered else (side.min(axis=1), side.max(axis=1))
    mine, theirs = np.split(low * used.size + high, [first.label.size])
    return mine, theirs
