"""What makes two views' ridges meet: the finger's shape between its outlines, the mirror's pose, and a small warp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from splitknit.fuse.chart import Chart
from splitknit.fuse.disparity import Disparity
from splitknit.fuse.sight import Sight
from splitknit.types import FloatArray

Array = NDArray[np.float64]

KNOT_MM = 2.0
"""Distance of the knots of the correction of the surface."""
POSE_PRIOR = (0.01, 0.01, 0.2)
"""Standard deviations of a mirror's two turns (rad) and its shift (mm) against where it is taken to be."""
DEPTH_PRIOR_MM = 2.0
"""Standard deviation of the surface against where it is taken to be."""
OUTLINE_PRIOR_MM, OUTLINE_DEG = 0.3, 10.0
"""The same where the front's outline tells the surface, this near to a right angle from the front."""
BEND_PRIOR_MM = 0.25
"""Standard deviation of the correction's second difference from knot to knot."""
NOISE_MM = 0.04
"""Of a measured shift."""


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What moves the surface and the mirrors."""

    radius_mm: Array
    """(n, m) to be added to the surface on the chart as it is."""
    poses: dict[str, tuple[float, float, float]]
    """Two turns (rad) and a shift (mm) of each mirror as it is, see :meth:`splitknit.fuse.reflection.Plane.moved`."""
    total: Array
    """(P,) all corrections so far: knots of the surface, then poses. What is expected of them is expected of these."""
    left_mm: float
    """Root mean square of the shifts that this does not explain."""


def shifts_by(
    sight: Sight, chart: Chart, points: Array, rays: Array, steps: tuple[Array, Array]
) -> tuple[Array, Array]:
    """How a view's ridges move on the chart when the surface or the mirror does.

    Parameters
    ----------
    points : (K, 3) on the surface
    rays : (K, 3) directions along which the surface moves
    steps : (K, 3) by one column and by one row of the chart, along the surface

    Returns
    -------
    by_radius : (K, 2) columns and rows for each mm of the surface
    by_pose : (K, 2, 3) for the mirror's turns (rad) and shift (mm); zero for the front
    """
    here = _pixels(sight, points)
    across, down = (_pixels(sight, points + 0.5 * s) - _pixels(sight, points - 0.5 * s) for s in steps)
    jacobian = np.stack([across, down], axis=-1)  # (K, 2 pixel, 2 chart)
    inverse = np.linalg.pinv(jacobian, rcond=0.05)
    small = 1e-2
    by_radius = np.einsum("kij,kj->ki", inverse, (_pixels(sight, points + small * rays) - here) / small)
    by_pose = np.zeros((len(points), 2, 3))
    if sight.plane is not None:
        for k in range(3):
            change = [0.0, 0.0, 0.0]
            change[k] = 1e-3
            moved = replace(sight, plane=sight.plane.moved((change[0], change[1]), change[2]))
            by_pose[:, :, k] = np.einsum("kij,kj->ki", inverse, (_pixels(moved, points) - here) / 1e-3)
    return by_radius, by_pose


def _pixels(sight: Sight, points: Array) -> Array:
    """(K, 2) columns and rows, in double precision."""
    seen = sight.to_view(points) * sight.camera.px_per_mm
    return np.stack([seen[..., 0], -seen[..., 1]], axis=-1)


def correct(  # noqa: PLR0917
    chart: Chart, radius_mm: Array, found: dict[str, Disparity], front: Sight, mirrors: dict[str, Sight],
    poses_free: bool = True, before: Array | None = None,
) -> Correction:  # fmt: skip
    """Surface and poses that explain how far the mirrors' ridges lie from the front's.

    Linear least squares with priors; shifts that do not fit are weighed down (Cauchy) in turns.

    Parameters
    ----------
    chart, radius_mm : the surface (n, m)
    found : shifts of each mirror against the front, in columns and rows of the chart
    poses_free : whether mirrors may move
    before : ``total`` of the corrections that the surface and the mirrors already have
    """
    rows, columns = chart.shape
    pitch = chart.pitch_mm
    every = max(1, round(KNOT_MM / pitch))
    knots = (-(-(rows - 1) // every) + 1, -(-(columns - 1) // every) + 1)
    count = knots[0] * knots[1]
    points = chart.points(radius_mm)
    _, rays = chart.rays()
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    matrices, values, weights = [], [], []
    names = list(found)
    for place, name in enumerate(names):
        one = found[name]
        if one.peak.size == 0:
            continue
        at = (
            np.clip(np.rint(one.rows).astype(int), 0, rows - 1),
            np.clip(np.rint(one.columns).astype(int), 0, columns - 1),
        )
        steps = right[at], down[at]
        scale = np.stack([np.linalg.norm(s, axis=1) for s in steps], axis=1)  # mm for a column, a row
        of_front, _ = shifts_by(front, chart, points[at], rays[at], steps)
        of_mirror, by_pose = shifts_by(mirrors[name], chart, points[at], rays[at], steps)
        spread = _hats(one.columns / every, one.rows / every, knots)
        for axis in range(2):
            by_depth = (of_mirror - of_front)[:, axis] * scale[:, axis]
            pose = np.zeros((len(one.peak), 3 * len(names)))
            if poses_free:
                pose[:, 3 * place : 3 * place + 3] = by_pose[:, axis] * scale[:, axis, None]
            matrices.append(
                scipy.sparse.hstack([scipy.sparse.diags_array(by_depth) @ spread, scipy.sparse.csr_array(pose)])
            )
            values.append(one.shift[:, axis] * scale[:, axis])
            weights.append(one.peak / NOISE_MM)
    done = np.zeros(count + 3 * len(names)) if before is None else before
    if not matrices:
        return Correction(np.zeros(chart.shape), dict.fromkeys(names, (0.0, 0.0, 0.0)), done, 0.0)
    matrix: Any = scipy.sparse.vstack(matrices).tocsr()
    value, weight = np.concatenate(values), np.concatenate(weights)
    prior = _priors(knots, len(names), _depth_prior(chart, every, knots[1]))
    solution = np.zeros_like(done)
    trust = np.ones(value.size)
    for _ in range(6):
        scaled = scipy.sparse.diags_array((weight * trust) ** 2)
        normal = matrix.T @ scaled @ matrix + prior
        solution = scipy.sparse.linalg.spsolve(
            scipy.sparse.csc_array(normal), matrix.T @ (scaled @ value) - prior @ done
        )
        left = value - matrix @ solution
        trust = 1.0 / np.sqrt(1.0 + (left / (2.5 * NOISE_MM)) ** 2)
    grid = solution[:count].reshape(knots).astype(np.float32)
    column, row = np.meshgrid(np.arange(columns, dtype=np.float32) / every, np.arange(rows, dtype=np.float32) / every)
    smooth = cv2.remap(grid, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    poses = {}
    for place, name in enumerate(names):
        first, second, shift = (float(v) for v in solution[count + 3 * place : count + 3 * place + 3])
        poses[name] = (first, second, shift)
    spread_left = float(np.sqrt(np.average(left**2, weights=trust**2)))
    return Correction(np.asarray(smooth, dtype=np.float64), poses, done + solution, spread_left)


def _hats(columns: Array, rows: Array, knots: tuple[int, int]) -> scipy.sparse.csr_array:
    """(K, knots) bilinear weights of the knots at places given in knots."""
    row0 = np.clip(np.floor(rows).astype(int), 0, knots[0] - 2)
    column0 = np.clip(np.floor(columns).astype(int), 0, knots[1] - 2)
    down, right = rows - row0, columns - column0
    entries, places = [], []
    for di, wi in ((0, 1 - down), (1, down)):
        for dj, wj in ((0, 1 - right), (1, right)):
            entries.append(wi * wj)
            places.append((row0 + di) * knots[1] + column0 + dj)
    lines = np.tile(np.arange(len(columns)), 4)
    shape = (len(columns), knots[0] * knots[1])
    return scipy.sparse.coo_array((np.concatenate(entries), (lines, np.concatenate(places))), shape=shape).tocsr()


def _depth_prior(chart: Chart, every: int, columns: int) -> Array:
    """(columns,) standard deviation of the surface at the knots' angles, mm."""
    step = float(chart.angle_rad[1] - chart.angle_rad[0]) * every
    degrees = np.rad2deg(float(chart.angle_rad[0]) + step * np.arange(columns))
    near = np.exp(-0.5 * ((np.abs(degrees) - 90.0) / OUTLINE_DEG) ** 2)
    return np.asarray(DEPTH_PRIOR_MM * (OUTLINE_PRIOR_MM / DEPTH_PRIOR_MM) ** near)


