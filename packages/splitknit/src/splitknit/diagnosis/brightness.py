"""Whether the lights of an opaque thing are as bright, and its photographs encoded, as is stated or
assumed: hypotheses of the forward model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from splitknit.diagnosis.response import TONE
from splitknit.diagnosis.samples import LEAST_PHOTOGRAPHS, in_blocks, median_angle_deg
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.robust import deviation
from splitknit.model import Array, FloatArray
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation
from splitknit.photometric.equations import length, shading
from splitknit.photometric.forward import (
    GLOSS_LEAVES,
    LEAST_MISFIT,
    Explanation,
    hypotheses,
    matt_misfit,
    misfits_by_light,
)


@dataclass(frozen=True, slots=True)
class Limits:
    """When a hypothesis is taken instead of equal lights, or of the stated encoding."""

    places: int = 1600  # of the object, to which hypotheses are fitted
    fewest: int = 200
    better: float = 2.5  # misfit under equal lights over that under unequal ones, at least
    spread: float = 0.04  # of the logarithm of brightness, up to which lights count as equal
    lamps: float = 0.085
    """The logarithm of `better` times `spread` from which lights are unequal, gloss free in both:
    0.094 to 0.5 on most things under lamps that differ by 12 %, up to 0.074 (a satin ring) under
    equal ones, but 0.091 (spread 0.038) on a satin bowl. Source: 59 sets of validation/objects."""
    no_lamps: float = 0.5  # spread that is no longer lamps': a surface that faces one way has 0.75
    unexplained: float = 0.25
    """Misfit from which lights are doubted: up to 0.05 on DiLiGenT's ball and bear and on rendered
    objects, 0.20 on a rough fossil under raking lights, 0.2 to 0.4 where lights are shifted or
    permuted. Metal may leave 0.3 under the right ones."""
    sure: float = 0.01
    """Misfit under unequal lights up to which differences of any size are taken out. Above it they
    are taken out unasked only within `several_fold` and `turned_deg`."""
    several_fold: float = 3.0  # brightest over dimmest lamp
    turned_deg: float = 10.0  # turn of the normals of a matt surface, median
    odd: float = 0.5
    """Logarithm of one lamp's brightness over the others', from which it is taken out alone: up to
    0.27 on DiLiGenT's bear and ball, whose other lamps agree within 0.01."""
    agreeing: float = 0.05  # robust deviation of the other lamps' logarithms, at most
    odd_misfit: float = 0.05  # with it taken out, at most: a raking light of a rough fossil has 0.2
    alike: float = 1.3  # misfit of unequal lights over that of gloss up to which both are possible
    simpler: float = 1.5
    """Misfit without gloss over that with it up to which there is none."""
    matt: float = 0.01  # misfit of a matt surface: noise leaves 0.001 to 0.005 of rendered ones
    responds: float = 2.5
    """Misfit, gloss free, as photographs are stated to be stored over that of a matt surface under
    another response of the camera; sound gloss and metal reach 2.3. Source: validation/objects."""
    curved: float = 4.0  # the same of another encoding, where it is sure
    other_light: float = 2.6
    """Misfit of a photograph under its own light over that under another one's, where it is under
    the other: 3.9 to 105 where it is, 2.9 where all lights are stated 12 deg too high, up to 2.3
    where not (DiLiGenT's bear and ball; rendered coins under 32 near lights)."""
    ambient: float = 0.06
    """Light of places that face away from the lamp, over the full light: up to 0.03 on twelve
    things, photographed and rendered, 0.08 to 0.22 with light of the room of 15 %."""
    shines: float = 0.4
    """Misfit with gloss over that without it below which it shines where a matt surface faces away:
    0.02 to 0.26 on rendered metal, which has up to 0.16 of its light there, 0.5 to 1 on others."""
    assumed: float = 1.9
    """Photographs count as linear light from this ratio of misfits, as sRGB (assumed) over as
    linear light: 24 of 31 things stored as linear light reach it, metal among them, and 1 of 31
    stored as sRGB, a steel coin (validation/objects, encoding)."""


