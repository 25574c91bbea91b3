"""Ridges as black and white, and as lines one pixel wide."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.model import BoolArray
from splitknit.prints.enhance import Enhanced


def ridge_mask(enhanced: Enhanced, least_px: int = 12) -> BoolArray:
    """(h, w) bool, true on ridges: where the wave is negative; specks and holes below `least_px` pixels are dropped."""
    ridges = enhanced.mask & (enhanced.wave < 0)
    ridges &= ~_small(ridges, least_px)
    return np.asarray(ridges | (_small(~ridges, least_px) & enhanced.mask))


def as_print(ridges: BoolArray) -> NDArray[np.uint8]:
    """(h, w) uint8: ridges 0, all else 255."""
    return np.where(ridges, np.uint8(0), np.uint8(255))


def thin(shape: BoolArray) -> BoolArray:
    """Thin a shape to lines one pixel wide that hang together as it does.

    Parameters
    ----------
    shape : (h, w) bool

    Raises
    ------
    BadInput
        If `shape` is not a boolean image.

    References
    ----------
    T. Zhang and C. Suen 1984, A fast parallel algorithm for thinning digital patterns. Pixels are looked up by the code
    of their eight neighbours; at the end corners of staircases are taken off, so that lines are one pixel wide.
    """
    array = np.asarray(shape)
    if array.ndim != 2 or array.dtype != np.bool_:
        raise BadInput(f"what is thinned must be a boolean image (h, w), but it is {array.shape} {array.dtype}.")
    image = np.pad(array, 1).astype(np.uint8)
    first, second, corners = _tables()
    while True:
        before = int(image.sum())
        for table in (first, second):
            image &= table[_codes(image)]
        if int(image.sum()) == before:
            break
    for table in corners:  # one after the other: neighbours of one kind never touch
        image &= table[_codes(image)]
    return image[1:-1, 1:-1] > 0


def _small(shape: BoolArray, least_px: int) -> BoolArray:
    """Pieces of `shape` of less than `least_px` pixels."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(shape.astype(np.uint8), connectivity=4)
    few = stats[:, cv2.CC_STAT_AREA] < least_px
    few[0] = False
    return np.asarray(few[labels]) if count > 1 else np.zeros_like(shape)


def _codes(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Bit k is set where neighbour k is set: north first, then clockwise (the paper's P2 to P9)."""
    code = np.zeros_like(image)
    inner = code[1:-1, 1:-1]
    h, w = image.shape
    for bit, (dy, dx) in enumerate(((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))):
        inner |= image[1 + dy : h - 1 + dy, 1 + dx : w - 1 + dx] << bit
    return code


@lru_cache(maxsize=1)
def _tables() -> tuple[NDArray[np.uint8], NDArray[np.uint8], tuple[NDArray[np.uint8], ...]]:
    """By code: 1 where the pixel stays, for both half-steps and for the four kinds of corners."""
    first, second = np.ones(256, dtype=np.uint8), np.ones(256, dtype=np.uint8)
    corners = tuple(np.ones(256, dtype=np.uint8) for _ in range(4))
    for code in range(256):
        n, ne, e, se, s, sw, w, nw = ((code >> bit) & 1 for bit in range(8))
        ring = [n, ne, e, se, s, sw, w, nw, n]
        rises = sum(1 for a, b in pairwise(ring) if (a, b) == (0, 1))
        if 2 <= sum(ring[:-1]) <= 6 and rises == 1:
            if n * e * s == 0 and e * s * w == 0:
                first[code] = 0
            if n * e * w == 0 and n * s * w == 0:
                second[code] = 0
        for table, (a, b, far, side_a, side_b) in zip(
            corners,
            ((n, e, sw, nw, se), (e, s, nw, ne, sw), (s, w, ne, se, nw), (w, n, se, sw, ne)),
            strict=True,
        ):
            # two neighbours that touch each other diagonally: the pixel between them is not needed
            if a and b and n + e + s + w == 2 and not (far or side_a or side_b):
                table[code] = 0
    return first, second, corners
