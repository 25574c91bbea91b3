"""Stereo of two to five cameras around the finger, and its visual hull from silhouettes.

Mirrors beside the finger give silhouettes, too: :mod:`splitknit.mirrors` fits a shape to those.

References
----------
H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information", IEEE TPAMI
30(2), 2008; A. Fusiello et al., "A compact algorithm for rectification of stereo pairs", Machine
Vision and Applications 12, 2000; B. Lucas and T. Kanade, "An iterative image registration
technique", 1981; A. Laurentini, "The visual hull concept for silhouette-based image understanding",
IEEE TPAMI 16(2), 1994.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from views import View, cloud_of

from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray

_ITERATIONS = 4
_MAX_STEP_PX = 0.5


def scan(
    pictures: Sequence[FloatArray], views: Sequence[View], middle_mm: Array, depth_mm: float
) -> FloatArray:
    """Match each camera with its neighbour and collect the points.

    `pictures`: two to five (H, W), 0 to 1, in the order of the cameras around the finger, 0 beside
    the finger; `views`: of the cameras; `middle_mm`: (3,) a point in the middle of the surface;
    `depth_mm`: how far the surface reaches before and behind it. Raises BadInput if there are other
    than two to five pictures, or nothing matches.
    """
    require(
        2 <= len(pictures) == len(views) <= 5,
        "stereo takes two to five pictures, each with its view.",
    )
    pairs = zip(pictures, pictures[1:], views, views[1:], strict=False)
    clouds = [
        _pair((image_a, image_b), (view_a, view_b), middle_mm, depth_mm)
        for image_a, image_b, view_a, view_b in pairs
    ]
    return cloud_of(np.concatenate(clouds))


def _pair(
    pictures: tuple[FloatArray, FloatArray],
    views: tuple[View, View],
    middle: Array,
    depth_mm: float,
) -> NDArray[np.floating]:
    """(N, 3) points that two neighbours see; both are turned so that the baseline runs along the
    rows."""
    base = views[1].centre_mm - views[0].centre_mm
    if (views[0].rotation @ base)[0] < 0:  # the left one first
        return _pair((pictures[1], pictures[0]), (views[1], views[0]), middle, depth_mm)
    length = float(np.linalg.norm(base))
    across = base / length
    axis = views[0].rotation[2] + views[1].rotation[2]
    down = np.cross(axis, across)
    down /= np.linalg.norm(down)
    turn = np.stack([across, down, np.cross(across, down)])
    shape, focal = pictures[0].shape, views[0].matrix[0, 0]
    turned, fields = [], []
    for picture, view in zip(pictures, views, strict=True):
        seen = turn @ (middle - view.centre_mm)
        centre = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2]) - focal * seen[:2] / seen[2]
        matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
        turned.append(View(matrix, turn, -turn @ view.centre_mm))
        warp = matrix @ turn @ view.rotation.T @ np.linalg.inv(view.matrix)
        field = cv2.warpPerspective(picture, warp, (shape[1], shape[0]), flags=cv2.INTER_CUBIC)
        fields.append(np.asarray(field, dtype=np.float32))
    far = float((turn @ (middle - views[0].centre_mm))[2])
    reach = focal * length * depth_mm / far**2
    lowest = -int(np.ceil(reach))
    count = 16 * int(np.ceil(2.2 * reach / 16))
    local = [_even(field) for field in fields]
    eight = [np.clip(128 + 40 * field, 0, 255).astype(np.uint8) for field in local]
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=7,
        P1=8 * 49,
        P2=32 * 49,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=400,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # the matrix's border would be lost to the search: it is widened
    wide = [cv2.copyMakeBorder(image, 0, 0, count, count, cv2.BORDER_REPLICATE) for image in eight]
    disparity = matcher.compute(*wide)[:, count:-count].astype(np.float32) / 16.0
    known = (disparity >= lowest) & (fields[0] > 0.02)
    disparity, good = _refined(local, np.where(known, disparity, 0.0).astype(np.float32))
    known &= good
    shift = turned[0].matrix[0, 2] - turned[1].matrix[0, 2]
    z = focal * length / (disparity.astype(np.float64) - shift)
    rays = turned[0].directions((shape[0], shape[1]))
    return np.asarray((turned[0].centre_mm + z[..., None] * rays)[known])


def _even(field: FloatArray) -> FloatArray:
    """Light over its local mean and spread."""
    sigma = 12.0
    mean = cv2.GaussianBlur(field, (0, 0), sigma)
    spread = np.sqrt(np.maximum(cv2.GaussianBlur((field - mean) ** 2, (0, 0), sigma), 1e-8))
    return np.asarray((field - mean) / np.maximum(spread, 2e-3), dtype=np.float32)


def _refined(fields: Sequence[FloatArray], disparity: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Disparities to a fraction of a pixel by Gauss-Newton on patches, and where the patches then
    agree."""
    rows, columns = (
        grid.astype(np.float32) for grid in np.mgrid[: disparity.shape[0], : disparity.shape[1]]
    )
    start, reference = disparity, fields[0]
    side = (9, 9)
    for _ in range(_ITERATIONS):
        warped = np.asarray(
            cv2.remap(fields[1], columns - disparity, rows, cv2.INTER_CUBIC), dtype=np.float32
        )
        slope = np.asarray(
            cv2.Sobel(warped, cv2.CV_32F, 1, 0, ksize=3), dtype=np.float32
        ) / np.float32(8.0)
        step = cv2.blur(slope * (warped - reference), side) / (cv2.blur(slope * slope, side) + 1e-3)
        disparity = disparity + np.clip(step, -_MAX_STEP_PX, _MAX_STEP_PX)
    warped = np.asarray(
        cv2.remap(fields[1], columns - disparity, rows, cv2.INTER_CUBIC), dtype=np.float32
    )
    a, b = (
        np.asarray(patch - cv2.blur(patch, side), dtype=np.float32) for patch in (reference, warped)
    )
    power = cv2.blur(a * a, side) * cv2.blur(b * b, side)
    alike = cv2.blur(a * b, side) / np.sqrt(np.maximum(power, 1e-8))
    return np.asarray(disparity, dtype=np.float32), np.asarray(
        (alike > 0.6) & (np.abs(disparity - start) < 2.0)
    )


