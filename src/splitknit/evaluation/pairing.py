"""Which comparison of one system is which of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.evaluation.scores import Ids, Scores


def pair_up(first: Scores, second: Scores) -> Scores | None:
    """The comparisons of `second` in the order of `first`, or None if they are not of the same pairs.

    Pairs are known by their fingers (or subjects) and sessions where both have them and they name each pair once;
    otherwise by their place, if labels, and ids where both have them, agree place by place.
    """
    if first.label.size != second.label.size:
        return None
    ids = [
        (mine, theirs)
        for mine, theirs in (
            (first.finger, second.finger),
            (first.subject, second.subject),
            (first.session, second.session),
        )
        if mine is not None and theirs is not None
    ]
    keys = _keys(ids, first.label.size)
    if keys is None:
        return None
    mine, theirs = keys
    if bool((mine == theirs).all()) and bool((first.label == second.label).all()):
        return second
    order_mine, order_theirs = np.argsort(mine, kind="stable"), np.argsort(theirs, kind="stable")
    ordered = mine[order_mine]
    if bool((ordered[1:] == ordered[:-1]).any()) or not bool((ordered == theirs[order_theirs]).all()):
        return None
    places = np.empty(mine.size, dtype=np.int64)
    places[order_mine] = order_theirs
    paired = second.taken(places)
    return paired if bool((paired.label == first.label).all()) else None


def _keys(ids: list[tuple[Ids, Ids]], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """A number for each comparison, (N,) and (N,), equal where all ids are; None if a name is known to one alone."""
    keys = np.zeros((2, count), dtype=np.int64)
    for mine, theirs in ids:
        place = {name: k for k, name in enumerate(mine.names)}
        translate = np.array([place.get(name, -1) for name in theirs.names], dtype=np.int64)
        translated = translate[theirs.codes]
        if bool((translated < 0).any()):
            return None
        for side in (0, 1):
            both = np.stack([mine.codes[:, side], translated[:, side]])
            _, keys = np.unique(keys * len(mine.names) + both, return_inverse=True)
            keys = keys.reshape(2, count)
    return keys[0], keys[1]
