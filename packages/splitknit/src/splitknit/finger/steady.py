"""A finger that moved between the shots, undone: every image brought onto the middle shot of the white band.

The shots of another band are brought onto the finger whose surface the white band has shown. Under near-infrared light
skin hardly shows its ridges: what is seen of them is reflected at the surface, and that looks the same in both bands.
So each shot is compared with what the first band's surface and specular reflection, both taken as one matt surface,
would look like under its light, and with the finger's outline. Of a crossed series only light from within the skin is
compared, in which nothing is reflected at the surface; where each of the two polarised series lies still, only the
crossed one is brought back.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.finger.locate import Finger, FingerSettings, find_finger, reduced
from splitknit.finger.motion import CORRECT_MM, MIN_RELIABILITY, MOST_LEFT, WARN_MM
from splitknit.finger.regions import dilate, erode
from splitknit.finger.registration import (
    BAND_RATIO,
    BLOCK_MM,
    COARSE_MM,
    FINE_MM,
    ITERATIONS,
    RIM_MM,
    SURROUND_MM,
    TURN_MM,
    WORKING_PX_PER_MM,
    Flow,
    Level,
    details_of,
    gram,
    lights_on,
    register_shots,
    robust_weight,
    step_limits,
    still,
    without_glare,
)
from splitknit.imaging.band import Window, has_colour, linear_channels, linear_stack
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import plane_points
from splitknit.model import Array, Band, BoolArray, Capture, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _RegisteredBand:
    """A band whose shots are registered: what the others are compared with."""

    stack: FloatArray
    """(K, H, W) grey, linear."""
    lights: Array
    """(K, 3, h, w)"""
    flow: Flow
    shots: NDArray[np.intp]
    """(K,) shot of every image."""


def _register_band(
    first: _RegisteredBand,
    stack: FloatArray,
    lights: Array,
    mask: BoolArray,
    px_per_mm: float,
) -> tuple[Flow, Array, Array]:
    """Flow of another band's `stack` (L, H, W), each image a shot, onto the registered band `first`, and the
    correlation (L,) of details with the expected ones with the motion undone, and as they are. `lights`: as those of
    `first`.
    """
    around = dilate(mask, SURROUND_MM * px_per_mm)
    skin = erode(mask, RIM_MM * px_per_mm)
    flow = unmoved = still(len(stack), mask, px_per_mm)
    for step, sigma in enumerate((*COARSE_MM, *FINE_MM)):
        region = skin if step >= len(COARSE_MM) and skin.any() else around
        band = (sigma, BAND_RATIO * sigma)
        both = (details_of(images, region, px_per_mm, band, WORKING_PX_PER_MM) for images in (stack, first.stack))
        level, known = both
        expected = _expected(first, level, known, lights, mask.shape, px_per_mm)
        flow = _followed(level, expected, flow, turns=step > 0)
    aligned = (level.sampled(f.at(*level.places()).astype(np.float32))[:, 0] for f in (flow, unmoved))
    likeness, before = (_likeness(level.weight, expected, images) for images in aligned)
    better = likeness > before  # a shot that went astray stays as it was
    return replace(flow, moves_mm=flow.moves_mm * better[:, None]), np.maximum(likeness, before), before


def _expected(  # noqa: PLR0917
    first: _RegisteredBand, level: Level, known: Level, lights: Array, shape: tuple[int, ...], px_per_mm: float
) -> FloatArray:
    """(L, N) details under `lights` of the surface that the `known` details of the first band give."""
    taken = replace(known, columns=level.columns, rows=level.rows, weight=level.weight)
    shifts = first.flow.at(*level.places())[first.shots].astype(np.float32)
    details = taken.sampled(shifts)[:, 0]
    if np.array_equal(lights, first.lights):  # a crossed series: what was seen is what is expected
        return details
    before, now = (lights_on(part, level, shape, px_per_mm) for part in (first.lights, lights))
    before = np.moveaxis(before.astype(np.float64), 2, 0)  # (N or 1, K, 3)
    normal = before.transpose(0, 2, 1) @ before
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    observed = (before * details.T[:, :, None]).sum(axis=1)
    surface = np.linalg.solve(np.broadcast_to(normal, (len(observed), 3, 3)), observed[..., None])[..., 0].T
    return np.asarray((now * surface).sum(axis=1), dtype=np.float32)


def _followed(level: Level, expected: FloatArray, flow: Flow, *, turns: bool) -> Flow:
    """Move every shot, by itself, towards the details that are expected of it, whatever their strength."""
    places = level.places()
    moves = flow.moves_mm.copy()
    basis = flow.basis(*places)[..., : 3 if turns else 2]
    most, least = step_limits(level)
    for k in range(len(moves)):
        alone = replace(level, images=level.images[k : k + 1])
        for _ in range(ITERATIONS):
            shifts = replace(flow, moves_mm=moves[k : k + 1]).at(*places)
            step = np.clip(_step(level, expected[k], alone.sampled(shifts.astype(np.float32))[0], basis), -most, most)
            moves[k, : basis.shape[2]] += step
            if float(np.abs(step).max()) < least:
                break
    return replace(flow, moves_mm=moves)


def _step(level: Level, expected: FloatArray, sampled: FloatArray, basis: Array) -> Array:
    """(M,) change of one shot's parameters; `sampled` (3, N) are its details and their derivatives."""
    power = float((expected * expected * level.weight).sum(dtype=np.float64))
    gain = float((expected * sampled[0] * level.weight).sum(dtype=np.float64)) / max(power, 1e-30)
    residual = sampled[0] - gain * expected
    root = np.sqrt(robust_weight(level, np.sqrt(residual * residual * level.weight)))
    shifts = sampled[1] * basis[:, 0].T + sampled[2] * basis[:, 1].T
    normal = gram(np.asarray(np.concatenate([shifts, -expected[None], residual[None]]) * root, dtype=np.float32))
    force = normal[:-1, -1]
    normal = normal[:-1, :-1]
    normal = normal + np.diag(1e-6 * np.diag(normal) + 1e-30)
    return np.asarray(-np.linalg.solve(normal, force)[:-1])


