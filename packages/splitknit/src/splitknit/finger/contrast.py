"""Contrast-limited adaptive histogram equalisation of float images of linear light.

At full resolution, inside the mask's bounding box. OpenCV's CLAHE has 256 grey levels on 8-bit
images (visible steps in a relief) and no usable clip limit on 16-bit ones (65,536 bins for 4,096
pixels), and it lets the black background into the histograms; so the equalisation is done here,
with mappings that are continuous in the grey value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from splitknit.checks import check_image, check_mask
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import srgb_code
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.settings import Checked, Limits

_CELL_PX = 64.0
"""Side of a cell at 75.7 px/mm. Source: thesis, section 3.3.1.3."""
_Cell = tuple[int, int]
"""Rows and columns of a cell."""


@dataclass(frozen=True, slots=True)
class ClaheSettings(Checked):
    """Adaptive equalisation."""

    grey: Literal["srgb", "linear"] = "srgb"
    """What is equalised: light in its ``srgb`` code, as pictures store it, or ``linear`` light."""
    tiles: Annotated[int, Limits(0, 512)] = 0
    """Number of cells across the finger, and along it. 0: cells of 64 x 64 pixels at 75.7 px/mm, as
    in the thesis."""
    clip_limit: Annotated[float, Limits(1)] = 3.0
    """Bins are clipped at this multiple of the mean bin (thesis: 2 to 4); contrast grows by at most
    this plus one."""
    white: Literal["skin", "camera"] = "skin"
    """What becomes white first: the brightest ``skin``, or the ``camera``'s full scale, as in the
    thesis author's program; then exposure matters."""


_HISTOGRAM_BINS = 256
"""Bins of the histograms; the mapping between them is interpolated. Chosen on: judgement. Range:
128 to 512 (validation/parameters)."""
_MIN_CELL_PX = 8
"""Smallest side of a cell. Chosen on: judgement. Range: 4 to 16 (validation/parameters)."""


def clahe(
    image: FloatArray,
    px_per_mm: float,
    settings: ClaheSettings | None = None,
    *,
    mask: BoolArray | None = None,
) -> FloatArray:
    """Equalise `image` (H, W), linear, in cells of 64 x 64 pixels (at 75.7 px/mm), or as the
    settings say, to [0, 1].

    Every cell's histogram, taken over the pixels of `mask` (H, W), all where None, is clipped, the
    excess spread evenly, and summed to a grey-value mapping; a pixel takes the bilinear mean of the
    mappings of the four cells around it. Cells with little finger in them borrow from their
    neighbours. Outside the mask the result is zero. Source: Zuiderveld, K., "Contrast limited
    adaptive histogram equalization", Graphics Gems IV, 1994; the thesis, 3.3.1.3.
    """
    from scipy.ndimage import map_coordinates  # half a second, for those who need it

    settings = settings or ClaheSettings()
    image = check_image(image)
    mask = check_mask(mask, (image.shape[0], image.shape[1]))
    box = bounding_box(mask)
    inside = mask[box]
    white = 1.0
    if settings.white == "skin":
        # this percentile of the finger becomes white before equalisation
        white = float(np.percentile(image[box][inside], 99.9))
    grey = np.clip(image[box] / max(white, 1e-12), 0.0, 1.0)
    if settings.grey == "srgb":
        grey = srgb_code(grey)
    level = grey * (_HISTOGRAM_BINS - 1)
    side = max(_MIN_CELL_PX, round(_CELL_PX * px_per_mm / 75.7))
    cell = side, side
    if settings.tiles:
        high, wide = (max(_MIN_CELL_PX, -(-size // settings.tiles)) for size in grey.shape)
        cell = high, wide
    counts = _histograms(level, inside, cell)
    mappings = _mappings(_borrow(counts, 0.25 * cell[0] * cell[1]), settings.clip_limit)
    result = np.zeros(image.shape, dtype=np.float32)
    rows, columns = np.nonzero(inside)
    places = [(rows + 0.5) / cell[0] - 0.5, (columns + 0.5) / cell[1] - 0.5, level[inside]]
    result[box][inside] = map_coordinates(mappings, places, order=1, mode="nearest")
    return result


def _histograms(level: FloatArray, inside: BoolArray, cell: _Cell) -> Array:
    """Counts (cell rows, cell columns, _HISTOGRAM_BINS) over the finger's pixels."""
    rows, columns = (-(-size // side) for size, side in zip(level.shape, cell, strict=True))
    counts = np.empty((rows, columns, _HISTOGRAM_BINS), dtype=np.float64)
    nearest = (level + 0.5).astype(np.intp)
    for i in range(rows):
        for j in range(columns):
            part = np.s_[i * cell[0] : (i + 1) * cell[0], j * cell[1] : (j + 1) * cell[1]]
            counts[i, j] = np.bincount(nearest[part][inside[part]], minlength=_HISTOGRAM_BINS)
    return counts


def _borrow(counts: Array, least: float) -> Array:
    """Add the neighbours' histograms to cells with fewer than `least` pixels, again until every
    cell has enough."""
    for _ in range(sum(counts.shape[:2])):
        poor = counts.sum(axis=2) < least
        if not poor.any() or counts.sum() == 0:
            break
        padded = np.pad(counts, ((1, 1), (1, 1), (0, 0)))
        around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), (0, 1)).sum(axis=(-2, -1))
        if (around[poor].sum(axis=1) <= counts[poor].sum(axis=1)).all():
            break
        counts = np.where(poor[..., None], around, counts)
    return counts


def _mappings(counts: Array, clip_limit: float) -> FloatArray:
    """Grey-value mappings in [0, 1], one per cell, from clipped histograms."""
    total = np.maximum(counts.sum(axis=2, keepdims=True), 1.0)
    clipped = np.minimum(counts, clip_limit * total / _HISTOGRAM_BINS)
    clipped += (total - clipped.sum(axis=2, keepdims=True)) / _HISTOGRAM_BINS
    summed = np.cumsum(clipped, axis=2)
    return np.asarray(summed / summed[..., -1:], dtype=np.float32)
