"""What a method works on, photographs of a finger that was found; and what it returns, the surface in its window."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from splitknit import steps
from splitknit.diagnosis.lights import doubt_of_places, fitted_places, sure_of_places
from splitknit.diagnosis.relief import LEAST_PX_PER_MM, bare_patch, doubt_of_patch, unlike_image
from splitknit.errors import BadInput, require
from splitknit.findings import Finding, Severity, refuse, worst_first
from splitknit.finger.locate import Finger, FingerSettings, prepared_capture
from splitknit.finger.regions import erode
from splitknit.finger.steady import find_steady_finger, without_moved_side
from splitknit.imaging.band import bin_mean, has_colour, linear_channels, linear_stack, pick_channel, saturation_levels
from splitknit.imaging.light_field import flat_promised
from splitknit.imaging.polarised import aligned, findings_on_series, specular_of, without_films, without_side_lights
from splitknit.imaging.view import view_of
from splitknit.integration.knit import place
from splitknit.methods.response import ENCODING, ResponseDoubt, doubt_of_response
from splitknit.model import Array, Band, BoolArray, Capture, FloatArray, Reconstruction, Rig
from splitknit.photometric.checks import (
    PhotographFault,
    faulty_photographs,
    leaves_out_object,
    light_gains,
    light_left,
)
from splitknit.photometric.frames import (
    HIGH_RESIDUAL,
    SPOILT_DEG,
    TURNED,
    LightFit,
    doubt_of_lights,
    fit_lights,
    spoils_skin,
)
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.uncalibrated import bas_relief_note, bas_relief_of
from splitknit.presets import PipelineSettings
from splitknit.steps import shared, step

if TYPE_CHECKING:
    from splitknit.mirrors.captured import SeenInMirrors

NO_NIR = (
    "there is no near-infrared band: the shape comes from the white band, in which ridges, scattering and specular "
    "reflection bend it."
)
_CURVED = 0.05
"""Light left unexplained from which the other encoding is tried: of linear photographs declared sRGB 0.07 to 0.1."""
JPEG = (
    "the photographs were saved as JPEG, which loses fine detail: ridges of simulated fingers came out up to 18 % too "
    "low above 15 px/mm, and 61 to 89 % at 11; save PNG, TIFF or RAW."
)
_JPEG_GRID = 0.92
"""High frequencies in blocks of 8 pixels on JPEG's grid, of those on the next best of 64 grids, below which it was
JPEG: 0.66 to 0.85 at quality 97, 0.54 to 0.66 at 95, less below; 0.99 and more without JPEG, and from 99 on."""
_JPEG_SIDE = 1024
OTHER_RIDGES = (
    "{} does not show the ridges that all other photographs show (moved, double, or another finger's): the relief "
    "mixes both; capture it again."
)
OTHER_OUTLINE = 0.03, 0.15
"""Part of the rim that is darker in near infrared than in white from which the outlines differ, and from which the
surface is spoilt: below 0 on simulated and path-traced fingers, 0.04 and 0.24 where the NIR images were of another."""
NOTED_DEG, _DISTANT = 0.5, 0.15
"""A fault of one photograph that turns the surface by more is noted, where less of the light is unexplained."""
TILTED = (
    "the lights differ in brightness by {:.0f} %, which was estimated from the photographs and taken out: that gives "
    "the ridges, but leaves open by some degrees how the finger is tilted."
)
_SIDE_UNUSED = (
    "the {} white images lit far more from the side than the others are not used: by the published cases, and where no "
    "network estimates the ridges, the shadows in them would be taken for the skin's shape."
)


def side_unused(count: int) -> Finding:
    """That images lit from the side were not used."""
    return Finding("side-unused", _SIDE_UNUSED.format(count))


INVERTED = (
    "the mask looks inverted: it runs around the picture, and what it leaves out turns more with the light than "
    "what it holds, so that the table is measured; paint the object white and all else black."
)
FRAME_SIDE = 300
"""Images of at least so many pixels a side are enough to detect in which frame the lights were measured."""
_COMPARED_VALUES = 4_000_000
"""Values of all photographs that are compared with each other, at most; larger ones are binned."""
_SAMPLED_MM, PLACES_MM = 0.1, 0.8
"""Distance of the pixels, and side of their blocks, in which the lights' places are looked for: ridges are smaller."""
_MUCH_BARE = 0.15
"""Part of the finger without ridges that is doubted and not merely noted: one of some 40 sound fingers in all
conditions had 0.11."""
_FEW_CLIPPED = 0.002
_EQUAL, _CLEARLY, _SURELY_UNEQUAL = 0.02, 2.5, 0.18
"""Spread (standard deviation of the logarithm) up to which lights are equal; over the light left unexplained from where
the estimate is better than equal lights, as gloss looks like a spread of up to 2.0 times that (a glazed bear; 1.5 on 24
rendered objects of three glosses); and from where they surely differ."""
_EXPLAINED = 0.7
"""Unequal lights leave less than this part of the residual: 0.66 where they differ by 6 %, equal ones 0.77 and more."""
_WEAK_COLOUR = 0.1
"""A colour in which a light has less than this part of the mean tells little of it."""


