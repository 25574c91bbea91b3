"""The scale of photographs for which nobody has measured it: assumed, stated later, or doubted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.findings import Finding, Severity
from splitknit.finger.ridge_period import ridge_period, scale_of_ridges
from splitknit.methods.photographs import FingerPhotographs, locate_finger, placed
from splitknit.methods.thesis import thesis_surface
from splitknit.model import BoolArray, Capture, FloatArray, Reconstruction
from splitknit.plausible import DEPTH, LED_DISTANCE, OBJECT_VIEW, RIDGE_PERIOD, VIEW
from splitknit.presets import PRESETS

USUAL_PERIOD_MM = 0.45
"""Distance of the ridges from which a scale is assumed."""
_PERIOD_PX_PER_MM = 20.0
"""Scale that is enough to measure it."""
_SEEN_PX, _COVERED = 5.0, 0.5
"""Where usual ridges are closer than this, they may not be seen, and films' gloss or dry skin looks like wider ones: a
doubt needs a wave in so many of the places, as fingers have in 0.6 to 0.8."""


def with_scale(
    capture: Capture, px_per_mm: float | None = None, ridge_period_mm: float | None = None
) -> tuple[Capture, str]:
    """Give a capture the scale that nobody has measured yet.

    `px_per_mm`: pixels a millimetre on the object; `ridge_period_mm`: instead, the distance of the finger's ridges on
    the skin; 0.45 is usual, people differ by 8 % (standard deviation), and heights with the scale. Raises BadInput if
    the capture has a scale, both ways are given, a number is no scale or ridge period, or no ridges are found.

    Returns the capture with the scale (the same one where neither is given), and how the scale was found in the ridges
    and how well it is known, else an empty text.
    """
    if px_per_mm is None and ridge_period_mm is None:
        return capture, ""
    camera, note = capture.rig.camera, ""
    require(not camera.scale_known, f"it has a scale already: {camera.px_per_mm:g} px/mm in its rig file.")
    if ridge_period_mm is not None:
        normals, mask = _plain_normals(capture)
        px_per_mm, note = scale_of_ridges(normals, mask, px_per_mm, ridge_period_mm)
    camera = replace(camera, px_per_mm=px_per_mm or camera.px_per_mm, scale_known=True)
    origin = {**capture.rig.provenance, **({"scale": note} if note else {})}
    return replace(capture, rig=replace(capture.rig, camera=camera, provenance=origin)), note


def doubt_of_size(capture: Capture, result: Reconstruction, metric: bool) -> tuple[Finding, ...]:
    """Notes where the skin is oddly deep, or its ridges lie oddly far apart. Raises BadInput if no finger is so deep.

    `metric`: whether it is the method `metric`, whose normals show the ridges' distance also at a rig's scale.
    """
    if capture.material != "skin":
        return ()
    depth_mm = float(np.ptp(result.height_mm[result.mask]))
    deep = DEPTH.notes(depth_mm, "check the images, the order and directions of the lights, and the scale")
    odd = deep + _doubt_of_scale(capture, result, metric)
    return tuple(replace(finding, severity=Severity.DOUBT) for finding in odd)


def _doubt_of_scale(capture: Capture, result: Reconstruction, metric: bool) -> tuple[Finding, ...]:
    camera = capture.rig.camera
    stated = all(led.position_mm is None for led in capture.rig.leds)
    if not camera.scale_known or "scale" in capture.rig.provenance or not (stated or metric):
        return ()
    every = max(1, int(camera.px_per_mm / _PERIOD_PX_PER_MM))
    try:
        found = ridge_period(
            result.normals[::every, ::every], result.mask[::every, ::every], step=32
        )  # a doubt needs few blocks
    except BadInput:  # too coarse to show any
        return ()
    if found.part < _COVERED and USUAL_PERIOD_MM * camera.px_per_mm < _SEEN_PX:
        return ()
    period_mm, (low, high) = found.period_px * every * result.pitch_mm, RIDGE_PERIOD.possible
    factor = f"{period_mm / USUAL_PERIOD_MM:.2g} of the true ones if the ridges lie {USUAL_PERIOD_MM:g} mm apart"
    remedy = f"check the scale of {camera.px_per_mm:g} px/mm (`px_per_mm`), as all lengths are {factor}"
    return RIDGE_PERIOD.notes(float(np.clip(period_mm, low, high)), remedy)


def _plain_normals(capture: Capture) -> tuple[FloatArray, BoolArray]:
    """Normals of the white band by plain photometric stereo, where nothing of a finger is looked for."""
    plain = PRESETS["ea"]
    capture, thing = locate_finger(replace(capture, material="opaque"), plain.finding())
    photographs = FingerPhotographs(capture, thing, (capture.bands["white"],))
    result = placed(photographs, thesis_surface(photographs, plain), plain.top_mm)
    return result.normals, result.mask


def with_working_scale(capture: Capture) -> tuple[Capture, tuple[Finding, ...]]:
    """Skin at a plausible scale, and a note where the scale is odd, also an object's: methods for skin work in mm.

    Where the scale of skin is unknown, that at which the ridges lie as usual; it is still marked as unknown.
    """
    camera = capture.rig.camera
    view_mm = max(capture.shape) / camera.px_per_mm
    check = f"check the scale of {camera.px_per_mm:g} px/mm (`px_per_mm`)"
    if capture.material != "skin":
        return capture, OBJECT_VIEW.notes(view_mm, f"{check}, as all lengths follow it") if camera.scale_known else ()
    away = [float(np.linalg.norm(led.position_mm)) for led in capture.rig.leds if led.position_mm is not None]
    remedy = "check the unit of position_mm, millimetres, in the rig file"
    far = [LED_DISTANCE.notes(one, remedy) for one in (min(away), max(away))] if away else []
    if camera.scale_known:
        return capture, (*VIEW.notes(view_mm, check), *sum(far, ()))
    found = ridge_period(*_plain_normals(capture))
    camera = replace(camera, px_per_mm=found.period_px / USUAL_PERIOD_MM)
    return replace(capture, rig=replace(capture.rig, camera=camera)), sum(far, ())
