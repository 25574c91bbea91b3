"""Whether the lights of an opaque thing are equally bright, where nobody stated it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.diagnosis.gains import light_gains, median_angle_deg
from splitknit.diagnosis.parameters import (
    CLEAR_SPREAD,
    EQUAL_SPREAD,
    LEAST_PHOTOGRAPHS,
    LEFT_BY_UNEQUAL,
    SURELY_UNEQUAL,
    WEAK_COLOUR,
)
from splitknit.diagnosis.photographs import light_left
from splitknit.findings import Finding
from splitknit.finger.locate import Finger
from splitknit.imaging.band import linear_channels, saturation_levels
from splitknit.model import Band, BoolArray, Capture
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.uncalibrated import bas_relief_of


def with_equal_lights(
    capture: Capture, band: Band, finger: Finger, binning: int, inside: BoolArray
) -> tuple[Band, dict[str, Any], list[Finding]]:
    """The white band of an opaque object whose images are divided by the brightness of their
    lights, in each colour, where nobody stated it and it is clearly unequal; facts and notes.
    """
    free = (
        capture.rig.intensities_assumed and band.flat is None and bas_relief_of(capture.rig) is None
    )
    if not free or len(band.lights) <= LEAST_PHOTOGRAPHS:
        return band, {}, []
    lights = capture.rig.select(band.lights).light_vectors()
    levels = saturation_levels(band, capture.encoding)
    channels = ("red", "green", "blue") if band.pixels.shape[3] == 3 else ("grey",)
    grey, *colours = linear_channels(
        band, capture.encoding, ("grey", *channels), finger.window, binning
    )
    gains = light_gains(grey, lights, inside, levels)
    scaled = lights * gains[:, None]
    before = light_left(grey, lights, inside, levels)
    after = light_left(grey, scaled, inside, levels)
    spread = float(np.std(np.log(gains)))
    asked = capture.rig.provenance.get("intensities") == "estimate"
    if not asked and (spread < EQUAL_SPREAD or after > LEFT_BY_UNEQUAL * before):
        return band, {}, []
    relative = gains / gains.mean()
    normals = lambertian(grey, lights, inside)[0][inside]
    turned_deg = median_angle_deg(normals, lambertian(grey, scaled, inside)[0][inside])
    effect = f"which turns the surface by {turned_deg:.1f} deg (median)"
    if not (
        asked or spread > CLEAR_SPREAD * after or (spread > SURELY_UNEQUAL and len(lights) > 5)
    ):
        words = (
            f"the lights may differ in brightness, by {100 * spread:.0f} %, {effect}, or shine and"
            " shadow look so: they are taken as equal; if they do, give `brightness` estimate, or"
            " as fourth numbers of the list, in its order:"
            f" {' '.join(f'{gain:.3f}' for gain in relative)}."
        )
        return band, {}, [Finding("unequal-lights", words, effect_deg=turned_deg)]
    transmission = np.repeat(gains[:, None], len(channels), axis=1)
    means = np.stack([stack[:, inside].mean(axis=1) for stack in colours], axis=1)
    if len(channels) == 3 and (means >= WEAK_COLOUR * means.mean()).all():
        of_colours = np.stack(
            [light_gains(stack, lights, inside, levels) for stack in colours], axis=1
        )
        transmission = of_colours * np.exp(np.log(gains).mean() - np.log(of_colours).mean(axis=0))
    each = "; ".join(
        f"{name} {gain:.2f}" for name, gain in zip(band.image_names, relative, strict=True)
    )
    words = (
        f"the lights differ in brightness, {effect}; that was estimated with the surface and taken"
        f" out: {each}."
    )
    facts = {"light_brightness": [round(float(gain), 3) for gain in relative]}
    finding = Finding("estimated-brightness", words, effect_deg=turned_deg)
    return replace(band, transmission=transmission), facts, [finding]
