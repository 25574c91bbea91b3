"""Where the LEDs are: from a table of shadow tips, photographs of a ball, or the rig's drawing."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import Camera, Led, Rig, write_rig
from splitknit.errors import Refused, refusing, require
from splitknit.files import read_bytes
from splitknit.findings import Finding, worst_first
from splitknit.imaging.response import shading_is_srgb
from splitknit.imaging.view import plane_points
from splitknit.io.light_list import LIST_TITLE, write_light_list
from splitknit.io.photograph_files import natural_order
from splitknit.io.photos import FORMATS, SUFFIXES, encoding_of, read_photo
from splitknit.io.provenance import file_hash, plain_json, provenance
from splitknit.io.targets import check_file, check_rig_file
from splitknit.model import (
    Array,
    FloatArray,
    Progress,
    camera_without_scale,
    no_progress,
    side_lights,
)
from splitknit_rig.calibration.lights import (
    BANDS,
    LEDS_PER_BAND,
    Circle,
    combine,
    led_name,
    led_of_file,
    read_tips,
)
from splitknit_rig.calibration.lights_found import (
    CalibratedLed,
    CalibratedLights,
    LightsOfNail,
    Point,
    Rules,
    lights_of_tips,
    point_of,
    rig_of,
)
from splitknit_rig.calibration.nail_photos import read_stack, tips_of_photos
from splitknit_rig.calibration.parameters import MIN_RIM_PX, NAIL_SD_MM, RIM_AGREED, RIM_OFF
from splitknit_rig.calibration.sphere import (
    Ball,
    ball_of_mask,
    chrome_directions,
    find_balls,
    grey_directions,
    rim_of,
)


def check_lights_file(out: Path | None) -> None:
    """Refuse a file that holds something else than a rig, or a list of lights by its ending."""
    if out is not None and _is_list(out):
        check_file(out, "a list of lights", lambda data: data.startswith(LIST_TITLE.encode()))
    else:
        check_rig_file(out)


def rig_without_leds(
    px_per_cm: float | None, image_size: str | None, led_height_cm: float | None
) -> Rig:
    """An orthographic camera of a scale and size, without LEDs."""
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
    """The circle of the LEDs as it is measured, or as the rig has it."""
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


def lights_as_drawn(
    rig: Rig, circle: Circle, out: Path, *, first_azimuth_deg: float
) -> CalibratedLights:
    """Write a rig whose LEDs are where the drawing has them: white and NIR in turn on the circle,
    14 in equal steps."""
    estimates = {}
    leds = []
    for nir, band in enumerate(BANDS):
        for led in range(LEDS_PER_BAND):
            azimuth = (
                math.radians(first_azimuth_deg) + 2.0 * math.pi * (led + 0.5 * nir) / LEDS_PER_BAND
            )
            x = circle.centre_mm[0] + circle.radius_mm * math.cos(azimuth)
            y = circle.centre_mm[1] + circle.radius_mm * math.sin(azimuth)
            place = (x, y, circle.height_mm)
            estimate = combine(band, led, np.array([place]), circle)
            estimates[band, led] = estimate
            leds.append(
                CalibratedLed(band, led, point_of(estimate.direction), place, verdict="nominal")
            )
    origin = plain_json(provenance({"circle": circle, "first_azimuth_deg": first_azimuth_deg}))
    rig = rig_of(estimates, rig, {"method": "geometry", "provenance": origin})
    lights = CalibratedLights("geometry", tuple(leds), rig, out=out)
    _write(lights)
    return lights


def _is_list(out: Path) -> bool:
    return out.suffix.lower() in (".txt", ".lp")


def _write(lights: CalibratedLights) -> None:
    out = lights.out
    if out is not None and _is_list(out):
        bands = {led.band for led in lights.rig.leds}
        require(
            len(bands) == 1,
            f"'{out}' would hold lights of {len(bands)} bands, and a list is for photographs of"
            " one; name a rig file, such as rig.json.",
        )
        write_light_list(
            lights.rig.leds, out, [led.image or f"LED {led.led}" for led in lights.leds]
        )
    elif out is not None:
        write_rig(lights.rig, out)


def lights_of_table(
    table: Path, rig: Rig, circle: Circle, rules: Rules, out: Path | None
) -> LightsOfNail:
    """LEDs by a table of nail and shadow tips."""
    data = read_bytes(table, 16_000_000)
    with refusing(f"{table} is not a text file; export the table as CSV in UTF-8."):
        text = data.decode("utf-8-sig")
    tips = read_tips(text, str(table))
    hashes = {table.name: hashlib.sha256(data).hexdigest()}
    lights = replace(lights_of_tips(tips, rig, circle, rules, hashes, name=str(table)), out=out)
    _write(lights)
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
    """LEDs by photographs of a nail; picture and table of the tips are written even if LEDs are
    refused."""
    if out is not None:
        show = show or out.with_name(f"{out.stem}_tips.png")
        tips_out = tips_out or out.with_name(f"{out.stem}_tips.csv")
    tips, hashes, lost = tips_of_photos(
        folder, rig.camera, encoding=encoding, show=show, table=tips_out, progress=progress
    )
    # a nail in photographs is located better than one that is clicked
    rules = replace(rules, nail=replace(rules.nail, sd_mm=NAIL_SD_MM))
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
    _write(lights)
    return lights


@dataclass(frozen=True, eq=False)
class LightsOfBall(CalibratedLights):
    """Lights by photographs of a ball."""

    ball: Ball | None = None
    encoding: str = "linear"

    def lines(self) -> list[str]:
        """See :meth:`CalibratedLights.lines`."""
        lines = [f"{len(self.leds)} lights from a {self.method} ball:"]
        for led in self.leds:
            x, y, z = led.direction
            lines.append(f"  {led.image}  towards ({x:+.4f}, {y:+.4f}, {z:+.4f})")
        lines += [f"Please note: {finding}" for finding in self.findings]
        lines.append(self.written_line())
        if self.out is not None:
            lines.append(
                f"Next: splitknit reconstruct --images PHOTOS --lights {self.out} --out RESULT"
            )
        return lines


def lights_of_ball(
    folder: Path,
    kind: str,
    base: Rig | None,
    out: Path | None,
    *,
    encoding: str | None,
    mask: Path | None,
    led_height_cm: float | None,
) -> LightsOfBall:
    """Find the light's direction of every photograph of a ball, ``chrome`` or ``grey`` (`kind`),
    within the white part of the image `mask`. With `led_height_cm` LEDs are placed at that height,
    side lights of the rig `base` as far away as drawn; with a `base` the ball lies on the finger
    plane, camera and LEDs near. `encoding`: as the files state it if None, else linear, or sRGB by
    the ball's shading.
    """
    photographs = _photographs(folder)
    paths = [file for _, _, file in photographs]
    rows, columns = read_photo(paths[0]).pixels.shape[:2]
    near = led_height_cm is not None
    require(
        base is not None or not near or out is None or _is_list(out),
        "`led_height_cm` gives places in mm, and a rig file with places needs the scale: give"
        " `px_per_cm` and `image_size`, or `rig`, or write a list of lights (`out` lights.txt).",
    )
    lies_on_plane = base is not None and near
    if base is None:
        base = Rig(
            Camera(1.0, (rows, columns)) if near else camera_without_scale((rows, columns)), ()
        )
    stack, digests = read_stack(paths, base.camera.image_size, encoding or "linear", upright=True)
    hashes = {file.relative_to(folder).as_posix(): digest for file, digest in digests.items()}
    if mask is None:
        ball, *others = find_balls(stack)
        findings = [_second_ball(ball, second) for second in others[:1]]
    else:
        ball, findings = _ball_within(mask, stack, kind)
        hashes[mask.name] = file_hash(mask)
    assumed = encoding
    if assumed is None:
        assumed, note = encoding_of(paths, lambda: kind == "grey" and _ball_is_srgb(stack, ball))
        findings.append(Finding("assumed-encoding", note))
        if assumed == "srgb":
            stack, _ = read_stack(paths, base.camera.image_size, assumed, upright=True)
    place = BallPlace(np.zeros(3))
    if lies_on_plane:
        place = place_on_plane(base, ball, [f"{band} {led}" for band, led, _ in photographs])
    strengths: list[float] | None = None
    if kind == "chrome":
        directions = chrome_directions(stack, ball, place.eye, place.distances)
    else:
        directions, shading = grey_directions(stack, ball, eye=place.eye, away=place.distances)
        strengths = (shading / shading.mean()).tolist()
    low = [str(file) for file, unit in zip(paths, directions, strict=True) if unit[2] <= 0.05]
    require(
        not low,
        f"{' and '.join(low)}: the light stands beside or behind the ball; correct the mask or the"
        " image.",
    )
    leds = []
    calibrated = []
    for k, ((band, number, file), unit) in enumerate(zip(photographs, directions, strict=True)):
        position = None if led_height_cm is None else place.of_led(k, unit, 10.0 * led_height_cm)
        require(
            position is None or place.is_side_light(k) or not side_lights([Led(band, position)]),
            f"{file} shows a side light, {math.degrees(math.acos(unit[2])):.0f} deg off the axis,"
            " for which `led_height_cm` does not hold; give `rig`, in which it is drawn.",
        )
        strength = None if strengths is None else strengths[k]
        intensity = strength or 1.0
        if position is not None:  # a near light's strength falls with the square of its distance
            intensity *= (float(np.linalg.norm(position)) / 100.0) ** 2
        direction = point_of(unit)
        leds.append(
            Led(band, position, None if position is not None else direction, intensity=intensity)
        )
        calibrated.append(
            CalibratedLed(band, number, direction, position, image=file.name, strength=strength)
        )
    origin = provenance({"sphere": kind, "ball": ball}, hashes)
    lights = {"method": kind, "provenance": plain_json(origin)}
    rig = Rig(base.camera, tuple(leds), {**base.provenance, "lights": lights}, base.mirrors)
    result = LightsOfBall(
        kind,
        tuple(calibrated),
        rig,
        worst_first(findings),
        out=out,
        ball=ball,
        encoding=assumed,
    )
    _write(result)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class BallPlace:
    """A ball on the finger plane, under near LEDs."""

    middle_mm: Array
    radius_mm: float = 1.0
    eye: Array | None = None
    # of the LEDs as drawn: `away` of :mod:`splitknit_rig.calibration.sphere`
    distances: Array | None = None
    drawn: tuple[Led | None, ...] = ()

    def is_side_light(self, k: int) -> bool:
        """Whether the rig has LED k at the side, and all LEDs are drawn."""
        led = self.drawn[k] if self.distances is not None else None
        return led is not None and bool(side_lights([led]))

    def of_led(self, k: int, direction: Array, height_mm: float) -> Point:
        """Where LED k is: at a height, or at the side as far from the ball as it is drawn."""
        far = (height_mm - self.middle_mm[2]) / direction[2]
        if self.distances is not None and self.is_side_light(k):
            far = self.distances[k] * self.radius_mm
        return point_of(self.middle_mm + far * direction)


def place_on_plane(rig: Rig, ball: Ball, names: Sequence[str]) -> BallPlace:
    """A ball on the finger plane under the named LEDs of a rig."""
    camera = rig.camera
    leds = {led_name(rig.leds, k): led for k, led in enumerate(rig.leds)}
    eye = None
    distances = None
    radius = ball.radius_px / camera.px_per_mm
    middle = np.append(plane_points(camera, np.array([[ball.column, ball.row]]))[0], radius)
    if camera.model == "perspective":  # above the finger plane it is seen larger, and further out
        scale = camera.height_mm / (camera.height_mm + radius)
        middle, radius = middle * scale, radius * scale
        eye = (np.array([0.0, 0.0, camera.height_mm]) - middle) / radius
    drawn = tuple(leds.get(name) for name in names)
    places = [led.position_mm for led in drawn if led is not None and led.position_mm is not None]
    if len(places) == len(names):
        distances = np.linalg.norm(np.array(places) - middle, axis=1) / radius
    return BallPlace(middle, radius, eye, distances, drawn)


def _ball_is_srgb(codes: FloatArray, ball: Ball) -> bool | None:
    """Whether the shading of a matt ball of known normals is that of sRGB values: its pixels are
    the lights here."""
    normals = ball.normals(codes.shape[1:])
    inner = np.argwhere(np.nan_to_num(normals[..., 2]) > 0.3)
    rows, columns = inner[:: max(1, len(inner) // 2000)].T
    return shading_is_srgb(codes[:, rows, columns].T, normals[rows, columns], known=True)


def _photographs(folder: Path) -> list[tuple[str, int, Path]]:
    """Band, LED, file of images: ``white_3.png`` names them; others are white ones in the order of
    their numbers."""
    require(
        folder.is_dir(),
        f"{folder} is not a folder; name the folder with the photographs of the ball.",
    )
    files = [
        file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()
    ]
    files = [
        file
        for file in files
        if "mask" not in file.stem.lower() and not file.name.lower().startswith((".", "ambient"))
    ]
    require(bool(files), f"{folder} holds no photographs ({FORMATS}).")
    named = [(*led, file) for file in files if (led := led_of_file(file)) is not None]
    if len(named) == len(files):
        return sorted(named, key=lambda photograph: (BANDS.index(photograph[0]), photograph[1]))
    return [
        ("white", k, file)
        for k, file in enumerate(sorted(files, key=lambda file: natural_order(file.name)))
    ]


def _second_ball(ball: Ball, second: Ball) -> Finding:
    places = [f"column {each.column:.0f}, row {each.row:.0f}" for each in (ball, second)]
    words = (
        f"a second ball stands out at {places[1]}: the lights are those of the one at {places[0]},"
        " as it is larger; cover the second, or give the outline with `mask`."
    )
    return Finding("second-ball", words)


def _ball_within(mask: Path, stack: FloatArray, kind: str) -> tuple[Ball, list[Finding]]:
    """The ball within the rim that the photographs (L, H, W) show near a mask, and findings."""
    pixels = read_photo(mask).pixels
    rows, columns = stack.shape[1:]
    require(
        pixels.shape[:2] == (rows, columns),
        f"{mask} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but the"
        f" photographs have {rows} x {columns}.",
    )
    ball = ball_of_mask(pixels.mean(axis=2) > np.iinfo(pixels.dtype).max / 2)
    rim, agreed = rim_of(stack, ball)
    per_radius = 2.0 if kind == "chrome" else 1.0  # a mirror doubles what its normal turns by
    if agreed < RIM_AGREED:
        is_small = ball.radius_px < MIN_RIM_PX
        small = f", as the ball is smaller than {2 * MIN_RIM_PX:g} px" if is_small else ""
        words = (
            f"the ball's rim is not found in the photographs near its mask{small}, so that nothing"
            " checks it: each pixel of error turns the lights by"
            f" {math.degrees(per_radius / ball.radius_px):.1f} deg; see that the mask ends at the"
            " rim."
        )
        return ball, [Finding("unchecked-mask", words)]
    offset = math.hypot(ball.column - rim.column, ball.row - rim.row)
    larger = ball.radius_px - rim.radius_px
    if offset + abs(larger) < max(RIM_OFF * rim.radius_px, 0.5):
        return ball, []
    turned = math.degrees((per_radius * offset + 0.6 * abs(larger)) / rim.radius_px)
    words = (
        f"the mask lies {offset:.1f} px beside the ball's rim in the photographs, and its radius is"
        f" {100.0 * larger / rim.radius_px:+.1f} % off: the rim is used; by the mask the lights"
        f" would be some {turned:.1f} deg off."
    )
    return rim, [Finding("corrected-mask", words)]
