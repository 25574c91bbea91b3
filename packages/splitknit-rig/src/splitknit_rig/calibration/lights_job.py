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
from splitknit.io.photos import FORMATS, SUFFIXES, encoding_of, read_photo
from splitknit.io.plain import natural_order
from splitknit.io.provenance import file_hash, plain_json, provenance
from splitknit.io.targets import check_file, check_rig_file
from splitknit.model import Array, FloatArray, camera_without_scale, no_progress, side_lights
from splitknit.verbs import Progress, path
from splitknit_rig.calibration.jobs import LightsJob
from splitknit_rig.calibration.lights import BANDS, LEDS_PER_BAND, Circle, Tip, combine, listed, read_tips
from splitknit_rig.calibration.lights_found import CalibratedLed, CalibratedLights, find_leds, rig_of
from splitknit_rig.calibration.nail import Nail
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


def lights_to_rig(job: LightsJob, progress: Progress = no_progress) -> CalibratedLights:
    """Find the LEDs, and write the rig file where one is named; see :class:`LightsJob`."""
    nail = Nail(job.nail_height_mm, job.nail_seen or "tip")
    source = _checked_source(job)
    if source == "sphere":
        return _of_sphere(job)
    rig = _base_rig(job)
    circle = _circle_of(job, rig)
    if source == "geometry":
        return _nominal(job, rig, circle)
    read = _of_table if source == "table" else _of_images
    return read(job, rig, circle, nail, progress)


def _checked_source(job: LightsJob) -> str:
    asked = {"table": job.table, "images": None if job.sphere else job.images, "sphere": job.sphere}
    sources = [name for name, given in asked.items() if given is not None] + ["geometry"] * bool(job.geometry)
    require(
        len(sources) == 1,
        f"calibrate lights needs one of `table`, `images`, `sphere` with `images`, and `geometry`, but "
        f"{'none was' if not sources else ' and '.join(f'`{name}`' for name in sources) + ' were'} given.",
    )
    require(sources[0] != "sphere" or job.images is not None, "`sphere` needs `images`, photographs of the ball.")
    out = path(job.out)
    if _is_list(out):
        check_file(out, "a list of lights", lambda data: data.startswith(LIST_TITLE.encode()))
    else:
        check_rig_file(out)
    require(sources[0] != "geometry" or job.out is not None, "`geometry` writes a rig file; name it by `out`.")
    return sources[0]


def _base_rig(job: LightsJob) -> Rig:
    """Return the rig of `job.rig`, or an orthographic camera of `px_per_cm` and `image_size` without LEDs."""
    if job.rig is not None:
        for name in ("px_per_cm", "image_size"):
            given = getattr(job, name) is None
            require(given, f"`{name}` and `rig` set the same thing; give one of them.")
        return read_rig(job.rig)
    needed = [name for name in ("px_per_cm", "image_size", "led_height_cm") if getattr(job, name) is None]
    require(
        not needed, f"calibrate lights needs {' and '.join(f'`{name}`' for name in needed)}, or `rig` with a camera."
    )
    assert job.px_per_cm is not None and job.image_size is not None and job.led_height_cm is not None
    rows, columns = _pair(job.image_size, "`image_size`", "rows,columns, such as 2200,3200")
    whole = rows == int(rows) and columns == int(columns) and min(rows, columns) >= 1 and rows * columns <= 2e8
    require(whole, f"`image_size` must be two positive whole numbers, rows,columns, but it is '{job.image_size}'.")
    height = job.led_height_cm * 10.0  # the thesis's camera sits at the height of its LEDs
    return Rig(Camera(job.px_per_cm / 10.0, (int(rows), int(columns)), height_mm=height), ())


def _circle_of(job: LightsJob, rig: Rig) -> Circle:
    side = side_lights(rig.leds)  # they stand on no circle with the others
    places = [led.position_mm for k, led in enumerate(rig.leds) if led.position_mm is not None and k not in side]
    radius, height = job.led_radius_cm, job.led_height_cm
    missing = [
        f"`led_{what}_cm`" for what, value in (("radius", radius), ("height", height)) if value is None and not places
    ]
    require(
        not missing,
        f"calibrate lights needs {' and '.join(missing)}"
        + (", because the rig's LEDs have no positions." if job.rig is not None else "."),
    )
    centre = (0.0, 0.0)
    if job.led_centre_px is not None:
        x, y = _pair(job.led_centre_px, "`led_centre_px`", "x,y in pixels, such as 1575,1174")
        point = plane_points(rig.camera, np.array([[x, y]]))[0]
        centre = (float(point[0]), float(point[1]))
    array = np.array(places).reshape(-1, 3)
    return Circle(
        radius_mm=float(np.hypot(array[:, 0], array[:, 1]).mean()) if radius is None else 10.0 * radius,
        height_mm=float(array[:, 2].mean()) if height is None else 10.0 * height,
        centre_mm=centre,
    )


