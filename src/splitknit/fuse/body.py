"""A smooth finger from its outlines: what the front shows of its breadth, and a mirror beside it of its height."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.check import require
from splitknit.fuse.chart import Chart
from splitknit.types import BoolArray, FloatArray

Array = NDArray[np.float64]

STEP_MM = 0.1
"""Distance of the cross-sections."""
SMOOTH_MM = 0.6
"""Standard deviation along the finger over which outlines are smoothed."""
LEAST_ROWS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Cross-sections of a finger in a chart's frame: superellipses, one each `STEP_MM`, closed at the tip."""

    along_mm: Array
    """(K,) ascending; the last is the tip."""
    middle_mm: Array
    """(K,) to the right."""
    half_mm: Array
    """(K,) half the breadth, zero at the tip."""
    level_mm: Array
    """(K,) of the widest line, towards the camera."""
    rise_mm: Array
    """(K,) half the height, zero at the tip."""
    exponent: float = 2.2
    """2 is an ellipse, more a squarer section."""

    def outside(self, points: Array) -> Array:
        """Values (...) of points (..., 3) of the frame: below zero inside, above it outside."""
        right, along, front = np.moveaxis(points, -1, 0)
        # the squares of the half axes are straight towards a round tip
        half, rise = (
            np.sqrt(np.maximum(np.interp(along, self.along_mm, v * v), 1e-8)) for v in (self.half_mm, self.rise_mm)
        )
        middle, level = (np.interp(along, self.along_mm, v) for v in (self.middle_mm, self.level_mm))
        value = np.abs((right - middle) / half) ** self.exponent + np.abs((front - level) / rise) ** self.exponent
        return np.asarray(np.where(along > self.along_mm[-1], np.maximum(value, 2.0), value) - 1.0)

    def radius(self, chart: Chart) -> Array:
        """(n, m) distance of the skin along the rays of a chart in whose frame the body lies."""
        start, directions = chart.rays()
        local_start = (start - chart.centre_mm) @ chart.axes.T
        local = directions @ chart.axes.T
        low = np.zeros(chart.shape)
        high = np.full(chart.shape, 1.5 * float(max(self.half_mm.max(), self.rise_mm.max())) + chart.cap_mm)
        for _ in range(24):
            middle = 0.5 * (low + high)
            out = self.outside(local_start[:, None] + middle[..., None] * local) > 0
            high, low = np.where(out, middle, high), np.where(out, low, middle)
        return np.asarray(0.5 * (low + high))

    def squarer(self, exponent: float) -> Body:
        """The same outlines with other sections between them."""
        return replace(self, exponent=exponent)


def outline(
    mask: BoolArray, pixel_of_plane: Array, across_mm: tuple[float, float], along_mm: Array
) -> tuple[Array, Array]:
    """Lowest and highest place (K,) of a view's mask in each row of a plane; NaN where the row shows nothing.

    Parameters
    ----------
    mask : (H, W)
    pixel_of_plane : (2, 3) column and row of the view at (across, along, 1) of the plane, mm
    across_mm : range that is looked at
    along_mm : (K,) the rows, evenly spaced
    """
    step = STEP_MM / 2
    count = int(np.ceil((across_mm[1] - across_mm[0]) / step)) + 1
    spacing = float(along_mm[1] - along_mm[0])
    to_plane = np.array([[step, 0.0, across_mm[0]], [0.0, spacing, along_mm[0]], [0.0, 0.0, 1.0]])
    matrix = pixel_of_plane @ to_plane
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    seen = cv2.warpAffine(
        smooth, matrix, (count, along_mm.size), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT, borderValue=0.0,
    )  # fmt: skip
    low, high = np.full(along_mm.size, np.nan), np.full(along_mm.size, np.nan)
    for k, row in enumerate(seen):
        there = np.flatnonzero(row > 0.5)
        if there.size:
            low[k] = across_mm[0] + step * _crossing(row, int(there[0]), -1)
            high[k] = across_mm[0] + step * _crossing(row, int(there[-1]), 1)
    return low, high


def _crossing(row: FloatArray, inner: int, direction: int) -> float:
    """Where a row falls below one half beside `inner`."""
    outer = inner + direction
    if not 0 <= outer < row.size:
        return float(inner)
    drop = float(row[inner] - row[outer])
    return inner + direction * (float(row[inner]) - 0.5) / max(drop, 1e-6)


def body_from_outlines(
    along_mm: Array, sides: tuple[Array, Array], heights: tuple[Array, Array], exponent: float = 2.2
) -> Body:
    """A body from its outlines, smoothed, closed at the tip.

    Parameters
    ----------
    along_mm : (K,) evenly spaced, ascending
    sides : left and right (K,), NaN where the front shows nothing
    heights : lowest and highest (K,), likewise of the views from beside
    exponent : of the sections

    Raises
    ------
    BadInput
        If the outlines have too few rows in common.
    """
    both = np.isfinite(np.stack([*sides, *heights])).all(axis=0)
    rows = np.flatnonzero(both)
    require(
        rows.size >= LEAST_ROWS,
        f"front and mirror show only {rows.size * STEP_MM:.1f} mm of the finger's length together; do both show it?",
    )
    rows = np.arange(rows[0], rows[-1] + 1)
    along = along_mm[rows]
    low, high, under, over = (np.interp(along, along_mm[both], v[both]) for v in (*sides, *heights))
    sigma = SMOOTH_MM / float(along_mm[1] - along_mm[0])

    def smooth(values: Array) -> Array:
        """Gaussian mean, mirrored about the ends' own values so that slopes go on."""
        reach = min(int(4 * sigma), values.size - 1)
        before, after = 2 * values[0] - values[reach:0:-1], 2 * values[-1] - values[-2 : -reach - 2 : -1]
        return np.asarray(ndimage.gaussian_filter1d(np.r_[before, values, after], sigma)[reach : reach + values.size])

    half, rise = (np.sqrt(np.maximum(smooth((0.5 * (b - a)) ** 2), 1e-8)) for a, b in ((low, high), (under, over)))
    middle, level = (smooth(0.5 * (a + b)) for a, b in ((low, high), (under, over)))
    # the squares run straight to zero at the tip
    step, slope = float(along[1] - along[0]), []
    last = slice(-max(6, round(0.8 / STEP_MM)), None)
    for values in (half, rise):
        fit = np.polyfit(along[last], values[last] ** 2, 1)
        slope.append(-fit[1] / fit[0] if fit[0] < -1e-6 else along[-1])
    tip = float(np.clip(np.median(slope), along[-1], along[-1] + 1.0)) + 0.25 * step
    ends = [
        np.r_[values, last_value]
        for values, last_value in ((half, 0.0), (rise, 0.0), (middle, middle[-1]), (level, level[-1]))
    ]
    return Body(np.r_[along, tip], ends[2], ends[0], ends[3], ends[1], exponent)
