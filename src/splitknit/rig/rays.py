"""Where short rays meet a triangle mesh: cell by cell of a grid, so that each looks at the triangles around it only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_TINY = 1e-12
_AT_ONCE = 400_000
"""Pairs of rays and triangles that are looked at together: what fits into the processor's cache."""


def first_hits(
    corners: NDArray[np.float64], origins: NDArray[np.float64], directions: NDArray[np.float64], reach_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return each ray's distance to the first triangle that it meets within its reach, and that triangle.

    Parameters
    ----------
    corners : (N, 3, 3), mm
    origins, directions : (R, 3); directions of unit length
    reach_mm : length of the rays

    Returns
    -------
    distance : (R,), infinite where nothing is met
    triangle : (R,), -1 where nothing is met

    References
    ----------
    T. Moeller and B. Trumbore, "Fast, minimum storage ray/triangle intersection", Journal of Graphics Tools 2(1), 1997.

    Examples
    --------
    >>> import numpy as np
    >>> floor = np.array([[[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]]])
    >>> first_hits(floor, np.array([[1.0, 1.0, 3.0]]), np.array([[0.0, 0.0, -1.0]]), 5.0)[0].tolist()
    [3.0]
    """
    distance = np.full(len(origins), np.inf)
    triangle = np.full(len(origins), -1, dtype=np.int64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    cells = np.floor(origins / reach_mm).astype(np.int64)
    _, cell_of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(cell_of.ravel(), kind="stable")
    for members in np.split(order, np.cumsum(counts)[:-1]):
        ends = origins[members] + reach_mm * directions[members]
        lowest = np.minimum(origins[members], ends).min(axis=0)
        highest = np.maximum(origins[members], ends).max(axis=0)
        near = np.flatnonzero((low <= highest).all(axis=1) & (high >= lowest).all(axis=1))
        if len(near) == 0:
            continue
        for some in np.array_split(members, max(1, len(members) * len(near) // _AT_ONCE)):
            found, index = _hits(corners[near], origins[some], directions[some])
            met = found <= reach_mm
            distance[some] = np.where(met, found, np.inf)
            triangle[some] = np.where(met, near[index], -1)
    return distance, triangle


def _hits(
    corners: NDArray[np.float64], origins: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distances (R,) and triangles (R,) of the first hits among all of `corners` (T, 3, 3)."""
    base, edge1, edge2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # triple products, arranged so that only matrix products of (R, 3) by (3, T) are needed
    normal = np.cross(edge1, edge2)
    determinant = -directions @ normal.T
    inverse = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=np.abs(determinant) > _TINY)
    moment = np.cross(origins, directions)  # (o - b) x d = o x d - b x d
    u = (moment @ edge2.T + directions @ np.cross(base, edge2).T) * inverse
    v = (moment @ edge1.T + directions @ np.cross(base, edge1).T) * -inverse
    t = (origins @ normal.T - (base * normal).sum(axis=1)) * inverse
    edge = 1e-9
    met = (inverse != 0) & (u >= -edge) & (v >= -edge) & (u + v <= 1 + edge) & (t > 1e-6)
    t = np.where(met, t, np.inf)
    index = t.argmin(axis=1)
    return np.asarray(t[np.arange(len(origins)), index]), index.astype(np.int64)
