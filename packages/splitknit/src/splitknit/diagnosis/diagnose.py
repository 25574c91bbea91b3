"""What is wrong with the photographs of a finger, or a thing, that was found in them: all
questions, in order."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from splitknit.diagnosis.brightness import with_equal_lights
from splitknit.diagnosis.frames import TURNED, LightFit, doubt_of_lights, fit_lights
from splitknit.diagnosis.lights import findings_on_places
from splitknit.diagnosis.masks import findings_on_mask, findings_on_outline
from splitknit.diagnosis.parameters import (
    CURVED_RESIDUAL,
    DISTANT_RESIDUAL,
    HIGH_RESIDUAL,
)
from splitknit.diagnosis.photographs import compared_pixels, faulty_photograph, left_out
from splitknit.diagnosis.relief import findings_on_relief
from splitknit.diagnosis.response import ENCODING, ResponseDoubt, doubt_of_response, other_encoding
from splitknit.diagnosis.samples import sampled_light
from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.polarised import findings_on_series
from splitknit.model import Band, Capture
from splitknit.steps import shared, step

TILTED = (
    "the lights differ in brightness by {:.0f} %, which was estimated from the photographs and"
    " taken out: that gives the ridges, but leaves open by some degrees how the finger is tilted."
)


class Diagnosis(NamedTuple):
    """Photographs, and what is wrong with them."""

    capture: Capture
    """Without photographs that do not fit the others, and as bright as the lights turned out to
    be."""
    finger: Finger
    """With facts of the lights."""
    findings: tuple[Finding, ...]


@shared
@step("finger")
def diagnose(capture: Capture, finger: Finger) -> Diagnosis:
    """Ask all questions. Raises BadInput if the white photographs are too few, or their lights lie
    in a plane."""
    skin = capture.material == "skin"
    white = capture.bands["white"]
    fit = None
    if not (skin and white.colours):
        with suppress(BadInput):  # raised below
            fit = _fit(capture, white, finger)
    of_mask = [] if fit is None else findings_on_mask(capture, finger)
    films: tuple[Finding, ...] = ()
    if white.crossed is not None and not white.colours:
        parallel, _, pixels = sampled_light(capture, replace(white, crossed=None))
        crossed, _, _ = sampled_light(capture, white.crossed)
        films = findings_on_series(parallel, crossed, finger.mask[pixels])
    judged = _judged_skin if skin else _judged_object
    capture, facts, findings = judged(capture, finger, fit)
    finger = replace(finger, facts={**finger.facts, **facts})
    return Diagnosis(capture, finger, (*of_mask, *findings, *films))


def _judged_object(
    capture: Capture, finger: Finger, fit: LightFit | None
) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """An opaque object without the photographs that do not fit the others, under equal lights;
    facts, and findings."""
    facts: dict[str, Any] = {}
    findings: list[Finding] = []
    # in another order, none of them is at fault
    if fit is None or fit.in_order or fit.frame == TURNED:
        bands = dict(capture.bands)
        for name, band in capture.bands.items():
            pixels = compared_pixels(band, finger)
            if pixels is None:
                continue
            bands[name], notes = left_out(capture, band, finger, *pixels)
            findings += notes
            if name == "white":
                bands[name], of_lights, notes = with_equal_lights(
                    capture, bands[name], finger, *pixels
                )
                findings += notes
                facts |= of_lights
        if len(bands["white"].leds) < len(capture.bands["white"].leds):
            fit = None  # it counts the photographs that were left out
        capture = replace(capture, bands=bands)
    for name in _judged_bands(capture):
        of_band, doubt = _judged_lights(capture, name, finger, fit, None)
        facts |= of_band
        findings += doubt
    return capture, facts, findings


def _judged_skin(
    capture: Capture, finger: Finger, fit: LightFit | None
) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """Photographs of a finger, as bright as their lights turn out to be; facts, and findings."""
    sound = fit is None or fit.residual < HIGH_RESIDUAL
    response = doubt_of_response(capture, finger) if sound else None
    facts: dict[str, Any] = {}
    findings = [response.finding] if response is not None and response.sure else []
    doubted = set()
    for name in _judged_bands(capture):
        band = capture.bands[name]
        of_band, doubt = _judged_lights(capture, name, finger, fit, response)
        facts |= of_band
        gains = of_band.get(f"light_brightness{_suffix(name)}", ())
        # nobody measured it
        if gains and len({led.intensity for led in capture.rig.select(band.lights).leds}) == 1:
            bright = np.repeat(np.array(gains)[:, None], band.pixels.shape[3], axis=1)
            equal = replace(
                band,
                transmission=bright * (1.0 if band.transmission is None else band.transmission),
            )
            capture = replace(capture, bands={**capture.bands, name: equal})
            words = TILTED.format(100 * float(np.std(np.log(gains))))
            findings.append(Finding("estimated-brightness", words).of_band(name))
            doubt = [each for each in doubt if each.severity == Severity.SPOILS]
        findings += doubt
        doubted |= {name} if doubt else set()
    findings += findings_on_relief(capture, finger, fits="white" not in doubted)
    if response is None and "white" not in doubted:
        findings += findings_on_places(capture, finger)
    if "nir" in capture.bands and "nir" not in doubted:
        findings += findings_on_outline(capture, finger)
    return capture, facts, findings


def _judged_bands(capture: Capture) -> list[str]:
    return [
        name
        for name in ("white", "nir")
        if name in capture.bands and not capture.bands[name].colours
    ]


def _suffix(name: str) -> str:
    """Of a band's facts."""
    return "" if name == "white" else f"_{name}"


