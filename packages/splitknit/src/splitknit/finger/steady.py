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

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.finger.locate import Finger, FingerSettings, find_finger, reduced
from splitknit.finger.motion import MIN_RELIABILITY, WARN_MM
from splitknit.finger.registration import (
    REGISTRATION_PX_PER_MM,
    TURN_MM,
    Flow,
    Level,
    bands_of,
    details_of,
    lights_on,
    register_shots,
    robust_weight,
    settled,
    still,
    without_glare,
)
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.pixels import Window
from splitknit.imaging.view import plane_points
from splitknit.model import Array, BoolArray, FloatArray, Rig
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation

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
_CORRECT_MM = 0.02
"""Motion from here on is undone. Still simulated fingers show at most 0.014 mm. Chosen on:
simulated fingers (80 still captures of the population, and seeds 9101 to 9104 that move)."""
_MOST_LEFT = 0.35
"""Fraction of the details that may be left over once the motion is undone, before the shots are
refused. Chosen on: simulated fingers (seeds 9101 to 9104)."""
_MAX_STILL_UNEXPLAINED = 0.95
"""Undoing motion must bring the residual that no surface explains below this fraction of what it
was. Chosen on: simulated fingers (80 still captures of the population, and seeds 9101 to 9104 that
move)."""
_CORRECT_SERIES_MM = 0.01
"""Motion between polarised series in colour from which it is undone. A still path-traced finger
shows 0.004 mm. Chosen on: path-traced fingers (one that lies still)."""


def find_steady_finger(
    observation: Observation, settings: FingerSettings
) -> tuple[Observation, Finger]:
    """Find the finger; where it moved between the shots, undo that first: images are then
    resampled, once, onto the pixels of the reference shot (the middle one of the white band). Where
    it lay still the observation is the same object. Raises BadInput if there is no finger, or it
    moved by more than can be undone.
    """
    finger = find_finger(observation, settings)
    motion = settings.motion
    white = observation.white
    skin = observation.material == "skin"
    measured_mm = [0.0]  # but of a crossed series, which is registered below
    for name, figures in finger.quality.items():
        if name != "white_crossed":
            reliable = np.asarray(figures.get("motion_reliability", [])) >= MIN_RELIABILITY
            measured_mm += np.asarray(figures.get("motion_mm", []))[reliable].tolist()
    suspect = skin and max(measured_mm) >= _CORRECT_MM  # gloss of other things looks like motion
    wanted = motion.correct == "on" or (motion.correct == "auto" and suspect)
    enough = len(white.lights) >= 5 and white.photographs >= 2
    registered = register(observation, finger) if wanted and enough else None
    if (
        registered is not None
        and motion.correct == "auto"
        and not _worth_undoing(registered, max(measured_mm))
    ):
        registered = None
    between = "shots"
    if registered is None and skin and "white_crossed" in observation.bands:
        registered = register(observation, finger, still_white=True)
        between = "parallel and the crossed series"
        # a crossed series looks clearly more like the parallel one once its motion is undone; gloss
        # does not
        figures = registered.facts["motion_white_crossed"]
        before, after = (
            1.0 - np.square(figures[f"likeness_{when}"]).mean() for when in ("before", "after")
        )
        helps = bool(after < _MAX_STILL_UNEXPLAINED**2 * before)
        least_mm = _CORRECT_SERIES_MM if white.has_colour else _CORRECT_MM
        if motion.correct == "off" or registered.most_mm < least_mm or not helps:
            moved = Finding(
                "moved-finger",
                f"the finger moved by {{:.2f mm}} between the {between}.",
                lengths_mm=(registered.most_mm,),
            )
            noted = (moved,) if helps and registered.most_mm >= WARN_MM else ()
            facts = {**finger.facts, **registered.facts}
            return observation, replace(finger, facts=facts, findings=(*finger.findings, *noted))
    if registered is None:
        return observation, finger
    require(
        registered.most_mm <= motion.most_mm,
        f"the finger moved by {registered.most_mm:.2f} mm between the shots, and at most"
        f" {motion.most_mm:g} mm can be undone; {_REMEDY}",
    )
    require(
        registered.after <= _MOST_LEFT,
        f"the shots do not fit together: {100 * registered.after:.0f} % of their details are left"
        f" over when the motion between them is undone, and at most {100 * _MOST_LEFT:.0f} % may"
        f" be; {_REMEDY}",
    )
    observation = _steadied(observation, registered.flows)
    finger = find_finger(observation, settings)
    note = Finding(
        "undone-motion",
        f"the finger moved by {{:.2f mm}} between the {between}; that was undone, and the images"
        " resampled.",
        lengths_mm=(registered.most_mm,),
    )
    facts = {**finger.facts, **registered.facts}
    return observation, replace(finger, facts=facts, findings=(note, *finger.findings))


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
    """Fraction of the variance of the white shots' shifts that remains without shifts along their
    lights."""


