"""The thesis's matcher: masks aligned, boxes made equal in size, features of every channel, the score (5.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.imaging.geometry import warp
from splitknit.matching.features import (
    LbpSettings,
    gabor_features,
    hog_features,
    lbp_features,
    shape_context_features,
    uniform_bins,
)
from splitknit.matching.score import dissimilarity, dissimilarity_of_gated, similarity_of
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits, check_fields

# The thesis's alignment of two finger masks, and how much of them overlaps.


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
    start = _tip_column(database) - _tip_column(query)
    small_database, small_query = _reduced(database, factor), _reduced(query, factor)
    reach = max(database.shape[1], query.shape[1]) // (4 * factor) + 1
    middle = round(start / factor)
    coarse = max(
        range(middle - reach, middle + reach + 1),
        key=lambda shift: (_overlap(small_database, small_query, shift), -abs(shift)),
    )
    shifts = [coarse * factor + step for step in range(-factor, factor + 1)]
    best = max(shifts, key=lambda shift: (_overlap(database, query, shift), -abs(shift)))
    return MaskAlignment(best, _intersection_over_union(database, query, best))


def _tip_column(mask: BoolArray) -> int:
    """Middle of the first row of a mask that has any pixel."""
    row = int(np.argmax(mask.any(axis=1)))
    return int(np.flatnonzero(mask[row]).mean())


def _intersection_over_union(database: BoolArray, query: BoolArray, right: int = 0) -> float:
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


NORMALS = ("normal_x", "normal_y", "normal_z")
ATTRIBUTES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"normals": NORMALS, "relief": ("relief",), "shape_normals": tuple(f"shape_{name}" for name in NORMALS)}
)
"""What is matched, and the channels of each."""


@dataclass(frozen=True, slots=True)
class ThesisSettings(Checked):
    """How two fingers are compared."""

    gate: Annotated[float, Limits(0, 1)] = 0.9
    """Pairs whose masks overlap less (5.1) are not compared; 0 compares all."""
    feature: Literal["lbp", "hog", "gabor", "shape_context"] = "lbp"
    """``lbp``, ``hog``, ``gabor`` or ``shape_context``."""
    attributes: tuple[str, ...] = ("normals", "relief")
    """Names in :data:`ATTRIBUTES`; the similarity is the mean of theirs."""
    lbp: LbpSettings = field(default_factory=LbpSettings)

    def __post_init__(self) -> None:
        check_fields(self)
        unknown = [name for name in self.attributes if name not in ATTRIBUTES]
        require(not unknown and len(self.attributes) > 0, f"thesis.attributes must be of {', '.join(ATTRIBUTES)}.")


@dataclass(frozen=True, slots=True, eq=False)
class FingerImages:
    """One finger, upright and cut to the bounding box of its mask."""

    channels: Mapping[str, FloatArray]
    """(h, w) each, zero outside the mask."""
    mask: BoolArray
    """(h, w)."""
    px_per_mm: float


@dataclass(frozen=True, slots=True)
class ThesisMatch:
    """The thesis's scores, and the library's."""

    similarity: float
    """1 - the mean dissimilarity of the attributes: 1 for equal fingers, below -1.7 where nothing was compared."""
    dissimilarity: Mapping[str, float]
    """(5.2) of each attribute; exp(2 - ratio) where the pair was not compared."""
    distances: Mapping[str, float]
    """Euclidean distance of each channel; empty where the pair was not compared."""
    ratio: float
    """Intersection over union of the masks."""
    shift_px: int
    """Columns by which the query's box was shifted."""
    compared: bool