LIMITS: Final = Limits()
_EXPONENTS = (0.5, 0.6, 0.7, 0.8, 0.9)
"""Tone curves, value = light^p, that are tried: cameras brighten what is dark, and gloss looks like
a larger exponent."""
_AMBIENT = (0.02, 0.05, 0.1, 0.15, 0.2)  # light of no lamp over the object's bright light, tried
_RAISED_DEG = (-15, -10, -5, 5, 10, 15)  # by which all lights are raised, tried
SLANT = (
    "the object is matt if all lights stand {:+} deg higher than stated: heights are wrong; check"
    " the lights' directions, such as the outline of the ball that gave them."
)
OTHER_ENCODING = (
    "the photographs shade as {0}, not as {1}: heights are wrong by a factor of about two; give"
    " `encoding` {0}."
)
AMBIENT = (
    "about {:.0f} % of the object's bright light comes from no lamp of the list: light of the room,"
    " haze, or a black level that was not taken off; slopes come out too small; give an image"
    " without any lamp (`background`), or darken the room."
)
UNEXPLAINED = (
    "the photographs do not fit the lights they are given: {:.0f} % of the light (rms) is explained"
    " neither by a matt nor by a glossy surface under these lights (up to 5 % is usual); check the"
    " order and directions of the lights, `encoding` and `background`, and that the mask holds the"
    " object alone."
)


def sampled(band: Light, finger: Finger) -> tuple[FloatArray, FloatArray]:
    """Light (1 + C, L, n) of some places of an object, grey before its channels, zero where it is
    clipped; and the lights (L, 3, n) there, in the pixels' own frames."""
    every = max(1, math.ceil(math.sqrt(finger.inside.sum() / LIMITS.places)))
    light, inside, _ = blocks = in_blocks(band, finger.wider, finger.window, every)
    values = light.grey_and_stack
    values[:, values[0] >= band.clips_at[:, None, None]] = 0.0
    flat = np.zeros(inside.shape, dtype=np.float32)
    return values[..., inside], blocks.lights(flat)[..., inside]


def with_equal_lights(band: Light, finger: Finger) -> tuple[Light, dict[str, Any], list[Finding]]:
    """The white band of an opaque object whose images are divided by the brightness of their
    lights, in each colour, where nobody stated it and it is clearly unequal; facts and findings. A
    doubt instead where it was stated otherwise, or where no hypothesis explains the photographs.
    """
    if len(band.lights) <= LEAST_PHOTOGRAPHS:
        return band, {}, []
    rig = band.rig
    values, lights = sampled(band, finger)
    grey, colours = values[0], values[1:]
    if grey.shape[1] < LIMITS.fewest:
        return band, {}, []
    fits = hypotheses(grey, lights)
    facts: dict[str, Any] = {"matt_misfit": round(fits["matt"].misfit, 4)}
    doubts = _light_everywhere(fits, grey, lights)
    left = min(fits["matt"].misfit, fits["glossy"].misfit)
    doubts = doubts or _matt_otherwise(band, finger, grey, lights, left)
    doubts += _other_lights(fits["matt"], grey, lights, band.image_names)
    if band.flattened or doubts:
        return band, facts, doubts
    equal, unequal = _fitting(fits, "matt", "glossy"), _fitting(fits, "unequal", "both")
    spread = float(unequal.gains.std())
    clear = _differ(equal, unequal)
    asked = rig.provenance.get("intensities") == "estimate"
    lamps = unequal.gains - np.median(unequal.gains)
    odd = np.abs(lamps) > LIMITS.odd
    alone = odd.any() and deviation(lamps) < LIMITS.agreeing
    if not asked and alone and unequal.misfit < LIMITS.odd_misfit:
        clear, lamps = True, np.where(odd, lamps, 0.0)
    if not (asked or clear):
        return band, facts, _unexplained(fits, equal, rig.intensities_assumed)
    gains = np.exp(lamps.astype(np.float64))
    relative = gains / gains.mean()
    turned_deg = median_angle_deg(fits["matt"].normals.T, unequal.normals.T)
    effect = f"which turns the surface by {turned_deg:.1f} deg (median)"
    far = turned_deg > LIMITS.turned_deg or gains.max() > LIMITS.several_fold * gains.min()
    far &= unequal.misfit > LIMITS.sure
    if not rig.intensities_assumed or (far and not asked):
        listed = gains * [led.intensity for led in rig.leds]
        stated = "taken as equal" if rig.intensities_assumed else "stated"
        words = (
            f"the lights are not as bright as is {stated}: they seem to differ from it by"
            f" {100 * spread:.0f} %, {effect}, which was not taken out; give `brightness` estimate,"
            " or as fourth numbers of the list (`intensities`), in its order:"
            f" {' '.join(f'{each:.3f}' for each in listed / listed.mean())}."
        )
        doubt = Finding("unequal-lights", words, Severity.DOUBT, effect_deg=turned_deg)
        return band, facts, [doubt]
    each = "; ".join(
        f"{name} {gain:.2f}" for name, gain in zip(band.image_names, relative, strict=True)
    )
    words = (
        f"the lights differ in brightness, {effect}; that was estimated with the surface and taken"
        f" out: {each}."
    )
    severity = Severity.NOTE
    if not clear:
        severity = Severity.DOUBT
        words = (
            f"the brightness of the lights was estimated and taken out as was asked, {effect}, but"
            f" the photographs do not show it clearly; shine and shadow look so too: {each}."
        )
    facts["light_brightness"] = [round(float(gain), 3) for gain in relative]
    facts["matt_misfit"] = round(fits["unequal"].misfit, 4)
    finding = Finding("estimated-brightness", words, severity, effect_deg=turned_deg)
    return band.divided_by(gains[:, None] * _of_colours(grey, colours)), facts, [finding]


