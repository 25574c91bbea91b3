"""The questions of the acceptance test. Each is a function of photographs and returns rows: what
was measured, the limit, and whether it passed.

A question whose photographs cannot be used fails, and its row gives the reason: a black image under
a dead LED is an answer. Folders that are not captures were refused when they were read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from splitknit import BadInput, Capture, Reconstruction, Rig, reconstruct
from splitknit.errors import require
from splitknit.findings import Severity
from splitknit.finger.motion import shot_motion
from splitknit.imaging.geometry import (
    BAND_SIGMA_MM,
    EROSION_MM,
    bounding_box,
    eroded,
    high_passed,
    wide_blur,
)
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import Light
from splitknit.observation.observe import observe
from splitknit_rig.acceptance.phantom import ridge_heights
from splitknit_rig.calibration.ball_photos import place_on_plane
from splitknit_rig.calibration.card_model import CardPlane, card_light, rays_to_led
from splitknit_rig.calibration.lights import led_name, listed
from splitknit_rig.calibration.radiometry import CardImages, beside_calibration, card_images
from splitknit_rig.calibration.sensor import fit_response
from splitknit_rig.calibration.sphere import find_ball, grey_directions, rim_of, smear_px
from splitknit_rig.capture.shots import MAX_CROSSED, SHINE_PERCENTILE


@dataclass(frozen=True, slots=True)
class Answer:
    """One row of the acceptance test: a question with its limit, and what was measured."""

    question: str
    limit: float
    unit: str
    at_least: bool = False
    """Whether the limit is the smallest value that passes, not the largest."""
    measured: float | None = None
    """None if the photographs could not be used; `note` gives the reason."""
    passed: bool = False
    note: str = ""
    """The LED or band that was measured, or the reason why nothing was."""


# What the limits let through. A rig with one defect at its limit adds at most 0.1 mm rms to a
# finger's surface and 5 % to the error of its ridges, except motion and focus
# (validation/rig_check, effects.csv).
DARK = Answer("dark level", 1.0, "% of full scale")
"""Beyond the black level that the capture states; subtracting an ambient frame removes it. Chosen
on: judgement, checked on simulated fingers (effects.csv). Range: up to 2, with ambient frames."""
LINEAR = Answer("linearity", 0.5, "% of full scale")
"""1 % adds 0.03 to 0.11 mm rms to a finger's surface and up to 5 % to the error of its ridges; the
sound twins have 0.03 %. Chosen on: simulated fingers (effects.csv). Range: at 2 up to 0.24 mm."""
LIT = Answer("LEDs that do not light", 0.0, "LEDs")
SPECKS = Answer("specks on sensor, lens or card", 3.0, "specks")
"""Places that are darker than their surroundings by `_SPECK` in the mean of all images, or stuck
pixels that are brighter by as much. A factor common to all images does not change the measured
slope, so a few specks do no harm."""
_SPECK = 0.03  # of the light around it; the card's calibration leaves out what departs by 0.02
EXPOSED = Answer("darkest card", 25.0, "% of full scale", at_least=True)
"""99th percentile. At the limit, ridges have up to 2 % more error. Chosen on: judgement, checked on
simulated fingers (effects.csv). Range: at 12.5 up to 3 %."""
BRIGHT = Answer("brightness by light", 3.0, "% off the rig file")
"""Relative to the LED's band. One LED at the limit adds 0.03 to 0.08 mm rms to a finger's surface
and 2 % to the error of its ridges. Chosen on: judgement, checked on simulated fingers
(effects.csv). Range: at 6 up to 0.19 mm."""
BEAM = Answer("light across the card", 1.0, "% off the rig file")
"""Robust standard deviation. One LED at the limit, which is tilted by 1.7 deg, adds 0.01 mm rms to
a finger's surface. Chosen on: judgement, checked on simulated fingers (effects.csv). Range: the
same up to 2."""
FLAT = Answer("flatness of the card", 1.0, "deg rms")
LEAK = Answer("light leaks", 1.0, "% of an LED's light")
"""With all LEDs off. An LED that leaks as much adds up to 0.02 mm rms to a finger's surface. Chosen
on: judgement, checked on simulated fingers (effects.csv). Range: at 2 up to 0.04 mm."""
RIDGES = Answer("ridges of the phantom", 0.9, "correlation", at_least=True)
"""Correlation with the drawn ridges, for pixels of 0.07 mm or less; the sound twin has 0.97. Chosen
on: simulated phantom (validation/rig_check)."""
SHARP = Answer("ridges of the phantom, fine over coarse", 0.81, "of the height", at_least=True)
"""The lens's blur, where a pixel is 0.07 mm or less: rigs in focus at f/2 have 0.84 to 0.86, rigs
that are 6 mm out of focus 0.76, which adds 19 to 33 % to the error of a finger's ridges; 3 mm cost
nothing. A print 20 % too low lowers it by 0.014. Chosen on: simulated phantom
(validation/rig_check, seeds 100 and 101): the middle of both."""
RADIUS = Answer("radius of the ball", 2.0, "% off the true one")
"""The finger's lengths have the same relative error, its heights 0.01 mm rms. Chosen on: judgement,
checked on simulated fingers (effects.csv)."""
ORDER = Answer("LEDs out of order", 0.0, "LEDs")
AIMED = Answer("direction of each LED", 0.6, "deg off the rig file")
"""After the common rotation of all LEDs is removed. Calibration leaves 0.12 deg per axis, so in one
of 20,000 rigs an LED of the 14 exceeds 0.6; an LED 2 mm off its place deviates by 0.8. One LED 1
deg off adds up to 0.03 mm rms to a finger's surface (effects.csv)."""
TURNED = Answer("turn of all LEDs together", 0.5, "deg")
"""Calibration leaves a standard deviation of 0.09 deg; the limit is five times that. A finger's
surface hardly changes: at 2 deg by less than 0.01 mm rms (effects.csv)."""
SMEAR = Answer("smear of every shot", 0.08, "mm")
"""Length of a straight motion during the exposure: at the limit, ridges 0.45 mm apart that lie
across it keep sinc(0.08 / 0.45) = 0.95 of their contrast."""
REPEAT = Answer("repeatability of the finger", 0.9, "correlation", at_least=True)
"""Correlation of the ridges of two captures. Thirty sound twins have 0.95 or more. Chosen on:
simulated fingers (validation/rig_check, seeds 100 to 104)."""
FLICKER = Answer("flicker", 3.0, "% from one shot to the next")
"""Change of an LED's brightness between the two captures, relative to its band, in strips of rows.
The limit is that of a steady LED's deviation from the rig file."""
STILL = Answer("motion of the finger", 0.13, "mm")
"""Between the shots; a capture has the same limit. It costs more than any other limit: 39 to 55 %
more error in the ridges. The sound twins have 0.04. Chosen on: judgement, checked on simulated
fingers (effects.csv). Range: at 0.26 up to 150 %."""
FILMS = Answer("crossed films, where the finger shines", 100 * MAX_CROSSED, "% of parallel light")


