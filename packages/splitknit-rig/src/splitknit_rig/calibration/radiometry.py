"""Radiometric calibration: a rig's lens, the brightness and beams of its LEDs; and the check of a
later card.

A capture of a white card is condensed to a few hundred numbers per LED: robust means over cells,
which dust and noise hardly affect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitknit import Band, Capture, Rig
from splitknit.arguments import text_of
from splitknit.errors import require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.model import Array
from splitknit.observation.light import FULL_SCALE, Light
from splitknit_rig.calibration.card_model import CardPlane, card_light
from splitknit_rig.calibration.flat_field import DUST_PERCENT, MAX_DUST, FlatField, fit_flat_field
from splitknit_rig.calibration.lights import led_name
from splitknit_rig.calibration.words import radiometry_lines

_CARD_CELLS = 40  # along the longer side of the white card's image
_CELL_BLOCKS = 5  # a side of a cell, whose brightness is the median of their means


def _cells_of(light: Light) -> tuple[Array, Array]:
    """Centres of the cells, (rows, columns, 2) as column and row, and the median of linear grey
    light (L, rows, columns) in them.
    """
    size = light.shape
    require(
        min(size) >= 16 and max(size) >= _CARD_CELLS,
        f"the images have {size[0]} x {size[1]} pixels, too few for a calibration; use at least"
        f" {_CARD_CELLS}.",
    )
    binning = max(1, round(max(size) / (_CARD_CELLS * _CELL_BLOCKS)))
    stack = light.at(binning).grey
    inner = min(_CELL_BLOCKS, max(1, max(size) // (binning * _CARD_CELLS)))
    # what fills no cell is dropped
    rows, columns = stack.shape[1] // inner, stack.shape[2] // inner
    cells = (
        stack[:, : rows * inner, : columns * inner]
        .reshape(-1, rows, inner, columns, inner)
        .swapaxes(2, 3)
    )
    medians = np.median(cells.reshape(-1, rows, columns, inner * inner), axis=-1)
    side = binning * inner
    row, column = np.mgrid[:rows, :columns] * side + (side - 1) / 2
    return np.stack([column, row], axis=-1), medians.astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class CardImages:
    """A white card under every LED of a rig, in the order of its LEDs."""

    pixels: Array  # (N, 2) column and row of the cells' middles
    light: Array  # (L, N) linear light of the LED alone, the lens's fall-off in it, by the exposure
    # light with all LEDs off, by band, relative to the mean image; None where there is no such
    # image
    ambient_percent: dict[str, float | None]
    brightest: Array  # (L,) 99th percentile of each image's values, as a part of full scale


def card_images(capture: Capture, rig: Rig, *, may_be_dark: bool = False) -> CardImages:
    """Condense a capture of a white card, with each LED of the rig alone in one image. Raises
    BadInput if capture and rig do not match, or an image is missing, double, clipped, or black.
    """
    _check_fit(capture, rig)
    bands = list(capture.bands.values())
    order = _images_of_leds(bands, rig)
    for band in bands:
        for k in range(len(band.pixels)):
            _check_image(band, k, rig, may_be_dark=may_be_dark)
    # the lens's fall-off, which is to be measured, stays in the light
    bare = replace(capture.rig, camera=replace(capture.rig.camera, shading=()))
    lights = [Light(band, bare, capture.encoding) for band in bands]
    cells = [_cells_of(light) for light in lights]
    places = cells[0][0]
    stored = [
        [
            float(np.percentile(image[::4, ::4].max(axis=2), 99)) / np.iinfo(image.dtype).max
            for image in band.pixels
        ]
        for band in bands
    ]
    return CardImages(
        pixels=places.reshape(-1, 2),
        light=np.stack([cells[b][1][k].ravel() for b, k in order]),
        ambient_percent={
            light.name: _ambient_percent(light, lit)
            for light, (_, lit) in zip(lights, cells, strict=True)
        },
        brightest=np.array([stored[b][k] for b, k in order]),
    )


def _check_fit(capture: Capture, rig: Rig) -> None:
    own = capture.rig
    require(
        own.camera.image_size == rig.camera.image_size,
        f"the card's images have {own.camera.image_size[0]} x {own.camera.image_size[1]} pixels,"
        f" but the rig's camera has {rig.camera.image_size[0]} x {rig.camera.image_size[1]}; give"
        " the rig that took them.",
    )
    require(
        [led.band for led in own.leds] == [led.band for led in rig.leds],
        f"the card was taken with a rig of {len(own.leds)} LEDs, but the rig to calibrate has"
        f" {len(rig.leds)} (or orders its bands otherwise); give the rig that took them.",
    )
    for k, led in enumerate(rig.leds):
        words = (
            f"LED {k} of the rig has a direction, but no position_mm; calibrate the lights first."
        )
        require(led.position_mm is not None, words)


def _images_of_leds(bands: Sequence[Band], rig: Rig) -> list[tuple[int, int]]:
    images: dict[int, tuple[int, int]] = {}
    for b, band in enumerate(bands):
        for k, group in enumerate(band.leds):
            require(
                len(group) == 1,
                f"image {k} of the band '{band.name}' is lit by {len(group)} LEDs; each LED must"
                " light the card alone.",
            )
            require(
                group[0] not in images,
                f"LED {group[0]} ({led_name(rig.leds, group[0])}) lights two images of the card;"
                " keep one.",
            )
            images[group[0]] = (b, k)
    missing = [f"{k} ({led_name(rig.leds, k)})" for k in range(len(rig.leds)) if k not in images]
    require(
        not missing,
        f"the card has {len(images)} images for the rig's {len(rig.leds)} LEDs: LED"
        f" {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing; take the card under"
        " every LED.",
    )
    return [images[k] for k in range(len(rig.leds))]


_MAX_CLIPPED_PERCENT = 0.5  # of an image's pixels


def _check_image(band: Band, k: int, rig: Rig, *, may_be_dark: bool) -> None:
    name = band.files[k] if band.files else f"image {k} of the band '{band.name}'"
    pixels, full = band.pixels[k], float(np.iinfo(band.pixels.dtype).max)
    clipped = 100 * float((pixels.max(axis=2) >= FULL_SCALE * full).mean())
    require(
        clipped <= _MAX_CLIPPED_PERCENT,
        f"{name} is clipped: {clipped:.1f} % of its pixels are at full scale (at most"
        f" {_MAX_CLIPPED_PERCENT:g} % may be); take the card with a shorter exposure.",
    )
    middle = (float(np.median(pixels[::4, ::4])) - float(band.black_level[k])) / full
    led = band.leds[k][0]
    require(
        may_be_dark or middle > 0.02,  # of full scale: black
        f"{name} is black ({100 * middle:.1f} % of full scale): LED {led}"
        f" ({led_name(rig.leds, led)}) did not light, or the exposure is far too short.",
    )


def _ambient_percent(light: Light, lit: Array) -> float | None:
    dark = light.at(2).ambient
    return None if dark is None else rounded(100 * float(np.mean(dark)) / np.mean(lit))


PROVENANCE = "radiometry"  # where a rig's provenance holds what is found here


@dataclass(frozen=True, slots=True, eq=False)
class RadiometricCalibration:
    """A rig's radiometry, measured with a white card."""

    rig: Rig
    """The rig with the lens's fall-off, intensities, beams and aims; its provenance holds the rest
    under `PROVENANCE`."""
    flat_field: FlatField
    images: CardImages
    facts: Mapping[str, Any]
    """What is stored in the rig's provenance: plain JSON; of a rig that was written also
    ``out``."""
    findings: tuple[Finding, ...]
    base_tilt: bool = False
    """Whether the card was assumed to be tilted like the rig's base."""

    def __str__(self) -> str:
        return text_of(radiometry_lines(self.facts, base_tilt=self.base_tilt))


