"""How far two surfaces lie apart, as sets of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.check import require

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


def surface_distances(
    first: Array, second: Array, *, first_all: Array | None = None, second_all: Array | None = None
) -> SurfaceDistances:
    """Measure two sets of points against each other.

    Parameters
    ----------
    first, second : (N, 3), (M, 3) points, mm
    first_all, second_all : larger sets that hold `first` and `second`, in which the nearest point is looked for: where
        only the middle of two surfaces is measured, a point at its border may have its neighbour just beyond

    Returns
    -------
    SurfaceDistances

    Raises
    ------
    BadInput
        If a set is empty, not (N, 3) or not finite.

    References
    ----------
    F. Hausdorff, Grundzuege der Mengenlehre, 1914, chapter 8; D. P. Huttenlocher, G. A. Klanderman, W. J. Rucklidge,
    Comparing images using the Hausdorff distance, IEEE PAMI 15 (1993), equations (1), (2) and, for the percentile, (8).
    """
    first_all = first if first_all is None else first_all
    second_all = second if second_all is None else second_all
    for name, points in (("first", first), ("second", second), ("first_all", first_all), ("second_all", second_all)):
        require(
            points.ndim == 2 and points.shape[1] == 3 and points.shape[0] > 0,
            f"{name} must hold points (N, 3), but it has the shape {points.shape}.",
        )
        require(bool(np.isfinite(points).all()), f"{name} holds points that are not finite.")
    there = nearest_distances(first, second_all)
    back = nearest_distances(second, first_all)
    return SurfaceDistances(
        hausdorff_mm=float(max(there.max(), back.max())),
        hausdorff95_mm=float(max(np.percentile(there, 95), np.percentile(back, 95))),
        rms_mm=float(np.sqrt(0.5 * (np.mean(there**2) + np.mean(back**2)))),
    )