def _likeness(weight: FloatArray, expected: FloatArray, images: FloatArray) -> Array:
    both, power, other = (
        (a * b * weight).sum(axis=1, dtype=np.float64)
        for a, b in ((images, expected), (images, images), (expected, expected))
    )
    return np.asarray(both / np.sqrt(np.maximum(power * other, 1e-30)))


HELPS = 0.95
"""Undoing motion must bring what no surface explains below this fraction of what it was."""
_SERIES_MM = 0.01
"""Motion between polarised series in colour from which it is undone; a still path-traced finger shows 0.004."""


def find_steady_finger(capture: Capture, settings: FingerSettings) -> tuple[Capture, Finger]:
    """Find the finger; where it moved between the shots, undo that first: images are then resampled, once, onto the
    pixels of the reference shot (the middle one of the white band). Where it lay still the capture is the same object.
    Raises BadInput if there is no finger, or it moved by more than can be undone.
    """
    finger = find_finger(capture, settings)
    motion = settings.motion
    seen_mm = seen_motion_mm(finger)
    suspect = capture.material == "skin" and seen_mm >= CORRECT_MM  # gloss of other things looks like motion
    wanted = motion.correct == "on" or (motion.correct == "auto" and suspect)
    enough = len(capture.bands["white"].lights) >= 5 and len(capture.bands["white"].pixels) >= 2
    registered = register(capture, finger) if wanted and enough else None
    if registered is not None and motion.correct == "auto" and not _worth_undoing(registered, seen_mm):
        registered = None
    where = "shots"
    if registered is None and capture.material == "skin" and "white_crossed" in capture.bands:
        registered = register(capture, finger, still_white=True)
        where = "parallel and the crossed series"
        least = _SERIES_MM if has_colour(capture.bands["white"]) else CORRECT_MM
        helps = _helps(registered.facts["motion_white_crossed"])
        if motion.correct == "off" or registered.most_mm < least or not helps:
            moved = Finding(
                "moved-finger",
                f"the finger moved by {{:.2f mm}} between the {where}.",
                lengths_mm=(registered.most_mm,),
            )
            doubt = (moved,) if helps and registered.most_mm >= WARN_MM else ()
            facts = {**finger.facts, **registered.facts}
            return capture, replace(finger, facts=facts, findings=(*finger.findings, *doubt))
    if registered is None:
        return capture, finger
    _check(registered, settings)
    steadied = resampled(capture, finger, registered)
    again = find_finger(steadied, settings)
    facts = {**again.facts, **registered.facts}
    note = Finding(
        "undone-motion",
        f"the finger moved by {{:.2f mm}} between the {where}; that was undone, and the images resampled.",
        lengths_mm=(registered.most_mm,),
    )
    return steadied, replace(again, facts=facts, findings=(note, *again.findings))


