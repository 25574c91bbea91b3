"""What is wrong with the photographs of a finger, or a thing, that was found in them: all questions, in order."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from splitknit.diagnosis.brightness import with_equal_lights
from splitknit.diagnosis.frames import HIGH_RESIDUAL, TURNED, LightFit, doubt_of_lights, fit_lights
from splitknit.diagnosis.lights import findings_on_places
from splitknit.diagnosis.masks import findings_on_mask, findings_on_outline
from splitknit.diagnosis.photographs import compared_pixels, faulty_photograph, left_out
from splitknit.diagnosis.relief import findings_on_relief
from splitknit.diagnosis.response import ENCODING, ResponseDoubt, doubt_of_response
from splitknit.diagnosis.samples import sampled_light
from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.polarised import findings_on_series
from splitknit.model import Band, Capture
from splitknit.steps import shared, step

_CURVED = 0.05
"""Light left unexplained from which the other encoding is tried: of linear photographs declared sRGB 0.07 to 0.1."""
_DISTANT = 0.15
"""Light left unexplained from which the lights are not distant, so that no photograph is compared with the others."""
TILTED = (
    "the lights differ in brightness by {:.0f} %, which was estimated from the photographs and taken out: that gives "
    "the ridges, but leaves open by some degrees how the finger is tilted."
)


class Diagnosis(NamedTuple):
    """Photographs, and what is wrong with them."""

    capture: Capture
    """Without photographs that do not fit the others, and as bright as the lights turned out to be."""
    finger: Finger
    """With facts of the lights."""
    findings: tuple[Finding, ...]


@shared
@step("finger")
def diagnose(capture: Capture, finger: Finger) -> Diagnosis:
    """Ask all questions. Raises BadInput if the white photographs are too few, or their lights lie in a plane."""
    white, skin = capture.bands["white"], capture.material == "skin"
    fit = None
    if not (skin and white.colours):
        with suppress(BadInput):  # raised below
            fit = _fit(capture, white, finger)
    of_mask = [] if fit is None else findings_on_mask(capture, finger)
    judged = _judged_skin(capture, finger, fit) if skin else _judged_thing(capture, finger, fit)
    capture, facts, findings = judged
    every = (*of_mask, *findings, *_findings_on_films(capture, finger))
    return Diagnosis(capture, replace(finger, facts={**finger.facts, **facts}), every)


def _judged_thing(
    capture: Capture, finger: Finger, fit: LightFit | None
) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """An opaque thing without the photographs that do not fit the others, under equal lights; facts, and findings."""
    facts, findings = dict[str, Any](), list[Finding]()
    if fit is None or fit.in_order or fit.frame == TURNED:  # in another order, none of them is at fault
        bands = dict(capture.bands)
        for name, band in capture.bands.items():
            pixels = compared_pixels(band, finger)
            if pixels is None:
                continue
            bands[name], notes, faults = left_out(capture, band, finger, *pixels)
            findings += notes
            facts |= {f"faulty_{name}": faults} if faults else {}
            if name == "white":
                bands[name], of_lights, notes = with_equal_lights(capture, bands[name], finger, *pixels)
                findings += notes
                facts |= of_lights
        capture = replace(capture, bands=bands)
    for name in _judged_bands(capture):
        band_fit = fit if name == "white" else None
        of_band, doubt = _judged_lights(capture, capture.bands[name], finger, band_fit, None)
        facts |= of_band
        findings += doubt
    return capture, facts, findings


def _judged_skin(
    capture: Capture, finger: Finger, fit: LightFit | None
) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """Photographs of a finger, as bright as their lights turn out to be; facts, and findings."""
    sound = fit is None or fit.residual < HIGH_RESIDUAL
    response = doubt_of_response(capture, finger) if sound else None
    facts = dict[str, Any]()
    findings = [response.finding] if response is not None and response.sure else []
    doubted = set()
    for name in _judged_bands(capture):
        band = capture.bands[name]
        of_band, doubt = _judged_lights(capture, band, finger, fit if name == "white" else None, response)
        gains = of_band.get("light_brightness" if name == "white" else f"light_brightness_{name}", ())
        if gains and len({led.intensity for led in capture.rig.select(band.lights).leds}) == 1:  # nobody measured it
            bright = np.repeat(np.array(gains)[:, None], band.pixels.shape[3], axis=1)
            alike = replace(band, transmission=bright * (1.0 if band.transmission is None else band.transmission))
            capture = replace(capture, bands={**capture.bands, name: alike})
            words = TILTED.format(100 * float(np.std(np.log(gains))))
            findings.append(Finding("estimated-brightness", words).of_band(name))
            doubt = [each for each in doubt if each.severity == Severity.SPOILS]
        facts |= of_band
        findings += doubt
        doubted |= {name} if doubt else set()
    findings += findings_on_relief(capture, finger, fits="white" not in doubted)
    if response is None and "white" not in doubted:
        findings += findings_on_places(capture, finger)
    if "nir" in capture.bands and "nir" not in doubted:
        findings += findings_on_outline(capture, finger)
    return capture, facts, findings


def _judged_bands(capture: Capture) -> list[str]:
    return [name for name in ("white", "nir") if name in capture.bands and not capture.bands[name].colours]


def _fit(capture: Capture, band: Band, finger: Finger) -> LightFit:
    """How well a band's photographs fit their lights."""
    stack, vectors, some = sampled_light(capture, band)
    opaque = capture.material == "opaque"
    fit = fit_lights(stack, vectors, finger.wider[some], relief=opaque)
    assumed = opaque and capture.rig.intensities_assumed
    return replace(fit, brightness=()) if assumed else fit  # see `with_equal_lights`


