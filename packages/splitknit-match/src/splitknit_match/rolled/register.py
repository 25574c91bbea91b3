"""Two views' ridges brought onto each other: by the finger's shape between its outlines, and the
mirror's pose."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.imaging.view import pixels_of
from splitknit.mirrors.reflection import Sight
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.rolled.chart import Chart, read
from splitknit_match.rolled.parameters import (
    ACROSS_CUT_MM,
    ACROSS_MM,
    ALONG_MM,
    APART_MM,
    BEND_PRIOR_MM,
    BULGE_MM,
    CANDIDATES,
    CORRELATED_MM,
    DEPTH_PRIOR_MM,
    DOUBT,
    FEW,
    KNOT_MM,
    LIKE_PLACES,
    MIN_CORRELATION,
    MOVE_MM,
    OUTER,
    OUTLINE_DEG,
    OUTLINE_PRIOR_MM,
    POSE_PRIOR,
    ROBUST,
    ROUNDS,
    SEARCHED,
    SHIFT_CUT_MM,
    SHIFT_MM,
    SIMPLEX,
    STEP_MM,
    TURN_CUT_DEG,
    TURN_DEG,
    UNSEEN_PRIOR_MM,
)

# Ridges by themselves: a relief without what is smooth in it.


def ridges_of(relief: FloatArray, known: BoolArray, pitch_mm: float) -> FloatArray:
    """(n, m) relief less its local mean over `known`, zero elsewhere."""
    filled = np.where(known, relief, 0.0).astype(np.float32)
    mean = gaussian_over(filled, known, 0.32 / pitch_mm)  # mm: the ridge band of this package
    return np.where(known, filled - mean, 0.0).astype(np.float32)


def gaussian_over(values: FloatArray, known: BoolArray, sigma: float) -> FloatArray:
    """Gaussian mean over `known` of values that are zero elsewhere."""
    fraction = np.maximum(cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma), 1e-3)
    return cv2.GaussianBlur(values, (0, 0), sigma) / fraction


def _evened(band: FloatArray, known: BoolArray, pitch_mm: float) -> FloatArray:
    """(n, m) ridge band over its local standard deviation in 1 mm: two ridges."""
    power = gaussian_over(np.where(known, band * band, 0).astype(np.float32), known, 1.0 / pitch_mm)
    typical = float(np.median(power[known])) if known.any() else 1.0
    return np.asarray(band / np.sqrt(power + (0.1 * typical + 1e-20)), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What moves the surface and the mirrors."""

    radius_mm: Array  # (n, m) to be added to the surface on the chart
    # turns (rad) and shift (mm) of each mirror, see :meth:`Plane.moved`
    poses: tuple[tuple[float, ...], ...]
    correlations: tuple[float, ...]  # of each mirror's ridges with the front's where both see them


def _shifts_by(
    sight: Sight, points: Array, rays: Array, steps: tuple[Array, Array]
) -> tuple[Array, Array]:
    """How a view's ridges move on the chart when the surface or the mirror does: (K, 2) columns and
    rows for each mm of the surface, and (K, 2, 3) for the mirror's turns (rad) and shift (mm), zero
    for the front. `points`: (K, 3) on the surface; `rays`: (K, 3) along which it moves; `steps`:
    (K, 3) by one column and by one row of the chart.
    """

    def pixels(places: Array, view: Sight = sight) -> Array:  # in double precision
        return pixels_of(view.camera, view.to_view(places))

    here = pixels(points)
    across, down = (pixels(points + 0.5 * s) - pixels(points - 0.5 * s) for s in steps)
    jacobian = np.stack([across, down], axis=-1)  # (K, 2 pixel, 2 chart)
    inverse = np.linalg.pinv(jacobian, rcond=0.05)
    small = 1e-2
    by_radius = np.einsum("kij,kj->ki", inverse, (pixels(points + small * rays) - here) / small)
    by_pose = np.zeros((len(points), 2, 3))
    if sight.plane is not None:
        for k in range(3):
            change = np.zeros(3)
            change[k] = 1e-3
            moved = replace(sight, plane=sight.plane.moved((change[0], change[1]), change[2]))
            by_pose[:, :, k] = np.einsum(
                "kij,kj->ki", inverse, (pixels(points, moved) - here) / 1e-3
            )
    return by_radius, by_pose


@dataclass(frozen=True, slots=True, eq=False)
class ViewRidges:
    """A view's ridges on the chart."""

    sight: Sight
    band: FloatArray  # (n, m) ridge band, zero where the view does not show the finger
    known: BoolArray  # (n, m) where it does; of a mirror, where the front does, too