def finger_images(  # noqa: PLR0917
    normals: FloatArray,
    ridge_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    input_from_upright: NDArray[np.float64] | None = None,
    upright_size: tuple[int, int] | None = None,
    shape_normals: FloatArray | None = None,
) -> FingerImages:
    """Bring normals and relief upright and cut them to the finger.

    Parameters
    ----------
    normals : (H, W, 3) float32
        Of the fingerprint's surface, in the frame of the images; they turn with the picture.
    ridge_mm : (H, W) float32
        Ridge-valley relief.
    mask : (H, W) bool
    pitch_mm : float
        Side of a pixel.
    input_from_upright : (3, 3), optional
        Takes (column, row, 1) of the upright frame to the input; the input is upright where it is missing.
    upright_size : (rows, columns) of the upright frame, optional
    shape_normals : (H, W, 3) float32, optional
        Of the finger without ridges.

    Raises
    ------
    BadInput
        If shapes disagree, the mask is empty, or the pitch is not positive.
    """
    require(bool(np.isfinite(pitch_mm)) and pitch_mm > 0, f"pitch_mm must be a positive number, but it is {pitch_mm}.")
    require(ridge_mm.ndim == 2, f"ridge_mm must have the shape (H, W), but it has {ridge_mm.shape}.")
    mask = check_mask(mask, (ridge_mm.shape[0], ridge_mm.shape[1]))
    channels = {"relief": ridge_mm}
    for prefix, field_of in (("", normals), ("shape_", shape_normals)):
        if field_of is not None:
            require(
                field_of.shape == (*mask.shape, 3),
                f"normals must have the shape {(*mask.shape, 3)}, but have {field_of.shape}.",
            )
            channels |= {prefix + name: field_of[..., k] for k, name in enumerate(NORMALS)}
    cleaned = {
        name: np.where(mask & np.isfinite(channel), channel, np.float32(0.0)).astype(np.float32)
        for name, channel in channels.items()
    }
    if input_from_upright is not None:
        size = mask.shape if upright_size is None else upright_size
        matrix = np.asarray(input_from_upright, dtype=np.float64)
        mask = warp(mask.astype(np.float32), matrix, (size[0], size[1])) > 0.5
        require(bool(mask.any()), "the mask lies outside the upright frame.")
        cleaned = {name: warp(channel, matrix, (size[0], size[1])) for name, channel in cleaned.items()}
        back = np.linalg.inv(matrix[:2, :2])
        turn = back / np.sqrt(abs(np.linalg.det(back)))
        for prefix in ("", "shape_"):
            if prefix + "normal_x" in cleaned:
                x, y = cleaned[prefix + "normal_x"], cleaned[prefix + "normal_y"]
                cleaned[prefix + "normal_x"] = (turn[0, 0] * x - turn[0, 1] * y).astype(np.float32)
                cleaned[prefix + "normal_y"] = (-turn[1, 0] * x + turn[1, 1] * y).astype(np.float32)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    inside = mask[box]
    return FingerImages(
        {name: np.where(inside, channel[box], np.float32(0.0)) for name, channel in cleaned.items()},
        inside,
        1.0 / pitch_mm,
    )


def finger_features(images: FingerImages, settings: ThesisSettings | None = None) -> dict[str, NDArray[np.float32]]:
    """Feature vector of each channel that `settings` name, for a finger of the database that is compared often.

    Parameters
    ----------
    images : FingerImages
    settings : ThesisSettings, optional

    Returns
    -------
    Channel to (n,) float32, for :func:`thesis_match`.

    Raises
    ------
    BadInput
        If a channel is missing, or smaller than a cell.
    """
    settings = settings or ThesisSettings()
    extract = _extractor(settings, images.px_per_mm)
    return {name: extract(images.channels[name]) for name in _needed(images, settings)}


