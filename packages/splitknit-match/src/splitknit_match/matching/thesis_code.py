"""The matcher that the thesis's author ran (``thesis-code``), where his program differs from his
text.

By the facts of his public MATLAB program (ICVGIP 2022, DOI 10.1145/3571600.3571618); no code of it
is here. What the differences change: docs/experiments/authors-program.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit_match.matching.features import REFERENCE_PX_PER_MM, cells, uniform_bins
from splitknit_match.matching.thesis import (
    ATTRIBUTES,
    FingerImages,
    ImageMatch,
    best_shift,
    check_scales,
    tip_column,
)

NEIGHBOURS = {"normals": 15, "relief": 15, "shape_normals": 4}
"""Pixels around the circle of a local binary pattern, of radius one pixel."""
CELL_PX = 32
"""Side of a cell at 75.7 px/mm. Source: the author's program."""
REACH_PX = 100
"""Largest lateral shift at 75.7 px/mm. Source: the author's program."""
STEP_PX = 5
"""Step of the lateral shift at 75.7 px/mm. Source: the author's program."""

Labels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class CodeSide:
    """One finger, ready: (h, w) labels of the uniform patterns by channel, and its mask."""

    labels: Mapping[str, Labels]
    mask: BoolArray
    px_per_mm: float


def code_side(images: FingerImages) -> CodeSide:
    """Label the patterns of a finger's channels, for :func:`code_match`."""
    labels = {
        name: pattern_labels(images.channels[name], NEIGHBOURS[attribute])
        for attribute, names in ATTRIBUTES.items()
        for name in names
        if name in images.channels
    }
    return CodeSide(labels, images.mask, images.px_per_mm)


def pattern_labels(image: FloatArray, neighbours: int) -> Labels:
    """Labels (H, W) of the uniform local binary patterns of `neighbours` pixels at radius 1,
    bilinear, not turned.

    Patterns with at most two changes around the circle have labels of their own, all others share
    the last one: n (n - 1) + 3 labels. Pixels beyond the border repeat its edge. Source: Ojala,
    Pietikainen and Maenpaa 2002, section 2.1.
    """
    padded = np.pad(image, 2, mode="edge")
    rows, columns = image.shape
    codes = np.zeros(image.shape, dtype=np.uint32)
    for k in range(neighbours):
        down, right = -np.sin(2 * np.pi * k / neighbours), np.cos(2 * np.pi * k / neighbours)
        top, left = int(np.floor(down)), int(np.floor(right))
        lower, later = down - top, right - left
        value = np.zeros(image.shape, dtype=np.float32)
        for i, j, weight in (
            (0, 0, (1 - lower) * (1 - later)), (0, 1, (1 - lower) * later),
            (1, 0, lower * (1 - later)), (1, 1, lower * later),
        ):  # fmt: skip
            corner = padded[2 + top + i :, 2 + left + j :][:rows, :columns]
            value += np.float32(weight) * corner
        codes |= (value >= image).astype(np.uint32) << np.uint32(k)
    return uniform_bins(neighbours)[codes]


def code_match(database: CodeSide, query: CodeSide) -> ImageMatch:
    """Compare a query with a finger of the database, as the author's program does.

    The tips are laid on each other, then the query is moved sideways to the largest overlap of the
    masks; it is neither turned nor brought to the database's size. Histograms are counts; the score
    of an attribute is 1 - the mean over its channels of the L1 distance, divided by the number of
    features: 1 for the same images, negative even for two captures of one finger; there is no gate.
    Raises BadInput if the scales differ, a mask is smaller than a cell, or one side lacks a channel
    of the other.
    """
    scale = database.px_per_mm / REFERENCE_PX_PER_MM
    check_scales(database.px_per_mm, query.px_per_mm)
    missing = set(database.labels) ^ set(query.labels)
    require(not missing, f"one finger has no channel '{min(missing, default='')}'.")
    cell, rows, columns = cells(database.mask, database.px_per_mm, CELL_PX)
    tip = tip_column(database.mask) - tip_column(query.mask)
    reach, step = round(REACH_PX * scale), max(1, round(STEP_PX * scale))
    shifts = range(tip - reach, tip + reach + 1, step)
    shift, both = best_shift(database.mask, query.mask, shifts, tip)
    union = np.count_nonzero(database.mask) + np.count_nonzero(query.mask) - both
    area = (CELL_PX / cell) ** 2  # counts as at 75.7 px/mm
    distances = {}
    for attribute, names in ATTRIBUTES.items():
        neighbours = NEIGHBOURS[attribute]
        bins = neighbours * (neighbours - 1) + 3
        channels = [
            np.abs(
                _counts(database.labels[name], 0, cell, (rows, columns), bins)
                - _counts(query.labels[name], shift, cell, (rows, columns), bins)
            ).mean()
            for name in names
            if name in database.labels
        ]
        if channels:
            distances[attribute] = float(area * np.mean(channels))
    similarity = float(np.mean([1.0 - distance for distance in distances.values()]))
    return ImageMatch(similarity, distances, both / union, shift)


def _counts(
    labels: Labels, right: int, cell: int, cells: tuple[int, int], bins: int
) -> NDArray[np.int64]:
    """(cells, bins) how often each label occurs, after a shift by `right` columns; nothing is the
    flat pattern."""
    rows, columns = cells[0] * cell, cells[1] * cell
    # all bits set: neighbours as large as the pixel
    laid = np.full((rows, columns), bins - 2, dtype=np.int64)
    first, last = max(0, right), min(columns, labels.shape[1] + right)
    height = min(rows, labels.shape[0])
    if last > first:
        laid[:height, first:last] = labels[:height, first - right : last - right]
    laid += bins * (
        np.arange(rows)[:, None] // cell * cells[1] + np.arange(columns)[None, :] // cell
    )
    return np.bincount(laid.ravel(), minlength=bins * cells[0] * cells[1])
