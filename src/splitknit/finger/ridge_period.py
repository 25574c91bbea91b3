"""How many pixels lie between the ridges, at any scale: the ruler that a finger carries."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.model import BoolArray, FloatArray
from splitknit.plausible import RIDGE_PERIOD

PEOPLE = 0.08
"""Standard deviation of the ridge distance between fingers, relative: sexes, people and digits, as the simulator's
population has them (Cummins, Waits and McQuitty, Am. J. Anat. 68, 1941: 20.7 ridges a centimetre in men, 23.4 in
women)."""
_BLOCK, _STEP = 64, 16
"""Side of a block of the reduced picture, and the distance of the blocks, pixels."""
_SHORTEST, _LONGEST = 4.0, 10.0
"""Periods that are sought in a reduced picture, pixels; the next picture has half the size."""
_LEVELS = 6
_FACING = 0.7
"""Cosine of the slant up to which blocks are used."""
_CONCENTRATED = 0.4
"""Part of a block's power, of all periods around, that one wave of ridges has at least."""
_MIN_BLOCKS, _MIN_FRACTION = 6, 0.25
"""Blocks with one wave: that many, and that part of all. On simulated fingers and a sculpted one 0.6 to 0.8 of them
have one, on DiLiGenT's bear 0.08, on a ball none."""


@dataclass(frozen=True, slots=True)
class _RidgePeriod:
    """Distance of the ridges along the skin."""

    period_px: float
    """Median of the blocks."""
    error_px: float
    """Standard deviation of the median."""
    blocks: int


def ridge_period(normals: FloatArray, mask: BoolArray) -> _RidgePeriod:
    """Measure the distance of the ridges in a map of normals whose scale is unknown.

    The slopes are reduced by 1, 2, 4, ...; in blocks of 64 pixels one wave of 4 to 10 pixels must hold most of the
    power. The size in which such waves cover most of the surface counts. Periods are corrected for the surface's slant.
    `normals`: (H, W, 3) unit normals, x right, y up, z to the camera; `mask`: (H, W) bool. Raises BadInput if no ridges
    are found.

    Examples
    --------
    >>> x = np.tile(np.arange(400.0), (400, 1))
    >>> slope = 0.2 * np.cos(2 * np.pi * x / 12.0)
    >>> normals = np.stack([-slope, 0 * x, np.ones_like(x)], axis=-1).astype(np.float32)
    >>> normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    >>> round(ridge_period(normals, np.ones((400, 400), bool)).period_px, 1)
    12.0
    """
    mask = check_mask(mask, (normals.shape[0], normals.shape[1]))
    steep = np.maximum(normals[..., 2], np.float32(0.2))
    slopes = np.stack([-normals[..., 0] / steep, -normals[..., 1] / steep], axis=-1)
    fields = np.dstack([np.where(mask[..., None], slopes, np.float32(0.0)), mask.astype(np.float32)])
    best: tuple[float, NDArray[np.float64]] = (0.0, np.zeros(0))
    for level in range(_LEVELS):
        factor = 2**level
        size = (mask.shape[1] // factor, mask.shape[0] // factor)
        if min(size) < _BLOCK:
            break
        small = fields if level == 0 else cv2.resize(fields, size, interpolation=cv2.INTER_AREA)
        periods, blocks = _periods(np.asarray(small, dtype=np.float32))
        area = float(len(periods) * factor**2)
        if len(periods) >= max(_MIN_BLOCKS, _MIN_FRACTION * blocks) and area > best[0]:
            best = area, periods * factor
    periods = best[1]
    require(
        len(periods) > 0,
        "no ridges were found to take the scale from: they need 4 pixels from one to the next and good focus; give "
        "`px_per_mm`.",
    )
    middle = float(np.median(periods))
    spread = 1.4826 * float(np.median(np.abs(periods - middle)))
    apart = max(1.0, len(periods) * (_STEP / _BLOCK) ** 2)
    return _RidgePeriod(middle, 1.25 * spread / float(np.sqrt(apart)), len(periods))


def scale_of_ridges(
    normals: FloatArray, mask: BoolArray, px_per_mm: float | None, period_mm: float
) -> tuple[float, str]:
    """The scale in pixels a millimetre at which ridges lie `period_mm` apart, and how well it is known. Raises BadInput
    if `px_per_mm` gives the scale too, `period_mm` is no distance of ridges, or none are found.
    """
    require(px_per_mm is None, "`px_per_mm` and `ridge_period_mm` both give the scale; choose one.")
    odd = RIDGE_PERIOD.notes(period_mm, "check --ridge-period")
    found = ridge_period(normals, mask)
    known = float(np.hypot(found.error_px / found.period_px, PEOPLE))
    return found.period_px / period_mm, (
        f"scale from the ridges: {found.period_px:.1f} px from one to the next (standard deviation "
        f"{found.error_px:.2f}, {found.blocks} places) are {period_mm:g} mm, so {found.period_px / period_mm:.2f} "
        f"px/mm; people differ, so that it is known to {100 * known:.0f} %." + "".join(f" Also, {note}" for note in odd)
    )


def _periods(fields: FloatArray) -> tuple[NDArray[np.float64], int]:
    """Periods along the surface, in pixels, of the blocks of slopes and mask (h, w, 3) with one wave in them, and the
    number of all blocks on the surface."""
    window = np.outer(np.hanning(_BLOCK), np.hanning(_BLOCK))
    v, u = np.meshgrid(np.fft.fftfreq(_BLOCK), np.fft.fftfreq(_BLOCK), indexing="ij")
    frequency = np.hypot(u, v)
    around = (frequency > 0.5 / _LONGEST) & (frequency < 0.45)
    sought = (frequency >= 1.0 / _LONGEST) & (frequency <= 1.0 / _SHORTEST)
    periods, blocks = [], 0
    for top in range(0, fields.shape[0] - _BLOCK + 1, _STEP):
        for left in range(0, fields.shape[1] - _BLOCK + 1, _STEP):
            block = fields[top : top + _BLOCK, left : left + _BLOCK]
            if block[..., 2].min() < 0.99:
                continue
            tilt = block[..., :2].mean(axis=(0, 1)).astype(np.float64)
            if 1.0 / np.sqrt(1.0 + tilt @ tilt) < _FACING:
                continue
            blocks += 1
            waves = np.fft.fft2((block[..., :2] - tilt) * window[..., None], axes=(0, 1))
            power = (np.abs(waves) ** 2).sum(axis=2)
            row, column = np.unravel_index(int(np.argmax(np.where(sought, power, 0.0))), power.shape)
            near = around & (np.minimum(
                np.hypot(u - u[row, column], v - v[row, column]), np.hypot(u + u[row, column], v + v[row, column])
            ) < 2.5 / _BLOCK)  # fmt: skip
            if power[near].sum() < _CONCENTRATED * power[around].sum():
                continue
            mean = float((power * frequency)[near].sum() / power[near].sum())
            if not 1.0 / _LONGEST <= mean <= 1.0 / _SHORTEST:  # the flank of a wave that is sought in another size
                continue
            along = np.array([u[row, column], -v[row, column]]) / frequency[row, column]
            periods.append(np.sqrt(1.0 + float(along @ tilt) ** 2) / mean)
    return np.array(periods), blocks
