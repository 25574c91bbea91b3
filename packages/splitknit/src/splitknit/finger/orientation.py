"""Which way the finger points, and the frame in which it is upright (tip up).

All on a copy of the mask whose longer side has 512 pixels: the centroid of each of its rows is
exact to a small fraction of a pixel, and the angle follows from hundreds of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from splitknit.finger.parameters import (
    CLEAR_TIP,
    FULL_WIDTH,
    HIDDEN_TIPS,
    LONGEST_SIDE,
    MAX_TURN_DEG,
    SEARCHED_SIDE,
    TIP_EXCLUSION,
    TIP_LENGTHS,
    TIP_STEP_DEG,
    UNLIKE_FINGER,
    UPRIGHT_MARGIN,
)
from splitknit.finger.regions import reduce_mask
from splitknit.imaging.geometry import rotation_about, warp
from splitknit.model import Array, BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Upright:
    """The frame in which the finger's tip points to row 0, at the input's pixel pitch."""

    yaw_rad: float
    """Direction of the tip in the input, counter-clockwise from up (towards row 0)."""
    input_from_upright: Array
    """(3, 3) on (column, row, 1): where an upright pixel lies in the input."""
    size: tuple[int, int]
    """Rows, columns of the upright frame."""
    tip: tuple[float, float]
    """Column, row of the tip in the input: the end of the finger on its axis."""
    width_px: float
    """Median full width of the finger, pixels."""
    reliable: bool = True
    """Whether an axis was found; if not, the tip is taken to point where it was expected."""
    clear: bool = True
    """Whether the outline shows which way the tip points, or it was given."""
    note: str = ""
    """Remarks on the result; empty if there are none."""

    @property
    def upright_from_input(self) -> Array:
        """(3, 3) on (column, row, 1): where an input pixel lies in the upright frame."""
        return np.asarray(np.linalg.inv(self.input_from_upright))

    @property
    def tip_row(self) -> float:
        """Row of the tip in the upright frame."""
        return float((self.upright_from_input @ np.array([*self.tip, 1.0]))[1])


def find_upright(
    mask: BoolArray, tip_direction_deg: float | None = None, *, all_rows: bool = False
) -> Upright:
    """The yaw of the finger `mask` (H, W) and the frame in which it is upright; nothing is
    resampled. A line is fitted robustly (Tukey's biweight) to the midpoints of full-width rows,
    without the tip and rows cut by the border, again in the frame turned by its angle until that
    stays. `tip_direction_deg`: of the tip within 75 deg, 0 = up, counter-clockwise; None: found by
    the outline; `all_rows`: a plain line through the middles of all rows, as the thesis has it.
    Source: the thesis, 3.3.1.1, "Orientation Correction".
    """
    stated = tip_direction_deg is not None
    expected, clear = (
        _tip_direction(mask) if tip_direction_deg is None else (np.deg2rad(tip_direction_deg), True)
    )
    scale = min(1.0, LONGEST_SIDE / max(mask.shape))
    small = reduce_mask(mask, scale)
    visible = np.zeros(small.shape, dtype=np.float32)
    visible[1:-1, 1:-1] = 1.0
    angle = _start(small, expected)
    if not stated and abs(_between(angle, expected)) > np.deg2rad(30.0):
        angle = expected
    reliable = False
    for _ in range(12):
        correction, reliable = _tilt(small, visible, angle, all_rows=all_rows)
        if not reliable:
            break
        angle += float(np.clip(correction, -0.35, 0.35))
        if abs(correction) < np.deg2rad(0.02):
            break
    note = ""
    turn = _between(angle, expected)
    if not reliable:
        note = (
            "the outline shows no axis (too little of the finger is in view); it was taken as"
            " upright."
        )
    elif abs(turn) > np.deg2rad(MAX_TURN_DEG):
        note = (
            f"the outline's axis is turned by {np.rad2deg(turn):.0f} deg from where the tip was"
            " expected; it was not believed (set tip_direction_deg)."
        )
        reliable = False
    yaw = float(expected + turn if reliable else expected)
    if not stated:
        yaw = _between(angle if reliable else expected, 0.0)
    if not clear and not note:
        note = (
            "the outline does not show which way the finger's tip points; it was taken to point"
            f" {round(float(np.rad2deg(yaw)))} deg from up, counter-clockwise. If it does not, give"
            " `tip_direction_deg` (tip_direction_deg in capture.json)."
        )
    return replace(_frame(mask, yaw), reliable=reliable, clear=clear, note=note)


def as_it_lies(mask: BoolArray) -> Upright:
    """The frame of an object that is not a finger, not turned."""
    return _frame(mask, 0.0)


def _between(angle: float, reference: float) -> float:
    """Turn from `reference` to `angle`, -pi to pi."""
    return float((angle - reference + np.pi) % (2 * np.pi) - np.pi)


def _tip_direction(mask: BoolArray) -> tuple[float, bool]:
    """Direction of the tip by the outline, and whether it is clear; of several that fit, that
    nearest to up."""
    directions = _tip_directions(mask)
    best, least = min(directions, key=itemgetter(1))
    close = [angle for angle, difference in directions if difference < least + CLEAR_TIP]
    if least < UNLIKE_FINGER and all(
        abs(_between(angle, best)) <= np.deg2rad(60.0) for angle in close
    ):
        return best, True
    return min(close, key=lambda angle: (abs(angle), angle)), False


def _tip_directions(mask: BoolArray) -> list[tuple[float, float]]:
    """How well a finger that points in each direction covers the mask: pairs of direction (rad,
    counter-clockwise from up) and area by which they differ (squared widths). The finger is a strip
    of the mask's width with one round end; only what the image shows of it is compared, so that a
    cut by the border, at whatever slant, is not evidence.
    """
    scale = min(1.0, SEARCHED_SIDE / max(mask.shape))
    small = reduce_mask(mask, scale) > 0.5
    if not small.any():
        small = mask
    rows, columns = np.indices(small.shape, dtype=np.float64)
    inside = small.ravel()
    fits = []
    for angle in np.deg2rad(np.arange(-180.0, 180.0, TIP_STEP_DEG)):
        across = (np.cos(angle) * columns - np.sin(angle) * rows).ravel()
        down = (np.sin(angle) * columns + np.cos(angle) * rows).ravel()
        fits.append((float(angle), *_difference(across, down, inside)))
    width = max(min(fits, key=itemgetter(1))[2], 1.0)
    return [(angle, difference / width**2) for angle, difference, _ in fits]


def _difference(across: Array, down: Array, inside: BoolArray) -> tuple[int, float]:
    """In how many pixels the mask `inside` (N,) differs from an upright finger at best, and the
    finger's width."""
    first = float(down[inside].min())
    last = float(down[inside].max())
    strip = np.floor(down[inside] - first).astype(np.intp)
    widths = np.bincount(strip)
    width = float(np.percentile(widths, 90))
    middles = np.bincount(strip, across[inside]) / np.maximum(widths, 1)
    middle = float(np.median(middles[widths > 0.5 * width])) if width > 0 else 0.0
    off_axis = np.abs(across - middle) / max(0.5 * width, 0.5)
    off_axis *= off_axis
    drawn = (down <= last) & (off_axis < 1.0)  # what is drawn lies in it, whatever the tip is
    tip = drawn & (down < first + max(TIP_LENGTHS) * width)  # below, all of it is drawn
    outside = int(np.count_nonzero(inside & ~drawn) + np.count_nonzero(drawn & ~tip & ~inside))
    off_axis = off_axis[tip]
    down = down[tip] - first
    inside = inside[tip]
    best = inside.size
    for hidden in HIDDEN_TIPS:
        below = down + hidden * width
        for cap in TIP_LENGTHS:
            left = np.maximum(1.0 - below / (cap * width), 0.0)
            best = min(best, int(np.count_nonzero((off_axis < 1.0 - left * left) != inside)))
    return outside + best, width


def _start(small: FloatArray, expected: float) -> float:
    """First guess: from the middle of the finger's entry at the image's border to the middle of the
    mask."""
    rows, columns = np.nonzero(small > 0.5)
    if len(rows) == 0:
        return expected
    edge = (
        (rows <= 1)
        | (columns <= 1)
        | (rows >= small.shape[0] - 2)
        | (columns >= small.shape[1] - 2)
    )
    up = np.array([-np.sin(expected), -np.cos(expected)])  # (column, row) of the expected direction
    centre = np.array([columns.mean(), rows.mean()])
    if int(edge.sum()) >= 6:
        axis = centre - np.array([columns[edge].mean(), rows[edge].mean()])
        guess = _direction(axis)
        if axis @ up > 0.2 * np.linalg.norm(axis) > 0:
            return guess
    points = np.stack([columns, rows]).astype(np.float64) - centre[:, None]
    values, vectors = np.linalg.eigh(np.einsum("in,jn->ij", points, points))
    if values[1] < 1.3 * values[0]:
        return expected
    axis = vectors[:, 1] * (1.0 if vectors[:, 1] @ up >= 0 else -1.0)
    return _direction(axis)


def _direction(axis: Array) -> float:
    """Angle, counter-clockwise from up, of a direction given as (column, row)."""
    return float(np.arctan2(-axis[0], -axis[1]))


def _tilt(
    small: FloatArray, visible: FloatArray, angle: float, *, all_rows: bool = False
) -> tuple[float, bool]:
    """Angle by which the midline leans (counter-clockwise) in the frame turned by `angle`, and
    whether it exists."""
    side = int(np.ceil(np.hypot(*small.shape))) + 2
    middle = ((small.shape[1] - 1) / 2, (small.shape[0] - 1) / 2)
    shift = np.array(
        [
            [1.0, 0.0, middle[0] - (side - 1) / 2],
            [0.0, 1.0, middle[1] - (side - 1) / 2],
            [0, 0, 1.0],
        ]
    )
    transform = rotation_about(middle, angle) @ shift
    turned = np.clip(warp(small, transform, (side, side)), 0.0, 1.0)
    inside = warp(visible, transform, (side, side)) > 0.5
    widths = turned.sum(axis=1, dtype=np.float64)
    column = np.arange(side, dtype=np.float64)
    middles = (turned * column).sum(axis=1, dtype=np.float64) / np.maximum(widths, 1e-9)
    row = np.arange(side)
    present = turned > 0.5
    cut = (present & ~inside).any(axis=1)
    whole = (widths > 2.0) & ~cut
    if not whole.any():
        return 0.0, False
    if all_rows and whole.sum() > 8:
        return float(np.arctan(np.polyfit(row[whole], middles[whole], 1)[0])), True
    first = int(np.argmax(widths > 2.0))
    widest = float(np.percentile(widths[whole], 95))
    chosen = whole & (widths >= FULL_WIDTH * widest) & (row >= first + TIP_EXCLUSION * widest)
    if chosen.sum() < max(8.0, 0.12 * widest):
        chosen = whole & (row >= first + 0.3 * widest)
    if chosen.sum() < max(8.0, 0.12 * widest):
        return 0.0, False
    return float(np.arctan(_robust_slope(row[chosen].astype(np.float64), middles[chosen]))), True


def _robust_slope(rows: Array, columns: Array) -> float:
    """Columns per row of the line through the midpoints, by iterated Tukey weights."""
    x = rows - rows.mean()
    weights = np.ones_like(x)
    for _ in range(20):
        total = weights.sum()
        mean_x = (weights * x).sum() / total
        mean_y = (weights * columns).sum() / total
        slope = float(
            (weights * (x - mean_x) * (columns - mean_y)).sum()
            / (weights * (x - mean_x) ** 2).sum()
        )
        intercept = float(mean_y - slope * mean_x)
        residual = columns - intercept - slope * x
        spread = max(1.4826 * float(np.median(np.abs(residual))), 0.05)
        updated = np.maximum(0.0, 1.0 - (residual / (4.685 * spread)) ** 2) ** 2
        if updated.sum() < 3.0 or np.allclose(updated, weights, atol=1e-4):
            break
        weights = updated
    return slope


def _frame(mask: BoolArray, yaw: float) -> Upright:
    """Bounding box of the turned mask, its tip and its width, from the outline's pixels at full
    resolution."""
    rows, columns = _outline(mask)
    turn = rotation_about((0.0, 0.0), -yaw)  # input to turned, both about the first pixel
    turned = turn[:2, :2] @ np.stack([columns, rows]).astype(np.float64)
    low = turned.min(axis=1)
    high = turned.max(axis=1)
    margin = max(2.0, UPRIGHT_MARGIN * float((high - low).max()))
    origin = np.floor(low - margin)
    size = np.ceil(high + margin) - origin + 1.0
    shift = np.array([[1.0, 0.0, origin[0]], [0.0, 1.0, origin[1]], [0.0, 0.0, 1.0]])
    input_from_upright = rotation_about((0.0, 0.0), yaw) @ shift
    extent = float(high[1] - low[1])
    lines = np.round(turned[1] - low[1]).astype(np.int64)
    left = np.full(int(np.ceil(extent)) + 2, np.inf)
    right = np.full(left.size, -np.inf)
    np.minimum.at(left, lines, turned[0])
    np.maximum.at(right, lines, turned[0])
    widths = np.where(np.isfinite(left), right - left + 1.0, 0.0)
    width = float(np.median(widths[widths >= 0.8 * widths.max()]))
    top = lines <= max(1.0, 0.03 * width)
    tip = input_from_upright @ np.array(
        [float(turned[0][top].mean()) - origin[0], float(low[1] - origin[1]), 1.0]
    )
    return Upright(
        yaw, input_from_upright, (int(size[1]), int(size[0])), (float(tip[0]), float(tip[1])), width
    )


def _outline(mask: BoolArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the first and last mask pixel of every row and every column: enough for
    any extent."""
    any_row = np.flatnonzero(mask.any(axis=1))
    any_column = np.flatnonzero(mask.any(axis=0))
    left = mask[any_row].argmax(axis=1)
    right = mask.shape[1] - 1 - mask[any_row][:, ::-1].argmax(axis=1)
    top = mask[:, any_column].argmax(axis=0)
    bottom = mask.shape[0] - 1 - mask[::-1, any_column].argmax(axis=0)
    rows = np.concatenate([any_row, any_row, top, bottom])
    columns = np.concatenate([left, right, any_column, any_column])
    return rows, columns