Taken = Capture | BadInput
"""A capture, or the reason why its photographs cannot be used."""


def _used(capture: Taken) -> Capture:
    """The capture; raises the reason why there is none."""
    if isinstance(capture, BadInput):
        raise capture
    return capture


def _answer(question: Answer, measured: float, note: str = "") -> Answer:
    if not math.isfinite(measured):
        return replace(question, note=note)
    passed = measured >= question.limit if question.at_least else measured <= question.limit
    return replace(question, measured=float(f"{measured:.4g}"), passed=passed, note=note)


def _asked(questions: Sequence[Answer], ask: Callable[[], Iterable[Answer]]) -> list[Answer]:
    """The answers; if the photographs cannot be used, one failed answer per question, with the
    reason."""
    try:
        return list(ask())
    except BadInput as error:
        return [replace(question, note=str(error)) for question in questions]


# The card.


def answers_of_sensor(card: Taken, values: Any, exposure: Any) -> list[Answer]:
    """Dark level and linearity by an exposure series of a card.

    `values` (J, N): N places at J exposures, as fractions of full scale, NaN where clipped;
    `exposure` (J,): time times gain.
    """

    def dark() -> Iterator[Answer]:
        white = _used(card).bands["white"]
        black = float(np.median(white.black_level)) / float(np.iinfo(white.pixels.dtype).max)
        stored = np.asarray(values, dtype=np.float64)
        times = np.asarray(exposure, dtype=np.float64)
        whole = stored[:, np.isfinite(stored).all(axis=0)]
        require(whole.size > 0, "every place of the exposure series is clipped somewhere.")
        # a linear sensor's values are a line over the time; its value at no time is the dark level
        intercept = np.polynomial.polynomial.polyfit(times, whole, 1)[0]
        yield _answer(DARK, 100 * abs(float(np.median(intercept)) - black))

    def linear() -> Iterator[Answer]:
        _used(card)
        yield _answer(LINEAR, fit_response(values, exposure, 100.0).linear_percent)

    return _asked([DARK], dark) + _asked([LINEAR], linear)