def _light_everywhere(
    fits: dict[str, Explanation], grey: FloatArray, lights: FloatArray
) -> list[Finding]:
    """A doubt where an object is bright, too, where it faces away from the lamp: no lamp shines
    there, and a fit takes light of the room for a surface that faces the camera."""
    matt = fits["matt"]
    away = shading(matt.normals, lights) < -0.05  # cosine of incidence
    shines = fits["glossy"].misfit < LIMITS.shines * matt.misfit
    if shines or matt.misfit > LIMITS.unexplained or away.sum() < 50:
        return []
    ambient = float(np.median((grey / np.maximum(np.quantile(grey, 0.9, axis=0), 1e-12))[away]))
    if ambient < LIMITS.ambient:
        return []
    return [Finding("ambient-light", AMBIENT.format(100 * ambient), Severity.DOUBT)]


def _matt_otherwise(
    band: Light, finger: Finger, grey: FloatArray, lights: FloatArray, stated: float
) -> list[Finding]:
    """A doubt where an object is clearly not matt as is stated, but is if its photographs were
    stored otherwise, hold light of the room, or all lights stand higher or lower.

    The light of what is not matt is not in proportion to the cosine either, so that its shading
    does not show how it was stored.
    """
    if band.flattened or band.colours or stated < LIMITS.responds * LEAST_MISFIT:
        return []
    other: Literal["linear", "srgb"] = "linear" if band.encoding == "srgb" else "srgb"
    misfit = matt_misfit(sampled(band.as_if_stored(other), finger)[0][0], lights)
    if misfit < LIMITS.matt and stated > LIMITS.curved * misfit:
        words = OTHER_ENCODING.format(other, band.encoding)
        return [Finding("other-encoding", words, Severity.SPOILS)]
    light = np.maximum(grey, 0.0)
    bright = np.quantile(light, 0.9)
    tried = [
        (p * matt_misfit(light ** np.float32(1 / p), lights), "tone-curve", TONE.format(p))
        for p in _EXPONENTS
    ]
    tried += [
        (matt_misfit(light - part * bright, lights), "ambient-light", AMBIENT.format(100 * part))
        for part in _AMBIENT
    ]
    tried += [
        (matt_misfit(light, _raised(lights, deg)), "light-residual", SLANT.format(deg))
        for deg in _RAISED_DEG
    ]
    misfit, code, words = min(tried)
    if misfit > LIMITS.matt or stated < LIMITS.responds * misfit:
        return []
    return [Finding(code, words, Severity.DOUBT)]


def _raised(lights: FloatArray, deg: float) -> FloatArray:
    """Lights (L, 3, n) that stand `deg` higher."""
    across = np.hypot(lights[:, 0], lights[:, 1])
    up = np.clip(np.arctan2(lights[:, 2], across) + np.deg2rad(deg), 0.03, 1.54)
    level = np.cos(up) / np.maximum(across, 1e-9)
    turned = np.stack([level * lights[:, 0], level * lights[:, 1], np.sin(up)], axis=1)
    return np.asarray(turned * length(np.moveaxis(lights, 1, 0))[:, None], dtype=np.float32)


def _other_lights(
    matt: Explanation, grey: FloatArray, lights: FloatArray, names: Sequence[str]
) -> list[Finding]:
    """A doubt where a photograph fits the light of another one far better than its own."""
    if matt.misfit > LIMITS.unexplained:
        return []
    misfits = misfits_by_light(matt, grey, lights)
    own = np.diag(misfits)
    odd = np.flatnonzero(own > LIMITS.other_light * misfits.min(axis=1)).tolist()
    if not odd:
        return []
    files = tuple(names[k] for k in odd)
    fits = "; ".join(f"{names[k]} that of {names[int(misfits[k].argmin())]}" for k in odd)
    words = (
        f"photographs fit another light than their own: {fits}; check their files, and the order"
        " and directions of the lights."
    )
    return [Finding("light-order", words, Severity.DOUBT, files)]


