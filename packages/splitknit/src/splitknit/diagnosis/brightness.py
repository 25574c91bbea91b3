"""Whether the lights of an opaque thing are equally bright, where nobody stated it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.diagnosis.gains import LEAST, light_gains
from splitknit.diagnosis.photographs import light_left
from splitknit.findings import Finding
from splitknit.finger.locate import Finger
from splitknit.imaging.band import linear_channels, saturation_levels
from splitknit.model import Band, BoolArray, Capture
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.uncalibrated import bas_relief_of

_EQUAL, _CLEARLY, _SURELY_UNEQUAL = 0.02, 2.5, 0.18
"""Spread (standard deviation of the logarithm) up to which lights are equal; over the light left unexplained from where
the estimate is better than equal lights, as gloss looks like a spread of up to 2.0 times that (a glazed bear; 1.5 on 24
rendered objects of three glosses); and from where they surely differ."""
_EXPLAINED = 0.7
"""Unequal lights leave less than this part of the residual: 0.66 where they differ by 6 %, equal ones 0.77 and more."""
_WEAK_COLOUR = 0.1
"""A colour in which a light has less than this part of the mean tells little of it."""


def with_equal_lights(
    capture: Capture, band: Band, finger: Finger, binning: int, inside: BoolArray
) -> tuple[Band, dict[str, Any], list[Finding]]:
    """The white band of an opaque thing whose images are divided by the brightness of their lights, in each colour,
    where nobody stated it and it is clearly unequal; facts and notes."""
    free = capture.rig.intensities_assumed and band.flat is None and bas_relief_of(capture.rig) is None
    if not free or len(band.lights) <= LEAST:
        return band, {}, []
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
