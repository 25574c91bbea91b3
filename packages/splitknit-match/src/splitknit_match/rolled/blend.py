"""Settings of the rolled-equivalent finger; views of one finger as one relief, and its seams."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits
from splitknit_match.rolled.register import RidgeSearchSettings

Array = NDArray[np.float64]
STEEPEST_DEG = 72.0  # slant, as a view sees it, from which it counts for nothing


@dataclass(frozen=True, slots=True)
class BlendSettings(Checked):
    """How views are weighed."""

    _group = "rolled.blend"
    fade_mm: Annotated[float, Limits(0, 5, above=True)] = 0.8
    """Width over which a view fades in from the outline of what it shows."""
    most_deviation_um: Annotated[float, Limits(0, above=True)] = 35.0
    """Where the relief's standard deviation exceeds this, ridges are unknown; a view loses weight
    from three quarters of it on."""


@dataclass(frozen=True, slots=True)
class RolledSettings:
    """How views from the front and in mirrors become one finger."""

    around_deg: float = 105.0
    """The chart reaches this far to either side of the front."""
    pitch_mm: float = 0.035
    """Pitch of the chart, finer than the camera resolves."""
    slope_prior: float = 0.5
    """Prior that holds slopes which the lights hardly determine to those of the shape: variance of the images' relative
    error over that of the slopes."""
    search: RidgeSearchSettings = field(default_factory=RidgeSearchSettings)
    blend: BlendSettings = field(default_factory=BlendSettings)

    def __post_init__(self) -> None:
        require(30.0 <= self.around_deg <= 150.0, "rolled.around_deg must lie in [30, 150].")
        require(0.01 <= self.pitch_mm <= 0.2, "rolled.pitch_mm must lie in [0.01, 0.2].")


@dataclass(frozen=True, slots=True, eq=False)
class Blended:
    """One relief from all views."""

    relief_mm: FloatArray  # (n, m) along the skin's normal, zero where no view shows the finger
    deviation_mm: FloatArray  # (n, m)
    known: BoolArray  # (n, m)
    fractions: FloatArray  # (V, n, m) of each view; they sum to one where known


def blend(reliefs: FloatArray, deviations_mm: FloatArray, weights: FloatArray) -> Blended:
    """Mean of the views (V, n, m) by their weights (V, n, m)."""
    total = weights.sum(axis=0)
    known = total > 1e-6
    fractions = weights / np.where(known, total, 1.0)
    relief = (fractions * np.where(fractions > 0, reliefs, 0.0)).sum(axis=0)
    variance = (fractions**2 * np.where(fractions > 0, deviations_mm, 0.0) ** 2).sum(axis=0)
    return Blended(relief.astype(np.float32), np.sqrt(variance).astype(np.float32), known, fractions.astype(np.float32))


def seam_lines(fractions: FloatArray, first: int, second: int) -> BoolArray:
    """(n, m) pixels just left of where the weight passes from view `first` to view `second`, along the rows."""
    ahead = fractions[first] > fractions[second]
    both = (np.minimum(fractions[first], fractions[second]) > 0.25) & (fractions[first] + fractions[second] > 0.8)
    line = np.zeros(ahead.shape, dtype=np.bool_)
    line[:, :-1] = (ahead[:, :-1] != ahead[:, 1:]) & both[:, :-1] & both[:, 1:]
    return line


def seam_steps(values: FloatArray, line: BoolArray, pitch_mm: float) -> Array:
    """(K,) by how much the mean beside a seam differs from that on its other side, at every pixel of the seam.
    `values` (n, m) is what should not change there: the relief's error, or the relief with its ridges smoothed away.
    """
    reach = max(1, round(0.25 / pitch_mm))
    padded = np.pad(values.astype(np.float64), ((0, 0), (reach, reach)), mode="edge")
    sums = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    rows, columns = np.nonzero(line)
    at = columns + reach + 1  # first pixel right of the seam, in the padded image
    left = (sums[rows, at] - sums[rows, at - reach]) / reach
    right = (sums[rows, at + reach] - sums[rows, at]) / reach
    return np.asarray(right - left)
