"""Checkerboards as a projector throws them, for tests of the separation of light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray


def checkerboard_patterns(size: tuple[int, int], check_px: float, shifts_px: Any) -> FloatArray:
    """States (N, H, W) in [0, 1] of a checkerboard along the camera's rows and columns, moved by
    (N, 2) `shifts_px`.

    Values are lit fractions of the pixel's area, so that shifts and checks (of a pixel or more)
    need not be whole pixels.
    """
    require(
        bool(np.isfinite(check_px)) and check_px >= 1,
        f"check_px must be at least 1, but it is {check_px}.",
    )
    shifts = np.asarray(shifts_px, dtype=np.float64)
    good = shifts.ndim == 2 and shifts.shape[1] == 2 and bool(np.isfinite(shifts).all())
    require(good, f"shifts_px must have the shape (N, 2) and be finite, but it has {shifts.shape}.")
    rows = [_square_wave(size[0], check_px, float(shift)) for shift in shifts[:, 0]]
    columns = [_square_wave(size[1], check_px, float(shift)) for shift in shifts[:, 1]]
    waves = [row[:, None] * column[None, :] for row, column in zip(rows, columns, strict=True)]
    return np.asarray(0.5 + 0.5 * np.stack(waves), dtype=np.float32)


def _square_wave(count: int, half_period: float, shift: float) -> NDArray[np.float64]:
    """Mean over each pixel of the wave that is +1 on [0, half_period) and -1 on the next half."""
    edges = np.arange(count + 1) - shift
    phase = np.mod(edges, 2 * half_period)
    # it returns to zero after each period
    integral = np.where(phase < half_period, phase, 2 * half_period - phase)
    return np.asarray(np.diff(integral))
