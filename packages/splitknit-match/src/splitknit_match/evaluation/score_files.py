"""Score files: one comparison a line, as CSV, of anybody's matcher; and lists of fingers to leave out.

``label`` (1 genuine, 0 impostor) and ``score`` are needed; a blank score is a failure to acquire. ``finger_a``,
``finger_b``, ``subject_a``, ``session_a`` and so on name who was compared; ``system`` names the matcher where a file
holds the scores of several. Other columns are ignored.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import read_bytes, require
from splitknit.io.csv_table import plain_text

IDS = ("finger", "subject", "session")
COLUMNS = ("label", "score", *(f"{kind}_{side}" for kind in IDS for side in "ab"), "system")
LARGEST = 1e150  # largest score whose square is still a number
_LABELS = {"1": True, "0": False, "1.0": True, "0.0": False}
_EXPECTED = "a line of column names and a line for each comparison are expected"
_MAX_BYTES = 500_000_000  # ten million comparisons


@dataclass(frozen=True, slots=True, eq=False)
class ScoreFile:
    """The columns of a score file, comparison by comparison."""

    label: NDArray[np.bool_]  # (N,)
    score: NDArray[np.float64]  # (N,) NaN where the field is blank
    line: NDArray[np.int64]  # (N,) the line of the file, from 1
    ids: Mapping[str, tuple[NDArray[np.int64], tuple[str, ...]]]
    """For each of ``finger``, ``subject``, ``session`` that is given: codes (N, 2) and their names."""
    system: tuple[NDArray[np.int64], tuple[str, ...]] | None  # codes (N,) and names, if there is such a column
    ignored: tuple[str, ...]  # columns that were not read
    sha256: str


def read_scores(path: str | os.PathLike[str]) -> ScoreFile:
    """Read a score file. Raises BadInput naming file and line: not a CSV, a column missing or named twice, a line of
    another length, a label other than 0 and 1, a score that is not a finite number, an id that is blank.
    """
    name, data = os.fspath(path), _bytes(path)
    rows = _rows(data, name)
    first, header = next(rows)
    _check_columns(header, name, first)
    places = {column: header.index(column) for column in COLUMNS if column in header}
    label, score = array("b"), array("d")
    lines = array("q")
    names = {column: _Names(column) for column in places if column not in ("label", "score")}
    for line, row in rows:
        lines.append(line)
        label.append(_label(row[places["label"]], name, line))
        score.append(_score(row[places["score"]], name, line))
        for column, known in names.items():
            known.add(row[places[column]], name, line)
    require(len(lines) > 0, f"{name} holds no comparison: after the column names a line for each is expected.")
    ids = {kind: _codes(names[f"{kind}_a"], names[f"{kind}_b"]) for kind in IDS if f"{kind}_a" in names}
    system = None
    if "system" in names:
        codes, systems = _codes(names["system"])
        system = codes[:, 0], systems
    columns = np.array(label, dtype=np.bool_), np.array(score), np.array(lines, dtype=np.int64)
    ignored = tuple(column for column in header if column not in places)
    return ScoreFile(*columns, ids, system, ignored, hashlib.sha256(data).hexdigest())


def read_exclusions(path: str | os.PathLike[str]) -> tuple[list[dict[str, str]], str]:
    """Read a list of fingers to leave out and its SHA-256: columns ``finger``, and if wanted ``subject`` (where fingers
    are named within it), ``session`` (one capture) and ``reason``. Raises BadInput naming file and line.
    """
    name, data = os.fspath(path), _bytes(path)
    rows = _rows(data, name)
    first, header = next(rows)
    require("finger" in header, f"{name}, line {first}: there is no column 'finger', which is needed.")
    kept = [str(column) for column in ("finger", "subject", "session", "reason") if column in header]
    entries = []
    for line, row in rows:
        entry = {column: row[header.index(column)].strip() for column in kept}
        require(bool(entry["finger"]), f"{name}, line {line}: the finger is blank.")
        entries.append(entry)
    return entries, hashlib.sha256(data).hexdigest()


class _Names:
    """A column of names as codes, in the order in which they appear."""

    def __init__(self, column: str) -> None:
        self.column = column
        self.places: dict[str, int] = {}
        self.codes = array("q")

    def add(self, text: str, name: str, line: int) -> None:
        stripped = text.strip()
        if not stripped:
            raise BadInput(f"{name}, line {line}: {self.column} is blank; name it in every line or nowhere.")
        self.codes.append(self.places.setdefault(stripped, len(self.places)))


def _codes(*columns: _Names) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Codes (N, columns) in one list of names, which are in order, numbers by their size."""
    names = sorted({name for column in columns for name in column.places}, key=_order)
    place = {name: k for k, name in enumerate(names)}
    ways = [np.array([place[name] for name in column.places], dtype=np.int64) for column in columns]
    codes = [way[np.array(column.codes, dtype=np.int64)] for way, column in zip(ways, columns, strict=True)]
    return np.stack(codes, axis=1), tuple(names)


