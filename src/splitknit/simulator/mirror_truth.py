"""What the twin knows of a finger between mirrors: the views, the true mirrors, the skin all around."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray
from splitknit.simulator.finger_shape import FingerBody
from splitknit.simulator.mirror_view import View
from splitknit.simulator.raycast import Placement
from splitknit.simulator.skin_map import SkinMap

Array = NDArray[np.float64]
_PROXIMAL_MM = 6.0


def view_truth(views: Sequence[View], masks: Sequence[BoolArray]) -> dict[str, NDArray[Any]]:
    """What each view shows, as it lies behind its mirror in the rig's frame, and the true mirrors.

    `masks` (H, W) tell what of each is visible.
    """
    truth: dict[str, NDArray[Any]] = {"mirror_names": np.array([view.mirror.name for view in views])}
    for view, mask in zip(views, masks, strict=True):
        name, surface = view.mirror.name, view.surface
        prefix = f"view_{name}"
        truth[f"{prefix}_mask"] = mask
        truth[f"{prefix}_height_mm"] = _within(surface.height_mm, mask, np.nan)
        truth[f"{prefix}_shape_mm"] = _within(surface.shape_mm, mask, np.nan)
        truth[f"{prefix}_normals"] = _within(surface.normals, mask, 0.0)
        truth[f"{prefix}_relief_um"] = _within(surface.relief_um, mask, 0.0)
        if surface.chart is not None:
            truth[f"{prefix}_chart_mm"] = _within(surface.chart, mask, np.nan)
        if surface.x_mm is not None and surface.y_mm is not None:
            truth[f"{prefix}_x_mm"] = _within(surface.x_mm, mask, np.nan)
            truth[f"{prefix}_y_mm"] = _within(surface.y_mm, mask, np.nan)
        truth[f"mirror_{name}_corners_mm"] = np.asarray(view.mirror.corners_mm)
        truth[f"mirror_{name}_normal"] = view.mirror.normal
        truth[f"mirror_{name}_point_mm"] = view.mirror.point_mm
        truth[f"mirror_{name}_reflectance"] = np.array(view.mirror.reflectance)
    return truth


def _within(array: NDArray[Any], mask: NDArray[np.bool_], empty: float) -> NDArray[Any]:
    inside = mask if array.ndim == mask.ndim else mask[..., None]
    return np.where(inside, array, np.float32(empty))


def body_truth(body: FingerBody, skin: SkinMap, placement: Placement, pitch_mm: float) -> dict[str, NDArray[Any]]:
    """The whole finger on a grid of places along it and angles around it, in the rig's frame.

    Rows are evenly spaced along the finger's axis, from behind the first crease to the tip; columns are evenly spaced
    angles about the axis of the section, 0 at the pad's top, positive towards the finger's +x.
    """
    shape = body.shape
    along = np.arange(-_PROXIMAL_MM, shape.length_mm, pitch_mm)
    around = 2 * max(8, round(0.5 * 2.0 * np.pi * 0.5 * shape.width_mm / pitch_mm))
    angle = (np.arange(around) + 0.5) / around * 2.0 * np.pi - np.pi
    y, theta = (grid.ravel() for grid in np.meshgrid(along, angle, indexing="ij"))
    points = section_points(body, y, theta)
    _, gx, gy, gz = body.value_and_gradient(*points)
    normals = placement.normal_to_camera(gx, gy, gz)
    _, u, v = body.distance_and_chart(*points)
    relief = skin.displacement(u, v)
    smooth = np.stack(points, axis=-1) @ placement.rotation.T + placement.shift
    skinned = smooth + relief[:, None] * normals
    size = along.size, angle.size
    return {
        "body_y_mm": along,
        "body_theta_rad": angle,
        "body_shape_mm": smooth.reshape(*size, 3).astype(np.float32),
        "body_points_mm": skinned.reshape(*size, 3).astype(np.float32),
        "body_normals": normals.reshape(*size, 3).astype(np.float32),
        "body_chart_mm": np.stack([u, v], axis=-1).reshape(*size, 2).astype(np.float32),
        "body_relief_um": (1e3 * relief).reshape(size).astype(np.float32),
        "body_rotation": placement.rotation,
        "body_shift_mm": placement.shift,
    }


def section_points(body: FingerBody, y: Array, theta: Array) -> tuple[Array, Array, Array]:
    """x, y, z (N,) in the finger's frame of the smooth skin at places `y` and angles `theta` about the axis."""
    axis, drop = body.axis_line(y)
    sine, cosine = np.sin(theta), np.cos(theta)

    def value_and_rise(radius: Array) -> tuple[Array, Array]:
        value, gx, _, gz = body.value_and_gradient(axis + radius * sine, y, drop + radius * cosine)
        return value, gx * sine + gz * cosine

    low, high = np.zeros_like(y), np.full_like(y, 1.5 * max(body.shape.width_mm, body.shape.thickness_mm))
    for _ in range(8):  # bisection: the sections are star-shaped about the axis
        middle = 0.5 * (low + high)
        inside = value_and_rise(middle)[0] < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    radius = high
    for _ in range(5):  # Newton from outside, where the function rises more steeply than it needs to
        value, rise = value_and_rise(radius)
        radius = np.clip(radius - value / np.maximum(rise, 1e-9), low, high)
    return axis + radius * sine, y, drop + radius * cosine