MAX_RESIDUAL_PERCENT = 1.0
"""Limit of the rms of an LED's residuals: the goal of the radiometric calibration."""


def fit_radiometry(
    capture: Capture,
    rig: Rig,
    card: CardPlane | None = None,
    limit_percent: float = MAX_RESIDUAL_PERCENT,
) -> RadiometricCalibration:
    """Calibrate the light of a rig with calibrated camera and LEDs' places from a white card (on
    the finger plane by default) under each LED. Raises BadInput, naming what and where, if the
    images show no even, matt card.
    """
    plane = card or CardPlane()
    images = card_images(capture, rig)
    flat = fit_flat_field(rig.camera, rig.leds, images.pixels, images.light, plane)
    _check(flat, rig, limit_percent)
    leds = [_led_facts(rig, flat, images, k, limit_percent) for k in range(len(rig.leds))]
    facts: dict[str, Any] = {
        "captured_at": capture.captured_at,
        "card": {
            "height_mm": plane.height_mm,
            "tilt_deg": list(plane.tilt_deg),
            "level": rounded(flat.card_level),
            "unevenness_percent": rounded(flat.common_percent),
            "gloss_percent": rounded(flat.gloss_percent),
            "dust_percent": rounded(100 * flat.dust.mean()),
        },
        "leds": leds,
        "lens": {
            "shading": list(flat.camera.shading),
            "corner": rounded(1.0 + sum(flat.camera.shading)),
        },
        "ambient_percent": images.ambient_percent,
    }
    provenance = {**rig.provenance, PROVENANCE: facts}
    return RadiometricCalibration(
        rig=replace(rig, camera=flat.camera, leds=flat.leds, provenance=provenance),
        flat_field=flat,
        images=images,
        facts=facts,
        findings=_findings(rig, images, flat, limit_percent),
    )


_GLOSS_PERCENT = 2.0
"""A card is glossy if its specular spot is brighter than this and than five standard errors."""


