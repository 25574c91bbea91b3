"""Where the LEDs are: from a table of shadow tips, photographs of a ball, or the rig's drawing."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.light_table import BANDS, LEDS_PER_BAND, Tip, read_tips
from splitknit.calibration.lights import Circle, combine
from splitknit.calibration.lights_found import (
    CalibratedLed,
    CalibratedLights,
    LightsJob,
    find_leds,
    rig_of,
)
from splitknit.calibration.nail_photos import FOUND_SD_MM, read_stack, tips_of_photos
from splitknit.calibration.sphere import Ball, ball_of_mask, chrome_directions, find_ball, grey_directions
from splitknit.errors import Refused, read_bytes, refusing, require
from splitknit.imaging.band import shading_is_srgb
from splitknit.imaging.view import plane_points
from splitknit.io.light_list import LIST_TITLE, write_light_list
from splitknit.io.photos import FORMATS, SUFFIXES, encoding_of, read_photo
from splitknit.io.provenance import file_hash, plain_json, provenance
from splitknit.io.rig import read_rig, write_rig
from splitknit.io.targets import check_file, check_rig_file
from splitknit.model import Camera, Led, Progress, Rig, camera_without_scale, no_progress


def lights_to_rig(job: LightsJob, progress: Progress = no_progress) -> CalibratedLights:
    """Find the LEDs, and write the rig file where one is named. Raises BadInput naming the option or file at fault, and
    Refused, whose facts hold what was found, if that is not good enough.
    """
    source = _checked_source(job)
    if source == "sphere":
        return _of_sphere(job)
    rig = _base_rig(job)
    circle = _circle_of(job, rig)
    if source == "geometry":
        return _nominal(job, rig, circle)
    return _of_table(job, rig, circle, progress) if source == "table" else _of_images(job, rig, circle, progress)


def _checked_source(job: LightsJob) -> str:
    """Return ``table``, ``images``, ``sphere`` or ``geometry``."""
    images = job.images is not None and job.sphere is None
    asked = {
        "table": job.table is not None,
        "images": images,
        "sphere": job.sphere is not None,
        "geometry": bool(job.geometry),
    }
    sources = [name for name, wanted in asked.items() if wanted]
    require(
        len(sources) == 1,
        f"calibrate lights needs one of `table`, `images`, `sphere` with `images`, and `geometry`, but "
        f"{'none was' if not sources else ' and '.join(f'`{name}`' for name in sources) + ' were'} given.",
    )
    require(sources[0] != "sphere" or job.images is not None, "`sphere` needs `images`, photographs of the ball.")
    if _is_list(job.out):
        check_file(job.out, "a list of lights", lambda data: data.startswith(LIST_TITLE.encode()))
    else:
        check_rig_file(job.out)
    require(sources[0] != "geometry" or job.out is not None, "`geometry` writes a rig file; name it by `out`.")
    return sources[0]


def _base_rig(job: LightsJob) -> Rig:
    """Return the rig of ``--rig``, or an orthographic camera of ``--px-per-cm`` and ``--image-size`` without LEDs."""
    if job.rig is not None:
        for name in ("px_per_cm", "image_size"):
            given = getattr(job, name) is None
            require(given, f"`{name}` and `rig` set the same thing; give one of them.")
        return read_rig(job.rig)
    needed = [name for name in ("px_per_cm", "image_size", "led_height_cm") if getattr(job, name) is None]
    require(
        not needed,
        f"calibrate lights needs {' and '.join(f'`{name}`' for name in needed)}, or `rig` with a camera.",
    )
    assert job.px_per_cm is not None and job.image_size is not None and job.led_height_cm is not None
    rows, columns = _pair(job.image_size, "`image_size`", "rows,columns, such as 2200,3200")
    whole = rows == int(rows) and columns == int(columns) and min(rows, columns) >= 1 and rows * columns <= 2e8
    require(whole, f"`image_size` must be two positive whole numbers, rows,columns, but it is '{job.image_size}'.")
    height = job.led_height_cm * 10.0  # the thesis's camera sits at the height of its LEDs
    return Rig(Camera(job.px_per_cm / 10.0, (int(rows), int(columns)), height_mm=height), ())


def _circle_of(job: LightsJob, rig: Rig) -> Circle:
    """Return the LED circle: of the options, and else of the rig's LEDs."""
    places = [led.position_mm for led in rig.leds if led.position_mm is not None]
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
    origin = plain_json(provenance({"circle": circle, "first_azimuth_deg": job.first_azimuth_deg}))
    rig = rig_of(found, rig, {"method": "geometry", "provenance": origin})
    return _written(rig, job.out, {"method": "geometry", "leds": facts})


def _is_list(out: Path | None) -> bool:
    """Whether a list of lights is to be written, as ``reconstruct --lights`` reads it, instead of a rig file."""
    return out is not None and out.suffix.lower() in (".txt", ".lp")


