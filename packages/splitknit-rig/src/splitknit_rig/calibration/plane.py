"""The finger plane as the camera sees it: scale, height of the camera, obliqueness, and the depth that is sharp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit import Array, require


@dataclass(frozen=True, slots=True, eq=False)
class PlanePose:
    """A plane before a camera."""

    height_mm: float  # from the camera's centre to the plane, along the optical axis
    px_per_mm: float  # where the axis meets the plane: focal length over height
    normal: Array  # (3,) of the plane in the rig's frame (x right, y up, z to the camera), towards the camera
    rms_px: float  # root of the mean squared distance between marks and their prediction
    # standard deviations of ``height_mm`` and ``tilt_deg`` that the marks' scatter causes, the camera being exact
    deviations: dict[str, float]

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the plane's normal."""
        return float(np.degrees(np.arctan2(np.hypot(self.normal[0], self.normal[1]), self.normal[2])))

    @property
    def tilt_xy_deg(self) -> tuple[float, float]:
        """Turn of the plane about x, then y, right-handed: its parts."""
        x, y, z = (float(value) for value in self.normal)
        return float(np.degrees(np.arctan2(-y, z))), float(np.degrees(np.arctan2(x, np.hypot(y, z))))

    @property
    def nearer_side(self) -> str:
        """Edge of the picture towards which the plane comes nearer to the camera."""
        rise_x, rise_y = -self.normal[0], -self.normal[1]
        sides = ("right", "upper right", "top", "upper left", "left", "lower left", "bottom", "lower right")
        return sides[round(float(np.arctan2(rise_y, rise_x)) / (np.pi / 4)) % 8]


@dataclass(frozen=True, slots=True)
class PlaneScale:
    """A plane seen by an orthographic camera."""

    px_per_mm: float
    rms_px: float
    deviation: float  # standard deviation of `px_per_mm` that the marks' scatter causes
    # longest over shortest scale in the plane, less one: what a tilt, or a lens's perspective, would leave
    anisotropy: float


def plane_pose(marks_mm: Any, pixels: Any, matrix: Any, distortion: Any = None) -> PlanePose:
    """Pose of a plane with five known `marks_mm` (N, 2) or more that appear at `pixels` (N, 2; column, row), by T.
    Collins and A. Bartoli, IJCV 109, 2014 (``SOLVEPNP_IPPE``), then Levenberg and Marquardt's least squares on the
    reprojection. Raises BadInput if there are too few marks, they lie on one line, or no pose explains them.
    """
    marks, places = _marks(marks_mm, pixels, least=5)
    camera = np.asarray(matrix, dtype=np.float64)
    lens = np.zeros(5) if distortion is None or len(distortion) == 0 else np.asarray(distortion, dtype=np.float64)
    flat = np.column_stack([marks - marks.mean(axis=0), np.zeros(len(marks))])
    count, turns, shifts, _ = cv2.solvePnPGeneric(flat, places, camera, lens, flags=cv2.SOLVEPNP_IPPE)
    require(count > 0, "no pose of the plane explains its marks; photograph it again.")
    poses: list[tuple[float, Array, Array]] = []
    for first_turn, first_shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(flat, places, camera, lens, np.array(first_turn), np.array(first_shift))
        seen, _ = cv2.projectPoints(flat, turn, shift, camera, lens)
        error = float(((np.asarray(seen)[:, 0] - places) ** 2).sum())
        poses.append((error, np.asarray(turn, dtype=np.float64), np.asarray(shift, dtype=np.float64).ravel()))
    error, turn, shift = min(poses, key=lambda pose: pose[0])
    height, normal = _height_and_normal(turn, shift)
    require(np.isfinite(height) and height > 0, "no pose of the plane explains its marks; photograph it again.")
    _, jacobian = cv2.projectPoints(flat, turn, shift, camera, lens)
    by_pose = np.asarray(jacobian, dtype=np.float64)[:, :6]
    covariance = np.linalg.pinv(by_pose.T @ by_pose) * error / max(2 * len(flat) - 6, 1)
    deviations = _deviations(turn, shift, covariance)
    focal = float(np.sqrt(camera[0, 0] * camera[1, 1]))
    return PlanePose(height, focal / height, normal, float(np.sqrt(error / len(marks))), deviations)


