"""Images in a few hundred numbers: robust means over cells, which dust and noise hardly touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging import linear_stack
from splitknit.model import Band, FloatArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CellSettings:
    """How an image is condensed."""

    across: int = 40
    """Cells along the image's longer side."""
    inner: int = 5
    """A cell's brightness is the median of the means of this many blocks a side."""

    def __post_init__(self) -> None:
        require(4 <= self.across <= 400, f"cells.across must be 4 to 400, but it is {self.across}.")
        require(1 <= self.inner <= 20, f"cells.inner must be 1 to 20, but it is {self.inner}.")


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The images of a band in cells."""

    pixels: Array
    """(N, 2) column and row of the cells' middles."""
    light: Array
    """(L, N) linear light."""
    shape: tuple[int, int]
    """Rows and columns of cells; N is their product."""


def cells_of(band: Band, encoding: str, settings: CellSettings | None = None) -> Cells:
    """Linear grey light of a band in cells: black level and ambient light removed, the lens's fall-off left in.

    Parameters
    ----------
    band : Band
    encoding : ``linear`` or ``srgb``
    settings : CellSettings, optional

    Returns
    -------
    Cells

    Raises
    ------
    BadInput
        If the images are too small for the cells.
    """
    chosen = settings or CellSettings()
    size = band.pixels.shape[1:3]
    require(
        min(size) >= 16 and max(size) >= chosen.across,
        f"the images have {size[0]} x {size[1]} pixels, too few for a calibration; use at least {chosen.across}.",
    )
    binning = max(1, round(max(size) / (chosen.across * chosen.inner)))
    stack = linear_stack(band, encoding, "grey", binning=binning)
    inner = min(chosen.inner, max(1, max(size) // (binning * chosen.across)))
    light = median_blocks(stack, inner)
    rows, columns = light.shape[1:]
    side = binning * inner
    row, column = np.mgrid[:rows, :columns] * side + (side - 1) / 2
    return Cells(np.stack([column.ravel(), row.ravel()], axis=1), light.reshape(len(light), -1), (rows, columns))


def median_blocks(stack: FloatArray, side: int) -> Array:
    """Median (L, H // side, W // side) over blocks of `side` x `side`; what fills no block is dropped."""
    count, height, width = stack.shape
    rows, columns = height // side, width // side
    trimmed = stack[:, : rows * side, : columns * side].reshape(count, rows, side, columns, side)
    return np.median(trimmed.transpose(0, 1, 3, 2, 4).reshape(count, rows, columns, -1), axis=-1).astype(np.float64)
