"""Scores of a store as arrays: the comparisons that several cases share, and each one's
similarities.

A *trial* is one system: a case (how captures are reconstructed), a matcher and, of the thesis's
matcher, an attribute. All trials of a table are brought to the same comparisons in the same order,
so that their differences are paired.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from splitknit_match.evaluation.scores import Ids, Scores

ATTRIBUTES = ("normals", "relief", "shape_normals")
KEPT_FRACTION = 0.2
"""A case that has less than this fraction of the largest one's comparisons is left out of a table,
and named."""

Values = NDArray[np.float64]


class StoreLike(Protocol):
    """What is read: :class:`splitknit_match.batch.Store`."""

    def features(self, case: str, columns: Sequence[str] | None = None) -> Any: ...

    def scores(self, case: str, matcher: str) -> Any: ...


@dataclass(frozen=True, slots=True, eq=False)
class Captures:
    """All captures that any case has seen, sorted by name."""

    names: NDArray[np.str_]
    subject: NDArray[np.str_]
    finger: NDArray[np.str_]
    session: NDArray[np.str_]

    def places(self, names: Any) -> NDArray[np.int64]:
        """Where captures stand in the list."""
        return np.searchsorted(self.names, names).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Comparisons: places of both captures, and whether they show one finger."""

    captures: Captures
    a: NDArray[np.int64]
    b: NDArray[np.int64]

    @property
    def genuine(self) -> NDArray[np.bool_]:
        return np.asarray(self.captures.finger[self.a] == self.captures.finger[self.b])

    def ids(self, column: NDArray[np.str_]) -> Ids:
        names, codes = np.unique(column, return_inverse=True)
        return Ids(
            np.stack([codes[self.a], codes[self.b]], axis=1), tuple(str(name) for name in names)
        )

    def of_both(self, values: Values) -> Values:
        """(N, 2) a figure of the captures, for both sides of every comparison."""
        return np.stack([values[self.a], values[self.b]], axis=1)

    def taken(self, index: Any) -> Pairs:
        return Pairs(self.captures, self.a[index], self.b[index])


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Similarities (N,) of one system, NaN where a capture could not be acquired."""

    case: str
    matcher: str
    attribute: str
    similarity: Values
    ratio: Values | None
    """Overlap of the masks (5.1); None where the thesis's matcher did not run on the case."""
    gated: Values | None = None
    """Similarity of a pair that does not pass the gate, by the thesis's rule; None: the matcher's
    lowest."""

    label: str = ""
    """What it is called beside others of its table; the case unless given."""

    @property
    def name(self) -> str:
        return " ".join(part for part in (self.case, self.matcher, self.attribute) if part)

    def at(self, chosen: NDArray[np.bool_]) -> Trial:
        """Of some of the comparisons."""
        parts = (self.similarity, self.ratio, self.gated)
        similarity, ratio, gated = (None if part is None else part[chosen] for part in parts)
        return replace(self, similarity=similarity, ratio=ratio, gated=gated)

    def other(self, attribute: str, similarity: Values) -> Trial:
        """The same case and comparisons, another similarity."""
        return replace(self, attribute=attribute, similarity=similarity, label=attribute)

    def labelled(self, label: str) -> Trial:
        return replace(self, label=label)

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", self.label or self.case)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Trials on the same comparisons."""

    pairs: Pairs
    trials: tuple[Trial, ...]
    missing: tuple[str, ...]
    """Cases and matchers that were asked for and are not there, or only in small part."""

    def trial(self, case: str, matcher: str, attribute: str = "") -> Trial | None:
        key = (case, matcher, attribute)
        return next((t for t in self.trials if (t.case, t.matcher, t.attribute) == key), None)


def read_captures(store: StoreLike, cases: Iterable[str]) -> Captures:
    """Names of all captures; a case that is not there adds none."""
    columns = ("capture", "subject", "finger", "session")
    rows: dict[str, tuple[str, ...]] = {}
    for case in cases:
        table = _table(lambda case=case: store.features(case, list(columns)))
        if table is not None:
            rows |= {
                row[0]: row for row in zip(*(table[name].tolist() for name in columns), strict=True)
            }
    if not rows:
        raise SystemExit(
            f"the store holds no captures of {', '.join(cases)}; run splitknit batch first."
        )
    ordered = [rows[name] for name in sorted(rows)]
    return Captures(*(np.array([str(row[k]) for row in ordered]) for k in range(4)))


