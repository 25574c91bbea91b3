"""How far two views' ridges lie apart on the chart, place by place."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.types import BoolArray, FloatArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DisparitySettings:
    """How ridges of two views are compared."""

    window_mm: float = 3.0
    """Side of the squares that are compared: some six ridges."""
    step_mm: float = 1.0
    """Distance of their middles."""
    least_peak: float = 0.4
    """Correlation below which a square says nothing."""
    least_lead: float = 0.03
    """How much the best place must correlate better than any other peak: ridges look alike a period on."""
    least_share: float = 0.7
    """Share of a square that both views must show."""

    def __post_init__(self) -> None:
        require(0.5 <= self.window_mm <= 10.0, "fuse.window_mm must lie in [0.5, 10].")
        require(0.1 <= self.step_mm <= 5.0, "fuse.step_mm must lie in [0.1, 5].")
        require(0.0 < self.least_peak < 1.0, "fuse.least_peak must lie between 0 and 1.")
        require(0.0 <= self.least_lead < 1.0, "fuse.least_lead must lie in [0, 1).")
        require(0.1 <= self.least_share <= 1.0, "fuse.least_share must lie in [0.1, 1].")


@dataclass(frozen=True, slots=True, eq=False)
class Disparity:
    """Where squares of one view are found in the other."""

    columns: Array
    """(K,) middles of the squares on the chart, in the first view."""
    rows: Array
    shift: Array
    """(K, 2) columns and rows by which the second view's ridges lie further."""
    peak: Array
    """(K,) correlation there."""


def disparity(  # noqa: PLR0917
    first: FloatArray,
    second: FloatArray,
    both: BoolArray,
    pitch_mm: float,
    reach_mm: float,
    settings: DisparitySettings | None = None,
) -> Disparity:
    """Compare two views' relief on the chart.

    Parameters
    ----------
    first, second : (n, m) relief, finite, free of its local mean; zero where a view shows nothing
    both : (n, m) where both views show the finger
    pitch_mm : of the chart
    reach_mm : how far apart ridges are looked for
    settings : DisparitySettings
    """
    chosen = settings or DisparitySettings()
    half = max(3, round(0.5 * chosen.window_mm / pitch_mm))
    reach = max(1, round(reach_mm / pitch_mm))
    step = max(1, round(chosen.step_mm / pitch_mm))
    rows, columns = both.shape
    shared = cv2.boxFilter(both.astype(np.float32), -1, (2 * half + 1, 2 * half + 1), borderType=cv2.BORDER_CONSTANT)
    found = []
    for row in range(half, rows - half, step):
        for column in range(half, columns - half, step):
            if shared[row, column] < chosen.least_share:
                continue
            one = _match(first, second, (row, column), half, reach, chosen)
            if one is not None:
                found.append((column, row, *one))
    table = np.array(found, dtype=np.float64).reshape(-1, 5)
    return Disparity(table[:, 0], table[:, 1], table[:, 2:4], table[:, 4])


def _match(  # noqa: PLR0917
    first: FloatArray, second: FloatArray, place: tuple[int, int], half: int, reach: int, chosen: DisparitySettings
) -> tuple[float, float, float] | None:
    row, column = place
    patch = first[row - half : row + half + 1, column - half : column + half + 1]
    top, left = max(0, row - half - reach), max(0, column - half - reach)
    area = second[top : row + half + reach + 1, left : column + half + reach + 1]
    if float(patch.std()) < 1e-9 or float(area.std()) < 1e-9:
        return None
    score = cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED)
    at = np.unravel_index(int(np.argmax(score)), score.shape)
    peak = float(score[at])
    i, j = int(at[0]), int(at[1])
    if not (0 < i < score.shape[0] - 1 and 0 < j < score.shape[1] - 1) or peak < chosen.least_peak:
        return None
    rivals = (score == cv2.dilate(score, np.ones((3, 3), np.uint8))) & (score < peak)
    if rivals.any() and peak - float(score[rivals].max()) < chosen.least_lead:
        return None
    down = _vertex(score[i - 1, j], score[i, j], score[i + 1, j])
    right = _vertex(score[i, j - 1], score[i, j], score[i, j + 1])
    return j + right + left - (column - half), i + down + top - (row - half), peak


def _vertex(before: float, here: float, after: float) -> float:
    """Where the parabola through three values has its highest point."""
    bend = before - 2.0 * here + after
    return float(0.5 * (before - after) / bend) if bend < 0 else 0.0


def ridge_band(relief: FloatArray, known: BoolArray, pitch_mm: float, sigma_mm: float = 0.32) -> FloatArray:
    """(n, m) relief less its local mean over `known`, zero elsewhere."""
    weight = known.astype(np.float32)
    filled = np.where(known, relief, np.float32(0.0)).astype(np.float32)
    sigma = sigma_mm / pitch_mm
    mean = cv2.GaussianBlur(filled, (0, 0), sigma) / np.maximum(
        cv2.GaussianBlur(weight, (0, 0), sigma), np.float32(1e-3)
    )
    return np.where(known, filled - mean, np.float32(0.0)).astype(np.float32)
