"""How slopes shade the images of a sensor, from balls of known radius: pressed into a gel, or lying free.

Every point of a ball has a known slope, so images of balls are pairs of intensities and slopes. Two things are fitted
to them: physics (where each light is, and how much light comes from everywhere), for people to judge a sensor by, and
a polynomial from intensities and place to slopes, which carries what physics leaves out. How rich the polynomial is,
balls that are left out in turns decide. The balls' centres are found with it, all at once, since a centre that is off
is a constant slope. The plane between the balls holds the slope of zero.

References
----------
M. K. Johnson, F. Cole, A. Raj and E. H. Adelson, "Microgeometry capture using an elastomeric sensor", SIGGRAPH 2011.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from splitknit.calibration.sphere import find_ball
from splitknit.errors import check_stack, require
from splitknit.imaging.band import bin_mean, over_flat
from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.shading import (
    BETWEEN,
    Array,
    Shading,
    facing_level,
    flat_of_fall_off,
    place_terms,
    shading_terms,
    term_count,
)

_BLOCK_PX = 24.0
"""Radius of a ball in the blocks of pixels that are fitted: noise of pixels would bend the polynomial."""
_FITTED = 0.72
"""Part of a ball's radius inside which it is fitted: slopes up to 1.04. Further out a gel leaves the ball."""
_FITTED_BETWEEN = 0.62
"""The same where the gel between the balls stands for a photograph of the flat gel, whose light is then known less
well: slopes up to 0.79."""
CAP = 0.6
"""Part of a ball's radius inside which heights are judged: slopes up to 0.75."""
_APART = 1.6
"""Radii around a ball beyond which the gel lies flat."""
_PLANE_SAMPLES = 8000
_FOLDS = 8
_SPREAD, _COVERED = 5, 0.6
"""Terms may vary over the field where more balls than this span this part of its width and height."""
_SIMPLER = 1.05
"""A simpler polynomial is taken where it errs at most so many times as much as the best one."""
_BINS = 9
_FEW = 4
"""Balls from which one is left out at a time; of fewer, sectors of them are."""
_CAP_DEGREE = 6
"""Of the polynomial whose gradient stands for the smooth part of a cap's slope errors."""
_LADDER = tuple(itertools.product((False, True), (1, 2, 3), ("none", "linear", "full")))
"""Polynomials that are tried: relative intensities or not, degree, which of its terms also vary over the field."""
_LARGEST = 200
"""Terms of a polynomial at most."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadingFit:
    """A calibration with what its report shows."""

    shading: Shading
    balls: Array
    """(N, 4) press, column, row of the centre, radius of the outline, all in pixels."""
    used: BoolArray
    """(N,) balls that were fitted; the others are damaged or cut."""
    cap_rms_um: Array
    """(N,) rms error of the height of each cap within 0.6 of the radius, of the ball left out; NaN where not used."""
    cap_gain: Array
    """(N,) height of each cap over the ball's, likewise."""
    cap_errors: tuple[Array, ...]
    """Of each used ball (n, 3): column, row, error of the height in um."""
    error_by_slope: Array
    """(B, 3) slope, mean error, rms error of a slope's part, of balls left out."""
    tried: tuple[dict[str, Any], ...]
    """Polynomials with their errors on balls left out."""
    notes: tuple[str, ...]


