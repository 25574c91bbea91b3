"""What is wrong with the photographs of a finger, or a thing, that was found in them: all
questions, in order."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from splitknit.diagnosis.brightness import with_encoding, with_equal_lights
from splitknit.diagnosis.frames import HIGH_RESIDUAL, TURNED, LightFit, doubt_of_lights, fit_lights
from splitknit.diagnosis.lights import findings_on_places, with_places_by_ground
from splitknit.diagnosis.masks import findings_on_mask, findings_on_outline
from splitknit.diagnosis.photographs import left_out
from splitknit.diagnosis.relief import findings_on_relief
from splitknit.diagnosis.response import doubt_of_response
from splitknit.diagnosis.samples import sampled_light
from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.observation.films import findings_on_series
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation
from splitknit.steps import step

TILTED = (
    "the lights differ in brightness by {:.0f} %, which was estimated from the photographs and"
    " taken out: that gives the ridges, but leaves open by some degrees how the finger is tilted."
)


class Diagnosis(NamedTuple):
    """Photographs, and what is wrong with them."""

    observation: Observation
    """Without photographs that do not fit the others, and as bright as the lights turned out to
    be."""
    finger: Finger
    """With facts of the lights."""
    findings: tuple[Finding, ...]


@step("finger")
def diagnose(observation: Observation, finger: Finger, *, fit_places: bool = True) -> Diagnosis:
    """Ask all questions; `fit_places`: of lights that were stated as directions, too. Raises
    BadInput if the white photographs are too few, or their lights lie in a plane.
    """
    skin = observation.material == "skin"
    places: dict[str, Any] = {}
    observation, before = with_encoding(observation, finger)
    if fit_places and not skin:
        observation, places, of_places = with_places_by_ground(observation, finger)
        before += of_places
    white = observation.white
    fit = None
    if not (skin and white.colours):
        with suppress(BadInput):  # raised below
            fit = _fit(white, observation.material, finger)
    of_mask = [] if fit is None else findings_on_mask(observation, finger)
    films: tuple[Finding, ...] = ()
    if white.crossed is not None and not white.colours:
        parallel, _, pixels = sampled_light(replace(white, crossed=None))
        crossed, _, _ = sampled_light(white.crossed)
        films = findings_on_series(parallel, crossed, finger.mask[pixels])
    judged = _judged_skin if skin else _judged_object
    observation, facts, findings = judged(observation, finger, fit)
    finger = replace(finger, facts={**finger.facts, **places, **facts})
    return Diagnosis(observation, finger, (*before, *of_mask, *findings, *films))


def _judged_object(
    observation: Observation, finger: Finger, fit: LightFit | None
) -> tuple[Observation, dict[str, Any], list[Finding]]:
    """An opaque object without the photographs that do not fit the others, under equal lights;
    facts, and findings."""
    facts: dict[str, Any] = {}
    findings: list[Finding] = []
    # in another order, none of them is at fault
    if fit is None or fit.in_order or fit.frame == TURNED:
        bands = dict(observation.bands)
        for name, band in observation.bands.items():
            bands[name], notes = left_out(band, finger)
            findings += notes
            if name == "white":
                bands[name], of_lights, notes = with_equal_lights(bands[name], finger)
                findings += notes
                facts |= of_lights
        if bands["white"] is not observation.white:
            fit = None  # some photographs were left out, or lamps evened
        observation = replace(observation, bands=bands)
    for name in _judged_bands(observation):
        of_band, doubt = _judged_lights(observation, name, finger, fit, None)
        facts |= of_band
        findings += doubt
    return observation, facts, findings


def _judged_skin(
    observation: Observation, finger: Finger, fit: LightFit | None
) -> tuple[Observation, dict[str, Any], list[Finding]]:
    """Photographs of a finger, as bright as their lights turn out to be; facts, and findings."""
    sound = fit is None or fit.residual < HIGH_RESIDUAL
    response = doubt_of_response(observation, finger) if sound else None
    facts: dict[str, Any] = {}
    sure = response is not None and response.severity == Severity.SPOILS
    findings = [response] if response is not None and sure else []
    doubted = set()
    for name in _judged_bands(observation):
        band = observation.bands[name]
        of_band, doubt = _judged_lights(observation, name, finger, fit, response)
        facts |= of_band
        gains = of_band.get(f"light_brightness{_suffix(name)}", ())
        # nobody measured it
        if gains and len({led.intensity for led in band.rig.leds}) == 1:
            bright = np.repeat(np.array(gains)[:, None], len(band.channels), axis=1)
            observation = observation.with_light(band.divided_by(bright))
            words = TILTED.format(100 * float(np.std(np.log(gains))))
            findings.append(Finding("estimated-brightness", words).of_band(name))
            doubt = [each for each in doubt if each.severity == Severity.SPOILS]
        findings += doubt
        doubted |= {name} if doubt else set()
    findings += findings_on_relief(observation, finger, fits="white" not in doubted)
    if response is None and "white" not in doubted:
        findings += findings_on_places(observation, finger)
    if "nir" in observation.bands and "nir" not in doubted:
        findings += findings_on_outline(observation, finger)
    return observation, facts, findings


def _judged_bands(observation: Observation) -> list[str]:
    return [
        name
        for name in ("white", "nir")
        if name in observation.bands and not observation.bands[name].colours
    ]


def _suffix(name: str) -> str:
    """Of a band's facts."""
    return "" if name == "white" else f"_{name}"


def _fit(light: Light, material: str, finger: Finger) -> LightFit:
    """How well a band's photographs fit their lights."""
    stack, vectors, pixels = sampled_light(light)
    return fit_lights(stack, vectors, finger.wider[pixels], relief=material == "opaque")


def _judged_lights(
    observation: Observation,
    name: str,
    finger: Finger,
    white_fit: LightFit | None,
    response: Finding | None,
) -> tuple[dict[str, Any], list[Finding]]:
    """How well a band's photographs fit their lights, and what is wrong where another order or
    frame fits better, one does not belong to the others, or the camera's response is wrong.
    """
    band = observation.bands[name]
    white = name == "white"
    try:
        fit = (white_fit if white else None) or _fit(band, observation.material, finger)
    except BadInput:
        if white:
            raise
        return {}, []  # refused where it is used
    suffix = _suffix(name)
    facts: dict[str, Any] = {
        f"light_residual{suffix}": round(fit.residual, 4),
        f"light_residual_per_image{suffix}": [round(each, 4) for each in fit.residual_per_image],
    }
    if fit.brightness:
        facts[f"light_brightness{suffix}"] = [round(each, 3) for each in fit.brightness]
    doubt = doubt_of_lights(fit, band.image_names, observation.material)
    in_order = fit.frame == "right-up" and fit.in_order
    worse = fit.strange is not None or (
        doubt is not None and doubt.severity == Severity.SPOILS and not fit.brightness
    )
    sure = response is not None and response.severity == Severity.SPOILS
    if in_order and response is not None and (sure or not worse):  # it explains the rest
        return facts, [response] if white and not sure else []
    return facts, [] if doubt is None else [doubt.of_band(name)]