def _nominal(job: LightsJob, rig: Rig, circle: Circle) -> CalibratedLights:
    """Write a rig whose LEDs are where the drawing has them: white and NIR in turn on the circle, 14 in equal steps."""
    found, facts = {}, []
    for nir, band in enumerate(BANDS):
        for led in range(LEDS_PER_BAND):
            azimuth = math.radians(job.first_azimuth_deg) + 2.0 * math.pi * (led + 0.5 * nir) / LEDS_PER_BAND
            x = circle.centre_mm[0] + circle.radius_mm * math.cos(azimuth)
            y = circle.centre_mm[1] + circle.radius_mm * math.sin(azimuth)
            place = [x, y, circle.height_mm]
            found[band, led] = combine(band, led, np.array([place]), (), circle)
            where = {"direction": found[band, led].direction.tolist(), "position_mm": place}
            facts.append({"band": band, "led": led, **where, **_UNCOMPARED, "verdict": "nominal"})
    origin = plain_json(provenance({"circle": circle, "first_azimuth_deg": job.first_azimuth_deg}))
    rig = rig_of(found, rig, {"method": "geometry", "provenance": origin})
    return _written(rig, path(job.out), {"method": "geometry", "leds": facts})


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


def _of_table(job: LightsJob, rig: Rig, circle: Circle, nail: Nail, progress: Progress) -> CalibratedLights:
    assert job.table is not None
    table = path(job.table)
    data = read_bytes(table, 16_000_000)
    with refusing(f"{table} is not a text file; export the table as CSV in UTF-8."):
        text = data.decode("utf-8-sig")
    tips = read_tips(text, str(table))
    progress("fitting", 0.5)
    hashes = {table.name: hashlib.sha256(data).hexdigest()}
    return _of_tips(job, rig, circle, nail, tips, hashes=hashes)


def _of_images(job: LightsJob, rig: Rig, circle: Circle, nail: Nail, progress: Progress) -> CalibratedLights:
    """Find the tips, go on as with a table; picture and table of them are written even if LEDs are refused."""
    folder, out = path(job.images), path(job.out)
    assert folder is not None
    require(nail.seen == "tip", "the nail's tip is found in photographs; leave `nail_seen` base away.")
    nail = replace(nail, sd_mm=FOUND_SD_MM)  # what is found in photographs is better than what is clicked
    show, table = _beside(path(job.show), out, "_tips.png"), _beside(path(job.tips_out), out, "_tips.csv")
    tips, hashes, lost = tips_of_photos(
        folder, rig.camera, encoding=job.encoding, show=show, table=table, progress=progress
    )
    shown: dict[str, Any] = {
        "show": None if show is None else str(show),
        "tips_out": None if table is None else str(table),
        "shadows_out_of_the_picture": lost,
    }
    try:
        found = _of_tips(job, rig, circle, nail, tips, hashes=hashes)
    except Refused as error:
        seen = "" if show is None else f" ({show} shows what was found)"
        raise Refused(f"{str(error).rstrip('.')}{seen}.", {**error.facts, **shown}) from error
    return replace(found, facts={**found.facts, **shown})


def _beside(given: Path | None, out: Path | None, ending: str) -> Path | None:
    return given if given is not None or out is None else out.with_name(out.stem + ending)


