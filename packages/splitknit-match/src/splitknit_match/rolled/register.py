"""Two views' ridges brought onto each other: by the finger's shape between its outlines, and the mirror's pose."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.view import pixels_of
from splitknit.mirrors.reflection import Sight
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits, check_fields
from splitknit_match.rolled.chart import Chart, read

# Ridges by themselves: a relief without what is smooth in it.


def ridges_of(relief: FloatArray, known: BoolArray, pitch_mm: float) -> FloatArray:
    """(n, m) relief less its local mean over `known`, zero elsewhere."""
    weight = known.astype(np.float32)
    filled = np.where(known, relief, 0.0).astype(np.float32)
    sigma = 0.32 / pitch_mm  # mm: the ridge band of this package
    fraction = np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)
    mean = cv2.GaussianBlur(filled, (0, 0), sigma) / fraction
    return np.where(known, filled - mean, 0.0).astype(np.float32)


def _evened(band: FloatArray, known: BoolArray, pitch_mm: float) -> FloatArray:
    """(n, m) ridge band over its local standard deviation."""
    size = 1.0 / pitch_mm  # 1 mm: two ridges
    fraction = np.maximum(cv2.GaussianBlur(known.astype(np.float32), (0, 0), size), 1e-3)
    power = cv2.GaussianBlur(np.where(known, band * band, 0).astype(np.float32), (0, 0), size) / fraction
    typical = float(np.median(power[known])) if known.any() else 1.0
    return np.asarray(band / np.sqrt(power + np.float32(0.1 * typical + 1e-20)), dtype=np.float32)


Array = NDArray[np.float64]

KNOT_MM = 2.5  # distance of the knots of the correction of the surface
POSE_PRIOR = (0.004, 0.002, 0.05)  # standard deviations of a mirror's two turns (rad) and its shift (mm)
DEPTH_PRIOR_MM = 0.15  # standard deviation of the surface against where it is taken to be
UNSEEN_PRIOR_MM = 0.03  # the same where no two views show it
OUTLINE_PRIOR_MM, OUTLINE_DEG = 0.05, 15.0
"""The same where the front's outline determines the surface, this near to a right angle from the front."""
BEND_PRIOR_MM = 0.04  # standard deviation of the correction's second difference from knot to knot
CORRELATED_MM = 0.3  # ridges are independent at about this distance
ROBUST = 1.0  # difference of two views' ridges, of unit contrast, from which it counts less and less
ROUNDS = 12
FEW = 500  # pixels that both views show; with fewer a mirror is left as it is


@dataclass(frozen=True, slots=True, eq=False)
class _Correction:
    """What moves the surface and the mirrors."""

    radius_mm: Array  # (n, m) to be added to the surface on the chart
    poses: tuple[tuple[float, float, float], ...]  # turns (rad) and shift (mm) of each mirror, see :meth:`Plane.moved`
    before: tuple[float, ...]  # correlation of each mirror's ridges with the front's where both see them, as it was
    after: tuple[float, ...]


def _shifts_by(sight: Sight, points: Array, rays: Array, steps: tuple[Array, Array]) -> tuple[Array, Array]:
    """How a view's ridges move on the chart when the surface or the mirror does: (K, 2) columns and rows for each mm of
    the surface, and (K, 2, 3) for the mirror's turns (rad) and shift (mm), zero for the front. `points`: (K, 3) on the
    surface; `rays`: (K, 3) along which it moves; `steps`: (K, 3) by one column and by one row of the chart.
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
    return pixels_of(sight.camera, sight.to_view(points))


@dataclass(frozen=True, slots=True, eq=False)
class ViewRidges:
    """A view's ridges on the chart."""

    sight: Sight
    band: FloatArray  # (n, m) ridge band, zero where the view does not show the finger
    known: BoolArray  # (n, m) where it does; of a mirror, where the front does, too