def without_moved_side(capture: Capture, finger: Finger) -> tuple[Capture, tuple[Finding, ...]]:
    """The capture, without images lit from the side (as of :func:`without_side_lights`, the white band not yet a mean)
    where the finger lay elsewhere than a matt surface like the others shows, all or some of them, and a warning then.
    """
    measured = []
    numbers = []
    for band in capture.bands.values():
        if band.side is not None:
            pair = {"white": replace(band, name="white"), "white_crossed": replace(band.side, name="white_crossed")}
            found = register(replace(capture, bands=pair), finger, still_white=True)
            shifts = np.array(found.facts["motion_white_crossed"]["shift_mm"])
            towards = _towards(capture, band.side.leds)
            numbers += np.flatnonzero(shifts.any(axis=1)).tolist()  # a shot that went astray has none
            measured.append(np.stack([shifts, towards])[:, shifts.any(axis=1)])
    shifts, towards = np.concatenate(measured, axis=1) if measured else np.zeros((2, 0, 2))
    if len(shifts) < _MEASURED:
        return capture, ()
    apart = _apart_from_lights(shifts, towards)
    known = _SURE * float(np.linalg.norm(apart.std(axis=0, ddof=1))) / np.sqrt(len(apart))
    if np.hypot(*apart.mean(axis=0)) >= max(CORRECT_MM, known):
        bands = {name: replace(band, side=None) for name, band in capture.bands.items()}
        return replace(capture, bands=bands), (Finding("side-moved", SIDE_MOVED),)
    alone = np.hypot(*(apart - np.median(apart, axis=0)).T) > _ALONE_MM
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
    """(L, 2) shifts of images less what they have in common along their lights: shading seems to shift ridges so."""
    centred = towards - towards.mean(axis=0)
    return np.asarray(shifts - (centred * shifts).sum() / max(float((centred * centred).sum()), 1e-9) * towards)


_MEASURED = 3
"""Side images whose shift is known: with fewer, one that all share is not told from one along each light."""
_SURE = 3.0
"""Standard errors of the shift of all side images above which they moved: gloss shifts each by up to 60 um."""
_ALONE_MM = 0.08
"""Shift of one of them against the others beyond which it moved."""
SOME_MOVED = (
    "the finger moved before or after {} of the images lit from the side, left out; rest it on its support and capture "
    "again."
)
SIDE_MOVED = (
    "the finger moved between the images lit from the front and from the side, and those from the side are left out; "
    "rest it on its support and capture again."
)


@dataclass(frozen=True, slots=True, eq=False)
class _Registered:
    flows: dict[str, Flow]
    most_mm: float
    """Largest shift of a shot against the reference, mean over the finger."""
    before: float
    """Fraction of the details that no surface explains: rms over the white shots, as they are."""
    after: float
    """The same with the motion undone."""
    facts: dict[str, Any]
    apart: float = 1.0
    """Variance of the white shots' shifts that is left without shifts along their lights, over all of it."""


def seen_motion_mm(finger: Finger) -> float:
    """Largest motion measured between the shots, but of a crossed series, which :func:`register` compares."""
    found = [0.0]
    for name, figures in finger.quality.items():
        reliable = np.asarray(figures.get("motion_reliability", [])) >= MIN_RELIABILITY
        if name != "white_crossed":
            found += [float(v) for v in np.asarray(figures.get("motion_mm", []))[reliable]]
    return max(found)


