"""Positions of lights from photographs of balls: from highlights on chrome and the brightness of
flat matt ground beside them, or from the shading of matt grey balls."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit import Camera, Led, Rig
from splitknit.diagnosis.lights import CERTAIN
from splitknit.errors import refusing, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.imaging.pixels import srgb_light
from splitknit.imaging.view import plane_points
from splitknit.io.photograph_files import natural_order, some_of
from splitknit.io.photos import FORMATS, SUFFIXES, encoding_of, read_photo
from splitknit.io.provenance import file_hash, plain_json, provenance
from splitknit.model import Array, BoolArray, FloatArray, Point, camera_without_scale
from splitknit.nominal import side_lights
from splitknit.photometric.forward import matt_misfit
from splitknit.photometric.places import (
    CAMERA_HEIGHT,
    GROUND_POINTS,
    BallGlints,
    LightPlaces,
    MattGround,
    fit_places,
    like_ground,
)
from splitknit_rig.calibration.light_sources import is_list, rig_without_leds, write_lights
from splitknit_rig.calibration.lights import (
    BANDS,
    CalibratedLed,
    led_name,
    led_of_file,
    point_of,
)
from splitknit_rig.calibration.lights_found import CalibratedLights
from splitknit_rig.calibration.nail_photos import image_of_size, read_stack
from splitknit_rig.calibration.sphere import (
    MIN_RIM_PX,
    Ball,
    balls_of_mask,
    chrome_directions,
    find_ball,
    glints_of,
    grey_directions,
    rim_of,
)


@dataclass(frozen=True, eq=False)
class LightsOfBall(CalibratedLights):
    """Lights measured with photographs of balls."""

    balls: tuple[Ball, ...] = ()
    encoding: str = "linear"
    left_out: tuple[str, ...] = ()
    """Photographs whose light could not be measured."""
    fit: Mapping[str, Any] | None = None
    """Of places: ``camera_height_mm``, ``dome_radius_mm``, ``glints_rms_px``, ``ground_misfit``,
    ``lobe_exponent``."""

    def lines(self) -> list[str]:
        """See :meth:`CalibratedLights.lines`."""
        count = "a" if len(self.balls) == 1 else len(self.balls)
        lines = [f"{len(self.leds)} lights from {count} {self.method} ball{'s' * (count != 'a')}:"]
        for led in self.leds:
            if led.interval_mm is not None and led.position_mm is not None:
                x, y, z = led.position_mm
                place = f"at ({x:+.1f}, {y:+.1f}, {z:+.1f}) +-{led.interval_mm:.1f} mm"
            else:
                x, y, z = led.direction
                place = f"towards ({x:+.4f}, {y:+.4f}, {z:+.4f})"
            lines.append(f"  {led.image}  {place}")
        if self.fit is not None:
            lines.append(
                f"They lie on a dome of {self.fit['dome_radius_mm']:.0f} mm radius, the camera"
                f" {self.fit['camera_height_mm']:.0f} mm above the ground; the glints lie"
                f" {self.fit['glints_rms_px']:.2f} px (rms) off."
            )
        lines += [f"Please note: {finding}" for finding in self.findings]
        lines.append(self.written_line())
        if self.out is not None:
            scale = f" --px-per-mm {self.rig.camera.px_per_mm:g}" if self.fit else ""
            lines.append(
                f"Next: splitknit reconstruct --images PHOTOS --lights {self.out}{scale} --out"
                " RESULT"
            )
        return lines


@dataclass(frozen=True, slots=True)
class BallPhotographs:
    """Photographs of balls, and what is known of them."""

    folder: Path
    kind: str
    """``chrome`` or ``grey``."""
    outlines: tuple[Ball, ...] = ()
    mask: Path | None = None
    """White where the balls are; with `outlines`, where the object is."""
    ground: bool = False
    """Whether the ground beside the balls is known to be flat and matt."""
    encoding: str | None = None
    led_height_cm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Lights of photographs; NaN or zero if a photograph shows none."""

    directions: Array
    """(L, 3)."""
    strengths: Array | None = None
    places_mm: Array | None = None
    """(L, 3), and (L,) half widths of their 95 % intervals."""
    interval_mm: Array | None = None
    fit: Mapping[str, Any] | None = None

    def is_low(self) -> BoolArray:
        """(L,) whether a light is too low to be used, or shows no highlight."""
        if self.places_mm is not None:
            return ~(self.places_mm[:, 2] >= 1.0)  # mm, the lowest of a list of lights
        return ~(self.directions[:, 2] > 0.05)


