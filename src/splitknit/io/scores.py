"""Score files: one comparison a line, as CSV, of anybody's matcher; and lists of fingers to leave out.

``label`` (1 genuine, 0 impostor) and ``score`` are needed; a blank score is a failure to acquire. ``finger_a``,
``finger_b`` and the like for ``subject`` and ``session`` say who was compared; ``system`` tells several matchers
apart. Other columns are not read.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.io.images import ImageSettings, read_bytes

IDS = ("finger", "subject", "session")
_LABELS = {"1": True, "0": False, "1.0": True, "0.0": False}
_LIMIT = ImageSettings(max_bytes=2_000_000_000)


@dataclass(frozen=True, slots=True, eq=False)
class ScoreFile:
    """The columns of a score file, comparison by comparison."""

    label: NDArray[np.bool_]
    """(N,)"""
    score: NDArray[np.float64]
    """(N,) NaN where the field is blank."""
    line: NDArray[np.int64]
    """(N,) the line of the file, from 1."""
    ids: Mapping[str, tuple[NDArray[np.int64], tuple[str, ...]]]
    """Of those of ``finger``, ``subject``, ``session`` that are given: codes (N, 2) and their names."""
    system: tuple[NDArray[np.int64], tuple[str, ...]] | None
    """Codes (N,) and names, if there is such a column."""
    ignored: tuple[str, ...]
    """Columns that were not read."""
    sha256: str


def read_scores(path: str | os.PathLike[str]) -> ScoreFile:
    """Read a score file.

    Raises
    ------
    BadInput
        Naming file and line: not a CSV, a column missing or named twice, a line of another length, a label other than 0
        and 1, a score that is no finite number, an id that is blank.
    """
    data, table = _table(path)
    name, header = os.fspath(path), table.header
    for column in ("label", "score"):
        require(
            column in header,
            f"{name}, line {table.first}: there is no column '{column}'; columns 'label' (1 genuine, 0 impostor) and "
            "'score' are needed.",
        )
    wanted = ["label", "score", *(f"{kind}_{side}" for kind in IDS for side in "ab"), "system"]
    for kind in IDS:
        given = [side for side in "ab" if f"{kind}_{side}" in header]
        require(
            len(given) != 1,
            f"{name}, line {table.first}: there is a column '{kind}_{(given or 'a')[0]}' alone; both '{kind}_a' and "
            f"'{kind}_b' are needed.",
        )
    columns = {one: [row[k] for row in table.rows] for k, one in enumerate(header) if one in wanted}
    lines = np.array(table.lines, dtype=np.int64)
    label = np.array([_label(text, name, line) for text, line in zip(columns["label"], table.lines, strict=True)])
    score = np.array([_score(text, name, line) for text, line in zip(columns["score"], table.lines, strict=True)])
    ids = {}
    for kind in IDS:
        if f"{kind}_a" in header:
            both = [*columns[f"{kind}_a"], *columns[f"{kind}_b"]]
            codes, names = _codes(both, [*table.lines, *table.lines], f"{kind}_a or {kind}_b", name)
            ids[kind] = np.ascontiguousarray(codes.reshape(2, -1).T), names
    system = _codes(columns["system"], table.lines, "system", name) if "system" in header else None
    ignored = tuple(one for one in header if one not in wanted)
    return ScoreFile(label, score, lines, ids, system, ignored, hashlib.sha256(data).hexdigest())


def read_exclusions(path: str | os.PathLike[str]) -> tuple[list[dict[str, str]], str]:
    """Read a list of fingers to leave out and its SHA-256: columns ``finger``, and if wanted the other three.

    ``subject`` where fingers are named within their subject, ``session`` where one capture is meant, ``reason``.

    Raises
    ------
    BadInput
        Naming file and line.
    """
    data, table = _table(path)
    name = os.fspath(path)
    require("finger" in table.header, f"{name}, line {table.first}: there is no column 'finger', which is needed.")
    kept = [str(column) for column in ("finger", "subject", "session", "reason") if column in table.header]
    places = [table.header.index(column) for column in kept]
    entries: list[dict[str, str]] = []
    for row, line in zip(table.rows, table.lines, strict=True):
        entry = {column: row[k].strip() for column, k in zip(kept, places, strict=True)}
        require(bool(entry["finger"]), f"{name}, line {line}: the finger is blank.")
        entries.append(entry)
    return entries, hashlib.sha256(data).hexdigest()


@dataclass(frozen=True, slots=True)
class _Table:
    header: list[str]
    rows: list[list[str]]
    lines: list[int]
    first: int
    """Line of the header."""


def _table(path: str | os.PathLike[str]) -> tuple[bytes, _Table]:
    """The bytes of a CSV file, and its rows with the lines where they begin."""
    name = os.fspath(path)
    data = read_bytes(Path(path), _LIMIT)
    require(bool(data.strip()), f"{name} is empty: a line of column names and a line for each comparison are expected.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise BadInput(f"{name} is not a CSV file: line {line} is not text in UTF-8.") from error
    header: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    first, before = 0, 0
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for row in reader:
            line, before = before + 1, reader.line_num
            if not row:
                continue
            if not header:
                header, first = _header(row, name, line), line
                continue
            if len(row) != len(header):
                raise BadInput(
                    f"{name}, line {line}: {len(header)} fields are expected, as in the line of column names, "
                    f"but there are {len(row)}."
                )
            rows.append(row)
            lines.append(line)
    except csv.Error as error:
        raise BadInput(f"{name} is not a CSV file: line {reader.line_num}: {error}.") from error
    require(bool(rows), f"{name} holds no comparison: after the column names a line for each is expected.")
    return data, _Table(header, rows, lines, first)


def _header(row: Sequence[str], name: str, line: int) -> list[str]:
    header = [field.strip() for field in row]
    twice = next((field for k, field in enumerate(header) if field in header[:k]), None)
    require(twice is None, f"{name}, line {line}: there are two columns '{_short(twice or '')}'; name each once.")
    known = {"label", "score", "finger"} & set(header)
    require(
        bool(known),
        f"{name}, line {line}: a line of column names apart by commas is expected, with 'label' and 'score' among "
        f"them, but it is '{_short(','.join(row))}'.",
    )
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
    if value is None or not np.isfinite(value):
        raise BadInput(
            f"{name}, line {line}: a score is a finite number, or blank for a failure to acquire, but it is "
            f"'{_short(text)}'."
        )
    return value


def _codes(
    texts: Sequence[str], lines: Sequence[int], column: str, name: str
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Codes of names, which are in order, numbers by their size."""
    stripped = [text.strip() for text in texts]
    if not all(stripped):
        raise BadInput(
            f"{name}, line {lines[stripped.index('')]}: {column} is blank; name it in every line or nowhere."
        )
    names = sorted(set(stripped), key=_order)
    place = {one: k for k, one in enumerate(names)}
    return np.array([place[one] for one in stripped], dtype=np.int64), tuple(names)


def _order(text: str) -> tuple[Any, ...]:
    plain = text.isascii() and text.isdigit() and len(text) < 19
    return (0, int(text), text) if plain else (1, 0, text)


def _short(text: str) -> str:
    shown = text.strip().encode("unicode_escape").decode("ascii")
    return shown if len(shown) <= 60 else shown[:57] + "..."
