"""The thesis's matcher: masks aligned, boxes made equal in size, features of every channel, the
score (5.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import cv2
import numpy as np

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box, warp
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.settings import Checked, Limits, check_fields
from splitknit_match.matching.features import lbp_features
from splitknit_match.matching.score import dissimilarity

# The thesis's alignment of two finger masks, and how much of them overlaps.


def align_masks(database: BoolArray, query: BoolArray) -> tuple[int, float]:
    """Lay the query's mask on the database's: tip on tip (row 0), then sideways to the largest
    overlap.

    Returns the columns by which the query's box is shifted to the right against the database's, and
    the intersection over union of the two masks, (5.1). Raises BadInput if a mask is empty. The
    lateral shift is found on masks reduced to about 128 rows, then to the pixel.

    `database`, `query`: (H, W) and (h, w) bool; upright (tip at row 0), cut to their bounding
    boxes, of one scale.

    Source: the thesis, section 5.3.1, steps 1 and 2. Where the first row of a tip starts depends on
    a pixel or two; the search removes that chance.
    """
    factor = max(1, max(database.shape[0], query.shape[0]) // 128)
    start = tip_column(database) - tip_column(query)
    small_database, small_query = (
        mask[factor // 2 :: factor, factor // 2 :: factor] for mask in (database, query)
    )
    reach = max(database.shape[1], query.shape[1]) // (4 * factor) + 1
    middle = round(start / factor)
    coarse, _ = best_shift(small_database, small_query, range(middle - reach, middle + reach + 1))
    best, both = best_shift(
        database, query, range((coarse - 1) * factor, (coarse + 1) * factor + 1)
    )
    union = np.count_nonzero(database) + np.count_nonzero(query) - both
    return best, float(both / union)


def tip_column(mask: BoolArray) -> int:
    """Middle of the first row of a mask that has any pixel."""
    row = int(np.argmax(mask.any(axis=1)))
    return int(np.flatnonzero(mask[row]).mean())


def best_shift(a: BoolArray, b: BoolArray, shifts: range, middle: int = 0) -> tuple[int, int]:
    """The one of `shifts` of `b` to the right with the largest overlap, of equal ones that nearest
    to the middle; and the overlap.
    """
    rows = min(len(a), len(b))
    best, most = middle, -1
    for right in sorted(shifts, key=lambda shift: abs(shift - middle)):
        first, last = max(0, right), max(0, right, min(a.shape[1], b.shape[1] + right))
        both = int(np.count_nonzero(a[:rows, first:last] & b[:rows, first - right : last - right]))
        if both > most:
            best, most = right, both
    return best, most


def to_box(image: FloatArray, size: tuple[int, int]) -> FloatArray:
    """`image` (h, w) resampled to `size` (rows, columns): step 4 of the thesis's alignment."""
    if image.shape == size:
        return image
    method = cv2.INTER_AREA if min(image.shape) > 2 * min(size) else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size[::-1], interpolation=method), dtype=np.float32)


NORMALS = ("normal_x", "normal_y", "normal_z")
ATTRIBUTES = {
    "normals": NORMALS,
    "relief": ("relief",),
    "shape_normals": tuple(f"shape_{name}" for name in NORMALS),
}
"""What is matched, and the channels of each."""


@dataclass(frozen=True, slots=True)
class ThesisSettings(Checked):
    """How two fingers are compared."""

    gate: Annotated[float, Limits(0, 1)] = 0.9
    """Pairs whose masks overlap less (5.1) are not compared; 0 compares all."""
    attributes: tuple[str, ...] = ("normals", "relief")
    """Names in :data:`ATTRIBUTES`; the similarity is the mean of theirs."""

    def __post_init__(self) -> None:
        check_fields(self)
        unknown = [name for name in self.attributes if name not in ATTRIBUTES]
        require(
            not unknown and len(self.attributes) > 0,
            f"thesis.attributes must be of {', '.join(ATTRIBUTES)}.",
        )


DEFAULTS = ThesisSettings()


@dataclass(frozen=True, slots=True, eq=False)
class FingerImages:
    """One finger, upright and cut to the bounding box of its mask."""

    channels: Mapping[str, FloatArray]
    """(h, w) each, zero outside the mask."""
    mask: BoolArray
    """(h, w)."""
    px_per_mm: float


@dataclass(frozen=True, slots=True)
class ImageMatch:
    """How similar two fingers are by their images."""

    similarity: float
    """1 for equal fingers; below -1.7 where the thesis's matcher compared nothing."""
    distances: Mapping[str, float]
    """Of each channel (``thesis``), empty where the pair was not compared, or attribute
    (``thesis-code``)."""
    ratio: float
    """Intersection over union of the masks."""
    shift_px: int
    """Columns by which the query's box was shifted."""
    dissimilarity: Mapping[str, float] = field(default_factory=dict)
    """(5.2) of each attribute; exp(2 - ratio) where the pair was not compared; of the matcher
    ``thesis``."""
    compared: bool = True