def _unexplained(fits: dict[str, Explanation], equal: Explanation, assumed: bool) -> list[Finding]:
    """What equal lights leave open: whether a surface shines or lights differ, where both explain
    the photographs; or that neither does."""
    matt, glossy, unequal = (fits[name] for name in ("matt", "glossy", "unequal"))
    spread = float(unequal.gains.std())
    if assumed and _differ(matt, unequal) and unequal.misfit < LIMITS.alike * glossy.misfit:
        turned_deg = median_angle_deg(matt.normals.T, unequal.normals.T)
        words = (
            f"the lights may differ in brightness, by {100 * spread:.0f} %, which turns the surface"
            f" by {turned_deg:.1f} deg (median), or the object shines: both explain the"
            " photographs, and the lights are taken as equal; if they differ, give `brightness`"
            " estimate."
        )
        return [Finding("unequal-lights", words, effect_deg=turned_deg)]
    shines = glossy.misfit < GLOSS_LEAVES * matt.misfit
    if shines or equal.misfit < LIMITS.unexplained:
        return []
    words = UNEXPLAINED.format(100 * equal.misfit)
    return [Finding("light-residual", words, Severity.DOUBT)]


def _differ(equal: Explanation, unequal: Explanation) -> bool:
    """Whether lamps differ, by fits under equal and under unequal ones."""
    better = equal.misfit / unequal.misfit
    spread = float(unequal.gains.std())
    shown = better > LIMITS.better and spread > LIMITS.spread
    shown &= math.log(better) * spread > LIMITS.lamps
    return shown and (spread < LIMITS.no_lamps or unequal.misfit < LIMITS.sure)


def _fitting(fits: dict[str, Explanation], simple: str, free: str) -> Explanation:
    """The simpler hypothesis, unless the other one fits clearly better."""
    better = fits[simple].misfit > LIMITS.simpler * fits[free].misfit
    return fits[free] if better else fits[simple]


def _of_colours(grey: FloatArray, colours: FloatArray) -> Array:
    """(L, C) brightness of each light's colours over its grey."""
    lit = (grey > 0.1 * grey.max(axis=0)) & (colours > 0).all(axis=0)
    means = colours.mean(axis=(1, 2))
    # below this fraction of the mean, a colour channel is too dark to judge a light's brightness
    if len(colours) < 3 or (means < 0.1 * means.mean()).any() or not lit.any(axis=1).all():
        return np.ones((len(grey), len(colours)))
    logs = np.log(np.where(lit, colours / np.maximum(grey, 1e-12), 1.0))
    logs -= logs.sum(axis=1, keepdims=True) / np.maximum(lit.sum(axis=0), 1)
    ratios = np.nanmedian(np.where(lit, logs, np.nan), axis=2).T
    return np.asarray(np.exp(ratios - ratios.mean(axis=0)))


def with_encoding(observation: Observation, finger: Finger) -> tuple[Observation, list[Finding]]:
    """Photographs decoded as they shade where nobody stated how they are stored; a finding where
    that changed."""
    white = observation.white
    assumed = white.encoding == "srgb" and white.rig.provenance.get("encoding") == "assumed"
    comparable = not (white.flattened or white.colours) and len(white.lights) > LEAST_PHOTOGRAPHS
    if not (assumed and comparable):
        return observation, []
    other = observation.as_if_stored(observation.other_encoding)
    fits = []
    for each in (observation, other):
        (grey, *_), lights = sampled(each.white, finger)
        if grey.shape[1] < LIMITS.fewest:
            return observation, []
        fits.append(hypotheses(grey, lights))
    stated, least = (min(fit["matt"].misfit, fit["glossy"].misfit) for fit in fits)
    lamps = [fit["unequal"].misfit for fit in fits]
    if min(stated, least) > LIMITS.better * min(lamps):  # they differ
        stated, least = lamps
    if stated < LIMITS.assumed * least:
        return observation, []
    words = (
        f"the photographs shade as {other.encoding}, not as {white.encoding} as was assumed; they"
        f" were read as {other.encoding} (`encoding` changes it)."
    )
    return other, [Finding("assumed-encoding", words)]
