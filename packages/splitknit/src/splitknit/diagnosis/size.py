"""Whether the surface of a finger is as deep, and its ridges as far apart, as a finger's are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit.finger.ridge_period import ridge_period
from splitknit.observation.observe import Observation
from splitknit.plausible import DEPTH, RIDGE_PERIOD, USUAL_RIDGE_PERIOD_MM
from splitknit.reconstruction import Reconstruction


def doubt_of_size(
    observation: Observation, result: Reconstruction, metric: bool
) -> tuple[Finding, ...]:
    """Doubts where the skin is oddly deep, or its ridges lie oddly far apart. Raises BadInput if no
    finger is so deep.

    `metric`: whether it is the method `metric`, whose normals show the ridges' distance also at a
    rig's scale.
    """
    if observation.material != "skin":
        return ()
    depth_mm = float(np.ptp(result.height_mm[result.mask]))
    deep = DEPTH.notes(
        depth_mm, "check the images, the order and directions of the lights, and the scale"
    )
    odd = (*deep, *_odd_ridge_period(observation, result, metric))
    return tuple(replace(finding, severity=Severity.DOUBT) for finding in odd)


def _odd_ridge_period(
    observation: Observation, result: Reconstruction, metric: bool
) -> tuple[Finding, ...]:
    camera = observation.rig.camera
    stated = all(led.position_mm is None for led in observation.rig.leds)
    if not camera.scale_known or "scale" in observation.rig.provenance or not (stated or metric):
        return ()
    # scale that is enough to measure the distance of the ridges
    every = max(1, int(camera.px_per_mm / 20.0))
    try:
        # a doubt needs few blocks
        ridges = ridge_period(
            result.normals[::every, ::every], result.mask[::every, ::every], step=32
        )
    except BadInput:  # too coarse to show any
        return ()
    # usual ridges nearer than 5 px may not be seen, and films' gloss or dry skin looks like wider
    # ones; then half of the places must show a wave, where fingers have one in 0.6 to 0.8
    if ridges.part < 0.5 and USUAL_RIDGE_PERIOD_MM * camera.px_per_mm < 5.0:
        return ()
    period_mm, (low, high) = ridges.period_px * every * result.pitch_mm, RIDGE_PERIOD.possible
    return RIDGE_PERIOD.notes(
        float(np.clip(period_mm, low, high)),
        f"check the scale of {camera.px_per_mm:g} px/mm (`px_per_mm`), as all lengths are"
        f" {period_mm / USUAL_RIDGE_PERIOD_MM:.2g} of the true ones if the ridges lie"
        f" {USUAL_RIDGE_PERIOD_MM:g} mm apart",
    )