def align(
    chart: Chart, radius_mm: Array, front: ViewRidges, mirrors: Sequence[ViewRidges], *, pose_free: bool = True
) -> _Correction:
    """Bend the surface and move the mirrors until their ridges lie on the front's, all of them at once.

    Gauss-Newton on the difference of the ridge bands, each of unit local contrast. Unknown are the knots of a smooth
    correction of the surface, which all views share, and the mirrors' poses, with priors on both. Ridges must lie
    within a quarter of a period to begin with: see :func:`search`. `chart`, `radius_mm`: the surface (n, m); `front`,
    `mirrors`: the views; the mirrors' are brought onto the front's; `pose_free`: whether mirrors may move. Source:
    Lucas and Kanade 1981, An iterative image registration technique; Baker and Matthews 2004, eq. 10.
    """
    every, knots = _knots(chart)
    count = knots[0] * knots[1]
    parts = [_Part(chart, radius_mm, front, one) if int(one.known.sum()) >= FEW else None for one in mirrors]
    weight = (chart.pitch_mm / CORRELATED_MM) ** 2  # neighbouring pixels are correlated
    seen = np.any([one.known for one in mirrors], axis=0)
    prior = _priors(knots, _depth_prior(chart, seen), pose_free, len(mirrors))
    values = np.zeros(count + 3 * len(mirrors))
    scores: list[tuple[float, list[float], Array]] = []
    for _ in range(ROUNDS):
        normal, right, found = prior.copy(), -prior @ values, []
        for k, part in enumerate(parts):
            if part is None:
                found.append(0.0)
                continue
            own = slice(count + 3 * k, count + 3 * k + 3)
            matrix, left, score = part.linearised(values[:count], values[own])
            found.append(score)
            others = (3 * k, 3 * (len(parts) - k - 1))  # poses before and after its own
            ahead, behind = (scipy.sparse.csr_array((matrix.shape[0], n)) for n in others)
            matrix = scipy.sparse.hstack([matrix[:, :count], ahead, matrix[:, count:], behind]).tocsr()
            trust = scipy.sparse.diags_array(weight / (1.0 + (left / ROBUST) ** 2))
            normal = normal + matrix.T @ trust @ matrix
            right = right + matrix.T @ (trust @ left)
        scores.append((float(np.mean(found)) if found else 0.0, found, values))
        values = values + scipy.sparse.linalg.spsolve(scipy.sparse.csc_array(normal), right)
    _, after, values = max(scores, key=lambda item: item[0])
    grid = values[:count].reshape(knots).astype(np.float32)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) / every for n in chart.shape[::-1]))
    smooth = cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    smooth = cv2.GaussianBlur(smooth, (0, 0), 0.35 * every)
    poses = [(float(a), float(b), float(c)) for a, b, c in values[count:].reshape(-1, 3)]
    return _Correction(np.asarray(smooth, dtype=np.float64), tuple(poses), tuple(scores[0][1]), tuple(after))


class _Part:
    """One mirror's fraction in the equations."""

    def __init__(self, chart: Chart, radius_mm: Array, front: ViewRidges, mirror: ViewRidges) -> None:
        self.rows, self.columns = np.nonzero(mirror.known)
        self.modes = _ridge_moves(chart, radius_mm, (front.sight, mirror.sight), (self.rows, self.columns))
        every, knots = _knots(chart)
        self.spread = _hats(self.columns / every, self.rows / every, knots)
        one, other = (_evened(view.band, mirror.known, chart.pitch_mm) for view in (front, mirror))
        self.fields = other, np.gradient(other, axis=1), np.gradient(other, axis=0)
        self.target = one[self.rows, self.columns]

    def linearised(self, depths: Array, pose: Array) -> tuple[Any, Array, float]:
        """Derivatives (K, knots + 3) of the mirror's ridges, the residuals (K,), and the correlation."""
        by_depth = self.spread @ depths
        moved = self.modes[..., 0] * by_depth[:, None] + self.modes[..., 1:] @ pose
        column, row = self.columns + moved[:, 0], self.rows + moved[:, 1]
        found = (scipy.ndimage.map_coordinates(one, [row, column], order=1) for one in self.fields)
        seen, across, down = (one.astype(np.float64) for one in found)
        score = float(np.corrcoef(seen, self.target)[0, 1]) if seen.std() > 0 else 0.0
        jacobian = across[:, None] * self.modes[:, 0] + down[:, None] * self.modes[:, 1]  # (K, 4)
        by_knots = scipy.sparse.diags_array(jacobian[:, 0]) @ self.spread
        matrix: Any = scipy.sparse.hstack([by_knots, scipy.sparse.csr_array(jacobian[:, 1:])]).tocsr()
        return matrix, self.target - seen, score


