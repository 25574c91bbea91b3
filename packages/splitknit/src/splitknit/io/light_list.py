"""Lists of lights for photographs: text files of directions or places, one a line, ``.lp`` files of
RTI, and ``.dome`` files of Relight.

A ``.dome`` file is a JSON object. Its ``lightConfiguration`` states which of its arrays of x, y, z
holds: ``directional`` its ``directions``, ``spherical`` its ``positionsSphere``, ``lights3d`` its
``positions3d``; places are mm from the picture's middle, y up, z to the camera. Red, green and blue
of a light are multiplied by r, g, b of ``ledAdjust`` to make lights equal.

Source: the data model of Relight (Visual Computing Lab, ISTI-CNR).
"""

from __future__ import annotations

import itertools
import json
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import Struct, to_builtins

from splitknit.errors import refusing, require
from splitknit.files import AnyPath, read_bytes
from splitknit.imaging.view import plane_points
from splitknit.io.atomic import write_file
from splitknit.io.fields import read_document
from splitknit.io.photos import SUFFIXES
from splitknit.model import Array, Camera, Coordinate, Led, Point

LIST_TITLE = (
    "# splitknit: lights of photographs in the order of their names: x right, y up, z to the camera"
)
PLACES = "x_mm y_mm z_mm"
"""First line of a list of places in mm instead of directions: from the picture's middle, z above
the object."""
ANGLES = "azimuth_deg elevation_deg"
"""First line of a list of angles instead of directions: azimuth counter-clockwise from x, elevation
above the object's plane, 90 at the camera."""
CAMERA = "camera_mm"
"""Begins a line x, y, z before the lights: the centre of a camera whose rays pass through it, where
the places are."""
LONGEST_DIRECTION = 10.0
"""Maximum length of a row that counts as a direction if the list does not state what it holds.
Source: lists of RTI and of DiLiGenT hold unit vectors; lights are 50 mm and more away."""


@dataclass(frozen=True, slots=True, eq=False)
class LightList:
    """What a list of lights holds."""

    lights: Array
    names: tuple[str, ...]
    places: bool  # whether the lights are places in mm
    intensities: Array | None = None
    """(L, 1) or (L, 3) brightness of the lights, or of their red, green and blue; None where the
    list has none."""
    camera_mm: Point | None = None
    """The camera's centre; None where the list has none, and rays are taken as parallel."""


class _Vector(Struct):
    x: Coordinate
    y: Coordinate
    z: Coordinate


class _Factors(Struct):
    r: Coordinate
    g: Coordinate
    b: Coordinate


class _Dome(Struct, rename="camel"):
    """What a ``.dome`` file holds of lights."""

    light_configuration: str = "directional"
    image_width: float = 0.0
    """In mm; 0: not known. So `dome_diameter`, `vertical_offset`."""
    dome_diameter: float = 0.0
    vertical_offset: float = 0.0
    directions: tuple[_Vector, ...] = ()
    positions_sphere: tuple[_Vector, ...] = ()
    positions3d: tuple[_Vector, ...] = ()
    led_adjust: tuple[_Factors, ...] = ()


def _read_dome(path: AnyPath) -> LightList:
    dome, _ = read_document(Path(path), _Dome)
    arrays = {
        "directional": ("directions", dome.directions),
        "spherical": ("positionsSphere", dome.positions_sphere),
        "lights3d": ("positions3d", dome.positions3d),
    }
    kind = dome.light_configuration
    require(
        kind in arrays,
        f"{path}: lightConfiguration must be one of {', '.join(arrays)}, but it is {kind[:60]!a}.",
    )
    field, vectors = arrays[kind]
    require(
        len(vectors) > 0, f"{path}: {field} is empty, which {kind} lights need; correct the file."
    )
    brightness = None
    factors = np.array([(each.r, each.g, each.b) for each in dome.led_adjust])
    if factors.size and np.ptp(factors) > 0:  # else all lights are alike
        sound = len(factors) == len(vectors) and _are_bright(factors)
        require(sound, f"{path}: ledAdjust needs positive numbers r, g, b for each light.")
        brightness = 1.0 / factors
    lights = np.array([(each.x, each.y, each.z) for each in vectors])
    return LightList(lights, (), kind != "directional", brightness)


def read_intensities(path: Path, count: int) -> Array:
    """Brightness (L, 1) or (L, 3) of `count` lights, a line each. Raises BadInput naming the file
    and the line."""
    wanted = (
        f"{path}: one positive number for each of the {count} lights, or three (red, green, blue),"
        " on a line each are expected."
    )
    with refusing(wanted):
        lines = [
            line.split("#")[0].split() for line in re.sub("[,;]", " ", _text_of(path)).splitlines()
        ]
        table = np.array([words for words in lines if words], dtype=np.float64)
        require(table.shape[1:] in ((1,), (3,)), wanted)
    require(
        len(table) == count,
        f"{path} has {len(table)} lines, but there are {count} lights; give one a light.",
    )
    require(_are_bright(table), wanted)
    return table


def _are_bright(values: Array) -> bool:
    return bool(((values > 0) & (values < 1e12)).all())


def _text_of(path: AnyPath) -> str:
    with refusing(f"{os.fspath(path)} is not a text file."):
        return read_bytes(path, 1_000_000).decode("utf-8-sig")


