"""What makes two views' ridges meet: the finger's shape between its outlines, the mirror's pose, and a small warp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.fuse.chart import Chart
from splitknit.fuse.disparity import Disparity
from splitknit.fuse.sight import Sight
from splitknit.types import BoolArray, FloatArray

Array = NDArray[np.float64]

KNOT_MM = 2.5
"""Distance of the knots of the correction of the surface."""
POSE_PRIOR = (0.01, 0.01, 0.2)
"""Standard deviations of a mirror's two turns (rad) and its shift (mm) against where it is taken to be."""
DEPTH_PRIOR_MM = 2.0
"""Standard deviation of the surface against where it is taken to be."""
OUTLINE_PRIOR_MM, OUTLINE_DEG = 0.3, 10.0
"""The same where the front's outline tells the surface, this near to a right angle from the front."""
BEND_PRIOR_MM = 0.25
"""Standard deviation of the correction's second difference from knot to knot."""
ALIKE_MM = 0.3
"""Ridges say something new at about this distance."""
ROBUST = 1.0
"""Difference of two views' ridges, of unit contrast, from which it counts less and less."""
ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What moves the surface and a mirror."""

    radius_mm: Array
    """(n, m) to be added to the surface on the chart."""
    pose: tuple[float, float, float]
    """Two turns (rad) and a shift (mm) of the mirror, see :meth:`splitknit.fuse.reflection.Plane.moved`."""
    before: float
    """Correlation of the two views' ridges where both see them, as it was."""
    after: float


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


def align(  # noqa: PLR0917
    chart: Chart, radius_mm: Array, front: Sight, mirror: Sight, first: FloatArray, second: FloatArray,
    both: BoolArray, pose_free: bool = True,
) -> Correction:  # fmt: skip
    """Bend the surface and move the mirror until its ridges lie on the front's, all of them at once.

    Gauss-Newton on the difference of the two ridge bands, each of unit local contrast. Unknown are the knots of a
    smooth correction of the surface and the mirror's pose, with priors on both. Ridges must lie within a quarter of a
    period to begin with: see :mod:`splitknit.fuse.search`.

    Parameters
    ----------
    chart, radius_mm : the surface (n, m)
    first, second : (n, m) ridge bands of the front and of the mirror's view, zero where not seen
    both : (n, m) where both see the finger
    pose_free : whether the mirror may move

    References
    ----------
    Lucas and Kanade 1981, An iterative image registration technique; Baker and Matthews 2004, eq. 10.
    """
    rows, columns = np.nonzero(both)
    if rows.size < 500:
        return Correction(np.zeros(chart.shape), (0.0, 0.0, 0.0), 0.0, 0.0)
    every = max(2, round(KNOT_MM / chart.pitch_mm))
    knots = (-(-(chart.shape[0] - 1) // every) + 1, -(-(chart.shape[1] - 1) // every) + 1)
    count = knots[0] * knots[1]
    modes = _modes(chart, radius_mm, (front, mirror), (rows, columns))
    spread = _hats(columns / every, rows / every, knots)
    one, other = (evened(band, both, chart.pitch_mm) for band in (first, second))
    slopes = np.gradient(other, axis=1), np.gradient(other, axis=0)
    target = one[rows, columns]
    prior = _priors(knots, _depth_prior(chart, every, knots[1]), pose_free)
    weight = (chart.pitch_mm / ALIKE_MM) ** 2  # neighbouring pixels say the same
    values = np.zeros(count + 3)
    scores: list[tuple[float, Array]] = []
    for _ in range(ROUNDS):
        by_depth = spread @ values[:count]
        moved = modes[..., 0] * by_depth[:, None] + modes[..., 1:] @ values[count:]
        column, row = columns + moved[:, 0], rows + moved[:, 1]
        seen, across, down = (_read(field, column, row) for field in (other, *slopes))
        scores.append((float(np.corrcoef(seen, target)[0, 1]) if seen.std() > 0 else 0.0, values))
        jacobian = across[:, None] * modes[:, 0] + down[:, None] * modes[:, 1]  # (K, 4)
        left = target - seen
        trust = 1.0 / (1.0 + (left / ROBUST) ** 2)
        matrix: Any = scipy.sparse.hstack(
            [scipy.sparse.diags_array(jacobian[:, 0]) @ spread, scipy.sparse.csr_array(jacobian[:, 1:])]
        ).tocsr()
        scaled = scipy.sparse.diags_array(trust * weight)
        normal = matrix.T @ scaled @ matrix + prior
        step = scipy.sparse.linalg.spsolve(scipy.sparse.csc_array(normal), matrix.T @ (scaled @ left) - prior @ values)
        values = values + step
    best, values = max(scores, key=lambda item: item[0])
    grid = values[:count].reshape(knots).astype(np.float32)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) / every for n in chart.shape[::-1]))
    smooth = cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    smooth = cv2.GaussianBlur(smooth, (0, 0), 0.35 * every)
    first_turn, second_turn, shift = (float(v) for v in values[count:])
    return Correction(np.asarray(smooth, dtype=np.float64), (first_turn, second_turn, shift), scores[0][0], best)


def _modes(
    chart: Chart, radius_mm: Array, sights: tuple[Sight, Sight], at: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> Array:
    """(K, 2, 4) columns and rows by which the mirror's ridges move against the front's: by mm of surface, by pose."""
    points = chart.points(radius_mm)
    _, rays = chart.rays()
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    (of_front, _), (of_mirror, by_pose) = (
        shifts_by(sight, chart, points[at], rays[at], (right[at], down[at])) for sight in sights
    )
    return np.concatenate([(of_mirror - of_front)[..., None], by_pose], axis=-1)


def evened(band: FloatArray, known: BoolArray, pitch_mm: float, sigma_mm: float = 1.0) -> FloatArray:
    """(n, m) ridge band over its local standard deviation."""
    size = sigma_mm / pitch_mm
    share = np.maximum(cv2.GaussianBlur(known.astype(np.float32), (0, 0), size), np.float32(1e-3))
    power = cv2.GaussianBlur(np.where(known, band * band, 0).astype(np.float32), (0, 0), size) / share
    typical = float(np.median(power[known])) if known.any() else 1.0
    return np.asarray(band / np.sqrt(power + np.float32(0.1 * typical + 1e-20)), dtype=np.float32)


def _read(field: FloatArray, columns: Array, rows: Array) -> Array:
    """(K,) values at places, zero outside."""
    return np.asarray(ndimage.map_coordinates(field, [rows, columns], order=1, mode="constant"), dtype=np.float64)


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


def _priors(knots: tuple[int, int], deviation_mm: Array, pose_free: bool) -> Any:
    """Inverse covariance of knots and pose; `deviation_mm` (columns,) of the surface."""
    rows, columns = knots

    def bends(count: int) -> Any:
        if count < 3:
            return scipy.sparse.csr_array((0, count))
        return scipy.sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count)).tocsr()

    down = scipy.sparse.kron(bends(rows), scipy.sparse.eye_array(columns))
    across = scipy.sparse.kron(scipy.sparse.eye_array(rows), bends(columns))
    smooth = (down.T @ down + across.T @ across) / BEND_PRIOR_MM**2
    near = scipy.sparse.diags_array(np.tile(1.0 / deviation_mm**2, rows))
    spreads = np.array(POSE_PRIOR) if pose_free else np.full(3, 1e-9)
    return scipy.sparse.block_diag([smooth + near, scipy.sparse.diags_array(1.0 / spreads**2)]).tocsr()


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
