"""The thesis's protocol: every session against every other, averaged over them or not; and which
comparison of one system is which of another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.errors import require
from splitknit.model import Array, BoolArray
from splitknit_match.evaluation.scores import KINDS, Ids, Indices, Scores, ids_of


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Which captures to compare, as places in the list of captures."""

    a: Indices  # (N,) the capture of the earlier session
    b: Indices  # (N,)
    genuine: BoolArray


def comparisons(
    finger: Sequence[Any],
    session: Sequence[Any],
    drawn: Callable[[Any, Any], bool] | None = None,
    *,
    within: bool = False,
) -> Comparisons:
    """Every finger of a session with every finger of every later session, ordered by session pair,
    then by capture.

    170 fingers in four sessions give 1,020 genuine and 172,380 impostor comparisons. A finger that
    is missing in a session is missing in its comparisons. Raises BadInput if a finger has two
    captures in one session.

    finger, session : of each capture, one capture for each finger and session
    drawn : whether two fingers are compared, in all sessions; None: all are; asked once, before
    comparisons are listed
    within : whether different fingers of one session are compared, too, each two once, after all
    others
    """
    fingers, sessions = np.asarray(finger), np.asarray(session)
    require(
        fingers.ndim == 1 and fingers.shape == sessions.shape,
        "fingers and sessions must be lists of one length.",
    )
    captures = set(zip(fingers.tolist(), sessions.tolist(), strict=True))
    require(
        len(captures) == len(fingers), "a finger has two captures in one session; keep one of them."
    )
    names, number = np.unique(fingers, return_inverse=True)
    kinds = np.unique(sessions)
    require(kinds.size > 1, "captures of two sessions at least are needed.")
    wanted = np.ones((names.size, names.size), dtype=bool)
    if drawn is not None:
        for row, name in enumerate(names.tolist()):
            wanted[row, :row] = wanted[:row, row] = [
                drawn(name, earlier) for earlier in names[:row].tolist()
            ]
    a, b = [], []
    for early, late in [*combinations(kinds, 2), *((kind, kind) for kind in kinds if within)]:
        first, second = np.flatnonzero(sessions == early), np.flatnonzero(sessions == late)
        chosen = wanted[np.ix_(number[first], number[second])]
        rows, columns = np.nonzero(np.triu(chosen, 1) if early == late else chosen)
        a.append(first[rows])
        b.append(second[columns])
    at_a, at_b = np.concatenate(a), np.concatenate(b)
    return Comparisons(at_a, at_b, fingers[at_a] == fingers[at_b])


def scores_of_comparisons(
    pairs: Comparisons,
    score: Array,
    finger: Sequence[Any],
    session: Sequence[Any],
    subject: Sequence[Any] | None = None,
    *,
    name: str = "scores",
) -> Scores:
    """Scores (N,) of `pairs`, NaN where there is none, with the names of fingers, sessions and
    subjects."""
    of_captures = {"finger": finger, "session": session, "subject": subject}
    named = {kind: np.asarray(names) for kind, names in of_captures.items() if names is not None}
    ids = {kind: ids_of(names[pairs.a], names[pairs.b]) for kind, names in named.items()}
    return Scores(pairs.genuine, np.asarray(score, dtype=float), **ids, name=name)


def average_sessions(scores: Scores) -> Scores:
    """One score for two fingers: the mean over the pairs of sessions in which they were compared.

    `scores` need fingers and sessions. Finger f of the earlier session with h of the later one, and
    h with f, stay two comparisons (170 fingers: 28,730 impostor scores). The thesis "averaged out
    the scores over the four sessions" (5.3.2). A user, with one finger to show, does not meet
    averages: they take six pairs of captures. Missing scores and comparisons within a session are
    left out of a mean; where all are missing, the mean is too.
    """
    finger, session = scores.finger, scores.session
    if finger is None or session is None:
        raise BadInput(
            f"{scores.name}: to average over sessions, columns for fingers and sessions are needed."
        )
    across = ~session.same
    score, names = scores.score[across], finger.codes[across]
    turned = session.codes[across, 0] > session.codes[across, 1]
    names = np.where(turned[:, None], names[:, ::-1], names)
    fingers, group = np.unique(names, axis=0, return_inverse=True)
    known = ~np.isnan(score)
    number = np.bincount(group[known], minlength=len(fingers))
    total = np.bincount(group[known], weights=score[known], minlength=len(fingers))
    mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    subject = None
    if scores.subject is not None:
        owner = np.zeros(len(finger.names), dtype=np.int64)
        owner[finger.codes.ravel()] = scores.subject.codes.ravel()
        subject = Ids(owner[fingers], scores.subject.names)
    name = f"{scores.name}, averaged over sessions"
    return Scores(
        fingers[:, 0] == fingers[:, 1], mean, Ids(fingers, finger.names), subject, name=name
    )


def pair_up(first: Scores, second: Scores) -> Scores:
    """The comparisons of `second` in the order of `first`. Pairs are known by fingers, subjects and
    sessions where both have them, each pair once, in any order of sides; otherwise by their place,
    if labels agree. Raises BadInput if the pairs are not the same, naming one.
    """
    # else several fingers would count as one
    same_kinds = (first.finger is None) == (second.finger is None)
    for ordered in (True, False):
        keys, keys_2 = _keys(first, second, ordered=ordered)
        if (
            same_kinds
            and np.array_equal(keys, keys_2)
            and np.array_equal(first.label, second.label)
        ):
            return second
        mine, theirs = np.argsort(keys, kind="stable"), np.argsort(keys_2, kind="stable")
        if np.array_equal(keys[mine], keys_2[theirs]) and np.unique(keys).size == keys.size:
            places = theirs[np.argsort(mine)]
            if np.array_equal(first.label, second.label[places]):
                return second.taken(places)
    fault = f"'{first.name}' and '{second.name}' did not score the same pairs"
    for own, theirs, scores, lacking in (
        (keys, keys_2, first, second),
        (keys_2, keys, second, first),
    ):
        values, counts = np.unique(theirs, return_counts=True)
        unpaired = np.flatnonzero(~np.isin(own, values[counts == 1]))
        if unpaired.size:
            pair = _names(scores, int(unpaired[0]))
            raise BadInput(f"{fault}: '{lacking.name}' lacks, or has more than once, {pair}.")
    raise BadInput(f"{fault}: their labels differ, or one holds a pair twice.")


def _names(scores: Scores, place: int) -> str:
    named = [(kind, ids) for kind in KINDS if (ids := getattr(scores, kind)) is not None]
    sides = (
        ", ".join(f"{kind} {ids.names[ids.codes[place, side]]}" for kind, ids in named)
        for side in (0, 1)
    )
    return " with ".join(sides) or "what has no names"


def _keys(first: Scores, second: Scores, *, ordered: bool) -> tuple[Indices, Indices]:
    """A number for each comparison of both, equal where all ids are that both have."""
    sides = np.zeros((first.label.size + second.label.size, 2), dtype=np.int64)
    for kind in KINDS:
        ids, ids_2 = getattr(first, kind), getattr(second, kind)
        if ids is not None and ids_2 is not None:
            names, codes = np.unique([*ids.names, *ids_2.names], return_inverse=True)
            own, theirs = np.split(codes.ravel(), [len(ids.names)])
            sides = sides * names.size + np.vstack([own[ids.codes], theirs[ids_2.codes]])
    if not ordered:
        sides = np.sort(sides, axis=1)
    keys = np.unique(sides, axis=0, return_inverse=True)[1].ravel()
    return keys[: first.label.size], keys[first.label.size :]
