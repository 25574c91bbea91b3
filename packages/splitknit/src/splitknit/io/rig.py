"""The rig file: camera and lights as JSON, format ``splitknit-rig`` version 1."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from splitknit.errors import naming, require
from splitknit.files import AnyPath
from splitknit.io.atomic import write_file
from splitknit.io.fields import Version1, converted, read_json
from splitknit.io.images import MAX_PIXELS
from splitknit.io.provenance import JsonValue, plain_json
from splitknit.model import Camera, Coordinate, Films, Led, Mirror, Point, Rig, camera_without_scale

RIG_FORMAT, RIG_VERSION = "splitknit-rig", 1
_DISTORTION_COUNTS = (4, 5, 8, 12, 14)
"""Numbers of coefficients of a lens. Source: OpenCV, `calibrateCamera`."""

_OF_LEDS = ("position_mm", "direction", "intensity", "band", "lobe_exponent", "aim", "colour")
"""Optional fields of an LED in the file."""
_Matrix = tuple[Point, Point, Point]
_Side = Annotated[int, Meta(ge=1, le=1_000_000)]


class _CameraFields(Struct):
    image_size: tuple[_Side, _Side]
    px_per_mm: Annotated[float, Meta(ge=1e-3, le=1e5)] | None
    height_mm: Annotated[float, Meta(ge=1e-3, le=1e6)] | None = None
    model: Annotated[str, Meta(pattern="^(orthographic|perspective)$")] = "orthographic"
    matrix: _Matrix | None = None
    distortion: tuple[Coordinate, ...] | None = None
    shading: Annotated[tuple[Coordinate, ...], Meta(max_length=4)] = ()
    crosstalk: _Matrix | None = None


class _RigFields(Struct):
    format: Annotated[str, Meta(pattern="^(splitknit-rig)$")]
    version: Version1
    camera: _CameraFields
    leds: Annotated[tuple[Led, ...], Meta(min_length=1, max_length=10_000)]
    mirrors: tuple[Mirror, ...] = ()
    films: Films | None = None
    provenance: dict[str, Any] | None = None


def read_rig(path: AnyPath) -> Rig:
    """Read a rig file.

    Returns
    -------
    Rig

    Raises
    ------
    BadInput
        Naming the file and the field, if anything in it is missing, of the wrong type or
        impossible.

    Examples
    --------
    >>> import splitknit
    >>> len(splitknit.read_rig("demo/capture/rig.json").leds)  # doctest: +SKIP
    14
    """
    document, _ = read_json(Path(path))
    return rig_from_json(document, str(path))


def write_rig(rig: Rig, path: AnyPath) -> None:
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
    """The document of :func:`rig_from_json`. Raises BadInput if LEDs are grouped (`also`), as by
    :meth:`Rig.select`."""
    camera = rig.camera
    distortion = camera.distortion
    if camera.model == "perspective" and distortion is None:
        distortion = (0.0,) * 5  # the file must say so
    lens = {
        "model": camera.model,
        "px_per_mm": camera.measured_px_per_mm,
        "image_size": camera.image_size,
        "height_mm": float(camera.height_mm),
        "matrix": camera.matrix,
        "distortion": distortion,
    }
    if camera.shading:
        lens["shading"] = camera.shading
    if camera.crosstalk is not None:
        lens["crosstalk"] = camera.crosstalk
    leds = []
    for index, led in enumerate(rig.leds):
        require(
            not led.also,
            f"LED {index} of the rig is a group of LEDs; write the rig from which it was selected.",
        )
        leds.append({name: value for name in _OF_LEDS if (value := getattr(led, name))})
    document = {"format": RIG_FORMAT, "version": RIG_VERSION, "camera": lens, "leds": leds}
    if rig.mirrors:
        document["mirrors"] = rig.mirrors
    if rig.films is not None:
        document["films"] = rig.films
    return plain_json({**document, "provenance": rig.provenance})  # type: ignore[return-value]


def rig_from_json(document: Any, name: str = "rig.json") -> Rig:
    """Build a rig from its JSON document; `name` is the file's name for messages.

    ``camera.model`` may be left out (orthographic), and so may ``height_mm`` of an orthographic
    camera (140), ``intensity`` (1), ``lobe_exponent`` (0), ``mirrors`` (none) and ``films``
    (ideal). A ``px_per_mm`` of null is a scale that nobody has measured. Fields that the format
    does not know are ignored. Raises BadInput naming the file and the field.
    """
    fields = converted(document, _RigFields, name)
    return naming(name, lambda: _rig(fields))


def _rig(fields: _RigFields) -> Rig:
    leds = tuple(_of_unit_direction(led, f"leds[{k}]") for k, led in enumerate(fields.leds))
    films = fields.films
    if films is not None:
        count = len(films.leds)
        different = 0 < len(set(films.leds)) == count and set(films.leds) <= set(range(len(leds)))
        require(different, f"films.leds must be different LEDs of the rig (0 to {len(leds) - 1}).")
        complete = len(films.leak) == len(films.brightness) == count
        require(complete, f"films must have a leak and a brightness for each of the {count} LEDs.")
    return Rig(_camera(fields.camera), leds, fields.provenance or {}, fields.mirrors, films)


def _camera(fields: _CameraFields) -> Camera:
    rows, columns = fields.image_size
    require(
        rows * columns <= MAX_PIXELS,
        f"camera.image_size is {rows} x {columns}, more than the {MAX_PIXELS} pixels that are"
        " read.",
    )
    require(
        fields.distortion is None or len(fields.distortion) in _DISTORTION_COUNTS,
        "camera.distortion must be a list of 4, 5, 8, 12 or 14 numbers.",
    )
    matrix = None if fields.matrix is None else np.array(fields.matrix, dtype=np.float64)
    if matrix is not None:
        sound = matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.array_equal(matrix[2], [0.0, 0.0, 1.0])
        require(
            sound, "camera.matrix must be a camera matrix: positive focal lengths, last row 0 0 1."
        )
    height_mm = fields.height_mm
    px_per_mm = fields.px_per_mm
    if fields.model == "perspective":
        whole = None not in (px_per_mm, height_mm, fields.matrix, fields.distortion)
        needs = "px_per_mm, height_mm, matrix and distortion (zeros if there is none)"
        require(whole, f"camera: a perspective camera needs {needs}.")
        assert matrix is not None and height_mm is not None and px_per_mm is not None
        by_matrix = math.sqrt(matrix[0, 0] * matrix[1, 1]) / height_mm  # on the finger plane
        require(
            0.5 <= by_matrix / px_per_mm <= 2.0,
            f"camera.px_per_mm is {px_per_mm:g}, but camera.matrix and camera.height_mm make it"
            f" {by_matrix:.4g} on the finger plane; correct one of them, or calibrate the camera.",
        )
    camera = (
        camera_without_scale((rows, columns))
        if px_per_mm is None
        else Camera(px_per_mm, (rows, columns))
    )
    return replace(
        camera,
        height_mm=height_mm or camera.height_mm,
        model=fields.model,
        matrix=matrix,
        distortion=fields.distortion,
        shading=fields.shading,
        crosstalk=(
            None if fields.crosstalk is None else np.array(fields.crosstalk, dtype=np.float64)
        ),
    )


def _of_unit_direction(led: Led, name: str) -> Led:
    """The LED with its direction normalised; a hand-written unit vector may be 2 % off."""
    alone = not led.also and not led.reflected and led.shade is None
    require(
        alone,
        f"{name} states also, reflected or shade, which are not read from files; leave them out.",
    )
    if led.direction is None:
        return led
    x, y, z = led.direction
    length = math.sqrt(x * x + y * y + z * z)
    require(
        0.98 <= length <= 1.02,
        f"{name}.direction must be a unit vector towards the light, but its length is {length:.4g};"
        " divide it by its length, or use position_mm for a place in mm.",
    )
    away = (
        f"{name}.direction points away from the camera's side (z = {z:g}); it must point towards"
        " the light."
    )
    require(z > 0, away)
    return (
        led
        if abs(length - 1.0) <= 1e-9
        else replace(led, direction=(x / length, y / length, z / length))
    )