@dataclass(frozen=True, slots=True)
class FingerBand:
    """One band's photographs of the finger."""

    capture: Capture
    band: Band
    finger: Finger
    plane_mm: float = 0.0
    """Assumed mean height of the surface above the finger plane, for near lights."""

    @property
    def rig(self) -> Rig:
        """`rig.leds[k]` lights photograph k."""
        return self.capture.rig.select(self.band.lights)

    @property
    def inside(self) -> BoolArray:
        """(h, w) pixels of the window that are reconstructed."""
        return self.finger.inside

    @property
    def px_per_mm(self) -> float:
        """Scale on the finger plane."""
        return self.capture.rig.camera.px_per_mm

    @property
    def pitch_mm(self) -> float:
        """Side of a pixel on the finger plane."""
        return self.capture.rig.camera.pitch_mm


@dataclass(slots=True, eq=False)
class FingerPhotographs:
    """All photographs of a finger, and the finger in them."""

    capture: Capture
    finger: Finger
    bands: tuple[Band, ...]  # the white band, and the near-infrared one if the shape is to come from it
    findings: tuple[Finding, ...] = ()
    specular: FloatArray | None = None
    """(H, W) picture of the specular reflection, of a polarised capture."""

    def white_and_nir(self, plane_mm: float) -> tuple[FingerBand, FingerBand]:
        """The white band, and the band of the shape: the same one where there is no other."""
        white, nir = self.bands[0], self.bands[-1]
        return (
            FingerBand(self.capture, white, self.finger, plane_mm),
            FingerBand(self.capture, nir, self.finger, plane_mm),
        )

    def release(self) -> None:
        """Let go of the images, so that their memory is free where nobody else holds them."""
        self.capture, self.bands = replace(self.capture, bands={}), ()
        steps.images_are_read()


def finger_photographs(capture: Capture, settings: PipelineSettings) -> FingerPhotographs:
    """Find the finger; where it moved between the shots, that is undone. Raises BadInput if there is none."""
    capture, finger = locate_finger(_with_promised_light(capture), settings.finding())
    bands = [capture.bands["white"]]
    findings = list(finger.findings)
    side = bands[0].side
    if side is not None and settings.method == "thesis":
        findings.append(side_unused(len(side.leds)))
    if settings.shape.source == "nir" and not settings.visible_alone:
        if "nir" in capture.bands:
            bands.append(capture.bands["nir"])
        elif capture.material == "skin":
            findings.append(Finding("no-nir", NO_NIR))
    if len(bands) == 1:  # what is wrong with a band that is not used spoils nothing
        findings = [each for each in findings if each.severity == Severity.NOTE or each.band == "white"]
    if (unsure := bas_relief_of(capture.rig)) is not None:
        findings.insert(0, Finding("bas-relief", bas_relief_note(unsure)))
    ordered = worst_first(findings)
    refuse(ordered, keep=settings.keep)
    return FingerPhotographs(capture, finger, tuple(bands), ordered, specular_of(capture, finger.mask))


