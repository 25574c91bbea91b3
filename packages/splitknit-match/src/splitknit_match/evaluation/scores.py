"""Comparisons and what is known of them, and their files: label, score, and whose finger of which
session each side is.

A score file is CSV of anybody's matcher, one comparison a line. ``label`` (1 genuine, 0 impostor)
and ``score`` are needed; a blank score is a failure to acquire. ``finger_a``, ``finger_b``,
``subject_a``, ``session_a`` and so on name who was compared. Other columns are ignored.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import naming, require
from splitknit.files import read_bytes
from splitknit.io.csv_table import csv_text, plain_text
from splitknit.model import Array, BoolArray

Indices = NDArray[np.int64]
KINDS = ("finger", "subject", "session")
LARGEST = 1e150
"""Largest score whose square is still a number. Source: limit of double precision."""
_LABELS = {"1": True, "0": False, "1.0": True, "0.0": False}


@dataclass(frozen=True, slots=True, eq=False)
class Ids:
    """One kind of name for both sides of every comparison."""

    codes: Indices  # (N, 2), places in `names`; column 0 is the probe, 1 the reference
    names: tuple[str, ...]

    @property
    def same(self) -> BoolArray:
        """(N,) whether both sides carry one name."""
        return np.asarray(self.codes[:, 0] == self.codes[:, 1])

    def taken(self, index: Any) -> Ids:
        """The ids of some comparisons."""
        return Ids(self.codes[index], self.names)


def ids_of(a: Any, b: Any) -> Ids:
    """Ids from the names of both sides, in the order in which names first appear when sorted."""
    names, codes = np.unique(np.asarray([a, b]).astype(str), return_inverse=True)
    return Ids(codes.reshape(2, -1).T.astype(np.int64), tuple(map(str, names)))


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """N comparisons; a higher score means more similar."""

    label: BoolArray  # (N,) true where genuine: both sides are one finger
    score: Array  # (N,) NaN where a comparison gave none (failure to acquire)
    # fingers of the world: the index fingers of two people have two names
    finger: Ids | None = None
    subject: Ids | None = None
    session: Ids | None = None
    name: str = "scores"

    def __post_init__(self) -> None:
        require(
            not np.isinf(self.score).any(),
            f"{self.name}: scores must be finite, or NaN where there is none.",
        )
        for words, scores in (
            ("genuine (label 1)", self.genuine),
            ("impostor (label 0)", self.impostor),
        ):
            require(
                scores.size > 0, f"{self.name} holds no {words} comparison: both kinds are needed."
            )
            require(
                not np.isnan(scores).all(),
                f"{self.name} holds no {words} score: all {scores.size} are failures to acquire.",
            )
        wrong = contradictions(self.label, self.finger, self.subject)
        require(
            not wrong.any(),
            f"{self.name}: comparison {int(np.argmax(wrong))} and its label contradict each other:"
            " check its ids.",
        )

    @property
    def genuine(self) -> Array:
        """Scores of one finger with itself, NaN included."""
        return self.score[self.label]

    @property
    def impostor(self) -> Array:
        """Scores of two fingers, NaN included."""
        return self.score[~self.label]

    def taken(self, index: Any) -> Scores:
        """Some of the comparisons, by a mask or by their places."""
        ids = {
            kind: getattr(self, kind).taken(index)
            for kind in KINDS
            if getattr(self, kind) is not None
        }
        return replace(self, label=self.label[index], score=self.score[index], **ids)


def contradictions(label: BoolArray, finger: Ids | None, subject: Ids | None) -> BoolArray:
    """(N,) whether a comparison's ids and label cannot both be right. Genuine: one finger (and
    subject) on both sides; impostor: two fingers, perhaps of one subject.
    """
    wrong = np.zeros(label.shape, dtype=bool)
    if finger is not None:
        wrong |= finger.same != label
    if subject is not None:
        wrong |= label & ~subject.same
    return wrong


def score_table(
    label: Sequence[bool],
    names: Mapping[str, tuple[Sequence[str], Sequence[str]]],
    scores: Mapping[str, Sequence[float]],
) -> bytes:
    """A score file: label, ``score`` first of the columns of scores (NaN is blank, else the
    shortest exact text), the names of both sides by their kind, and the other scores.
    """
    texts = {
        key: ["" if math.isnan(value) else repr(float(value)) for value in column]
        for key, column in scores.items()
    }
    columns = {
        "label": [int(genuine) for genuine in label],
        "score": texts.pop("score"),
    }
    for kind, sides in names.items():
        columns |= {f"{kind}_a": sides[0], f"{kind}_b": sides[1]}
    columns |= texts
    return csv_text([list(columns), *zip(*columns.values(), strict=True)]).encode("utf-8")


@dataclass(frozen=True, slots=True, eq=False)
class ScoreFile:
    """What a score file holds."""

    scores: Scores  # named by the file
    ignored: list[str]  # columns that were not read
    sha256: str


MAX_BYTES = 500_000_000  # longest score file: ten million comparisons


def read_scores(path: str | os.PathLike[str], *, dissimilarity: bool = False) -> ScoreFile:
    """Read a score file; `dissimilarity`: lower means more similar, and scores are negated. Raises
    BadInput naming file and line: not a CSV, a column missing or named twice, a line of another
    length, a label other than 0 and 1, a score that is not a finite number, an id that is blank or
    contradicts its label.
    """
    name, data = os.fspath(path), read_bytes(path, MAX_BYTES)
    rows = _rows(data, name)
    first, header = next(rows, (1, []))
    header = [column.strip() for column in header]
    kinds = _check_columns(header, f"{name}, line {first}")
    places = {kind: [header.index(f"{kind}_{side}") for side in "ab"] for kind in kinds}
    label_place, score_place = header.index("label"), header.index("score")
    label, score, lines = array("b"), array("d"), array("q")
    names: dict[str, dict[str, int]] = {kind: {} for kind in kinds}
    codes = {kind: array("q") for kind in kinds}
    for line, row in rows:
        where = f"{name}, line {line}"
        require(
            len(row) == len(header),
            f"{where}: {len(header)} fields are expected, but there are {len(row)}.",
        )
        lines.append(line)
        text = row[label_place].strip()
        require(
            text in _LABELS,
            f"{where}: a label is 1 (genuine) or 0 (impostor), but it is '{_short(text)}'.",
        )
        label.append(_LABELS[text])
        score.append(_score(row[score_place].strip(), where))
        for kind, both in places.items():
            for place in both:
                text = row[place].strip()
                require(
                    text, f"{where}: {header[place]} is blank; name it in every line or nowhere."
                )
                codes[kind].append(names[kind].setdefault(text, len(names[kind])))
    require(
        lines,
        f"{name} holds no comparison: a line of column names and a line for each are expected.",
    )
    ids = {kind: _in_order(names[kind], np.array(codes[kind])) for kind in kinds}
    if "finger" in ids and "subject" in ids:
        ids["finger"] = fingers_of_subjects(ids["finger"], ids["subject"])
    genuine, values = (
        np.array(label, dtype=bool),
        np.array(score) * (-1.0 if dissimilarity else 1.0),
    )
    wrong = contradictions(genuine, ids.get("finger"), ids.get("subject"))
    require(
        not wrong.any(),
        f"{name}, line {lines[int(np.argmax(wrong))]}: label and ids of the comparison contradict"
        " each other; correct one of them.",
    )
    scores = naming(name, lambda: Scores(genuine, values, **ids, name=Path(name).stem))
    read = {"label", "score", *(f"{kind}_{side}" for kind in kinds for side in "ab")}
    return ScoreFile(
        scores,
        [column for column in header if column not in read],
        hashlib.sha256(data).hexdigest(),
    )


def _rows(data: bytes, name: str) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV file with the number of the line where they begin; blank lines left out."""
    reader = csv.reader(io.TextIOWrapper(io.BytesIO(data), "utf-8-sig", newline=""), strict=True)
    before = 0
    try:
        for row in reader:
            line, before = before + 1, reader.line_num
            if row:
                yield line, [plain_text(cell) for cell in row]
    except csv.Error as error:
        raise BadInput(f"{name} is not a CSV file: line {reader.line_num}: {error}.") from error
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not a CSV file: it is not text in UTF-8.") from error


