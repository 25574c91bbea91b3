"""Lists of lights for photographs: text files of directions or places, one a line, and ``.lp`` files of RTI."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, refusing, require
from splitknit.io.atomic import write_file
from splitknit.io.photos import SUFFIXES
from splitknit.model import Led

LIST_TITLE = "# splitknit: lights of photographs in the order of their names: x right, y up, z to the camera"
PLACES = "x_mm y_mm z_mm"
"""First line of a list of places in mm instead of directions: from the picture's middle, z above the object."""


def read_named_lights(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read light directions and the photographs' names from a text file: x, y, z a line, apart by spaces, semicolons or
    commas.

    A first line with a single number is the count of the lights that follow, as in ``.lp`` files of RTI; ``#`` starts a
    comment. A line may begin or end with the name of its photograph. Decimal commas are understood where spaces or
    semicolons stand between the numbers. Returns `lights`, (L, 3), places in mm where the file's first line is
    :data:`PLACES`; `names`, of the photographs, one for each light, without folders; empty where the file holds none.
    Raises BadInput naming the file and the line; also where only some of the lines hold a name.
    """
    found = read_light_list(path)
    return found.lights, found.names


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
    """As :func:`read_named_lights`; a fourth number of a line, or a fourth to sixth, is the light's brightness."""
    name = os.fspath(path)
    text = _text_of(path)
    bright: list[list[float]] = []
    rows: list[list[float]] = []
    names: list[str] = []
    count: int | None = None
    places = False
    for number, line in enumerate(text.splitlines(), start=1):
        words, decimals = _words_of(line.split("#")[0])
        title = line.lower().replace(",", " ").replace(";", " ").split()[-3:]
        if not rows and title in (PLACES.split(), ["x", "y", "z"]):  # numpy reads it after a #
            places = places or title[-1] == "z_mm"
            continue
        if not words:
            continue
        if len(words) == 1 and not rows and count is None and words[0].isdecimal():
            count = int(words[0][:9])
            continue
        first = len(words) > 3 and _as_numbers(words[-3:]) is not None
        extra = [] if decimals and "." not in line else _brightness_of(words)
        if extra:  # the numbers without it, and the name where it stood
            after = words[-1] == extra[-1]
            words = words[: -len(extra)] if after else [*words[:3], *words[3 + len(extra) :]]
            bright.append(_as_numbers(extra) or [])
            first = after and len(words) > 3
        values = _as_numbers(words[-3:] if first else words[:3])
        wanted, shown = f"{name}, line {number}: three finite numbers x y z are expected", f"{line.strip()[:60]!a}"
        if values is None or len(words) < 3 or not all(abs(value) <= 1e6 for value in values):
            more = "none beyond a million, perhaps with a file's name before or after them"
            raise BadInput(f"{wanted}, {more}, but it is {shown}.")
        rest = words[:-3] if first else words[3:]
        cure = "; write decimals with a point, or put spaces or semicolons between numbers." if decimals else "."
        require(not rest or _as_numbers(rest) is None, f"{wanted}, but there are more: {shown}{cure}")
        rows.append(values)
        names += [re.split(r"[/\\\\]", " ".join(rest))[-1]] if rest else []
    require(len(rows) > 0, f"{name} holds no lights: a line x y z for each image is expected.")
    differ = f"{name} states {count} lights in its first line, but {len(rows)} follow."
    require(count in (None, len(rows)), differ)
    require(len(names) in (0, len(rows)), f"{name} names a file in some of its lines only; name one in all or in none.")
    twice = [one for k, one in enumerate(names) if one in names[:k]]
    require(not twice, f"{name} names {twice[0] if twice else ''!a} twice.")
    some = f"{name}: brightness stands in some lines only, or in one column here and three there; give it in all"
    require(len(bright) in {0, len(rows)} and len({len(one) for one in bright}) < 2, f"{some}.")
    intensities = _positive(np.array(bright), f"{name}: the brightness of a light must be positive") if bright else None
    return LightList(np.array(rows, dtype=np.float64), tuple(names), places, intensities)


def _brightness_of(words: Sequence[str]) -> list[str]:
    """The fourth number of a line, or the fourth to sixth; none where it has three, or the fourth may be of a name."""
    numbers = [_as_numbers([word]) is not None for word in words]
    count = numbers.index(False) if False in numbers else len(words)
    if count in {4, 6}:
        return list(words[3:count])
    after = numbers[::-1].index(False) if False in numbers else 0
    named = after in {4, 6} and words[-after - 1].lower().endswith(tuple(SUFFIXES))
    return list(words[3 - after :]) if named else []


def _words_of(line: str) -> tuple[list[str], bool]:
    """Words of a line of a list of lights, decimal commas as points; and whether its commas may be decimal ones."""
    parts = [part for part in (word.strip(",") for word in re.split(r"[;\s]+", line)) if part]
    points = [part.replace(",", ".") for part in parts]
    if any("," in part for part in parts) and len(parts) >= 3:
        if _as_numbers(points[-3:]) is not None:
            return [*parts[:-3], *points[-3:]], True
        if _as_numbers(points[:3]) is not None:
            return [*points[:3], *parts[3:]], True
    return line.replace(",", " ").replace(";", " ").split(), "," in line


def write_light_list(leds: Sequence[Led], path: Path, photographs: Sequence[str]) -> None:
    """Write lights as :func:`read_named_lights` reads them. `photographs` show where each light was found; they are
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