def read_table(
    store: StoreLike, captures: Captures, cases: Sequence[str], matchers: Sequence[str]
) -> Table:
    """Trials of all cases by all matchers, on the comparisons that all of them have.

    The overlap of the masks comes from the thesis's matcher, also for the others.
    """
    wanted = [(case, matcher) for matcher in matchers for case in cases]
    overlaps = {case: _overlap_case(store, captures, case, cases) for case in cases}
    asked = dict.fromkeys(
        [*wanted, *((case, "thesis") for case in overlaps.values() if case is not None)]
    )
    raw = {key: _columns(store, captures, *key) for key in asked}
    longest = max((len(columns["key"]) for key in wanted if (columns := raw[key])), default=0)
    used = {
        key: columns
        for key, columns in raw.items()
        if columns and len(columns["key"]) >= KEPT_FRACTION * longest
    }
    missing = [f"{case} by {matcher}" for case, matcher in wanted if (case, matcher) not in used]
    if not any(key in used for key in wanted):
        raise SystemExit(
            f"the store holds no scores of {', '.join(cases)} by {', '.join(matchers)}."
        )
    common: NDArray[np.int64] | None = None
    for columns in used.values():
        common = (
            columns["key"]
            if common is None
            else np.intersect1d(common, columns["key"], assume_unique=True)
        )
    assert common is not None
    aligned = {
        key: {
            name: values[np.searchsorted(columns["key"], common)]
            for name, values in columns.items()
        }
        for key, columns in used.items()
    }
    count = len(captures.names)
    trials = [
        trial
        for case, matcher in wanted
        if (case, matcher) in aligned
        for trial in _trials(
            case, matcher, aligned[case, matcher], aligned.get((overlaps[case] or "", "thesis"))
        )
    ]
    return Table(Pairs(captures, common // count, common % count), tuple(trials), tuple(missing))


def _overlap_case(
    store: StoreLike, captures: Captures, case: str, cases: Sequence[str]
) -> str | None:
    """The case whose overlaps under the thesis's matcher are those of `case`: its own, or one with
    the same masks.

    A store that is being filled may have more of another case. Masks are taken to be the same where
    all captures have the same area to the last bit.
    """
    areas = {name: _areas(store, captures, name) for name in cases}
    compared = {
        name: 0 if table is None else len(table["a"])
        for name in cases
        for table in [_read_scores(store, name)]
    }
    same = [
        name
        for name in cases
        if areas[name] is not None and np.array_equal(areas[name], areas[case])
    ]
    best = max(same, key=lambda name: (compared[name], name == case), default=None)
    return best if best is not None and compared[best] > 0 else None


def _areas(store: StoreLike, captures: Captures, case: str) -> Values | None:
    table = _table(lambda: store.features(case, ["capture", "area_mm2"]))
    if table is None:
        return None
    areas = np.full(captures.names.shape, -1.0)
    areas[captures.places(table["capture"])] = table["area_mm2"]
    return areas


def _read_scores(store: StoreLike, case: str) -> Any:
    return _table(lambda: store.scores(case, "thesis"))


def scores_of(pairs: Pairs, similarity: Values, name: str) -> Scores:
    """What :mod:`splitknit_match.evaluation` takes."""
    captures = pairs.captures
    ids = {key: pairs.ids(getattr(captures, key)) for key in ("finger", "subject", "session")}
    return Scores(pairs.genuine, similarity, name=name, **ids)


def _trials(
    case: str, matcher: str, columns: Mapping[str, Values], of_thesis: Mapping[str, Values] | None
) -> list[Trial]:
    compared = columns["compared"].astype(np.bool_)
    ratio = (
        None
        if of_thesis is None
        else np.where(of_thesis["compared"].astype(np.bool_), of_thesis["ratio"], np.nan)
    )
    if matcher != "thesis":
        return [Trial(case, matcher, "", np.where(compared, columns["similarity"], np.nan), ratio)]
    assert ratio is not None
    return [
        Trial(
            case,
            matcher,
            name,
            np.where(compared, 1.0 - columns[f"dissimilarity_{name}"], np.nan),
            ratio,
            1.0 - np.exp(2.0 - ratio),
        )
        for name in ATTRIBUTES
        if f"dissimilarity_{name}" in columns
    ]


def _columns(
    store: StoreLike, captures: Captures, case: str, matcher: str
) -> dict[str, NDArray[Any]] | None:
    """Columns of numbers by rising key, place of a times number of captures plus place of b."""
    table = _table(lambda: store.scores(case, matcher))
    if table is None or len(table["a"]) == 0:
        return None
    a, b = (captures.places(table[side]) for side in ("a", "b"))
    key = a * len(captures.names) + b
    order = np.argsort(key, kind="stable")
    columns = {name: values[order] for name, values in table.items() if values.dtype.kind in "fiub"}
    return {**columns, "key": key[order]}


def _table(read: Any) -> Any:
    """None where a case or its scores are not in the store."""
    try:
        return read()
    except (ValueError, OSError, KeyError):
        return None