def mean_pose(poses: Sequence[PlanePose], focal_px: float) -> PlanePose:
    """Mean of several photographs' poses of one plane, each by the inverse of its variance."""
    by_height, by_tilt = (
        np.array([1 / max(pose.deviations[name], 1e-9) ** 2 for pose in poses]) for name in ("height_mm", "tilt_deg")
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


def plane_scale(marks_mm: Any, pixels: Any) -> PlaneScale:
    """Scale of a plane with four known `marks_mm` (N, 2) or more at `pixels` (N, 2) under an orthographic camera: the
    best similarity. Raises BadInput if marks are too few, or lie on one line.
    """
    marks, places = _marks(marks_mm, pixels, least=4)
    a, b = marks - marks.mean(axis=0), places - places.mean(axis=0)
    # the picture's rows run down and the marks' order is free: a turn, or a turn with a reflection, whichever fits
    left, sizes, right = np.linalg.svd(b.T @ a)
    scale = float(sizes.sum() / (a**2).sum())
    residual = b - scale * (a @ (left @ right).T)
    sigma2 = float((residual**2).sum()) / (2 * len(marks) - 4)
    stretch = np.linalg.svd(np.linalg.lstsq(a, b, rcond=None)[0], compute_uv=False)
    return PlaneScale(
        scale,
        float(np.sqrt((residual**2).sum() / len(marks))),
        float(np.sqrt(sigma2 / (a**2).sum())),
        float(stretch[0] / stretch[1] - 1),
    )


def _marks(marks_mm: Any, pixels: Any, least: int) -> tuple[Array, Array]:
    marks, places = np.asarray(marks_mm, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    require(len(marks) >= least, f"at least {least} marks of the plane are needed, but {len(marks)} are given.")
    spread = np.linalg.svd(marks - marks.mean(axis=0), compute_uv=False)
    require(bool(spread[1] > 0.02 * spread[0]), "the marks of the plane lie on one line; show more of them.")
    return marks, places


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
    return {"height_mm": float(np.sqrt(variances[0])), "tilt_deg": float(np.degrees(np.sqrt(variances[1:].max())))}


@dataclass(frozen=True, slots=True)
class DepthOfField:
    """Sharpness against depth of a camera that is focused on the finger plane."""

    focal_length_mm: float
    f_number: float
    focus_mm: float  # distance of the plane in focus
    confusion_um: float  # diameter, on the sensor, of the disc that still counts as a point
    near_mm: float  # nearest distance at which a point is no larger than that
    far_mm: float  # farthest; infinite beyond the hyperfocal distance
    finger_depth_mm: float  # depth of the finger that the camera sees
    # diameter, in pixels of the image, of a point's disc at half the finger's depth from the plane in focus
    blur_px: float
    needed_f_number: float  # at which the finger's depth would just be sharp, focused in its middle
    diffraction_px: float  # diameter of the Airy disc at that f-number, in pixels of the image, for light of 550 nm
    depth_mm: float  # from the near to the far limit
    fits: bool  # whether the finger is sharp throughout
    # at which defocus at the finger's ends and diffraction blur equally: stopping down further gains nothing
    best_f_number: float


def depth_of_field(
    focal_px: float, pixel_um: float, f_number: float, focus_mm: float, *, finger_depth_mm: float = 8.0
) -> DepthOfField:
    """Limits of sharpness of a thin lens.

    A camera matrix holds the distance v from lens to sensor. With the distance u of the plane in focus the focal length
    is F = u v / (u + v), and the lens's opening A = F / N. A point at the distance s becomes a disc of the diameter b =
    A v |1/u - 1/s|. With b = c, one pixel of the image, 1/near = 1/u + c / (A v) and 1/far = 1/u - c / (A v).
    `pixel_um`: c on the sensor (the sensor's pixel times the binning); `focus_mm`: u, height of the camera's centre
    over the finger plane; `finger_depth_mm`: depth of the finger that it sees.
    Source: S. F. Ray, "Applied Photographic Optics", 3rd edition, 2002, chapter 22 (depth of field); M. Born and E.
    Wolf, "Principles of Optics", 7th edition, 8.5.2 (Airy's disc, 2.44 times wavelength times working f-number).

    >>> field = depth_of_field(10598.0, 1.12, 2.0, 140.0)
    >>> round(field.focal_length_mm, 2), round(field.depth_mm, 2), field.fits
    (10.94, 0.68, False)
    """
    pixel_mm = pixel_um / 1000
    behind = focal_px * pixel_mm
    focal = focus_mm * behind / (focus_mm + behind)
    reach = pixel_mm * f_number / (focal * behind)  # c / (A v)
    near, beyond = 1 / (1 / focus_mm + reach), 1 / focus_mm - reach
    side = finger_depth_mm / 2
    side_reach = side / (focus_mm * max(focus_mm - side, 1e-9))
    # near to far of the finger about its middle: reach that its two ends need, the nearer one more
    needed = side_reach * focal * behind / pixel_mm
    airy_px = 2.44 * 550e-6 * needed * (1 + behind / focus_mm) / pixel_mm
    far = 1 / beyond if beyond > 0 else float("inf")
    return DepthOfField(
        focal_length_mm=focal,
        f_number=f_number,
        focus_mm=focus_mm,
        confusion_um=1000 * pixel_mm,
        near_mm=near,
        far_mm=far,
        finger_depth_mm=finger_depth_mm,
        blur_px=focal / f_number * behind * side_reach / pixel_mm,
        needed_f_number=needed,
        diffraction_px=airy_px,
        depth_mm=far - near,
        fits=far - near >= finger_depth_mm,
        best_f_number=needed / float(np.sqrt(airy_px)),
    )