def _by_fit(
    stack: FloatArray, balls: Sequence[Ball], camera: Camera, ground: MattGround | None
) -> tuple[_Measured, list[Finding]]:
    """Positions from highlights and ground, or directions from the picture's middle if the scale or
    the distances are unknown; and findings."""
    fit = places_of_lights(stack, balls, camera, ground)
    distances = np.linalg.norm(fit.places_mm, axis=1)
    directions = fit.places_mm / distances[:, None]
    findings = _doubts(fit)
    if not camera.scale_known:
        return _Measured(directions), findings
    require(
        fit.dome_mm[3] < _LARGEST_DOME * fit.eye_mm[2],
        f"balls and ground put the lights on a dome of {fit.dome_mm[3]:.0f} mm radius and the"
        f" camera {fit.eye_mm[2]:.0f} mm above the ground: correct the outlines and the scale, or"
        " leave out `ground` where it is not flat and matt.",
    )
    interval, distance = float(np.nanmedian(fit.interval_mm)), float(np.nanmedian(distances))
    if interval > CERTAIN * distance:
        words = (
            f"the glints leave the lights' distances open ({distance:.0f} +- {interval:.0f} mm):"
            " these are directions; places need flat matt ground beside the balls (`ground`), or"
            " two balls and a camera whose place is known (`rig`)."
        )
        return _Measured(directions), [*findings, Finding("uncertain-distances", words)]
    facts = {
        "camera_height_mm": float(fit.eye_mm[2]),
        "dome_radius_mm": float(fit.dome_mm[3]),
        "glints_rms_px": fit.glint_px,
        "ground_misfit": fit.ground_misfit,
        "lobe_exponent": fit.lobe_exponent,
    }
    return _Measured(directions, None, fit.places_mm, fit.interval_mm, facts), findings


