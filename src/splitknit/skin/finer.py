"""Images of a coarse camera on a grid twice as fine, where the networks of relief and shape can read them.

The networks have learned pixels of 17 to 41 um. A camera of 12 to 25 pixels a millimetre shows ridges well enough (6 to
11 pixels a period), in pixels that are too large for them; interpolated to half the pitch they are read as others are.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray
from splitknit.skin.grid import BandImages, Grid

FACTOR = 2


def finer_grid(grid: Grid) -> Grid:
    """The grid with each of its pixels divided into 2 x 2."""
    mask = np.repeat(np.repeat(grid.mask, FACTOR, axis=0), FACTOR, axis=1)
    x, y = grid.x_mm, grid.y_mm
    if x.ndim == 2:  # the rays of a perspective camera
        x, y = (_halved(_halved(axis, 0), 1) for axis in (x, y))
    else:
        x, y = _halved(x, 0), _halved(y, 0)
    return Grid(mask, x, y, grid.pitch_mm / FACTOR, grid.cut, grid.apex_mm)


def finer_images(band: BandImages) -> BandImages:
    """Images of a band on :func:`finer_grid`, bicubic."""
    channels, lights, height, width = band.stack.shape
    fine = np.empty((channels, lights, height * FACTOR, width * FACTOR), dtype=np.float32)
    size = (width * FACTOR, height * FACTOR)
    for c in range(channels):
        for k in range(lights):
            cv2.resize(band.stack[c, k], size, dst=fine[c, k], interpolation=cv2.INTER_CUBIC)
    return BandImages(band.channels, fine, band.rig)


def coarser(field: FloatArray) -> FloatArray:
    """Mean (h, w) of the 2 x 2 pixels of each pixel of the grid as it was; NaN where one of them is."""
    height, width = field.shape[0] // FACTOR, field.shape[1] // FACTOR
    blocks = field.reshape(height, FACTOR, width, FACTOR)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64), dtype=np.float32)


def _halved(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Values at the middles of both halves of each pixel along `axis`, straight between their neighbours."""
    if values.shape[axis] < 2:
        return np.repeat(values, FACTOR, axis=axis)
    quarter = np.gradient(values, axis=axis) / 4
    both = np.stack([values - quarter, values + quarter], axis=axis + 1)
    shape = list(values.shape)
    shape[axis] *= FACTOR
    return np.asarray(both.reshape(shape), dtype=np.float64)