_MIN_BESIDE_LIGHTS = 0.1
"""Below this fraction (`apart`) the shifts follow the lights: shading moved the ridges, not the
finger; a steady drift has two thirds. Chosen on: path-traced fingers (one that lies still)."""


def _worth_undoing(registered: _Registered, measured_mm: float) -> bool:
    """Whether motion was found that is to be undone, or refused; else the images are left as they
    are."""
    if registered.most_mm < _CORRECT_MM or registered.apart < _MIN_BESIDE_LIGHTS:
        return False
    if registered.after > _MOST_LEFT and measured_mm < WARN_MM:  # no skin, wet skin
        return False
    # nothing helps where nothing moved, however much is left
    return registered.after < _MAX_STILL_UNEXPLAINED * registered.before


def without_moved_side(
    observation: Observation, finger: Finger
) -> tuple[Observation, tuple[Finding, ...]]:
    """Leave out images lit from the side during which the finger lay elsewhere, all or some of
    them, by comparison with a matt surface that explains the others; and a warning then.
    """
    side = observation.side
    if side is None:
        return observation, ()
    pairs = [(observation.white, replace(side, crossed=None))]
    if side.crossed is not None:
        pairs.append((observation.bands["white_crossed"], side.crossed))
    shifts = np.zeros((0, 2))
    towards = np.zeros((0, 2))
    numbers = []
    for front, beside in pairs:
        bands = {"white": front, "white_crossed": beside}
        registered = register(replace(observation, bands=bands), finger, still_white=True)
        measured = np.array(registered.facts["motion_white_crossed"]["shift_mm"])
        known = measured.any(axis=1)  # a shot that went astray has none
        numbers += np.flatnonzero(known).tolist()
        shifts = np.concatenate([shifts, measured[known]])
        towards = np.concatenate([towards, _towards(beside.rig)[known]])
    # side images whose shift is known: with fewer, a shift common to all is indistinguishable from
    # one along each light
    if len(shifts) < 3:
        return observation, ()
    apart = _apart_from_lights(shifts, towards)
    error_mm = float(np.linalg.norm(apart.std(axis=0, ddof=1))) / np.sqrt(len(apart))
    # standard errors of the shift of all side images above which they moved: gloss shifts each by
    # up to 60 um
    if np.hypot(*apart.mean(axis=0)) >= max(_CORRECT_MM, 3.0 * error_mm):
        return replace(observation, side=None), (Finding("side-moved", SIDE_MOVED),)
    # shift of one of them against the others beyond which it moved
    alone = np.hypot(*(apart - np.median(apart, axis=0)).T) > 0.08
    if not alone.any():
        return observation, ()
    out = {number for number, moved in zip(numbers, alone, strict=True) if moved}
    side = side.of_images([k for k in range(side.photographs) if k not in out])
    return replace(observation, side=side), (Finding("side-moved", SOME_MOVED.format(len(out))),)


def _towards(rig: Rig) -> Array:
    """(L, 2) directions of lights in the plane of the images, x right and y up; of length one."""
    towards = rig.light_vectors()[:, :2]
    return np.asarray(towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9))


def _apart_from_lights(shifts: Array, towards: Array) -> Array:
    """(L, 2) shifts of images less what they have in common along their lights: shading seems to
    shift ridges so."""
    centred = towards - towards.mean(axis=0)
    return np.asarray(
        shifts - (centred * shifts).sum() / max(float((centred * centred).sum()), 1e-9) * towards
    )


