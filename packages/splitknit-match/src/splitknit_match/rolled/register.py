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

from splitknit.imaging.geometry import sampled_at, smoothed
from splitknit.imaging.view import pixels_of
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.rolled.chart import Chart, Sight

# Ridges by themselves: a relief without what is smooth in it.


def ridges_of(relief: FloatArray, known: BoolArray, pitch_mm: float) -> FloatArray:
    """(n, m) relief less its local mean over `known`, zero elsewhere."""
    mean = smoothed(relief, known, 0.32 / pitch_mm)  # mm: the ridge band of this package
    return np.where(known, relief - mean, 0.0)


def _evened(band: FloatArray, known: BoolArray, pitch_mm: float) -> FloatArray:
    """(n, m) ridge band over its local standard deviation in 1 mm: two ridges."""
    power = smoothed(band * band, known, 1.0 / pitch_mm)
    typical = float(np.median(power[known])) if known.any() else 1.0
    return np.asarray(band / np.sqrt(power + (0.1 * typical + 1e-20)), dtype=np.float32)


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """Of two lists of values; 0 where one has nothing but its mean."""
    return float(np.corrcoef(a, b)[0, 1]) if min(np.ptp(a), np.ptp(b)) > 1e-12 else 0.0


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
        for k, change in enumerate(1e-3 * np.eye(3)):
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


_CORRELATED_MM = 0.3
"""Ridges are independent at about this distance. Chosen on: simulated fingers (11, 101, 102 and 201
to 204 between two mirrors)."""
_ROBUST = 1.0
"""Difference of two views' ridges, of unit contrast, from which it counts less and less. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_ROUNDS = 12
"""Rounds of the registration, at most. Chosen on: simulated fingers (11, 101, 102 and 201 to 204
between two mirrors)."""
_FEW = 500
"""Pixels that both views show; with fewer a mirror is left as it is, in px. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


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
    usable = [k for k, mirror in enumerate(mirrors) if mirror.known.sum() >= _FEW]
    parts = {k: _Part(chart, radius_mm, front, mirrors[k]) for k in usable}
    weight = (chart.pitch_mm / _CORRELATED_MM) ** 2  # neighbouring pixels are correlated
    prior = _priors(chart, np.any([mirror.known for mirror in mirrors], axis=0), len(mirrors))
    values = np.zeros(count + 3 * len(mirrors))
    best = -np.inf
    for _ in range(_ROUNDS):
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
            trust = scipy.sparse.diags_array(weight / (1.0 + (residual / _ROBUST) ** 2))
            normal = normal + matrix.T @ trust @ matrix
            right = right + matrix.T @ (trust @ residual)
        if scores.mean() > best:
            best = scores.mean()
            moved = values
            correlations = scores
        values = values + scipy.sparse.linalg.spsolve(scipy.sparse.csc_array(normal), right)
    down, across = (_hats(n, every, k) for n, k in zip(chart.shape, knots, strict=True))
    smooth = cv2.GaussianBlur(down @ moved[:count].reshape(knots) @ across.T, (0, 0), 0.35 * every)
    poses = tuple(map(tuple, moved[count:].reshape(-1, 3).tolist()))
    return Correction(np.asarray(smooth, float), poses, tuple(correlations.tolist()))


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
        down, across = (_hats(n, every, k) for n, k in zip(chart.shape, knots, strict=True))
        weights = scipy.sparse.kron(scipy.sparse.csr_array(down), across)
        self.spread: Any = weights.tocsr()[self.rows * chart.shape[1] + self.columns]
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
        score = _correlation(seen, self.target)
        jacobian = across[:, None] * self.modes[:, 0] + down[:, None] * self.modes[:, 1]  # (K, 4)
        by_knots = scipy.sparse.diags_array(jacobian[:, 0]) @ self.spread
        matrix = scipy.sparse.hstack([by_knots, scipy.sparse.csr_array(jacobian[:, 1:])]).tocsr()
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


def _hats(pixels: int, every: int, knots: int) -> Array:
    """(pixels, knots) linear weights of knots `every` pixels apart along a line of pixels."""
    return np.maximum(1.0 - np.abs(np.arange(pixels)[:, None] / every - np.arange(knots)), 0.0)


_KNOT_MM = 2.5
"""Distance of the knots of the correction of the surface. Chosen on: simulated fingers (11, 101,
102 and 201 to 204 between two mirrors)."""