def calibrate_shading(
    balls: Sequence[FloatArray],
    flat: FloatArray | None,
    radius_mm: float,
    spacing_mm: float | None = None,
    centres: Sequence[Array] | None = None,
) -> ShadingFit:
    """Calibrate a sensor's shading on balls.

    Parameters
    ----------
    balls : images (L, H, W) of balls, linear light; several where one ball was pressed in many places
    flat : (L, h, w) images of the sensor pressed on nothing, on the grid of
        :func:`splitknit.imaging.band.coarse_flat`; None: of a ball lying free, without; where `spacing_mm` is given, of
        balls between which the gel lies flat: its light is then taken from there
    radius_mm : of the balls
    spacing_mm : distance of neighbouring balls in a lattice, which gives the scale; else the outlines' radius does
    centres : for each of `balls` (N, 2) or (N, 3), columns and rows in pixels and radii; found where None

    Returns
    -------
    ShadingFit

    Raises
    ------
    BadInput
        If no balls are found, the images differ in size, or the numbers are none.

    Examples
    --------
    >>> fit = calibrate_shading([balls], flat, radius_mm=0.2475, spacing_mm=1.0)  # doctest: +SKIP
    >>> write_shading("shading.npz", fit.shading)  # doctest: +SKIP
    """
    require(len(balls) > 0, "give photographs of balls, or of one ball.")
    require(0 < radius_mm < 1e4, f"`radius_mm` must be a positive number, not {radius_mm}.")
    require(spacing_mm is None or 0 < spacing_mm < 1e4, f"`spacing_mm` must be a positive number, not {spacing_mm}.")
    stacks = [check_stack(one, least=3, name="the photographs of balls") for one in balls]
    between = flat is None and spacing_mm is not None
    if between:
        require(
            centres is not None, "without photographs of the flat gel the balls are not found; give their `centres`."
        )
        light = fall_off_between(stacks, [_given(one, stacks[0].shape[1:]) for one in centres or ()])
        flat = flat_of_fall_off(light, stacks[0].shape[1:])
    if flat is not None:
        stacks = [over_flat(one, flat) for one in stacks]
        stacks = [one / np.float32(facing_level(one)) for one in stacks]
    size = stacks[0].shape[1:]
    require(all(one.shape == stacks[0].shape for one in stacks), "all photographs of balls must be of one size.")
    found = [
        find_balls(one, flat is None) if centres is None else _given(centres[k], size) for k, one in enumerate(stacks)
    ]
    outlines = np.concatenate([np.column_stack([np.full(len(some), k), some]) for k, some in enumerate(found)])
    require(len(outlines) > 0, "no balls were found in the photographs; give their `centres`.")
    notes = []
    if spacing_mm is not None:
        pitch_mm = spacing_mm / lattice_spacing(found[0][:, :2])
    else:
        pitch_mm = radius_mm / float(np.median(outlines[:, 3]))
        if flat is not None:
            notes.append(
                "the scale is that of the balls' outlines, as if they were pressed in to their equator; give the "
                "distance of the balls (--pitch), or their centres with radii, where they are not."
            )
    data = _Data(stacks, radius_mm / pitch_mm, flat is not None, between)
    if flat is not None and not data.covered(outlines):
        notes.append(
            "the balls do not lie all over the field: lights are taken to shade slopes alike everywhere, and errors "
            "far from the balls are larger than stated; press balls all over it, if need be one after the other."
        )
    centre, used, first = _joint(data, outlines)
    if spacing_mm is not None:  # centres are better than outlines, on which lights from the side pull
        pitch_mm = spacing_mm / lattice_spacing(centre[(centre[:, 0] == 0) & used, 1:])
        data.radius_px = radius_mm / pitch_mm
        centre, used, first = _joint(data, np.column_stack([centre, outlines[:, 3]]))
    units = _units(data, centre, used, first)
    plane = data.flat_samples(outlines) if data.plane else None
    model, without, tried = _chosen(data, centre, used, units, plane)
    um = 1000.0 * radius_mm
    tried = tuple(one | ({"cap_um": um * one["cap_um"]} if "cap_um" in one else {}) for one in tried)
    errors, by_slope, spent = _errors_left_out(data, centre, units, without)
    caps = [(u.ball, *_cap_error(data, centre[u.ball], m)) for u, m in zip(units, without, strict=True)]
    caps = list({ball: (ball, error, gain) for ball, error, gain in caps}.values())
    rms, gains = np.full(len(centre), np.nan), np.full(len(centre), np.nan)
    for ball, error, gain in caps:
        rms[ball], gains[ball] = um * float(np.sqrt((error[:, 2] ** 2).mean())), gain
    lights = len(data.stacks[0])
    physics, left = _physics(data, centre, units, plane, pitch_mm)
    shading = Shading(
        pitch_mm=pitch_mm,
        image_size=data.size,
        direction=physics[:, :3],
        nearness=physics[:, 3],
        ambient=physics[:, 4],
        fall_off=light if between else np.zeros((lights, 6)) if flat is None else fall_off_terms(flat),
        relative=model.relative,
        degree=model.degree,
        weights=model.weights,
        covariance=_covariance(data, model, units, plane),
        deviation=by_slope[:, 2],
        max_slope=float(by_slope[-1, 0]),
        height_mm_per_slope=float(np.sqrt(np.nanmean(rms**2)) / 1000.0 / spent),
    )
    facts = {
        "balls": len(centre),
        "balls_used": int(used.sum()),
        "left_out": "balls" if len(units) == int(used.sum()) else "sectors of balls",
        "cap_rms_um": float(np.sqrt(np.nanmean(rms**2))),
        "cap_rms_um_median": float(np.nanmedian(rms)),
        "cap_gain": [float(value) for value in np.nanpercentile(gains, (5, 50, 95))],
        "physics_residual": [float(value) for value in left],
        "max_slope": shading.max_slope,
        "radius_mm": radius_mm,
        "flat": BETWEEN if between else "photographs" if data.plane else "none",
        "tried": list(tried),
    }
    outline = np.column_stack([centre, outlines[:, 3]])
    maps = tuple(np.column_stack([error[:, :2], um * error[:, 2]]) for _, error, _ in caps)
    return ShadingFit(replace(shading, facts=facts), outline, used, rms, gains, maps, errors, tried, tuple(notes))


