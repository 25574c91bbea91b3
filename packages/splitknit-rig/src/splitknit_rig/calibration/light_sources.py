"""Positions of LEDs from a nail's shadow tips; and files of lights."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import Camera, Rig, write_rig
from splitknit.errors import Refused, refusing, require
from splitknit.files import read_bytes
from splitknit.findings import Finding, worst_first
from splitknit.imaging.view import plane_points
from splitknit.io.light_list import LIST_TITLE, write_light_list
from splitknit.io.provenance import plain_json
from splitknit.io.targets import check_file
from splitknit.model import Progress, no_progress
from splitknit.nominal import side_lights
from splitknit_rig.calibration.lights import Circle, read_tips
from splitknit_rig.calibration.lights_found import (
    CalibratedLights,
    LightsOfNail,
    Rules,
    lights_of_tips,
)
from splitknit_rig.calibration.nail_photos import tips_of_photos
from splitknit_rig.calibration.written import check_rig_file


def check_lights_file(out: Path | None) -> None:
    """Refuse to replace a file that is neither a rig nor, by its suffix, a list of lights."""
    if out is not None and is_list(out):
        check_file(out, "a list of lights", _holds_lights)
    else:
        check_rig_file(out)


def _holds_lights(data: bytes) -> bool:
    """Whether a file begins like a list of lights, an .lp file or a .dome file."""
    titled = data.startswith(LIST_TITLE.encode())
    counted = data.partition(b"\n")[0].strip().isdigit()
    return titled or counted or b'"lightConfiguration"' in data


def rig_without_leds(
    px_per_cm: float | None, image_size: str | None, led_height_cm: float | None
) -> Rig:
    """A rig with an orthographic camera of a scale and size, without LEDs."""
    values = {"px_per_cm": px_per_cm, "image_size": image_size, "led_height_cm": led_height_cm}
    missing = " and ".join(f"`{name}`" for name, value in values.items() if value is None)
    require(not missing, f"calibrate lights needs {missing}, or `rig` with a camera.")
    assert px_per_cm is not None and image_size is not None and led_height_cm is not None
    expected = "two positive whole numbers, rows,columns, such as 2200,3200"
    rows, columns = pair_of(image_size, f"`image_size` must be {expected}")
    whole = (
        rows == int(rows)
        and columns == int(columns)
        and min(rows, columns) >= 1
        and rows * columns <= 2e8
    )
    require(whole, f"`image_size` must be {expected}, but it is '{image_size}'.")
    height_mm = led_height_cm * 10.0  # the thesis's camera sits at the height of its LEDs
    return Rig(Camera(px_per_cm / 10.0, (int(rows), int(columns)), height_mm=height_mm), ())


def pair_of(text: str, expected: str) -> tuple[float, float]:
    """Two finite numbers with a comma between them; `expected` begins the refusal."""
    with refusing(f"{expected}, but it is '{text}'."):
        x, y = (float(part) for part in text.split(","))
        assert abs(x) < 1e6 and abs(y) < 1e6
    return x, y


def led_circle(
    rig: Rig, radius_cm: float | None, height_cm: float | None, centre_px: str | None
) -> Circle:
    """The circle of the LEDs as stated or, by default, as in the rig."""
    side = side_lights(rig.leds)  # they stand on no circle with the others
    places = [
        led.position_mm
        for k, led in enumerate(rig.leds)
        if led.position_mm is not None and k not in side
    ]
    sizes = {"led_radius_cm": radius_cm, "led_height_cm": height_cm}
    missing = " and ".join(
        f"`{name}`" for name, value in sizes.items() if value is None and not places
    )
    require(not missing, f"calibrate lights needs {missing}, because no LED's position is known.")
    centre = (0.0, 0.0)
    if centre_px is not None:
        pixel = pair_of(centre_px, "`led_centre_px` must be x,y in pixels, such as 1575,1174")
        x, y = plane_points(rig.camera, np.array([pixel]))[0].tolist()
        centre = (x, y)
    array = np.array(places).reshape(-1, 3)
    return Circle(
        radius_mm=(
            float(np.hypot(array[:, 0], array[:, 1]).mean())
            if radius_cm is None
            else 10.0 * radius_cm
        ),
        height_mm=float(array[:, 2].mean()) if height_cm is None else 10.0 * height_cm,
        centre_mm=centre,
    )


def is_list(out: Path) -> bool:
    """Whether a file is a list of lights, by its suffix."""
    return out.suffix.lower() in (".txt", ".lp", ".dome")


def write_lights(lights: CalibratedLights, *, named: bool = False) -> None:
    """Write the file `out` of the lights, if there is one; a list names photographs if `named`."""
    out = lights.out
    if out is not None and is_list(out):
        bands = {led.band for led in lights.rig.leds}
        require(
            len(bands) == 1,
            f"'{out}' would hold lights of {len(bands)} bands, and a list is for photographs of"
            " one; name a rig file, such as rig.json.",
        )
        require(
            not named or out.suffix.lower() != ".dome",
            f"'{out}' would not name the photographs, and some are left out; write a .txt or an .lp"
            " file.",
        )
        write_light_list(
            lights.rig.leds,
            out,
            [led.image or f"LED {led.led}" for led in lights.leds],
            named=named,
            camera=lights.rig.camera,
        )
    elif out is not None:
        write_rig(lights.rig, out)


def lights_of_table(
    table: Path, rig: Rig, circle: Circle, rules: Rules, out: Path | None
) -> LightsOfNail:
    """LEDs from a table of nail and shadow tips."""
    data = read_bytes(table, 16_000_000)
    with refusing(f"{table} is not a text file; export the table as CSV in UTF-8."):
        text = data.decode("utf-8-sig")
    tips = read_tips(text, str(table))
    hashes = {table.name: hashlib.sha256(data).hexdigest()}
    lights = replace(lights_of_tips(tips, rig, circle, rules, hashes, name=str(table)), out=out)
    write_lights(lights)
    return lights


def lights_of_nail(
    folder: Path,
    rig: Rig,
    circle: Circle,
    rules: Rules,
    out: Path | None,
    *,
    encoding: str | None,
    show: Path | None,
    tips_out: Path | None,
    progress: Progress = no_progress,
) -> LightsOfNail:
    """LEDs from photographs of a nail; picture and table of the tips are written even if LEDs are
    refused."""
    if out is not None:
        show = show or out.with_name(f"{out.stem}_tips.png")
        tips_out = tips_out or out.with_name(f"{out.stem}_tips.csv")
    tips, hashes, lost = tips_of_photos(
        folder, rig.camera, encoding=encoding, show=show, table=tips_out, progress=progress
    )
    # a nail in photographs is located better than one that is clicked: to 0.01 mm in the twin, but
    # nails stand a little askew
    rules = replace(rules, nail=replace(rules.nail, sd_mm=0.05))
    gone = f"the shadow leaves the picture for {', '.join(lost)}."
    findings = [Finding("shadow-out-of-view", gone)] if lost else []
    try:
        lights = lights_of_tips(tips, rig, circle, rules, hashes, name=str(folder))
    except Refused as error:
        pictured = "" if show is None else f" ({show} shows the tips)"
        files: Any = plain_json(
            {"show": show, "tips_out": tips_out, "shadows_out_of_the_picture": lost}
        )
        files["findings"] = [*error.facts["findings"], *(finding.facts for finding in findings)]
        raise Refused(f"{str(error).rstrip('.')}{pictured}.", {**error.facts, **files}) from error
    lights = replace(
        lights,
        findings=worst_first([*lights.findings, *findings]),
        out=out,
        show=show,
        tips_out=tips_out,
        shadows_out_of_the_picture=tuple(lost),
    )
    write_lights(lights)
    return lights
