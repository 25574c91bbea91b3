"""Comparisons and what is known of them: label, score, and whose finger of which session each side is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.csv_table import csv_text

Codes = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Ids:
    """One kind of name for both sides of every comparison."""

    codes: Codes  # (N, 2), places in `names`; column 0 is the probe, 1 the reference
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        fault = "ids must have the shape (N, 2),"
        require(self.codes.ndim == 2 and self.codes.shape[1] == 2, f"{fault} but they have {self.codes.shape}.")
        inside = self.codes.size == 0 or (self.codes.min() >= 0 and self.codes.max() < len(self.names))
        require(bool(inside), "ids must be places in their list of names.")

    @property
    def same(self) -> NDArray[np.bool_]:
        """(N,) whether both sides carry one name."""
        return np.asarray(self.codes[:, 0] == self.codes[:, 1])

    def taken(self, index: Any) -> Ids:
        """The ids of some comparisons."""
        return Ids(self.codes[index], self.names)


def ids_of(a: Sequence[Any], b: Sequence[Any]) -> Ids:
    """Ids from the names of both sides, in the order in which names first appear when sorted."""
    names, codes = np.unique(np.asarray([a, b]).astype(str), return_inverse=True)
    return Ids(codes.reshape(2, -1).T.astype(np.int64), tuple(str(name) for name in names))


def score_table(
    label: Sequence[bool],
    names: Mapping[str, tuple[Sequence[str], Sequence[str]]],
    scores: Mapping[str, Sequence[float]],
) -> bytes:
    """A score file: label, ``score`` first of the columns of scores (NaN is blank, else the shortest exact text), the
    names of both sides by their kind, and the other scores.
    """
    told = {
        key: ["" if math.isnan(value) else repr(float(value)) for value in values] for key, values in scores.items()
    }
    columns: dict[str, Sequence[Any]] = {"label": [int(one) for one in label], "score": told.pop("score")}
    for kind, sides in names.items():
        columns |= {f"{kind}_a": sides[0], f"{kind}_b": sides[1]}
    columns |= told
    return csv_text([list(columns), *map(list, zip(*columns.values(), strict=True))]).encode("utf-8")


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """N comparisons; a higher score means more similar."""

    label: NDArray[np.bool_]  # (N,) true where genuine: both sides are one finger
    score: NDArray[np.float64]  # (N,) NaN where a comparison gave none (failure to acquire)
    finger: Ids | None = None  # fingers of the world: the index fingers of two people have two names
    subject: Ids | None = None
    session: Ids | None = None
    name: str = "scores"

    def __post_init__(self) -> None:
        good = self.label.ndim == 1 and self.label.shape == self.score.shape
        fault = f"{self.name}: labels and scores must be of one length,"
        require(good, f"{fault} but they are {self.label.shape} and {self.score.shape}.")
        require(self.label.dtype == np.bool_, f"{self.name}: labels must be boolean, true where genuine.")
        finite = not bool(np.isinf(self.score).any())
        require(finite, f"{self.name}: scores must be finite, or NaN where there is none.")
        for ids in (self.finger, self.subject, self.session):
            require(ids is None or len(ids.codes) == self.label.size, f"{self.name}: ids and scores differ in number.")
        for words, label in (("genuine (label 1)", True), ("impostor (label 0)", False)):
            chosen = self.score[self.label == label]
            require(chosen.size > 0, f"{self.name} holds no {words} comparison: both kinds are needed.")
            fault = f"{self.name} holds no {words} score"
            require(not bool(np.isnan(chosen).all()), f"{fault}: all {chosen.size} are failures to acquire.")
        wrong = contradiction(self.label, self.finger, self.subject)
        require(wrong is None, f"{self.name}: comparison {wrong} and its label contradict each other: check its ids.")

    @property
    def genuine(self) -> NDArray[np.float64]:
        """Scores of one finger with itself, NaN included."""
        return self.score[self.label]

    @property
    def impostor(self) -> NDArray[np.float64]:
        """Scores of two fingers, NaN included."""
        return self.score[~self.label]

    def taken(self, index: Any, name: str | None = None) -> Scores:
        """Some of the comparisons, by a mask or by their places."""
        every = (self.finger, self.subject, self.session)
        finger, subject, session = (None if ids is None else ids.taken(index) for ids in every)
        return Scores(self.label[index], self.score[index], finger, subject, session, name or self.name)


def contradiction(label: NDArray[np.bool_], finger: Ids | None, subject: Ids | None) -> int | None:
    """The first comparison whose ids and label cannot both be right, or None. Genuine: one finger (and subject) on both
    sides; impostor: two fingers, perhaps of one subject.
    """
    wrong = np.zeros(label.shape, dtype=np.bool_)
    if finger is not None:
        wrong |= finger.same != label
    if subject is not None:
        wrong |= label & ~subject.same
    return int(np.argmax(wrong)) if bool(wrong.any()) else None
