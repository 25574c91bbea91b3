"""Lists of lights for photographs: text files of directions or places, one a line, and ``.lp``
files of RTI."""

from __future__ import annotations

import itertools
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.files import read_bytes
from splitknit.io.atomic import write_file
from splitknit.io.photos import SUFFIXES
from splitknit.model import Led

LIST_TITLE = (
    "# splitknit: lights of photographs in the order of their names: x right, y up, z to the camera"
)
PLACES = "x_mm y_mm z_mm"
"""First line of a list of places in mm instead of directions: from the picture's middle, z above
the object."""
ANGLES = "azimuth_deg elevation_deg"
"""First line of a list of angles instead of directions: azimuth counter-clockwise from x, elevation
above the object's plane, 90 at the camera."""


@dataclass(frozen=True, slots=True, eq=False)
class LightList:
    """What a list of lights holds."""

    lights: NDArray[np.float64]
    names: tuple[str, ...]
    places: bool  # whether the lights are places in mm
    intensities: NDArray[np.float64] | None = None
    """(L, 1) or (L, 3) brightness of the lights, or of their red, green and blue; None where the
    list has none."""


def read_intensities(path: Path, count: int) -> NDArray[np.float64]:
    """Brightness (L, 1) or (L, 3) of `count` lights, a line each. Raises BadInput naming the file
    and the line."""
    wanted = (
        f"{path}: one positive number for each light, or three (red, green, blue), on a line each"
        " are expected"
    )
    with refusing(f"{wanted}."):
        lines = [
            line.split("#")[0].split() for line in re.sub("[,;]", " ", _text_of(path)).splitlines()
        ]
        table = np.array([words for words in lines if words], dtype=np.float64)
        require(table.shape[1:] in ((1,), (3,)), f"{wanted}.")
    require(len(table) == count, f"{wanted}; there are {len(table)} for {count} lights.")
    return _positive(table, wanted)


def _positive(values: NDArray[np.float64], wanted: str) -> NDArray[np.float64]:
    require(bool(((values > 0) & (values < 1e12)).all()), f"{wanted}; not {float(values.min()):g}.")
    return values


def _text_of(path: str | os.PathLike[str]) -> str:
    with refusing(f"{os.fspath(path)} is not a text file."):
        return read_bytes(path, 1_000_000).decode("utf-8-sig")


def read_light_list(path: str | os.PathLike[str]) -> LightList:
    """Read light directions and the photographs' names from a text file: x, y, z a line, apart by
    spaces, semicolons or commas.

    A fourth number of a line, or a fourth to sixth, is the light's brightness. A line may begin or
    end with the name of its photograph. A first line with a single number is the count of the
    lights, as in ``.lp`` files of RTI; ``#`` starts a comment; lights are places in mm where the
    first line is :data:`PLACES`, angles, two a line, where it is :data:`ANGLES`. Decimal commas are
    understood where spaces or semicolons stand between the numbers. Raises BadInput naming the file
    and the line.
    """
    name = os.fspath(path)
    count = None
    axes = "x y z"
    rows: list[list[float]] = []
    names: list[str] = []
    for number, line in enumerate(_text_of(path).splitlines(), start=1):
        title = " ".join(re.split(r"[,;\s]+", line.lower().strip()))
        titled = next((kind for kind in (PLACES, ANGLES, "x y z") if title.endswith(kind)), None)
        size = len(axes.split())
        words, doubtful = _words_of(line.split("#")[0], size)
        if not rows and titled:  # numpy reads it after a #
            axes = axes if titled == "x y z" else titled
        elif len(words) == 1 and not rows and count is None and words[0].isdecimal():
            count = int(words[0][:9])
        elif words:
            values, photograph = _numbers_of(words, size)
            sizes = {size} if doubtful else {size, size + 1, size + 3}
            sound = len(values) in sizes and all(abs(value) <= 1e6 for value in values)
            cure = (
                "; write decimals with a point, or put spaces or semicolons between numbers"
                if doubtful
                else ""
            )
            require(
                sound,
                f"{name}, line {number}: {'two' if size == 2 else 'three'} finite numbers"
                f" {axes} are expected, perhaps a brightness and the name of a file, but it is"
                f" {line.strip()[:60]!a}{cure}.",
            )
            rows.append(values)
            names += [photograph] if photograph else []
    require(len(rows) > 0, f"{name} holds no lights: a line {axes} for each image is expected.")
    require(
        count in (None, len(rows)),
        f"{name} states {count} lights in its first line, but {len(rows)} follow.",
    )
    require(
        len(names) in (0, len(rows)),
        f"{name} names a file in some of its lines only; name one in all or in none.",
    )
    photograph, times = Counter(names).most_common(1)[0] if names else ("", 1)
    require(times == 1, f"{name} names {photograph!a} twice.")
    require(
        len({len(row) for row in rows}) == 1,
        f"{name}: brightness stands in some lines only, or in one column here and three there; give"
        " it in all.",
    )
    table = np.array(rows, dtype=np.float64)
    lights, brightness = np.split(table, [len(axes.split())], axis=1)
    bright = (
        _positive(brightness, f"{name}: the brightness of a light must be positive")
        if brightness.size
        else None
    )
    if axes == ANGLES:
        azimuth, elevation = np.deg2rad(lights).T
        require(
            bool((elevation <= np.pi / 2).all()),
            f"{name}: an elevation is above 90 deg; azimuth stands first.",
        )
        across = np.cos(elevation)
        lights = np.column_stack(
            [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)]
        )
    return LightList(lights, tuple(names), axes == PLACES, bright)


