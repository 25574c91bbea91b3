"""A white card photographed again: which LEDs depart from their calibration, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.card_images import card_images, led_name
from splitknit.calibration.card_light import CardPlane, card_light
from splitknit.calibration.radiometry import PROVENANCE, RadiometrySettings
from splitknit.errors import BadInput, require
from splitknit.model import Capture, Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CardCheck:
    """A later card against the stored one."""

    ratio: Array
    """(L,) brightness now over brightness at the calibration, of each LED."""
    common: Mapping[str, float | None]
    """Of each band: the median of its LEDs' ratios, what exposure, gain, lens and card do to all alike; None where the
    exposures of one of the two are not known."""
    own: Array
    """(L,) the ratio without the band's common part."""
    pattern_percent: Array
    """(L,) robust deviation over the picture of now over then: an LED that moved or turned."""
    ambient_percent: Mapping[str, float | None]
    sentences: tuple[str, ...]
    """What departs, in words; empty where nothing does."""


def check_card(
    capture: Capture, rig: Rig, black_level: float | None = None, settings: RadiometrySettings | None = None
) -> CardCheck:
    """Compare a card with the calibration that a rig carries.

    Parameters
    ----------
    capture : of the white card, as for :func:`splitknit.calibration.radiometry.calibrate_radiometry`
    rig : calibrated by it
    black_level : stored value of no light, for images of which the capture does not say it
    settings : RadiometrySettings, optional

    Returns
    -------
    CardCheck

    Raises
    ------
    BadInput
        If the rig carries no such calibration, or the capture cannot be used.
    """
    chosen = settings or RadiometrySettings()
    levels, plane, given = _stored(rig)
    images = card_images(capture, rig, black_level, chosen.images)
    expected = np.stack([card_light(rig.camera, led, images.pixels, plane) for led in rig.leds]) * levels[:, None]
    now = images.light / expected
    ratio = np.median(now, axis=1)
    require(bool((ratio > 0).all()), f"LED {int(np.argmin(ratio))} did not light; take the card again.")
    flat = now / ratio[:, None]
    pattern = 100 * 1.4826 * np.median(np.abs(flat - 1.0), axis=1)
    bands = np.array([led.band for led in rig.leds])
    middle = {band: float(np.median(ratio[bands == band])) for band in dict.fromkeys(bands.tolist())}
    own = ratio / np.array([middle[band] for band in bands])
    comparable = given and images.exposures_given
    common: dict[str, float | None] = {band: value if comparable else None for band, value in middle.items()}
    return CardCheck(
        ratio=ratio,
        common=common,
        own=own,
        pattern_percent=pattern,
        ambient_percent=images.ambient_percent,
        sentences=tuple(_sentences(rig, own, common, pattern, images.ambient_percent, chosen)),
    )


def _stored(rig: Rig) -> tuple[Array, CardPlane, bool]:
    """Each LED's card brightness at the calibration, where the card lay, and whether its exposures were known."""
    facts = rig.provenance.get(PROVENANCE)
    try:
        assert facts is not None
        levels = np.array([float(led["level"]) for led in facts["leds"]])
        card = facts["card"]
        x, y = (float(value) for value in card["tilt_deg"])
        plane = CardPlane(float(card["height_mm"]), (x, y))
        given = bool(card["exposures_given"])
        assert len(levels) == len(rig.leds) and bool((levels > 0).all())
    except (AssertionError, KeyError, TypeError, ValueError) as error:
        raise BadInput(
            "the rig carries no radiometric calibration to check against; make one with "
            "'splitknit calibrate radiometry FOLDER --rig RIG --out RIG2' and check RIG2."
        ) from error
    return levels, plane, given


def _sentences(  # noqa: PLR0917
    rig: Rig,
    own: Array,
    common: Mapping[str, float | None],
    pattern: Array,
    ambient: Mapping[str, float | None],
    settings: RadiometrySettings,
) -> list[str]:
    words: list[str] = []
    for k, value in enumerate(own):
        name = f"LED {led_name(rig.leds, k)}"
        if abs(value - 1) > 0.01 * settings.drift_percent:
            words.append(f"{name} is {_change(float(value))} than at the calibration.")
        if pattern[k] > settings.pattern_percent:
            words.append(
                f"{name} lights the card otherwise than at the calibration ({pattern[k]:.1f} % across the picture): it "
                f"moved or turned."
            )
    for band, value in common.items():
        if value is not None and abs(value - 1) > 0.01 * settings.drift_percent:
            words.append(
                f"all {band} LEDs together are {_change(value)} than at the calibration: exposure, gain, supply, lens "
                f"or card changed."
            )
    for band, share in ambient.items():
        if share is not None and share > settings.ambient_percent:
            words.append(f"light from elsewhere is {share:.1f} % of the {band} LEDs'.")
    return words


def _change(value: float) -> str:
    return f"{100 * abs(value - 1):.0f} % {'darker' if value < 1 else 'brighter'}"


def check_facts(check: CardCheck, rig: Rig) -> dict[str, Any]:
    """Return the check as plain JSON."""
    return {
        "verdict": "drifted" if check.sentences else "as calibrated",
        "leds": [
            {
                "led": k,
                "name": led_name(rig.leds, k),
                "ratio": float(f"{check.ratio[k]:.6g}"),
                "own_ratio": float(f"{check.own[k]:.6g}"),
                "pattern_percent": float(f"{check.pattern_percent[k]:.6g}"),
            }
            for k in range(len(rig.leds))
        ],
        "common_ratio": {b: None if v is None else float(f"{v:.6g}") for b, v in check.common.items()},
        "ambient_percent": {b: None if v is None else float(f"{v:.6g}") for b, v in check.ambient_percent.items()},
        "warnings": list(check.sentences),
    }
