"""Unrolling by way of a simple body: one cylinder, or a tube whose circles change smoothly along the finger.

References
----------
Y. Chen, G. Parziale, E. Diaz-Santana and A. Jain 2006, 3D touchless fingerprints: compatibility with legacy rolled
images (parametric: the cylinder). The tube is the same with one circle a cross-section.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from splitknit.errors import require
from splitknit.prints.unroll_grid import SurfaceGrid, slant_cos

Array = NDArray[np.float64]


def on_cylinder(grid: SurfaceGrid) -> Array:
    """Lay the skin on the best-fit circular cylinder and roll that out: (n, m, 2) u to the right, v to the tip, mm.

    Five parameters: where the axis passes (x, z), its two slopes over y, and the radius; least squares of the distances
    of the nodes that face the camera within 60 deg, with a robust loss, so that the tip does not decide.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - slow to import, and seldom used

    points = grid.points_mm
    used = points[grid.inside & (slant_cos(grid.points_mm) > 0.5)]
    require(len(used) >= 8, "too little of the finger faces the camera for a cylinder; mark the whole finger.")
    middle = used.mean(axis=0)
    spread = max(2.0, float(np.ptp(used[:, 0])) / 2)

    def distances(p: Array) -> Array:
        return np.asarray(_from_axis(used - middle, p)[0] - p[4])

    start = np.array([0.0, -spread, 0.0, 0.0, spread])
    found = least_squares(distances, start, loss="soft_l1", f_scale=0.3, max_nfev=200).x
    _, angle, along = _from_axis(points - middle, found)
    return np.stack([found[4] * angle, along], axis=2)


def _from_axis(points: Array, p: Array) -> tuple[Array, Array, Array]:
    """Distance from the axis, angle about it (0 towards the camera) and length along it."""
    axis = np.array([p[2], 1.0, p[3]])
    axis = axis / np.linalg.norm(axis)
    right = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    right = right / np.linalg.norm(right)
    up = np.cross(right, axis)
    rest = points - np.array([p[0], 0.0, p[1]])
    x, z = rest @ right, rest @ up
    return np.hypot(x, z), np.arctan2(x, z), rest @ axis


def on_tube(grid: SurfaceGrid, smooth_mm: float = 2.0) -> Array:
    """Lay each cross-section on its own circle: (n, m, 2) u to the right, v to the tip, mm.

    A circle is fitted to every row of nodes (least squares of x^2 + z^2 = a x + b z + c), and middles and radii are
    smoothed along the finger. u is the radius times the angle, v the length of the tube's top line.
    """
    points, inside = grid.points_mm, grid.inside
    rows = np.flatnonzero(inside.sum(axis=1) >= 5)
    require(rows.size >= 4, "too few cross-sections for a tube; mark the whole finger.")
    circles, weights = [], []
    for row in rows:
        x, z = points[row, inside[row], 0], points[row, inside[row], 2]
        shift = z.mean()
        a, b, c = np.linalg.lstsq(np.stack([x, z - shift, np.ones_like(x)], 1), x * x + (z - shift) ** 2, rcond=None)[0]
        radius = np.sqrt(max(c + 0.25 * (a * a + b * b), 0.25))
        circles.append((0.5 * a, shift + 0.5 * b, min(radius, 40.0)))
        weights.append(float(np.ptp(x)))
    sigma = smooth_mm / grid.pitch_mm
    weight = np.zeros(len(points))
    weight[rows] = weights
    values = np.zeros((len(points), 3))
    values[rows] = np.array(circles)
    tops = np.zeros(len(points))
    tops[rows] = np.array([c[1] + c[2] for c in circles])
    total = gaussian_filter1d(weight, sigma, mode="constant")
    total = np.maximum(total, 1e-9)
    smooth = gaussian_filter1d(values * weight[:, None], sigma, axis=0, mode="constant") / total[:, None]
    top = gaussian_filter1d(tops * weight, sigma, mode="constant") / total
    first, last = rows[0], rows[-1]  # beyond them the ends are continued
    smooth[:first], smooth[last + 1 :] = smooth[first], smooth[last]
    places = np.arange(len(points), dtype=np.float64)
    top = np.interp(places, rows, top[rows])
    for ends, inner in ((slice(0, first), first), (slice(last + 1, None), last)):
        slope = np.gradient(top[first : last + 1])[0 if inner == first else -1]
        top[ends] = top[inner] + slope * (places[ends] - inner)
    step = np.hypot(grid.pitch_mm, np.diff(top))
    v = -np.r_[0.0, np.cumsum(step)]
    v = v - v[round(float(rows.mean()))]
    angle = np.arctan2(points[..., 0] - smooth[:, None, 0], points[..., 2] - smooth[:, None, 1])
    flat = np.stack([smooth[:, None, 2] * angle, np.broadcast_to(v[:, None], angle.shape)], axis=2)
    flat[~grid.known] = np.nan
    return np.asarray(flat)
