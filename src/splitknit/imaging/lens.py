"""How the lens darkens towards the corners."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray


def lens_shading(  # noqa: PLR0917
    shading: Sequence[float],
    image_size: Sequence[int],
    first_row: int = 0,
    first_column: int = 0,
    binning: int = 1,
    shape: Sequence[int] | None = None,
) -> FloatArray:
    """(h, w) brightness of the lens relative to the image's centre: 1 + a r^2 + b r^4 + ...

    Parameters
    ----------
    shading : a, b, ... of :class:`splitknit.model.Camera`
    image_size : rows, columns of the whole image; r is the distance from its centre over half its diagonal
    first_row, first_column : where the window starts
    binning : pixels a side of a block of the window
    shape : of the window in blocks; the whole image by default
    """
    rows, columns = int(image_size[0]), int(image_size[1])
    height, width = (rows // binning, columns // binning) if shape is None else (int(shape[0]), int(shape[1]))
    middle = 0.5 * (binning - 1)
    y = first_row + np.arange(height) * binning + middle - 0.5 * (rows - 1)
    x = first_column + np.arange(width) * binning + middle - 0.5 * (columns - 1)
    squared = (y[:, None] ** 2 + x[None, :] ** 2) / (0.25 * (rows**2 + columns**2))
    return shading_at(shading, squared).astype(np.float32)


def shading_at(shading: Sequence[float], squared: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 + a r^2 + b r^4 + ... at `squared` distances r^2 (any shape), see :class:`splitknit.model.Camera`."""
    brightness = np.ones_like(squared)
    for k, coefficient in enumerate(shading):
        brightness += coefficient * squared ** (k + 1)
    return brightness