def _check(flat: FlatField, rig: Rig, limit_percent: float) -> None:
    dust = float(flat.dust.mean())
    require(
        dust <= MAX_DUST,
        f"the card is not uniform: {100 * dust:.0f} % of the picture departs by more than"
        f" {DUST_PERCENT:g} % from an even card; clean or change it, and see that it reaches over"
        " all borders.",
    )
    worst, rms = int(np.argmax(flat.rms_percent)), float(flat.rms_percent.max())
    require(
        rms <= limit_percent or flat.common_percent < 0.7 * rms,
        f"the card is not uniform: it differs by {flat.common_percent:.1f} % from place to place"
        " under all LEDs; use a clean matt white card.",
    )
    require(
        rms <= limit_percent,
        f"LED {worst} ({led_name(rig.leds, worst)}) lights the card otherwise than its place"
        f" allows: the residuals' rms is {rms:.1f} % (at most {limit_percent:g} %), the largest"
        f" {flat.largest_percent[worst]:.1f} %; check its calibrated position, that nothing shadows"
        " the card, and that its beam is smooth (a frosted LED's is).",
    )
    require(
        flat.gloss_percent <= max(_GLOSS_PERCENT, 5 * flat.gloss_error),
        f"the card shines: it is {flat.gloss_percent:.1f} % brighter where a mirror would show the"
        f" LEDs (at most {_GLOSS_PERCENT:g} % may be); use a matt card, such as uncoated paper or a"
        " sheet of PTFE.",
    )


def _led_facts(
    rig: Rig, flat: FlatField, images: CardImages, k: int, limit_percent: float
) -> dict[str, Any]:
    led = flat.leds[k]
    origin = -np.asarray(led.position_mm) / np.linalg.norm(np.asarray(led.position_mm))
    rms = float(flat.rms_percent[k])
    level = np.median(images.light[k] / card_light(flat.camera, led, images.pixels, flat.card))
    return {
        "led": k,
        "name": led_name(rig.leds, k),
        "intensity": led.intensity,
        "lobe_exponent": led.lobe_exponent,
        "lobe_exponent_error": rounded(flat.exponent_error[k]),
        "aim_off_deg": rounded(np.rad2deg(np.arccos(np.clip(led.axis @ origin, -1, 1)))),
        "level": rounded(level),
        "rms_percent": rounded(rms),
        "largest_percent": rounded(flat.largest_percent[k]),
        "verdict": "good" if rms <= 0.5 * limit_percent else "fair",
    }


_AMBIENT_PERCENT = 5.0
"""Limit of ambient light, relative to that of the LEDs."""


def _findings(
    rig: Rig, images: CardImages, flat: FlatField, limit_percent: float
) -> tuple[Finding, ...]:
    findings = []
    for band, fraction in images.ambient_percent.items():
        if fraction is None:
            words = (
                f"there is no ambient image of the band {band}: ambient light and black level"
                " counted as the LEDs'."
            )
            findings.append(Finding("no-ambient-image", words))
        elif fraction > _AMBIENT_PERCENT:
            words = (
                f"light from elsewhere is {fraction:.1f} % of the {band} LEDs' (limit"
                f" {_AMBIENT_PERCENT:g} %); close the lid, for it changes from image to image."
            )
            findings.append(Finding("ambient-light", words))
    for k, largest in enumerate(flat.largest_percent):
        if largest > 3 * limit_percent:
            words = (
                f"LED {led_name(rig.leds, k)} departs from the model by up to {largest:.1f} %: its"
                " beam is not smooth, or something shadows it."
            )
            findings.append(Finding("uneven-beam", words, Severity.DOUBT))
    dim = float(images.brightest.min())
    if dim < 0.25:
        words = (
            f"the darkest image reaches {100 * dim:.0f} % of full scale only; expose longer for"
            " less noise."
        )
        findings.append(Finding("dark-photographs", words))
    if flat.gloss_percent > 0.5 * _GLOSS_PERCENT and flat.gloss_percent > 5 * flat.gloss_error:
        words = (
            f"the card shines a little: {flat.gloss_percent:.1f} % where a mirror would show the"
            " LEDs."
        )
        findings.append(Finding("glossy-card", words))
    return worst_first(findings)


def rounded(value: float | np.floating) -> float:
    """A number for a report, to six digits."""
    return float(f"{value:.6g}")


def beside_calibration(
    images: CardImages, rig: Rig, plane: CardPlane
) -> tuple[Array, Array, Array]:
    """(L,) each: brightness of the card under each LED relative to the rig's calibration, the same
    relative to the median of the LED's band, and the robust standard deviation across the
    picture."""
    expected = np.stack([card_light(rig.camera, led, images.pixels, plane) for led in rig.leds])
    now = images.light / expected
    ratio = np.median(now, axis=1)
    ratio = np.maximum(ratio, 1e-6)  # of an LED that did not light
    pattern = 1.4826 * np.median(np.abs(now / ratio[:, None] - 1.0), axis=1)
    bands = np.array([led.band for led in rig.leds])
    middles = np.array([np.median(ratio[bands == band]) for band in bands])
    return ratio, ratio / middles, pattern
