"""How far two surfaces lie apart, as sets of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.errors import require

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SurfaceDistances:
    """Distances between two surfaces, mm. Each is the larger (`rms_mm`: the root mean square) of both directions."""

    hausdorff_mm: float
    """The largest distance of a point of one set to the nearest point of the other."""
    hausdorff95_mm: float
    """The 95th percentile in the place of the largest."""
    rms_mm: float
    """Root mean square of all nearest distances, both directions weighing the same."""


def nearest_distances(points: Array, others: Array) -> Array:
    """(N,) distance from each of (N, 3) `points` to the nearest of (M, 3) `others`."""
    return np.asarray(cKDTree(others).query(points)[0], dtype=np.float64)


def both_ways(first: Array, second: Array) -> tuple[Array, Array]:
    """Nearest distances from (N, 3) `first` to (M, 3) `second`, (N,), and back, (M,).

    Raises
    ------
    BadInput
        If a set is empty, not (N, 3) or not finite.
    """
    for name, points in (("first", first), ("second", second)):
        require(
            points.ndim == 2 and points.shape[1] == 3 and points.shape[0] > 0,
            f"{name} must hold points (N, 3), but it has the shape {points.shape}.",
        )
        require(bool(np.isfinite(points).all()), f"{name} holds points that are not finite.")
    return nearest_distances(first, second), nearest_distances(second, first)


def surface_distances(there: Array, back: Array) -> SurfaceDistances:
    """Summarise nearest distances, (N,) and (M,), in both directions: those of :func:`both_ways`, or a part of them.

    Where only the middle of two surfaces is measured, a point at its border may have its neighbour just beyond; so
    distances are found on the whole surfaces and those of the middle are kept.

    References
    ----------
    F. Hausdorff, Grundzuege der Mengenlehre, 1914, chapter 8; D. P. Huttenlocher, G. A. Klanderman, W. J. Rucklidge,
    Comparing images using the Hausdorff distance, IEEE PAMI 15 (1993), equations (1) and (2); the percentile is their
    partial distance, equation (8).
    """
    require(there.size > 0 and back.size > 0, "no distances to summarise; the surfaces share no points.")
    return SurfaceDistances(
        hausdorff_mm=float(max(there.max(), back.max())),
        hausdorff95_mm=float(max(np.percentile(there, 95), np.percentile(back, 95))),
        rms_mm=float(np.sqrt(0.5 * (np.mean(there**2) + np.mean(back**2)))),
    )