def _judged_lights(
    capture: Capture, band: Band, finger: Finger, fit: LightFit | None, response: ResponseDoubt | None
) -> tuple[dict[str, Any], list[Finding]]:
    """How well a band's photographs fit their lights (`fit`, where it is known), and what is wrong where another order
    or frame fits better, one does not belong to the others, or the camera's response is wrong."""
    white, skin = band.name == "white", capture.material == "skin"
    try:
        fit = fit or _fit(capture, band, finger)
    except BadInput:
        if white:
            raise
        return {}, []  # refused where it is used
    end = "" if white else f"_{band.name}"
    facts = {
        f"light_residual{end}": round(fit.residual, 4),
        f"light_residual_per_image{end}": [round(each, 4) for each in fit.residual_per_image],
    }
    if fit.brightness:
        facts[f"light_brightness{end}"] = [round(each, 3) for each in fit.brightness]
    doubt = doubt_of_lights(fit, band.image_names, capture.material)
    in_order = fit.frame == "right-up" and fit.in_order
    strange = fit.strange is not None
    spoils = doubt is not None and doubt.severity == Severity.SPOILS
    worse = strange or (spoils and not fit.brightness)
    if in_order and response is not None and (response.sure or not worse):  # it explains the rest
        return facts, [response.finding] if white and not response.sure else []
    if skin and in_order and not strange and (doubt is not None or fit.residual > _CURVED):
        other = "linear" if capture.encoding == "srgb" else "srgb"
        stored = _fit(replace(capture, encoding=other), band, finger)  # unequal lights stay so, a wrong curve does not
        explained = doubt is not None and doubt_of_lights(stored, band.image_names, capture.material) is None
        if explained or stored.residual < 0.5 * fit.residual:
            severity = Severity.SPOILS if fit.spoils_skin else Severity.DOUBT
            doubt = Finding("other-encoding", ENCODING.format(capture.encoding, other), severity)
    if doubt is None and skin and fit.residual < _DISTANT:  # LEDs beside the finger are not such lights
        doubt = faulty_photograph(capture, band, finger)
    return facts, [] if doubt is None else [doubt.of_band(band.name)]


def _findings_on_films(capture: Capture, finger: Finger) -> tuple[Finding, ...]:
    """A note where two polarised series are exchanged, or not in one order."""
    white = capture.bands["white"]
    if white.crossed is None or white.colours:
        return ()
    (parallel, _, some), (crossed, *_) = (
        sampled_light(capture, series) for series in (replace(white, crossed=None), white.crossed)
    )
    return findings_on_series(parallel, crossed, finger.mask[some])
