"""Lists of lights for photographs: text files of directions or places, one a line, and ``.lp`` files of RTI."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, require
from splitknit.io.atomic import write_file
from splitknit.model import Led

LIST_TITLE = "# splitknit: lights of photographs in the order of their names: x right, y up, z to the camera"
PLACES = "x_mm y_mm z_mm"
"""First line of a list whose lights are places in mm instead of directions: from the picture's middle, z above the
object."""


def read_named_lights(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read light directions and the photographs' names from a text file: x, y, z a line, apart by spaces, semicolons or
    commas.

    A first line with a single number is the count of the lights that follow, as in ``.lp`` files of RTI; ``#`` starts a
    comment. A line may begin or end with the name of its photograph. Decimal commas are understood where spaces or
    semicolons stand between the numbers. Returns `lights`, (L, 3), places in mm where the file's first line is
    :data:`PLACES`; `names`, of the photographs, one for each light, without folders; empty where the file holds none.
    Raises BadInput naming the file and the line; also where only some of the lines hold a name.
    """
    lights, names, _ = read_light_list(path)
    return lights, names


def read_light_list(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], tuple[str, ...], bool]:
    """As :func:`read_named_lights`, and whether the lights are places in mm."""
    name = os.fspath(path)
    try:
        text = read_bytes(path, 1_000_000).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not a text file.") from error
    rows: list[list[float]] = []
    names: list[str] = []
    count: int | None = None
    places = False
    for number, line in enumerate(text.splitlines(), start=1):
        words, decimals = _words_of(line.split("#")[0])
        if not words:
            continue
        if not rows and [word.lower() for word in words[-3:]] in (PLACES.split(), ["x", "y", "z"]):
            places = words[-1].lower() == "z_mm"
            continue
        if len(words) == 1 and not rows and count is None and words[0].isdecimal():
            count = int(words[0][:9])
            continue
        first = len(words) > 3 and _as_numbers(words[-3:]) is not None
        values = _as_numbers(words[-3:] if first else words[:3])
        if values is None or len(words) < 3 or not all(abs(value) <= 1e6 for value in values):
            raise BadInput(
                f"{name}, line {number}: three finite numbers x y z are expected, none beyond a million, perhaps with "
                f"a file's name before or after them, but it is {line.strip()[:60]!a}."
            )
        rest = words[:-3] if first else words[3:]
        require(
            not rest or _as_numbers(rest) is None,
            f"{name}, line {number}: three finite numbers x y z are expected, but there are more: "
            f"{line.strip()[:60]!a}"
            + ("; write decimals with a point, or put spaces or semicolons between numbers." if decimals else "."),
        )
        rows.append(values)
        names += [re.split(r"[/\\\\]", " ".join(rest))[-1]] if rest else []
    require(len(rows) > 0, f"{name} holds no lights: a line x y z for each image is expected.")
    require(
        count is None or count == len(rows), f"{name} states {count} lights in its first line, but {len(rows)} follow."
    )
    require(len(names) in (0, len(rows)), f"{name} names a file in some of its lines only; name one in all or in none.")
    twice = [one for k, one in enumerate(names) if one in names[:k]]
    require(not twice, f"{name} names {twice[0] if twice else ''!a} twice.")
    return np.array(rows, dtype=np.float64), tuple(names), places


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
    lines = [LIST_TITLE, PLACES if near else "x y z"]
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