def align(
    chart: Chart, radius_mm: Array, front: ViewRidges, mirrors: Sequence[ViewRidges]
) -> Correction:
    """Bend the surface and move the mirrors until their ridges lie on the front's, all of them at
    once.

    Gauss-Newton on the difference of the ridge bands, each of unit local contrast. Unknown are the
    knots of a smooth correction of the surface, which all views share, and the mirrors' poses, with
    priors on both. Ridges must lie within a quarter of a period to begin with: see :func:`search`.
    `chart`, `radius_mm`: the surface (n, m); `front`, `mirrors`: the views; the mirrors' are
    brought onto the front's. Source: Lucas and Kanade 1981, An iterative image registration
    technique; Baker and Matthews 2004, eq. 10.
    """
    every, knots = _knots(chart)
    count = knots[0] * knots[1]
    usable = [k for k, mirror in enumerate(mirrors) if mirror.known.sum() >= FEW]
    parts = {k: _Part(chart, radius_mm, front, mirrors[k]) for k in usable}
    weight = (chart.pitch_mm / CORRELATED_MM) ** 2  # neighbouring pixels are correlated
    prior = _priors(chart, np.any([mirror.known for mirror in mirrors], axis=0), len(mirrors))
    values = np.zeros(count + 3 * len(mirrors))
    best = -np.inf
    for _ in range(ROUNDS):
        normal = prior.copy()
        right = -prior @ values
        scores = np.zeros(len(mirrors))
        for k, part in parts.items():
            matrix, residual, scores[k] = part.linearised(
                values[:count], values[count + 3 * k : count + 3 * k + 3]
            )
            # poses before and after its own
            before, after = (
                scipy.sparse.csr_array((len(residual), 3 * n)) for n in (k, len(mirrors) - k - 1)
            )
            matrix = scipy.sparse.hstack(
                [matrix[:, :count], before, matrix[:, count:], after]
            ).tocsr()
            trust = scipy.sparse.diags_array(weight / (1.0 + (residual / ROBUST) ** 2))
            normal = normal + matrix.T @ trust @ matrix
            right = right + matrix.T @ (trust @ residual)
        if scores.mean() > best:
            best = scores.mean()
            moved = values
            correlations = scores
        values = values + scipy.sparse.linalg.spsolve(scipy.sparse.csc_array(normal), right)
    grid = moved[:count].reshape(knots).astype(np.float32)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) / every for n in chart.shape[::-1]))
    smooth = cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    smooth = cv2.GaussianBlur(smooth, (0, 0), 0.35 * every)
    poses = tuple(map(tuple, moved[count:].reshape(-1, 3).tolist()))
    return Correction(smooth.astype(float), poses, tuple(correlations.tolist()))


class _Part:
    """One mirror's fraction in the equations."""

    def __init__(
        self, chart: Chart, radius_mm: Array, front: ViewRidges, mirror: ViewRidges
    ) -> None:
        self.rows, self.columns = np.nonzero(mirror.known)
        self.modes = _ridge_moves(
            chart, radius_mm, (front.sight, mirror.sight), (self.rows, self.columns)
        )
        every, knots = _knots(chart)
        self.spread = _hats(self.columns / every, self.rows / every, knots)
        band = _evened(mirror.band, mirror.known, chart.pitch_mm)
        self.fields = band, np.gradient(band, axis=1), np.gradient(band, axis=0)
        self.target = _evened(front.band, mirror.known, chart.pitch_mm)[self.rows, self.columns]

    def linearised(self, depths: Array, pose: Array) -> tuple[Any, Array, float]:
        """Derivatives (K, knots + 3) of the mirror's ridges, the residuals (K,), and the
        correlation."""
        moved = self.modes[..., 0] * (self.spread @ depths)[:, None] + self.modes[..., 1:] @ pose
        place = [self.rows + moved[:, 1], self.columns + moved[:, 0]]
        seen, across, down = (
            scipy.ndimage.map_coordinates(field, place, order=1).astype(float)
            for field in self.fields
        )
        score = float(np.corrcoef(seen, self.target)[0, 1]) if seen.std() > 0 else 0.0
        jacobian = across[:, None] * self.modes[:, 0] + down[:, None] * self.modes[:, 1]  # (K, 4)
        by_knots = scipy.sparse.diags_array(jacobian[:, 0]) @ self.spread
        matrix: Any = scipy.sparse.hstack(
            [by_knots, scipy.sparse.csr_array(jacobian[:, 1:])]
        ).tocsr()
        return matrix, self.target - seen, score