def _priors(knots: tuple[int, int], mirrors: int, deviation_mm: Array) -> Any:
    """Inverse covariance of knots and poses; `deviation_mm` (columns,) of the surface."""
    rows, columns = knots

    def bends(count: int) -> scipy.sparse.csr_array:
        if count < 3:
            return scipy.sparse.csr_array((0, count))
        return scipy.sparse.csr_array(
            scipy.sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count))
        )

    down = scipy.sparse.kron(bends(rows), scipy.sparse.eye_array(columns))
    across = scipy.sparse.kron(scipy.sparse.eye_array(rows), bends(columns))
    smooth = (down.T @ down + across.T @ across) / BEND_PRIOR_MM**2
    near = scipy.sparse.diags_array(np.tile(1.0 / deviation_mm**2, rows))
    poses = scipy.sparse.diags_array(np.tile(1.0 / np.array(POSE_PRIOR) ** 2, mirrors))
    return scipy.sparse.block_diag([smooth + near, poses])


def warp_field(found: Disparity, shape: tuple[int, int], pitch_mm: float, smooth_mm: float = 1.5) -> FloatArray:
    """(n, m, 2) smooth shift, in columns and rows, through the measured ones; falls to zero away from them."""
    weight = np.zeros(shape, dtype=np.float32)
    total = np.zeros((*shape, 2), dtype=np.float32)
    middle = np.median(found.shift, axis=0) if len(found.peak) else np.zeros(2)
    for column, row, shift, peak in zip(found.columns, found.rows, found.shift, found.peak, strict=True):
        if np.abs(shift - middle).max() * pitch_mm > 0.6:  # a ridge too far
            continue
        weight[int(row), int(column)] += peak
        total[int(row), int(column)] += peak * shift
    sigma = smooth_mm / pitch_mm
    spread = cv2.GaussianBlur(weight, (0, 0), sigma)
    dense = max(float(np.quantile(spread[spread > 0], 0.5)) if (spread > 0).any() else 1.0, 1e-9)
    return np.asarray(cv2.GaussianBlur(total, (0, 0), sigma) / (spread + 0.1 * dense)[..., None], dtype=np.float32)
