"""Radiometric calibration: a rig's lens, the brightness and beams of its LEDs; and the check of a
later card.

A capture of a white card is condensed to a few hundred numbers an LED: robust means over cells,
which dust and noise hardly touch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitknit import Band, Capture, Rig
from splitknit.arguments import text_of
from splitknit.errors import refusing, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.imaging.band import linear_image, linear_stack, pick_channel
from splitknit.model import Array
from splitknit_rig.calibration.card_model import CardPlane, card_light
from splitknit_rig.calibration.flat_field import FlatField, fit_flat_field
from splitknit_rig.calibration.lights import led_name
from splitknit_rig.calibration.parameters import (
    AMBIENT_PERCENT,
    CARD_CELLS,
    CELL_BLOCKS,
    DRIFT_PERCENT,
    DUST_PERCENT,
    FULL_SCALE,
    GLOSS_PERCENT,
    MAX_CLIPPED_PERCENT,
    MAX_DUST,
    MAX_RESIDUAL_PERCENT,
    MIN_CARD_LIGHT,
    PATTERN_PERCENT,
)
from splitknit_rig.calibration.words import radiometry_lines


def _cells_of(band: Band, encoding: str) -> tuple[Array, Array]:
    """Middles of the cells, (rows, columns, 2) columns and rows, and a band's linear grey light (L,
    rows, columns) in them: black level and ambient light removed, the lens's fall-off left in.
    """
    size = band.pixels.shape[1:3]
    require(
        min(size) >= 16 and max(size) >= CARD_CELLS,
        f"the images have {size[0]} x {size[1]} pixels, too few for a calibration; use at least"
        f" {CARD_CELLS}.",
    )
    binning = max(1, round(max(size) / (CARD_CELLS * CELL_BLOCKS)))
    stack = linear_stack(band, encoding, "grey", binning=binning)
    inner = min(CELL_BLOCKS, max(1, max(size) // (binning * CARD_CELLS)))
    # what fills no cell is dropped
    rows, columns = stack.shape[1] // inner, stack.shape[2] // inner
    cells = (
        stack[:, : rows * inner, : columns * inner]
        .reshape(-1, rows, inner, columns, inner)
        .swapaxes(2, 3)
    )
    light = np.median(cells.reshape(-1, rows, columns, inner * inner), axis=-1).astype(np.float64)
    side = binning * inner
    row, column = np.mgrid[:rows, :columns] * side + (side - 1) / 2
    return np.stack([column, row], axis=-1), light


@dataclass(frozen=True, slots=True, eq=False)
class CardImages:
    """A white card under every LED of a rig, in the order of its LEDs."""

    pixels: Array  # (N, 2) column and row of the cells' middles
    light: Array  # (L, N) linear light of the LED alone, the lens's fall-off in it, by the exposure
    shape: tuple[int, int]  # rows and columns of cells
    # light with all LEDs off, by band, relative to the mean image; None where there is no such
    # image
    ambient_percent: dict[str, float | None]
    # whether the capture states how long it exposed, so that brightness can be compared with
    # another day's
    exposures_given: bool
    brightest: Array  # (L,) 99th percentile of each image's values, as a part of full scale


def card_images(capture: Capture, rig: Rig) -> CardImages:
    """Condense a capture of a white card, each LED of the rig alone in one image. Raises BadInput
    if capture and rig do not fit, or an image is missing, double, black or clipped.
    """
    _check_fit(capture, rig)
    bands = list(capture.bands.values())
    order = _images_of_leds(bands, rig)
    for band in bands:
        for k in range(len(band.pixels)):
            _check_image(band, k, rig)
    cells = [_cells_of(replace(band, shading=()), capture.encoding) for band in bands]
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
        shape=(places.shape[0], places.shape[1]),
        ambient_percent={
            band.name: _ambient_percent(band, capture.encoding, light)
            for band, (_, light) in zip(bands, cells, strict=True)
        },
        exposures_given=any(bool((band.exposure != 1.0).any()) for band in bands),
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


def _check_image(band: Band, k: int, rig: Rig) -> None:
    name = band.files[k] if band.files else f"image {k} of the band '{band.name}'"
    pixels, full = band.pixels[k], float(np.iinfo(band.pixels.dtype).max)
    clipped = 100 * float((pixels.max(axis=2) >= FULL_SCALE * full).mean())
    require(
        clipped <= MAX_CLIPPED_PERCENT,
        f"{name} is clipped: {clipped:.1f} % of its pixels are at full scale (at most"
        f" {MAX_CLIPPED_PERCENT:g} % may be); take the card with a shorter exposure.",
    )
    middle = (float(np.median(pixels[::4, ::4])) - float(band.black_level[k])) / full
    led = band.leds[k][0]
    require(
        middle > MIN_CARD_LIGHT,
        f"{name} is black ({100 * middle:.1f} % of full scale): LED {led}"
        f" ({led_name(rig.leds, led)}) did not light, or the exposure is far too short.",
    )


def _ambient_percent(band: Band, encoding: str, light: Array) -> float | None:
    if band.ambient is None:
        return None
    image = linear_image(
        band.ambient, encoding, band.ambient_exposure, band.ambient_black_level, binning=2
    )
    return _round(100 * float(np.mean(pick_channel(image, "grey"))) / float(np.mean(light)))


PROVENANCE = "radiometry"  # where a rig's provenance holds what is found here


@dataclass(frozen=True, slots=True, eq=False)
class RadiometricCalibration:
    """A rig's radiometry as a white card shows it."""

    rig: Rig
    """With the lens's fall-off, intensities, beams and aims; its provenance has the rest under
    `PROVENANCE`."""
    flat_field: FlatField
    images: CardImages
    facts: Mapping[str, Any]
    """What is stored in the rig's provenance: plain JSON; of a rig that was written also ``out``
    and ``files``."""
    findings: tuple[Finding, ...]
    base_tilt: bool = False
    """Whether the card was taken to lie as the rig's base does."""

    def __str__(self) -> str:
        return text_of(radiometry_lines(self.facts, base_tilt=self.base_tilt))


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
            "level": _round(flat.card_level),
            "exposures_given": images.exposures_given,
            "unevenness_percent": _round(flat.common_percent),
            "gloss_percent": _round(flat.gloss_percent),
            "dust_percent": _round(100 * float(flat.dust.mean())),
        },
        "leds": leds,
        "lens": {
            "shading": list(flat.camera.shading),
            "corner": _round(1.0 + sum(flat.camera.shading)),
        },
        "model": {
            "chosen": flat.order.name,
            "tried": [
                {"name": n, "parameters": p, "rms_percent": _round(rms)}
                for n, p, rms in flat.orders
            ],
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
        flat.gloss_percent <= max(GLOSS_PERCENT, 5 * flat.gloss_error),
        f"the card shines: it is {flat.gloss_percent:.1f} % brighter where a mirror would show the"
        f" LEDs (at most {GLOSS_PERCENT:g} % may be); use a matt card, such as uncoated paper or a"
        " sheet of PTFE.",
    )


