"""Whether the camera's values are proportional to the light: colours, tone, local contrast,
clipping.

Under L lights a matt pixel obeys I_k = l_k . b with its albedo times normal b (3 numbers); what is
left over is the same for all pixels where it is a gain of an image. Gains that differ between
colours are the camera's white balance. Gains that follow the stated brightness of the lights are
its tone: where a light twice as bright gives 2^p times the value, the gain of light k is (p - 1)
log(brightness). Under lights of equal brightness the shading of the flanks shows p; values that are
not in proportion to the light also flatten or steepen the whole surface, as the outline shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splitknit.diagnosis.samples import coarse_surface, in_blocks
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import erode
from splitknit.imaging.geometry import refined_peak
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation
from splitknit.photometric.forward import unequal

SWAPPED = (
    "the skin is {:.1f} times as bright in blue as in red, but blood makes it 0.4 to 0.7: the files"
    " seem to hold blue, green, red in this order; swap them, as ridges are hardly measured"
    " otherwise."
)
CLIPPED = (
    "{:.0f} % of the finger is clipped in {} ({}): the surface comes out wrong there and ridges too"
    " low; photograph it again with a shorter exposure."
)
WHITE_BALANCE = (
    "the colour of the light differs from image to image by {:.0f} %, where LEDs of one kind do by"
    " 1 %: the camera seems to have balanced white anew for each, which spoils shape and ridges;"
    " fix its white balance and exposure."
)
TONE = (
    "the photographs are not in proportion to the light, value = light^{:.2f}: a gamma, tone curve,"
    " night mode or local contrast of the camera, haze or light of the room in all images, or a"
    " wrong `encoding` (then below 0.7 or above 1.5); heights are wrong; store RAW or linear"
    " images, and add an ambient one."
)
FLAT = (
    "the finger comes out {:.2f} times as high as it is half wide (0.6 to 1 is usual): local"
    " contrast, a tone curve or night mode of the camera, light of the room or haze has flattened"
    " it, or the LEDs stand elsewhere than stated; store RAW or linear images, and add an ambient"
    " one."
)
DRIFTED = (
    "{}: its LED is {:.0f} % {} than at the calibration, by this capture; photograph the white card"
    " again (splitknit calibrate radiometry)."
)
_EXPONENTS = np.geomspace(0.64, 1.8, 8)  # of shading, that are tried


class Response(NamedTuple):
    """Response of a band's L images to the light."""

    gains: Array
    """(C, L) as of :func:`image_gains`."""
    directions: Array
    """(L, 3) mean direction to each light."""
    brightness: Array
    """(L,) as it is stated: intensity times exposure."""
    files: Sequence[str]


