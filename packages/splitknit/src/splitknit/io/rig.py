"""The rig file: camera and lights as JSON, format ``splitknit-rig`` version 1."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming, require
from splitknit.io.atomic import write_file
from splitknit.io.fields import Fields, read_json
from splitknit.io.provenance import JsonValue, plain_json
from splitknit.model import Camera, Films, Led, Mirror, Rig, camera_without_scale

RIG_FORMAT, RIG_VERSION = "splitknit-rig", 1
_MAX_PIXELS = 200_000_000
_DISTORTION_COUNTS = (4, 5, 8, 12, 14)


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
    camera, distortion, leds = rig.camera, rig.camera.distortion, list[JsonValue]()
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
    fields = Fields(document, name)
    fields.format(RIG_FORMAT, RIG_VERSION)
    camera = _camera(fields.child("camera"))
    entries = fields.items("leds")
    if not 1 <= len(entries) <= 10_000:
        fields.refuse("leds", "a list of at least one LED")
    leds = tuple(_led(Fields(entry, name, f"leds[{k}]")) for k, entry in enumerate(entries))
    entries = fields.items("mirrors") if fields.has("mirrors") else []
    mirrors = [_mirror(Fields(entry, name, f"mirrors[{k}]")) for k, entry in enumerate(entries)]
    origin = fields.mapping("provenance")
    films = _films(fields.child("films"), len(leds)) if fields.has("films") else None
    return naming(name, lambda: Rig(camera, leds, origin, tuple(mirrors), films))


def _films(fields: Fields, count: int) -> Films:
    leds = fields.items("leds")
    if not (all(type(k) is int and 0 <= k < count for k in leds) and 0 < len(set(leds)) == len(leds)):
        fields.refuse("leds", f"a list of different LEDs of the rig (0 to {count - 1})")
    expected = f"three numbers from 0.01 to 100 for each of the {len(leds)} LEDs"
    rows = fields.triples("brightness", 100.0, expected)
    if len(rows) != len(leds) or np.min(rows) < 0.01:
        fields.refuse("brightness", expected)
    leak = fields.numbers("leak", (len(leds),), 0.499)
    if min(leak) < 0.0:
        fields.refuse("leak", "numbers from 0 to 0.499")
    return Films(
        leds=tuple(leds),
        leak=leak,
        brightness=rows,
        shift_px=fields.numbers("shift_px", (2,), 1e3),
        scale=fields.number("scale", 0.9, 1.1, 1.0),
        extinction_ratio=fields.number("extinction_ratio", 1.0, 1e9) if fields.has("extinction_ratio") else None,
        angle_deg=fields.numbers("angle_deg", (0, len(leds)), 90.0) if fields.has("angle_deg") else (),
    )


def _mirror(fields: Fields) -> Mirror:
    corners = fields.triples("corners_mm", 1e4, "a list of points, each three numbers in mm")
    name, reflectance = fields.text("name"), fields.number("reflectance", 1e-6, 1.0, 0.9)
    return naming(f"{fields.name}: {fields.where}", lambda: Mirror(name, corners, reflectance))


def _camera(fields: Fields) -> Camera:
    model = fields.choice("model", ("orthographic", "perspective"))
    perspective = model == "perspective"
    size = fields.items("image_size")
    if len(size) != 2 or not all(type(item) is int and 0 < item <= 1_000_000 for item in size):
        fields.refuse("image_size", "two positive whole numbers, rows and columns")
    rows, columns = size
    few = rows * columns <= _MAX_PIXELS
    fields.require(few, "image_size", f"is {rows} x {columns}, more than the {_MAX_PIXELS} pixels that are read.")
    distortion = fields.numbers("distortion", _DISTORTION_COUNTS) if fields.has("distortion") else None
    if perspective and distortion is None:
        fields.refuse("distortion", "given for a perspective camera (zeros if there is none)")
    known = perspective or fields.has("px_per_mm") or "px_per_mm" not in fields.keys()  # noqa: SIM118 - not a dict
    px_per_mm = fields.number("px_per_mm", 1e-3, 1e5) if known else camera_without_scale((rows, columns)).px_per_mm
    height_mm = fields.number("height_mm", 1e-3, 1e6, None if perspective else 140.0)
    matrix = None
    if perspective or fields.has("matrix"):
        matrix = _numbers_3x3(fields, "matrix", "3 x 3 finite numbers (the camera matrix in pixels)")
        if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.array_equal(matrix[2], [0.0, 0.0, 1.0])):
            fields.refuse("matrix", "a camera matrix: positive focal lengths, last row 0 0 1")
    if perspective and matrix is not None:  # focal length over height is the scale on the finger plane
        seen = math.sqrt(matrix[0, 0] * matrix[1, 1]) / height_mm
        other = f"is {px_per_mm:g}, but camera.matrix and camera.height_mm make it {seen:.4g} on the finger plane"
        remedy = "correct one of them, or calibrate the camera."
        fields.require(0.5 <= seen / px_per_mm <= 2.0, "px_per_mm", f"{other}; {remedy}")
    shading = fields.numbers("shading", (1, 2, 3, 4)) if fields.has("shading") else ()
    crosstalk = _numbers_3x3(fields, "crosstalk") if fields.has("crosstalk") else None
    given = px_per_mm, (rows, columns), height_mm, model, matrix, distortion, shading, crosstalk, known
    return naming(fields.name, lambda: Camera(*given))


def _numbers_3x3(fields: Fields, name: str, what: str = "3 x 3 finite numbers") -> NDArray[np.float64]:
    rows = fields.triples(name, 1e7, what)
    if len(rows) != 3:
        fields.refuse(name, what)
    return np.array(rows, dtype=np.float64)


def _led(fields: Fields) -> Led:
    band = fields.text("band")
    if not band.strip():
        fields.refuse("band", 'the name of a band ("white" or "nir")')
    near, distant = fields.has("position_mm"), fields.has("direction")
    found = f"must have either position_mm (near) or direction (distant), but it has {'both' if near else 'neither'}."
    fields.require(near != distant, "", found)
    position = fields.numbers("position_mm", (3,)) if near else None
    if position is not None and position[2] < 1e-3:
        fields.refuse("position_mm", "a place above the finger plane (the third number positive)")
    direction = _direction(fields) if distant else None
    intensity = fields.number("intensity", 1e-9, 1e9, 1.0)
    lobe_exponent = fields.number("lobe_exponent", 0.0, 1000.0, 0.0)
    aim = fields.numbers("aim", (3,)) if fields.has("aim") else None
    colour = fields.text("colour", "")
    given = band, position, direction, intensity, lobe_exponent, aim
    return naming(f"{fields.name}: {fields.where}", lambda: Led(*given, colour=colour))


def _direction(fields: Fields) -> tuple[float, float, float]:
    """Return the unit vector: 2 % of rounding in a hand-written file are forgiven and taken off."""
    x, y, z = fields.numbers("direction", (3,))
    length = math.sqrt(x * x + y * y + z * z)
    long = f"must be a unit vector towards the light, but its length is {length:.4g}; divide it by its length"
    fields.require(0.98 <= length <= 1.02, "direction", f"{long}, or use position_mm for a place in mm.")
    away = f"points away from the camera's side (z = {z:g}); it must point towards the light, z towards the camera."
    fields.require(z > 0, "direction", away)
    return (x, y, z) if abs(length - 1.0) <= 1e-9 else (x / length, y / length, z / length)
