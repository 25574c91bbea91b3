"""How far a flat map of the skin stretches it: two principal stretches everywhere, as maps and as numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Distortion:
    """Of the cells between the nodes; NaN where there is no surface."""

    area: Array
    """(n - 1, m - 1) area on the map over area of the skin, minus one."""
    anisotropy: Array
    """(n - 1, m - 1) larger over smaller principal stretch, minus one."""
    largest: Array
    """(n - 1, m - 1) larger principal stretch."""
    smallest: Array
    """(n - 1, m - 1) smaller principal stretch."""
    slant_deg: Array
    """(n - 1, m - 1) slant of the skin."""
    skin_mm2: Array
    """(n - 1, m - 1) area of the skin."""

    def figures(self) -> dict[str, float | None]:
        """Percent, weighted by the skin's area: medians, 95th percentiles, and by zones of slant."""
        zones = {
            "": np.isfinite(self.area),
            "_centre": self.slant_deg < 20.0,
            "_slant_60": np.abs(self.slant_deg - 60.0) < 5.0,
        }
        result: dict[str, float | None] = {}
        worst = np.maximum(np.abs(self.largest - 1.0), np.abs(self.smallest - 1.0))
        for zone, slanted in zones.items():
            where = slanted & np.isfinite(self.area)
            for name, values in (("area", np.abs(self.area)), ("anisotropy", self.anisotropy), ("length", worst)):
                for word, share in (("median", 0.5), ("p95", 0.95)):
                    found = _percentile(values[where], self.skin_mm2[where], share)
                    result[f"{name}{zone}_{word}_percent"] = None if found is None else round(100.0 * found, 3)
        return result


def distortion(points_mm: Array, flat_mm: Array, inside: NDArray[np.bool_]) -> Distortion:
    """Compare a flat map with the surface, cell by cell.

    Parameters
    ----------
    points_mm : (n, m, 3)
        Surface points of the nodes.
    flat_mm : (n, m, 2)
        Where the map lays them.
    inside : (n, m) bool
        Cells with four corners inside count.

    References
    ----------
    The stretches are the roots of the eigenvalues of J G^-1 J^T, J the map's and G the surface's first derivatives over
    the grid (Floater and Hormann 2005, Surface parameterization, section 2).
    """
    right, down = _differences(points_mm)
    flat_right, flat_down = _differences(flat_mm)
    e, f, g = (right * right).sum(2), (right * down).sum(2), (down * down).sum(2)
    a, b, c = (flat_right**2).sum(2), (flat_right * flat_down).sum(2), (flat_down**2).sum(2)
    determinant = np.maximum(e * g - f * f, 1e-18)
    # eigenvalues of G^-1 A, A the map's own metric
    trace = (g * a - 2.0 * f * b + e * c) / determinant
    product = np.maximum(a * c - b * b, 0.0) / determinant
    root = np.sqrt(np.maximum(0.25 * trace * trace - product, 0.0))
    largest = np.sqrt(np.maximum(0.5 * trace + root, 1e-18))
    smallest = np.sqrt(np.maximum(0.5 * trace - root, 1e-18))
    normal = np.cross(right, -down)
    size = np.linalg.norm(normal, axis=2)
    slant = np.rad2deg(np.arccos(np.clip(np.abs(normal[..., 2]) / np.maximum(size, 1e-18), 0.0, 1.0)))
    cell = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    cell &= np.isfinite(trace)
    fields = [largest * smallest - 1.0, largest / smallest - 1.0, largest, smallest, slant, size]
    return Distortion(*(np.where(cell, field, np.nan) for field in fields))


def _differences(values: Array) -> tuple[Array, Array]:
    """Differences to the right and down at the middles of the cells."""
    right = 0.5 * (values[:-1, 1:] - values[:-1, :-1] + values[1:, 1:] - values[1:, :-1])
    down = 0.5 * (values[1:, :-1] - values[:-1, :-1] + values[1:, 1:] - values[:-1, 1:])
    return right, down


def _percentile(values: Array, weights: Array, share: float) -> float | None:
    if values.size == 0:
        return None
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(total, share * total[-1])), values.size - 1)])