def register(capture: Capture, finger: Finger, *, still_white: bool = False) -> _Registered:
    """Registration of the white band, unless `still_white`, of the others to it, and the report's facts on them."""
    px_per_mm = capture.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / WORKING_PX_PER_MM))
    px = px_per_mm / binning
    window = around(capture, finger)
    white = capture.bands["white"]
    coloured = has_colour(white) and capture.material == "skin"
    grey, skin = _light_of(capture, white, window, binning, coloured)
    mask = reduced(finger.wider[window], grey.shape[1:])
    lights = _lights_over(capture, white, window)
    colours = [len(set(names)) for names in white.colours] or 1  # coloured LEDs share a photograph
    shots = np.repeat(np.arange(len(white.pixels)), colours)
    reference = len(white.pixels) // 2
    flows: dict[str, Flow] = {}
    facts: dict[str, Any] = {"motion": {"reference": f"white {reference}"}}
    before = after = np.zeros(1)
    left = 1.0
    flow = still(len(white.pixels), mask, px)
    corner_mm = window[1].start / px_per_mm, window[0].start / px_per_mm
    centre = flow.centre_mm[0] + corner_mm[0], flow.centre_mm[1] + corner_mm[1]
    rows, columns = np.nonzero(mask)
    middle = float(columns.mean()) / px + corner_mm[0], float(rows.mean()) / px + corner_mm[1]
    if not still_white:
        found = register_shots(skin, lights, mask, px, reference=reference, shots=shots)
        flow = found.flow
        before = found.before
        after = found.after
        flows["white"] = replace(flow, centre_mm=centre)
        reported = _motion_facts(flows["white"], middle)
        facts["motion_white"] = reported | {"unexplained_before": _plain(before), "unexplained_after": _plain(after)}
        shifts = np.array(reported["shift_mm"])
        if not white.colours:  # one light a shot
            apart = _apart_from_lights(shifts, _towards(capture, white.lights))
            left = float(apart.var(axis=0).sum() / max(shifts.var(axis=0).sum(), 1e-30))
    for name, band in capture.bands.items():
        crossed = name == "white_crossed"
        if name == "white" or band.colours or (still_white and not crossed):
            continue
        alike, stack = (skin, _light_of(capture, band, window, binning, coloured)[1]) if crossed else (
            grey, linear_stack(band, capture.encoding, "grey", window, binning))  # fmt: skip
        vectors = _lights_over(capture, band, window)
        known = _RegisteredBand(alike, lights, flow, shots)
        other, likeness, likeness_before = _register_band(known, stack, vectors, mask, px)
        moves = other.moves_mm
        if crossed and not coloured:  # gloss shifts each image by itself: their mean is what moved
            moves = np.broadcast_to(moves.mean(axis=0), moves.shape)
        flows[name] = Flow(moves, centre)
        reported = _motion_facts(flows[name], middle)
        reported |= {"likeness_before": _plain(likeness_before), "likeness_after": _plain(likeness)}
        facts[f"motion_{name}"] = reported
    most = max(max(facts[f"motion_{name}"]["moved_mm"]) for name in flows)
    facts["motion"]["most_mm"] = most
    return _Registered(flows, most, _rms(before), _rms(after), facts, left)


def _light_of(
    capture: Capture, band: Band, window: Window, binning: int, coloured: bool
) -> tuple[FloatArray, FloatArray]:
    """(L, h, w) images in grey, and the light in them that came through the skin where colours show it."""
    if not coloured:
        grey = linear_stack(band, capture.encoding, "grey", window, binning)
        return grey, grey
    channels = linear_channels(band, capture.encoding, ("grey", "red", "green", "blue"), window, binning)
    return channels[0], without_glare(channels[1:])


BY_SHADING = 0.1
"""`_Registered.apart` below which shading moved the ridges, and not the finger; a steady drift has two thirds."""


def _worth_undoing(registered: _Registered, seen_mm: float) -> bool:
    """Whether motion was found that is to be undone, or refused; else the images are left as they are."""
    if registered.most_mm < CORRECT_MM or registered.apart < BY_SHADING:
        return False
    if registered.after > MOST_LEFT and seen_mm < WARN_MM:  # no skin, wet skin
        return False
    return registered.after < HELPS * registered.before  # nothing helps where nothing moved, however much is left over


_SWITCH = (
    ", or leave the images as they are with `settings` motion.correct=off (what is not a finger is imported with "
    "`material` opaque)"
)