def answers_of_card(card: Taken, rig: Rig, plane: CardPlane) -> list[Answer]:
    """Compare a white matt card under every LED with the rig file."""

    def ask() -> Iterator[Answer]:
        images = card_images(_used(card), rig, may_be_dark=True)
        _, own, beams = beside_calibration(images, rig, plane)
        lit = own > _UNLIT
        yield _answer(LIT, float(np.sum(~lit)), "" if lit.all() else _beyond(~lit, 0.5, rig))
        yield _answer(EXPOSED, 100 * float(images.brightest[lit].min()))
        for question, off in ((BRIGHT, np.abs(own - 1)), (BEAM, beams)):
            percent = np.where(lit, 100 * off, 0.0)
            yield _answer(question, float(percent.max()), _beyond(percent, question.limit, rig))
        bands = dict.fromkeys(led.band for led in rig.leds)
        slopes = {band: _slope_deg(images, rig, plane, own, band) for band in bands}
        worst = max(slopes, key=lambda band: slopes[band])
        yield _answer(FLAT, slopes[worst], worst)

    def leaks() -> Iterator[Answer]:
        parts = {name: _leak(light) for name, light in observe(_used(card)).bands.items()}
        worst = max(parts, key=lambda band: parts[band])
        yield _answer(LEAK, 100 * parts[worst], worst)

    def specks() -> Iterator[Answer]:
        yield _answer(SPECKS, *_specks(_used(card), rig.camera.px_per_mm))

    asked = [LIT, EXPOSED, BRIGHT, BEAM, FLAT]
    return _asked(asked, ask) + _asked([LEAK], leaks) + _asked([SPECKS], specks)


_UNLIT = 0.12  # of its band's light, as a capture session has it


def _specks(card: Capture, px_per_mm: float) -> tuple[float, str]:
    """Number of specks that all images of the card share, and the place of the strongest."""
    stack = np.concatenate([light.grey for light in observe(card).bands.values()])
    flat = stack.mean(axis=0)
    departure = cv2.GaussianBlur(flat / wide_blur(flat, px_per_mm), (0, 0), 0.7) - 1.0
    specks = (np.abs(departure) > _SPECK).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(specks)
    small = stats[1:, cv2.CC_STAT_AREA] < px_per_mm**2  # mm^2
    row, column = np.unravel_index(int(np.argmax(np.abs(departure))), departure.shape)
    most = f"{100 * float(departure[row, column]):+.0f} % at column {column}, row {row}"
    return float(small.sum()), most if small.any() else ""


def _beyond(values: Any, limit: float, rig: Rig) -> str:
    """Names of the LEDs beyond a limit; if none is, of the LED with the largest value."""
    beyond = np.flatnonzero(np.asarray(values) > limit)
    named = beyond if len(beyond) else [int(np.argmax(values))]
    return listed([led_name(rig.leds, int(k)) for k in named])


def _slope_deg(images: CardImages, rig: Rig, plane: CardPlane, own: Array, band: str) -> float:
    """Angle (rms, deg) between the card's normal and the normals measured with a band's LEDs."""
    leds = [k for k, led in enumerate(rig.leds) if led.band == band and own[k] > _UNLIT]
    points = plane.points(rig.camera, images.pixels)
    towards = np.stack([rays_to_led(rig.leds[k], points)[0] for k in leds])
    facing = np.stack([card_light(rig.camera, rig.leds[k], images.pixels, plane) for k in leds])
    facing = facing / (towards @ plane.normal) * own[leds, None]
    # a card of the normal n has the light I_k = facing_k (towards_k . n)
    light = images.light[leds] / facing
    product = np.einsum("kni,knj->nij", towards, towards)
    normals = np.linalg.solve(product, np.einsum("kni,kn->ni", towards, light)[..., None])[..., 0]
    cosine = normals @ plane.normal / np.linalg.norm(normals, axis=1)
    return float(np.rad2deg(np.sqrt(np.mean(np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2))))