def register(observation: Observation, finger: Finger, *, still_white: bool = False) -> _Registered:
    """Registration of the white band, unless `still_white`, of the others to it, and the report's
    facts on them."""
    px_per_mm = observation.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / REGISTRATION_PX_PER_MM))
    px = px_per_mm / binning
    window = bounding_box(finger.wider, round(2.5 * px_per_mm))  # and what is beside it
    white = observation.white
    coloured = white.has_colour and observation.material == "skin"
    grey, skin = _light_through(white.at(binning, window), coloured)
    mask = reduced(finger.wider[window], grey.shape[1:])
    lights = _lights_over(white.rig, window)
    colours = [len(set(names)) for names in white.colours] or 1  # coloured LEDs share a photograph
    shots = np.repeat(np.arange(white.photographs), colours)
    reference = white.photographs // 2
    flow = still(white.photographs, mask, px)
    corner_mm = np.array([part.start for part in window[::-1]]) / px_per_mm
    middle_mm = np.argwhere(mask).mean(axis=0)[::-1] / px + corner_mm
    flows: dict[str, Flow] = {}
    facts: dict[str, Any] = {"motion": {"reference": f"white {reference}"}}

    def report(name: str, moves_mm: Array, **figures: Array) -> Array:
        """Keep a band's flow and its facts; the shifts (L, 2) of the finger's middle, x right and y
        up."""
        flows[name] = Flow(moves_mm, flow.centre_mm + corner_mm)
        shifts = flows[name].at(*middle_mm[:, None])[..., 0]
        figures = {
            "moved_mm": np.linalg.norm(shifts, axis=1),
            "turn_deg": -np.rad2deg(moves_mm[:, 2] / TURN_MM),
            **figures,
        }
        shifts = shifts * [1.0, -1.0]
        facts[f"motion_{name}"] = {
            **{key: np.round(values, 5).tolist() for key, values in figures.items()},
            "shift_mm": shifts.tolist(),
            "centre_mm": middle_mm.tolist(),
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
            beside = _apart_from_lights(shifts, _towards(white.rig))
            apart = float(beside.var(axis=0).sum() / max(shifts.var(axis=0).sum(), 1e-30))
    for name, band in observation.bands.items():
        crossed = name == "white_crossed"
        if name == "white" or band.colours or (still_white and not crossed):
            continue
        known = skin if crossed else grey
        stack = _light_through(band.at(binning, window), coloured and crossed)[1]
        field = _lights_over(band.rig, window)
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
            alone = replace(level, images=level.images[k : k + 1])
            shot = replace(flow, moves_mm=flow.moves_mm[k : k + 1])
            step = partial(_step, level, expected[k])
            moves.append(settled(alone, shot, shots[:1], [0], step, turns).moves_mm)
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
    surface = (np.linalg.pinv(np.moveaxis(before, 2, 0)) @ details.T[..., None])[..., 0]
    return np.asarray((now * surface.T).sum(axis=1), dtype=np.float32)


def _step(level: Level, expected: FloatArray, images: FloatArray, basis: Array) -> Array:
    """(1, M) change of one shot's parameters; `images` (1, 3, N) are its details and their
    derivatives."""
    (sampled,) = images
    power = float((expected * expected * level.weight).sum(dtype=np.float64))
    gain = float((expected * sampled[0] * level.weight).sum(dtype=np.float64)) / max(power, 1e-30)
    residual = sampled[0] - gain * expected
    root = np.sqrt(robust_weight(level, np.sqrt(residual * residual * level.weight)))
    shifts = sampled[1] * basis[:, 0].T + sampled[2] * basis[:, 1].T
    terms = np.concatenate([shifts, -expected[None]]) * root
    normal = terms @ terms.T
    normal += np.diag(1e-6 * np.diag(normal) + 1e-30)
    return np.asarray(-np.linalg.solve(normal, terms @ (residual * root))[None, :-1])


def _light_through(light: Light, coloured: bool) -> tuple[FloatArray, FloatArray]:
    """(L, h, w) images in grey, and the light in them that came through the skin where colours show
    it."""
    if not coloured:
        grey = light.grey
        return grey, grey
    channels = light.grey_and_stack
    return channels[0], without_glare(channels[1:])


def _steadied(observation: Observation, flows: dict[str, Flow]) -> Observation:
    """The observation with every image resampled at the place of its skin."""
    px_per_mm = observation.rig.camera.px_per_mm
    for name, flow in flows.items():
        moves = [
            flow.affine(k, px_per_mm) if move.any() else None
            for k, move in enumerate(flow.moves_mm)
        ]
        observation = observation.with_light(observation.bands[name].moved_by(moves))
    return observation


_LIGHT_PITCH_MM = 0.6
"""Pitch at which the light of near LEDs is computed. Chosen on: simulated fingers (seeds 9101 to
9104). Range: 0.3 to 1.2 (validation/parameters)."""


def _lights_over(rig: Rig, window: Window) -> Array:
    """(L, 3, h, w) light vectors of the rig's lights on the finger plane, on nodes about 0.6 mm
    apart evenly over a window."""
    camera = rig.camera
    rows, columns = (
        np.linspace(
            part.start,
            part.stop - 1,
            max(2, round((part.stop - part.start) * camera.pitch_mm / _LIGHT_PITCH_MM) + 1),
        )
        for part in window
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    places = plane_points(camera, pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
    level = np.zeros(pixels.shape[:2], dtype=np.float32)
    field = light_vectors_at(rig, places[..., 0], places[..., 1], level)
    return np.asarray(field, dtype=np.float64)
