"""Which way the finger points, and the frame in which it is upright (tip up).

All on a copy of the mask whose longer side has 512 pixels: the centroid of each of its rows is
exact to a small fraction of a pixel, and the angle follows from hundreds of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from splitknit.finger.regions import reduce_mask
from splitknit.imaging.geometry import rotation_about, warp
from splitknit.imaging.robust import robust_line
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


_MAX_TURN = np.deg2rad(75.0)
"""Largest turn from the stated direction that is accepted (captures guarantee 60 deg)."""


def find_upright(mask: BoolArray, tip_direction_deg: float | None = None) -> Upright:
    """The yaw of the finger `mask` (H, W) and the frame in which it is upright; nothing is
    resampled. A line is fitted robustly (Tukey's biweight) to the midpoints of full-width rows,
    without the tip and rows cut by the border, again in the frame turned by its angle until that
    stays. `tip_direction_deg`: of the tip within 75 deg, 0 = up, counter-clockwise; None: found by
    the outline. Source: the thesis, 3.3.1.1, "Orientation Correction".
    """
    directions = _tip_directions(mask)
    if tip_direction_deg is None:
        expected, clear = _tip_direction(directions)
        angle = expected
    else:
        expected, clear = np.deg2rad(tip_direction_deg), True
        near = [fit for fit in directions if abs(_between(fit[0], expected)) <= _MAX_TURN]
        angle = min(near, key=itemgetter(1))[0]
    scale = min(1.0, 512 / max(mask.shape))  # longer side of the reduced mask
    small = reduce_mask(mask, scale)
    visible = np.zeros(small.shape, dtype=np.float32)
    visible[1:-1, 1:-1] = 1.0
    reliable = False
    for _ in range(12):
        correction, reliable = _tilt(small, visible, angle)
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
    elif abs(turn) > _MAX_TURN:
        note = (
            f"the outline's axis is turned by {np.rad2deg(turn):.0f} deg from where the tip was"
            " expected; it was not believed (set tip_direction_deg)."
        )
        reliable = False
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


_CLEAR_TIP = 0.03
"""The direction is clear if all others, more than 60 deg away, differ from the mask by so much
more, in squared widths of the finger. Chosen on: simulated fingers (seeds 7501 to 7503, turned)."""
_UNLIKE_FINGER = 0.3
"""A mask that differs from every finger by this much shows no direction, in squared widths of the
finger. Chosen on: simulated fingers (seeds 7501 to 7503, turned)."""


def _tip_direction(directions: Sequence[tuple[float, float]]) -> tuple[float, bool]:
    """Direction of the tip by how well each fits, and whether it is clear; of several that fit,
    that nearest to up."""
    best, least = min(directions, key=itemgetter(1))
    close = [angle for angle, difference in directions if difference < least + _CLEAR_TIP]
    if least < _UNLIKE_FINGER and all(
        abs(_between(angle, best)) <= np.deg2rad(60.0) for angle in close
    ):
        return best, True
    return min(close, key=lambda angle: (abs(angle), angle)), False


_TIP_STEP_DEG = 5.0
"""Step between the directions that are tried. Chosen on: simulated fingers (seeds 7501 to 7503,
turned)."""


def _tip_directions(mask: BoolArray) -> list[tuple[float, float]]:
    """How well a finger that points in each direction covers the mask: pairs of direction (rad,
    counter-clockwise from up) and area by which they differ (squared widths). The finger is a strip
    of the mask's width with one round end; only what the image shows of it is compared, so that a
    cut by the border, at whatever slant, is not evidence.
    """
    # longer side of the copy on which the direction of the tip is searched
    scale = min(1.0, 96 / max(mask.shape))
    small = reduce_mask(mask, scale) > 0.5
    if not small.any():
        small = mask
    rows, columns = np.indices(small.shape, dtype=np.float64)
    inside = small.ravel()
    fits = []
    for angle in np.deg2rad(np.arange(-180.0, 180.0, _TIP_STEP_DEG)):
        across = (np.cos(angle) * columns - np.sin(angle) * rows).ravel()
        down = (np.sin(angle) * columns + np.cos(angle) * rows).ravel()
        fits.append((float(angle), *_difference(across, down, inside)))
    width = max(min(fits, key=itemgetter(1))[2], 1.0)
    return [(angle, difference / width**2) for angle, difference, _ in fits]


_TIP_LENGTHS = (0.45, 0.65, 0.9)
"""Lengths of the rounded tip that are tried: blunt to slender, in widths of the finger. Chosen on:
simulated fingers (seeds 7501 to 7503, turned)."""
_HIDDEN_TIPS = (0.0, 0.5, 1.5)
"""Lengths of the tip beyond the image's border that are tried, in widths of the finger. Chosen on:
simulated fingers (seeds 7501 to 7503, turned)."""


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
    tip = drawn & (down < first + max(_TIP_LENGTHS) * width)  # below, all of it is drawn
    outside = int(np.count_nonzero(inside & ~drawn) + np.count_nonzero(drawn & ~tip & ~inside))
    off_axis = off_axis[tip]
    down = down[tip] - first
    inside = inside[tip]
    best = inside.size
    for hidden in _HIDDEN_TIPS:
        below = down + hidden * width
        for cap in _TIP_LENGTHS:
            left = np.maximum(1.0 - below / (cap * width), 0.0)
            best = min(best, int(np.count_nonzero((off_axis < 1.0 - left * left) != inside)))
    return outside + best, width


def _tilt(small: FloatArray, visible: FloatArray, angle: float) -> tuple[float, bool]:
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
    first = int(np.argmax(widths > 2.0))
    widest = float(np.percentile(widths[whole], 95))
    # rows of full width, but those nearer to the tip than half the widest one
    chosen = whole & (widths >= 0.85 * widest) & (row >= first + 0.5 * widest)
    if chosen.sum() < max(8.0, 0.12 * widest):
        chosen = whole & (row >= first + 0.3 * widest)
    if chosen.sum() < max(8.0, 0.12 * widest):
        return 0.0, False
    slope, _ = robust_line(row[chosen].astype(np.float64), middles[chosen], 0.05)
    return float(np.arctan(slope)), True


def _frame(mask: BoolArray, yaw: float) -> Upright:
    """Bounding box of the turned mask, its tip and its width, at full resolution."""
    places = np.argwhere(mask)[:, ::-1]
    turn = rotation_about((0.0, 0.0), -yaw)  # input to turned, both about the first pixel
    turned = turn[:2, :2] @ places.T
    low = turned.min(axis=1)
    high = turned.max(axis=1)
    margin = max(2.0, 0.02 * float((high - low).max()))
    origin = np.floor(low - margin)
    size = np.ceil(high + margin) - origin + 1.0
    shift = np.array([[1.0, 0.0, origin[0]], [0.0, 1.0, origin[1]], [0.0, 0.0, 1.0]])
    input_from_upright = rotation_about((0.0, 0.0), yaw) @ shift
    lines = np.round(turned[1] - low[1]).astype(np.int64)
    left = np.full(lines.max() + 1, np.inf)
    right = -left
    np.minimum.at(left, lines, turned[0])
    np.maximum.at(right, lines, turned[0])
    widths = np.maximum(right - left + 1.0, 0.0)
    width = float(np.median(widths[widths >= 0.8 * widths.max()]))
    top = lines <= max(1.0, 0.03 * width)
    tip = input_from_upright @ np.array(
        [float(turned[0][top].mean()) - origin[0], float(low[1] - origin[1]), 1.0]
    )
    return Upright(
        yaw, input_from_upright, (int(size[1]), int(size[0])), (float(tip[0]), float(tip[1])), width
    )