def doubt_of_response(observation: Observation, finger: Finger) -> Finding | None:
    """What is wrong with a camera's response to light, the surest; it is sure where it spoils the
    surface."""
    # pixels of the coarse images' longer side, at least
    every = max(1, max(observation.shape) // 300)
    responses: list[Response] = []
    doubts: list[Finding] = []
    surface: FloatArray | None = None
    for band in observation.bands.values():  # white before NIR
        if band.colours or len(band.lights) < 5:  # fewer do not show it
            continue
        blocks = in_blocks(band, finger.wider, finger.window, every)
        # width of the rim beside the outline that is not used
        core = erode(blocks.inside, 0.6 / (every * observation.rig.camera.pitch_mm))
        if core.sum() < 1000:  # fewer do not show it, in px
            continue
        coloured = band.name == "white" and band.has_colour
        stack = blocks.light.stack if coloured else blocks.light.grey[None]
        light = stack[..., core]
        if doubt := _doubt_of_values(band, light, finger, every):
            return doubt
        if surface is None:
            surface = coarse_surface(stack.sum(axis=0), blocks)
        towards = blocks.lights(surface)[..., core]
        mean = towards.mean(axis=-1)
        strength = np.asarray(np.linalg.norm(mean, axis=1), dtype=np.float64)
        exposure = band.exposure if len(band.exposure) == len(strength) else 1.0
        gains = image_gains(light, towards)
        response = Response(gains, mean / strength[:, None], strength * exposure, band.image_names)
        if (spread := colour_spread(gains)) > _COLOUR_SPREAD:
            odd = int(np.argmax(np.abs(gains - gains.mean(axis=0)).max(axis=0)))
            without = image_gains(np.delete(light, odd, axis=1), np.delete(towards, odd, axis=0))
            sure = colour_spread(without) > _COLOUR_SPREAD
            words = WHITE_BALANCE.format(100 * spread)
            return Finding("white-balance", words, Severity.SPOILS if sure else Severity.DOUBT)
        responses.append(response)
        if coloured:
            equal = np.isnan(tone_exponent(responses)[0])
            exponent = shading_exponent(light[1:], towards) if equal else 1.0
            if not _SHADED_EXPONENTS[0] < exponent < _SHADED_EXPONENTS[1]:
                doubts.append(Finding("tone-curve", TONE.format(exponent), Severity.DOUBT))
            height = height_over_half_width(surface, blocks.inside, blocks.light.pitch_mm)
            # below the first number the finger is not flat but hollow: lights in another order
            if 0.1 < height < _FLAT_FINGER:
                doubts.append(Finding("flat-finger", FLAT.format(height), Severity.DOUBT))
    if not responses:
        return None
    tone, t_value = tone_exponent(responses)
    if abs(tone - 1) > _TONE_DOUBTED and abs(t_value) > _TONE_SURE:
        # departure of the exponent from one that spoils the surface
        severity = Severity.SPOILS if abs(tone - 1) > 0.1 else Severity.DOUBT
        return Finding("tone-curve", TONE.format(tone), severity)
    if "radiometry" in observation.rig.provenance:
        doubts += [doubt for each in responses if (doubt := _drift(each))]
    return doubts[0] if doubts else None


def _drift(response: Response) -> Finding | None:
    drift = drifted_light(response.gains.mean(axis=0), response.directions)
    if drift is None:
        return None
    light, brightness = drift
    file = response.files[light]
    change = "darker" if brightness < 1 else "brighter"
    words = DRIFTED.format(file, 100 * abs(brightness - 1), change)
    return Finding("drifted-led", words, Severity.DOUBT, files=(file,))


_BLUE_OVER_RED = 1.3
"""Blue over red light: at most 0.63; from 1.6 where the colours are swapped. Chosen on: simulated
fingers (180 in all conditions). Range: 0.63 to 1.6."""
_CLIPPED_FINGER = 0.2
"""Fraction of the finger that is clipped in one colour of an image: at most 0.06 (once 0.13); from
0.27 where it is. Chosen on: simulated fingers (180 in all conditions). Range: 0.13 to 0.27."""
_COLOUR_SPREAD = 0.02
"""Standard deviation of the colours' gains: at most 0.001; from 0.037 where white was balanced.
Chosen on: simulated fingers (180 in all conditions). Range: 0.001 to 0.037."""


def _doubt_of_values(band: Light, light: FloatArray, finger: Finger, every: int) -> Finding | None:
    """What colours (C, L, n), or clipping, show."""
    if len(light) == 3 and (blue := blue_over_red(light)) > _BLUE_OVER_RED:
        return Finding("swapped-colours", SWAPPED.format(blue), Severity.SPOILS)
    clipped, image, colour = band.sampled(every).most_clipped(finger.wider[::every, ::every])
    if clipped < _CLIPPED_FINGER:
        return None
    file = band.image_names[image]
    channel = band.channels[colour] if len(light) == 3 else "grey"
    words = CLIPPED.format(100 * clipped, file, channel)
    return Finding("clipped-photograph", words, Severity.DOUBT, files=(file,))


_TONE_DOUBTED = 0.07
"""Departure of the exponent from one that is doubted: 0.03 at most on 126 sound fingers under
unequal lights, 0.12 to 0.75 where a curve or light of 30 % was added. Chosen on: simulated fingers
(126 under unequal lights). Range: 0.03 to 0.12."""
_TONE_SURE = 7.0
"""Least t value of the exponent's departure from one. Chosen on: simulated fingers (126 under
unequal lights)."""
_SHADED_EXPONENTS = (0.86, 1.2)
"""Exponents between which shading under equal lights is sound: 0.87 (wet) to 1.05 on 12 sound
fingers in all conditions. Chosen on: simulated fingers. Range: 0.85 to 0.87, 1.05 to 1.24."""
_FLAT_FINGER = 0.5
"""Height over half width below which a finger is too flat: 0.61 to 1.06 on 144 sound fingers, 0.63
to 0.75 on path-traced ones, 0.34 to 0.45 with local contrast. Chosen on: simulated fingers (144,
and path-traced ones). Range: 0.45 to 0.61."""


def image_gains(stack: FloatArray, vectors: FloatArray) -> Array:
    """Logarithm (C, L) of each image's gain, in each colour, as the forward model explains it,
    beside what a tilt of the surface does: a pattern as the lights' x and y.

    Parameters
    ----------
    stack : (C, L, n)
        Linear light of n pixels in C colours under L lights.
    vectors : (L, 3, n)
        Direction to each light times its irradiance, at each pixel (near lights on a coarse surface
        will do).
    """
    logs = np.array([unequal(light, vectors).gains for light in stack])
    return np.asarray(logs @ _beside_tilt(vectors.mean(axis=-1)))


def colour_spread(gains: Array) -> float:
    """Standard deviation by which the gains (C, L) of :func:`image_gains` differ between colours; 0
    of one colour."""
    return float(np.std(gains - gains.mean(axis=0)))


def tone_exponent(bands: Sequence[Response]) -> tuple[float, float]:
    """Exponent p of the camera's answer to light, value = light^p, fitted to all bands, and its t
    value against p = 1, where brightness is stated to 0.2 % at best; NaN and 0 where the lights are
    too nearly equal."""
    levels = [_beside_tilt(band.directions) @ np.log(band.brightness) for band in bands]
    rests = [band.gains.mean(axis=0) for band in bands]
    freedom = sum(len(rest) - 3 for rest in rests) - 1
    level = np.concatenate(levels)
    rest = np.concatenate(rests)
    square = float(level @ level)
    # sum of squares of the lights' log brightness, beside a tilt's, from which it shows the tone:
    # 0.03 to 0.2 of LEDs that differ by 10 %. Range: up to 0.03
    if square < 0.01 or freedom < 2:
        return float("nan"), 0.0
    slope = float(level @ rest) / square
    residual = rest - slope * level
    # standard deviation of brightness as it is stated, at best, in the logarithm
    return 1.0 + slope, slope / float(np.sqrt((residual @ residual / freedom + 0.002**2) / square))


def _beside_tilt(directions: Array) -> Array:
    """(L, L) projection that takes off what a tilt of the surface, or its albedo, does to gains
    under L lights."""
    basis = np.linalg.qr(np.column_stack([np.ones(len(directions)), directions[:, :2]]))[0]
    return np.asarray(np.eye(len(directions)) - basis @ basis.T)


def drifted_light(gains: Array, directions: Array) -> tuple[int, float] | None:
    """The light (L,) whose brightness alone explains the `gains` of :func:`image_gains`, and its
    relative brightness.

    Beside the patterns of `directions` (L, 3) that a tilt of the surface makes; None where no
    single light has changed.
    """
    beside = _beside_tilt(directions)
    rest = beside @ gains
    freedom = np.diag(beside)
    explained = rest**2 / freedom
    k = int(np.argmax(explained))
    change = float(np.exp(rest[k] / freedom[k]))
    # it explains most of all gains alone: gloss, shadows and scattering move several a little
    sure = explained[k] > 0.75 * float(rest @ rest)
    # change of a light's brightness from which it has drifted
    return (k, change) if sure and abs(change - 1) > 0.03 else None


def shading_exponent(stack: FloatArray, vectors: FloatArray) -> float:
    """The exponent p, value = light^p, at which shading fits matt surfaces best, under equal
    lights.

    Small errors of their brightness are taken out. Parameters as of :func:`image_gains`, in colours
    that scatter little in the skin. Light that is added to all images does not show: it looks like
    a surface that faces the camera.
    """
    logs = np.log(_EXPONENTS)
    best = []
    for light in np.maximum(stack, 1e-4):
        varied = light.std(axis=0) / light.mean(axis=0)
        # quantile of the pixels, by how much they change with the light, from which they show the
        # tone
        flanks = np.flatnonzero(varied > np.quantile(varied, 0.6))
        # about so many pixels of the flanks are fitted
        flanks = flanks[:: max(1, len(flanks) // 700)]
        misfits = [
            p * unequal(light[:, flanks] ** np.float32(1 / p), vectors[..., flanks]).misfit
            for p in _EXPONENTS
        ]
        place = refined_peak(-np.array(misfits), int(np.argmin(misfits)))
        best.append(np.interp(place, np.arange(len(logs)), logs))
    return float(np.exp(np.mean(best)))


def height_over_half_width(height_mm: FloatArray, mask: BoolArray, pitch_mm: float) -> float:
    """How high a finger's surface (h, w) rises over half its width, as half an ellipse across:
    median over its rows.

    NaN where it has no ten rows that are nearly as wide as the widest and end inside the image.
    """
    width = mask.sum(axis=1)
    rows = np.flatnonzero((width > 0.8 * width.max()) & ~mask[:, 0] & ~mask[:, -1])
    ratios = []
    for row in rows[len(rows) // 4 : len(rows) - len(rows) // 4]:
        columns = np.flatnonzero(mask[row])
        half = 0.5 * (columns[-1] - columns[0] + 1)
        across = (columns - 0.5 * (columns[0] + columns[-1])) / half
        # fraction of the half width of a finger, from its axis, on which its height is fitted
        near = np.abs(across) < 0.9
        terms = np.column_stack([np.ones(near.sum()), across[near], np.sqrt(1 - across[near] ** 2)])
        fit = np.linalg.lstsq(terms, height_mm[row, columns[near]].astype(np.float64), rcond=None)[
            0
        ]
        ratios.append(fit[2] / (half * pitch_mm))
    return float(np.median(ratios)) if len(ratios) >= 10 else float("nan")


def blue_over_red(stack: FloatArray) -> float:
    """Median of blue over red light of n pixels, of the light (3, L, n) of all lights together."""
    light = stack.sum(axis=1)
    return float(np.median(light[2]) / max(float(np.median(light[0])), 1e-12))