def _knots(chart: Chart) -> tuple[int, tuple[int, int]]:
    """Pixels of the chart from one knot of the correction to the next, and rows and columns of
    knots."""
    every = max(2, round(_KNOT_MM / chart.pitch_mm))
    return every, (-(-(chart.shape[0] - 1) // every) + 1, -(-(chart.shape[1] - 1) // every) + 1)


_POSE_PRIOR = (0.004, 0.002, 0.05)
"""Standard deviations of a mirror's two turns (rad) and its shift (mm), in rad, rad, mm. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_DEPTH_PRIOR_MM = 0.15
"""Standard deviation of the surface against where it is taken to be. Chosen on: simulated fingers
(11, 101, 102 and 201 to 204 between two mirrors)."""
_UNSEEN_PRIOR_MM = 0.03
"""The same standard deviation where no two views show the surface. Chosen on: simulated fingers
(11, 101, 102 and 201 to 204 between two mirrors)."""
_OUTLINE_PRIOR_MM = 0.05
"""The same standard deviation where the front's outline determines the surface. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_OUTLINE_DEG = 15.0
"""The front's outline determines the surface so near to a right angle from the front. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_BEND_PRIOR_MM = 0.04
"""Standard deviation of the correction's second difference from knot to knot. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


def _priors(chart: Chart, seen: BoolArray, mirrors: int) -> Any:
    """Inverse covariance of knots and poses; away from what two views show (`seen`) the surface
    stays as it is."""
    every, (rows, columns) = _knots(chart)
    step = float(chart.angle_rad[1] - chart.angle_rad[0]) * every
    degrees = np.rad2deg(float(chart.angle_rad[0]) + step * np.arange(columns))
    near = np.exp(-0.5 * ((np.abs(degrees) - 90.0) / _OUTLINE_DEG) ** 2)
    deviation = _DEPTH_PRIOR_MM * (_OUTLINE_PRIOR_MM / _DEPTH_PRIOR_MM) ** near
    reach = cv2.dilate(seen.astype(np.uint8), np.ones((2 * every + 1, 2 * every + 1), np.uint8))
    row = np.minimum(np.arange(rows) * every, seen.shape[0] - 1)
    column = np.minimum(np.arange(columns) * every, seen.shape[1] - 1)
    deviation = np.where(reach[np.ix_(row, column)] > 0, deviation[None], _UNSEEN_PRIOR_MM)
    # second differences from knot to knot
    down = scipy.sparse.kron(np.diff(np.eye(rows), 2, axis=0), scipy.sparse.eye_array(columns))
    across = scipy.sparse.kron(scipy.sparse.eye_array(rows), np.diff(np.eye(columns), 2, axis=0))
    smooth = (down.T @ down + across.T @ across) / _BEND_PRIOR_MM**2
    still = scipy.sparse.diags_array(1.0 / deviation.ravel() ** 2)
    of_poses = scipy.sparse.diags_array(np.tile(1.0 / np.array(_POSE_PRIOR) ** 2, mirrors))
    return scipy.sparse.block_diag([smooth + still, of_poses]).tocsr()


# The first guess of surface and pose: a handful of numbers for which all ridges of two views meet
# at once. Single squares of ridges look the same a period on; the whole overlap does not.


_SEARCHED = 6000
"""So many pixels show which of many guesses is best, in px. Chosen on: speed."""
_APART_MM = 0.15
"""Moves that differ by less than this lead to the same place. Chosen on: simulated fingers (11,
101, 102 and 201 to 204 between two mirrors)."""
_OUTER = 0.9
"""How much more the surface bulges for each 20 deg towards the side, over the bulge's standard
deviation. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_LIKE_PLACES = 20.0
"""A move of a mirror counts as so many measured places. Chosen on: simulated fingers (11, 101, 102
and 201 to 204 between two mirrors)."""
_MOVE_MM = 0.05
"""Standard deviation of each of these places. Chosen on: simulated fingers (11, 101, 102 and 201 to
204 between two mirrors)."""
_DOUBT = 0.01
"""Correlation that a number must gain to be believed one standard deviation from what the outlines
show. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
MIN_CORRELATION = 0.2
"""Correlation of two views' ridges below which nothing is changed. Chosen on: simulated fingers
(11, 101, 102 and 201 to 204 between two mirrors)."""
_ACROSS_MM = 1.6
"""Largest offset of the mirror's ridges against the front's around the finger. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_ACROSS_CUT_MM = 3.0
"""The same offset of views that are cut: their mirrors' poses are known less well. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_ALONG_MM = 0.3
"""Largest offset of the mirror's ridges along the finger. Chosen on: simulated fingers (11, 101,
102 and 201 to 204 between two mirrors)."""
_BULGE_MM = 0.2
"""Standard deviation of the surface's bulge half-way between front and side, where outlines
determine it. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_SHIFT_MM = 0.06
"""Standard deviation of the mirror's place along its normal, where outlines determine it. Chosen
on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_TURN_DEG = 0.2
"""Standard deviation of the mirror's turns, where outlines determine them. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_SHIFT_CUT_MM = 0.6
"""Standard deviation of the place of a mirror whose view is cut. Chosen on: simulated fingers (11,
101, 102 and 201 to 204 between two mirrors)."""
_TURN_CUT_DEG = 0.6
"""Standard deviation of the turns of a mirror whose view is cut. Chosen on: simulated fingers (11,
101, 102 and 201 to 204 between two mirrors)."""
_CANDIDATES = 6
"""Best guesses that are refined. Chosen on: speed."""
_SIMPLEX = np.array([0.003, 0.001, 0.03, 0.03, 0.05, 0.03])
"""First steps of the refinement: two turns (rad), shift and bulges (mm), in rad, rad, mm. Chosen
on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


def search(  # noqa: PLR0915
    chart: Chart, radius_mm: Array, front: ViewRidges, mirror: ViewRidges, *, cut: bool = False
) -> Correction:
    """Find how the surface `radius_mm` (n, m) bulges and where the mirror lies; `cut`: whose view
    is cut."""
    rows, columns = np.nonzero(mirror.known)
    if rows.size < _FEW:
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
    turn = float(np.deg2rad(_TURN_CUT_DEG if cut else _TURN_DEG))
    spread = np.array(
        [turn, turn, _SHIFT_CUT_MM if cut else _SHIFT_MM, _BULGE_MM, _BULGE_MM, _OUTER * _BULGE_MM]
    )
    few = slice(None, None, max(1, rows.size // _SEARCHED))
    every = slice(None)

    def score(moves: FloatArray, some: slice) -> float:
        """Correlation of the mirror's ridges, moved on the chart, with the front's."""
        column, row = (place[some] + moves).T
        values = sampled_at(mirror.band, column, row, outside=0.0)
        return _correlation(values, target[some])

    def refined(start: Array, some: slice) -> tuple[float, Array]:
        """The best numbers near `start`, and their merit."""

        def loss(step: Array) -> float:
            numbers = start + step * _SIMPLEX
            correlation = score(modes[some] @ numbers.astype(np.float32), some)
            return _DOUBT * float(((numbers / spread) ** 2).sum()) - correlation

        minimum = minimize(loss, np.zeros(6), method="Nelder-Mead", options=options)
        return -float(minimum.fun), start + minimum.x * _SIMPLEX

    options = {
        "initial_simplex": np.eye(7, 6, -1),
        "maxfev": 200,
        "xatol": 0.02,
        "fatol": 1e-4,
    }
    minimize: Any = scipy.optimize.minimize
    # what the outlines may be wrong by, as one move of all ridges
    typical = np.sqrt(((np.median(modes, axis=0) * spread) ** 2).sum(axis=1)) + 1e-9
    guesses = []
    reaches = _ACROSS_CUT_MM if cut else _ACROSS_MM, _ALONG_MM
    steps = (0.05 * np.arange(-n, n + 1) for n in (round(reach / 0.05) for reach in reaches))  # mm
    for move in itertools.product(*(offsets / chart.pitch_mm for offsets in steps)):
        far = float(((np.array(move) / typical) ** 2).sum())
        guesses.append(
            (score(np.array([move], dtype=np.float32), few) - _DOUBT * far, np.array(move))
        )
    # turns, shift and bulges that move all ridges by about so much, as likely as they can be
    count = len(modes[few])
    weight = _LIKE_PLACES / count / (_MOVE_MM / chart.pitch_mm) ** 2
    flat = modes[few].reshape(-1, modes.shape[2]).astype(float)
    matrix = weight * flat.T @ flat + np.diag(1.0 / spread**2)
    starts: list[Array] = []  # the best moves of which no two are nearly the same
    for _, guess in sorted(guesses, key=itemgetter(0), reverse=True):
        apart = all(
            float(np.abs(guess - start).max()) * chart.pitch_mm > _APART_MM for start in starts
        )
        if apart and len(starts) < _CANDIDATES:
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
