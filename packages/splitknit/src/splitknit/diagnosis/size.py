"""Whether the surface of a finger is as deep, and its ridges as far apart, as a finger's are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.diagnosis.parameters import (
    COVERED,
    PERIOD_PX_PER_MM,
    SEEN_PX,
    USUAL_PERIOD_MM,
)
from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit.finger.ridge_period import ridge_period
from splitknit.model import Capture, Reconstruction
from splitknit.plausible import DEPTH, RIDGE_PERIOD


def doubt_of_size(capture: Capture, result: Reconstruction, metric: bool) -> tuple[Finding, ...]:
    """Doubts where the skin is oddly deep, or its ridges lie oddly far apart. Raises BadInput if no
    finger is so deep.

    `metric`: whether it is the method `metric`, whose normals show the ridges' distance also at a
    rig's scale.
    """
    if capture.material != "skin":
        return ()
    depth_mm = float(np.ptp(result.height_mm[result.mask]))
    deep = DEPTH.notes(
        depth_mm, "check the images, the order and directions of the lights, and the scale"
    )
    odd = (*deep, *_odd_ridge_period(capture, result, metric))
    return tuple(replace(finding, severity=Severity.DOUBT) for finding in odd)


def _odd_ridge_period(
    capture: Capture, result: Reconstruction, metric: bool
) -> tuple[Finding, ...]:
    camera = capture.rig.camera
    stated = all(led.position_mm is None for led in capture.rig.leds)
    if not camera.scale_known or "scale" in capture.rig.provenance or not (stated or metric):
        return ()
    every = max(1, int(camera.px_per_mm / PERIOD_PX_PER_MM))
    try:
        # a doubt needs few blocks
        ridges = ridge_period(
            result.normals[::every, ::every], result.mask[::every, ::every], step=32
        )
    except BadInput:  # too coarse to show any
        return ()
    if ridges.part < COVERED and USUAL_PERIOD_MM * camera.px_per_mm < SEEN_PX:
        return ()
    period_mm, (low, high) = ridges.period_px * every * result.pitch_mm, RIDGE_PERIOD.possible
    factor = (
        f"{period_mm / USUAL_PERIOD_MM:.2g} of the true ones if the ridges lie {USUAL_PERIOD_MM:g}"
        " mm apart"
    )
    remedy = (
        f"check the scale of {camera.px_per_mm:g} px/mm (`px_per_mm`), as all lengths are {factor}"
    )
    return RIDGE_PERIOD.notes(float(np.clip(period_mm, low, high)), remedy)
