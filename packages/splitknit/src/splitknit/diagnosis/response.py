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

from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import erode
from splitknit.imaging.geometry import refined_peak
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation
from splitknit.photometric.equations import shading, solve
from splitknit.photometric.near_light import pseudo_normals

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
    " wrong `encoding` (then near 0.5 or 2); heights are wrong; store RAW or linear images, and add"
    " an ambient one."
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
_EXPONENTS = np.geomspace(0.55, 1.8, 9)  # of shading, that are tried


class ResponseDoubt(NamedTuple):
    """What is wrong with a camera's response to light."""

    finding: Finding
    sure: bool = True
    """Whether it holds even where the photographs are not in the order of their lights."""


class _Response(NamedTuple):
    """Response of a band's L images to the light."""

    gains: Array
    directions: Array
    brightness: Array
    """(L,) as it is stated."""
    files: Sequence[str]
    exponent: float
    """By shading, in colours."""
    height: float
    """Over half width, in colours."""
    surface: FloatArray
    """(h, w) height in mm on the pixels that are looked at."""


def doubt_of_response(observation: Observation, finger: Finger) -> ResponseDoubt | None:
    """What is wrong with a camera's response to light, the surest."""
    # pixels of the coarse images' longer side, at least
    every = max(1, max(observation.shape) // 300)
    inside = np.zeros(observation.shape, dtype=np.bool_)
    inside[finger.window] = finger.inside
    inside = inside[::every, ::every]
    # width of the rim beside the outline that is not used
    core = erode(inside, 0.6 / (every * observation.rig.camera.pitch_mm))
    responses: list[_Response] = []
    for name in ("white", "nir"):
        band = observation.bands.get(name)
        if (
            band is None
            or band.colours
            or len(band.lights) < 5  # lights from which the response is judged
            or core.sum() < 1000  # pixels of the coarse images from which the response shows, in px
        ):
            continue
        surface = responses[0].surface if responses else None
        response = _response(band, inside, core, every, surface)
        if isinstance(response, ResponseDoubt):
            return response
        responses.append(response)
    if not responses:
        return None
    doubt = _doubt_of_tone(responses)
    if doubt is None and "radiometry" in observation.rig.provenance:
        for response in responses:
            drift = drifted_light(response.gains, response.directions)
            if drift is not None:
                light, brightness = drift
                file = response.files[light]
                change = "darker" if brightness < 1 else "brighter"
                words = DRIFTED.format(file, 100 * abs(brightness - 1), change)
                finding = Finding("drifted-led", words, Severity.DOUBT, files=(file,))
                return ResponseDoubt(finding, False)
    return doubt


_BLUE_OVER_RED = 1.3
"""Blue over red light: at most 0.63; from 1.6 where the colours are swapped. Chosen on: simulated
fingers (180 in all conditions). Range: 0.63 to 1.6."""
_CLIPPED_FINGER = 0.2
"""Fraction of the finger that is clipped in one colour of an image: at most 0.06 (once 0.13); from
0.27 where it is. Chosen on: simulated fingers (180 in all conditions). Range: 0.13 to 0.27."""
_COLOUR_SPREAD = 0.02
"""Standard deviation of the colours' gains: at most 0.001; from 0.037 where white was balanced.
Chosen on: simulated fingers (180 in all conditions). Range: 0.001 to 0.037."""


def _response(
    band: Light, inside: BoolArray, core: BoolArray, every: int, surface: FloatArray | None
) -> _Response | ResponseDoubt:
    """How a band's images answer to the light; a doubt where their colours or clipping show that
    they do not. `surface`: as another band shows it."""
    coloured = band.name == "white" and band.has_colour
    channels = band.channels if coloured else ("grey",)
    sampled = band.sampled(every)
    stack = sampled.stack if coloured else sampled.grey[None]
    light = stack[..., core]
    if coloured and (blue := blue_over_red(light)) > _BLUE_OVER_RED:
        return ResponseDoubt(Finding("swapped-colours", SWAPPED.format(blue), Severity.SPOILS))
    clipped, image, colour = sampled.most_clipped(inside)
    if clipped > _CLIPPED_FINGER:
        file = band.image_names[image]
        words = CLIPPED.format(100 * clipped, file, channels[colour] if coloured else "grey")
        return ResponseDoubt(Finding("clipped-photograph", words, Severity.DOUBT, files=(file,)))
    view = view_of(band.built.camera, along_rays=True)
    pixels = (np.s_[::every],) * view.x_mm.ndim
    view = View(view.x_mm[pixels], view.y_mm[pixels], view.apex_mm, view.along_rays)
    if surface is None:
        surface = _coarse_surface(stack.sum(axis=0), sampled, inside, view)
    points = view.points(surface + _RESPONSE_PLANE_MM)
    vectors = view.turned(light_vectors_at(band.rig, *points))
    towards = vectors[..., core]
    gains = image_gains(light, towards)
    if (spread := colour_spread(gains)) > _COLOUR_SPREAD:
        odd = int(np.argmax(np.abs(gains - gains.mean(axis=0)).max(axis=0)))
        without = image_gains(np.delete(light, odd, axis=1), np.delete(towards, odd, axis=0))
        finding = Finding("white-balance", WHITE_BALANCE.format(100 * spread), Severity.SPOILS)
        return ResponseDoubt(finding, colour_spread(without) > _COLOUR_SPREAD)
    mean = towards.mean(axis=-1)
    strength = np.linalg.norm(mean, axis=1)
    return _Response(
        gains.mean(axis=0),
        mean / strength[:, None],
        strength * (band.exposure if len(band.exposure) == len(strength) else 1.0),
        band.image_names,
        shading_exponent(light[1:], towards) if coloured else float("nan"),
        height_over_half_width(surface, inside, sampled.pitch_mm) if coloured else float("nan"),
        surface,
    )


_TONE_DOUBTED = 0.07
"""Departure of the exponent from one that is doubted: 0.03 at most on 126 sound fingers under
unequal lights, 0.12 to 0.75 where a curve or light of 30 % was added. Chosen on: simulated fingers
(126 under unequal lights). Range: 0.03 to 0.12."""
_TONE_SURE = 7.0
"""Least t value of the exponent's departure from one. Chosen on: simulated fingers (126 under
unequal lights)."""
_SHADED_EXPONENTS = (0.85, 1.22)
"""Exponents between which shading under equal lights is sound. Chosen on: simulated fingers (180 in
all conditions)."""
_FLAT_FINGER = 0.5
"""Height over half width below which a finger is too flat: 0.61 to 1.06 on 144 sound fingers, 0.63
to 0.75 on path-traced ones, 0.34 to 0.45 with local contrast. Chosen on: simulated fingers (144,
and path-traced ones). Range: 0.45 to 0.61."""


def _doubt_of_tone(responses: Sequence[_Response]) -> ResponseDoubt | None:
    """What contradicts a linear response: the lights' stated brightness, else shading, else the
    finger's height."""
    tone, sure = tone_exponent([response[:3] for response in responses])
    if abs(tone - 1) > _TONE_DOUBTED and abs(sure) > _TONE_SURE:
        # departure of the exponent from one that spoils the surface
        severity = Severity.SPOILS if abs(tone - 1) > 0.1 else Severity.DOUBT
        return ResponseDoubt(Finding("tone-curve", TONE.format(tone), severity))
    exponent = responses[0].exponent
    if np.isnan(tone) and (exponent < _SHADED_EXPONENTS[0] or exponent > _SHADED_EXPONENTS[1]):
        return ResponseDoubt(Finding("tone-curve", TONE.format(exponent), Severity.DOUBT), False)
    # height over half width below which the finger is not flat but hollow: lights in another order
    if 0.1 < responses[0].height < _FLAT_FINGER:
        return ResponseDoubt(
            Finding("flat-finger", FLAT.format(responses[0].height), Severity.DOUBT), False
        )
    return None


_RESPONSE_PLANE_MM = 1.0  # mean height of the skin above the finger plane, about


def _coarse_surface(stack: FloatArray, sampled: Light, inside: BoolArray, view: View) -> FloatArray:
    """Height (h, w) in mm by near-light photometric stereo."""
    height_mm = np.zeros(inside.shape, dtype=np.float32)
    for _ in range(2):
        g = pseudo_normals(stack, sampled.rig, height_mm + _RESPONSE_PLANE_MM, inside, view=view)
        z = np.maximum(g[..., 2], 0.15 * np.sqrt((g * g).sum(axis=-1)) + 1e-9)
        height = poisson(-g[..., 0] / z, -g[..., 1] / z, inside) * sampled.pitch_mm
        height_mm = np.nan_to_num(height).astype(np.float32)
    return height_mm


def image_gains(stack: FloatArray, vectors: FloatArray) -> Array:
    """Logarithm (C, L) of each image's gain, in each colour, over what least squares predicts of
    it; mean 0 by colour.

    Parameters
    ----------
    stack : (C, L, n)
        Linear light of n pixels in C colours under L lights.
    vectors : (L, 3, n)
        Direction to each light times its irradiance, at each pixel (near lights on a coarse surface
        will do).

    Returns
    -------
    (C, L)
        NaN where too few pixels are lit. A pattern as the lights' x and y is seen as a tilt of the
        surface, not here.

    References
    ----------
    Y. Queau et al., "LED-based photometric stereo", JMIV 60 (2018), eq. 2.5, for the pixel's
    equations.
    """
    gains = np.full((len(stack), len(vectors)), np.nan)
    for row, light in zip(gains, stack, strict=True):
        predicted, lit = _fitted(light, vectors)
        # fraction of a pixel's brightest light from which a light's gain is judged: below, attached
        # shadows and light scattered in the skin matter more
        judged = lit & (predicted > 0.5 * predicted.max(axis=0)) & (light > 0)
        # pixels, at least, of which a gain is the median, in px
        for k in np.flatnonzero(judged.sum(axis=1) >= 100):
            row[k] = np.median(np.log(light[k, judged[k]] / predicted[k, judged[k]]))
    return np.asarray(gains - gains.mean(axis=1, keepdims=True))


def _fitted(light: FloatArray, vectors: FloatArray) -> tuple[FloatArray, BoolArray]:
    """What least squares predicts of light (L, n), and where it counts."""
    # fraction of a pixel's brightest light from which a light counts in its fit
    lit = light > 0.3 * light.max(axis=0)
    return shading(solve(light, vectors, lit.astype(np.float32)), vectors), lit


def colour_spread(gains: Array) -> float:
    """Standard deviation by which the gains (C, L) of :func:`image_gains` differ between colours; 0
    of one colour."""
    return float(np.std(gains - gains.mean(axis=0))) if np.isfinite(gains).all() else 0.0


def tone_exponent(bands: Sequence[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Exponent p of the camera's answer to light, value = light^p, and its t value against p = 1.

    Parameters
    ----------
    bands : of (gains, directions, brightness)
        (L,) gains as of :func:`image_gains`; (L, 3) directions to the lights; (L,) brightness of
        their images as it is stated: intensity times exposure. One p is fitted to all bands.

    Returns
    -------
    p, t
        Its t value against p = 1, where brightness is stated to 0.2 % at best; NaN and 0 where the
        lights are too nearly equal.
    """
    levels = [np.zeros(0)]
    rests = [np.zeros(0)]
    freedom = -1
    for gains, directions, brightness in bands:
        if len(gains) >= 5 and np.isfinite(gains).all():
            beside = _beside_tilt(directions)
            levels.append(beside @ np.log(brightness))
            rests.append(beside @ gains)
            freedom += len(gains) - 3
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
    change = float(rest[k] / freedom[k])
    total = float(rest @ rest)
    error = np.sqrt((total - explained[k]) / max(len(gains) - 4, 1) / freedom[k])
    # it explains most of all gains alone (gloss, shadows and scattering move several a little), by
    # three standard errors
    sure = explained[k] > 0.6 * total and abs(change) > 3.0 * error  # not where gains are NaN
    # change of a light's brightness from which it has drifted
    return (k, float(np.exp(change))) if sure and abs(np.expm1(change)) > 0.03 else None


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
        residuals = [
            _residual(light[:, flanks] ** np.float32(1 / p), vectors[..., flanks]) * p
            for p in _EXPONENTS
        ]
        place = refined_peak(-np.array(residuals), int(np.argmin(residuals)))
        best.append(np.interp(place, np.arange(len(logs)), logs))
    return float(np.exp(np.mean(best)))


def _residual(light: FloatArray, vectors: FloatArray) -> float:
    """Median of each pixel's residual, relative to its light, once every image has its own gain."""
    gains = np.nan_to_num(image_gains(light[None], vectors)[0])
    equal = light / np.exp(gains).astype(np.float32)[:, None]
    predicted, lit = _fitted(equal, vectors)
    residual = (equal - predicted) * lit / np.maximum(predicted.mean(axis=0), 1e-6)
    return float(np.median(np.sqrt((residual**2).sum(axis=0) / np.maximum(lit.sum(axis=0) - 3, 1))))


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