def lights_of_ball(shown: BallPhotographs, base: Rig, out: Path | None) -> LightsOfBall:
    """Find the light of every photograph of balls.

    Highlights on chrome give positions if the scale is known (the camera of `base`), and directions
    from the picture's middle if it is not, or if distances cannot be determined; shading on grey
    gives directions. With `led_height_cm` LEDs are placed at that height, and side lights of the
    rig `base` at their drawn distance; the ball is then taken to lie on the finger plane, near
    camera and LEDs. `encoding`: if None, as the files state it; if they do not, linear or sRGB,
    whichever fits the ball's shading.
    """
    folder, kind, camera = shown.folder, shown.kind, base.camera
    photographs = photographs_of_balls(folder)
    paths = [file for _, _, file in photographs]
    near = shown.led_height_cm is not None
    require(
        camera.scale_known or not near or out is None or is_list(out),
        "`led_height_cm` gives places in mm, and a rig file with places needs the scale: give"
        " `px_per_cm`, or `rig`, or write a list of lights (`out` lights.txt).",
    )
    fitted = not near and kind == "chrome"
    require(
        not shown.ground or (fitted and camera.scale_known),
        "`ground` goes with chrome balls and the scale, `px_per_cm` or `rig`, without"
        " `led_height_cm`.",
    )
    stack, digests = read_stack(paths, camera.image_size, shown.encoding or "linear", upright=True)
    hashes = {file.relative_to(folder).as_posix(): digest for file, digest in digests.items()}
    white = None
    if shown.mask is not None:
        white = _read_mask(shown.mask, camera.image_size)
        hashes[shown.mask.name] = file_hash(shown.mask)
    checked = not (fitted and camera.scale_known)
    balls, findings = _outlined(stack, shown, white, checked=checked)
    require(
        len(balls) == 1 or (kind == "chrome" and not near),
        "a grey ball, or one with `led_height_cm`, is measured alone; give the outline of one.",
    )
    encoding = shown.encoding
    if encoding is None:
        likely = _likely_encoding(stack, balls[0]) if kind == "grey" else "linear"
        encoding, note = encoding_of(paths, likely)
        findings.append(Finding("assumed-encoding", note))
        if encoding == "srgb":
            stack, _ = read_stack(paths, camera.image_size, encoding, upright=True)
    place = BallPlace(np.zeros(3))
    if near and camera.scale_known:
        place = place_on_plane(base, balls[0], [f"{band} {led}" for band, led, _ in photographs])
    if fitted:
        covered = white if shown.outlines else None
        ground = ground_of(stack, balls, camera, covered) if shown.ground else None
        measured, doubts = _by_fit(stack, balls, camera, ground)
        findings += doubts
    elif kind == "chrome":
        rays = chrome_directions(stack, balls[0], place.eye, place.distances)
        measured = _Measured(rays)
    else:
        shading = grey_directions(stack, balls[0], eye=place.eye, away=place.distances)
        measured = _Measured(shading[0], shading[1] / shading[1].mean())
    low = measured.is_low()
    left_out = tuple(file.name for file, is_low in zip(paths, low, strict=True) if is_low)
    require(
        not left_out or (kind == "chrome" and not low.all()),
        f"{some_of(left_out)}: the light stands beside or behind the ball; correct the outline or"
        " the image.",
    )
    require(
        bool(shown.outlines) or white is not None or 2 * len(left_out) < len(low),
        f"the largest round thing, at x {balls[0].column:.0f}, y {balls[0].row:.0f} and of radius"
        f" {balls[0].radius_px:.0f} px, shows a glint of {len(low) - len(left_out)} of {len(low)}"
        " lights, and seems to be no ball; give the ball's outline, `ball`.",
    )
    leds = [
        _led(k, photographs[k], measured, place, shown.led_height_cm)
        for k in np.flatnonzero(~low).tolist()
    ]
    of_rig, calibrated = zip(*leds, strict=True)
    findings += _notes(left_out, out, of_rig)
    origin = provenance({"sphere": kind, "balls": balls, "ground": shown.ground}, hashes)
    camera = replace(camera, scale_known=camera.scale_known or near)  # of the list it is not read
    rig = Rig(
        camera,
        of_rig,
        {**base.provenance, "lights": {"method": kind, "provenance": plain_json(origin)}},
        base.mirrors,
    )
    result = LightsOfBall(
        kind,
        calibrated,
        rig,
        worst_first(findings),
        out=out,
        balls=tuple(balls),
        encoding=encoding,
        left_out=left_out,
        fit=measured.fit,
    )
    write_lights(result, named=bool(left_out))
    return result


def _notes(left_out: Sequence[str], out: Path | None, leds: Sequence[Led]) -> Iterator[Finding]:
    """Finding that names the photographs missing from the list of lights."""
    if left_out:
        words = (
            f"left out, as no ball shows a glint of their light on its front: {some_of(left_out)};"
            " the list names the photographs that stay."
        )
        yield Finding("lights-left-out", words, files=tuple(left_out))
    near = leds[0].position_mm is not None
    if near and out is not None and out.suffix.lower() == ".lp":
        words = "an .lp file holds directions, from the picture's middle: the distances are lost."
        yield Finding("directions-only", words)


def _led(
    k: int,
    photograph: tuple[str, int, Path],
    measured: _Measured,
    place: BallPlace,
    led_height_cm: float | None,
) -> tuple[Led, CalibratedLed]:
    """The light of photograph k."""
    band, number, file = photograph
    unit = measured.directions[k]
    strength = None if measured.strengths is None else float(measured.strengths[k])
    intensity = strength or 1.0
    position = None
    interval = None
    if measured.places_mm is not None and measured.interval_mm is not None:
        position = point_of(measured.places_mm[k])
        interval = float(measured.interval_mm[k])
    if led_height_cm is not None:
        position = place.of_led(k, unit, 10.0 * led_height_cm)
        require(
            k in place.at_side or not side_lights([Led(band, position)]),
            f"{file} shows a side light, {math.degrees(math.acos(unit[2])):.0f} deg off the axis,"
            " for which `led_height_cm` does not hold; give `rig`, in which it is drawn.",
        )
        # a near light's strength falls with the square of its distance
        intensity *= (float(np.linalg.norm(position)) / 100.0) ** 2
    direction = point_of(unit)
    led = Led(
        band,
        position,
        None if position is not None else direction,
        intensity,
        (measured.fit or {}).get("lobe_exponent", 0.0),
    )
    return led, CalibratedLed(
        band,
        number,
        direction,
        position,
        interval_mm=interval,
        image=file.name,
        strength=strength,
    )


