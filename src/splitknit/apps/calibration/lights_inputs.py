"""What the command line of ``splitknit calibrate lights`` says about the rig, in one piece."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.apps.calibration.calibrated_lights import LightSettings, rig_of
from splitknit.apps.options import read_changes
from splitknit.apps.targets import check_rig_file
from splitknit.apps.verb import Outcome
from splitknit.calibration.light_table import BANDS, LEDS_PER_BAND
from splitknit.calibration.lights import Circle, combine
from splitknit.errors import require
from splitknit.imaging.view import plane_points
from splitknit.io import plain_json, provenance, read_rig, write_rig
from splitknit.model import Camera, Rig
from splitknit.settings import override


@dataclass(frozen=True, slots=True, eq=False)
class RigInputs:
    """The camera, and the rig it is from."""

    camera: Camera
    base: Rig | None


def check_way(options: argparse.Namespace) -> str:
    """Return ``table``, ``images``, ``sphere`` or ``geometry``.

    Raises
    ------
    BadInput
        If none or several of them are asked for.
    """
    images = options.images is not None and options.sphere is None
    asked = {
        "table": options.table is not None,
        "images": images,
        "sphere": options.sphere is not None,
        "geometry": bool(options.geometry),
    }
    ways = [way for way, wanted in asked.items() if wanted]
    require(
        len(ways) == 1,
        f"calibrate lights needs one of --table CSV, --images FOLDER, --sphere KIND with --images, and --geometry, but "
        f"{'none was' if not ways else ' and '.join('--' + way for way in ways) + ' were'} given.",
    )
    require(
        ways[0] != "sphere" or options.images is not None, "--sphere needs --images FOLDER, photographs of the ball."
    )
    check_rig_file(options.out)
    require(ways[0] != "geometry" or options.out is not None, "--geometry writes a rig file; name it with --out FILE.")
    return ways[0]


def rig_inputs(options: argparse.Namespace) -> RigInputs:
    """Return the camera of ``--rig``, or an orthographic one of ``--px-per-cm`` and ``--image-size``."""
    if options.rig is not None:
        for name in ("px_per_cm", "image_size"):
            given = getattr(options, name) is None
            require(given, f"--{name.replace('_', '-')} and --rig say the same thing; give one of them.")
        base = read_rig(options.rig)
        return RigInputs(base.camera, base)
    needed = [name for name in ("px_per_cm", "image_size", "led_height_cm") if getattr(options, name) is None]
    require(
        not needed,
        f"calibrate lights needs {' and '.join('--' + name.replace('_', '-') for name in needed)}, or --rig FILE "
        f"with a camera.",
    )
    rows, columns = _pair(options.image_size, "--image-size", "rows,columns, such as 2200,3200")
    whole = rows == int(rows) and columns == int(columns) and min(rows, columns) >= 1 and rows * columns <= 2e8
    require(whole, f"--image-size must be two positive whole numbers, rows,columns, but it is '{options.image_size}'.")
    height = options.led_height_cm * 10.0  # the thesis's camera sits at the height of its LEDs
    return RigInputs(Camera(options.px_per_cm / 10.0, (int(rows), int(columns)), height_mm=height), None)


def circle_of(options: argparse.Namespace, inputs: RigInputs) -> Circle:
    """Return the LED circle: of the options, and else of the rig's LEDs."""
    places = [led.position_mm for led in inputs.base.leds if led.position_mm is not None] if inputs.base else []
    radius, height = options.led_radius_cm, options.led_height_cm
    missing = [
        f"--led-{what}-cm" for what, value in (("radius", radius), ("height", height)) if value is None and not places
    ]
    require(
        not missing,
        f"calibrate lights needs {' and '.join(missing)}"
        + (", because the rig's LEDs have no positions." if inputs.base else "."),
    )
    centre = (0.0, 0.0)
    if options.led_centre_px is not None:
        x, y = _pair(options.led_centre_px, "--led-centre-px", "x,y in pixels, such as 1575,1174")
        point = plane_points(inputs.camera, np.array([[x, y]]))[0]
        centre = (float(point[0]), float(point[1]))
    array = np.array(places).reshape(-1, 3)
    return Circle(
        radius_mm=float(np.hypot(array[:, 0], array[:, 1]).mean()) if radius is None else 10.0 * radius,
        height_mm=float(array[:, 2].mean()) if height is None else 10.0 * height,
        centre_mm=centre,
    )


def settings_of(options: argparse.Namespace) -> LightSettings:
    """Return the settings: ``--set`` and ``--settings``, then the options of their own."""
    settings = override(LightSettings(), read_changes(options.settings, options.assignments))
    if options.limit_deg is not None:
        settings = replace(settings, limits=replace(settings.limits, limit_deg=options.limit_deg))
    if options.nail_height_mm is not None:
        settings = replace(settings, nail=replace(settings.nail, nail_height_mm=options.nail_height_mm))
    if options.nail_seen is not None:
        settings = replace(settings, nail=replace(settings.nail, nail_seen=options.nail_seen))
    return settings


def nominal_lights(options: argparse.Namespace, inputs: RigInputs) -> Outcome:
    """Write a rig whose LEDs are where the drawing has them: white and NIR in turn on the circle, 14 in equal steps."""
    circle = circle_of(options, inputs)
    found, facts = {}, []
    for nir, band in enumerate(BANDS):
        for led in range(LEDS_PER_BAND):
            azimuth = math.radians(options.first_azimuth_deg) + 2.0 * math.pi * (led + 0.5 * nir) / LEDS_PER_BAND
            x = circle.centre_mm[0] + circle.radius_mm * math.cos(azimuth)
            y = circle.centre_mm[1] + circle.radius_mm * math.sin(azimuth)
            place = np.array([[x, y, circle.height_mm]])
            found[band, led] = combine(band, led, place, (), circle)
            facts.append(
                {
                    "band": band,
                    "led": led,
                    "direction": found[band, led].direction.tolist(),
                    "position_mm": [x, y, circle.height_mm],
                    "disagreement_deg": None,
                    "verdict": "nominal",
                    "kept": True,
                }
            )
    origin = plain_json({**provenance({"circle": circle, "first_azimuth_deg": options.first_azimuth_deg})})
    rig = rig_of(found, inputs.camera, inputs.base, {"method": "geometry", "provenance": origin})
    write_rig(rig, options.out)
    lines = [f"{len(found)} LEDs where the drawing has them, not measured; written to {options.out}."]
    return {"method": "geometry", "leds": facts, "written": True, "out": str(options.out)}, lines


def write_lights(rig: Rig, out: Path | None, facts: dict[str, Any], lines: list[str]) -> Outcome:
    """Write the rig where a name is given, and say so."""
    if out is not None:
        write_rig(rig, out)
    facts = {**facts, "written": out is not None, "out": None if out is None else str(out)}
    said = "No rig was written; name one with --out FILE." if out is None else f"Written to {out}."
    result = plain_json(facts)
    assert isinstance(result, dict)
    return dict(result), [*lines, said]


def _pair(text: str, name: str, form: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    sound = len(values) == 2 and all(math.isfinite(value) and abs(value) < 1e6 for value in values)
    require(sound, f"{name} must be {form}, but it is '{text}'.")
    return values[0], values[1]