def _helps(figures: dict[str, Any]) -> bool:
    """Whether a crossed series looks clearly more like the parallel one once its motion is undone; gloss does not."""
    before, after = (1.0 - np.square(figures[f"likeness_{when}"]).mean() for when in ("before", "after"))
    return bool(after < HELPS**2 * before)


def _check(registered: _Registered, settings: FingerSettings) -> None:
    moved = registered.most_mm
    most = settings.motion.most_mm
    remedy = f"rest the finger on its support and capture again{_SWITCH}."
    require(
        moved <= most,
        f"the finger moved by {moved:.2f} mm between the shots, and at most {most:g} mm can be undone; {remedy}",
    )
    require(
        registered.after <= MOST_LEFT,
        "the shots do not fit together: "
        f"{100 * registered.after:.0f} % of their details are left over"
        f" when the motion between them is undone, and at most {100 * MOST_LEFT:.0f} % may be; {remedy}",
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _motion_facts(flow: Flow, middle_mm: tuple[float, float]) -> dict[str, Any]:
    """Shift of the finger's middle (x right, y up) and turn of every shot, for a report."""
    shifts = flow.at(*np.reshape(middle_mm, (2, 1)))[..., 0]
    return {
        "moved_mm": _plain(np.hypot(shifts[:, 0], shifts[:, 1])),
        "shift_mm": (shifts * [1.0, -1.0]).tolist(),
        "turn_deg": _plain(-np.rad2deg(flow.moves_mm[:, 2] / TURN_MM)),
        "centre_mm": list(middle_mm),
    }


def _plain(values: Array) -> list[float]:
    return [round(float(v), 5) for v in values]


def resampled(capture: Capture, finger: Finger, registered: _Registered) -> Capture:
    """The capture with every image taken from where its skin is, once, in the values that are stored."""
    px_per_mm = capture.rig.camera.px_per_mm
    window = around(capture, finger)
    bands = dict(capture.bands)
    for name, flow in registered.flows.items():
        band = bands[name]
        pixels = band.pixels.copy()

        def one(k: int, pixels: Any = pixels, band: Band = band, flow: Flow = flow) -> None:
            if flow.moves_mm[k].any():
                take(band.pixels[k], flow, k, px_per_mm, window, pixels[k])

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(one, range(len(pixels))))
        bands[name] = replace(band, pixels=pixels)
    return replace(capture, bands=bands)


# The part of the images in which motion is looked for and undone: its place, its light, and its pixels elsewhere.

MARGIN_MM = 2.0
"""Beyond the finger, images are left as they are."""


def around(capture: Capture, finger: Finger) -> Window:
    """Rows and columns that hold the finger and what is beside it."""
    margin = round(MARGIN_MM * capture.rig.camera.px_per_mm)
    rows, columns = (
        slice(max(0, part.start - margin), min(side, part.stop + margin))
        for part, side in zip(finger.window, capture.shape, strict=True)
    )
    return rows, columns


def _lights_over(capture: Capture, band: Band, window: Window) -> Array:
    """(L, 3, h, w) light vectors on the finger plane, on nodes about 0.6 mm apart evenly over a window."""
    camera = capture.rig.camera
    rows, columns = (
        np.linspace(part.start, part.stop - 1, max(2, round((part.stop - part.start) * camera.pitch_mm / BLOCK_MM) + 1))
        for part in window
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    places = plane_points(camera, pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
    level = np.zeros(pixels.shape[:2], dtype=np.float32)
    field = light_vectors_at(capture.rig.select(band.lights), places[..., 0], places[..., 1], level)
    return np.asarray(field, dtype=np.float64)


def take(  # noqa: PLR0917
    image: NDArray[Any], flow: Flow, shot: int, px_per_mm: float, window: Window, out: NDArray[Any]
) -> None:
    """Write a shot's image where a window of the reference has its skin, by cubic interpolation, into `out`."""
    place = out[window]
    affine = flow.affine(shot, px_per_mm)
    affine[:, 2] += affine[:, :2] @ np.array([window[1].start, window[0].start], dtype=np.float64)
    size = (place.shape[1], place.shape[0])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(image, affine, size, dst=place, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    if not np.shares_memory(moved, out):
        place[...] = moved.reshape(place.shape)
