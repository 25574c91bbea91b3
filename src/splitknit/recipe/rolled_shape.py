"""The finger between its mirrors as a smooth body: where it lies, and its chart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.fuse import Body, Chart, Sight, body_from_outlines, chart_over, outline
from splitknit.fuse.body import STEP_MM
from splitknit.preprocess import find_upright
from splitknit.types import BoolArray

Array = NDArray[np.float64]

SHAPE_PITCH_MM = 0.25
"""Of the chart on which the smooth finger is kept."""
FAN_DEG = 75.0
"""How far the chart bends over the tip."""
REACH_MM = 24.0
BELOW_MM = 4.0
"""The chart goes on below what the mirrors show: light from there matters."""
AROUND_DEG = 172.0
EDGE_MM, CUT_MM = 0.4, 0.05
"""An outline that lies this near to a mirror's edge, and so moves by more than this with it, is the mirror's."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A smooth finger on a chart all around it."""

    chart: Chart
    radius_mm: Array
    """(n, m)."""
    body: Body


def first_shape(
    views: Mapping[str, tuple[Sight, BoolArray]],
    corners_mm: Mapping[str, Array],
    tip_direction_deg: float | None,
    exponent: float,
) -> Shape:
    """Smooth finger from the outlines of the front and of the mirrors beside it.

    Parameters
    ----------
    views : sight and mask (H, W) of ``front``, and of ``left`` or ``right`` or both
    corners_mm : outlines (K, 3) of the mirrors: rows that they cut are not the finger's own
    tip_direction_deg : of the capture
    exponent : of the sections

    Raises
    ------
    BadInput
        If the front, or a mirror beside the finger, shows too little.
    """
    front, mask = views["front"]
    upright = find_upright(mask, tip_direction_deg)
    step = upright.input_from_upright[:2, :2] @ np.array([0.0, -1.0])
    along = np.array([step[0], -step[1], 0.0]) / np.linalg.norm(step)
    axes = np.stack([np.cross(along, [0.0, 0.0, 1.0]), along, [0.0, 0.0, 1.0]])
    rows, columns = np.nonzero(mask[::4, ::4])
    camera = front.camera
    middle = np.array(
        [
            (4 * columns.mean() - (camera.image_size[1] - 1) / 2) / camera.px_per_mm,
            ((camera.image_size[0] - 1) / 2 - 4 * rows.mean()) / camera.px_per_mm,
            0.0,
        ]
    )
    places = np.arange(-REACH_MM, REACH_MM, STEP_MM)
    sides = outline(mask, front.pixel_of(middle, axes[0], axes[1]), (-REACH_MM, REACH_MM), places)
    centre = 0.5 * (sides[0] + sides[1])
    require(bool(np.isfinite(centre).any()), "the front view shows nothing of the finger.")
    off = float(np.nanmedian(centre))
    middle = middle + off * axes[0]
    sides = sides[0] - off, sides[1] - off
    heights = []
    for name in ("left", "right"):
        if name in views:
            sight, seen = views[name]
            pixel = sight.pixel_of(middle, axes[2], axes[1])
            if abs(float(np.linalg.det(pixel[:, :2]))) < 1e-3:
                raise BadInput(f"the {name} mirror does not show the finger from beside; check its pose in the rig.")
            span = (-REACH_MM - 8.0, REACH_MM - 8.0)
            low, high = outline(seen, pixel, span, places)
            within = outline(seen & _within(front, corners_mm[name], seen.shape), pixel, span, places)
            whole = (np.abs(within[0] - low) < CUT_MM) & (np.abs(within[1] - high) < CUT_MM)
            heights.append((np.where(whole, low, np.nan), np.where(whole, high, np.nan)))
    require(bool(heights), "no mirror beside the finger shows it.")
    with np.errstate(invalid="ignore"):
        under, over = (_mean([pair[k] for pair in heights]) for k in range(2))
    body = body_from_outlines(places, (sides[0], sides[1]), (under, over), exponent)
    level = float(np.median(body.level_mm))
    cap = min(float(np.median(body.half_mm)), 0.6 * float(np.ptp(body.along_mm)))
    tip = float(body.along_mm[-1])
    shifted = Body(
        body.along_mm - (tip - cap), body.middle_mm, body.half_mm, body.level_mm - level, body.rise_mm, exponent
    )
    centre_mm = middle + (tip - cap) * axes[1] + level * axes[2]
    lengths = (float(shifted.along_mm[0]) - BELOW_MM, float(cap * np.deg2rad(FAN_DEG)))
    chart = chart_over(centre_mm, axes, (-AROUND_DEG, AROUND_DEG), lengths, cap, SHAPE_PITCH_MM, cap)
    return Shape(chart, shifted.radius(chart), shifted)


def _within(front: Sight, corners_mm: Array, shape: tuple[int, ...]) -> BoolArray:
    """(H, W) pixels well inside a mirror's outline."""
    column, row = front.pixels(np.asarray(corners_mm, dtype=np.float64))
    inner = np.zeros(shape, dtype=np.uint8)
    cv2.fillConvexPoly(inner, np.rint(np.stack([column, row], axis=1)).astype(np.int32), 1)
    margin = max(1, round(EDGE_MM * front.camera.px_per_mm))
    eroded = cv2.erode(np.pad(inner, margin), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    return np.asarray(eroded[margin:-margin, margin:-margin] > 0)


def _mean(values: list[Array]) -> Array:
    """Mean of what is finite."""
    stacked = np.stack(values)
    known = np.isfinite(stacked)
    total = np.where(known, stacked, 0.0).sum(axis=0)
    count = known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