def _leak(light: Light) -> float:
    """Light with all LEDs off, relative to that of the band's LEDs."""
    dark = light.at(2).ambient
    require(dark is not None, f"the band {light.name} has no image with all LEDs off.")
    assert dark is not None
    return float(np.mean(dark)) / float(np.mean(light.at(2).grey))


# The phantom.


def answers_of_phantom(capture: Taken) -> list[Answer]:
    """Ridges of the printed phantom, as the default method measures them."""

    def ask() -> Iterator[Answer]:
        result = reconstruct(_used(capture), "metric", {"keep": True})
        height, likeness, fine = ridge_heights(result)
        yield _answer(RIDGES, likeness, f"{100 * height:.0f} % of the height drawn")
        yield _answer(SHARP, fine)

    return _asked([RIDGES, SHARP], ask)


# The ball.


def answers_of_ball(capture: Taken, rig: Rig, diameter_mm: float) -> list[Answer]:
    """Scale, smear and light directions, from a matt grey ball on the finger plane under every
    LED."""

    def ask() -> Iterator[Answer]:
        ball = _used(capture)
        order = [(band, k) for band in ball.bands.values() for k in range(len(band.leds))]
        leds = [band.leds[k][0] for band, k in order]
        require(sorted(leds) == list(range(len(rig.leds))), "photograph the ball under every LED.")
        stack = np.concatenate([light.grey for light in observe(ball).bands.values()])[
            np.argsort(leds)
        ]
        stack = np.maximum(stack, 0) / np.float32(max(float(stack.max()), 1e-9))
        level = np.percentile(stack, 99, axis=(1, 2))
        lit = np.flatnonzero(level > _UNLIT * np.median(level))
        stack = stack[lit]
        outline, _ = rim_of(stack, find_ball(stack))
        place = place_on_plane(rig, outline, [led_name(rig.leds, int(k)) for k in lit])
        off = abs(2 * place.radius_mm / diameter_mm - 1)
        yield _answer(RADIUS, 100 * off, f"{2 * place.radius_mm:.2f} mm, not {diameter_mm:g} mm")
        yield _answer(SMEAR, smear_px(stack.mean(axis=0), outline) / rig.camera.px_per_mm)
        # what of the shading is the beam's, not the ball's
        normals = outline.normals(stack.shape[1:], place.eye)
        points = place.middle_mm + place.radius_mm * normals
        for n, k in enumerate(lit):
            towards, _ = rays_to_led(rig.leds[k], points.reshape(-1, 3))
            along = np.maximum(-(towards @ rig.leds[k].axis), 1e-6)
            beam = np.nan_to_num(along ** rig.leds[k].lobe_exponent, nan=1.0)
            stack[n] /= beam.reshape(stack.shape[1:]).astype(np.float32)
        measured = np.full((len(rig.leds), 3), np.nan)
        away = place.distances
        measured[lit], _ = grey_directions(stack, outline, np.inf, eye=place.eye, away=away)
        drawn = np.array([led.position_mm for led in rig.leds]) - place.middle_mm
        drawn /= np.linalg.norm(drawn, axis=1)[:, None]
        cosines = measured @ drawn.T
        band = np.array([led.band for led in rig.leds])
        cosines[band[:, None] != band] = -1.0
        stray = np.isin(np.arange(len(band)), lit) & (
            cosines.argmax(axis=1) != np.arange(len(band))
        )
        yield _answer(ORDER, float(stray.sum()), _beyond(stray, 0.5, rig) if stray.any() else "")
        turn, _ = Rotation.align_vectors(measured[lit], drawn[lit])
        yield _answer(TURNED, float(np.rad2deg(turn.magnitude())))
        apart = np.linalg.norm(measured - turn.apply(drawn), axis=1)
        angles = np.nan_to_num(np.rad2deg(2 * np.arcsin(np.minimum(apart / 2, 1.0))))
        yield _answer(AIMED, float(angles.max()), _beyond(angles, AIMED.limit, rig))

    return _asked([RADIUS, SMEAR, ORDER, TURNED, AIMED], ask)


# The finger, photographed twice while it lies still.


