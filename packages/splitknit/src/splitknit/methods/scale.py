"""The scale of photographs that came without one: assumed, set later, or checked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.capture import Capture
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.finger.ridge_period import ridge_period, scale_of_ridges
from splitknit.methods.photographs import photographs_of, placed
from splitknit.methods.thesis import thesis_surface
from splitknit.model import BoolArray, FloatArray
from splitknit.plausible import LED_DISTANCE, OBJECT_VIEW, USUAL_RIDGE_PERIOD_MM, VIEW
from splitknit.presets import PRESETS


def with_scale(
    capture: Capture, px_per_mm: float | None = None, ridge_period_mm: float | None = None
) -> tuple[Capture, str]:
    """Give a capture the scale that nobody has measured yet.

    `px_per_mm`: pixels a millimetre on the object; `ridge_period_mm`: instead, the distance of the
    finger's ridges on the skin; 0.45 is usual, people differ by 8 % (standard deviation), and
    heights with the scale. Raises BadInput if the capture has a scale, both ways are given, a
    number is no scale or ridge period, or no ridges are found.

    Returns the capture with the scale (the same one where neither is given), and how the scale was
    found in the ridges and how well it is known, else an empty text.
    """
    if px_per_mm is None and ridge_period_mm is None:
        return capture, ""
    camera, note = capture.rig.camera, ""
    require(
        not camera.scale_known,
        f"it has a scale already: {camera.px_per_mm:g} px/mm in its rig file.",
    )
    if ridge_period_mm is not None:
        normals, mask = _plain_normals(capture)
        px_per_mm, note = scale_of_ridges(normals, mask, px_per_mm, ridge_period_mm)
    camera = replace(camera, px_per_mm=px_per_mm or camera.px_per_mm, scale_known=True)
    origin = {**capture.rig.provenance, **({"scale": note} if note else {})}
    return replace(capture, rig=replace(capture.rig, camera=camera, provenance=origin)), note


def _plain_normals(capture: Capture) -> tuple[FloatArray, BoolArray]:
    """Normals of the white band by plain photometric stereo, where nothing of a finger is looked
    for."""
    plain = PRESETS["ea"]
    photographs = photographs_of(replace(capture, material="opaque"), plain.finding())
    result = placed(photographs, thesis_surface(photographs, plain), plain.top_mm)
    return result.normals, result.mask


def with_working_scale(capture: Capture) -> tuple[Capture, tuple[Finding, ...]]:
    """The capture at a scale to work with, and notes on implausible scales. Methods for skin work
    in mm: skin of unknown scale gets the one at which its ridge period is usual, and stays marked
    as unknown.
    """
    camera = capture.rig.camera
    view_mm = max(capture.shape) / camera.px_per_mm
    check = f"check the scale of {camera.px_per_mm:g} px/mm (`px_per_mm`)"
    if capture.material != "skin":
        return capture, OBJECT_VIEW.notes(
            view_mm, f"{check}, as all lengths follow it"
        ) if camera.scale_known else ()
    away = [
        float(np.linalg.norm(led.position_mm))
        for led in capture.rig.leds
        if led.position_mm is not None
    ]
    remedy = "check the unit of position_mm, millimetres, in the rig file"
    notes: tuple[Finding, ...] = ()
    if away:
        notes = LED_DISTANCE.notes(min(away), remedy) + LED_DISTANCE.notes(max(away), remedy)
    if camera.scale_known:
        return capture, VIEW.notes(view_mm, check) + notes
    period_px = ridge_period(*_plain_normals(capture)).period_px
    camera = replace(camera, px_per_mm=period_px / USUAL_RIDGE_PERIOD_MM)
    return replace(capture, rig=replace(capture.rig, camera=camera)), notes
