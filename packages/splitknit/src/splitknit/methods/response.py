"""Doubts of the camera's response to light in photographs of skin, by :mod:`splitknit.diagnosis.response`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splitknit.diagnosis.response import (
    blue_over_red,
    clipped_part,
    colour_spread,
    drifted_light,
    height_over_half_width,
    image_gains,
    shading_exponent,
    tone_exponent,
)
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import erode
from splitknit.imaging.band import has_colour, linear_channels
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.integration.poisson import poisson
from splitknit.model import Array, Band, BoolArray, Capture, FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.photometric.uncalibrated import bas_relief_of

SWAPPED = (
    "the skin is {:.1f} times as bright in blue as in red, but blood makes it 0.4 to 0.7: the files seem to hold blue, "
    "green, red in this order; swap them, as ridges are hardly measured otherwise."
)
CLIPPED = (
    "{:.0f} % of the finger is clipped in {} ({}): the surface comes out wrong there and ridges too low; photograph it "
    "again with a shorter exposure."
)
WHITE_BALANCE = (
    "the colour of the light differs from image to image by {:.0f} %, where LEDs of one kind do by 1 %: the camera "
    "seems to have balanced white anew for each, which spoils shape and ridges; fix its white balance and exposure."
)
ENCODING = (
    "the photographs do not fit their lights as they are declared, {} (`encoding`), but as {}: check how they were "
    "stored (a tone curve or local contrast of the camera looks alike); heights are wrong otherwise."
)
TONE = (
    "the photographs are not in proportion to the light, value = light^{:.2f}: a gamma, tone curve, night mode or "
    "local contrast of the camera, or haze or light of the room in all images; heights are wrong; store RAW or linear "
    "images, and add an ambient one."
)
FLAT = (
    "the finger comes out {:.2f} times as high as it is half wide (0.6 to 1 is usual): local contrast, a tone curve or "
    "night mode of the camera, light of the room or haze has flattened it, or the LEDs stand elsewhere than stated; "
    "store RAW or linear images, and add an ambient one."
)
DRIFTED = (
    "{}: its LED is {:.0f} % {} than at the calibration, by this capture; photograph the white card again (splitknit "
    "calibrate radiometry)."
)
_BLUE, _CLIPPED, _COLOURS = 1.3, 0.2, 0.02
"""Blue over red light, part of the finger that is clipped in one colour of an image, and standard deviation of the
colours' gains, from which they are doubted: at most 0.63, 0.06 (once 0.13), 0.001 on 180 sound fingers in all
conditions (dry, wet, scarred, glossy ...); from 1.6, 0.27 and 0.037 where they are wrong."""
_TONE, _TONE_SPOILS, _SURE = 0.07, 0.1, 7.0
"""Departure of the exponent from one that is doubted, and that spoils the surface: 0.03 at most on 126 sound fingers
under unequal lights, 0.12 to 0.75 where a curve or light of 30 % was added; its least t value."""
_SHADED = 0.85, 1.22
"""Exponents between which shading under equal lights is sound."""
_FLAT, _HOLLOW = 0.5, 0.1
"""Height over half width below which a finger is too flat, and is none (lights in another order): 0.61 to 1.06 on 144
sound fingers, 0.63 to 0.75 on path-traced ones, 0.34 to 0.45 with local contrast."""
_SIDE = 300
"""Pixels of the coarse images' longer side, at least."""
_DEPTH_MM, _PLANE_MM = 0.6, 1.0
"""Beside the outline, which is not used; mean height of the skin above the finger plane, about."""
_FEWEST_LIGHTS, _FEWEST = 5, 1000
"""Lights, and pixels of the coarse images, from which the response shows."""


@dataclass(frozen=True, slots=True)
class ResponseDoubt:
    """What is wrong with a camera's response to light."""

    finding: Finding
    sure: bool = True
    """Whether it holds even where the photographs are not in the order of their lights."""