def finger_images(
    normals: FloatArray,
    shape_normals: FloatArray,
    relief_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    *,
    input_from_upright: Array,
    upright_size: tuple[int, int],
) -> FingerImages:
    """Bring normals and relief upright and cut them to the finger.

    `normals`, `shape_normals`: (H, W, 3) of the finger's surface with and without ridges, in the
    frame of the images, turned with the picture; `relief_mm`, `mask`: (H, W); `input_from_upright`:
    (3, 3), takes (column, row, 1) of the upright frame, of `upright_size` rows and columns, to the
    input. Raises BadInput if shapes disagree, or the mask is empty.
    """
    mask = check_mask(mask, (relief_mm.shape[0], relief_mm.shape[1]))
    channels = {"relief": relief_mm}
    for prefix, vectors in (("", normals), ("shape_", shape_normals)):
        channels |= {prefix + name: vectors[..., k] for k, name in enumerate(NORMALS)}
    for name, channel in channels.items():
        known = np.where(mask & np.isfinite(channel), channel, 0.0).astype(np.float32)
        channels[name] = warp(known, input_from_upright, upright_size)
    mask = warp(mask.astype(np.float32), input_from_upright, upright_size) > 0.5
    require(mask.any(), "the mask lies outside the upright frame.")
    back = np.linalg.inv(input_from_upright[:2, :2])
    turn = back / np.sqrt(abs(np.linalg.det(back)))
    for prefix in ("", "shape_"):
        x, y = channels[f"{prefix}normal_x"], channels[f"{prefix}normal_y"]
        channels[f"{prefix}normal_x"] = (turn[0, 0] * x - turn[0, 1] * y).astype(np.float32)
        channels[f"{prefix}normal_y"] = (-turn[1, 0] * x + turn[1, 1] * y).astype(np.float32)
    box = bounding_box(mask)
    inside = mask[box]
    cut = {name: np.where(inside, channel[box], 0.0) for name, channel in channels.items()}
    return FingerImages(cut, inside, 1.0 / pitch_mm)


def check_scales(database: float, query: float) -> None:
    """Raise BadInput where two fingers differ in pixels per mm."""
    require(
        abs(database / query - 1.0) < 0.02,
        f"the fingers have {database:.1f} and {query:.1f} px/mm; the thesis's matchers need one"
        " scale.",
    )


def finger_features(images: FingerImages, settings: ThesisSettings) -> dict[str, FloatArray]:
    """Feature vector of each channel that `settings` name, for a finger of the database that is
    compared often.

    Raises BadInput if a channel is missing, or smaller than a cell. Returns (n,) float32 by
    channel, for :func:`thesis_match`.
    """
    return {
        name: lbp_features(images.channels[name], images.px_per_mm)
        for name in _needed(images, settings)
    }


def thesis_match(
    database: FingerImages,
    query: FingerImages,
    settings: ThesisSettings = DEFAULTS,
    features: Mapping[str, FloatArray] | None = None,
) -> ImageMatch:
    """Compare a query with a finger of the database, as the thesis does.

    The query is resampled to the database's box, so that the order of the two matters a little.
    Raises BadInput if the two have different scales, or one lacks a channel. The similarity is 1 -
    the mean dissimilarity (5.2): 1 for equal fingers, below -1.7 where the gate left the pair out.

    Source: the thesis, section 5.3.1, steps 1 to 8, (5.1) and (5.2). The three distances of (5.2)
    are those of the channels of one attribute; relief has one. `features`: what
    :func:`finger_features` made of the database's finger with the same settings, whose channels are
    not needed then.
    """
    check_scales(database.px_per_mm, query.px_per_mm)
    needed = _needed(query, settings)
    right, ratio = align_masks(database.mask, query.mask)
    if ratio < settings.gate or ratio <= 0.0:
        gated = float(np.exp(2.0 - ratio))  # above e: worse than any pair that is compared
        return ImageMatch(
            1.0 - gated, {}, ratio, right, dict.fromkeys(settings.attributes, gated), compared=False
        )
    features = finger_features(database, settings) if features is None else features
    box = database.mask.shape[0], database.mask.shape[1]
    distances = {}
    for name in needed:
        own = lbp_features(to_box(query.channels[name], box), database.px_per_mm)
        distances[name] = float(np.linalg.norm(features[name] - own))
    scores = {
        attribute: dissimilarity(ratio, [distances[name] for name in ATTRIBUTES[attribute]])
        for attribute in settings.attributes
    }
    return ImageMatch(1.0 - float(np.mean(list(scores.values()))), distances, ratio, right, scores)


def _needed(images: FingerImages, settings: ThesisSettings) -> list[str]:
    needed = [name for attribute in settings.attributes for name in ATTRIBUTES[attribute]]
    missing = next((name for name in needed if name not in images.channels), None)
    require(missing is None, f"a finger has no channel '{missing}'.")
    return needed