@shared
@step("finger")
def locate_finger(capture: Capture, settings: FingerSettings) -> tuple[Capture, Finger]:
    """Segmentation mask, pose, crease and quality; where the finger moved between the shots, that is undone; and what
    is wrong with the photographs.
    """
    lit, prepared = prepared_capture(capture, settings)
    lit, films = aligned(lit)  # before motion is measured, which would take the shift of the image for one
    steady, finger = find_steady_finger(without_side_lights(lit), settings)
    steady, side_moved = without_moved_side(steady, finger)
    steady = without_films(steady)
    judge = _judged_skin if steady.material == "skin" else _judged_thing
    steady, facts, findings = judge(steady, finger)
    if any(_was_jpeg(band, finger) for band in lit.bands.values()):
        facts["jpeg"] = True
        findings += [Finding("jpeg", JPEG, Severity.DOUBT)] if capture.material == "skin" else []
    between = _findings_on_films(steady, finger)
    every = (*findings, *prepared, *finger.findings, *side_moved, *between)
    return steady, replace(finger, facts={**finger.facts, **films, **facts}, findings=every)


def _judged_thing(capture: Capture, finger: Finger) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """An opaque thing without the photographs that do not fit the others; facts, and what is wrong."""
    white, fit = capture.bands["white"], None
    with suppress(BadInput):  # refused below
        fit = _fit(capture, white, finger)
    facts, findings = dict[str, Any](), list[Finding]()
    reordered = fit is not None and fit.frame != TURNED and fit.order != tuple(range(len(fit.order)))
    if not reordered:  # in another order, none of them is at fault
        capture, facts, findings = _compared(capture, finger)
    if fit is not None:
        findings += _inverted_mask(capture, finger)
    for name in _judged_bands(capture):
        band = capture.bands[name]
        of_band, doubt = _doubt_of_lights(capture, band, finger, fit if name == "white" else None, None)
        facts |= _named(of_band, name)
        findings += [] if doubt is None else [doubt]
    return capture, facts, findings


def _judged_skin(capture: Capture, finger: Finger) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """Photographs of a finger, as bright as their lights turn out to be; facts, and what is wrong."""
    fit, response = _response(capture, finger)
    facts, findings = dict[str, Any](), list[Finding]()
    if fit is not None:
        findings += _inverted_mask(capture, finger)
    if response is not None and response.sure:
        findings.append(response.finding)
    doubted = set()
    for name in _judged_bands(capture):
        band = capture.bands[name]
        of_band, doubt = _doubt_of_lights(capture, band, finger, fit if name == "white" else None, response)
        gains = of_band.get("light_brightness", ())
        if gains and len({led.intensity for led in capture.rig.select(band.lights).leds}) == 1:  # nobody measured it
            bright = np.repeat(np.array(gains)[:, None], band.pixels.shape[3], axis=1)
            alike = replace(band, transmission=bright * (1.0 if band.transmission is None else band.transmission))
            capture = replace(capture, bands={**capture.bands, name: alike})
            words = TILTED.format(100 * float(np.std(np.log(gains))))
            findings.append(Finding("estimated-brightness", words).of_band(name))
            doubt = doubt if doubt is not None and doubt.severity == Severity.SPOILS else None
        facts |= _named(of_band, name)
        if doubt is not None:
            findings.append(doubt)
            doubted.add(name)
    findings += _findings_on_relief(capture, finger, fits="white" not in doubted)
    if response is None and "white" not in doubted:
        findings += _findings_on_places(capture, finger)
    if "nir" in capture.bands and "nir" not in doubted:
        findings += _findings_on_outline(capture, finger)
    return capture, facts, findings


def _judged_bands(capture: Capture) -> list[str]:
    return [name for name in ("white", "nir") if name in capture.bands and not capture.bands[name].colours]


def _named(facts: Mapping[str, Any], band: str) -> dict[str, Any]:
    """Facts under names that say of which band they are."""
    return {(name if band == "white" else f"{name}_{band}"): value for name, value in facts.items()}


def _inverted_mask(capture: Capture, finger: Finger) -> list[Finding]:
    """A doubt where the given mask holds what lies around the object."""
    white = capture.bands["white"]
    if capture.mask is None or white.colours:
        return []
    stack, vectors, some = _sampled(capture, white)
    inverted = leaves_out_object(stack, vectors, finger.mask[some])
    return [Finding("inverted-mask", INVERTED, Severity.DOUBT)] if inverted else []