def _bytes(path: str | os.PathLike[str]) -> bytes:
    data = read_bytes(path, _MAX_BYTES)
    require(bool(data.strip()), f"{os.fspath(path)} is empty: {_EXPECTED}.")
    return data


def _rows(data: bytes, name: str) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV file with the number of the line where they begin: column names first, blank lines left out."""
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise BadInput(f"{name} is not a CSV file: line {line} is not text in UTF-8.") from error
    columns, before, restored = 0, 0, b"'" in data
    reader = csv.reader(io.TextIOWrapper(io.BytesIO(data), "utf-8-sig", newline=""), strict=True)
    try:
        for row in reader:
            line, before = before + 1, reader.line_num
            if not row:
                continue
            if restored:
                row = [plain_text(cell) for cell in row]  # noqa: PLW2901
            if columns == 0:
                columns = len(row)
                yield line, _header(row, name, line)
                continue
            if len(row) != columns:
                fault = f"{name}, line {line}: {columns} fields are expected,"
                raise BadInput(f"{fault} as in the line of column names, but there are {len(row)}.")
            yield line, row
    except csv.Error as error:
        raise BadInput(f"{name} is not a CSV file: line {reader.line_num}: {error}.") from error
    require(columns > 0, f"{name} is empty: {_EXPECTED}.")


def _check_columns(header: Sequence[str], name: str, line: int) -> None:
    for column in ("label", "score"):
        cure = "columns 'label' (1 genuine, 0 impostor) and 'score' are needed."
        require(column in header, f"{name}, line {line}: there is no column '{column}'; {cure}")
    for kind in IDS:
        given = [side for side in "ab" if f"{kind}_{side}" in header]
        cure = f"both '{kind}_a' and '{kind}_b' are needed."
        require(len(given) != 1, f"{name}, line {line}: there is a column '{kind}_{(given or 'a')[0]}' alone; {cure}")


def _header(row: Sequence[str], name: str, line: int) -> list[str]:
    header = [field.strip() for field in row]
    twice = next((field for k, field in enumerate(header) if field in header[:k]), None)
    require(twice is None, f"{name}, line {line}: there are two columns '{_short(twice or '')}'; name each once.")
    known = {"label", "score", "finger"} & set(header)
    fault = f"{name}, line {line}: a line of column names apart by commas is expected,"
    require(bool(known), f"{fault} with 'label' and 'score' among them, but it is '{_short(','.join(row))}'.")
    return header


def _label(text: str, name: str, line: int) -> bool:
    label = _LABELS.get(text.strip())
    if label is None:
        raise BadInput(f"{name}, line {line}: a label is 1 (genuine) or 0 (impostor), but it is '{_short(text)}'.")
    return label


def _score(text: str, name: str, line: int) -> float:
    try:
        value = float(text) if "_" not in text else None
    except ValueError:
        value = float("nan") if not text.strip() else None
        if value is not None:
            return value
    if value is None or not abs(value) <= LARGEST:
        fault = f"{name}, line {line}: a score is a finite number (of at most {LARGEST:g}),"
        raise BadInput(f"{fault} or blank for a failure to acquire, but it is '{_short(text)}'.")
    return value


def _order(text: str) -> tuple[Any, ...]:
    plain = text.isascii() and text.isdigit() and len(text) < 19
    return (0, int(text), text) if plain else (1, 0, text)


def _short(text: str) -> str:
    shown = text.strip().encode("unicode_escape").decode("ascii")
    return shown if len(shown) <= 60 else shown[:57] + "..."
