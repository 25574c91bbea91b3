"""The thesis's matcher for many pairs: what :func:`splitknit.matching.thesis_match` gives, to the last bit, sooner.

The features of the database's finger are kept without its images, and local binary patterns are counted for all cells
of a channel at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.matching.align import align_masks, to_box
from splitknit.matching.lbp import LbpSettings, uniform_bins
from splitknit.matching.score import dissimilarity, dissimilarity_of_gated, similarity_of
from splitknit.matching.thesis import ATTRIBUTES, FingerImages, ThesisMatch, ThesisSettings, finger_features
from splitknit.model import BoolArray, FloatArray

_STRIP = 128
_UNIFORM = uniform_bins()


@dataclass(frozen=True, slots=True, eq=False)
class DatabaseFinger:
    """A finger of the database without its images; 1 MB at 30 px/mm with all attributes."""

    features: Mapping[str, NDArray[np.float32]]
    mask: BoolArray
    px_per_mm: float


def database_finger(images: FingerImages, settings: ThesisSettings) -> DatabaseFinger:
    """Keep of a finger what comparisons with it need."""
    return DatabaseFinger(features_of(images, settings), images.mask, images.px_per_mm)


def match_database(database: DatabaseFinger, query: FingerImages, settings: ThesisSettings) -> ThesisMatch:
    """Compare a query with a finger of the database; equal to ``thesis_match`` with the same settings.

    Raises
    ------
    BadInput
        If the two have different scales, or one lacks a channel.
    """
    require(
        abs(database.px_per_mm / query.px_per_mm - 1.0) < 0.02,
        f"the fingers have {database.px_per_mm:.1f} and {query.px_per_mm:.1f} px/mm; the thesis's matcher needs both "
        "alike.",
    )
    laid = align_masks(database.mask, query.mask)
    if laid.ratio < settings.gate or laid.ratio <= 0.0:
        gated = dissimilarity_of_gated(laid.ratio)
        return ThesisMatch(
            similarity_of(gated), dict.fromkeys(settings.attributes, gated), {}, laid.ratio, laid.right, False
        )
    box = database.mask.shape[0], database.mask.shape[1]
    needed = [name for attribute in settings.attributes for name in ATTRIBUTES[attribute]]
    require(all(name in query.channels for name in needed), "the query lacks a channel.")
    channels = {name: to_box(query.channels[name], box) for name in needed}
    found = features_of(FingerImages(channels, database.mask, database.px_per_mm), settings)
    distances = {name: float(np.linalg.norm(database.features[name] - found[name])) for name in needed}
    scores = {
        attribute: dissimilarity(laid.ratio, [distances[name] for name in ATTRIBUTES[attribute]])
        for attribute in settings.attributes
    }
    mean = float(np.mean(list(scores.values())))
    return ThesisMatch(similarity_of(mean), scores, distances, laid.ratio, laid.right, True)


def features_of(images: FingerImages, settings: ThesisSettings) -> dict[str, NDArray[np.float32]]:
    """What ``finger_features`` gives."""
    if settings.feature != "lbp" or settings.lbp.interpolation != "linear":
        return finger_features(images, settings)
    needed = [name for attribute in settings.attributes for name in ATTRIBUTES[attribute]]
    missing = [name for name in needed if name not in images.channels]
    require(not missing, f"a finger has no channel '{missing[0] if missing else ''}'.")
    return {name: quick_lbp_features(images.channels[name], images.px_per_mm, settings.lbp) for name in needed}


def quick_lbp_features(image: FloatArray, px_per_mm: float, settings: LbpSettings) -> NDArray[np.float32]:
    """Feature vector of a finite channel (H, W), as ``lbp_features`` with linear interpolation gives it."""
    cell = settings.cell(px_per_mm)
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    require(rows > 0 and columns > 0, f"the image of {image.shape} pixels is smaller than a cell of {cell} pixels.")
    codes = _codes(np.ascontiguousarray(image, dtype=np.float32), settings.radius(px_per_mm))
    codes = np.ascontiguousarray(codes[: rows * cell, : columns * cell])
    bins = 59 if settings.uniform else 256
    if settings.uniform:
        codes = np.asarray(cv2.LUT(codes, _UNIFORM))
    number = _first_bins(rows, columns, cell, bins) + codes
    counts = np.bincount(number.ravel(), minlength=rows * columns * bins).astype(np.float32)
    result = counts.reshape(rows, columns, bins)
    if settings.normalisation == "l2":
        result /= np.sqrt((result * result).sum(axis=2, keepdims=True))
    elif settings.normalisation == "l1":
        result /= result.sum(axis=2, keepdims=True)
    return result.ravel()


@lru_cache(maxsize=4)
def _first_bins(rows: int, columns: int, cell: int, bins: int) -> NDArray[np.int64]:
    """First bin (rows * cell, columns * cell) of each pixel's cell."""
    down, across = np.arange(rows * cell) // cell * columns, np.arange(columns * cell) // cell
    return (down[:, None] + across[None, :]) * bins


def _codes(image: FloatArray, radius: float) -> NDArray[np.uint8]:
    """Patterns (H, W): the sums of ``lbp_codes`` in the same order, in larger strips, with fewer passes."""
    diagonal = radius * float(np.sqrt(0.5))
    border = int(np.ceil(radius)) + 1
    border_of = cv2.copyMakeBorder(image, border, border, border, border, cv2.BORDER_REPLICATE)
    padded = np.asarray(border_of, dtype=np.float32)
    height, width = image.shape
    codes = np.empty((height, width), dtype=np.uint8)
    reached = np.empty((min(_STRIP, height), width), dtype=np.bool_)
    for top in range(0, height, _STRIP):
        rows = min(_STRIP, height - top)
        strip = padded[top : top + rows + 2 * border]
        inner = strip[border:-border]
        centre = inner[:, border:-border]
        right, left = _mixed(strip, diagonal, border, 1), _mixed(strip, -diagonal, border, 1)
        middle = strip[:, border:-border]
        # from the highest bit to the lowest: each pass doubles what is there
        neighbours = (
            _mixed(right, diagonal, border, 0),
            _mixed(middle, radius, border, 0),
            _mixed(left, diagonal, border, 0),
            _mixed(inner, -radius, border, 1),
            _mixed(left, -diagonal, border, 0),
            _mixed(middle, -radius, border, 0),
            _mixed(right, -diagonal, border, 0),
            _mixed(inner, radius, border, 1),
        )
        code, bit = codes[top : top + rows], reached[:rows]
        np.greater_equal(neighbours[0], centre, out=code.view(np.bool_))
        for neighbour in neighbours[1:]:
            np.greater_equal(neighbour, centre, out=bit)
            np.add(code, code, out=code)
            np.add(code, bit.view(np.uint8), out=code)
    return codes


def _mixed(strip: FloatArray, shift: float, border: int, axis: int) -> FloatArray:
    """The strip without its borders along `axis`, seen from places `shift` pixels further along it, linear."""
    first = int(np.floor(shift + 1e-9))
    part = shift - first
    length = strip.shape[axis] - 2 * border

    def cut(start: int) -> FloatArray:
        along = slice(start, start + length)
        return strip[along] if axis == 0 else strip[:, along]

    if part <= 1e-9:
        return cut(border + first)
    return np.asarray(cv2.addWeighted(cut(border + first), 1.0 - part, cut(border + first + 1), part, 0.0))
