"""Views of one finger as one relief: weights that fade into each other, seams, and how far around it reaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.mirrors.rolled.chart import Chart
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

Array = NDArray[np.float64]


STEEPEST_DEG = 72.0
"""Slant, as a view sees it, from which it counts for nothing."""
_POWER = 8.0
"""Views weigh with this power of what their slant leaves: high hands over fast, low mixes over a wide zone."""
_DEVIATION_FLOOR_UM = 4.0
"""Added to the relief's standard deviation, so that no view is trusted without limit."""


@dataclass(frozen=True, slots=True)
class BlendSettings(Checked):
    """How views are weighed."""

    _group = "rolled.blend"
    fade_mm: Annotated[float, Limits(0, 5, above=True)] = 0.8
    """Width over which a view fades in from the outline of what it shows."""
    most_deviation_um: Annotated[float, Limits(0, above=True)] = 35.0
    """Where the relief's standard deviation is as large as this, ridges are not known; from three quarters of it on, a
    view counts less."""


def view_weight(
    cosine: Array, known: BoolArray, deviation_mm: FloatArray, pitch_mm: float, settings: BlendSettings
) -> FloatArray:
    """(n, m) weight of a view on the chart, zero where it shows nothing.

    Parameters
    ----------
    cosine : (n, m) of the slant as the view sees it
    known : (n, m) where it shows the finger
    deviation_mm : (n, m) of its relief, along the skin's normal
    """
    least = np.cos(np.deg2rad(STEEPEST_DEG))
    facing = np.clip((cosine - least) / (1.0 - least), 0.0, 1.0) ** _POWER
    inside = np.asarray(known & (facing > 0), dtype=np.uint8)
    depth = cv2.distanceTransform(np.pad(inside, 1), cv2.DIST_L2, 5)[1:-1, 1:-1] * pitch_mm
    fade = np.clip(depth / settings.fade_mm, 0.0, 1.0)
    fade = fade * fade * (3.0 - 2.0 * fade)
    floor = 1e-3 * _DEVIATION_FLOOR_UM
    smooth = cv2.GaussianBlur(np.where(known, deviation_mm, 0.0).astype(np.float32), (0, 0), 0.5 / pitch_mm)
    fraction = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 0.5 / pitch_mm)
    deviation = smooth / np.maximum(fraction, np.float32(1e-3))
    certain = floor**2 / (floor**2 + deviation**2)
    sure = np.clip(4.0 * (1.0 - deviation / (1e-3 * settings.most_deviation_um)), 0.0, 1.0)
    return np.asarray(facing * fade * certain * sure * inside, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Blended:
    """One relief from all views."""

    relief_mm: FloatArray
    """(n, m) along the skin's normal, zero where no view shows the finger."""
    deviation_mm: FloatArray
    """(n, m)."""
    known: BoolArray
    """(n, m)."""
    fractions: FloatArray
    """(V, n, m) of each view; they sum to one where known."""


def blend(reliefs: FloatArray, deviations_mm: FloatArray, weights: FloatArray) -> Blended:
    """Mean of the views (V, n, m) by their weights (V, n, m)."""
    total = weights.sum(axis=0)
    known = total > 1e-6
    fractions = weights / np.where(known, total, np.float32(1.0))
    relief = (fractions * np.where(fractions > 0, reliefs, np.float32(0.0))).sum(axis=0)
    variance = (fractions**2 * np.where(fractions > 0, deviations_mm, np.float32(0.0)) ** 2).sum(axis=0)
    return Blended(relief.astype(np.float32), np.sqrt(variance).astype(np.float32), known, fractions.astype(np.float32))


def seam_lines(fractions: FloatArray, first: int, second: int) -> BoolArray:
    """(n, m) pixels just left of where the weight passes from view `first` to view `second`, along the rows."""
    ahead = fractions[first] > fractions[second]
    both = (np.minimum(fractions[first], fractions[second]) > 0.25) & (fractions[first] + fractions[second] > 0.8)
    line = np.zeros(ahead.shape, dtype=np.bool_)
    line[:, :-1] = (ahead[:, :-1] != ahead[:, 1:]) & both[:, :-1] & both[:, 1:]
    return line


def seam_steps(values: FloatArray, line: BoolArray, pitch_mm: float, beside_mm: float = 0.25) -> Array:
    """(K,) by how much the mean beside a seam differs from that on its other side, at every pixel of the seam.

    `values` (n, m) is what should not change there: the relief's error where the truth is known, or what is left of the
    relief when the ridges are smoothed away.
    """
    reach = max(1, round(beside_mm / pitch_mm))
    padded = np.pad(values.astype(np.float64), ((0, 0), (reach, reach)), mode="edge")
    sums = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    rows, columns = np.nonzero(line)
    at = columns + reach + 1  # first pixel right of the seam, in the padded image
    left = (sums[rows, at] - sums[rows, at - reach]) / reach
    right = (sums[rows, at + reach] - sums[rows, at]) / reach
    return np.asarray(right - left)


def coverage_deg(chart: Chart, known: BoolArray, normals: Array) -> Array:
    """(n,) range of directions, around the finger, of the skin's normals that each row shows without a gap; degrees.

    A row over the straight part of the finger counts its longest run of known pixels. The direction is that of the
    normal about the finger's axis, not that of the ray: what a flat view calls slant.
    """
    local = normals @ chart.axes.T
    around = np.rad2deg(np.arctan2(local[..., 0], local[..., 2]))
    result = np.zeros(chart.shape[0])
    for row in range(chart.shape[0]):
        labels, count = ndimage.label(known[row])
        if count == 0:
            continue
        longest = 1 + int(np.argmax(np.bincount(labels[labels > 0])[1:]))
        places = np.flatnonzero(labels == longest)
        result[row] = float(np.ptp(np.unwrap(np.deg2rad(around[row, places])))) * 180.0 / np.pi
    return result
