"""How many pixels lie between the ridges, at any scale: the ruler that a finger carries."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.imaging.robust import deviation
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.plausible import RIDGE_PERIOD

PEOPLE = 0.08
"""Standard deviation of the ridge distance between fingers, relative: sexes, people and digits, as
the simulator's population has them. Source: Cummins, Waits and McQuitty, Am. J. Anat. 68, 1941
(20.7 ridges a centimetre in men, 23.4 in women)."""


class _RidgePeriod(NamedTuple):
    period_px: float
    """Median of the blocks."""
    error_px: float
    """Standard deviation of the median."""
    blocks: int
    part: float
    """Fraction of the examined blocks that hold a single wave."""


_BLOCK_PX = 64
"""Side of a block of the reduced picture. Chosen on: judgement. Range: 32 to 64
(validation/parameters)."""
_STEP_PX = 16
"""Usual distance of the blocks. Chosen on: judgement. Range: 8 to 16 (validation/parameters)."""
_MIN_RIDGED = 0.25
"""At least this fraction of all blocks must have one wave. Fingers have 0.6 to 0.8, DiLiGenT's bear
0.08, a ball none. Chosen on: simulated fingers (and photographs of objects without ridges). Range:
0.08 to 0.6 (what it separates)."""


def ridge_period(normals: FloatArray, mask: BoolArray, step: int = _STEP_PX) -> _RidgePeriod:
    """Measure the distance of the ridges in a map of normals whose scale is unknown.

    The slopes are reduced by 1, 2, 4, ...; in blocks of 64 pixels one wave of 4 to 10 pixels must
    hold most of the power. The size in which such waves cover most of the surface counts. Periods
    are corrected for the surface's slant. `normals`: (H, W, 3) unit normals, x right, y up, z to
    the camera; `mask`: (H, W) bool; `step`: distance of the blocks, pixels. Raises BadInput if no
    ridges are found.

    >>> x = np.tile(np.arange(400.0), (400, 1))
    >>> slope = 0.2 * np.cos(2 * np.pi * x / 12.0)
    >>> normals = np.stack([-slope, 0 * x, np.ones_like(x)], axis=-1).astype(np.float32)
    >>> normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    >>> round(ridge_period(normals, np.ones((400, 400), bool)).period_px, 1)
    12.0
    """
    mask = check_mask(mask, (normals.shape[0], normals.shape[1]))
    steep = np.maximum(normals[..., 2], 0.2)
    slopes = np.stack([-normals[..., 0] / steep, -normals[..., 1] / steep], axis=-1)
    fields = np.dstack([np.where(mask[..., None], slopes, 0.0), mask.astype(np.float32)])
    best: tuple[float, Array, float] = (0.0, np.zeros(0), 0.0)
    for level in range(6):  # maximum number of reduced pictures
        factor = 2**level
        size = (mask.shape[1] // factor, mask.shape[0] // factor)
        if min(size) < _BLOCK_PX:
            break
        small = fields if level == 0 else cv2.resize(fields, size, interpolation=cv2.INTER_AREA)
        periods, blocks = _periods(np.asarray(small), step)
        area = float(len(periods) * factor**2)
        # at least so many blocks must have one wave
        if len(periods) >= max(6 * (_STEP_PX / step) ** 2, _MIN_RIDGED * blocks) and area > best[0]:
            best = area, periods * factor, len(periods) / blocks
    periods = best[1]
    require(
        len(periods) > 0,
        "no ridges were found to take the scale from: they need 4 pixels from one to the next and"
        " good focus; give `px_per_mm`.",
    )
    middle = float(np.median(periods))
    spread = deviation(periods - middle)
    apart = max(1.0, len(periods) * (step / _BLOCK_PX) ** 2)
    return _RidgePeriod(middle, 1.25 * spread / float(np.sqrt(apart)), len(periods), best[2])


def scale_of_ridges(
    normals: FloatArray, mask: BoolArray, px_per_mm: float | None, period_mm: float
) -> tuple[float, str]:
    """Pixels a millimetre at which ridges lie `period_mm` apart, and how well known. BadInput if
    `px_per_mm` is given too, `period_mm` is not a distance of ridges, or none are found.
    """
    require(px_per_mm is None, "`px_per_mm` and `ridge_period_mm` both give the scale; choose one.")
    odd = RIDGE_PERIOD.notes(period_mm, "check `ridge_period_mm`")
    ridges = ridge_period(normals, mask)
    error = float(np.hypot(ridges.error_px / ridges.period_px, PEOPLE))
    px_per_mm = ridges.period_px / period_mm
    also = "".join(f" Also, {note}" for note in odd)
    return (
        px_per_mm,
        (
            f"scale from the ridges: {ridges.period_px:.1f} px from one to the next (standard"
            f" deviation {ridges.error_px:.2f}, {ridges.blocks} places) are {period_mm:g} mm, so"
            f" {px_per_mm:.2f} px/mm; people differ, so that it is known to {100 * error:.0f}"
            f" %.{also}"
        ),
    )


_SHORTEST_PX = 4.0
"""Shortest period that is sought in a reduced picture; the next picture has half the size. Chosen
on: judgement. Range: 2 to 4 (validation/parameters)."""
_LONGEST_PX = 10.0
"""Longest period that is sought in a reduced picture. Chosen on: judgement. Range: 7 to 20
(validation/parameters)."""


def _periods(fields: FloatArray, step: int) -> tuple[Array, int]:
    """Periods (px, on the surface) of blocks of slopes and mask (h, w, 3) with one wave, and the
    number of blocks."""
    window = np.outer(np.hanning(_BLOCK_PX), np.hanning(_BLOCK_PX))[..., None]
    v, u = np.meshgrid(np.fft.fftfreq(_BLOCK_PX), np.fft.rfftfreq(_BLOCK_PX), indexing="ij")
    u, v = u.ravel(), v.ravel()
    frequency = np.hypot(u, v)
    around = (frequency > 0.5 / _LONGEST_PX) & (frequency < 0.45)
    sought = (frequency >= 1.0 / _LONGEST_PX) & (frequency <= 1.0 / _SHORTEST_PX)
    # the other half plane is the same, mirrored
    weight = np.where(u > 0, 2.0, 1.0) * around
    lattice = tuple(slice(0, length - _BLOCK_PX + 1, step) for length in fields.shape[:2])
    side = (_BLOCK_PX, _BLOCK_PX)
    corner = (0, 0)
    tilts = cv2.blur(fields[..., :2], side, anchor=corner)[lattice]
    whole = cv2.erode(fields[..., 2], np.ones(side, np.uint8), anchor=corner)[lattice] >= 0.99
    # cosine of the slant up to which blocks are used
    usable = whole & (1.0 / np.sqrt(1.0 + (tilts * tilts).sum(axis=-1)) >= 0.7)
    periods = []
    for row, column in np.argwhere(usable):
        tilt, (top, left) = tilts[row, column], (row * step, column * step)
        block = (fields[top : top + _BLOCK_PX, left : left + _BLOCK_PX, :2] - tilt) * window
        waves = np.abs(np.fft.rfft2(block, axes=(0, 1)))
        power = (waves**2).sum(axis=-1).ravel() * weight
        peak = int(np.argmax(power * sought))
        apart = [(u - s * u[peak]) ** 2 + (v - s * v[peak]) ** 2 for s in (1, -1)]
        near = power * (np.minimum(*apart) < (2.5 / _BLOCK_PX) ** 2)
        held = near.sum()
        mean = (near @ frequency) / max(held, 1e-30)
        # one wave of ridges has at least so much of the block's power, in a period that is sought
        # here; else it is the flank of a wave that is sought in another size
        if held >= 0.4 * power.sum() and 1.0 / _LONGEST_PX <= mean <= 1.0 / _SHORTEST_PX:
            along = (u[peak] * tilt[0] - v[peak] * tilt[1]) / frequency[peak]
            periods.append(np.sqrt(1.0 + along**2) / mean)
    return np.array(periods), int(usable.sum())