_FAR = 100.0
"""Factor by which the camera of a single ball without a scale is moved away, so that its rays are
parallel. Chosen on: a photographed chrome ball."""
_BALL_SURROUNDINGS = 2.0  # radii, with its holder and deepest shadow


def places_of_lights(
    stack: FloatArray, balls: Sequence[Ball], camera: Camera, ground: MattGround | None
) -> LightPlaces:
    """Places of the lights of photographs (L, H, W) that glint on one ball or more; NaN for the
    others."""
    glints = np.stack([glints_of(stack, ball) for ball in balls])
    glint = np.isfinite(glints[..., 0]).any(axis=0)
    require(
        glint.any(), "no photograph shows a glint on a ball; correct the outlines of the balls."
    )
    seen = [
        BallGlints(_on_ground(ball, camera), plane_points(camera, pixels[glint]))
        for ball, pixels in zip(balls, glints, strict=True)
    ]
    if ground is not None:
        ground = MattGround(ground.points_mm, ground.values[glint], ground.usable[glint])
    height, certain = camera.height_mm, 0.02
    if camera.model == "orthographic":
        height, certain = CAMERA_HEIGHT * max(camera.image_size) / camera.px_per_mm, 0.3
        if not camera.scale_known and len(balls) == 1:
            height *= _FAR
    places = fit_places(
        seen,
        camera.px_per_mm,
        ground=ground,
        eye_mm=(0.0, 0.0, height),
        eye_sd_mm=(0.1 * height, 0.1 * height, certain * height),
    )
    everywhere = np.full((len(stack), 3), np.nan)
    intervals = np.full(len(stack), np.nan)
    everywhere[glint], intervals[glint] = places.places_mm, places.interval_mm
    return replace(places, places_mm=everywhere, interval_mm=intervals)


def _on_ground(ball: Ball, camera: Camera) -> tuple[float, float, float]:
    x, y = plane_points(camera, np.array([[ball.column, ball.row]]))[0].tolist()
    return x, y, ball.radius_px / camera.px_per_mm


def ground_of(
    stack: FloatArray, balls: Sequence[Ball], camera: Camera, covered: BoolArray | None
) -> MattGround:
    """Points of the ground in photographs (L, H, W): pixels about as bright as most of the picture,
    away from the balls and from pixels that are `covered` (H, W)."""
    step = int(np.sqrt(stack[0].size / GROUND_POINTS)) + 1
    rows, columns = (
        axis.ravel() for axis in np.mgrid[: stack.shape[1] : step, : stack.shape[2] : step]
    )
    smooth = (cv2.GaussianBlur(image, (0, 0), step / 10.0) for image in stack)
    values = np.array([image[rows, columns] for image in smooth], dtype=np.float64)
    pixels = np.column_stack([columns, rows])
    on_ground = like_ground(values, pixels, camera.image_size)
    for ball in balls:
        away = np.hypot(columns - ball.column, rows - ball.row)
        on_ground &= away > _BALL_SURROUNDINGS * ball.radius_px
    if covered is not None:
        on_ground &= ~covered[rows, columns]
    require(int(on_ground.sum()) >= 50, "no ground is left beside the balls; leave out `ground`.")
    return MattGround.of(plane_points(camera, pixels[on_ground]), values[:, on_ground])


_LARGEST_DOME = 3.0  # radius over the camera's height; 1.0 on a home-made dome
_FAR_GLINT_PX = 0.5  # rms; 0.24 to 0.27 on photographed balls
_GLOSSY_GROUND = 0.1  # relative; 0.02 on a matt plate of a renderer, 0.3 on felt