def _written(rig: Rig, out: Path | None, facts: Mapping[str, Any]) -> CalibratedLights:
    """Write the rig, or a list of its lights, where a name is given."""
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
    plain = _plain({**facts, "written": out is not None, "out": None if out is None else str(out)})
    leds = tuple(_led_of(one) for one in plain["leds"])
    return CalibratedLights(plain["method"], leds, rig, (*plain.get("warnings", ()), *plain.get("notes", ())), plain)


def _led_of(facts: Mapping[str, Any]) -> CalibratedLed:
    x, y, z = facts["direction"]
    place = facts["position_mm"]
    return CalibratedLed(
        facts["band"], facts["led"], (x, y, z), None if place is None else (place[0], place[1], place[2]),
        facts["disagreement_deg"], facts["verdict"], facts["kept"], facts.get("interval_deg"), facts.get("interval_mm"),
    )  # fmt: skip


def _plain(value: Mapping[str, Any]) -> dict[str, Any]:
    result = plain_json(value)
    assert isinstance(result, dict)
    return dict(result)


def _pair(text: str, name: str, form: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    sound = len(values) == 2 and all(math.isfinite(value) and abs(value) < 1e6 for value in values)
    require(sound, f"{name} must be {form}, but it is '{text}'.")
    return values[0], values[1]


def _of_table(job: LightsJob, rig: Rig, circle: Circle, progress: Progress) -> CalibratedLights:
    """Calibrate from a typed table of nail and shadow tips."""
    assert job.table is not None
    data = read_bytes(job.table, 16_000_000)
    with refusing(f"{job.table} is not a text file; export the table as CSV in UTF-8."):
        text = data.decode("utf-8-sig")
    tips = read_tips(text, str(job.table))
    progress("fitting", 0.5)
    hashes = {job.table.name: hashlib.sha256(data).hexdigest()}
    return _of_tips(job, rig, circle, tips, hashes)


def _of_images(job: LightsJob, rig: Rig, circle: Circle, progress: Progress) -> CalibratedLights:
    """Find the tips, go on as with a table; picture and table of them are written even if LEDs are refused."""
    folder, nail = job.images, job.settings.nail
    assert folder is not None
    require(nail.nail_seen == "tip", "the nail's tip is found in photographs; leave `nail_seen` base away.")
    # what is found in photographs is better than what is clicked
    better = replace(nail, nail_sd_mm=min(nail.nail_sd_mm, FOUND_SD_MM))
    job = replace(job, settings=replace(job.settings, nail=better))
    show, table = _beside(job.show, job.out, "_tips.png"), _beside(job.tips_out, job.out, "_tips.csv")
    tips, hashes, lost = tips_of_photos(
        folder, rig.camera, encoding=job.encoding, show=show, table=table, progress=progress
    )
    shown: dict[str, Any] = {
        "show": None if show is None else str(show),
        "tips_out": None if table is None else str(table),
        "shadows_out_of_the_picture": lost,
    }
    try:
        found = _of_tips(job, rig, circle, tips, hashes)
    except Refused as error:
        seen = "" if show is None else f" ({show} shows what was found)"
        raise Refused(f"{str(error).rstrip('.')}{seen}.", {**error.facts, **shown}) from error
    return replace(found, facts={**found.facts, **shown})


def _beside(given: Path | None, out: Path | None, ending: str) -> Path | None:
    return given if given is not None or out is None else out.with_name(out.stem + ending)


def _of_tips(
    job: LightsJob, rig: Rig, circle: Circle, tips: Sequence[Tip], hashes: Mapping[str, str]
) -> CalibratedLights:
    """Find the LEDs, refuse or write."""
    chosen, found, sentence = find_leds(tips, rig.camera, circle, job)
    facts = {**found, "circle": {"radius_mm": circle.radius_mm, "height_mm": circle.height_mm}}
    if sentence is not None:
        raise Refused(f"{job.table or job.images}: {sentence}", _plain({**facts, "written": False, "out": None}))
    origin = provenance({"method": found["method"], "circle": circle, "lights": job.settings}, hashes)
    kept = ("band", "led", "verdict", "disagreement_deg", "interval_deg", "interval_mm")
    words = [{key: one[key] for key in kept} for one in found["leds"]]
    rig = rig_of(chosen, rig, _plain({"leds": words, "provenance": origin}))
    return _written(rig, job.out, facts)


def _of_sphere(job: LightsJob) -> CalibratedLights:
    """Find the light's direction of every image in a folder; no scale is needed. With ``--led-height-cm`` LEDs are
    placed at that height, as a near light must be.
    """
    assert job.images is not None
    photographs = _photographs(job.images)
    paths = [path for _, _, path in photographs]
    rows, columns = read_photo(paths[0]).pixels.shape[:2]
    size = (rows, columns)
    known = job.rig is not None or job.px_per_cm is not None
    near = job.led_height_cm is not None
    require(
        known or not near or job.out is None or _is_list(job.out),
        "`led_height_cm` gives places in mm, and a rig file with places needs the scale: give `px_per_cm` and "
        "`image_size`, or `rig`, or write a list of lights (`out` lights.txt).",
    )
    dummy = Camera(1.0, size) if near else camera_without_scale(size)
    base = _base_rig(job) if known else Rig(dummy, ())
    hashes: dict[str, str] = {}
    camera_size = base.camera.image_size
    stack, digests = read_stack(paths, camera_size, job.encoding or "linear", upright=True)
    hashes |= {path.relative_to(job.images).as_posix(): digest for path, digest in digests.items()}
    ball = _ball(job.mask, stack, size, hashes)
    encoding, note = job.encoding, ""
    if encoding is None:
        encoding, note = encoding_of(paths, lambda: job.sphere == "grey" and _ball_is_srgb(stack, ball))
    if encoding == "srgb" and job.encoding is None:
        stack, _ = read_stack(paths, camera_size, encoding, upright=True)
    strengths: NDArray[np.float64] | None = None
    if job.sphere == "chrome":
        directions = chrome_directions(stack, ball)
    else:
        directions, strengths = grey_directions(stack, ball)
    low = [str(path) for path, unit in zip(paths, directions, strict=True) if unit[2] <= 0.05]
    require(not low, f"{' and '.join(low)}: the light stands beside or behind the ball; correct the mask or the image.")
    height = None if job.led_height_cm is None else 10.0 * job.led_height_cm
    facts, leds = [], []
    for k, ((band, led, path), direction) in enumerate(zip(photographs, directions, strict=True)):
        unit = (float(direction[0]), float(direction[1]), float(direction[2]))
        place = None if height is None else (height * unit[0] / unit[2], height * unit[1] / unit[2], height)
        strength = 1.0 if strengths is None else float(strengths[k] / strengths.mean())
        # a near light's strength falls with the square of its distance
        intensity = strength if place is None else strength * (float(np.linalg.norm(place)) / 100.0) ** 2
        leds.append(Led(band, position_mm=place, direction=unit if place is None else None, intensity=intensity))
        facts.append(
            {
                "band": band,
                "led": led,
                "image": path.name,
                "direction": list(unit),
                "position_mm": None if place is None else list(place),
                "strength": None if strengths is None else strength,
                "disagreement_deg": None,
                "verdict": "unchecked",
                "kept": True,
            }
        )
    origin = provenance({"sphere": job.sphere, "ball": ball}, hashes)
    said = {**base.provenance, "lights": {"method": job.sphere, "provenance": plain_json(origin)}}
    rig = Rig(base.camera, tuple(leds), said, base.mirrors)
    outline = {"column": ball.column, "row": ball.row, "radius_px": ball.radius_px}
    found = {"method": job.sphere, "ball": outline, "encoding": encoding, "leds": facts}
    return _written(rig, job.out, {**found, "notes": [note] if note else []})


def _ball_is_srgb(codes: NDArray[np.float32], ball: Ball) -> bool:
    """Whether the shading of a matt ball of known normals is that of sRGB values: its pixels are the lights here."""
    normals = ball.normals(codes.shape[1:])
    inner = np.argwhere(np.nan_to_num(normals[..., 2]) > 0.3)
    rows, columns = inner[:: max(1, len(inner) // 2000)].T
    return shading_is_srgb(codes[:, rows, columns].T, normals[rows, columns])


def _photographs(folder: Path) -> list[tuple[str, int, Path]]:
    """Band, LED, file of images: ``white_3.png`` names them; others are white ones in the order of their numbers."""
    require(folder.is_dir(), f"{folder} is not a folder; name the folder with the photographs of the ball.")
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    files = [path for path in files if not path.name.startswith(".")]
    files = [path for path in files if "mask" not in path.stem.lower() and not path.stem.lower().startswith("ambient")]
    require(bool(files), f"{folder} holds no photographs ({FORMATS}).")
    named = {path: re.fullmatch(r"(white|nir)[_.-]?(\d+)", path.stem.lower()) for path in files}
    if all(match is not None for match in named.values()):
        found = [(match.group(1), int(match.group(2)), path) for path, match in named.items() if match]
        return sorted(found, key=lambda one: (BANDS.index(one[0]), one[1]))
    files.sort(key=lambda path: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)])
    return [("white", k, path) for k, path in enumerate(files)]


def _ball(mask: Path | None, stack: NDArray[np.float32], size: tuple[int, int], hashes: dict[str, str]) -> Ball:
    if mask is None:
        return find_ball(stack)
    pixels = read_photo(mask).pixels
    require(
        pixels.shape[:2] == size,
        f"{mask} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but the photographs have "
        f"{size[0]} x {size[1]}.",
    )
    hashes[mask.name] = file_hash(mask)
    return ball_of_mask(pixels.mean(axis=2) > np.iinfo(pixels.dtype).max / 2)
