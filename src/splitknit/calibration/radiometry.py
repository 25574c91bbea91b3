"""Radiometric calibration: a rig's lens, the brightness and beams of its LEDs; and the check of a later card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.card_images import CardImages, card_images, led_name
from splitknit.calibration.card_model import CardPlane, card_light
from splitknit.calibration.flat_field import DUST_PERCENT, MAX_DUST, FlatField, fit_flat_field
from splitknit.errors import refusing, require
from splitknit.model import Capture, Rig
from splitknit.settings import Checked, Limits

Array = NDArray[np.float64]
PROVENANCE = "radiometry"
"""Where a rig's provenance holds what is found here."""


_GLOSS_PERCENT = 2.0
"""A card whose mirror spot is brighter than this (and five of its errors) shines."""
_AMBIENT_PERCENT = 5.0
"""Light from elsewhere above which there is a warning, relative to the LEDs'."""
_PATTERN_PERCENT = 1.0
"""Departure of an LED's pattern on the card (robust deviation) above which it has moved or turned."""


@dataclass(frozen=True, slots=True)
class RadiometrySettings(Checked):
    """Limits of a radiometric calibration."""

    limit_percent: Annotated[float, Limits(0, above=True)] = 1.0
    """Largest rms of an LED's residuals."""
    drift_percent: Annotated[float, Limits(0, above=True)] = 3.0
    """Departure of an LED from the calibration above which there is a warning."""


@dataclass(frozen=True, slots=True, eq=False)
class RadiometricCalibration:
    """A rig's radiometry as a white card shows it."""

    rig: Rig
    """With the lens's fall-off, intensities, beams and aims; its provenance has the rest under `PROVENANCE`."""
    flat_field: FlatField
    images: CardImages
    facts: Mapping[str, Any]
    """What is stored in the rig's provenance: plain JSON."""
    warnings: tuple[str, ...]


def fit_radiometry(
    capture: Capture,
    rig: Rig,
    card: CardPlane | None = None,
    black_level: float | None = None,
    settings: RadiometrySettings | None = None,
) -> RadiometricCalibration:
    """Calibrate the light of a rig with calibrated camera and LEDs' places from a white card under each of its LEDs.
    `card` lies on the finger plane by default; `black_level`: stored value of no light, where the capture does not
    state it. Raises BadInput, naming what and where, if the images do not show an even, matt card under each LED alone.
    """
    chosen, plane = settings or RadiometrySettings(), card or CardPlane()
    images = card_images(capture, rig, black_level)
    flat = fit_flat_field(rig.camera, rig.leds, images.pixels, images.light, plane)
    _check(flat, rig, chosen)
    leds = [_led_facts(rig, flat, images, k, chosen) for k in range(len(rig.leds))]
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
        "lens": {"shading": list(flat.camera.shading), "corner": _round(1.0 + sum(flat.camera.shading))},
        "model": {
            "chosen": flat.order.name,
            "tried": [{"name": n, "parameters": p, "rms_percent": _round(rms)} for n, p, rms in flat.orders],
        },
        "ambient_percent": {band: None if v is None else _round(v) for band, v in images.ambient_percent.items()},
    }
    provenance = {**rig.provenance, PROVENANCE: facts}
    return RadiometricCalibration(
        rig=replace(rig, camera=flat.camera, leds=flat.leds, provenance=provenance),
        flat_field=flat,
        images=images,
        facts=facts,
        warnings=_warnings(rig, images, flat, black_level, chosen),
    )


def _check(flat: FlatField, rig: Rig, settings: RadiometrySettings) -> None:
    dust = float(flat.dust.mean())
    require(
        dust <= MAX_DUST,
        f"the card is not uniform: {100 * dust:.0f} % of the picture departs by more than "
        f"{DUST_PERCENT:g} % from an even card; clean or change it, and see that it reaches over all "
        f"borders.",
    )
    worst = int(np.argmax(flat.rms_percent))
    require(
        flat.rms_percent[worst] <= settings.limit_percent or flat.common_percent < 0.7 * flat.rms_percent[worst],
        f"the card is not uniform: it differs by {flat.common_percent:.1f} % from place to place under all LEDs; "
        f"use a clean matt white card.",
    )
    rms = float(flat.rms_percent[worst])
    require(
        rms <= settings.limit_percent,
        f"LED {worst} ({led_name(rig.leds, worst)}) lights the card otherwise than its place allows: the residuals' "
        f"rms is {rms:.1f} % (at most {settings.limit_percent:g} %), the largest {flat.largest_percent[worst]:.1f} %; "
        f"check its calibrated position, that nothing shadows the card, and that its beam is smooth (a frosted LED's "
        f"is).",
    )
    shines = flat.gloss_percent > _GLOSS_PERCENT and flat.gloss_percent > 5 * flat.gloss_error
    require(
        not shines,
        f"the card shines: it is {flat.gloss_percent:.1f} % brighter where a mirror would show the LEDs (at most "
        f"{_GLOSS_PERCENT:g} % may be); use a matt card, such as uncoated paper or a sheet of PTFE.",
    )


def _led_facts(rig: Rig, flat: FlatField, images: CardImages, k: int, settings: RadiometrySettings) -> dict[str, Any]:
    led = flat.leds[k]
    origin = -np.asarray(led.position_mm) / np.linalg.norm(np.asarray(led.position_mm))
    rms = float(flat.rms_percent[k])
    error = float(flat.exponent_error[k])
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
        "verdict": "good" if rms <= 0.5 * settings.limit_percent else "fair",
    }


