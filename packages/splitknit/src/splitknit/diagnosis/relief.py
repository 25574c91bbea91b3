"""Whether the relief is the skin's: places without ridges, as under a plaster; ridges that one
image alone shows."""

from __future__ import annotations

import numpy as np

from splitknit.diagnosis.samples import in_blocks
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import depth_inside, dilate, largest_component, quantile
from splitknit.imaging.geometry import smoothed
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.observe import Observation

BARE = (
    "{:.0f} % of the finger (about {:.0f} mm2 in one place) shows no ridges although it is lit:"
    " heights there are not the skin's; take off what covers it, such as a plaster or dirt."
)
OTHER_RIDGES = (
    "{} does not show the ridges that all other photographs show (moved, double, blurred, or"
    " another finger's): the relief mixes both; capture it again."
)
_LEAST_PX_PER_MM = 6.0  # scale below which ridges are not seen: three pixels from one to the next
_RIDGES_FINE_MM = 0.06
"""Standard deviation of the Gaussian that is finer than ridges, 0.4 to 0.6 mm apart."""
_RIDGES_LEVEL_MM = 0.35  # standard deviation of the Gaussian that is coarser than ridges
_JUDGED_RIM_MM = 1.5  # skin nearer to the outline is not judged
_RIDGED_QUANTILE = 0.75  # quantile of the skin that surely has ridges: a plaster may cover half
_BARE_CONTRAST = 0.45
"""Fraction of the ridged skin's contrast below which skin is bare. With 0.5 one of 185 sound
fingers, a glossy one, had a patch of 8 mm2; with 0.45 the largest has 2.5 mm2, and that of four
path-traced fingers 3.5. Chosen on: simulated fingers (185 sound ones, then four path-traced ones).
Range: 0.45 to 0.5."""
_LEAST_BARE_MM2 = 4.0
"""Smallest bare patch that counts. Chosen on: simulated fingers (185 sound ones)."""
_BARE_BEYOND_MM = 1.0
"""How far beyond a bare patch skin is bare as well, since the window reaches over its edge: the
patch so grown had 0.78 to 1.02 of the plasters' area. Chosen on: simulated fingers (92
plasters)."""


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
        Scale of the stack; below `_LEAST_PX_PER_MM` no patch is found.
    """
    deep_mm = depth_inside(mask) / px_per_mm
    light = smoothed(stack.mean(axis=0), mask, _RIDGES_LEVEL_MM * px_per_mm)
    judged = mask & (deep_mm > _JUDGED_RIM_MM)
    if px_per_mm < _LEAST_PX_PER_MM or not judged.any():
        return 0.0, 0.0
    # part of the finger's median light that lit skin has
    judged &= light > 0.35 * quantile(light[judged])
    energy = np.zeros(mask.shape, dtype=np.float32)
    for image in stack:
        level = smoothed(image, mask, _RIDGES_LEVEL_MM * px_per_mm)
        floor = 0.05 * max(quantile(level[judged]), 1e-12)
        relative = (smoothed(image, mask, _RIDGES_FINE_MM * px_per_mm) - level) / np.maximum(
            level, floor
        )
        down, across = np.gradient(relative)
        energy += down * down + across * across
    # part of that skin's energy at which a pixel counts as part of a ridge
    most = 0.3 * quantile(energy[judged], _RIDGED_QUANTILE)
    # mean contrast of the ridges in a Gaussian of 0.5 mm, in which skin within 0.4 mm of the
    # outline does not count
    contrast = smoothed(np.minimum(energy, most), deep_mm > 0.4, 0.5 * px_per_mm)
    bare = largest_component(
        judged & (contrast < _BARE_CONTRAST**2 * quantile(contrast[judged], _RIDGED_QUANTILE))
    )
    if bare.sum() < _LEAST_BARE_MM2 * px_per_mm**2:
        return 0.0, 0.0
    pixels = int((dilate(bare, _BARE_BEYOND_MM * px_per_mm) & judged).sum())
    return pixels / px_per_mm**2, pixels / int(judged.sum())


_MUCH_BARE = 0.15
"""Part of the finger without ridges that is doubted and not merely noted: one of some 40 sound
fingers in all conditions had 0.11. Chosen on: simulated fingers (some 40 in all conditions)."""


def findings_on_relief(observation: Observation, finger: Finger, *, fits: bool) -> list[Finding]:
    """A doubt where a large part of the finger shows no ridges, a note on a smaller one, which
    gloss may hide; a doubt where a white photograph shows other ridges than the rest, if it is not
    known that they do not fit their lights.
    """
    white, px_per_mm = observation.white, observation.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / (2 * _LEAST_PX_PER_MM)))
    light, inside, _ = in_blocks(white, finger.mask, finger.window, binning)
    stack = light.grey
    area_mm2, part = bare_patch(stack, inside, px_per_mm / binning)
    findings = []
    if area_mm2:
        words = BARE.format(100 * part, area_mm2)
        findings.append(
            Finding("bare-patch", words, Severity.DOUBT if part > _MUCH_BARE else Severity.NOTE)
        )
    if fits and white.photographs == len(stack):
        lights = white.rig.light_vectors()
        unlike = unlike_image(stack, lights, inside, px_per_mm / binning)
        if unlike is not None:
            name = white.image_names[unlike]
            findings.append(
                Finding("other-ridges", OTHER_RIDGES.format(name), Severity.DOUBT, (name,))
            )
    return findings


_UNLIKE_RIDGES = 1.8
"""Error of an image's ridges, as the others predict them, over the images' median: 1.01 to 1.44 on
196 sound simulated fingers and 1.61, 1.74 on two of 190 others (glossy, wet); 2.1 and more with an
image of another finger, 1.4 to 3.6 with one that shows everything twice. Chosen on: simulated
fingers (196 and 190 sound ones). Range: 1.74 to 2.1."""


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
        Scale of the stack; below `_LEAST_PX_PER_MM` nothing is judged.
    """
    light = stack.mean(axis=0)
    deep_mm = depth_inside(mask) / px_per_mm
    judged = mask & (deep_mm > _JUDGED_RIM_MM)
    # lights of which each is judged by the others
    if len(stack) < 6 or px_per_mm < _LEAST_PX_PER_MM or not judged.any():
        return None
    # part of the finger's median light that skin has whose ridges are compared between single
    # images
    judged &= light > 0.5 * quantile(light[judged])
    level = smoothed(light, mask, _RIDGES_LEVEL_MM * px_per_mm)[judged]
    fine, wide = (
        [smoothed(image, mask, mm * px_per_mm)[judged] for image in stack]
        for mm in (_RIDGES_FINE_MM, _RIDGES_LEVEL_MM)
    )
    ridges = (np.array(fine) - np.array(wide)) / level
    predicted = lights @ np.linalg.pinv(lights)
    error = np.median(np.abs(ridges - predicted @ ridges), axis=1) / (1 - np.diag(predicted))
    worst = int(error.argmax())
    return worst if error[worst] > _UNLIKE_RIDGES * np.median(error) else None