def _numbers_of(words: Sequence[str], size: int) -> tuple[list[float], str]:
    """The numbers at the beginning of a line, `size` at least, or at its end, and the name beside
    them, without folders."""
    numeric = [_is_number(word) for word in words]
    count = len(list(itertools.takewhile(bool, numeric)))
    if count >= size:
        numbers = words[:count]
        rest = words[count:]
    else:
        first = len(words) - len(list(itertools.takewhile(bool, reversed(numeric))))
        if 0 < first < len(words) - size and not words[first - 1].lower().endswith(tuple(SUFFIXES)):
            first = len(words) - size  # a number ends the name
        numbers = words[first:]
        rest = words[:first]
    return list(map(float, numbers)), re.split(r"[/\\]", " ".join(rest))[-1]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _words_of(line: str, size: int) -> tuple[list[str], bool]:
    """Words of a line of `size` numbers at least, decimal commas as points; and whether its commas
    may be decimal ones."""
    parts = [part for part in (word.strip(",") for word in re.split(r"[;\s]+", line)) if part]
    if len(parts) >= size:
        return [re.sub(r"^([-+]?\d+),(\d+)$", r"\1.\2", part) for part in parts], False
    return (
        re.split(r"[,;\s]+", line.strip(" ,;\t")) if parts else []
    ), "," in line and "." not in line


def write_light_list(leds: Sequence[Led], path: Path, photographs: Sequence[str]) -> None:
    """Write lights as :func:`read_light_list` reads them. `photographs` show where each light was
    found; they are comments. A `path` that ends in ``.lp`` is a file of RTI instead: the count,
    then photograph and unit direction.
    """
    near = leds[0].position_mm is not None
    if path.suffix.lower() == ".lp":
        require(
            not near,
            "an .lp file holds directions, and these lights have places; write a .txt or a rig"
            " file.",
        )
        lines = [str(len(leds))]
        for led, photograph in zip(leds, photographs, strict=True):
            lines.append(f"{photograph} {_written(led.towards / np.linalg.norm(led.towards))}")
    else:
        lines = [LIST_TITLE, f"# {PLACES if near else 'x y z'}"]
        for led, photograph in zip(leds, photographs, strict=True):
            alike = (led.position_mm is not None) == near
            require(
                alike,
                "a list of lights holds directions or places in mm, not both; write a rig file.",
            )
            comment = "".join(c if c.isprintable() else "?" for c in photograph)
            lines.append(f"{_written(led.towards)}  # {comment}")
    write_file(path, "\n".join([*lines, ""]).encode("utf-8"))


def _written(vector: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.6f}" for value in vector)