def _warnings(
    rig: Rig, images: CardImages, flat: FlatField, black_level: float | None, settings: RadiometrySettings
) -> tuple[str, ...]:
    words = []
    for band, fraction in images.ambient_percent.items():
        if fraction is None:
            words.append(
                f"there is no ambient image of the band {band}: ambient light"
                f"{'' if black_level is not None else ' and black level'} counted as the LEDs'."
            )
        elif fraction > _AMBIENT_PERCENT:
            words.append(
                f"light from elsewhere is {fraction:.1f} % of the {band} LEDs' (limit {_AMBIENT_PERCENT:g} %); "
                f"close the lid, for it changes from image to image."
            )
    for k, largest in enumerate(flat.largest_percent):
        if largest > 3 * settings.limit_percent:
            words.append(
                f"LED {led_name(rig.leds, k)} departs from the model by up to {largest:.1f} %: its beam is not smooth, "
                f"or something shadows it."
            )
    dim = float(images.brightest.min())
    if dim < 0.25:
        words.append(f"the darkest image reaches {100 * dim:.0f} % of full scale only; expose longer for less noise.")
    if flat.gloss_percent > 0.5 * _GLOSS_PERCENT and flat.gloss_percent > 5 * flat.gloss_error:
        words.append(f"the card shines a little: {flat.gloss_percent:.1f} % where a mirror would show the LEDs.")
    return tuple(words)


def _round(value: float) -> float:
    return float(f"{value:.6g}")


def check_card(
    capture: Capture, rig: Rig, black_level: float | None = None, settings: RadiometrySettings | None = None
) -> dict[str, Any]:
    """Compare a card with the calibration that a rig carries; arguments as of :func:`fit_radiometry`. Raises BadInput
    if the rig carries no such calibration, or the capture cannot be used.

    Returns plain JSON: ``verdict``; of ``leds`` the ``ratio`` of brightness now to then, the ``own_ratio`` without the
    median of its band, and the ``pattern_percent``, robust deviation over the picture; ``common_ratio`` of each band,
    None where the exposures of one of the two are not known; ``ambient_percent``; ``warnings``: what departs.
    """
    chosen = settings or RadiometrySettings()
    levels, plane, given = _stored(rig)
    images = card_images(capture, rig, black_level)
    expected = np.stack([card_light(rig.camera, led, images.pixels, plane) for led in rig.leds]) * levels[:, None]
    now = images.light / expected
    ratio = np.median(now, axis=1)
    require(bool((ratio > 0).all()), f"LED {int(np.argmin(ratio))} did not light; take the card again.")
    flat = now / ratio[:, None]
    pattern = 100 * 1.4826 * np.median(np.abs(flat - 1.0), axis=1)  # of an LED that moved or turned
    bands = np.array([led.band for led in rig.leds])
    middle = {band: float(np.median(ratio[bands == band])) for band in dict.fromkeys(bands.tolist())}
    own = ratio / np.array([middle[band] for band in bands])
    comparable = given and images.exposures_given  # else exposure, gain, lens and card are not known to be the same
    common: dict[str, float | None] = {band: value if comparable else None for band, value in middle.items()}
    sentences: list[str] = []
    for k, value in enumerate(own):
        name = f"LED {led_name(rig.leds, k)}"
        if abs(value - 1) > 0.01 * chosen.drift_percent:
            sentences.append(f"{name} is {_change(float(value))} than at the calibration.")
        if pattern[k] > _PATTERN_PERCENT:
            sentences.append(
                f"{name} lights the card otherwise than at the calibration ({pattern[k]:.1f} % across "
                f"the picture): it moved or turned."
            )
    for band, value in common.items():
        if value is not None and abs(value - 1) > 0.01 * chosen.drift_percent:
            sentences.append(
                f"all {band} LEDs together are {_change(value)} than at the calibration: exposure, gain, supply, lens "
                f"or card changed."
            )
    for band, fraction in images.ambient_percent.items():
        if fraction is not None and fraction > _AMBIENT_PERCENT:
            sentences.append(f"light from elsewhere is {fraction:.1f} % of the {band} LEDs'.")
    columns = {"ratio": ratio, "own_ratio": own, "pattern_percent": pattern}
    return {
        "verdict": "drifted" if sentences else "as calibrated",
        "leds": [
            {"led": k, "name": led_name(rig.leds, k), **{what: _round(values[k]) for what, values in columns.items()}}
            for k in range(len(rig.leds))
        ],
        "common_ratio": {b: None if v is None else _round(v) for b, v in common.items()},
        "ambient_percent": {b: None if v is None else _round(v) for b, v in images.ambient_percent.items()},
        "warnings": sentences,
    }


def _stored(rig: Rig) -> tuple[Array, CardPlane, bool]:
    """Each LED's card brightness at the calibration, where the card lay, and whether its exposures were known."""
    with refusing(
        "the rig carries no radiometric calibration to check against; make one with "
        "'splitknit calibrate radiometry FOLDER --rig RIG --out RIG2' and check RIG2."
    ):
        facts = rig.provenance[PROVENANCE]
        levels = np.array([float(led["level"]) for led in facts["leds"]])
        card = facts["card"]
        x, y = (float(value) for value in card["tilt_deg"])
        plane, given = CardPlane(float(card["height_mm"]), (x, y)), bool(card["exposures_given"])
        assert len(levels) == len(rig.leds) and bool((levels > 0).all())
    return levels, plane, given


def _change(value: float) -> str:
    return f"{100 * abs(value - 1):.0f} % {'darker' if value < 1 else 'brighter'}"