def _ridge_moves(
    chart: Chart,
    radius_mm: Array,
    sights: tuple[Sight, Sight],
    at: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> Array:
    """(K, 2, 4) columns and rows by which the mirror's ridges move against the front's: by mm of
    surface, by pose."""
    points = chart.points(radius_mm)
    rays = chart.rays()[1][at]
    steps = np.gradient(points, axis=1)[at], np.gradient(points, axis=0)[at]
    (of_front, _), (of_mirror, by_pose) = (
        _shifts_by(sight, points[at], rays, steps) for sight in sights
    )
    return np.concatenate([(of_mirror - of_front)[..., None], by_pose], axis=-1)


def _hats(columns: Array, rows: Array, knots: tuple[int, int]) -> scipy.sparse.csr_array:
    """(K, knots) bilinear weights of the knots at places given in knots."""
    row0 = np.clip(np.floor(rows).astype(int), 0, knots[0] - 2)
    column0 = np.clip(np.floor(columns).astype(int), 0, knots[1] - 2)
    down = rows - row0
    right = columns - column0
    weights = np.r_[(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
    first = row0 * knots[1] + column0
    places = np.r_[first, first + 1, first + knots[1], first + knots[1] + 1]
    shape = (len(columns), knots[0] * knots[1])
    return scipy.sparse.coo_array(
        (weights, (np.tile(np.arange(len(columns)), 4), places)), shape=shape
    ).tocsr()


def _knots(chart: Chart) -> tuple[int, tuple[int, int]]:
    """Pixels of the chart from one knot of the correction to the next, and rows and columns of
    knots."""
    every = max(2, round(KNOT_MM / chart.pitch_mm))
    return every, (-(-(chart.shape[0] - 1) // every) + 1, -(-(chart.shape[1] - 1) // every) + 1)


def _priors(chart: Chart, seen: BoolArray, mirrors: int) -> Any:
    """Inverse covariance of knots and poses; away from what two views show (`seen`) the surface
    stays as it is."""
    every, (rows, columns) = _knots(chart)
    step = float(chart.angle_rad[1] - chart.angle_rad[0]) * every
    degrees = np.rad2deg(float(chart.angle_rad[0]) + step * np.arange(columns))
    near = np.exp(-0.5 * ((np.abs(degrees) - 90.0) / OUTLINE_DEG) ** 2)
    deviation = DEPTH_PRIOR_MM * (OUTLINE_PRIOR_MM / DEPTH_PRIOR_MM) ** near
    reach = cv2.dilate(seen.astype(np.uint8), np.ones((2 * every + 1, 2 * every + 1), np.uint8))
    row = np.minimum(np.arange(rows) * every, seen.shape[0] - 1)
    column = np.minimum(np.arange(columns) * every, seen.shape[1] - 1)
    deviation = np.where(reach[np.ix_(row, column)] > 0, deviation[None], UNSEEN_PRIOR_MM)
    # second differences from knot to knot
    down = scipy.sparse.kron(np.diff(np.eye(rows), 2, axis=0), scipy.sparse.eye_array(columns))
    across = scipy.sparse.kron(scipy.sparse.eye_array(rows), np.diff(np.eye(columns), 2, axis=0))
    smooth = (down.T @ down + across.T @ across) / BEND_PRIOR_MM**2
    still = scipy.sparse.diags_array(1.0 / deviation.ravel() ** 2)
    of_poses = scipy.sparse.diags_array(np.tile(1.0 / np.array(POSE_PRIOR) ** 2, mirrors))
    return scipy.sparse.block_diag([smooth + still, of_poses]).tocsr()


# The first guess of surface and pose: a handful of numbers for which all ridges of two views meet
# at once. Single
# squares of ridges look the same a period on; the whole overlap does not.


def search(  # noqa: PLR0915
    chart: Chart, radius_mm: Array, front: ViewRidges, mirror: ViewRidges, *, cut: bool = False
) -> Correction:
    """Find how the surface `radius_mm` (n, m) bulges and where the mirror lies; `cut`: whose view
    is cut."""
    rows, columns = np.nonzero(mirror.known)
    if rows.size < FEW:
        return Correction(np.zeros(chart.shape), ((0.0, 0.0, 0.0),), (0.0,))
    ridge_moves = _ridge_moves(chart, radius_mm, (front.sight, mirror.sight), (rows, columns))
    angle = chart.angle_rad[columns]
    side = np.sign(float(np.median(angle)))
    middle = float(chart.length_mm[rows].mean())
    along = (chart.length_mm[rows] - middle) / 10.0
    outer = (np.abs(angle) - np.pi / 4) / np.deg2rad(20.0)
    bulge = ridge_moves[..., 0] * (np.sin(2 * angle) ** 2)[:, None]
    bulges = bulge, bulge * along[:, None], bulge * outer[:, None]
    # (K, 2, 6)
    modes = np.stack([*np.moveaxis(ridge_moves[..., 1:], 2, 0), *bulges], axis=-1).astype(
        np.float32
    )
    target = front.band[rows, columns]
    place = np.stack([columns, rows], axis=1).astype(np.float32)
    turn = float(np.deg2rad(TURN_CUT_DEG if cut else TURN_DEG))
    spread = np.array(
        [turn, turn, SHIFT_CUT_MM if cut else SHIFT_MM, BULGE_MM, BULGE_MM, OUTER * BULGE_MM]
    )
    few = slice(None, None, max(1, rows.size // SEARCHED))
    every = slice(None)

    def score(moves: FloatArray, some: slice) -> float:
        """Correlation of the mirror's ridges, moved on the chart, with the front's."""
        values = read(mirror.band, *(place[some] + moves).T, empty=0.0)
        wanted = target[some] - target[some].mean()
        values = values - values.mean()
        power = float((values**2).sum()) * float((wanted**2).sum())
        return float((values * wanted).sum()) / float(np.sqrt(max(power, 1e-24)))

    def refined(start: Array, some: slice) -> tuple[float, Array]:
        """The best numbers near `start`, and their merit."""

        def loss(step: Array) -> float:
            numbers = start + step * SIMPLEX
            correlation = score(modes[some] @ numbers.astype(np.float32), some)
            return DOUBT * float(((numbers / spread) ** 2).sum()) - correlation

        minimum = minimize(loss, np.zeros(6), method="Nelder-Mead", options=options)
        return -float(minimum.fun), start + minimum.x * SIMPLEX

    options: Any = {
        "initial_simplex": np.eye(7, 6, -1),
        "maxfev": 200,
        "xatol": 0.02,
        "fatol": 1e-4,
    }
    minimize: Any = scipy.optimize.minimize
    # what the outlines may be wrong by, as one move of all ridges
    typical = np.sqrt(((np.median(modes, axis=0) * spread) ** 2).sum(axis=1)) + 1e-9
    guesses = []
    reaches = ACROSS_CUT_MM if cut else ACROSS_MM, ALONG_MM
    for move in itertools.product(*(_range(reach) / chart.pitch_mm for reach in reaches)):
        far = float(((np.array(move) / typical) ** 2).sum())
        guesses.append(
            (score(np.array([move], dtype=np.float32), few) - DOUBT * far, np.array(move))
        )
    # turns, shift and bulges that move all ridges by about so much, as likely as they can be
    count = len(modes[few])
    weight = LIKE_PLACES / count / (MOVE_MM / chart.pitch_mm) ** 2
    flat = modes[few].reshape(-1, modes.shape[2]).astype(float)
    matrix = weight * flat.T @ flat + np.diag(1.0 / spread**2)
    starts: list[Array] = []  # the best moves of which no two are nearly the same
    for _, guess in sorted(guesses, key=itemgetter(0), reverse=True):
        apart = all(
            float(np.abs(guess - start).max()) * chart.pitch_mm > APART_MM for start in starts
        )
        if apart and len(starts) < CANDIDATES:
            starts.append(guess)
    solved = [np.linalg.solve(matrix, weight * flat.T @ np.tile(start, count)) for start in starts]
    _, numbers = max((refined(start, few) for start in solved), key=itemgetter(0))
    _, numbers = refined(numbers, every)
    correlation = score(modes @ numbers.astype(np.float32), every)
    if correlation < MIN_CORRELATION:
        return Correction(np.zeros(chart.shape), ((0.0, 0.0, 0.0),), (correlation,))
    angle = chart.angle_rad
    bulged = (np.sign(angle) == side) * np.sin(2 * angle) ** 2 * (np.abs(angle) < np.pi / 2)
    rising = np.clip((chart.length_mm - middle) / 10.0, float(along.min()), float(along.max()))
    further = (np.abs(angle) - np.pi / 4) / np.deg2rad(20.0)
    radius = bulged[None] * (numbers[3] + numbers[4] * rising[:, None] + numbers[5] * further[None])
    return Correction(radius, (tuple(numbers[:3].tolist()),), (correlation,))


def _range(reach: float) -> Array:
    count = int(np.floor(reach / STEP_MM + 1e-9))
    return np.arange(-count, count + 1, dtype=float) * STEP_MM
