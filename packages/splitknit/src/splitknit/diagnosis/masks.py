"""Whether the mask holds the object, and whether both bands show one finger in one place."""

from __future__ import annotations

import numpy as np

from splitknit.diagnosis.samples import sampled_light
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import border, erode
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.observe import Observation

INVERTED = (
    "the mask looks inverted: it runs around the picture, and what it leaves out turns more with"
    " the light than what it holds, so that the table is measured; paint the object white and all"
    " else black."
)
_LIT_OBJECT = 0.1  # lit is what is brighter than this fraction of the brightest pixels
_INVERTED_TURNS = 2.5
"""Spread of directions (70 % of pixels) of what an inverted mask leaves out, over that of what it
holds. Chosen on: simulated objects (drawn, on six kinds of tables)."""
_INVERTED_TURNS_DEG = 5.0
"""Spread of directions of what an inverted mask leaves out, at least. Chosen on: simulated objects
(drawn, on six kinds of tables)."""


def leaves_out_object(images: FloatArray, lights: Array, inside: BoolArray) -> bool:
    """Whether a mask looks inverted: it runs around the picture, and what it leaves out, lit,
    changes more in direction than what it holds. Directions are those of pinv(lights) @ images, one
    vector a pixel.
    """
    mean = images.mean(axis=0)
    lit = mean > _LIT_OBJECT * np.quantile(mean, 0.995)
    beside, held = lit & ~inside, lit & inside
    corners = inside[:: max(1, len(inside) - 1), :: max(1, inside.shape[1] - 1)]
    # a mask may be inverted that holds the picture's corners and this fraction of its border
    # a mask may be inverted that leaves out this fraction of the picture's border, lit
    if not corners.all() or border(inside).mean() < 0.7 or beside.mean() < 0.02:
        return False
    if held.sum() < _LIT_OBJECT * inside.sum():
        return True
    rows, columns = np.nonzero(held)
    light = np.tensordot(np.linalg.pinv(lights), images, 1)
    unit = light / np.maximum(np.linalg.norm(light, axis=0), 1e-12)
    place = np.stack([rows, columns, np.ones(len(rows))], axis=1)
    trend = place @ np.linalg.lstsq(place, unit[:, held].T, rcond=None)[0]
    level = np.median(unit[:, beside], axis=1, keepdims=True)
    spreads = [
        float(np.degrees(np.quantile(np.linalg.norm(rest, axis=0), 0.7)))
        for rest in (unit[:, held] - trend.T, unit[:, beside] - level)
    ]
    return spreads[1] > max(_INVERTED_TURNS * spreads[0], _INVERTED_TURNS_DEG)


def findings_on_mask(observation: Observation, finger: Finger) -> list[Finding]:
    """A doubt where the given mask holds what lies around the object."""
    white = observation.white
    if observation.mask is None or white.colours:
        return []
    stack, lights, some = sampled_light(white)
    inverted = leaves_out_object(stack, lights, finger.mask[some])
    return [Finding("inverted-mask", INVERTED, Severity.DOUBT)] if inverted else []


_DARK_RIM = 0.03
"""Fraction of the rim that is darker in near infrared than in white from which the outlines differ:
below 0 on simulated and path-traced fingers, 0.04 and 0.24 where the NIR images were of another.
Chosen on: simulated fingers (and path-traced ones). Range: 0 to 0.04."""


def findings_on_outline(observation: Observation, finger: Finger) -> list[Finding]:
    """A doubt where the finger of the near-infrared photographs has another outline than that of
    the white ones."""
    white, _, pixels = sampled_light(observation.white)
    nir, _, _ = sampled_light(observation.bands["nir"])
    inside = finger.mask[pixels]
    core = erode(inside, 1.5 * observation.rig.camera.px_per_mm / pixels[0].step)
    rim = inside & ~core
    if not core.any():
        return []
    means = (stack.mean(axis=0) for stack in (white, nir))
    dark_white, dark_nir = (
        float((mean[rim] < 0.15 * np.median(mean[core])).mean()) for mean in means
    )
    if dark_nir - dark_white <= _DARK_RIM:
        return []
    words = (
        f"{100 * dark_nir:.0f} % of the finger's rim (1.5 mm) is dark in it, and"
        f" {100 * dark_white:.0f} % in white: check that both bands are of one finger in one place."
    )
    # from this fraction of the rim on they spoil the shape
    severity = Severity.SPOILS if dark_nir - dark_white > 0.15 else Severity.DOUBT
    return [Finding("other-outline", words, severity).of_band("nir")]
