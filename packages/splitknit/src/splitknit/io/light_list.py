"""Lists of lights for photographs: text files of directions or places, one a line, and ``.lp`` files of RTI."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import read_bytes, refusing, require
from splitknit.io.atomic import write_file
from splitknit.io.photos import SUFFIXES
from splitknit.model import Led

LIST_TITLE = "# splitknit: lights of photographs in the order of their names: x right, y up, z to the camera"
PLACES = "x_mm y_mm z_mm"
"""First line of a list of places in mm instead of directions: from the picture's middle, z above the object."""


@dataclass(frozen=True, slots=True, eq=False)
class LightList:
    """What a list of lights holds."""

    lights: NDArray[np.float64]
    names: tuple[str, ...]
    places: bool  # whether the lights are places in mm
    intensities: NDArray[np.float64] | None = None
    """(L, 1) or (L, 3) brightness of the lights, or of their red, green and blue; None where the list has none."""


def read_intensities(path: Path, count: int) -> NDArray[np.float64]:
    """Brightness (L, 1) or (L, 3) of `count` lights, a line each. Raises BadInput naming the file and the line."""
    lines = [line.split("#")[0].replace(",", " ").replace(";", " ").split() for line in _text_of(path).splitlines()]
    rows = [_as_numbers(words) for words in lines if words]
    wanted = f"{path}: one positive number for each light, or three (red, green, blue), on a line each are expected"
    sizes = {0 if row is None else len(row) for row in rows}
    require(len(sizes) == 1 and sizes <= {1, 3}, f"{wanted}.")
    require(len(rows) == count, f"{wanted}; there are {len(rows)} for {count} lights.")
    return _positive(np.array(rows, dtype=np.float64), wanted)


def _positive(values: NDArray[np.float64], wanted: str) -> NDArray[np.float64]:
    good = bool(np.isfinite(values).all()) and float(values.min()) > 0.0 and float(values.max()) < 1e12
    require(good, f"{wanted}; not {float(values.min()):g}.")
    return values


def _text_of(path: str | os.PathLike[str]) -> str:
    with refusing(f"{os.fspath(path)} is not a text file."):
        return read_bytes(path, 1_000_000).decode("utf-8-sig")


def read_light_list(path: str | os.PathLike[str]) -> LightList:
    """Read light directions and the photographs' names from a text file: x, y, z a line, apart by spaces, semicolons or
    commas.

    A fourth number of a line, or a fourth to sixth, is the light's brightness. A line may begin or end with the name of
    its photograph. A first line with a single number is the count of the lights, as in ``.lp`` files of RTI; ``#``
    starts a comment; lights are places in mm where the first line is :data:`PLACES`. Decimal commas are understood
    where spaces or semicolons stand between the numbers. Raises BadInput naming the file and the line.
    """
    name = os.fspath(path)
    count = None
    places = False
    rows: list[list[float]] = []
    names: list[str] = []
    for number, line in enumerate(_text_of(path).splitlines(), start=1):
        title = re.split(r"[,;\s]+", line.lower().strip())[-3:]
        words, doubtful = _words_of(line.split("#")[0])
        if not rows and title in (PLACES.split(), ["x", "y", "z"]):  # numpy reads it after a #
            places = places or title[-1] == "z_mm"
        elif len(words) == 1 and not rows and count is None and words[0].isdecimal():
            count = int(words[0][:9])
        elif words:
            values, photograph = _numbers_of(words)
            sound = len(values) in {3, 4, 6} and all(abs(value) <= 1e6 for value in values)
            wanted = f"{name}, line {number}: three finite numbers x y z are expected, perhaps a brightness and the"
            cure = "; write decimals with a point, or put spaces or semicolons between numbers" if doubtful else ""
            sound = sound and not (doubtful and len(values) > 3)
            require(sound, f"{wanted} name of a file, but it is {line.strip()[:60]!a}{cure}.")
            rows.append(values)
            names += [photograph] if photograph else []
    require(len(rows) > 0, f"{name} holds no lights: a line x y z for each image is expected.")
    require(count in (None, len(rows)), f"{name} states {count} lights in its first line, but {len(rows)} follow.")
    require(len(names) in (0, len(rows)), f"{name} names a file in some of its lines only; name one in all or in none.")
    twice = [photograph for k, photograph in enumerate(names) if photograph in names[:k]]
    require(not twice, f"{name} names {twice[0] if twice else ''!a} twice.")
    require(
        len({len(row) for row in rows}) == 1,
        f"{name}: brightness stands in some lines only, or in one column here and three there; give it in all.",
    )
    table = np.array(rows, dtype=np.float64)
    wanted = f"{name}: the brightness of a light must be positive"
    bright = _positive(table[:, 3:], wanted) if table.shape[1] > 3 else None
    return LightList(table[:, :3], tuple(names), places, bright)


def _numbers_of(words: Sequence[str]) -> tuple[list[float], str]:
    """The numbers at the beginning of a line, or at its end, and the name beside them, without folders."""
    known = [_as_numbers([word]) is not None for word in words]
    first = known.index(False) if False in known else len(words)
    if first >= 3:
        numbers = words[:first]
        rest = words[first:]
    else:
        last = known[::-1].index(False) if False in known else first
        before = words[: len(words) - last]
        if last > 3 and not before[-1].lower().endswith(tuple(SUFFIXES)):  # a number ends the name
            last = 3
        numbers = words[len(words) - last :]
        rest = words[: len(words) - last]
    return _as_numbers(numbers) or [], re.split(r"[/\\]", " ".join(rest))[-1]


def _words_of(line: str) -> tuple[list[str], bool]:
    """Words of a line, decimal commas as points; and whether its commas may be decimal ones."""
    parts = [part for part in (word.strip(",") for word in re.split(r"[;\s]+", line)) if part]
    if len(parts) >= 3:
        return [re.sub(r"^([-+]?\d+),(\d+)$", r"\1.\2", part) for part in parts], False
    return re.split(r"[,;\s]+", line.strip(" ,;\t")) if parts else [], "," in line and "." not in line


def write_light_list(leds: Sequence[Led], path: Path, photographs: Sequence[str]) -> None:
    """Write lights as :func:`read_light_list` reads them. `photographs` show where each light was found; they are
    comments. A `path` that ends in ``.lp`` is a file of RTI instead: the count, then photograph and unit direction.
    """
    near = leds[0].position_mm is not None
    if path.suffix.lower() == ".lp":
        require(not near, "an .lp file holds directions, and these lights have places; write a .txt or a rig file.")
        rows = [np.asarray(led.direction) / np.linalg.norm(led.direction or ()) for led in leds]
        lines = [f"{name} {x:.6f} {y:.6f} {z:.6f}" for name, (x, y, z) in zip(photographs, rows, strict=True)]
        write_file(path, "\n".join([str(len(lines)), *lines, ""]).encode("utf-8"))
        return
    lines = [LIST_TITLE, f"# {PLACES if near else 'x y z'}"]
    for led, photograph in zip(leds, photographs, strict=True):
        vector = led.position_mm if near else led.direction
        require(vector is not None, "a list of lights holds directions or places in mm, not both; write a rig file.")
        shown = "".join(c if c.isprintable() else "?" for c in photograph)
        lines.append(" ".join(f"{value:.6f}" for value in vector or ()) + f"  # {shown}")
    write_file(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _as_numbers(words: Sequence[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None