def _doubts(fit: LightPlaces) -> list[Finding]:
    """Findings that make the positions of lights doubtful."""
    findings = []
    if fit.glint_px > _FAR_GLINT_PX:
        words = (
            f"the glints lie {fit.glint_px:.1f} px (rms) from where one place for each light puts"
            " them: check the outlines of the balls and the scale."
        )
        findings.append(Finding("glints-disagree", words, Severity.DOUBT))
    if fit.ground_misfit is not None and fit.ground_misfit > _GLOSSY_GROUND:
        words = (
            f"the ground's light departs by {100 * fit.ground_misfit:.0f} % from a flat matt"
            " ground's: distances may be further off than their intervals say."
        )
        findings.append(Finding("ground-departs", words))
    return findings


@dataclass(frozen=True, slots=True, eq=False)
class BallPlace:
    """A ball on the finger plane, under near LEDs."""

    middle_mm: Array
    radius_mm: float = 1.0
    eye: Array | None = None
    # of the LEDs, where all are drawn: `away` of :mod:`splitknit_rig.calibration.sphere`
    distances: Array | None = None
    at_side: frozenset[int] = frozenset()
    """Which LEDs are side lights."""

    def of_led(self, k: int, direction: Array, height_mm: float) -> Point:
        """Position of LED k: at the stated height or, for a side light, at its drawn distance from
        the ball."""
        far = (height_mm - self.middle_mm[2]) / direction[2]
        if self.distances is not None and k in self.at_side:
            far = self.distances[k] * self.radius_mm
        return point_of(self.middle_mm + far * direction)


def place_on_plane(rig: Rig, ball: Ball, names: Sequence[str]) -> BallPlace:
    """A ball on the finger plane under the named LEDs of a rig."""
    camera = rig.camera
    leds = {led_name(rig.leds, k): led for k, led in enumerate(rig.leds)}
    eye = None
    middle = np.array(_on_ground(ball, camera))
    radius = float(middle[2])
    if camera.model == "perspective":  # above the finger plane it is seen larger, and further out
        scale = camera.height_mm / (camera.height_mm + radius)
        middle, radius = middle * scale, radius * scale
        eye = (np.array([0.0, 0.0, camera.height_mm]) - middle) / radius
    drawn = [leds[name] for name in names if name in leds and leds[name].position_mm is not None]
    if len(drawn) < len(names):
        return BallPlace(middle, radius, eye)
    places = np.array([led.position_mm for led in drawn])
    distances = np.linalg.norm(places - middle, axis=1) / radius
    return BallPlace(middle, radius, eye, distances, frozenset(side_lights(drawn)))