def hull(
    masks: Sequence[BoolArray], views: Sequence[View], box_mm: Array, pitch_mm: float
) -> FloatArray:
    """Upper side of the visual hull: the highest points that lie within all silhouettes.

    `masks`: (H, W) silhouettes; what leaves a picture goes on beyond its border; `views`: of the
    cameras; `box_mm`: (2, 3) lowest and highest corner of what is searched; `pitch_mm`: of the
    grid, sideways; along z it is four times that, and interpolated. Raises BadInput if there are
    fewer than two silhouettes, or they have nothing in common.
    """
    require(
        2 <= len(masks) == len(views),
        "a visual hull needs two silhouettes at least, each with its view.",
    )
    steps = (pitch_mm, pitch_mm, 4.0 * pitch_mm)
    x, y, z = (
        np.arange(low, high, step)
        for (low, high), step in zip(np.asarray(box_mm).T, steps, strict=True)
    )
    require(
        x.size * y.size * z.size <= 100_000_000,
        "the grid is too fine for the box; give a larger `pitch_mm`.",
    )
    inside = []
    for mask in masks:  # distance to the outline, positive inside
        near = [
            cv2.distanceTransform(region.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            for region in (mask, ~mask)
        ]
        inside.append(np.asarray(near[0] - near[1], dtype=np.float32))
    grid_y, grid_x = np.meshgrid(y[::-1], x, indexing="ij")
    top = np.full(grid_x.shape, np.nan)
    above = np.full(grid_x.shape, -1.0, np.float32)
    for height in z[::-1]:
        points = np.stack([grid_x, grid_y, np.full_like(grid_x, height)], axis=-1)
        here = np.full(grid_x.shape, np.inf, np.float32)
        for distance, view in zip(inside, views, strict=True):
            column, row = (coordinate.astype(np.float32) for coordinate in view.pixels(points))
            here = np.minimum(
                here,
                cv2.remap(distance, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
            )
        entered = np.isnan(top) & (here > 0)
        top[entered] = height + (steps[2] * here / np.maximum(here - above, 1e-6))[entered]
        above = here
    return cloud_of(np.stack([grid_x, grid_y, top], axis=-1))