def doubt_of_response(capture: Capture, finger: Finger, others: bool = True) -> ResponseDoubt | None:
    """What is wrong with a camera's response to light; the surest first. `others`: whether to try other encodings."""
    every = max(1, max(capture.shape) // _SIDE)
    inside = np.zeros(capture.shape, dtype=np.bool_)
    inside[finger.window] = finger.inside
    inside = inside[::every, ::every]
    core = erode(inside, _DEPTH_MM / (every * capture.rig.camera.pitch_mm))
    toned, names, found = [], [], list[ResponseDoubt]()
    exponent, height = float("nan"), float("nan")
    for name in ("white", "nir"):
        band = capture.bands.get(name)
        if band is None or band.colours or len(band.lights) < _FEWEST_LIGHTS or core.sum() < _FEWEST:
            continue
        coloured, some = name == "white" and has_colour(band), band.sampled(every)
        stack = linear_channels(some, capture.encoding, ("red", "green", "blue") if coloured else ("grey",))
        if coloured and (blue := blue_over_red(stack[..., core])) > _BLUE:
            found.append(ResponseDoubt(Finding("swapped-colours", SWAPPED.format(blue), Severity.SPOILS)))
        part, image, colour = clipped_part(some.pixels[:, inside])
        if part > _CLIPPED:
            channel = ("red", "green", "blue")[colour] if coloured else "grey"
            name_of = band.image_names[image]
            words = CLIPPED.format(100 * part, name_of, channel)
            found.append(ResponseDoubt(Finding("clipped-photograph", words, Severity.DOUBT, files=(name_of,))))
        surface, vectors = _coarse_surface(stack.sum(axis=0), capture, band, inside, every)
        gains, at = image_gains(stack[..., core], vectors[..., core]), vectors[..., core].mean(axis=-1)
        if (spread := colour_spread(gains)) > _COLOURS:
            odd = int(np.argmax(np.abs(gains - gains.mean(axis=0)).max(axis=0)))
            light, towards = np.delete(stack, odd, axis=1), np.delete(vectors, odd, axis=0)
            others_too = colour_spread(image_gains(light[..., core], towards[..., core])) > _COLOURS
            words = WHITE_BALANCE.format(100 * spread)
            found.append(ResponseDoubt(Finding("white-balance", words, Severity.SPOILS), others_too))
        strength = np.linalg.norm(at, axis=1)
        level = strength * (band.exposure if len(band.exposure) == len(strength) else 1.0)
        toned.append((gains.mean(axis=0), at / strength[:, None], level))
        names.append(band.image_names)
        if coloured:
            exponent = shading_exponent(stack[1:][..., core], vectors[..., core])
            height = height_over_half_width(surface, inside, every * capture.rig.camera.pitch_mm)
    if found or not toned or bas_relief_of(capture.rig) is not None:  # lights that were estimated fit any tone
        return found[0] if found else None
    doubt, (tone, sure) = None, tone_exponent(toned)
    if abs(tone - 1) > _TONE and (abs(sure) > _SURE or not others):  # another encoding must fit well
        severity = Severity.SPOILS if abs(tone - 1) > _TONE_SPOILS else Severity.DOUBT
        doubt = ResponseDoubt(Finding("tone-curve", TONE.format(tone), severity))
    elif np.isnan(tone) and not (np.isnan(exponent) or _SHADED[0] < exponent < _SHADED[1]):
        doubt = ResponseDoubt(Finding("tone-curve", TONE.format(exponent), Severity.DOUBT), False)
    elif _HOLLOW < height < _FLAT:
        doubt = ResponseDoubt(Finding("flat-finger", FLAT.format(height), Severity.DOUBT), False)
    if doubt is not None and others:
        other = "linear" if capture.encoding == "srgb" else "srgb"
        if doubt_of_response(replace(capture, encoding=other), finger, others=False) is None:
            words = ENCODING.format(capture.encoding, other)
            return replace(doubt, finding=replace(doubt.finding, code="other-encoding", message=words))
    return doubt or (_doubt_of_drift(names, toned) if "radiometry" in capture.rig.provenance else None)


def _doubt_of_drift(names: list[tuple[str, ...]], toned: list[tuple[Array, Array, Array]]) -> ResponseDoubt | None:
    """Whether the brightness of one LED is no longer that of the rig's calibration."""
    for files, (gains, directions, _) in zip(names, toned, strict=True):
        drift = drifted_light(gains, directions) if np.isfinite(gains).all() else None
        if drift is not None:
            percent, word = 100 * abs(drift[1] - 1), "darker" if drift[1] < 1 else "brighter"
            file = files[drift[0]]
            words = DRIFTED.format(file, percent, word)
            return ResponseDoubt(Finding("drifted-led", words, Severity.DOUBT, files=(file,)), False)
    return None


def _coarse_surface(
    stack: FloatArray, capture: Capture, band: Band, inside: BoolArray, every: int
) -> tuple[FloatArray, FloatArray]:
    """Height (h, w) in mm by near-light photometric stereo, and light vectors (L, 3, h, w) on it."""
    camera, rig = capture.rig.camera, capture.rig.select(band.lights)
    view = view_of(camera, along_rays=True)
    step = np.s_[::every]
    pixels = step if view.x_mm.ndim == 1 else (step, step)
    view = View(view.x_mm[pixels], view.y_mm[pixels], view.apex_mm, view.along_rays)
    height_mm = np.zeros(inside.shape, dtype=np.float32)
    for _ in range(2):
        g = pseudo_normals(stack, rig, height_mm + _PLANE_MM, inside, view=view)
        z = np.maximum(g[..., 2], 0.15 * np.sqrt((g * g).sum(axis=-1)) + 1e-9)
        height = poisson(-g[..., 0] / z, -g[..., 1] / z, inside) * (every * camera.pitch_mm)
        height_mm = np.nan_to_num(height).astype(np.float32)
    points = view.points(height_mm + _PLANE_MM)
    return height_mm, view.turned(light_vectors_at(rig, *points))
