"""A finger that moved between the shots, undone: every image brought onto the middle shot of the
white band.

The shots of another band are brought onto the finger whose surface the white band has shown. Under
near-infrared light skin hardly shows its ridges: what is seen of them is reflected at the surface,
and that looks the same in both bands. So each shot is compared with what the first band's surface
and specular reflection, both taken as one matt surface, would look like under its light, and with
the finger's outline. Of a crossed series only light from within the skin is compared, in which
nothing is reflected at the surface; where each of the two polarised series lies still, only the
crossed one is brought back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.finger.locate import Finger, FingerSettings, find_finger, reduced
from splitknit.finger.parameters import (
    ALONE_SHIFT_MM,
    CORRECT_MM,
    CORRECT_SERIES_MM,
    LIGHT_PITCH_MM,
    MAX_STILL_UNEXPLAINED,
    MIN_BESIDE_LIGHTS,
    MIN_RELIABILITY,
    MIN_SIDE_SHIFTS,
    MOST_LEFT,
    REGISTRATION_PX_PER_MM,
    RESAMPLED_MARGIN_MM,
    SURE_SIDE_SHIFT,
    TURN_MM,
    WARN_MM,
)
from splitknit.finger.registration import (
    Flow,
    Level,
    bands_of,
    details_of,
    gram,
    lights_on,
    register_shots,
    robust_weight,
    settled,
    still,
    without_glare,
)
from splitknit.imaging.band import Window, has_colour, linear_channels, linear_stack
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import plane_points
from splitknit.model import Array, Band, BoolArray, Capture, FloatArray

SOME_MOVED = (
    "the finger moved during {} of the images lit from the side, left out; rest it on its support"
    " and capture again."
)
SIDE_MOVED = (
    "the finger moved between the images lit from the front and from the side, and those from the"
    " side are left out; rest it on its support and capture again."
)
_REMEDY = (
    "rest the finger on its support and capture again, or leave the images as they are with"
    " `settings` motion.correct=off (what is not a finger is imported with `material` opaque)."
)


def find_steady_finger(capture: Capture, settings: FingerSettings) -> tuple[Capture, Finger]:
    """Find the finger; where it moved between the shots, undo that first: images are then
    resampled, once, onto the pixels of the reference shot (the middle one of the white band). Where
    it lay still the capture is the same object. Raises BadInput if there is no finger, or it moved
    by more than can be undone.
    """
    finger = find_finger(capture, settings)
    motion = settings.motion
    white = capture.bands["white"]
    skin = capture.material == "skin"
    measured_mm = [0.0]  # but of a crossed series, which is registered below
    for name, figures in finger.quality.items():
        if name != "white_crossed":
            reliable = np.asarray(figures.get("motion_reliability", [])) >= MIN_RELIABILITY
            measured_mm += np.asarray(figures.get("motion_mm", []))[reliable].tolist()
    suspect = skin and max(measured_mm) >= CORRECT_MM  # gloss of other things looks like motion
    wanted = motion.correct == "on" or (motion.correct == "auto" and suspect)
    enough = len(white.lights) >= 5 and len(white.pixels) >= 2
    registered = register(capture, finger) if wanted and enough else None
    if (
        registered is not None
        and motion.correct == "auto"
        and not _worth_undoing(registered, max(measured_mm))
    ):
        registered = None
    between = "shots"
    if registered is None and skin and "white_crossed" in capture.bands:
        registered = register(capture, finger, still_white=True)
        between = "parallel and the crossed series"
        # a crossed series looks clearly more like the parallel one once its motion is undone; gloss
        # does not
        figures = registered.facts["motion_white_crossed"]
        before, after = (
            1.0 - np.square(figures[f"likeness_{when}"]).mean() for when in ("before", "after")
        )
        helps = bool(after < MAX_STILL_UNEXPLAINED**2 * before)
        least_mm = CORRECT_SERIES_MM if has_colour(white) else CORRECT_MM
        if motion.correct == "off" or registered.most_mm < least_mm or not helps:
            words = f"the finger moved by {{:.2f mm}} between the {between}."
            moved = Finding("moved-finger", words, lengths_mm=(registered.most_mm,))
            findings = (
                (*finger.findings, moved)
                if helps and registered.most_mm >= WARN_MM
                else finger.findings
            )
            return capture, replace(
                finger, facts={**finger.facts, **registered.facts}, findings=findings
            )
    if registered is None:
        return capture, finger
    require(
        registered.most_mm <= motion.most_mm,
        f"the finger moved by {registered.most_mm:.2f} mm between the shots, and at most"
        f" {motion.most_mm:g} mm can be undone; {_REMEDY}",
    )
    require(
        registered.after <= MOST_LEFT,
        f"the shots do not fit together: {100 * registered.after:.0f} % of their details are left"
        f" over when the motion between them is undone, and at most {100 * MOST_LEFT:.0f} % may be;"
        f" {_REMEDY}",
    )
    capture = _resampled(capture, finger, registered.flows)
    finger = find_finger(capture, settings)
    words = (
        f"the finger moved by {{:.2f mm}} between the {between}; that was undone, and the images"
        " resampled."
    )
    note = Finding("undone-motion", words, lengths_mm=(registered.most_mm,))
    facts = {**finger.facts, **registered.facts}
    return capture, replace(finger, facts=facts, findings=(note, *finger.findings))


class _Registered(NamedTuple):
    flows: dict[str, Flow]
    most_mm: float
    """Largest shift of a shot against the reference, mean over the finger."""
    before: float
    """Fraction of the details that no surface explains: rms over the white shots, as they are."""
    after: float
    """The same with the motion undone."""
    facts: dict[str, Any]
    apart: float
    """Variance of the white shots' shifts that is left without shifts along their lights, over all
    of it."""


def _worth_undoing(registered: _Registered, measured_mm: float) -> bool:
    """Whether motion was found that is to be undone, or refused; else the images are left as they
    are."""
    if registered.most_mm < CORRECT_MM or registered.apart < MIN_BESIDE_LIGHTS:
        return False
    if registered.after > MOST_LEFT and measured_mm < WARN_MM:  # no skin, wet skin
        return False
    # nothing helps where nothing moved, however much is left
    return registered.after < MAX_STILL_UNEXPLAINED * registered.before


def without_moved_side(capture: Capture, finger: Finger) -> tuple[Capture, tuple[Finding, ...]]:
    """The capture, without images lit from the side (as of :func:`without_side_lights`, the white
    band not yet a mean) where the finger lay elsewhere than a matt surface like the others shows,
    all or some of them, and a warning then.
    """
    shifts = np.zeros((0, 2))
    towards = np.zeros((0, 2))
    numbers = []
    for band in capture.bands.values():
        if band.side is not None:
            pair = {
                "white": replace(band, name="white"),
                "white_crossed": replace(band.side, name="white_crossed"),
            }
            registered = register(replace(capture, bands=pair), finger, still_white=True)
            measured = np.array(registered.facts["motion_white_crossed"]["shift_mm"])
            known = measured.any(axis=1)  # a shot that went astray has none
            numbers += np.flatnonzero(known).tolist()
            shifts = np.concatenate([shifts, measured[known]])
            towards = np.concatenate([towards, _towards(capture, band.side.leds)[known]])
    if len(shifts) < MIN_SIDE_SHIFTS:
        return capture, ()
    apart = _apart_from_lights(shifts, towards)
    error_mm = float(np.linalg.norm(apart.std(axis=0, ddof=1))) / np.sqrt(len(apart))
    if np.hypot(*apart.mean(axis=0)) >= max(CORRECT_MM, SURE_SIDE_SHIFT * error_mm):
        bands = {name: replace(band, side=None) for name, band in capture.bands.items()}
        return replace(capture, bands=bands), (Finding("side-moved", SIDE_MOVED),)
    alone = np.hypot(*(apart - np.median(apart, axis=0)).T) > ALONE_SHIFT_MM
    if not alone.any():
        return capture, ()
    out = {number for number, moved in zip(numbers, alone, strict=True) if moved}
    bands = dict(capture.bands)
    for name, band in bands.items():
        if band.side is not None:
            kept = [k for k in range(len(band.side.leds)) if k not in out]
            bands[name] = replace(band, side=band.side.of_images(kept))
    return replace(capture, bands=bands), (Finding("side-moved", SOME_MOVED.format(len(out))),)


def _towards(capture: Capture, leds: Sequence[Sequence[int]]) -> Array:
    """(L, 2) directions of lights in the plane of the images, x right and y up; of length one."""
    towards = capture.rig.select(leds).light_vectors()[:, :2]
    return np.asarray(towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9))


def _apart_from_lights(shifts: Array, towards: Array) -> Array:
    """(L, 2) shifts of images less what they have in common along their lights: shading seems to
    shift ridges so."""
    centred = towards - towards.mean(axis=0)
    return np.asarray(
        shifts - (centred * shifts).sum() / max(float((centred * centred).sum()), 1e-9) * towards
    )


def register(capture: Capture, finger: Finger, *, still_white: bool = False) -> _Registered:
    """Registration of the white band, unless `still_white`, of the others to it, and the report's
    facts on them."""
    px_per_mm = capture.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / REGISTRATION_PX_PER_MM))
    px = px_per_mm / binning
    window = _window(capture, finger)
    white = capture.bands["white"]
    coloured = has_colour(white) and capture.material == "skin"
    grey, skin = _light_of(capture, white, window, binning, coloured)
    mask = reduced(finger.wider[window], grey.shape[1:])
    lights = _lights_over(capture, white, window)
    colours = [len(set(names)) for names in white.colours] or 1  # coloured LEDs share a photograph
    shots = np.repeat(np.arange(len(white.pixels)), colours)
    reference = len(white.pixels) // 2
    flow = still(len(white.pixels), mask, px)
    corner_mm = window[1].start / px_per_mm, window[0].start / px_per_mm
    centre_mm = flow.centre_mm[0] + corner_mm[0], flow.centre_mm[1] + corner_mm[1]
    rows, columns = np.nonzero(mask)
    middle_mm = float(columns.mean()) / px + corner_mm[0], float(rows.mean()) / px + corner_mm[1]
    flows: dict[str, Flow] = {}
    facts: dict[str, Any] = {"motion": {"reference": f"white {reference}"}}

    def report(name: str, moves_mm: Array, **figures: Array) -> Array:
        """Keep a band's flow and its facts; the shifts (L, 2) of the finger's middle, x right and y
        up."""
        flows[name] = Flow(moves_mm, centre_mm)
        shifts = flows[name].at(*np.reshape(middle_mm, (2, 1)))[..., 0]
        figures = {
            "moved_mm": np.hypot(shifts[:, 0], shifts[:, 1]),
            "turn_deg": -np.rad2deg(moves_mm[:, 2] / TURN_MM),
            **figures,
        }
        rounded = {key: [round(float(v), 5) for v in values] for key, values in figures.items()}
        shifts = shifts * [1.0, -1.0]
        facts[f"motion_{name}"] = {
            **rounded,
            "shift_mm": shifts.tolist(),
            "centre_mm": list(middle_mm),
        }
        return shifts

    before = after = np.zeros(1)
    apart = 1.0
    if not still_white:
        flow, before, after = register_shots(
            skin, lights, mask, px, reference=reference, shots=shots
        )
        shifts = report("white", flow.moves_mm, unexplained_before=before, unexplained_after=after)
        if not white.colours:  # one light a shot
            beside = _apart_from_lights(shifts, _towards(capture, white.lights))
            apart = float(beside.var(axis=0).sum() / max(shifts.var(axis=0).sum(), 1e-30))
    for name, band in capture.bands.items():
        crossed = name == "white_crossed"
        if name == "white" or band.colours or (still_white and not crossed):
            continue
        known = skin if crossed else grey
        stack = _light_of(capture, band, window, binning, coloured and crossed)[1]
        field = _lights_over(capture, band, window)
        first = _FirstBand(known, lights, flow, shots)
        moves_mm, likeness, before_likeness = _register_band(first, stack, field, mask, px)
        if crossed and not coloured:  # gloss shifts each image by itself: their mean is what moved
            moves_mm = np.broadcast_to(moves_mm.mean(axis=0), moves_mm.shape)
        report(name, moves_mm, likeness_before=before_likeness, likeness_after=likeness)
    most_mm = max(max(facts[f"motion_{name}"]["moved_mm"]) for name in flows)
    facts["motion"]["most_mm"] = most_mm
    rms_before, rms_after = (float(np.sqrt(np.mean(values**2))) for values in (before, after))
    return _Registered(flows, most_mm, rms_before, rms_after, facts, apart)


class _FirstBand(NamedTuple):
    """The white band, whose shots are registered: what the others are compared with."""

    stack: FloatArray
    """(K, H, W) linear."""
    lights: Array
    """(K, 3, h, w)"""
    flow: Flow
    shots: NDArray[np.intp]
    """(K,) shot of every image."""


def _register_band(
    first: _FirstBand, stack: FloatArray, lights: Array, mask: BoolArray, px_per_mm: float
) -> tuple[Array, Array, Array]:
    """Moves (L, 3) of another band's `stack` (L, H, W), each image a shot, onto the registered band
    `first`, and the correlation (L,) of details with the expected ones with the motion undone, and
    as they are.
    """
    shots = np.arange(len(stack))
    flow = unmoved = still(len(stack), mask, px_per_mm)
    for sigma_mm, region, turns in bands_of(mask, px_per_mm):
        level = details_of(stack, region, px_per_mm, sigma_mm)
        first_level = details_of(first.stack, region, px_per_mm, sigma_mm)
        expected = _expected(first, level, first_level, lights, mask.shape, px_per_mm)
        moves = []
        # each by itself, towards the details that are expected of it, whatever their strength
        for k in shots:

            def step_of(
                sampled: FloatArray,
                basis: Array,
                level: Level = level,
                details: Array = expected[k],
            ) -> Array:
                return _step(level, details, sampled[0], basis)

            alone = replace(level, images=level.images[k : k + 1])
            shot = replace(flow, moves_mm=flow.moves_mm[k : k + 1])
            moves.append(settled(alone, shot, shots[:1], [0], step_of, turns).moves_mm)
        flow = replace(flow, moves_mm=np.concatenate(moves))

    def likeness(flow: Flow) -> Array:
        images = level.sampled(flow.at(*level.places()).astype(np.float32))[:, 0]
        both, power, expected_power = (
            (a * b * level.weight).sum(axis=1, dtype=np.float64)
            for a, b in ((images, expected), (images, images), (expected, expected))
        )
        return np.asarray(both / np.sqrt(np.maximum(power * expected_power, 1e-30)))

    before = likeness(unmoved)
    after = likeness(flow)
    better = after > before  # a shot that went astray stays as it was
    return flow.moves_mm * better[:, None], np.maximum(after, before), before


def _expected(  # noqa: PLR0917
    first: _FirstBand,
    level: Level,
    first_level: Level,
    lights: Array,
    shape: tuple[int, ...],
    px_per_mm: float,
) -> FloatArray:
    """(L, N) details under `lights` of the surface that the details of the first band give."""
    at_level = replace(first_level, columns=level.columns, rows=level.rows, weight=level.weight)
    details = at_level.sampled(first.flow.at(*level.places())[first.shots].astype(np.float32))[:, 0]
    if np.array_equal(lights, first.lights):  # a crossed series: what was seen is what is expected
        return details
    before, now = (lights_on(part, level, shape, px_per_mm) for part in (first.lights, lights))
    before = np.moveaxis(before.astype(np.float64), 2, 0)  # (N or 1, K, 3)
    normal = before.transpose(0, 2, 1) @ before
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    observed = (before * details.T[:, :, None]).sum(axis=1)
    surface = np.linalg.solve(np.broadcast_to(normal, (len(observed), 3, 3)), observed[..., None])[
        ..., 0
    ].T
    return np.asarray((now * surface).sum(axis=1), dtype=np.float32)


def _step(level: Level, expected: FloatArray, sampled: FloatArray, basis: Array) -> Array:
    """(1, M) change of one shot's parameters; `sampled` (3, N) are its details and their
    derivatives."""
    power = float((expected * expected * level.weight).sum(dtype=np.float64))
    gain = float((expected * sampled[0] * level.weight).sum(dtype=np.float64)) / max(power, 1e-30)
    residual = sampled[0] - gain * expected
    root = np.sqrt(robust_weight(level, np.sqrt(residual * residual * level.weight)))
    shifts = sampled[1] * basis[:, 0].T + sampled[2] * basis[:, 1].T
    products = gram(
        np.asarray(
            np.concatenate([shifts, -expected[None], residual[None]]) * root, dtype=np.float32
        )
    )
    normal = products[:-1, :-1]
    normal = normal + np.diag(1e-6 * np.diag(normal) + 1e-30)
    return np.asarray(-np.linalg.solve(normal, products[:-1, -1])[None, :-1])


def _light_of(
    capture: Capture, band: Band, window: Window, binning: int, coloured: bool
) -> tuple[FloatArray, FloatArray]:
    """(L, h, w) images in grey, and the light in them that came through the skin where colours show
    it."""
    if not coloured:
        grey = linear_stack(band, capture.encoding, "grey", window, binning)
        return grey, grey
    channels = linear_channels(
        band, capture.encoding, ("grey", "red", "green", "blue"), window, binning
    )
    return channels[0], without_glare(channels[1:])


def _resampled(capture: Capture, finger: Finger, flows: dict[str, Flow]) -> Capture:
    """The capture with every image taken from where its skin is, once, in the values that are
    stored."""
    window = _window(capture, finger)
    bands = dict(capture.bands)
    for name, flow in flows.items():
        pixels = bands[name].pixels.copy()
        for k in np.flatnonzero(flow.moves_mm.any(axis=1)).tolist():
            take(bands[name].pixels[k], flow, k, capture.rig.camera.px_per_mm, window, pixels[k])
        bands[name] = replace(bands[name], pixels=pixels)
    return replace(capture, bands=bands)


def take(  # noqa: PLR0917
    image: NDArray[Any], flow: Flow, shot: int, px_per_mm: float, window: Window, out: NDArray[Any]
) -> None:
    """Write a shot's image where a window of the reference has its skin, by cubic interpolation,
    into `out`."""
    place = out[window]
    affine = flow.affine(shot, px_per_mm)
    affine[:, 2] += affine[:, :2] @ np.array([window[1].start, window[0].start], dtype=np.float64)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    size = (place.shape[1], place.shape[0])
    place[...] = cv2.warpAffine(
        image, affine, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
    ).reshape(place.shape)


def _window(capture: Capture, finger: Finger) -> Window:
    """Rows and columns that hold the finger and what is beside it."""
    margin = round(RESAMPLED_MARGIN_MM * capture.rig.camera.px_per_mm)
    rows, columns = (
        slice(max(0, part.start - margin), min(side, part.stop + margin))
        for part, side in zip(finger.window, capture.shape, strict=True)
    )
    return rows, columns


def _lights_over(capture: Capture, band: Band, window: Window) -> Array:
    """(L, 3, h, w) light vectors on the finger plane, on nodes about 0.6 mm apart evenly over a
    window."""
    camera = capture.rig.camera
    rows, columns = (
        np.linspace(
            part.start,
            part.stop - 1,
            max(2, round((part.stop - part.start) * camera.pitch_mm / LIGHT_PITCH_MM) + 1),
        )
        for part in window
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    places = plane_points(camera, pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
    level = np.zeros(pixels.shape[:2], dtype=np.float32)
    field = light_vectors_at(capture.rig.select(band.lights), places[..., 0], places[..., 1], level)
    return np.asarray(field, dtype=np.float64)
