"""Whether the relief is the skin's: places without ridges, as under a plaster; ridges that one
image alone shows."""

from __future__ import annotations

import numpy as np

from splitknit.diagnosis.parameters import (
    BARE_BEYOND_MM,
    BARE_CONTRAST,
    BRIGHT_SKIN,
    CONTRAST_EDGE_MM,
    CONTRAST_WINDOW_MM,
    ENERGY_CAP,
    FEWEST_RIDGED,
    JUDGED_RIM_MM,
    LEAST_BARE_MM2,
    LEAST_PX_PER_MM,
    LIT_SKIN,
    MUCH_BARE,
    RIDGED_QUANTILE,
    RIDGES_FINE_MM,
    RIDGES_LEVEL_MM,
    UNLIKE_RIDGES,
)
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import depth_inside, dilate, largest_component, quantile
from splitknit.imaging.band import bin_mean, linear_stack
from splitknit.imaging.geometry import smoothed
from splitknit.model import Array, BoolArray, Capture, FloatArray

BARE = (
    "{:.0f} % of the finger (about {:.0f} mm2 in one place) shows no ridges although it is lit:"
    " heights there are not the skin's; take off what covers it, such as a plaster or dirt."
)
OTHER_RIDGES = (
    "{} does not show the ridges that all other photographs show (moved, double, or another"
    " finger's): the relief mixes both; capture it again."
)


def bare_patch(stack: FloatArray, mask: BoolArray, px_per_mm: float) -> tuple[float, float]:
    """Area of the largest lit patch of a finger without ridges: in mm2, and as a part of the skin
    that is judged; zeros where none is large enough to be more than a flaw of the skin.

    Ridges are what the light, relative to its surroundings, changes within a fraction of a
    millimetre, under each light alone: the mean square of its gradient, capped, so that an edge
    does not count as ridges all around.

    Parameters
    ----------
    stack : (L, h, w)
        Linear light under each lamp.
    mask : (h, w)
        The finger.
    px_per_mm
        Scale of the stack; below `LEAST_PX_PER_MM` no patch is found.
    """
    deep_mm = depth_inside(mask) / px_per_mm
    light = smoothed(stack.mean(axis=0), mask, RIDGES_LEVEL_MM * px_per_mm)
    judged = mask & (deep_mm > JUDGED_RIM_MM)
    if px_per_mm < LEAST_PX_PER_MM or not judged.any():
        return 0.0, 0.0
    judged &= light > LIT_SKIN * quantile(light[judged])
    energy = np.zeros(mask.shape, dtype=np.float32)
    for image in stack:
        level = smoothed(image, mask, RIDGES_LEVEL_MM * px_per_mm)
        floor = 0.05 * max(quantile(level[judged]), 1e-12)
        relative = (smoothed(image, mask, RIDGES_FINE_MM * px_per_mm) - level) / np.maximum(
            level, floor
        )
        down, across = np.gradient(relative)
        energy += down * down + across * across
    most = ENERGY_CAP * quantile(energy[judged], RIDGED_QUANTILE)
    contrast = smoothed(
        np.minimum(energy, most), deep_mm > CONTRAST_EDGE_MM, CONTRAST_WINDOW_MM * px_per_mm
    )
    bare = largest_component(
        judged & (contrast < BARE_CONTRAST**2 * quantile(contrast[judged], RIDGED_QUANTILE))
    )
    if bare.sum() < LEAST_BARE_MM2 * px_per_mm**2:
        return 0.0, 0.0
    pixels = int((dilate(bare, BARE_BEYOND_MM * px_per_mm) & judged).sum())
    return pixels / px_per_mm**2, pixels / int(judged.sum())


def findings_on_relief(capture: Capture, finger: Finger, *, fits: bool) -> list[Finding]:
    """A doubt where a large part of the finger shows no ridges, a note on a smaller one, which
    gloss may hide; a doubt where a white photograph shows other ridges than the rest, if it is not
    known that they do not fit their lights.
    """
    band, px_per_mm = capture.bands["white"], capture.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / (2 * LEAST_PX_PER_MM)))
    inside = bin_mean(finger.mask[finger.window].astype(np.float32), binning) > 0.99
    stack = linear_stack(band, capture.encoding, "grey", finger.window, binning)
    area_mm2, part = bare_patch(stack, inside, px_per_mm / binning)
    findings = []
    if area_mm2:
        words = BARE.format(100 * part, area_mm2)
        findings.append(
            Finding("bare-patch", words, Severity.DOUBT if part > MUCH_BARE else Severity.NOTE)
        )
    if fits and len(band.lights) == len(stack):
        lights = capture.rig.select(band.lights).light_vectors()
        unlike = unlike_image(stack, lights, inside, px_per_mm / binning)
        if unlike is not None:
            name = band.image_names[unlike]
            findings.append(
                Finding("other-ridges", OTHER_RIDGES.format(name), Severity.DOUBT, (name,))
            )
    return findings


def unlike_image(stack: FloatArray, lights: Array, mask: BoolArray, px_per_mm: float) -> int | None:
    """The image whose ridges are not those that all others show; None where there is none, or too
    few lights.

    Each image's ridge band is predicted from all others by least squares (light is linear in the
    albedo times the normal: R. J. Woodham, Optical Engineering 19, 1980), by the leverages of the
    whole fit (R. D. Cook and S. Weisberg, Residuals and influence in regression, 1982, equation
    2.2.4).

    Parameters
    ----------
    stack : (L, h, w)
        Linear light under each lamp.
    lights : (L, 3)
        Light vectors.
    mask : (h, w)
        The finger.
    px_per_mm
        Scale of the stack; below `LEAST_PX_PER_MM` nothing is judged.
    """
    light = stack.mean(axis=0)
    deep_mm = depth_inside(mask) / px_per_mm
    judged = mask & (deep_mm > JUDGED_RIM_MM)
    if len(stack) < FEWEST_RIDGED or px_per_mm < LEAST_PX_PER_MM or not judged.any():
        return None
    judged &= light > BRIGHT_SKIN * quantile(light[judged])
    level = smoothed(light, mask, RIDGES_LEVEL_MM * px_per_mm)[judged]
    fine, wide = (
        [smoothed(image, mask, mm * px_per_mm)[judged] for image in stack]
        for mm in (RIDGES_FINE_MM, RIDGES_LEVEL_MM)
    )
    ridges = (np.array(fine) - np.array(wide)) / level
    predicted = lights @ np.linalg.pinv(lights)
    error = np.median(np.abs(ridges - predicted @ ridges), axis=1) / (1 - np.diag(predicted))
    worst = int(error.argmax())
    return worst if error[worst] > UNLIKE_RIDGES * np.median(error) else None