def _ridge_moves(
    chart: Chart, radius_mm: Array, sights: tuple[Sight, Sight], at: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> Array:
    """(K, 2, 4) columns and rows by which the mirror's ridges move against the front's: by mm of surface, by pose."""
    points = chart.points(radius_mm)
    _, rays = chart.rays()
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    by_view = (_shifts_by(sight, points[at], rays[at], (right[at], down[at])) for sight in sights)
    (of_front, _), (of_mirror, by_pose) = by_view
    return np.concatenate([(of_mirror - of_front)[..., None], by_pose], axis=-1)


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


def _knots(chart: Chart) -> tuple[int, tuple[int, int]]:
    """Pixels of the chart from one knot of the correction to the next, and rows and columns of knots."""
    every = max(2, round(KNOT_MM / chart.pitch_mm))
    return every, (-(-(chart.shape[0] - 1) // every) + 1, -(-(chart.shape[1] - 1) // every) + 1)


def _depth_prior(chart: Chart, seen: BoolArray) -> Array:
    """(knots) standard deviation of the surface at the knots, mm: away from what two views show it stays as it is."""
    every, knots = _knots(chart)
    step = float(chart.angle_rad[1] - chart.angle_rad[0]) * every
    degrees = np.rad2deg(float(chart.angle_rad[0]) + step * np.arange(knots[1]))
    near = np.exp(-0.5 * ((np.abs(degrees) - 90.0) / OUTLINE_DEG) ** 2)
    deviation = np.asarray(DEPTH_PRIOR_MM * (OUTLINE_PRIOR_MM / DEPTH_PRIOR_MM) ** near)
    reach = cv2.dilate(seen.astype(np.uint8), np.ones((2 * every + 1, 2 * every + 1), np.uint8))
    row, column = (np.minimum(np.arange(n) * every, size - 1) for n, size in zip(knots, seen.shape, strict=True))
    return np.where(reach[np.ix_(row, column)] > 0, deviation[None], UNSEEN_PRIOR_MM)


def _priors(knots: tuple[int, int], deviation_mm: Array, pose_free: bool, mirrors: int) -> Any:
    """Inverse covariance of knots and poses; `deviation_mm` (knots) of the surface."""
    rows, columns = knots

    def bends(count: int) -> Any:
        if count < 3:
            return scipy.sparse.csr_array((0, count))
        return scipy.sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count)).tocsr()

    down = scipy.sparse.kron(bends(rows), scipy.sparse.eye_array(columns))
    across = scipy.sparse.kron(scipy.sparse.eye_array(rows), bends(columns))
    smooth = (down.T @ down + across.T @ across) / BEND_PRIOR_MM**2
    near = scipy.sparse.diags_array(1.0 / deviation_mm.ravel() ** 2)
    spreads = np.array(POSE_PRIOR) if pose_free else np.full(3, 1e-9)
    of_poses = scipy.sparse.diags_array(np.tile(1.0 / spreads**2, mirrors))
    return scipy.sparse.block_diag([smooth + near, of_poses]).tocsr()


# The first guess of surface and pose: a handful of numbers for which all ridges of two views meet at once. Single
# squares of ridges look the same a period on; the whole overlap does not.

_SEARCHED = 6000  # so many pixels show which of many guesses is best
APART_MM = 0.15  # moves that differ by less than this lead to the same place
OUTER = 0.9  # how much more the surface bulges for each 20 deg towards the side, over the bulge's standard deviation
LIKE_PLACES, MOVE_MM = 20.0, 0.05  # a move counts as so many measured ones, each with this standard deviation
_DOUBT = 0.01  # correlation that a number must gain to be believed one standard deviation from what the outlines show
MIN_CORRELATION = 0.2  # correlation below which nothing is changed


@dataclass(frozen=True, slots=True)
class RidgeSearchSettings(Checked):
    """Ranges in which the views are brought together: (reach, step)."""

    _group = "rolled.search"
    across_mm: tuple[float, float] = (1.6, 0.05)
    """Offset of the mirror's ridges against the front's around the finger: search range and step."""
    along_mm: tuple[float, float] = (0.3, 0.05)
    """The same along the finger."""
    deviations: Annotated[tuple[float, float, float], Limits(0, above=True)] = (0.2, 0.06, 0.2)
    """Standard deviations of what the outlines determine: the surface's bulge half-way between front and side (mm), the
    mirror's place along its normal (mm), and its turns (deg)."""
    candidates: Annotated[int, Limits(1, 50)] = 6
    """Number of best guesses that are refined."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("across_mm", "along_mm"):
            reach, step = getattr(self, name)
            require(0.0 <= reach <= 5.0 and step > 0.0, f"rolled.search.{name} must be (reach, step), both small.")


@dataclass(frozen=True, slots=True, eq=False)
class _ViewMatch:
    """Surface and pose at which two views' ridges lie on each other."""

    radius_mm: Array  # (n, m) to be added to the surface
    pose: tuple[float, float, float]  # turns (rad) and shift (mm) of the mirror
    correlation: float  # correlation of the ridges in the overlap


def search(
    chart: Chart, radius_mm: Array, front: ViewRidges, mirror: ViewRidges, settings: RidgeSearchSettings | None = None
) -> _ViewMatch:
    """Find how the surface `radius_mm` (n, m) bulges and where the mirror lies."""
    chosen = settings or RidgeSearchSettings()
    nothing = _ViewMatch(np.zeros(chart.shape), (0.0, 0.0, 0.0), 0.0)
    rows, columns = np.nonzero(mirror.known)
    if rows.size < 500:
        return nothing
    moved = _ridge_moves(chart, radius_mm, (front.sight, mirror.sight), (rows, columns))
    angle = chart.angle_rad[columns]
    side = np.sign(float(np.median(angle)))
    hump = np.sin(2 * angle) ** 2
    along = (chart.length_mm[rows] - float(chart.length_mm[rows].mean())) / 10.0
    by_bulge = moved[..., 0] * hump[:, None]
    outer = (np.abs(angle) - np.pi / 4) / np.deg2rad(20.0)
    by_bulges = by_bulge, by_bulge * along[:, None], by_bulge * outer[:, None]
    modes = np.stack([*np.moveaxis(moved[..., 1:], 2, 0), *by_bulges], axis=-1).astype(np.float32)  # (K, 2, 6)
    target = front.band[rows, columns]
    place = np.stack([columns, rows], axis=1).astype(np.float32)

    def score(moves: FloatArray, some: slice) -> float:
        seen = read(mirror.band, *(place[some] + moves).T, empty=0.0)
        there = target[some] - target[some].mean()
        seen = seen - seen.mean()
        power = float((seen**2).sum()) * float((there**2).sum())
        return float((seen * there).sum()) / float(np.sqrt(max(power, 1e-24)))

    bulge, shift, turn = chosen.deviations[0], chosen.deviations[1], float(np.deg2rad(chosen.deviations[2]))
    spread = np.array([turn, turn, shift, bulge, bulge, OUTER * bulge])

    def merit(values: Array, some: slice = slice(None)) -> float:
        return score(modes[some] @ values.astype(np.float32), some) - _DOUBT * float(((values / spread) ** 2).sum())

    few = slice(None, None, max(1, rows.size // _SEARCHED))
    # what the outlines may be wrong by, as one move of all ridges
    typical = np.sqrt(((np.median(modes, axis=0) * spread) ** 2).sum(axis=1)) + 1e-9
    guesses = []
    for move in itertools.product(*(_range(*pair) / chart.pitch_mm for pair in (chosen.across_mm, chosen.along_mm))):
        far = float(((np.array(move) / typical) ** 2).sum())
        guesses.append((score(np.array([move], dtype=np.float32), few) - _DOUBT * far, np.array(move)))
    scale = np.array([0.003, 0.001, 0.03, 0.03, 0.05, 0.03])
    simplex = np.vstack([np.zeros(6), np.eye(6)])
    options: Any = {"initial_simplex": simplex, "maxfev": 200, "xatol": 0.02, "fatol": 1e-4}
    minimize: Any = scipy.optimize.minimize

    def refined(start: Array, some: slice) -> tuple[float, Array]:
        done = minimize(lambda x: -merit(start + x * scale, some), np.zeros(6), method="Nelder-Mead", options=options)
        return -float(done.fun), start + done.x * scale

    # turns, shift and bulges that move all ridges by about so much, as likely as they can be
    weight = LIKE_PLACES / len(modes[few]) / (MOVE_MM / chart.pitch_mm) ** 2
    flat = modes[few].reshape(-1, modes.shape[2]).astype(np.float64)
    matrix = weight * flat.T @ flat + np.diag(1.0 / spread**2)
    starts = [
        np.asarray(np.linalg.solve(matrix, weight * flat.T @ np.tile(move, len(modes[few]))), dtype=np.float64)
        for move in _apart(guesses, chart.pitch_mm, chosen.candidates)
    ]
    _, at = max((refined(start, few) for start in starts), key=lambda item: item[0])
    _, at = refined(at, slice(None))
    best = score(modes @ at.astype(np.float32), slice(None))
    if best < MIN_CORRELATION:
        return _ViewMatch(nothing.radius_mm, nothing.pose, best)
    angle = chart.angle_rad
    there = (np.sign(angle) == side) * np.sin(2 * angle) ** 2 * (np.abs(angle) < np.pi / 2)
    rising = (chart.length_mm - float(chart.length_mm[rows].mean())) / 10.0
    rising = np.clip(rising, float(along.min()), float(along.max()))
    further = (np.abs(chart.angle_rad) - np.pi / 4) / np.deg2rad(20.0)
    radius = there[None] * (at[3] + at[4] * rising[:, None] + at[5] * further[None])
    return _ViewMatch(radius, (float(at[0]), float(at[1]), float(at[2])), best)


def _apart(guesses: list[tuple[float, Array]], pitch_mm: float, count: int) -> list[Array]:
    """The best moves (2,) of which no two are nearly the same."""
    found: list[Array] = []
    for _, move in sorted(guesses, key=lambda item: -item[0]):
        if all(float(np.abs(move - other).max()) * pitch_mm > APART_MM for other in found):
            found.append(move)
        if len(found) == count:
            break
    return found


def _range(reach: float, step: float) -> Array:
    count = int(np.floor(reach / step + 1e-9))
    return np.asarray(np.arange(-count, count + 1) * step, dtype=np.float64)