def answers_of_finger(*captures: Taken) -> list[Answer]:
    """Repeatability, flicker and motion, from two captures of one finger. Surfaces are those of
    `ea`, which uses no model of skin, and motion, which has its own question, is not undone:
    resampling images of a finger that lay still costs repeatability."""
    results: list[Reconstruction] = []

    def ask() -> Iterator[Answer]:
        settings = {"keep": True, "motion.correct": "off"}
        results.extend(reconstruct(_used(taken), "ea", settings) for taken in captures)
        yield from (_asked([REPEAT], again) + _asked([FLICKER], flicker) + _asked([STILL], still))
        if "white_crossed" in _used(captures[0]).bands:
            yield from _asked([FILMS], crossed)

    @cache
    def laid_over() -> tuple[Array, float, BoolArray]:
        return _laid_over(*results)

    def again() -> Iterator[Answer]:
        for result in results:
            spoilt = [str(each) for each in result.findings if each.severity == Severity.SPOILS]
            require(not spoilt, "".join(spoilt[:1]))
        yield _answer(REPEAT, laid_over()[1])

    def flicker() -> Iterator[Answer]:
        move, _, inside = laid_over()
        rig = _used(captures[0]).rig
        changes = np.zeros(len(rig.leds))
        first, second = (observe(_used(taken)).bands for taken in captures)
        for name in first.keys() & second.keys() - {"white_crossed"}:
            leds = [led for (led,) in first[name].lights]
            after = np.stack([_moved(image, move) for image in second[name].grey])
            changes[leds] = _changes(first[name].grey, after, inside)
        percent = 100 * changes
        yield _answer(FLICKER, float(percent.max()), _beyond(percent, FLICKER.limit, rig))

    def still() -> Iterator[Answer]:
        moved = 0.0
        for capture, result in zip(map(_used, captures), results, strict=True):
            stack = observe(capture).white.grey
            shifts = shot_motion(stack, result.mask, 1.0 / result.pitch_mm).shift_mm
            moved = max(moved, float(np.linalg.norm(shifts, axis=1).max()))
        yield _answer(STILL, moved)

    def crossed() -> Iterator[Answer]:
        bands, where = observe(_used(captures[0])).bands, results[0].mask
        shine = [
            np.percentile(image[where], SHINE_PERCENTILE)
            for name in ("white", "white_crossed")
            for image in bands[name].grey
        ]
        parallel, left = np.reshape(shine, (2, -1)).sum(axis=1)
        yield _answer(FILMS, 100 * float(left / max(parallel, 1e-9)))

    return _asked([REPEAT, FLICKER, STILL], ask)


def _changes(first: FloatArray, second: FloatArray, inside: BoolArray) -> Array:
    """(L,) largest change of each image's light in any strip of rows, relative to all images."""
    strips = np.array_split(np.flatnonzero(inside.any(axis=1)), 4)
    ratios = np.empty((len(first), len(strips)))
    for n, rows in enumerate(strips):
        before, after = (
            np.maximum(stack[:, rows][:, inside[rows]], 1e-6) for stack in (first, second)
        )
        ratios[:, n] = np.median(np.log(after / before), axis=1)
    return np.asarray(np.abs(ratios - np.median(ratios, axis=0)).max(axis=1))


def _well_inside(result: Reconstruction) -> BoolArray:
    return eroded(result.mask & np.isfinite(result.height_mm), EROSION_MM / result.pitch_mm)


def _laid_over(first: Reconstruction, second: Reconstruction) -> tuple[Array, float, BoolArray]:
    """Shift between two surfaces where both show ridges: a map (2, 3) from columns and rows of the
    first picture to those of the second, the correlation of the ridges, and (H, W) where both
    surfaces are measured well."""
    require(first.mask.shape == second.mask.shape, "the finger's two captures differ in size.")

    def ridges(result: Reconstruction) -> FloatArray:
        relief = np.nan_to_num(np.where(result.mask, result.ridge_mm, 0.0)).astype(np.float32)
        sharp = high_passed(relief, result.mask, BAND_SIGMA_MM / result.pitch_mm)
        return np.where(_well_inside(result), sharp, 0.0).astype(np.float32)

    a, b = ridges(first), ridges(second)
    require(bool(a.any() and b.any()), "the finger shows too little skin.")
    box = bounding_box(first.mask | second.mask)
    shift, _ = cv2.phaseCorrelate(a[box], b[box])
    move = np.column_stack([np.eye(2), np.array(shift)])
    there = _moved(_well_inside(second).astype(np.float32), move)
    inside = _well_inside(first) & (there > 0.99)
    likeness = float(np.corrcoef(a[inside], _moved(b, move)[inside])[0, 1])
    return move, likeness, inside


def _moved(image: FloatArray, move: Array) -> FloatArray:
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, move, image.shape[::-1], flags=flags))
