"""The thesis's alignment of two finger masks, and how much of them overlaps."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class MaskAlignment:
    """Where the query's mask is put on the database's, both upright and cut to their bounding boxes."""

    right: int
    """Columns by which the query's box is shifted against the database's; the tips share row 0."""
    ratio: float
    """Intersection over union of the two masks, (5.1)."""


def align_masks(database: BoolArray, query: BoolArray) -> MaskAlignment:
    """Lay the query's mask on the database's: tip on tip, then sideways to the largest overlap.

    Parameters
    ----------
    database, query : (H, W) and (h, w) bool
        Upright (tip at row 0), cut to their bounding boxes, of one scale.

    Returns
    -------
    MaskAlignment
        The lateral shift is found on masks reduced to about 128 rows, then to the pixel.

    Raises
    ------
    BadInput
        If a mask is empty.

    References
    ----------
    The thesis, section 5.3.1, steps 1 and 2. Where the first row of a tip starts depends on a pixel or two; the search
    removes that chance.
    """
    require(bool(database.any()) and bool(query.any()), "a mask is empty: not one pixel belongs to the finger.")
    factor = max(1, max(database.shape[0], query.shape[0]) // 128)
    start = tip_column(database) - tip_column(query)
    small_database, small_query = _reduced(database, factor), _reduced(query, factor)
    reach = max(database.shape[1], query.shape[1]) // (4 * factor) + 1
    middle = round(start / factor)
    coarse = max(
        range(middle - reach, middle + reach + 1),
        key=lambda shift: (_overlap(small_database, small_query, shift), -abs(shift)),
    )
    shifts = [coarse * factor + step for step in range(-factor, factor + 1)]
    best = max(shifts, key=lambda shift: (_overlap(database, query, shift), -abs(shift)))
    return MaskAlignment(best, intersection_over_union(database, query, best))


def tip_column(mask: BoolArray) -> int:
    """Middle of the first row of a mask that has any pixel."""
    row = int(np.argmax(mask.any(axis=1)))
    return int(np.flatnonzero(mask[row]).mean())


def intersection_over_union(database: BoolArray, query: BoolArray, right: int = 0) -> float:
    """(5.1) of two masks whose first rows and, after `right` columns, first columns coincide."""
    both = _overlap(database, query, right)
    union = np.count_nonzero(database) + np.count_nonzero(query) - both
    return float(both / union) if union else 0.0


def _overlap(a: BoolArray, b: BoolArray, right: int) -> int:
    rows = min(a.shape[0], b.shape[0])
    first, last = max(0, right), min(a.shape[1], b.shape[1] + right)
    if last <= first:
        return 0
    return int(np.count_nonzero(a[:rows, first:last] & b[:rows, first - right : last - right]))


def _reduced(mask: BoolArray, factor: int) -> BoolArray:
    return mask[factor // 2 :: factor, factor // 2 :: factor] if factor > 1 else mask


def to_box(image: FloatArray, size: tuple[int, int]) -> FloatArray:
    """`image` (h, w) resampled to `size` (rows, columns): step 4 of the thesis's alignment."""
    if image.shape == size:
        return image
    smaller = size[0] < image.shape[0] or size[1] < image.shape[1]
    method = cv2.INTER_AREA if smaller and min(image.shape) > 2 * min(size) else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size[::-1], interpolation=method), dtype=np.float32)
