"""What a camera's calibration found: as facts for programs and as provenance for the rig file, with its warnings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from splitknit.calibration.plane import PlanePose
from splitknit.io import provenance

if TYPE_CHECKING:
    from splitknit.apps.calibration.calibrated_camera import CameraJob, FoundCamera

_TILT_LIMIT_DEG = 1.0
_POSES_HEIGHT, _POSES_TILT_DEG = 0.003, 0.3
"""Photographs of one plane that differ by more are warned about."""


def facts_of(job: CameraJob, found: FoundCamera, nominal_leds: bool) -> dict[str, Any]:
    """Return everything that was found, plain."""
    camera = found.camera
    measured, nominal = _origins(found, nominal_leds)
    warnings = [*found.warnings, *_warnings(found)]
    return {
        "out": str(job.out),
        "calibrated_at": job.calibrated_at,
        "model": camera.model,
        "image_size": list(camera.image_size),
        "matrix": None if camera.matrix is None else np.asarray(camera.matrix).tolist(),
        "distortion": None if camera.distortion is None else list(camera.distortion),
        "height_mm": camera.height_mm,
        "px_per_mm": camera.px_per_mm,
        "board": {"inner_corners": job.board, "square_mm": job.square_mm},
        "fit": _fit(found),
        "plane": _plane(found),
        "depth_of_field": _sharpness(found),
        "measured": measured,
        "nominal": nominal,
        "warnings": warnings,
    }


def rig_provenance(facts: Mapping[str, Any], hashes: Mapping[str, str]) -> dict[str, Any]:
    """Return what the rig file says about its camera's origin."""
    kept = ("calibrated_at", "measured", "nominal", "warnings")
    residuals = {"fit": facts["fit"], "plane": facts["plane"]}
    origin = provenance({"board": facts["board"]}, hashes)
    return {**{name: facts[name] for name in kept}, "residuals": residuals, **origin}


def _fit(found: FoundCamera) -> dict[str, Any] | None:
    if found.fit is None:
        return None
    fit, lens = found.fit, found.fit.lens
    return {
        "rms_px": lens.rms_px,
        "images": len(fit.used),
        "per_image_px": dict(zip(fit.used, lens.view_rms_px.tolist(), strict=True)),
        "rejected_px": fit.rejected,
        "repeated": fit.repeated,
        "without_board": list(found.boardless),
        "focal_length_px": [float(lens.matrix[0, 0]), float(lens.matrix[1, 1])],
        "principal_point_px": lens.matrix[:2, 2].tolist(),
        "deviations": dict(lens.deviations),
        "fitted": list(lens.fitted),
        "held": dict(lens.fixed),
        "tilts_deg": [round(float(tilt), 2) for tilt in fit.tilts_deg],
        "variety_deg": fit.variety_deg,
        "coverage": fit.coverage,
    }


def _plane(found: FoundCamera) -> dict[str, Any] | None:
    if found.scale is not None:
        scale = found.scale
        return {
            "px_per_mm": scale.px_per_mm,
            "px_per_mm_deviation": scale.deviation,
            "rms_px": scale.rms_px,
            "anisotropy": scale.anisotropy,
        }
    if found.pose is None:
        return None
    pose = found.pose
    return {
        "height_mm": pose.height_mm,
        "height_mm_deviation": pose.deviations["height_mm"],
        "px_per_mm": pose.px_per_mm,
        "tilt_deg": pose.tilt_deg,
        "tilt_deg_deviation": _tilt_deviation(found, pose),
        "tilt_xy_deg": list(pose.tilt_xy_deg),
        "nearer_at": pose.nearer_side,
        "normal": pose.normal.tolist(),
        "rms_px": pose.rms_px,
        "per_image": {
            name: {"height_mm": one.height_mm, "tilt_deg": one.tilt_deg, "rms_px": one.rms_px}
            for name, one in found.poses.items()
        },
    }


