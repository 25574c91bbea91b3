"""Scores as cells in falling order, so that a replicate of the bootstrap is a weight for each cell and no sorting.

Rates depend on scores through their order alone. Up to a limit every distinct score is a cell and replicates are exact.
Beyond it, cells are cut at chosen scores: each chosen one is a cell, and so is what lies between two. GAR at FAR stays
exact between two chosen scores as long as only impostors lie there; all genuine scores are chosen if they are few
enough. Point estimates never come from cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELLS = 60_000
"""At most about so many."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Where the scores lie; cell 0 holds the highest."""

    genuine: NDArray[np.int64]
    """(N,) the cell of each; ``count`` where it is a failure."""
    impostor: NDArray[np.int64]
    """(M,)"""
    count: int
    """Cells without that of the failures."""
    crowded: NDArray[np.bool_]
    """(count,) whether a cell holds several distinct impostor scores, and no genuine one."""
    moments: NDArray[np.float64]
    """(2, 2, count): genuine, impostor; mean and variance of the standardised scores of a cell."""


def make_cells(genuine: NDArray[np.float64], impostor: NDArray[np.float64], limit: int = CELLS) -> Cells:
    """Put scores (N,) and (M,), NaN included, into cells."""
    sides = [side[~np.isnan(side)] for side in (genuine, impostor)]
    distinct = [np.unique(side) for side in sides]
    every = np.union1d(*distinct)
    edges = every if every.size <= limit else _edges(distinct, sides[1], limit)
    used, codes = np.unique(np.concatenate([_code(side, edges) for side in sides]), return_inverse=True)
    codes = used.size - 1 - codes
    parts = codes[: sides[0].size], codes[sides[0].size :]
    values = np.bincount(used.size - 1 - np.searchsorted(used, _code(distinct[1], edges)), minlength=used.size)
    crowded = (values > 1) & (np.bincount(parts[0], minlength=used.size) == 0)
    middle, scale = float(np.mean(sides[1])), float(np.ptp(every)) or 1.0
    moments = [_moments(part, (side - middle) / scale, used.size) for part, side in zip(parts, sides, strict=True)]
    placed = []
    for whole, part in zip((genuine, impostor), parts, strict=True):
        cell = np.full(whole.size, used.size, dtype=np.int64)
        cell[~np.isnan(whole)] = part
        placed.append(cell)
    return Cells(placed[0], placed[1], int(used.size), crowded, np.stack(moments))


def _edges(distinct: list[NDArray[np.float64]], impostor: NDArray[np.float64], limit: int) -> NDArray[np.float64]:
    """Scores to cut at: genuine ones, all or evenly by rank; impostor ones evenly by rank, and every one at the top."""
    kept = distinct[0]
    if kept.size > limit // 3:
        kept = kept[np.linspace(0, kept.size - 1, limit // 3).round().astype(np.int64)]
    ordered = np.sort(impostor)
    ranks = np.unique(np.linspace(0, ordered.size - 1, limit // 12).round().astype(np.int64))
    return np.unique(np.concatenate([kept, ordered[ranks], ordered[-(limit // 12) :]]))


def _code(scores: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """Twice the number of edges below a score, and one more on an edge."""
    below = np.searchsorted(edges, scores, side="left")
    return np.asarray(below + np.searchsorted(edges, scores, side="right"), dtype=np.int64)


def _moments(cell: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    number = np.maximum(np.bincount(cell, minlength=count), 1)
    mean = np.bincount(cell, weights=values, minlength=count) / number
    return np.stack([mean, np.bincount(cell, weights=(values - mean[cell]) ** 2, minlength=count) / number])
