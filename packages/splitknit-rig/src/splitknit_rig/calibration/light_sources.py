"""Where the LEDs are: from a table of shadow tips, photographs of a ball, or the rig's drawing."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import Camera, Led, Rig, read_rig, write_rig
from splitknit.errors import Refused, read_bytes, refusing, require
from splitknit.imaging.response import shading_is_srgb
from splitknit.imaging.view import plane_points
from splitknit.io.light_list import LIST_TITLE, write_light_list
from splitknit.io.photograph_files import natural_order
from splitknit.io.photos import FORMATS, SUFFIXES, encoding_of, read_photo
from splitknit.io.provenance import file_hash, plain_json, provenance
from splitknit.io.targets import check_file, check_rig_file
from splitknit.model import Array, FloatArray, Progress, camera_without_scale, no_progress, side_lights
from splitknit_rig.calibration.lights import BANDS, LEDS_PER_BAND, Circle, Tip, combine, listed, read_tips
from splitknit_rig.calibration.lights_found import CalibratedLed, CalibratedLights, Rules, find_leds, rig_of
from splitknit_rig.calibration.nail_photos import FOUND_SD_MM, read_stack, tips_of_photos
from splitknit_rig.calibration.radiometry import led_name
from splitknit_rig.calibration.sphere import (
    RIM_PX,
    Ball,
    ball_of_mask,
    chrome_directions,
    find_ball,
    grey_directions,
    rim_of,
)

_UNCOMPARED = {"disagreement_deg": None, "kept": True}  # what is stated of an LED that only one nail position shows

_RIM_AGREED, _RIM_OFF = 0.5, 0.005
"""Part of all rays that must agree on a ball's rim: 0.53 on a photographed chrome ball that is half dark on dark, 0.55
and more on drawn ones, up to 0.40 where nothing but noise is seen; and part of the radius by which it must lie off the
mask to replace it."""
_RIM = (
    "the mask lies {:.1f} px beside the ball's rim in the photographs, and its radius is {:+.1f} % off: the rim is used"
)
_NO_RIM = (
    "the ball's rim is not found in the photographs near its mask{}, so that nothing checks it: each pixel that it "
    "lies aside turns the lights by {:.1f} deg; see that the mask ends at the rim."
)


@dataclass(frozen=True, slots=True)
class BallPhotographs:
    """Photographs of a ball under one light each."""

    folder: Path
    kind: str  # ``chrome`` or ``grey``
    encoding: str | None  # None: as the files state it, else linear, or sRGB by the ball's shading
    mask: Path | None  # image that is white where the ball is


def check_lights_file(out: Path | None) -> None:
    """Refuse a file that holds something else than a rig, or a list of lights by its ending."""
    if out is not None and _is_list(out):
        check_file(out, "a list of lights", lambda data: data.startswith(LIST_TITLE.encode()))
    else:
        check_rig_file(out)


def known_rig(rig: Path | None, px_per_cm: float | None, image_size: str | None, led_height_cm: float | None) -> Rig:
    """The rig of a file, or an orthographic camera of a scale and size without LEDs."""
    if rig is not None:
        return read_rig(rig)
    values = {"px_per_cm": px_per_cm, "image_size": image_size, "led_height_cm": led_height_cm}
    needed = " and ".join(f"`{name}`" for name, value in values.items() if value is None)
    require(not needed, f"calibrate lights needs {needed}, or `rig` with a camera.")
    assert px_per_cm is not None and image_size is not None and led_height_cm is not None
    rows, columns = _pair(image_size, "`image_size`", "rows,columns, such as 2200,3200")
    whole = rows == int(rows) and columns == int(columns) and min(rows, columns) >= 1 and rows * columns <= 2e8
    require(whole, f"`image_size` must be two positive whole numbers, rows,columns, but it is '{image_size}'.")
    height = led_height_cm * 10.0  # the thesis's camera sits at the height of its LEDs
    return Rig(Camera(px_per_cm / 10.0, (int(rows), int(columns)), height_mm=height), ())


def led_circle(rig: Rig, radius_cm: float | None, height_cm: float | None, centre_px: str | None) -> Circle:
    """The circle of the LEDs as it is measured, or as the rig has it."""
    side = side_lights(rig.leds)  # they stand on no circle with the others
    places = [led.position_mm for k, led in enumerate(rig.leds) if led.position_mm is not None and k not in side]
    sizes = {"led_radius_cm": radius_cm, "led_height_cm": height_cm}
    missing = " and ".join(f"`{name}`" for name, value in sizes.items() if value is None and not places)
    require(not missing, f"calibrate lights needs {missing}, because no LED's position is known.")
    centre = (0.0, 0.0)
    if centre_px is not None:
        x, y = _pair(centre_px, "`led_centre_px`", "x,y in pixels, such as 1575,1174")
        point = plane_points(rig.camera, np.array([[x, y]]))[0]
        centre = (float(point[0]), float(point[1]))
    array = np.array(places).reshape(-1, 3)
    return Circle(
        radius_mm=float(np.hypot(array[:, 0], array[:, 1]).mean()) if radius_cm is None else 10.0 * radius_cm,
        height_mm=float(array[:, 2].mean()) if height_cm is None else 10.0 * height_cm,
        centre_mm=centre,
    )


def lights_as_drawn(rig: Rig, circle: Circle, out: Path | None, *, first_azimuth_deg: float) -> CalibratedLights:
    """Write a rig whose LEDs are where the drawing has them: white and NIR in turn on the circle, 14 in equal steps."""
    found, facts = {}, []
    for nir, band in enumerate(BANDS):
        for led in range(LEDS_PER_BAND):
            azimuth = math.radians(first_azimuth_deg) + 2.0 * math.pi * (led + 0.5 * nir) / LEDS_PER_BAND
            x = circle.centre_mm[0] + circle.radius_mm * math.cos(azimuth)
            y = circle.centre_mm[1] + circle.radius_mm * math.sin(azimuth)
            place = [x, y, circle.height_mm]
            found[band, led] = combine(band, led, np.array([place]), (), circle)
            where = {"direction": found[band, led].direction.tolist(), "position_mm": place}
            facts.append({"band": band, "led": led, **where, **_UNCOMPARED, "verdict": "nominal"})
    origin = plain_json(provenance({"circle": circle, "first_azimuth_deg": first_azimuth_deg}))
    rig = rig_of(found, rig, {"method": "geometry", "provenance": origin})
    return _written(rig, out, {"method": "geometry", "leds": facts})


def _is_list(out: Path | None) -> bool:
    return out is not None and out.suffix.lower() in (".txt", ".lp")


def _written(rig: Rig, out: Path | None, facts: Mapping[str, Any]) -> CalibratedLights:
    if out is not None and _is_list(out):
        bands = {led.band for led in rig.leds}
        require(
            len(bands) == 1,
            f"'{out}' would hold lights of {len(bands)} bands, and a list is for photographs of one; name a rig file, "
            "such as rig.json.",
        )
        write_light_list(rig.leds, out, [str(one.get("image", f"LED {one['led']}")) for one in facts["leds"]])
    elif out is not None:
        write_rig(rig, out)
    plain: Any = plain_json({**facts, "written": out is not None, "out": None if out is None else str(out)})
    leds = tuple(_led_of(one) for one in plain["leds"])
    return CalibratedLights(plain["method"], leds, rig, (*plain.get("warnings", ()), *plain.get("notes", ())), plain)


def _led_of(facts: Mapping[str, Any]) -> CalibratedLed:
    known: dict[str, Any] = {one.name: facts.get(one.name) for one in fields(CalibratedLed)}
    known |= {name: known[name] and tuple(known[name]) for name in ("direction", "position_mm")}
    return CalibratedLed(**known)


def _pair(text: str, name: str, form: str) -> tuple[float, float]:
    words = f"{name} must be {form}, but it is '{text}'."
    with refusing(words):
        x, y = (float(part) for part in text.split(","))
    require(abs(x) < 1e6 and abs(y) < 1e6, words)
    return x, y


def lights_of_table(table: Path, rig: Rig, circle: Circle, rules: Rules, out: Path | None) -> CalibratedLights:
    """LEDs by a table of nail and shadow tips."""
    data = read_bytes(table, 16_000_000)
    with refusing(f"{table} is not a text file; export the table as CSV in UTF-8."):
        text = data.decode("utf-8-sig")
    tips = read_tips(text, str(table))
    hashes = {table.name: hashlib.sha256(data).hexdigest()}
    return _of_tips(tips, rig, circle, rules, out, name=str(table), hashes=hashes)


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
) -> CalibratedLights:
    """LEDs by photographs of a nail; picture and table of the tips are written even if LEDs are refused."""
    show, table = _beside(show, out, "_tips.png"), _beside(tips_out, out, "_tips.csv")
    tips, hashes, lost = tips_of_photos(
        folder, rig.camera, encoding=encoding, show=show, table=table, progress=progress
    )
    pictures: dict[str, Any] = {
        "show": None if show is None else str(show),
        "tips_out": None if table is None else str(table),
        "shadows_out_of_the_picture": lost,
    }
    # what is found in photographs is better than what is clicked
    rules = replace(rules, nail=replace(rules.nail, sd_mm=FOUND_SD_MM))
    try:
        lights = _of_tips(tips, rig, circle, rules, out, name=str(folder), hashes=hashes)
    except Refused as error:
        seen = "" if show is None else f" ({show} shows what was found)"
        raise Refused(f"{str(error).rstrip('.')}{seen}.", {**error.facts, **pictures}) from error
    return replace(lights, facts={**lights.facts, **pictures})


def _beside(path: Path | None, out: Path | None, ending: str) -> Path | None:
    return path if path is not None or out is None else out.with_name(out.stem + ending)


def _of_tips(
    tips: Sequence[Tip],
    rig: Rig,
    circle: Circle,
    rules: Rules,
    out: Path | None,
    *,
    name: str,
    hashes: Mapping[str, str],
) -> CalibratedLights:
    """Judge the LEDs of tips, and write them; `hashes`: of the table or folder `name`, by file."""
    chosen, facts, sentence = find_leds(tips, rig.camera, circle, rules, name)
    facts["circle"] = {"radius_mm": circle.radius_mm, "height_mm": circle.height_mm}
    if sentence is not None:
        plain: Any = plain_json({**facts, "written": False, "out": None})
        raise Refused(f"{name}: {sentence}", plain)
    origin = provenance(
        {"method": facts["method"], "circle": circle, "limit_deg": rules.limit_deg, "nail": rules.nail}, hashes
    )
    kept = ("band", "led", "verdict", "disagreement_deg", "interval_deg", "interval_mm")
    words = [{key: led[key] for key in kept} for led in facts["leds"]]
    rig = rig_of(chosen, rig, {"leds": plain_json(words), "provenance": plain_json(origin)})
    drawn = [led_name(rig.leds, k) for k in side_lights(rig.leds)]
    if drawn:
        note = f"the side lights {listed(drawn)} keep the places that the rig file had; a ball measures them"
        facts["warnings"] = [*facts["warnings"], note]
    return _written(rig, out, facts)


def lights_of_ball(
    photos: BallPhotographs, base: Rig | None, out: Path | None, *, led_height_cm: float | None
) -> CalibratedLights:
    """Find the light's direction of every photograph. With `led_height_cm` LEDs are placed at that height, side lights
    of the rig `base` as far away as drawn; with a `base` the ball lies on the finger plane, camera and LEDs near.
    """
    photographs = _photographs(photos.folder)
    paths = [file for _, _, file in photographs]
    rows, columns = read_photo(paths[0]).pixels.shape[:2]
    size = (rows, columns)
    near = led_height_cm is not None
    require(
        base is not None or not near or out is None or _is_list(out),
        "`led_height_cm` gives places in mm, and a rig file with places needs the scale: give `px_per_cm` and "
        "`image_size`, or `rig`, or write a list of lights (`out` lights.txt).",
    )
    known = base is not None
    if base is None:
        base = Rig(Camera(1.0, size) if near else camera_without_scale(size), ())
    camera_size = base.camera.image_size
    stack, digests = read_stack(paths, camera_size, photos.encoding or "linear", upright=True)
    hashes = {file.relative_to(photos.folder).as_posix(): digest for file, digest in digests.items()}
    ball, notes = _ball(photos, stack, size, hashes)
    encoding = photos.encoding
    if encoding is None:
        encoding, note = encoding_of(paths, lambda: photos.kind == "grey" and _ball_is_srgb(stack, ball))
        notes += [note] if note else []
    if encoding == "srgb" and photos.encoding is None:
        stack, _ = read_stack(paths, camera_size, encoding, upright=True)
    strengths: Array | None = None
    height = None if led_height_cm is None else 10.0 * led_height_cm
    lying = _Lying.of(base, ball, [f"{band} {led}" for band, led, _ in photographs], lying=known and near)
    if photos.kind == "chrome":
        directions = chrome_directions(stack, ball, lying.eye, lying.away)
    else:
        directions, strengths = grey_directions(stack, ball, eye=lying.eye, away=lying.away)
    low = [str(file) for file, unit in zip(paths, directions, strict=True) if unit[2] <= 0.05]
    require(not low, f"{' and '.join(low)}: the light stands beside or behind the ball; correct the mask or the image.")
    facts, leds = [], []
    for k, ((band, led, file), direction) in enumerate(zip(photographs, directions, strict=True)):
        unit = (float(direction[0]), float(direction[1]), float(direction[2]))
        place = None if height is None else lying.place(k, direction, height)
        require(
            place is None or lying.aside(k) or not side_lights([Led(band, place)]),
            f"{file} shows a side light, {math.degrees(math.acos(unit[2])):.0f} deg off the axis, for which "
            "`led_height_cm` does not hold; give `rig`, in which it is drawn.",
        )
        strength = 1.0 if strengths is None else float(strengths[k] / strengths.mean())
        # a near light's strength falls with the square of its distance
        intensity = strength if place is None else strength * (float(np.linalg.norm(place)) / 100.0) ** 2
        leds.append(Led(band, position_mm=place, direction=unit if place is None else None, intensity=intensity))
        where = {"direction": list(unit), "position_mm": place and list(place)}
        how = {"strength": None if strengths is None else strength, **_UNCOMPARED, "verdict": "unchecked"}
        facts.append({"band": band, "led": led, "image": file.name, **where, **how})
    origin = provenance({"sphere": photos.kind, "ball": ball}, hashes)
    said = {**base.provenance, "lights": {"method": photos.kind, "provenance": plain_json(origin)}}
    rig = Rig(base.camera, tuple(leds), said, base.mirrors)
    outline = {"column": ball.column, "row": ball.row, "radius_px": ball.radius_px}
    found = {"method": photos.kind, "ball": outline, "encoding": encoding, "leds": facts}
    return _written(rig, out, {**found, "notes": notes})


@dataclass(frozen=True, slots=True, eq=False)
class _Lying:
    """A ball on the finger plane, under near LEDs."""

    middle_mm: Array
    radius_mm: float = 1.0
    eye: Array | None = None
    away: Array | None = None  # see :mod:`splitknit_rig.calibration.sphere`
    drawn: tuple[Led | None, ...] = ()

    @classmethod
    def of(cls, rig: Rig, ball: Ball, names: Sequence[str], *, lying: bool) -> _Lying:
        """A ball under the named LEDs of a rig; not `lying`: where it lies is not known."""
        if not lying:
            return cls(np.zeros(3))
        camera, own = rig.camera, {led_name(rig.leds, k): led for k, led in enumerate(rig.leds)}
        radius, eye, away = ball.radius_px / camera.px_per_mm, None, None
        middle = np.append(plane_points(camera, np.array([[ball.column, ball.row]]))[0], radius)
        if camera.model == "perspective":  # above the finger plane it is seen larger, and further out
            scale = camera.height_mm / (camera.height_mm + radius)
            middle, radius = middle * scale, radius * scale
            eye = (np.array([0.0, 0.0, camera.height_mm]) - middle) / radius
        drawn = tuple(own.get(name) for name in names)
        places = [led.position_mm for led in drawn if led is not None and led.position_mm is not None]
        if len(places) == len(names):
            away = np.linalg.norm(np.array(places) - middle, axis=1) / radius
        return cls(middle, radius, eye, away, drawn)

    def aside(self, k: int) -> bool:
        """Whether the rig has LED k at the side, and all LEDs are drawn."""
        led = self.drawn[k] if self.away is not None else None
        return led is not None and bool(side_lights([led]))

    def place(self, k: int, direction: Array, height_mm: float) -> tuple[float, float, float]:
        """Where LED k is: at a height, or at the side as far from the ball as it is drawn."""
        far = (height_mm - self.middle_mm[2]) / direction[2]
        if self.away is not None and self.aside(k):
            far = self.away[k] * self.radius_mm
        x, y, z = (float(value) for value in self.middle_mm + far * direction)
        return x, y, z


def _ball_is_srgb(codes: FloatArray, ball: Ball) -> bool | None:
    """Whether the shading of a matt ball of known normals is that of sRGB values: its pixels are the lights here."""
    normals = ball.normals(codes.shape[1:])
    inner = np.argwhere(np.nan_to_num(normals[..., 2]) > 0.3)
    rows, columns = inner[:: max(1, len(inner) // 2000)].T
    return shading_is_srgb(codes[:, rows, columns].T, normals[rows, columns], known=True)


def _photographs(folder: Path) -> list[tuple[str, int, Path]]:
    """Band, LED, file of images: ``white_3.png`` names them; others are white ones in the order of their numbers."""
    require(folder.is_dir(), f"{folder} is not a folder; name the folder with the photographs of the ball.")
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()]
    files = [
        file for file in files if "mask" not in file.stem.lower() and not file.name.lower().startswith((".", "ambient"))
    ]
    require(bool(files), f"{folder} holds no photographs ({FORMATS}).")
    named = [re.fullmatch(r"(white|nir)[_.-]?(\d+)", file.stem.lower()) for file in files]
    found = [(match[1], int(match[2]), file) for match, file in zip(named, files, strict=True) if match]
    if len(found) == len(files):
        return sorted(found, key=lambda one: (BANDS.index(one[0]), one[1]))
    return [("white", k, file) for k, file in enumerate(sorted(files, key=lambda file: natural_order(file.name)))]


def _ball(
    photos: BallPhotographs, stack: FloatArray, size: tuple[int, int], hashes: dict[str, str]
) -> tuple[Ball, list[str]]:
    """The ball within the rim that the photographs (L, H, W) show, near `mask` where there is one, and notes."""
    mask = photos.mask
    if mask is None:
        return find_ball(stack), []
    pixels = read_photo(mask).pixels
    require(
        pixels.shape[:2] == size,
        f"{mask} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but the photographs have "
        f"{size[0]} x {size[1]}.",
    )
    hashes[mask.name] = file_hash(mask)
    ball = ball_of_mask(pixels.mean(axis=2) > np.iinfo(pixels.dtype).max / 2)
    rim, agreed = rim_of(stack, ball)
    per_radius = 2.0 if photos.kind == "chrome" else 1.0  # a mirror doubles what its normal turns by
    if agreed < _RIM_AGREED:
        small = f", as the ball is smaller than {2 * RIM_PX:g} px" if ball.radius_px < RIM_PX else ""
        return ball, [_NO_RIM.format(small, math.degrees(per_radius / ball.radius_px))]
    aside, larger = math.hypot(ball.column - rim.column, ball.row - rim.row), ball.radius_px - rim.radius_px
    if aside + abs(larger) < max(_RIM_OFF * rim.radius_px, 0.5):
        return ball, []
    turned = math.degrees((per_radius * aside + 0.6 * abs(larger)) / rim.radius_px)
    said = _RIM.format(aside, 100.0 * larger / rim.radius_px)
    return rim, [f"{said}; by the mask the lights would be some {turned:.1f} deg off."]