def thesis_match(
    database: FingerImages,
    query: FingerImages,
    settings: ThesisSettings | None = None,
    features: Mapping[str, NDArray[np.float32]] | None = None,
) -> ThesisMatch:
    """Compare a query with a finger of the database, as the thesis does.

    The query is resampled to the database's box, so that the order of the two matters a little.

    Parameters
    ----------
    database, query : FingerImages
        Of one scale (pixels per mm).
    settings : ThesisSettings, optional
    features : of the database's finger by channel, optional
        What :func:`finger_features` made with the same settings.

    Returns
    -------
    ThesisMatch
        The similarity, 1 - the mean dissimilarity (5.2): 1 for equal fingers, below -1.7 where the gate
        left the pair out.

    Raises
    ------
    BadInput
        If the two have different scales, or one lacks a channel.

    References
    ----------
    The thesis, section 5.3.1, steps 1 to 8, (5.1) and (5.2). The three distances of (5.2) are those of the channels of
    one attribute; relief has one.
    """
    settings = settings or ThesisSettings()
    require(
        abs(database.px_per_mm / query.px_per_mm - 1.0) < 0.02,
        f"the fingers have {database.px_per_mm:.1f} and {query.px_per_mm:.1f} px/mm; the thesis's matcher needs one "
        "scale.",
    )
    _needed(database, settings)
    needed = _needed(query, settings)
    laid = align_masks(database.mask, query.mask)
    if laid.ratio < settings.gate or laid.ratio <= 0.0:
        gated = dissimilarity_of_gated(laid.ratio)
        return ThesisMatch(
            similarity_of(gated), dict.fromkeys(settings.attributes, gated), {}, laid.ratio, laid.right, False
        )
    distances = {}
    extract = _extractor(settings, database.px_per_mm)
    for name in needed:
        channel = to_box(query.channels[name], (database.mask.shape[0], database.mask.shape[1]))
        known = extract(database.channels[name]) if features is None else features[name]
        distances[name] = float(np.linalg.norm(known - extract(channel)))
    scores = {
        attribute: dissimilarity(laid.ratio, [distances[name] for name in ATTRIBUTES[attribute]])
        for attribute in settings.attributes
    }
    mean = float(np.mean(list(scores.values())))
    return ThesisMatch(similarity_of(mean), scores, distances, laid.ratio, laid.right, True)


def _needed(images: FingerImages, settings: ThesisSettings) -> list[str]:
    needed = [name for attribute in settings.attributes for name in ATTRIBUTES[attribute]]
    missing = [name for name in needed if name not in images.channels]
    require(not missing, f"a finger has no channel '{missing[0] if missing else ''}'.")
    return needed


def _extractor(settings: ThesisSettings, px_per_mm: float) -> Callable[[FloatArray], NDArray[np.float32]]:
    if settings.feature == "lbp":
        return lambda image: lbp_features(image, px_per_mm, settings.lbp)
    others = {"hog": hog_features, "gabor": gabor_features, "shape_context": shape_context_features}
    return lambda image: others[settings.feature](image, px_per_mm)


# The thesis's matcher for many pairs: what :func:`splitknit.matching.thesis.thesis_match` gives, to the last bit,
# sooner.
#
# The features of the database's finger are kept without its images, and local binary patterns are counted for all cells
# of a channel at once.


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
    return DatabaseFinger(_features_of(images, settings), images.mask, images.px_per_mm)


def match_database(database: DatabaseFinger, query: FingerImages, settings: ThesisSettings) -> ThesisMatch:
    """Compare a query with a finger of the database; equal to ``thesis_match`` with the same settings.

    Raises
    ------
    BadInput
        If the two have different scales, or one lacks a channel.
    """
    require(
        abs(database.px_per_mm / query.px_per_mm - 1.0) < 0.02,
        f"the fingers have {database.px_per_mm:.1f} and {query.px_per_mm:.1f} px/mm; the thesis's matcher needs one "
        "scale.",
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
    found = _features_of(FingerImages(channels, database.mask, database.px_per_mm), settings)
    distances = {name: float(np.linalg.norm(database.features[name] - found[name])) for name in needed}
    scores = {
        attribute: dissimilarity(laid.ratio, [distances[name] for name in ATTRIBUTES[attribute]])
        for attribute in settings.attributes
    }
    mean = float(np.mean(list(scores.values())))
    return ThesisMatch(similarity_of(mean), scores, distances, laid.ratio, laid.right, True)


def _features_of(images: FingerImages, settings: ThesisSettings) -> dict[str, NDArray[np.float32]]:
    """What ``finger_features`` gives."""
    if settings.feature != "lbp" or settings.lbp.interpolation != "linear":
        return finger_features(images, settings)
    needed = [name for attribute in settings.attributes for name in ATTRIBUTES[attribute]]
    missing = [name for name in needed if name not in images.channels]
    require(not missing, f"a finger has no channel '{missing[0] if missing else ''}'.")
    return {name: _quick_lbp_features(images.channels[name], images.px_per_mm, settings.lbp) for name in needed}


def _quick_lbp_features(image: FloatArray, px_per_mm: float, settings: LbpSettings) -> NDArray[np.float32]:
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