def _check_columns(header: list[str], where: str) -> list[str]:
    """The kinds of names that there are."""
    for column in ("label", "score"):
        require(
            column in header,
            f"{where}: there is no column '{column}' in '{_short(','.join(header))}'; columns apart"
            " by commas, 'label' (1 genuine, 0 impostor) and 'score' among them, are needed.",
        )
    require(
        "system" not in header,
        f"{where}: there is a column 'system'; put each system into a file of its own.",
    )
    twice = next((column for column in header if header.count(column) > 1), None)
    require(
        twice is None, f"{where}: there are two columns '{_short(str(twice))}'; name each once."
    )
    kinds = []
    for kind in KINDS:
        sides = [f"{kind}_{side}" for side in "ab"]
        present = [column for column in sides if column in header]
        require(
            len(present) != 1,
            f"{where}: there is a column '{''.join(present)}' alone; both '{sides[0]}' and"
            f" '{sides[1]}' are needed.",
        )
        kinds += [kind] if present else []
    return kinds


def _score(text: str, where: str) -> float:
    try:
        value = float("nan" if "_" in text else text or "nan")
    except ValueError:
        value = float("nan")
    require(
        abs(value) <= LARGEST or not text,
        f"{where}: a score is a finite number (of at most {LARGEST:g}), or blank for a failure to"
        f" acquire, but it is '{_short(text)}'.",
    )
    return value


def _in_order(places: Mapping[str, int], codes: Indices) -> Ids:
    """Ids whose names are in order, numbers by their size."""
    names = sorted(
        places, key=lambda text: (0, text.zfill(20), text) if text.isdigit() else (1, text, text)
    )
    order = np.empty(len(names), dtype=np.int64)
    order[[places[name] for name in names]] = np.arange(len(names))
    return Ids(order[codes.reshape(-1, 2)], tuple(names))


def fingers_of_subjects(finger: Ids, subject: Ids) -> Ids:
    """Fingers named with their subject, so that everybody's ``right_index`` is a finger of its
    own."""
    count = len(finger.names)
    used, codes = np.unique(subject.codes * count + finger.codes, return_inverse=True)
    names = (f"{subject.names[key // count]}/{finger.names[key % count]}" for key in used)
    return Ids(codes.reshape(finger.codes.shape), tuple(names))


def _short(text: str) -> str:
    plain = text.encode("unicode_escape").decode("ascii")
    return plain if len(plain) <= 60 else plain[:57] + "..."