def _led_facts(
    rig: Rig, flat: FlatField, images: CardImages, k: int, limit_percent: float
) -> dict[str, Any]:
    led = flat.leds[k]
    origin = -np.asarray(led.position_mm) / np.linalg.norm(np.asarray(led.position_mm))
    rms, error = float(flat.rms_percent[k]), float(flat.exponent_error[k])
    level = np.median(images.light[k] / card_light(flat.camera, led, images.pixels, flat.card))
    return {
        "led": k,
        "name": led_name(rig.leds, k),
        "intensity": led.intensity,
        "lobe_exponent": led.lobe_exponent,
        "lobe_exponent_error": _round(error) if np.isfinite(error) else None,
        "aim_off_deg": _round(float(np.rad2deg(np.arccos(np.clip(led.axis @ origin, -1, 1))))),
        "level": _round(float(level)),
        "rms_percent": _round(rms),
        "largest_percent": _round(float(flat.largest_percent[k])),
        "verdict": "good" if rms <= 0.5 * limit_percent else "fair",
    }


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
        elif fraction > AMBIENT_PERCENT:
            words = (
                f"light from elsewhere is {fraction:.1f} % of the {band} LEDs' (limit"
                f" {AMBIENT_PERCENT:g} %); close the lid, for it changes from image to image."
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
    if flat.gloss_percent > 0.5 * GLOSS_PERCENT and flat.gloss_percent > 5 * flat.gloss_error:
        words = (
            f"the card shines a little: {flat.gloss_percent:.1f} % where a mirror would show the"
            " LEDs."
        )
        findings.append(Finding("glossy-card", words))
    return worst_first(findings)


def _round(value: float) -> float:
    return float(f"{value:.6g}")


@dataclass(frozen=True, slots=True)
class CardCheck:
    """How a rig's light departs from its calibration."""

    facts: dict[str, Any]
    """``verdict``; of ``leds`` the ``ratio`` of brightness now to then, the ``own_ratio`` without
    the median of its band, and the ``pattern_percent``, robust deviation over the picture;
    ``common_ratio`` of each band, None where exposures are not known; ``ambient_percent``;
    ``findings``."""
    findings: tuple[Finding, ...]
    limit_percent: float

    def __str__(self) -> str:
        own = [100 * led["own_ratio"] for led in self.facts["leds"]]
        lines = [
            f"The LEDs show the card at {min(own):.1f} to {max(own):.1f} % of their calibrated"
            " brightness."
        ]
        if None in self.facts["common_ratio"].values():
            lines.append(
                "Only LEDs of one band are compared: the exposures are not known on both days."
            )
        lines += [f"Please note: {finding}" for finding in self.findings]
        if not self.findings:
            lines.append(f"All LEDs are as calibrated, within {self.limit_percent:g} %.")
        return text_of(lines)


def check_card(capture: Capture, rig: Rig, limit_percent: float = DRIFT_PERCENT) -> CardCheck:
    """Compare a card with the calibration that a rig carries; BadInput if it carries none, or as
    :func:`fit_radiometry`.
    """
    with refusing(
        "the rig carries no radiometric calibration to check against; make one with "
        "'splitknit calibrate radiometry' and check that."
    ):
        stored = rig.provenance[PROVENANCE]
        levels = np.array([float(led["level"]) for led in stored["leds"]])
        x, y = (float(value) for value in stored["card"]["tilt_deg"])
        plane = CardPlane(float(stored["card"]["height_mm"]), (x, y))
        exposures_given = bool(stored["card"]["exposures_given"])
        assert len(levels) == len(rig.leds) and bool((levels > 0).all())
    images = card_images(capture, rig)
    expected = (
        np.stack([card_light(rig.camera, led, images.pixels, plane) for led in rig.leds])
        * levels[:, None]
    )
    now = images.light / expected
    ratio = np.median(now, axis=1)
    require(
        bool((ratio > 0).all()), f"LED {int(np.argmin(ratio))} did not light; take the card again."
    )
    # of an LED that moved or turned
    pattern = 100 * 1.4826 * np.median(np.abs(now / ratio[:, None] - 1.0), axis=1)
    bands = np.array([led.band for led in rig.leds])
    middle = {
        band: float(np.median(ratio[bands == band])) for band in dict.fromkeys(bands.tolist())
    }
    own = ratio / np.array([middle[band] for band in bands])
    # else exposure, gain, lens and card are not known to be the same
    comparable = exposures_given and images.exposures_given
    findings: list[Finding] = []
    leds = []
    for k, value in enumerate(own):
        name = led_name(rig.leds, k)
        if abs(value - 1) > 0.01 * limit_percent:
            words = f"LED {name} is {_change(float(value))} than at the calibration."
            findings.append(Finding("drifted-led", words, Severity.DOUBT))
        if pattern[k] > PATTERN_PERCENT:
            words = (
                f"LED {name} lights the card otherwise than at the calibration ({pattern[k]:.1f} %"
                " across the picture): it moved or turned."
            )
            findings.append(Finding("moved-led", words, Severity.DOUBT))
        ratios = {
            "ratio": _round(ratio[k]),
            "own_ratio": _round(value),
            "pattern_percent": _round(pattern[k]),
        }
        leds.append({"led": k, "name": name, **ratios})
    for band, value in middle.items():
        if comparable and abs(value - 1) > 0.01 * limit_percent:
            words = (
                f"all {band} LEDs together are {_change(value)} than at the calibration: exposure,"
                " gain, supply, lens or card changed."
            )
            findings.append(Finding("drifted-band", words, Severity.DOUBT))
    for band, fraction in images.ambient_percent.items():
        if fraction is not None and fraction > AMBIENT_PERCENT:
            words = f"light from elsewhere is {fraction:.1f} % of the {band} LEDs'."
            findings.append(Finding("ambient-light", words))
    facts = {
        "verdict": "drifted" if findings else "as calibrated",
        "leds": leds,
        "common_ratio": {
            band: _round(value) if comparable else None for band, value in middle.items()
        },
        "ambient_percent": images.ambient_percent,
        "findings": [finding.facts for finding in worst_first(findings)],
        "limit_percent": limit_percent,
        "inputs": dict(capture.hashes),
    }
    return CardCheck(facts, worst_first(findings), limit_percent)


def _change(value: float) -> str:
    return f"{100 * abs(value - 1):.0f} % {'darker' if value < 1 else 'brighter'}"