def _sharpness(found: FoundCamera) -> dict[str, Any] | None:
    field = found.sharpness
    if field is None:
        return None
    far = field.far_mm if math.isfinite(field.far_mm) else None
    return {
        "focal_length_mm": field.focal_length_mm,
        "f_number": field.f_number,
        "focus_mm": field.focus_mm,
        "confusion_um": field.confusion_um,
        "binning": found.binning,
        "near_mm": field.near_mm,
        "far_mm": far,
        "depth_mm": None if far is None else field.depth_mm,
        "finger_depth_mm": field.finger_depth_mm,
        "fits": field.fits,
        "blur_px": field.blur_px,
        "needed_f_number": field.needed_f_number,
        "diffraction_px": field.diffraction_px,
        "best_f_number": field.best_f_number,
    }


def _tilt_deviation(found: FoundCamera, pose: PlanePose) -> float:
    """With what the principal point's uncertainty adds: an axis that is off by one pixel is off by 1 / f."""
    lens = found.fit.lens if found.fit is not None else None
    if lens is None:
        return pose.deviations["tilt_deg"]
    axis = max(lens.deviations.get("cx", 0.0), lens.deviations.get("cy", 0.0)) / float(lens.matrix[0, 0])
    return float(np.hypot(pose.deviations["tilt_deg"], np.degrees(axis)))


def _origins(found: FoundCamera, nominal_leds: bool) -> tuple[list[str], list[str]]:
    """What is measured, and what is taken over."""
    measured: list[str] = []
    nominal: list[str] = []
    if found.fit is not None:
        measured += ["camera.matrix", "camera.distortion", "camera.image_size"]
    (measured if found.pose is not None or found.scale is not None else nominal).append("camera.px_per_mm")
    (measured if found.pose is not None else nominal).append("camera.height_mm")
    if nominal_leds:
        nominal += ["leds"]
    return measured, nominal


def _warnings(found: FoundCamera) -> list[str]:
    words = []
    fit, camera = found.fit, found.camera
    if fit is not None and found.pose is None:
        words.append(
            f"px_per_mm rests on a height of {camera.height_mm:g} mm that was not measured; photograph the board flat "
            "on the finger plane (--plane) or the calibration disc (--disc)."
        )
    if found.pose is not None:
        words += _plane_warnings(found, found.pose)
    if found.scale is not None and found.scale.anisotropy > 0.01:
        words.append(
            f"the scale differs by {100 * found.scale.anisotropy:.1f} % between two directions, so the camera looks on "
            "obliquely; calibrate its matrix from a FOLDER of photographs of a checkerboard."
        )
    return words


def _plane_warnings(found: FoundCamera, pose: PlanePose) -> list[str]:
    words = []
    camera = found.camera
    if pose.tilt_deg > _TILT_LIMIT_DEG:
        slope = math.tan(math.radians(pose.tilt_deg))
        reach = math.hypot(*camera.image_size) / 2 / camera.px_per_mm
        depth = found.sharpness.finger_depth_mm if found.sharpness is not None else 8.0
        words.append(
            f"the camera looks on the base obliquely by {pose.tilt_deg:.2f} deg: the picture's corners lie up to "
            f"{reach * slope:.2f} mm nearer or farther than its middle, which displaces them by "
            f"{reach**2 * slope / pose.height_mm:.2f} mm, and what stands {depth:g} mm high leans by "
            f"{depth * slope:.2f} mm; straighten the camera, or put something thin under the base."
        )
    heights = [one.height_mm for one in found.poses.values()]
    apart = max(
        (float(np.degrees(np.arccos(min(1.0, float(one.normal @ pose.normal))))) for one in found.poses.values()),
        default=0.0,
    )
    if max(heights) - min(heights) > _POSES_HEIGHT * pose.height_mm or apart > _POSES_TILT_DEG:
        each = ", ".join(f"{name} {one.height_mm:.2f} mm, {one.tilt_deg:.2f} deg" for name, one in found.poses.items())
        words.append(
            f"the photographs of the finger plane disagree ({each}); the print lay uneven, or its scale is off."
        )
    if pose.rms_px > max(1.0, 0.01 * camera.px_per_mm):
        words.append(
            f"the marks on the finger plane miss their places by {pose.rms_px:.2f} px: the print is not flat, or its "
            "marks are not where they should be."
        )
    return words
