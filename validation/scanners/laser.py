"""Laser line: a plane of light that sweeps over the finger; for every pixel the time at which it
passes.

References
----------
B. Curless and M. Levoy, "Better optical triangulation through spacetime analysis", ICCV 1995; R.
Fisher and D. Naidu, "A comparison of algorithms for subpixel peak detection", 1996 (Gaussian
approximation).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from views import View, between_neighbours, cloud_of, on_planes

from splitknit.errors import require
from splitknit.model import FloatArray


def peaks(frames: Iterable[NDArray[np.floating]], least: float = 0.05) -> FloatArray:
    """Find when each pixel is brightest: a Gaussian through the brightest frame and its neighbours.

    `frames`: (H, W) linear light, 0 to 1, one after another, of which only three are held; `least`:
    smallest brightness of a peak that counts. Returns (H, W) the number of the frame, with its
    fraction; NaN where nothing passed or the peak lies at an end of the sweep. Raises BadInput if
    there are fewer than three frames.

    >>> times = np.arange(9)[:, None, None]
    >>> peaks(np.exp(-((times - 4.3) ** 2) / 2) * np.ones((9, 1, 1))).round(3).tolist()
    [[4.300000190734863]]
    """
    before: FloatArray | None = None
    middle: FloatArray | None = None
    best = at = left = right = np.zeros(0, np.float32)
    count = 0
    for frame in frames:
        after = np.asarray(frame, dtype=np.float32)
        if count == 0:
            best = np.zeros_like(after)
            at = left = right = np.full_like(after, np.nan)
        if before is not None and middle is not None:
            new = middle > best
            best, at = np.where(new, middle, best), np.where(new, np.float32(count - 1), at)
            left, right = np.where(new, before, left), np.where(new, after, right)
        before, middle, count = middle, after, count + 1
    require(count >= 3, f"a sweep needs three frames at least, but there are {count}.")
    fraction = between_neighbours(
        *(np.log(np.maximum(frame, 1e-4)) for frame in (left, best, right))
    )
    known = (best >= least) & (np.abs(fraction) <= 1.0)
    return np.where(known, at + fraction, np.nan).astype(np.float32)


def scan(camera: View, laser: View, frame: FloatArray, rows: tuple[float, float]) -> FloatArray:
    """Triangulate a sweep: frame k lit the row rows[0] + k rows[1] of the laser's scanner,
    described as a projector."""
    return cloud_of(on_planes(camera, laser, rows[0] + rows[1] * frame)[0])