def _fit(capture: Capture, band: Band, finger: Finger) -> LightFit:
    """How well a band's photographs fit their lights."""
    stack, vectors, pixels = sampled_light(capture, band)
    opaque = capture.material == "opaque"
    fit = fit_lights(stack, vectors, finger.wider[pixels], relief=opaque)
    assumed = opaque and capture.rig.intensities_assumed
    return replace(fit, brightness=()) if assumed else fit  # see `with_equal_lights`


def _judged_lights(
    capture: Capture,
    name: str,
    finger: Finger,
    white_fit: LightFit | None,
    response: ResponseDoubt | None,
) -> tuple[dict[str, Any], list[Finding]]:
    """How well a band's photographs fit their lights, and what is wrong where another order or
    frame fits better, one does not belong to the others, or the camera's response is wrong.
    """
    band = capture.bands[name]
    white = name == "white"
    try:
        fit = white_fit if white and white_fit is not None else _fit(capture, band, finger)
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
    doubt = doubt_of_lights(fit, band.image_names, capture.material)
    in_order = fit.frame == "right-up" and fit.in_order
    strange = fit.strange is not None
    worse = strange or (
        doubt is not None and doubt.severity == Severity.SPOILS and not fit.brightness
    )
    if in_order and response is not None and (response.sure or not worse):  # it explains the rest
        return facts, [response.finding] if white and not response.sure else []
    skin = capture.material == "skin"
    if skin and in_order and not strange and (doubt is not None or fit.residual > CURVED_RESIDUAL):
        encoding = other_encoding(capture)
        # unequal lights stay so, a wrong curve not
        stored = _fit(replace(capture, encoding=encoding), band, finger)
        explained = doubt is not None and doubt_of_lights(stored, band.image_names) is None
        if explained or stored.residual < 0.5 * fit.residual:
            severity = Severity.SPOILS if fit.spoils_skin else Severity.DOUBT
            doubt = Finding("other-encoding", ENCODING.format(capture.encoding, encoding), severity)
    # LEDs beside the finger are not such lights
    if doubt is None and skin and fit.residual < DISTANT_RESIDUAL:
        doubt = faulty_photograph(capture, band, finger)
    return facts, [] if doubt is None else [doubt.of_band(name)]