def read_light_list(path: AnyPath) -> LightList:
    """Read light directions and the photographs' names from a text file: x, y, z a line, apart by
    spaces, semicolons or commas; or the lights of a ``.dome`` file, which has no names.

    A fourth number of a line, or a fourth to sixth, is the light's brightness. A line may begin or
    end with the name of its photograph. A first line with a single number is the count of the
    lights, as in ``.lp`` files of RTI; ``#`` starts a comment; lights are places in mm where the
    first line is :data:`PLACES`, angles, two a line, where it is :data:`ANGLES`; without a first
    line, rows too long to be directions are refused. A line :data:`CAMERA` before the lights is the
    camera's centre. Decimal commas are
    understood where spaces or semicolons stand between the numbers. Raises BadInput naming the file
    and the line.
    """
    name = os.fspath(path)
    if name.lower().endswith(".dome"):
        return _read_dome(path)
    count = None
    camera = None
    axes = "x y z"
    stated_axes = False
    rows: list[list[float]] = []
    names: list[str] = []
    for number, line in enumerate(_text_of(path).splitlines(), start=1):
        title = " ".join(re.split(r"[,;\s]+", line.lower().strip()))
        titled = next((kind for kind in (PLACES, ANGLES, "x y z") if title.endswith(kind)), None)
        size = len(axes.split())
        words, doubtful = _words_of(line.split("#")[0], size)
        if not rows and CAMERA in title.split()[:2]:
            camera = _camera_of(title, f"{name}, line {number}")
        elif not rows and titled:  # numpy reads it after a #
            axes = titled
            stated_axes = True
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
    require(_are_bright(brightness), f"{name}: the brightness of a light must be positive.")
    shortest, longest = np.sort(np.linalg.norm(lights, axis=1))[[0, -1]]
    require(
        stated_axes or longest <= LONGEST_DIRECTION,
        f"{name}: its rows are {shortest:.3g} to {longest:.3g} long, too long for directions; if"
        f" they are places in mm, write {PLACES} as its first line, if directions, x y z.",
    )
    if axes == ANGLES:
        azimuth, elevation = np.deg2rad(lights).T
        require(
            (elevation <= np.pi / 2).all(),
            f"{name}: an elevation is above 90 deg; azimuth stands first.",
        )
        across = np.cos(elevation)
        lights = np.column_stack(
            [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)]
        )
    require(
        camera is None or axes == PLACES,
        f"{name} states the camera's place, but its lights are directions; leave out {CAMERA}.",
    )
    intensities = brightness if brightness.size else None
    return LightList(lights, tuple(names), axes == PLACES, intensities, camera)


def _camera_of(title: str, where: str) -> Point:
    with refusing(f"{where}: {CAMERA} needs three numbers x, y, z, the last above 1 mm."):
        x, y, z = (float(word) for word in title.partition(CAMERA)[2].split())
        assert max(abs(x), abs(y)) <= 1e6 and 1.0 < z <= 1e6
    return x, y, z


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


def write_light_list(
    leds: Sequence[Led],
    path: Path,
    photographs: Sequence[str],
    *,
    named: bool = False,
    camera: Camera | None = None,
) -> None:
    """Write lights as :func:`read_light_list` reads them. `photographs` show where each light was
    found; they are comments, or the list's own names where it is `named`. A `path` that ends in
    ``.lp`` is a file of RTI instead: the count, then photograph and unit direction; ``.dome`` one
    of Relight, which names no photographs.

    Of a perspective `camera` places are written from the picture's middle, and where it stands.
    """
    near = leds[0].position_mm is not None
    lights = np.array([led.towards for led in leds])
    units = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    suffix = path.suffix.lower()
    if suffix == ".lp":
        lines = [str(len(leds))]
        pairs = zip(photographs, units, strict=True)
        lines += [f"{photograph} {_written(unit)}" for photograph, unit in pairs]
        write_file(path, "\n".join([*lines, ""]).encode("utf-8"))
        return
    require(
        all((led.position_mm is not None) == near for led in leds),
        "a list of lights holds directions or places in mm, not both; write a rig file.",
    )
    lines = [LIST_TITLE, f"# {PLACES if near else 'x y z'}"]
    if near and camera is not None and camera.model == "perspective":
        rows, columns = camera.image_size
        middle = np.append(plane_points(camera, np.array([[columns - 1, rows - 1]]) / 2.0)[0], 0.0)
        lights = lights - middle
        lines.append(f"# {CAMERA} {_written(np.array([0.0, 0.0, camera.height_mm]) - middle)}")
    if suffix == ".dome":
        width = camera.image_size[1] / camera.px_per_mm if camera and camera.scale_known else 0.0
        write_file(path, _dome_of(lights if near else None, units, width))
        return
    for photograph, light in zip(photographs, lights, strict=True):
        name = "".join(c if c.isprintable() else "?" for c in photograph)
        lines.append(f"{name} {_written(light)}" if named else f"{_written(light)}  # {name}")
    write_file(path, "\n".join([*lines, ""]).encode("utf-8"))


def _dome_of(places: Array | None, units: Array, width_mm: float) -> bytes:
    """A ``.dome`` file of places (L, 3), or of directions (L, 3) where they are not known."""
    directions = tuple(_Vector(*unit) for unit in units.round(6).tolist())
    dome = _Dome("directional", round(width_mm, 6), directions=directions)
    if places is not None:
        dome.light_configuration = "lights3d"
        dome.positions3d = tuple(_Vector(*place) for place in places.round(6).tolist())
        dome.positions_sphere = dome.positions3d
        dome.dome_diameter = round(2.0 * float(np.linalg.norm(places, axis=1).mean()), 6)
    return (json.dumps(to_builtins(dome), indent=1) + "\n").encode("ascii")


def _written(vector: Array) -> str:
    return " ".join(f"{value:.6f}" for value in vector)