def find_balls(images: FloatArray, free: bool = False) -> Array:
    """Outlines (N, 3) of balls: column, row, radius in pixels; what the image's border cuts is left out.

    Parameters
    ----------
    images : (L, H, W) over the flat ones
    free : one ball against a dark background, instead of many in a plane
    """
    if free:
        ball = find_ball(images)
        return np.array([[ball.column, ball.row, ball.radius_px]])
    mean = images.mean(axis=0)
    factor = max(1, round(max(mean.shape) / 800))
    small = bin_mean(images, factor)
    contrast = cv2.GaussianBlur((small.std(axis=0) / np.maximum(small.mean(axis=0), np.float32(0.05))), (0, 0), 1.0)
    top = float(np.percentile(contrast, 99.5))
    grey = np.rint(np.clip(contrast / max(top, 1e-6), 0, 1) * 255).astype(np.uint8)
    _, sloped = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    outlines, _ = cv2.findContours(sloped, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    circles = []
    for outline in outlines:
        (column, row), around = cv2.minEnclosingCircle(outline)
        area = cv2.contourArea(outline)
        inside = around + 1 < min(column + 1, row + 1, grey.shape[1] - column, grey.shape[0] - row)
        if around > 4 and inside and area > 0.7 * np.pi * around**2:
            moments = cv2.moments(outline)
            radius = float(np.sqrt(area / np.pi)) + 0.5  # the outline runs through its pixels' centres
            circles.append((moments["m10"] / moments["m00"], moments["m01"] / moments["m00"], radius))
    found = np.array(circles).reshape(-1, 3)
    if len(found):
        typical = float(np.median(found[:, 2]))
        found = found[np.abs(found[:, 2] / typical - 1.0) < 0.3]
    found[:, :2] = (found[:, :2] + 0.5) * factor - 0.5
    found[:, 2] *= factor
    return found[np.lexsort((found[:, 0], found[:, 1]))]


def _given(centres: Array, size: tuple[int, ...]) -> Array:
    """Centres (N, 2) or (N, 3) as outlines; without radii that of the nearest neighbour's half distance."""
    array = np.asarray(centres, dtype=np.float64)
    require(
        array.ndim == 2 and array.shape[1] in (2, 3) and len(array) > 0 and bool(np.isfinite(array).all()),
        "centres of balls must be columns and rows (and radii) in pixels.",
    )
    inside = (array[:, :2] >= 0).all() and (array[:, 0] < size[1]).all() and (array[:, 1] < size[0]).all()
    require(bool(inside), f"centres of balls must lie in the image of {size[0]} x {size[1]} pixels (rows x columns).")
    if array.shape[1] == 3:
        return array
    require(len(array) > 1, "one centre needs the radius of the ball's outline beside it, in pixels.")
    return np.column_stack([array, np.full(len(array), 0.25 * lattice_spacing(array))])


def lattice_spacing(points: Array) -> float:
    """Distance in pixels of neighbouring points (N, 2) of any lattice, by least squares over all of them.

    Raises
    ------
    BadInput
        If fewer than three points lie in a lattice.
    """
    require(len(points) >= 3, f"a lattice needs three balls at least, but {len(points)} were found.")
    apart = points[:, None] - points[None]
    distance = np.hypot(apart[..., 0], apart[..., 1]) + np.where(np.eye(len(points)) > 0, np.inf, 0.0)
    nearest = float(np.median(distance.min(axis=1)))
    steps = apart[np.abs(distance / nearest - 1.0) < 0.15]
    first = steps[0]
    cross = np.abs(steps[:, 0] * first[1] - steps[:, 1] * first[0]) / nearest**2
    basis = [np.median(_alike(steps, first, nearest), axis=0)]
    if (cross > 0.5).any():
        basis.append(np.median(_alike(steps, steps[int(np.argmax(cross))], nearest), axis=0))
    vectors = np.array(basis)
    for _ in range(3):  # numbers of steps, then the steps, from pairs ever further apart
        pairs = apart.reshape(-1, 2)
        counts = pairs @ np.linalg.pinv(vectors)
        near = np.abs(counts - np.rint(counts)).max(axis=1) < 0.2
        vectors = np.linalg.lstsq(np.rint(counts[near]), pairs[near], rcond=None)[0]
    return float(np.hypot(vectors[:, 0], vectors[:, 1]).mean())


def _alike(steps: Array, step: Array, nearest: float) -> Array:
    off = steps - step
    return np.asarray(steps[np.hypot(off[:, 0], off[:, 1]) < 0.2 * nearest])


class _Data:
    """Photographs of balls in blocks of pixels, and samples of them."""

    def __init__(self, stacks: Sequence[FloatArray], radius_px: float, plane: bool, between: bool) -> None:
        self.stacks, self.radius_px, self.plane, self.between = stacks, radius_px, plane, between
        self.fitted = _FITTED_BETWEEN if between else _FITTED
        self.size = (stacks[0].shape[1], stacks[0].shape[2])
        self.block = max(1, round(radius_px / _BLOCK_PX))
        self.blocks = [bin_mean(one, self.block) for one in stacks]
        self.x, self.y = place_terms(self.size)

    def covered(self, balls: Array) -> bool:
        """Whether balls (N, 3) lie all over the field; else what varies over it would be extrapolated."""
        span = np.ptp(balls[:, 1:3], axis=0) / np.array(self.size[::-1])
        return len(balls) > _SPREAD and bool((span > _COVERED).all())

    def varies(self, balls: Array) -> bool:
        """Whether what varies over the field is fitted; without a flat frame it is, as light then varies most."""
        return self.covered(balls) or (self.between and len(balls) > _SPREAD)

    def within(self, ball: Array, reach: float, every: int = 1, fine: bool = False) -> tuple[FloatArray, Array, Array]:
        """Intensities (L, n) within so many radii of a centre (press, column, row), and columns and rows (n,)."""
        side = 1 if fine else self.block
        images = (self.stacks if fine else self.blocks)[int(ball[0])]
        column, row = ((ball[k] + 0.5) / side - 0.5 for k in (1, 2))
        far = reach * self.radius_px / side
        rows, columns = np.mgrid[
            max(int(row - far), 0) : min(int(row + far) + 2, images.shape[1]) : every,
            max(int(column - far), 0) : min(int(column + far) + 2, images.shape[2]) : every,
        ].reshape(2, -1)
        inside = (rows - row) ** 2 + (columns - column) ** 2 < far * far
        rows, columns = rows[inside], columns[inside]
        return images[:, rows, columns], (columns + 0.5) * side - 0.5, (rows + 0.5) * side - 0.5

    def flat_samples(self, outlines: Array) -> tuple[FloatArray, Array, Array]:
        """Intensities (L, n) of the plane between the balls, and of the flat images (1), with columns and rows."""
        parts = []
        for press, images in enumerate(self.blocks):
            rows, columns = np.mgrid[: images.shape[1], : images.shape[2]].reshape(2, -1)
            step = max(1, len(rows) * len(self.blocks) // (8 * _PLANE_SAMPLES))
            rows, columns = rows[step // 2 :: step], columns[step // 2 :: step]
            values = images[:, rows, columns]
            free = values.std(axis=0) < 3.0 * np.median(values.std(axis=0))  # neither cut balls nor dust
            others = np.insert(find_balls(self.stacks[press]), 0, press, axis=1)  # where some centres alone are given
            for _, column, row, radius in np.concatenate([outlines[outlines[:, 0] == press], others]):
                off = np.hypot((columns + 0.5) * self.block - 0.5 - column, (rows + 0.5) * self.block - 0.5 - row)
                free &= off > _APART * max(radius, self.radius_px)
            some = np.flatnonzero(free)[:: max(1, int(free.sum()) * len(self.blocks) // _PLANE_SAMPLES)]
            parts.append(
                (values[:, some], (columns[some] + 0.5) * self.block - 0.5, (rows[some] + 0.5) * self.block - 0.5)
            )
        values, columns, rows = (np.concatenate([one[k] for one in parts], axis=-1) for k in range(3))
        if self.between:  # the light between the balls is a smooth one there already
            return np.ones_like(values), columns, rows
        return np.concatenate([values, np.ones_like(values)], axis=1), np.tile(columns, 2), np.tile(rows, 2)

    def slopes(self, ball: Array, columns: Array, rows: Array) -> Array:
        """(n, 2) of the sphere; points beyond its fitted part have the slopes at the equator."""
        x, y = (columns - ball[1]) / self.radius_px, (ball[2] - rows) / self.radius_px
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 1e-3))
        return np.column_stack([-x / z, -y / z])


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """One polynomial."""

    relative: bool
    degree: int
    place: str
    """``none``; ``linear``: its terms up to the first degree also vary over the field; ``full``: all do."""
    weights: Array
    """(T, 2) or (3 T, 2)."""

    def rows(self, data: _Data, values: FloatArray, columns: Array, rows: Array) -> Array:
        """(n, T or 3 T) terms."""
        terms = shading_terms(values.astype(np.float64), self.relative, self.degree).T
        if self.place == "none":
            return np.asarray(terms)
        x = np.interp(columns, np.arange(data.size[1]), data.x)[:, None]
        y = np.interp(rows, np.arange(data.size[0]), data.y)[:, None]
        varying = terms.copy()
        if self.place == "linear":
            varying[:, 1 + len(values) :] = 0.0
        return np.concatenate([terms, varying * x, varying * y], axis=1)

    def solved(self, normal: Array, right: Array) -> _Model:
        """The model with the weights that solve the normal equations, terms that are nowhere left at zero."""
        return replace(self, weights=np.asarray(np.linalg.solve(_damped(normal), right), dtype=np.float64))


def _damped(normal: Any) -> Array:
    own = np.diag(normal)
    return np.asarray(normal + np.diag(1e-6 * own + (own == 0)), dtype=np.float64)  # terms that are not there


def _sampled(data: _Data, ball: Array, model: _Model | None) -> tuple[FloatArray, Array, Array, Array, float]:
    """Intensities (L, n), columns, rows and slopes (n, 2) of a ball without what lies off a model (dust, scratches),
    and the median error of the slopes; everything without a model."""
    values, columns, rows = data.within(ball, data.fitted)
    slopes = data.slopes(ball, columns, rows)
    if model is None or len(columns) == 0:
        return values, columns, rows, slopes, 0.0 if len(columns) else np.inf
    error = np.hypot(*(model.rows(data, values, columns, rows) @ model.weights - slopes).T)
    off = float(np.median(error))
    keep = error < 4.0 * off
    return values[:, keep], columns[keep], rows[keep], slopes[keep], off


def _joint(data: _Data, outlines: Array) -> tuple[Array, BoolArray, _Model]:
    """Centres (N, 3: press, column, row), which balls are whole, and the polynomial that was fitted with the centres.

    Gauss-Newton on weights and centres together: of the centres' two unknowns each, the normal equations are reduced.
    """
    balls, used = outlines[:, :3].copy(), np.ones(len(outlines), dtype=bool)
    place = "full" if data.plane and data.varies(balls) else "none"  # else what varies with the place moves centres
    start = _Model(not data.plane, 3 if data.between else 2, place, np.zeros((0, 2)))
    count = term_count(len(data.stacks[0]), start.degree) * (1 if place == "none" else 3)
    plane = np.zeros((count, count))
    if data.plane:
        terms = start.rows(data, *data.flat_samples(outlines))
        plane = terms.T @ terms
    model: _Model | None = None
    for turn in range(7):
        normal, right = np.kron(np.eye(2), plane), np.zeros(2 * count)
        steps, off = [], []
        for k, ball in enumerate(balls):
            values, columns, rows, slopes, error = _sampled(data, ball, model if turn > 1 else None)
            off.append(error)
            terms = start.rows(data, values, columns, rows)
            change = np.stack(
                [data.slopes(ball + step, columns, rows) - slopes for step in 0.25 * np.eye(3)[1:]], axis=-1
            )
            change *= 4.0  # (n, 2, 2): of each part of the slope with the centre's column and row
            inner = np.einsum("nci,ncj->ij", change, change) + 1e-9 * np.eye(2)
            cross = -np.concatenate([terms.T @ change[:, 0], terms.T @ change[:, 1]])
            rest = -np.einsum("nci,nc->i", change, slopes)
            steps.append((inner, cross, rest))
            if not used[k]:
                continue
            normal += np.kron(np.eye(2), terms.T @ terms)
            right += (terms.T @ slopes).T.ravel()
            if data.plane or len(balls) > 3:  # else the outline holds the centre
                solved = np.linalg.solve(inner, np.column_stack([cross.T, rest]))
                normal -= cross @ solved[:, :-1]
                right -= cross @ solved[:, -1]
        vector = np.linalg.solve(_damped(normal), right)
        model = replace(start, weights=np.asarray(vector.reshape(2, count).T, dtype=np.float64))
        if turn > 1:
            used = np.array(off) < 2.5 * float(np.median(off))
        if data.plane or len(balls) > 3:
            for k, (inner, cross, rest) in enumerate(steps):
                limit = 0.05 * data.radius_px
                balls[k, 1:] += np.clip(np.linalg.solve(inner, rest - cross.T @ vector), -limit, limit)
        if data.between:  # the lattice stays where it was given: terms that vary with the place could stretch it
            affine = np.column_stack([np.ones(len(balls)), outlines[:, 1:3]])
            moved = balls[:, 1:] - outlines[:, 1:3]
            balls[:, 1:] -= affine @ np.linalg.lstsq(affine, moved, rcond=None)[0]
    assert model is not None
    return balls, used, model


@dataclass(frozen=True, slots=True, eq=False)
class _Unit:
    """What is left out at once: a ball, or of few balls a sector of one."""

    ball: int
    values: FloatArray
    columns: Array
    rows: Array
    slopes: Array


def _units(data: _Data, balls: Array, used: BoolArray, model: _Model) -> list[_Unit]:
    units = []
    for k in np.flatnonzero(used):
        values, columns, rows, slopes, _ = _sampled(data, balls[k], model)
        if int(used.sum()) >= _FEW:
            units.append(_Unit(int(k), values, columns, rows, slopes))
            continue
        turn = np.arctan2(rows - balls[k, 2], columns - balls[k, 1])
        sector = np.minimum((turn / (2 * np.pi) + 0.5) * _FOLDS, _FOLDS - 1).astype(int)
        for one in range(_FOLDS):
            part = sector == one
            units.append(_Unit(int(k), values[:, part], columns[part], rows[part], slopes[part]))
    return units


def _flat_moments(data: _Data, model: _Model, plane: Any) -> Array:
    """Normal matrix of the plane, whose slopes are zero."""
    if plane is None:
        return np.zeros(())
    terms = model.rows(data, *plane)
    return np.asarray(terms.T @ terms)


def _left_out(model: _Model, units: Sequence[_Unit], data: _Data, plane: Any) -> tuple[_Model, list[_Model]]:
    """The model fitted to all units, and for each unit the one that was fitted without its fold."""
    moments = []
    for unit in units:
        terms = model.rows(data, unit.values, unit.columns, unit.rows)
        moments.append((terms.T @ terms, terms.T @ unit.slopes))
    flat = _flat_moments(data, model, plane)
    fold = np.random.default_rng(0).permutation(len(units)) % _FOLDS
    whole, right = flat + np.sum([one[0] for one in moments], axis=0), np.sum([one[1] for one in moments], axis=0)
    without = []
    for part in range(_FOLDS):
        left, target = whole.copy(), right.copy()
        for k in np.flatnonzero(fold == part):
            left -= moments[k][0]
            target -= moments[k][1]
        without.append(model.solved(left, target))
    return model.solved(whole, right), [without[part] for part in fold]


def _cap_error(data: _Data, ball: Array, model: _Model) -> tuple[Array, float]:
    """Of a ball's cap (n, 3): column, row, error of the height in radii once its place is fitted; and the gain.

    The height is that of a polynomial whose gradient is nearest to the slopes' errors: what an integration keeps.
    """
    values, columns, rows = data.within(ball, CAP)
    error = model.rows(data, values, columns, rows) @ model.weights - data.slopes(ball, columns, rows)
    x, y = (columns - ball[1]) / data.radius_px, (ball[2] - rows) / data.radius_px
    powers = [(i, j) for i in range(_CAP_DEGREE + 1) for j in range(_CAP_DEGREE + 1 - i) if i + j]
    along = [np.column_stack([i * x ** max(i - 1, 0) * y**j for i, j in powers])]
    along.append(np.column_stack([j * x**i * y ** max(j - 1, 0) for i, j in powers]))
    weights = np.linalg.lstsq(np.concatenate(along), error.T.ravel(), rcond=None)[0]
    height = np.column_stack([x**i * y**j for i, j in powers]) @ weights
    sphere = np.sqrt(1.0 - x * x - y * y)
    moved = np.column_stack([np.ones_like(x), x / sphere, y / sphere])
    left = height - moved @ np.linalg.lstsq(moved, height, rcond=None)[0]
    scaled = np.column_stack([moved, sphere])
    gain = 1.0 + float(np.linalg.lstsq(scaled, height, rcond=None)[0][3])
    return np.column_stack([columns, rows, left]), gain


def _chosen(
    data: _Data, balls: Array, used: BoolArray, units: Sequence[_Unit], plane: Any
) -> tuple[_Model, list[_Model], tuple[dict[str, Any], ...]]:
    """The simplest polynomial that errs hardly more than the best on what was left out, and those without each unit."""
    lights, whole = len(data.stacks[0]), len(units) == int(used.sum())
    found: list[tuple[float, int, _Model, list[_Model]]] = []
    tried: list[dict[str, Any]] = []
    wide = data.varies(balls[used])
    for relative, degree, place in _LADDER:
        count = term_count(lights, degree)
        terms = count + {"none": 0, "linear": 2 * (1 + lights), "full": 2 * count}[place]
        if terms > _LARGEST or (place != "none" and not wide) or not (data.plane or relative):
            continue
        model, without = _left_out(_Model(relative, degree, place, np.zeros((0, 2))), units, data, plane)
        if whole:
            errors = [
                float(np.sqrt((_cap_error(data, balls[u.ball], m)[0][:, 2] ** 2).mean()))
                for u, m in zip(units, without, strict=True)
            ]
        else:
            errors = [
                float(np.sqrt(((m.rows(data, u.values, u.columns, u.rows) @ m.weights - u.slopes) ** 2).mean()))
                for u, m in zip(units, without, strict=True)
            ]
        score = float(np.mean(np.sort(errors)[: max(1, round(0.9 * len(errors)))]))
        found.append((score, terms, model, without))
        kind = "cap_um" if whole else "slope"
        tried.append({"relative": relative, "degree": degree, "place": place, "terms": terms, kind: score})
    best = min(one[0] for one in found)
    chosen = min((one for one in found if one[0] <= _SIMPLER * best), key=lambda one: (one[1], one[0]))
    return chosen[2], chosen[3], tuple(tried)


def _errors_left_out(
    data: _Data, balls: Array, units: Sequence[_Unit], without: Sequence[_Model]
) -> tuple[Array, Array, float]:
    """Slope errors of single pixels by slope, where each unit was left out: (B, 3) for people; (B, 3) by the whole
    slope; and their rms in the caps."""
    parts = []
    for unit, model in zip(units, without, strict=True):
        ball = balls[unit.ball]
        values, columns, rows = data.within(ball, data.fitted, max(1, data.block), fine=True)
        truth = data.slopes(ball, columns, rows)
        error = model.rows(data, values, columns, rows) @ model.weights - truth
        size = np.hypot(*truth.T)
        radial = (error * truth).sum(axis=1) / np.maximum(size, 1e-9)
        rough = np.abs(error).max(axis=1) < 6.0 * float(np.median(np.abs(error)))  # without dust
        parts.append(np.column_stack([size, radial, np.sqrt(0.5 * (error**2).sum(axis=1))])[rough])
    size, radial, error = np.concatenate(parts).T
    top = data.fitted / np.sqrt(1.0 - data.fitted**2)
    middle = np.linspace(0.0, top, _BINS)
    index = np.rint(size / top * (_BINS - 1)).astype(int)
    count = np.maximum(np.bincount(index, minlength=_BINS), 1)
    rms = np.sqrt(np.bincount(index, error**2, _BINS) / count)
    table = np.column_stack([middle, np.bincount(index, radial, _BINS) / count, rms])
    inner = size < CAP / np.sqrt(1.0 - CAP**2)
    return table, table, float(np.sqrt((error[inner] ** 2).mean()))


def _covariance(data: _Data, model: _Model, units: Sequence[_Unit], plane: Any) -> Array:
    """Covariance of the weights, robust to errors that are alike all over a ball (White's sandwich, by units)."""
    normal = _flat_moments(data, model, plane) + np.zeros((len(model.weights),) * 2)
    spread = np.zeros_like(normal)
    for unit in units:
        terms = model.rows(data, unit.values, unit.columns, unit.rows)
        score = terms.T @ (unit.slopes - terms @ model.weights)
        normal, spread = normal + terms.T @ terms, spread + 0.5 * score @ score.T
    some = np.diag(normal) > 0
    result = np.zeros_like(normal)
    inverse = np.linalg.inv(_damped(normal[np.ix_(some, some)]))
    result[np.ix_(some, some)] = inverse @ spread[np.ix_(some, some)] @ inverse * len(units) / max(len(units) - 1, 1)
    return np.asarray(result)


def fall_off_between(stacks: Sequence[FloatArray], outlines: Sequence[Array]) -> Array:
    """(L, 6) as :func:`fall_off_terms`, of the gel between pressed balls, where no photograph of the flat gel is.

    A least-absolute fit, within two radii of the field of balls: dust, dents and other balls stay out of it.

    Parameters
    ----------
    stacks : images (L, H, W)
    outlines : of each (N, 3) balls: column, row, radius in pixels
    """
    x, y = place_terms(stacks[0].shape[1:])
    terms, light = [], []
    for images, balls in zip(stacks, outlines, strict=True):
        radius = float(np.median(balls[:, 2]))
        (left, top), (right, bottom) = balls[:, :2].min(axis=0) - 2 * radius, balls[:, :2].max(axis=0) + 2 * radius
        step = max(1, round(radius / 12))
        rows, columns = np.mgrid[
            max(int(top), 0) : min(int(bottom), images.shape[1]) : step,
            max(int(left), 0) : min(int(right), images.shape[2]) : step,
        ].reshape(2, -1)
        off = np.hypot(columns[:, None] - balls[:, 0], rows[:, None] - balls[:, 1]).min(axis=1)
        rows, columns = rows[off > _APART * radius], columns[off > _APART * radius]
        require(len(rows) > 50, "the balls leave no gel between them; photograph it without them (`flat`).")
        u, v = x[columns], y[rows]
        terms.append(np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v]))
        light.append(np.log(np.maximum(np.stack([cv2.blur(one, (step, step))[rows, columns] for one in images]), 1e-6)))
    basis, values = np.concatenate(terms).astype(np.float64), np.concatenate(light, axis=1)
    found = []
    for one in values:
        trust = np.ones(len(one))
        for _ in range(20):
            weights = np.linalg.lstsq(basis * trust[:, None], one * trust, rcond=None)[0]
            trust = 1.0 / np.sqrt(np.maximum(np.abs(one - basis @ weights), 0.01))
        found.append(weights)
    return np.array(found)


def fall_off_terms(flat: FloatArray) -> Array:
    """(L, 6) ln of the brightness of a flat surface's coarse images (L, h, w): terms 1, x, y, x^2, x y, y^2."""
    x, y = (part.ravel() for part in np.meshgrid(*place_terms((flat.shape[1], flat.shape[2]))))
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    light = np.log(np.maximum(flat.reshape(len(flat), -1), 1e-6))
    return np.asarray(np.linalg.lstsq(terms, light.T, rcond=None)[0].T, dtype=np.float64)


def _minus(light: Callable[[Array], tuple[Array, Array]], image: Array, parameters: Array) -> Array:
    return light(parameters)[1] - image


def _physics(data: _Data, balls: Array, units: Sequence[_Unit], plane: Any, pitch_mm: float) -> tuple[Array, Array]:
    """Of each light direction (3), nearness and ambient fraction (L, 5), and the rms residual (L,) of its images.

    Lambert's law with attached shadow, one near point light, ambient light: of an image over the flat one
    s (a + (1 - a) max(0, n . d) / d_z at the middle of the field), d the unit vector from the place to the light.
    """
    values = np.concatenate([unit.values for unit in units], axis=1)
    columns, rows = (np.concatenate([getattr(unit, name) for unit in units]) for name in ("columns", "rows"))
    slopes = np.concatenate([unit.slopes for unit in units])
    if plane is not None:
        values, columns = np.concatenate([values, plane[0]], axis=1), np.concatenate([columns, plane[1]])
        rows, slopes = np.concatenate([rows, plane[2]]), np.concatenate([slopes, np.zeros((len(plane[1]), 2))])
    some = slice(None, None, max(1, len(columns) // 6000))
    values, slopes = values[:, some].astype(np.float64), slopes[some]
    normals = np.column_stack([-slopes, np.ones(len(slopes))]) / np.sqrt(1.0 + (slopes**2).sum(axis=1))[:, None]
    half = 0.5 * np.array([data.size[1] - 1, data.size[0] - 1])
    place = np.column_stack([columns[some] - half[0], half[1] - rows[some], np.zeros(len(slopes))]) * pitch_mm
    width = float(np.abs(place).max()) + pitch_mm

    def light(p: Array) -> tuple[Array, Array]:
        towards = np.array([np.cos(p[0]) * np.cos(p[1]), np.sin(p[0]) * np.cos(p[1]), np.sin(p[1])])
        rays = towards - p[2] / width * place
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        level = np.maximum(rays[:, 2], 0.05) if plane is not None else max(towards[2], 0.05)
        return towards, p[4] * (p[3] + (1.0 - p[3]) * np.maximum((normals * rays).sum(axis=1), 0.0) / level)

    found, left = [], []
    for image in values:
        pull = normals[:, :2].T @ (image - image.mean())
        scale = float(np.median(image))
        start = [np.arctan2(pull[1], pull[0]), 0.6, 0.01, 0.3, scale]
        bounds = ([-10.0, 0.05, 0.0, 0.0, 0.01 * scale], [10.0, 1.57, 0.9, 0.98, 100.0 * scale])
        residual = partial(_minus, light, image)
        fit = least_squares(residual, start, bounds=bounds, x_scale=[1, 0.3, 0.1, 0.3, scale])
        found.append([*light(fit.x)[0], fit.x[2] / width, fit.x[3]])
        left.append(float(np.sqrt((fit.fun**2).mean())) / scale)
    return np.array(found), np.array(left)