def _likely_encoding(codes: FloatArray, ball: Ball) -> str:
    """Encoding of the stored values, judged by the shading of a matt ball of known normals. The
    forward model is used with exchanged roles: pixels as lights, lights as normals."""
    normals = ball.normals(codes.shape[1:])
    inner = np.argwhere(np.nan_to_num(normals[..., 2]) > 0.3)
    rows, columns = inner[:: max(1, len(inner) // 2000)].T
    values = codes[:, rows, columns].T
    linear, srgb = (
        matt_misfit(np.where(values < 0.97, light, 0.0), normals[rows, columns].astype(np.float32))
        for light in (values, srgb_light(values))
    )
    return "linear" if linear < srgb else "srgb"


def photographs_of_balls(folder: Path) -> list[tuple[str, int, Path]]:
    """Band, LED and file of images. ``white_3.png`` states band and LED; other names are white LEDs
    in the order of their numbers."""
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
    require(files, f"{folder} holds no photographs ({FORMATS}).")
    named = [(*led, file) for file in files if (led := led_of_file(file)) is not None]
    if len(named) == len(files):
        return sorted(named, key=lambda photograph: (BANDS.index(photograph[0]), photograph[1]))
    return [
        ("white", k, file)
        for k, file in enumerate(sorted(files, key=lambda file: natural_order(file.name)))
    ]


_RIM_AGREED = 0.5
"""Fraction of all rays that must agree on a ball's rim: 0.53 on a photographed chrome ball that is
half dark on dark, 0.55 and more on drawn ones, up to 0.40 where there is nothing but noise. Chosen
on: real photographs (a chrome ball; drawn balls beside it). Range: 0.40 to 0.53."""


def rig_of_balls(shown: BallPhotographs, px_per_cm: float | None, image_size: str | None) -> Rig:
    """A rig without LEDs, for photographs of balls, with or without a known scale."""
    rows, columns = read_photo(photographs_of_balls(shown.folder)[0][2]).pixels.shape[:2]
    if px_per_cm is not None:
        size = image_size or f"{rows},{columns}"
        return rig_without_leds(px_per_cm, size, shown.led_height_cm or 14.0)
    return Rig(camera_without_scale((rows, columns)), ())


def ball_of_text(text: str) -> Ball:
    """A ball's outline X,Y,R in pixels."""
    with refusing(f"`ball` must be x,y,radius in pixels, such as 162,740,38, but it is '{text}'."):
        ball = Ball(*(float(part) for part in text.split(",")))
        assert 0 < ball.radius_px < 1e5 and abs(ball.column) + abs(ball.row) < 1e6
    return ball


def _outlined(
    stack: FloatArray, shown: BallPhotographs, white: BoolArray | None, *, checked: bool
) -> tuple[list[Ball], list[Finding]]:
    """Balls in photographs (L, H, W), from outlines, from a mask, or detected; and findings. With
    `checked` a finding also says if an outline could not be checked."""
    if not shown.outlines and white is None:
        found = find_ball(stack)
        words = (
            f"the ball was looked for: the largest round thing is at x {found.column:.0f}, y"
            f" {found.row:.0f}, radius {found.radius_px:.0f} px; give its outline, `ball`, if that"
            " is another thing."
        )
        return [found], [] if checked else [Finding("found-ball", words)]
    balls = []
    findings: list[Finding] = []
    for outline in shown.outlines or balls_of_mask(white):
        ball, doubts = _ball_within(outline, stack, shown.kind)
        balls.append(ball)
        findings += [each for each in doubts if checked or each.code != "unchecked-mask"]
    return balls, findings


def _read_mask(mask: Path, size: tuple[int, int]) -> BoolArray:
    other = f"the photographs have {size[0]} x {size[1]}"
    pixels, _ = image_of_size(mask, size, other, upright=True)
    return np.asarray(pixels.mean(axis=2) > np.iinfo(pixels.dtype).max / 2)


def _ball_within(ball: Ball, stack: FloatArray, kind: str) -> tuple[Ball, list[Finding]]:
    """The ball whose rim the photographs (L, H, W) show near an outline, and findings."""
    rim, agreed = rim_of(stack, ball)
    per_radius = 2.0 if kind == "chrome" else 1.0  # a mirror doubles what its normal turns by
    if agreed < _RIM_AGREED:
        is_small = ball.radius_px < MIN_RIM_PX
        small = f", as the ball is smaller than {2 * MIN_RIM_PX:g} px" if is_small else ""
        words = (
            f"the ball's rim is not found in the photographs near its outline{small}, so that"
            " nothing checks it: each pixel of error turns the lights by"
            f" {math.degrees(per_radius / ball.radius_px):.1f} deg; see that the outline ends at"
            " the rim."
        )
        return ball, [Finding("unchecked-mask", words)]
    offset = math.hypot(ball.column - rim.column, ball.row - rim.row)
    larger = ball.radius_px - rim.radius_px
    if offset + abs(larger) < max(0.005 * rim.radius_px, 0.5):
        return ball, []
    turned = math.degrees((per_radius * offset + 0.6 * abs(larger)) / rim.radius_px)
    words = (
        f"the outline lies {offset:.1f} px beside the ball's rim in the photographs, and its radius"
        f" is {100.0 * larger / rim.radius_px:+.1f} % off: the rim is used; by the outline the"
        f" lights would be some {turned:.1f} deg off."
    )
    return rim, [Finding("corrected-mask", words)]
