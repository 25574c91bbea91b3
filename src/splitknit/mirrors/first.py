"""A first guess: how far mirrors are turned, by the tips of two views, and a plain body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.body import Body
from splitknit.mirrors.outline import Rows, rows_of
from splitknit.mirrors.planes import MirrorPlane
from splitknit.mirrors.settings import ROW_MM, MirrorShapeSettings
from splitknit.mirrors.state import Pose, SeenIn
from splitknit.model import BoolArray, Camera

_KNOTS = 11
"""Spans of the splines along the finger."""

Array = NDArray[np.float64]

MOST_TURN_RAD = 0.12
"""Mirrors are not turned by more."""


def cap(mask: BoolArray, camera: Camera, binning: int, axis: Array) -> Array:
    """(n, 2) points of the outline's tip, on the finger plane."""
    sideways = rows_of(mask, camera, binning, np.array([axis[1], -axis[0]]), ROW_MM, trust_ends=True)
    places, _, _ = sideways.places("left")
    return places


def turn_of_tips(camera: Camera, plane: MirrorPlane, front: Array, side: Array, axis: Array) -> float | None:
    """How far a mirror is turned about the camera's axis, from the tips of two views.

    The line that joins a point with its mirror image touches both views' outlines at the tip (a frontier point). None:
    no turn within reason makes it so.
    """
    about = np.array([0.0, 0.0, 0.0])

    def apart(turn: float) -> float:
        moved = plane.moved(turn, 0.0, 0.0, about)
        joint = moved.normal[:2] / np.hypot(*moved.normal[:2])
        upward = np.array([-joint[1], joint[0]])
        upward = upward if float(upward @ axis) > 0 else -upward
        epipole = moved.epipole(camera)
        if epipole is None:
            return float(np.max(side @ upward) - np.max(front @ upward))
        far = [_slopes_about(points - epipole, joint, upward) for points in (side, front)]
        return float(far[0] - far[1]) * float(np.hypot(*epipole))

    low, high = -MOST_TURN_RAD, MOST_TURN_RAD
    values = apart(low), apart(high)
    if values[0] * values[1] > 0:
        return None
    for _ in range(30):
        middle = 0.5 * (low + high)
        if (apart(middle) > 0) == (values[0] > 0):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _slopes_about(points: Array, joint: Array, upward: Array) -> float:
    return float(np.max((points @ upward) / np.abs(points @ joint)))


def first_body(
    front: Rows,
    lateral: Mapping[str, Rows],
    seen: Mapping[str, SeenIn],
    poses: Mapping[str, Pose],
    settings: MirrorShapeSettings,
) -> Body:
    """Ellipses from the front view's rows, and heights from the first mirror's."""
    known = np.isfinite(front.width_mm)
    along = front.along_mm[known]
    seen_mm = max(rows.tip_mm - float(rows.along_mm[np.isfinite(rows.width_mm)][0]) for rows in lateral.values())
    length = min(front.tip_mm - float(along[0]), seen_mm) + 0.3
    origin = float(np.mean(0.5 * (front.left_mm + front.right_mm)[known]))
    body = Body(origin * front.across, front.axis, front.tip_mm, length, np.zeros((4, _KNOTS + 3)))
    name = next(iter(lateral))
    rays = poses[name].of(seen[name]).reflect(seen[name].touching)
    point, direction = body.to_frame(rays.point, place=True), body.to_frame(rays.direction, place=False)
    far = -point[:, 0] / direction[:, 0]
    heights = point[:, 2] + far * direction[:, 2]  # where the rays cross the plane through the finger's axis
    low, high = (float(v) for v in np.quantile(heights, (0.15, 0.85)))
    z, rise = 0.5 * (low + high), 0.5 * (high - low)
    width = 0.5 * float(np.nanquantile(front.width_mm, 0.8))
    coefficients = np.zeros((4, _KNOTS + 3))
    coefficients[1], coefficients[2], coefficients[3] = z, width, rise
    squareness = 0.0 if settings.section == "ellipse" else settings.squareness
    return replace(body, coefficients=coefficients, squareness=squareness)