def _of_tips(
    job: LightsJob, rig: Rig, circle: Circle, nail: Nail, tips: Sequence[Tip], *, hashes: Mapping[str, str]
) -> CalibratedLights:
    chosen, found, sentence = find_leds(tips, rig.camera, circle, job, nail)
    facts = {**found, "circle": {"radius_mm": circle.radius_mm, "height_mm": circle.height_mm}}
    if sentence is not None:
        plain: Any = plain_json({**facts, "written": False, "out": None})
        raise Refused(f"{job.table or job.images}: {sentence}", plain)
    origin = provenance(
        {"method": found["method"], "circle": circle, "limit_deg": found["limit_deg"], "nail": nail}, hashes
    )
    kept = ("band", "led", "verdict", "disagreement_deg", "interval_deg", "interval_mm")
    words = [{key: one[key] for key in kept} for one in found["leds"]]
    rig = rig_of(chosen, rig, {"leds": plain_json(words), "provenance": plain_json(origin)})
    drawn = [led_name(rig.leds, k) for k in side_lights(rig.leds)]
    if drawn:
        note = f"the side lights {listed(drawn)} keep the places that the rig file had; a ball measures them"
        facts["warnings"] = [*facts["warnings"], note]
    return _written(rig, path(job.out), facts)


def _of_sphere(job: LightsJob) -> CalibratedLights:
    """Find the light's direction of every image in a folder. With `led_height_cm` LEDs are placed at that height, side
    lights of `rig` as far away as drawn; with a scale the ball lies on the finger plane, camera and LEDs near.
    """
    folder = path(job.images)
    assert folder is not None
    photographs = _photographs(folder)
    paths = [file for _, _, file in photographs]
    rows, columns = read_photo(paths[0]).pixels.shape[:2]
    size = (rows, columns)
    known, near = job.rig is not None or job.px_per_cm is not None, job.led_height_cm is not None
    require(
        known or not near or job.out is None or _is_list(path(job.out)),
        "`led_height_cm` gives places in mm, and a rig file with places needs the scale: give `px_per_cm` and "
        "`image_size`, or `rig`, or write a list of lights (`out` lights.txt).",
    )
    dummy = Camera(1.0, size) if near else camera_without_scale(size)
    base = _base_rig(job) if known else Rig(dummy, ())
    camera_size = base.camera.image_size
    stack, digests = read_stack(paths, camera_size, job.encoding or "linear", upright=True)
    hashes = {file.relative_to(folder).as_posix(): digest for file, digest in digests.items()}
    ball, notes = _ball(job, stack, size, hashes)
    encoding: str | None = job.encoding
    if encoding is None:
        encoding, note = encoding_of(paths, lambda: job.sphere == "grey" and _ball_is_srgb(stack, ball))
        notes += [note] if note else []
    if encoding == "srgb" and job.encoding is None:
        stack, _ = read_stack(paths, camera_size, encoding, upright=True)
    strengths: Array | None = None
    height = None if job.led_height_cm is None else 10.0 * job.led_height_cm
    lying = _Lying.of(base, ball, [f"{band} {led}" for band, led, _ in photographs], lying=known and near)
    if job.sphere == "chrome":
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
    origin = provenance({"sphere": job.sphere, "ball": ball}, hashes)
    said = {**base.provenance, "lights": {"method": job.sphere, "provenance": plain_json(origin)}}
    rig = Rig(base.camera, tuple(leds), said, base.mirrors)
    outline = {"column": ball.column, "row": ball.row, "radius_px": ball.radius_px}
    found = {"method": job.sphere, "ball": outline, "encoding": encoding, "leds": facts}
    return _written(rig, path(job.out), {**found, "notes": notes})


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


def _ball(job: LightsJob, stack: FloatArray, size: tuple[int, int], hashes: dict[str, str]) -> tuple[Ball, list[str]]:
    """The ball within the rim that the photographs (L, H, W) show, near `mask` where there is one, and notes."""
    mask = path(job.mask)
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
    per_radius = 2.0 if job.sphere == "chrome" else 1.0  # a mirror doubles what its normal turns by
    if agreed < _RIM_AGREED:
        small = f", as the ball is smaller than {2 * RIM_PX:g} px" if ball.radius_px < RIM_PX else ""
        return ball, [_NO_RIM.format(small, math.degrees(per_radius / ball.radius_px))]
    aside, larger = math.hypot(ball.column - rim.column, ball.row - rim.row), ball.radius_px - rim.radius_px
    if aside + abs(larger) < max(_RIM_OFF * rim.radius_px, 0.5):
        return ball, []
    turned = math.degrees((per_radius * aside + 0.6 * abs(larger)) / rim.radius_px)
    said = _RIM.format(aside, 100.0 * larger / rim.radius_px)
    return rim, [f"{said}; by the mask the lights would be some {turned:.1f} deg off."]
