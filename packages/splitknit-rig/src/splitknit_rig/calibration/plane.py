"""The finger plane in the camera's frame: scale, height of the camera, and tilt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import Array


@dataclass(frozen=True, slots=True, eq=False)
class PlanePose:
    """Pose of a plane in front of a camera."""

    height_mm: float  # from the camera's centre to the plane, along the optical axis
    px_per_mm: float  # where the axis meets the plane: focal length over height
    # (3,) of the plane in the rig's frame (x right, y up, z to the camera), towards the camera
    normal: Array
    rms_px: float  # root of the mean squared distance between marks and their prediction
    # standard deviations of ``height_mm`` and ``tilt_deg`` that the marks' scatter causes, the
    # camera being exact
    deviations: dict[str, float]

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the plane's normal."""
        return float(
            np.degrees(np.arctan2(np.hypot(self.normal[0], self.normal[1]), self.normal[2]))
        )

    @property
    def tilt_xy_deg(self) -> tuple[float, float]:
        """Components of the tilt: turn about x, then y, right-handed."""
        x, y, z = (float(value) for value in self.normal)
        return float(np.degrees(np.arctan2(-y, z))), float(
            np.degrees(np.arctan2(x, np.hypot(y, z)))
        )

    @property
    def nearer_side(self) -> str:
        """Edge of the picture towards which the plane comes nearer to the camera."""
        rise_x, rise_y = -self.normal[0], -self.normal[1]
        sides = (
            "right",
            "upper right",
            "top",
            "upper left",
            "left",
            "lower left",
            "bottom",
            "lower right",
        )
        return sides[round(float(np.arctan2(rise_y, rise_x)) / (np.pi / 4)) % 8]


def plane_pose(marks_mm: Any, pixels: Any, matrix: Any, distortion: Any = None) -> PlanePose:
    """Pose of a plane with five known `marks_mm` (N, 2) or more that appear at `pixels` (N, 2;
    column, row), by T. Collins and A. Bartoli, IJCV 109, 2014 (``SOLVEPNP_IPPE``), then Levenberg
    and Marquardt's least squares on the reprojection. Raises BadInput if there are too few marks,
    they lie on one line, or no pose explains them.
    """
    marks, places = np.asarray(marks_mm, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    require(
        len(marks) >= 5, f"at least 5 marks of the plane are needed, but {len(marks)} are given."
    )
    spread = np.linalg.svd(marks - marks.mean(axis=0), compute_uv=False)
    require(
        spread[1] > 0.02 * spread[0],
        "the marks of the plane lie on one line; show more of them.",
    )
    camera = np.asarray(matrix, dtype=np.float64)
    lens = (
        np.zeros(5)
        if distortion is None or len(distortion) == 0
        else np.asarray(distortion, dtype=np.float64)
    )
    flat = np.column_stack([marks - marks.mean(axis=0), np.zeros(len(marks))])
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        flat, places, camera, lens, flags=cv2.SOLVEPNP_IPPE
    )
    require(count > 0, "no pose of the plane explains its marks; photograph it again.")
    poses: list[tuple[float, Array, Array]] = []
    for first_turn, first_shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(
            flat, places, camera, lens, np.array(first_turn), np.array(first_shift)
        )
        seen, _ = cv2.projectPoints(flat, turn, shift, camera, lens)
        error = float(((np.asarray(seen)[:, 0] - places) ** 2).sum())
        poses.append(
            (error, np.asarray(turn, dtype=np.float64), np.asarray(shift, dtype=np.float64).ravel())
        )
    error, turn, shift = min(poses, key=lambda pose: pose[0])
    height, normal = _height_and_normal(turn, shift)
    require(
        np.isfinite(height) and height > 0,
        "no pose of the plane explains its marks; photograph it again.",
    )
    _, jacobian = cv2.projectPoints(flat, turn, shift, camera, lens)
    by_pose = np.asarray(jacobian, dtype=np.float64)[:, :6]
    covariance = np.linalg.pinv(by_pose.T @ by_pose) * error / max(2 * len(flat) - 6, 1)
    deviations = _deviations(turn, shift, covariance)
    focal = float(np.sqrt(camera[0, 0] * camera[1, 1]))
    return PlanePose(height, focal / height, normal, float(np.sqrt(error / len(marks))), deviations)


def mean_pose(poses: Sequence[PlanePose], focal_px: float) -> PlanePose:
    """Mean of several photographs' poses of one plane, weighted by the inverse variances."""
    by_height, by_tilt = (
        np.array([1 / max(pose.deviations[name], 1e-9) ** 2 for pose in poses])
        for name in ("height_mm", "tilt_deg")
    )
    height = float(by_height @ [pose.height_mm for pose in poses] / by_height.sum())
    normal = by_tilt @ np.array([pose.normal for pose in poses])
    return PlanePose(
        height,
        focal_px / height,
        np.asarray(normal / np.linalg.norm(normal), dtype=np.float64),
        float(np.sqrt(np.mean([pose.rms_px**2 for pose in poses]))),
        {"height_mm": float(by_height.sum() ** -0.5), "tilt_deg": float(by_tilt.sum() ** -0.5)},
    )


def _height_and_normal(turn: Array, shift: Array) -> tuple[float, Array]:
    """Distance along the axis to the plane, and its normal in the rig's frame."""
    across = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)[:, 2]
    across = across if across[2] < 0 else -across  # towards the camera, which looks along its own z
    height = float(across @ shift / across[2])
    return height, np.array([across[0], -across[1], -across[2]])


def _deviations(turn: Array, shift: Array, covariance: Array) -> dict[str, float]:
    """Standard deviations of height and tilt from the covariance (6, 6) of the pose."""
    pose, slopes = np.concatenate([turn.ravel(), shift.ravel()]), np.zeros((3, 6))
    for k, step in enumerate(np.diag([1e-5] * 3 + [1e-3] * 3)):
        high, low = (_height_and_normal((pose + s)[:3], (pose + s)[3:]) for s in (step, -step))
        slopes[:, k] = np.array([high[0] - low[0], *(high[1] - low[1])[:2]]) / (2 * step[k])
    variances = np.diag(slopes @ covariance @ slopes.T)
    return {
        "height_mm": float(np.sqrt(variances[0])),
        "tilt_deg": float(np.degrees(np.sqrt(variances[1:].max()))),
    }
