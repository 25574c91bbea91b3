"""The rig file: camera and lights as JSON, format ``splitknit-rig`` version 1."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import asdict as fields_of

from splitknit.errors import naming, require
from splitknit.io.atomic import write_file
from splitknit.io.fields import Version1, converted, read_json
from splitknit.io.provenance import JsonValue, plain_json
from splitknit.model import Camera, Films, Led, Mirror, Rig, camera_without_scale

RIG_FORMAT, RIG_VERSION = "splitknit-rig", 1
_MAX_PIXELS = 200_000_000
_DISTORTION_COUNTS = (4, 5, 8, 12, 14)

_Number = Annotated[float, Meta(ge=-1e7, le=1e7)]
_Point = tuple[_Number, _Number, _Number]
_Matrix = tuple[_Point, _Point, _Point]
_Side = Annotated[int, Meta(ge=1, le=1_000_000)]


class _CameraFields(Struct):
    image_size: tuple[_Side, _Side]
    px_per_mm: Annotated[float, Meta(ge=1e-3, le=1e5)] | None
    height_mm: Annotated[float, Meta(ge=1e-3, le=1e6)] | None = None
    model: Annotated[str, Meta(pattern="^(orthographic|perspective)$")] = "orthographic"
    matrix: _Matrix | None = None
    distortion: tuple[_Number, ...] | None = None
    shading: Annotated[tuple[_Number, ...], Meta(max_length=4)] = ()
    crosstalk: _Matrix | None = None


class _LedFields(Struct):
    band: Annotated[str, Meta(min_length=1)]
    position_mm: _Point | None = None
    direction: _Point | None = None
    intensity: Annotated[float, Meta(ge=1e-9, le=1e9)] = 1.0
    lobe_exponent: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    aim: _Point | None = None
    colour: str = ""


_Brightness = Annotated[float, Meta(ge=0.01, le=100)]


class _FilmsFields(Struct):
    leds: tuple[int, ...]
    leak: tuple[Annotated[float, Meta(ge=0, le=0.499)], ...]
    brightness: tuple[tuple[_Brightness, _Brightness, _Brightness], ...]
    shift_px: tuple[_Number, _Number] = (0.0, 0.0)
    scale: Annotated[float, Meta(ge=0.9, le=1.1)] = 1.0


class _RigFields(Struct):
    format: Annotated[str, Meta(pattern="^(splitknit-rig)$")]
    version: Version1
    camera: _CameraFields
    leds: Annotated[list[_LedFields], Meta(min_length=1, max_length=10_000)]
    mirrors: tuple[Mirror, ...] = ()
    films: _FilmsFields | None = None
    provenance: dict[str, Any] | None = None


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """Read a rig file.

    Returns
    -------
    Rig

    Raises
    ------
    BadInput
        Naming the file and the field, if anything in it is missing, of the wrong type or impossible.

    Examples
    --------
    >>> import splitknit
    >>> len(splitknit.read_rig("demo/capture/rig.json").leds)  # doctest: +SKIP
    14
    """
    document, _ = read_json(Path(path))
    return rig_from_json(document, str(path))


def write_rig(rig: Rig, path: str | os.PathLike[str]) -> None:
    """Write a rig file; equal rigs give equal bytes.

    Parameters
    ----------
    rig : Rig
    path : file to write

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1)
    >>> splitknit.write_rig(capture.rig, "rig.json")  # doctest: +SKIP
    """
    text = json.dumps(rig_to_json(rig), indent=2, allow_nan=False) + "\n"
    write_file(path, text.encode("ascii"))


def rig_to_json(rig: Rig) -> dict[str, JsonValue]:
    """The document of :func:`rig_from_json`. Raises BadInput if LEDs are grouped (`also`), as by :meth:`Rig.select`."""
    camera = rig.camera
    distortion = rig.camera.distortion
    leds = list[JsonValue]()
    if camera.model == "perspective" and distortion is None:
        distortion = (0.0,) * 5  # the file must say so
    for index, led in enumerate(rig.leds):
        require(not led.also, f"LED {index} of the rig is a group of LEDs; write the rig from which it was selected.")
        place = "position_mm" if led.position_mm is not None else "direction"
        entry: dict[str, Any] = {place: plain_json(getattr(led, place)), "intensity": led.intensity, "band": led.band}
        if led.lobe_exponent:
            entry["lobe_exponent"] = led.lobe_exponent
        if led.aim is not None:
            entry["aim"] = plain_json(led.aim)
        if led.colour:
            entry["colour"] = led.colour
        leds.append(plain_json(entry))
    mirrors = [
        {"name": one.name, "corners_mm": np.array(one.corners_mm, np.float64), "reflectance": float(one.reflectance)}
        for one in rig.mirrors
    ]
    return {
        "format": RIG_FORMAT,
        "version": RIG_VERSION,
        "camera": {
            "model": camera.model,
            "px_per_mm": camera.measured_px_per_mm,
            "image_size": [int(camera.image_size[0]), int(camera.image_size[1])],
            "height_mm": float(camera.height_mm),
            "matrix": plain_json(camera.matrix),
            "distortion": plain_json(distortion),
            **({"shading": plain_json(camera.shading)} if camera.shading else {}),
            **({} if camera.crosstalk is None else {"crosstalk": plain_json(camera.crosstalk)}),
        },
        "leds": leds,
        **({"mirrors": plain_json(mirrors)} if mirrors else {}),
        **({} if rig.films is None else {"films": plain_json(asdict(rig.films))}),
        "provenance": plain_json(rig.provenance),
    }


def rig_from_json(document: Any, name: str = "rig.json") -> Rig:
    """Build a rig from its JSON document; `name` is the file's name for messages.

    ``camera.model`` may be left out (orthographic), and so may ``height_mm`` of an orthographic camera (140),
    ``intensity`` (1), ``lobe_exponent`` (0), ``mirrors`` (none) and ``films`` (ideal). A ``px_per_mm`` of null is a
    scale that nobody has measured. Fields that the format does not know are ignored. Raises BadInput naming the file
    and the field.
    """
    fields = converted(document, _RigFields, name)
    camera = naming(name, partial(_camera, fields.camera))
    leds = tuple(naming(f"{name}: leds[{k}]", partial(_led, led)) for k, led in enumerate(fields.leds))
    films = None if fields.films is None else _films(fields.films, len(leds), f"{name}: films")
    return naming(name, lambda: Rig(camera, leds, fields.provenance or {}, fields.mirrors, films))


def _films(films: _FilmsFields, count: int, where: str) -> Films:
    leds = len(films.leds)
    different = 0 < len(set(films.leds)) == leds and all(0 <= k < count for k in films.leds)
    require(different, f"{where}.leds must be different LEDs of the rig (0 to {count - 1}).")
    require(
        len(films.leak) == len(films.brightness) == leds,
        f"{where} must have a leak and a brightness for each of the {leds} LEDs.",
    )
    return Films(**fields_of(films))


def _camera(fields: _CameraFields) -> Camera:
    rows, columns = fields.image_size
    require(
        rows * columns <= _MAX_PIXELS,
        f"camera.image_size is {rows} x {columns}, more than the {_MAX_PIXELS} pixels that are read.",
    )
    require(
        fields.distortion is None or len(fields.distortion) in _DISTORTION_COUNTS,
        "camera.distortion must be a list of 4, 5, 8, 12 or 14 numbers.",
    )
    matrix = None if fields.matrix is None else np.array(fields.matrix, dtype=np.float64)
    if matrix is not None:
        sound = matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.array_equal(matrix[2], [0.0, 0.0, 1.0])
        require(bool(sound), "camera.matrix must be a camera matrix: positive focal lengths, last row 0 0 1.")
    if fields.model == "perspective":
        whole = None not in (fields.distortion, fields.height_mm, fields.matrix, fields.px_per_mm)
        require(
            whole,
            "camera: a perspective camera needs px_per_mm, height_mm, matrix and distortion (zeros if there is none).",
        )
    if fields.model == "perspective" and matrix is not None and fields.height_mm and fields.px_per_mm:
        by_matrix = math.sqrt(matrix[0, 0] * matrix[1, 1]) / fields.height_mm  # on the finger plane
        require(
            0.5 <= by_matrix / fields.px_per_mm <= 2.0,
            f"camera.px_per_mm is {fields.px_per_mm:g}, but camera.matrix and camera.height_mm make it"
            f" {by_matrix:.4g} on the finger plane; correct one of them, or calibrate the camera.",
        )
    return Camera(
        fields.px_per_mm or camera_without_scale(fields.image_size).px_per_mm,
        fields.image_size,
        fields.height_mm or 140.0,
        fields.model,
        matrix,
        fields.distortion,
        fields.shading,
        None if fields.crosstalk is None else np.array(fields.crosstalk, dtype=np.float64),
        fields.px_per_mm is not None,
    )


def _led(fields: _LedFields) -> Led:
    """The LED; 2 % of rounding in a hand-written unit vector are forgiven and taken off."""
    led = Led(**fields_of(fields))
    if led.direction is None:
        return led
    x, y, z = led.direction
    length = math.sqrt(x * x + y * y + z * z)
    require(
        0.98 <= length <= 1.02,
        f"direction must be a unit vector towards the light, but its length is {length:.4g}; divide it by its length"
        ", or use position_mm for a place in mm.",
    )
    require(z > 0, f"direction points away from the camera's side (z = {z:g}); it must point towards the light.")
    return led if abs(length - 1.0) <= 1e-9 else replace(led, direction=(x / length, y / length, z / length))