def _was_jpeg(band: Band, finger: Finger) -> bool:
    """Whether a band's photographs are JPEG files, or show JPEG's blocks of 8 pixels."""
    if any(file.lower().endswith((".jpg", ".jpeg")) for file in band.files):
        return True
    stored = band.pixels[0][finger.window][:_JPEG_SIDE, :_JPEG_SIDE].astype(np.float32)
    if band.pixels.dtype != np.uint8 or min(stored.shape[:2]) < 64:
        return False
    image, k = pick_channel(stored, "grey"), np.arange(4, 8)  # the upper half of a block's frequencies
    waves = 0.5 * np.cos(np.pi / 16 * k[:, None] * (2 * np.arange(8) + 1)).astype(np.float32)
    total = np.zeros_like(image)
    for across in waves:
        rows = cv2.filter2D(image, cv2.CV_32F, across[None], anchor=(0, 0))
        for down in waves:
            total += np.minimum(np.abs(cv2.filter2D(rows, cv2.CV_32F, down[:, None], anchor=(0, 0))), 4.0)
    grids = sorted(float(total[i:-8:8, j:-8:8].mean()) for i in range(8) for j in range(8))
    return grids[0] < _JPEG_GRID * grids[1]


def _sampled(capture: Capture, band: Band) -> tuple[FloatArray, Array, tuple[slice, slice]]:
    """Grey linear light (L, h, w) at some of a band's pixels, its lights (L, 3), and which pixels these are."""
    every = max(1, max(capture.shape) // FRAME_SIDE)
    lights = capture.rig.select(band.lights).light_vectors()
    return linear_stack(band.sampled(every), capture.encoding, "grey"), lights, np.s_[::every, ::every]


def _fit(capture: Capture, band: Band, finger: Finger) -> LightFit:
    """How well a band's photographs fit their lights."""
    stack, vectors, some = _sampled(capture, band)
    opaque = capture.material == "opaque"
    fit = fit_lights(stack, vectors, finger.wider[some], relief=opaque)
    return replace(fit, brightness=()) if opaque and capture.rig.intensities_assumed else fit  # see `_brightness`


def _response(capture: Capture, finger: Finger) -> tuple[LightFit | None, ResponseDoubt | None]:
    """How white photographs of skin fit their lights; what is wrong with the camera's response, unless they do not."""
    band, fit = capture.bands["white"], None
    with suppress(BadInput):  # refused where doubts are made
        fit = None if band.colours else _fit(capture, band, finger)
    sound = fit is None or fit.residual < HIGH_RESIDUAL
    return fit, doubt_of_response(capture, finger) if sound else None


def _compared(capture: Capture, finger: Finger) -> tuple[Capture, dict[str, Any], list[Finding]]:
    """The capture without the photographs that do not fit the others, its lights as bright as they are found to be
    where nobody stated it; facts and notes on that."""
    bands, facts, notes = dict(capture.bands), dict[str, Any](), list[Finding]()
    for name, band in capture.bands.items():
        if len(band.lights) != len(band.pixels) or band.crossed is not None or band.polarisation:
            continue
        rows, columns = finger.window
        values = len(band.pixels) * (rows.stop - rows.start) * (columns.stop - columns.start)
        binning = max(1, int(np.ceil(np.sqrt(values / _COMPARED_VALUES))))
        inside = bin_mean(finger.inside.astype(np.float32), binning) > 0.99
        if not inside.any():
            continue
        stack = linear_stack(band, capture.encoding, "grey", finger.window, binning)
        levels = saturation_levels(band, capture.encoding)
        lights = capture.rig.select(band.lights).light_vectors()
        faults = faulty_photographs(stack, lights, inside, levels)
        out = {fault.photograph for fault in faults if fault.kind != "overexposed"}
        notes += [_fault_finding(band.image_names[fault.photograph], fault, binning) for fault in faults]
        clipped = (stack >= levels[:, None, None]).sum(axis=0)[inside] > len(stack) - 3
        if clipped.mean() > _FEW_CLIPPED:
            where = f"{100 * clipped.mean():.1f} % of the surface is overexposed in all photographs but two or fewer"
            words = f"{where}: its slopes there are unknown; photograph it again with a shorter exposure."
            notes.append(Finding("overexposed-surface", words))
        kept = [k for k in range(len(stack)) if k not in out]
        if out:
            bands[name] = band.of_images(kept)
        free = capture.rig.intensities_assumed and band.flat is None and bas_relief_of(capture.rig) is None
        if name == "white" and free and len(bands[name].lights) > 4:
            bands[name], found, of_lights = _brightness(bands[name], capture, finger, binning)
            facts, notes = facts | found, [*notes, *of_lights]
        if faults:
            named = [(band.image_names[one.photograph], one.kind, round(one.effect_deg, 2)) for one in faults]
            facts[f"faulty_{name}"] = [list(one) for one in named]
    return replace(capture, bands=bands), facts, notes


def _brightness(
    band: Band, capture: Capture, finger: Finger, binning: int
) -> tuple[Band, dict[str, Any], list[Finding]]:
    """The band whose images are divided by the brightness of their lights, in each colour, where that is clearly
    unequal; facts and notes."""
    inside = bin_mean(finger.inside.astype(np.float32), binning) > 0.99
    lights, levels = capture.rig.select(band.lights).light_vectors(), saturation_levels(band, capture.encoding)
    channels = ("red", "green", "blue") if band.pixels.shape[3] == 3 else ("grey",)
    each = linear_channels(band, capture.encoding, ("grey", *channels), finger.window, binning)
    found = [light_gains(stack, lights, inside, levels) for stack in each]
    equal, gains = np.ones(len(lights)), found[0]
    before, after = (light_left(each[0], lights * one[:, None], inside, levels) for one in (equal, gains))
    spread = float(np.std(np.log(gains)))
    asked = capture.rig.provenance.get("intensities") == "estimate"
    sure = asked or spread > _CLEARLY * after or (spread > _SURELY_UNEQUAL and len(lights) > 5)
    if not asked and (spread < _EQUAL or after > _EXPLAINED * before):
        return band, {}, []
    shown = "; ".join(f"{name} {gain:.2f}" for name, gain in zip(band.image_names, gains / gains.mean(), strict=True))
    both = [lambertian(each[0], lights * one[:, None], inside)[0][inside] for one in (equal, gains)]
    turned_deg = float(np.rad2deg(np.arccos(np.clip(np.median((both[0] * both[1]).sum(axis=1)), -1.0, 1.0))))
    turned = f"which turns the surface by {turned_deg:.1f} deg (median)"
    if not sure:
        numbers = " ".join(f"{gain:.3f}" for gain in gains / gains.mean())
        doubt = f"the lights may differ in brightness, by {100 * spread:.0f} %, {turned}, or shine and shadow look so"
        cure = "if they do, give `brightness` estimate, or as fourth numbers of the list, in its order"
        words = f"{doubt}: they are taken as equal; {cure}: {numbers}."
        return band, {}, [Finding("unequal-lights", words, effect_deg=turned_deg)]
    of_colours = np.stack(found[1:], axis=1)
    weak = _WEAK_COLOUR * each[1:][:, :, inside].mean() > each[1:][:, :, inside].mean(axis=2).T
    shown_gains = [round(float(one), 3) for one in gains / gains.mean()]
    facts: dict[str, Any] = {"light_brightness": shown_gains, "light_brightness_by": "estimated"}
    if len(channels) == 3 and not weak.any():
        of_colours *= np.exp(np.log(gains).mean() - np.log(of_colours).mean(axis=0))
        facts["light_colours"] = np.round(of_colours / of_colours.mean(), 3).tolist()
    else:
        of_colours = np.repeat(gains[:, None], len(channels), axis=1)
    note = f"the lights differ in brightness, {turned}; that was estimated with the surface and taken out: {shown}."
    finding = Finding("estimated-brightness", note, effect_deg=turned_deg)
    return replace(band, transmission=of_colours), facts, [finding]


def _fault_finding(name: str, fault: PhotographFault, binning: int) -> Finding:
    """That a photograph was not used, or not all of it."""
    turned = f"turned the normals by {fault.effect_deg:.2g} deg (median)"
    px, percent = f"{binning * fault.size:.2g} px", f"{100 * fault.size:.2g} %"
    known = not np.isnan(fault.effect_deg)
    if fault.kind == "overexposed":
        effect = f"; used, they would have {turned} there" if known else ""
        clipped = f"{name} is overexposed: {percent} of the surface is clipped"
        words = f"{clipped}. The clipped values are not used{effect}."
    else:
        what = {
            "moved": f"is shifted by {px} against the others",
            "blurred": f"is blurred by {px} (sigma) against the others",
            "double": f"shows everything twice, {px} apart",
            "underexposed": f"has {percent} of the others' light",
            "unlike": f"does not fit the others: it is {percent} off what they predict",
        }[fault.kind]
        words = f"{name} {what}. It was left out; it would have {turned}."
    effect_deg = fault.effect_deg if known else None
    return Finding(_FAULT_CODES[fault.kind], words, files=(name,), effect_deg=effect_deg)


_FAULT_CODES = {
    "overexposed": "overexposed-photograph",
    "moved": "moved-photograph",
    "blurred": "blurred-photograph",
    "double": "double-photograph",
    "underexposed": "underexposed-photograph",
    "unlike": "unlike-photograph",
}


def _doubt_of_lights(
    capture: Capture, band: Band, finger: Finger, fit: LightFit | None, response: ResponseDoubt | None
) -> tuple[dict[str, Any], Finding | None]:
    """How well a band's photographs fit their lights (`fit`, where it is known), and what is wrong where another order
    or frame fits better, one does not belong to the others, or the camera's response is wrong."""
    try:
        fit = fit or _fit(capture, band, finger)
    except BadInput:
        if band.name == "white":
            raise
        return {}, None  # refused where it is used
    facts = {
        "light_residual": round(fit.residual, 4),
        "light_residual_per_image": [round(each, 4) for each in fit.residual_per_image],
    }
    if fit.brightness:
        facts["light_brightness"] = [round(each, 3) for each in fit.brightness]
    skin = capture.material == "skin"
    doubt = doubt_of_lights(fit, band.image_names, capture.material)
    in_order = fit.frame == "right-up" and fit.order == tuple(range(len(fit.order)))
    strange = fit.strange is not None
    spoils = doubt is not None and doubt.severity == Severity.SPOILS
    worse = strange or (spoils and not fit.brightness)
    if in_order and response is not None and (response.sure or not worse):  # it explains the rest
        here = band.name == "white" and not response.sure
        return facts, response.finding if here else None
    if skin and in_order and not strange and (doubt is not None or fit.residual > _CURVED):
        other = "linear" if capture.encoding == "srgb" else "srgb"
        stored = _fit(replace(capture, encoding=other), band, finger)  # unequal lights stay so, a wrong curve does not
        explained = doubt is not None and doubt_of_lights(stored, band.image_names, capture.material) is None
        if explained or stored.residual < 0.5 * fit.residual:
            severity = Severity.SPOILS if spoils_skin(fit) else Severity.DOUBT
            doubt = Finding("other-encoding", ENCODING.format(capture.encoding, other), severity)
    if doubt is None and skin and fit.residual < _DISTANT:  # LEDs beside the finger are not such lights
        doubt = _faulty_photograph(capture, band, finger)
    return facts, None if doubt is None else doubt.of_band(band.name)


def _faulty_photograph(capture: Capture, band: Band, finger: Finger) -> Finding | None:
    """The photograph of skin that fits the others least, if it turns the surface."""
    stack, vectors, some = _sampled(capture, band)
    faults = faulty_photographs(stack, vectors, finger.wider[some], saturation_levels(band, capture.encoding))
    # highlights are overexposed, and no method takes them for skin
    bad = [fault for fault in faults if fault.kind != "overexposed" and fault.effect_deg > NOTED_DEG]
    if not bad:
        return None
    fault = max(bad, key=lambda each: each.effect_deg)
    how = {"double": "a double image", "unlike": "unlike what the others predict"}.get(fault.kind, fault.kind)
    turns = f"it turns the surface by {fault.effect_deg:.1f} deg (median)"
    name = band.image_names[fault.photograph]
    return Finding(
        _FAULT_CODES[fault.kind],
        f"{name} does not fit the other photographs ({how}): {turns}; capture it again.",
        Severity.SPOILS if fault.effect_deg > SPOILT_DEG else Severity.DOUBT,
        files=(name,),
        effect_deg=fault.effect_deg,
    )


def _findings_on_outline(capture: Capture, finger: Finger) -> list[Finding]:
    """A doubt where the finger of the near-infrared photographs has another outline than that of the white ones."""
    (white, _, some), (nir, *_) = (_sampled(capture, capture.bands[name]) for name in ("white", "nir"))
    inside, px = finger.mask[some], capture.rig.camera.px_per_mm / some[0].step
    rim = inside & ~erode(inside, 1.5 * px)
    core = inside & ~rim
    if not core.any():
        return []
    means = white.mean(axis=0), nir.mean(axis=0)
    own, dark = (float((mean[rim] < 0.15 * np.median(mean[core])).mean()) for mean in means)
    noted, spoils = OTHER_OUTLINE
    if dark - own <= noted:
        return []
    other = f"{100 * dark:.0f} % of the finger's rim (1.5 mm) is dark in it, and {100 * own:.0f} % in white"
    words = f"{other}: check that both bands are of one finger in one place."
    severity = Severity.SPOILS if dark - own > spoils else Severity.DOUBT
    return [Finding("other-outline", words, severity).of_band("nir")]


def _findings_on_places(capture: Capture, finger: Finger) -> list[Finding]:
    """A doubt, or a note, where the white LEDs seem to stand elsewhere than the rig states."""
    band, camera = capture.bands["white"], capture.rig.camera
    if band.colours or any(led.position_mm is None for led in capture.rig.leds):
        return []
    every = max(1, round(_SAMPLED_MM * camera.px_per_mm))
    binning = max(1, round(PLACES_MM * camera.px_per_mm / every))
    names = ("red", "green", "blue") if has_colour(band) else ("grey",)
    images = bin_mean(linear_channels(band.sampled(every), capture.encoding, names), binning)
    inside = bin_mean(finger.mask[::every, ::every].astype(np.float32), binning) > 0.99
    rows, columns = (n // (every * binning) for n in capture.shape)
    images, inside = images[..., :rows, :columns], inside[:rows, :columns]
    if not inside.any():
        return []
    levelled = (image / max(float(image[:, inside].mean()), 1e-9) for image in images)
    stack = sum(levelled, np.zeros_like(images[0]))
    pitch_mm = every * binning * camera.pitch_mm
    depth_mm = cv2.distanceTransform(np.pad(inside, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1] * pitch_mm
    view = view_of(camera, binning=every * binning, along_rays=True)
    rig = capture.rig.select(band.lights)
    places = fitted_places(stack, rig, inside, depth_mm, view, pitch_mm)
    words = "" if places is None else doubt_of_places(places, rig)
    if places is None or not words:
        return []
    return [Finding("led-places", words, Severity.DOUBT if sure_of_places(places) else Severity.NOTE)]


def _findings_on_relief(capture: Capture, finger: Finger, *, fits: bool) -> list[Finding]:
    """A doubt where a white photograph shows other ridges than the rest, or a large part of the finger none; a note on
    a smaller part, which gloss may hide."""
    band, px_per_mm = capture.bands["white"], capture.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / (2 * LEAST_PX_PER_MM)))
    inside = bin_mean(finger.mask[finger.window].astype(np.float32), binning) > 0.99
    stack = linear_stack(band, capture.encoding, "grey", finger.window, binning)
    area_mm2, part = bare_patch(stack, inside, px_per_mm / binning)
    findings = []
    if words := doubt_of_patch(area_mm2, part):
        severity = Severity.DOUBT if part > _MUCH_BARE else Severity.NOTE
        findings.append(Finding("bare-patch", words, severity))
    if fits and len(band.lights) == len(stack):
        lights = capture.rig.select(band.lights).light_vectors()
        unlike = unlike_image(stack, lights, inside, px_per_mm / binning)
        if unlike is not None:
            name = band.image_names[unlike]
            findings.append(Finding("other-ridges", OTHER_RIDGES.format(name), Severity.DOUBT, files=(name,)))
    return findings


def _findings_on_films(capture: Capture, finger: Finger) -> tuple[Finding, ...]:
    white = capture.bands["white"]
    if white.crossed is None or white.colours:
        return ()
    (parallel, _, some), (crossed, *_) = (
        _sampled(capture, series) for series in (replace(white, crossed=None), white.crossed)
    )
    return findings_on_series(parallel, crossed, finger.mask[some])


def _with_promised_light(capture: Capture) -> Capture:
    """Where images are divided by flat ones: with the brightness that the rig's lights have on a flat surface."""
    flat = {name: (band, band.flat) for name, band in capture.bands.items() if band.flat is not None}
    promised = {
        name: replace(band, promised=flat_promised(capture.rig.select(band.lights), image.shape))
        for name, (band, image) in flat.items()
    }
    return replace(capture, bands={**capture.bands, **promised}) if promised else capture


@dataclass(frozen=True, slots=True, eq=False)
class FingerSurface:
    """A surface in the finger's window: arrays (h, w), finite inside the mask."""

    height_mm: FloatArray
    ridge_mm: FloatArray
    shape_mm: FloatArray
    albedo: FloatArray
    normals: FloatArray | None = None
    """(h, w, 3) measured by photometric stereo, in the rig's frame; None where the method measures none."""
    uncertainty_um: FloatArray | None = None
    whole: bool = False
    """Whether the surface is not split into relief and shape: its height is what the thesis's matcher takes."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


@step("result")
def placed(photographs: FingerPhotographs, surface: FingerSurface, top_mm: float) -> Reconstruction:
    """The window's surface in the full image, cut to the mask, with the normals of the knitted height.

    `top_mm`: assumed height of the highest point above the finger plane.
    """
    capture, finger = photographs.capture, photographs.finger
    mask, window, camera = finger.mask, finger.window, capture.rig.camera
    inside = mask[window]
    height_mm, shape_mm, normals, x_mm, y_mm = place(
        surface.height_mm, surface.shape_mm, inside, camera, window, top_mm
    )

    def whole(part: FloatArray) -> FloatArray:
        image = np.full(mask.shape, np.nan, dtype=np.float32)
        np.copyto(image[window], part, where=inside)
        return image

    def whole_normals(part: FloatArray) -> FloatArray:
        image = np.zeros((*mask.shape, 3), dtype=np.float32)
        np.copyto(image[window], part, where=inside[..., None])  # no negative zeros, which pack badly
        return image

    return Reconstruction(
        height_mm=whole(height_mm),
        ridge_mm=whole(surface.ridge_mm if x_mm is None else height_mm - shape_mm),
        shape_mm=whole(shape_mm),
        mask=mask,
        normals=whole_normals(normals),
        normals_measured=None if surface.normals is None else whole_normals(surface.normals),
        albedo=whole(surface.albedo),
        pitch_mm=camera.pitch_mm,
        scale_known=camera.scale_known,
        x_mm=None if x_mm is None else whole(x_mm),
        y_mm=None if y_mm is None else whole(y_mm),
        input_from_upright=finger.upright.input_from_upright,
        upright_size=finger.upright.size,
        preset="",
        whole=surface.whole,
        specular=photographs.specular,
        uncertainty_um=None if surface.uncertainty_um is None else whole(surface.uncertainty_um),
        quality=finger.quality,
        facts={"material": capture.material, **finger.facts, **surface.facts},
        hashes=capture.hashes,
    )


NOT_SPLIT = (
    "this preset keeps the visible surface whole, so that a shape from mirrors has no place in it: take `preset` "
    "metric or snk."
)


@step("finger")
def mirror_views(capture: Capture, settings: PipelineSettings) -> SeenInMirrors:
    """The finger as mirrors show it. Raises BadInput if there are none, or the settings keep the surface whole."""
    from splitknit.mirrors.captured import seen_in_mirrors  # large, and needed where there are mirrors

    require(not settings.visible_alone, NOT_SPLIT)
    return seen_in_mirrors(capture, settings.shape.mirror)


def on_mirror_shape(
    photographs: FingerPhotographs, surface: FingerSurface, seen: SeenInMirrors, settings: PipelineSettings
) -> FingerSurface:
    """The surface's relief on the mirrors' shape; the finger ends where no mirror shows it.

    The shape keeps the fine detail of the one before (creases), but in the thesis's cases.
    """
    from splitknit.mirrors.captured import mirror_shape_of

    detail_mm = None if settings.method == "thesis" else surface.shape_mm
    shape_mm, mask, facts = mirror_shape_of(photographs.finger, seen, detail_mm)
    photographs.finger = replace(photographs.finger, mask=mask)
    facts = {**surface.facts, **facts}
    findings = (*surface.findings, *seen.shape.findings)
    return replace(surface, height_mm=shape_mm + surface.ridge_mm, shape_mm=shape_mm, facts=facts, findings=findings)
