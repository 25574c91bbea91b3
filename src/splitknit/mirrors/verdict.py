"""Whether views are of one finger, and what was found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.state import Fit, SeenIn, Slopes

_MISFIT_MM = 0.6
"""Views that agree no better than this (rms) are not of one finger."""

THICKNESS = (0.4, 1.4)
"""Of fingers, over their breadth."""
MOST_DEG = 7.0
"""A mirror that would be further off than this is not believed."""


def refuse_misfit(fit: Fit, seen: Mapping[str, SeenIn]) -> None:
    """Refuse views that no finger explains."""
    for name, misfit in fit.misfit_mm.items():
        if name in seen and seen[name].from_tip:
            continue
        size = float(np.median(np.abs(misfit)))
        require(
            size < _MISFIT_MM,
            f"the views do not fit one finger: the {name} view's outline lies {size:.1f} mm beside the others'; check "
            "that the rig file's mirrors are the ones in the picture and that one finger alone is in view.",
        )
    thickness = float(np.median(fit.body.coefficients[3] / fit.body.coefficients[2]))
    require(
        THICKNESS[0] < thickness < THICKNESS[1],
        f"the views do not fit one finger: in the mirrors it would be {thickness:.2f} times as thick as it is broad in "
        "front; check that one finger alone is in view.",
    )
    for name, pose in fit.poses.items():
        worst = max(abs(float(np.rad2deg(angle))) for angle in (pose.turn_rad, pose.lean_rad))
        require(
            worst < MOST_DEG,
            f"the views do not fit one finger: the {name} mirror would be {worst:.0f} deg off its place in the rig "
            "file; check that one finger alone is in view, or correct the rig file.",
        )


def facts_of(fit: Fit, settings: MirrorShapeSettings, slopes: Slopes | None) -> dict[str, Any]:
    """For the report: poses, misfits, the sections' form."""
    rms = {}
    for name, misfit in fit.misfit_mm.items():
        weight = fit.weights[name]
        rms[name] = float(np.sqrt(np.sum(weight * misfit**2) / max(float(weight.sum()), 1e-9)))
    body = fit.body
    return {
        "method": "outlines",
        "mirrors": sorted(fit.poses),
        "section": settings.section,
        "section_seen_by": "slopes" if slopes is not None else "expectation",
        "squareness": body.squareness,
        "shear": body.shear,
        "poses": {
            name: {
                "turn_deg": float(np.rad2deg(pose.turn_rad)),
                "lean_deg": float(np.rad2deg(pose.lean_rad)),
                "shift_mm": pose.shift_mm,
            }
            for name, pose in fit.poses.items()
        },
        "outline_rms_mm": rms,
        "outline_used": {name: float(np.mean(weight > 0)) for name, weight in fit.weights.items()},
    }
