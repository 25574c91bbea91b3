"""Where every pixel of a calibrated camera looks.

A camera stands at (0, 0, height) of the rig's frame and looks down. An orthographic camera's rays are parallel; a
perspective camera's pass through its centre, lens distortion taken off, and meet the finger plane (z = 0) where this
module says.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.types import Camera

Points = NDArray[np.float64]


def plane_points(camera: Camera, pixels: Any) -> Points:
    """Points of the finger plane that pixels look at.

    Parameters
    ----------
    camera : Camera
    pixels : (N, 2) columns and rows, fractions allowed; the centre of the first pixel is (0, 0)

    Returns
    -------
    (N, 2) x and y in mm on the plane z = 0

    Raises
    ------
    BadInput
        If `pixels` has another shape or is not finite.
    """
    places = _pairs(pixels, "pixels")
    rows, columns = camera.image_size
    if camera.model == "orthographic":
        x = (places[:, 0] - (columns - 1) / 2) / camera.px_per_mm
        y = ((rows - 1) / 2 - places[:, 1]) / camera.px_per_mm
        return np.stack([x, y], axis=1)
    assert camera.matrix is not None
    distortion = np.asarray(camera.distortion if camera.distortion else (0.0,) * 5, dtype=np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
    matrix = np.asarray(camera.matrix, dtype=np.float64)
    rays = cv2.undistortPointsIter(places[:, None], matrix, distortion, np.eye(3), matrix, criteria)[:, 0]
    rays = (rays - matrix[:2, 2]) / np.diag(matrix)[:2]
    rays[:, 0] -= matrix[0, 1] / matrix[0, 0] * rays[:, 1]
    return np.asarray(rays * (camera.height_mm, -camera.height_mm), dtype=np.float64)


def pixels_of(camera: Camera, points_mm: Any) -> Points:
    """Pixels (N, 2), column and row, at which the camera sees points (N, 3) in mm: the inverse of `plane_points`.

    Raises
    ------
    BadInput
        If `points_mm` has another shape, is not finite, or holds a point at or beyond a perspective camera's height.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    require(
        points.ndim == 2 and points.shape[1] == 3 and bool(np.isfinite(points).all()),
        f"points_mm must be finite and of the shape (N, 3), but it has the shape {points.shape}.",
    )
    rows, columns = camera.image_size
    if camera.model == "orthographic":
        column = points[:, 0] * camera.px_per_mm + (columns - 1) / 2
        return np.stack([column, (rows - 1) / 2 - points[:, 1] * camera.px_per_mm], axis=1)
    require(bool((points[:, 2] < camera.height_mm).all()), "points_mm must lie below the camera.")
    assert camera.matrix is not None
    seen = np.stack([points[:, 0], -points[:, 1], camera.height_mm - points[:, 2]], axis=1)
    distortion = np.asarray(camera.distortion if camera.distortion else (0.0,) * 5, dtype=np.float64)
    pixels, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), np.asarray(camera.matrix, np.float64), distortion)
    return np.asarray(pixels[:, 0], dtype=np.float64)


def _pairs(values: Any, name: str) -> Points:
    array = np.asarray(values, dtype=np.float64)
    require(
        array.ndim == 2 and array.shape[1] == 2 and bool(np.isfinite(array).all()),
        f"{name} must be finite and of the shape (N, 2), but it has the shape {array.shape}.",
    )
    return array
