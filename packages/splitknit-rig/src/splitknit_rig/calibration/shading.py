"""How slopes shade the images of a sensor, from balls of known radius: pressed into a gel, or lying free.

Every point of a ball has a known slope, so images of balls are pairs of intensities and slopes. Two things are fitted
to them: physics (where each light is, and how much light comes from everywhere), for people to judge a sensor by, and
a polynomial from intensities to slopes, whose coefficients vary smoothly over the field, which carries what physics
leaves out. How rich it is, and how much it may vary, balls that are left out decide. The balls' centres are found with
it, all at once, since a centre that is off is a constant slope. The plane between the balls holds the slope of zero.

Source: M. K. Johnson, F. Cole, A. Raj and E. H. Adelson, "Microgeometry capture using an elastomeric sensor", SIGGRAPH
2011. C. E. Rasmussen and C. K. I. Williams, "Gaussian processes for machine learning", MIT Press 2006, section 2.1:
Bayesian linear regression, whose prior is what holds the variation over the field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from splitknit import (
    BETWEEN,
    FLAT_TERMS,
    Array,
    BoolArray,
    FloatArray,
    Shading,
    bin_mean,
    check_stack,
    facing_level,
    flat_of_fall_off,
    over_flat,
    place_terms,
    require,
    shading_terms,
    term_count,
)
from splitknit_rig.calibration.sphere import find_ball

_BLOCK_PX = 24.0  # radius of a ball in the blocks of pixels that are fitted: noise of pixels would bend the polynomial
CAP = 0.6  # part of a ball's radius inside which heights are judged: slopes up to 0.75
_FITTED = 0.72
"""Part of a ball's radius inside which it is fitted: slopes up to 1.04. Further out a gel leaves the ball. Where the
gel between the balls stands for a photograph of the flat gel, `CAP` is: the light is then known less well."""
_APART = 1.6  # radii around a ball beyond which the gel lies flat
_PLANE_SAMPLES = 8000
_PLANE = 0.3  # weight of the plane between the balls, all of whose weight is 1
_FOLDS, _SECTORS = 20, 8  # parts that are left out in turns: balls, or of fewer than `_FEW` balls their sectors
_FEW = 4
_SPREAD, _COVERED = 5, 0.6
"""Coefficients may vary over the field where there are more balls; it is covered if they span this part of it."""
_SIMPLER = 1.03  # a simpler polynomial is taken where it errs at most so many times as much as the best one
_BINS = 9
_CAP_DEGREE = 6  # degree of the polynomial whose gradient models the smooth part of a cap's slope errors
_LADDER = tuple((degree, place) for degree in (1, 2, 3) for place in (1, 3, 6, 10))
"""Polynomials that are tried: degree, and monomials of the place that its coefficients vary with."""
_PRIOR = 0.5
"""Strength of the prior that they do not: the variance of a ball's misfit over that of the slopes' variation."""
_LINEAR = 0.02  # the same of linear variation, which near lights show, over that of higher degrees
_CENTRE = 0.06
"""Standard deviation of a centre as given, in radii, where no photograph of the flat gel holds the slopes."""
_LARGEST = 300  # terms of a polynomial at most


@dataclass(frozen=True, slots=True, eq=False)
class ShadingFit:
    """A calibration with what its report shows."""

    shading: Shading
    balls: Array  # (N, 4) press, column, row of the centre, radius of the outline, all in pixels
    used: BoolArray  # (N,) balls that were fitted; the others are damaged or cut
    # (N,) rms error of the height of each cap within 0.6 of the radius, of the ball left out; NaN where not used
    cap_rms_um: Array
    cap_gain: Array  # (N,) height of each cap over the ball's, likewise
    cap_errors: tuple[Array, ...]  # errors for each used ball (n, 3): column, row, error of the height in um
    error_by_slope: Array  # (B, 3) slope, mean error, rms error of a slope's part, of balls left out
    notes: tuple[str, ...]


def calibrate_shading(
    balls: Sequence[FloatArray],
    flat: FloatArray | None,
    radius_mm: float,
    spacing_mm: float | None = None,
    centres: Sequence[Array] | None = None,
) -> ShadingFit:
    """Calibrate a sensor's shading on balls.

    Raises BadInput if no balls are found, the images differ in size, or the numbers are none. `balls`: images (L, H, W)
    of balls, linear light; several where one ball was pressed in many places; `flat`: (L, h, w) of the sensor pressed
    on nothing, as :func:`splitknit.imaging.band.coarse_flat`; None: of a ball lying free, without; with `spacing_mm`,
    the gel's light between the balls; `radius_mm`: of the balls; `spacing_mm`: distance of neighbouring balls in a
    lattice, which gives the scale; else the outlines' radius does; `centres`: for each of `balls` (N, 2) or (N, 3),
    columns and rows in pixels and radii; found where None.

    >>> fit = calibrate_shading([balls], flat, radius_mm=0.2475, spacing_mm=1.0)  # doctest: +SKIP
    >>> write_shading("shading.npz", fit.shading)  # doctest: +SKIP
    """
    require(0 < radius_mm < 1e4, f"`radius_mm` must be a positive number, not {radius_mm}.")
    require(spacing_mm is None or 0 < spacing_mm < 1e4, f"`spacing_mm` must be a positive number, not {spacing_mm}.")
    stacks, fall_off, kind = _over_flat(balls, flat, spacing_mm, centres)
    outlines = _outlines(stacks, kind, centres)
    if spacing_mm is not None:
        pitch_mm = spacing_mm / lattice_spacing(outlines[outlines[:, 0] == 0, 1:3])
    else:
        pitch_mm = radius_mm / float(np.median(outlines[:, 3]))
    data = _Data(stacks, radius_mm / pitch_mm, kind, outlines)
    centre, used, first = _joint(data, outlines[:, :3])
    if spacing_mm is not None:  # centres are better than outlines, on which lights from the side pull
        pitch_mm = spacing_mm / lattice_spacing(centre[(centre[:, 0] == 0) & used, 1:])
        data.radius_px = radius_mm / pitch_mm
        centre, used, first = _joint(data, outlines[:, :3])
    units = _units(data, centre, used, first)
    model, without, tried = _chosen(data, centre, units, radius_mm)
    by_slope, spent = _errors_left_out(data, centre, units, without)
    model, covariance, own = _covariance(data, centre, model, units)
    rms, gains, maps = np.full(len(centre), np.nan), np.full(len(centre), np.nan), {}
    for unit, one in zip(units, without, strict=True):
        error, gains[unit.ball] = _cap_error(data, centre[unit.ball], one)
        maps[unit.ball] = error * [1.0, 1.0, 1000.0 * radius_mm]
        rms[unit.ball] = float(np.sqrt((maps[unit.ball][:, 2] ** 2).mean()))
    cap_rms_um = float(np.sqrt(np.nanmean(rms**2)))
    physics, left = _physics(data, units, pitch_mm)
    facts = {
        "balls": len(centre),
        "balls_used": int(used.sum()),
        "left_out": "balls" if data.whole(used) else "sectors of balls",
        "cap_rms_um": cap_rms_um,
        "cap_rms_um_median": float(np.nanmedian(rms)),
        "cap_gain": [float(value) for value in np.nanpercentile(gains, (5, 50, 95))],
        "physics_residual": [float(value) for value in left],
        "max_slope": float(by_slope[-1, 0]),
        "radius_mm": radius_mm,
        "flat": kind,
        "tried": list(tried),
    }
    shading = Shading(
        pitch_mm=pitch_mm,
        image_size=data.size,
        direction=physics[:, :3],
        nearness=physics[:, 3],
        ambient=physics[:, 4],
        fall_off=fall_off,
        relative=model.relative,
        degree=model.degree,
        weights=model.weights,
        covariance=covariance,
        deviation=by_slope[:, 2],
        max_slope=float(by_slope[-1, 0]),
        height_mm_per_slope=cap_rms_um / 1000.0 / float(np.hypot(spent, own)),
        facts=facts,
    )
    outline = np.column_stack([centre, outlines[:, 3]])
    notes = _notes(data, outlines, spacing_mm)
    return ShadingFit(shading, outline, used, rms, gains, tuple(maps.values()), by_slope, notes)


def _over_flat(
    balls: Sequence[FloatArray], flat: FloatArray | None, spacing_mm: float | None, centres: Sequence[Array] | None
) -> tuple[list[FloatArray], Array, str]:
    """Images over those of the flat surface, its fall-off, and where that was measured."""
    require(len(balls) > 0, "give photographs of balls, or of one ball.")
    stacks = [check_stack(one, least=3, name="the photographs of balls") for one in balls]
    size = stacks[0].shape[1:]
    require(all(one.shape == stacks[0].shape for one in stacks), "all photographs of balls must be of one size.")
    if flat is None and spacing_mm is None:
        return stacks, np.zeros((len(stacks[0]), FLAT_TERMS)), "none"
    if flat is None:
        require(
            centres is not None, "without photographs of the flat gel the balls are not found; give their `centres`."
        )
        fall_off = fall_off_between(stacks, [_given(one, size) for one in centres or ()])
        flat = flat_of_fall_off(fall_off, size)
        kind = BETWEEN
    else:
        fall_off, kind = fall_off_terms(flat), "photographs"
    stacks = [over_flat(one, flat) for one in stacks]
    return [one / np.float32(facing_level(one)) for one in stacks], fall_off, kind


def _outlines(stacks: Sequence[FloatArray], kind: str, centres: Sequence[Array] | None) -> Array:
    """(N, 4) balls: press, column, row, radius in pixels; as given, else found."""
    found = [
        find_balls(one, kind == "none") if centres is None else _given(centres[k], one.shape[1:])
        for k, one in enumerate(stacks)
    ]
    outlines = np.concatenate([np.column_stack([np.full(len(some), k), some]) for k, some in enumerate(found)])
    require(len(outlines) > 0, "no balls were found in the photographs; give their `centres`.")
    return outlines


def _notes(data: _Data, outlines: Array, spacing_mm: float | None) -> tuple[str, ...]:
    notes = []
    if data.plane and spacing_mm is None:
        notes.append(
            "the scale is that of the balls' outlines, as if they were pressed in to their equator; give the "
            "distance of the balls (`spacing_mm`), or their centres with radii, where they are not."
        )
    if data.plane and not (len(outlines) > _SPREAD and data.covered(outlines)):
        wide, high = 100 * np.ptp(outlines[:, 1:3], axis=0) / np.array(data.size[::-1])
        notes.append(
            f"the balls ({len(outlines)}; more than {_SPREAD} are needed) do not lie all over the field, but over "
            f"{wide:.0f} % of its width and {high:.0f} % of its height ({100 * _COVERED:.0f} % are needed): "
            "how lights shade slopes far from the balls is extrapolated, and "
            "errors there are larger; press balls all over it, if need be one after the other."
        )
    return tuple(notes)


def find_balls(images: FloatArray, free: bool = False) -> Array:
    """Outlines (N, 3) of whole balls in `images` (L, H, W) over the flat ones: column, row, radius in pixels. `free`:
    one ball against a dark background, instead of many in a plane.
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
    """Distance in pixels of neighbours in a lattice of points (N, 2), by least squares; BadInput below three points."""
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

    def __init__(self, stacks: Sequence[FloatArray], radius_px: float, kind: str, outlines: Array) -> None:
        self.stacks, self.radius_px = stacks, radius_px
        self.plane, self.between = kind != "none", kind == BETWEEN
        self.fitted = CAP if self.between else _FITTED
        self.size = (stacks[0].shape[1], stacks[0].shape[2])
        self.block = max(1, round(radius_px / _BLOCK_PX))
        self.blocks = [bin_mean(one, self.block) for one in stacks]
        self.flat = self.flat_samples(outlines) if self.plane else None

    def varies(self, balls: Array) -> bool:
        """Whether what varies over the field is fitted; without a flat frame it is, as light then varies most."""
        return self.plane and len(balls) > _SPREAD and (self.between or self.covered(balls))

    def covered(self, balls: Array) -> bool:
        """Whether balls (N, 3) lie all over the field; else what varies over it would be extrapolated."""
        return bool((np.ptp(balls[:, 1:3], axis=0) > _COVERED * np.array(self.size[::-1])).all())

    def whole(self, used: BoolArray) -> bool:
        """Whether whole balls are left out, not sectors of them."""
        return int(used.sum()) >= _FEW

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
        require(len(rows) > 0, "nothing of the gel lies flat beside the balls; photograph them farther apart.")
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
    relative: bool
    degree: int
    place: int  # number of monomials of the place with which its coefficients vary; 1: they do not
    weights: Array  # (place T, 2), place slowest

    def rows(self, data: _Data, values: FloatArray, columns: Array, rows: Array) -> Array:
        """(n, place T) terms."""
        terms = shading_terms(values.astype(np.float64), self.relative, self.degree)
        place = place_terms(data.size, columns, rows, self.place)
        return np.asarray((place[:, None] * terms).reshape(-1, len(columns)).T)

    def prior(self, normal: Array, count: int) -> Array:
        """Precision of the weights' prior, which keeps them nearly constant over the field; `normal`: of all balls."""
        size = len(normal) // self.place
        strength = np.array([0.0, _LINEAR, _LINEAR, *[1.0] * 7])[: self.place] * _PRIOR / count
        return np.asarray(np.kron(np.diag(strength), np.ones((size, size))) * normal)

    def plane(self, data: _Data, count: int) -> Any:
        """Normal matrix of the plane, whose slopes are zero, beside so many balls."""
        if data.flat is None:
            return 0.0
        terms = self.rows(data, *data.flat)
        return _PLANE * count / len(terms) * terms.T @ terms


def _damped(normal: Any) -> Array:
    own = np.diag(normal)
    return np.asarray(normal + np.diag(1e-6 * own + (own == 0)), dtype=np.float64)  # terms that are not there


def _sampled(data: _Data, ball: Array, model: _Model | None) -> tuple[FloatArray, Array, Array, Array, float]:
    """Intensities (L, n), columns, rows and slopes (n, 2) of a ball, less what lies off a model; median slope error."""
    values, columns, rows = data.within(ball, data.fitted)
    slopes = data.slopes(ball, columns, rows)
    if model is None or len(columns) == 0:
        return values, columns, rows, slopes, 0.0 if len(columns) else np.inf
    error = np.hypot(*(model.rows(data, values, columns, rows) @ model.weights - slopes).T)
    off = float(np.median(error))
    keep = error < 4.0 * off
    return values[:, keep], columns[keep], rows[keep], slopes[keep], off


def _joint(data: _Data, given: Array) -> tuple[Array, BoolArray, _Model]:
    """Centres (N, 3: press, column, row), which balls are whole, and the polynomial, all fitted by Gauss-Newton."""
    balls, used, misfit = given.copy(), np.ones(len(given), dtype=bool), 0.0
    free = data.plane or len(balls) > 3  # else the outline holds the centre
    place = 10 if data.varies(balls) else 1
    model = _Model(not data.plane, 3 if data.between else 2, place, np.zeros((0, 2)))
    count = term_count(len(data.stacks[0]), model.degree) * place
    plane = model.plane(data, len(balls)) + np.zeros((count, count))
    for turn in range(7):
        whole, reduced, right = plane.copy(), np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        given_by = (misfit / (_CENTRE * data.radius_px)) ** 2 if data.between else 0.0
        steps, off = [], []
        for k, ball in enumerate(balls):
            values, columns, rows, slopes, error = _sampled(data, ball, model if turn > 1 else None)
            off.append(error)
            root = 1.0 / np.sqrt(max(len(columns), 1))  # every ball counts as much
            terms = root * model.rows(data, values, columns, rows)
            change = np.stack(
                [data.slopes(ball + step, columns, rows) - slopes for step in 0.25 * np.eye(3)[1:]], axis=-1
            )
            change *= 4.0 * root  # (n, 2, 2): of each part of the slope with the centre's column and row
            inner = np.einsum("nci,ncj->ij", change, change) + (given_by + 1e-9) * np.eye(2)
            cross = -np.concatenate([terms.T @ change[:, 0], terms.T @ change[:, 1]])
            rest = given_by * (given[k, 1:] - ball[1:]) - np.einsum("nci,nc->i", change, root * slopes)
            steps.append((inner, cross, rest))
            if used[k]:
                whole += terms.T @ terms
                right += (terms.T @ (root * slopes)).T.ravel()
                if free:
                    solved = np.linalg.solve(inner, np.column_stack([cross.T, rest]))
                    reduced -= cross @ solved[:, :-1]
                    right -= cross @ solved[:, -1]
        whole += model.prior(whole, len(balls))
        vector = np.linalg.solve(_damped(np.kron(np.eye(2), whole) + reduced), right)
        model = replace(model, weights=np.asarray(vector.reshape(2, count).T, dtype=np.float64))
        if turn > 1:
            misfit = float(np.median(off))
            used = np.array(off) < 2.5 * misfit
        if free:
            for k, (inner, cross, rest) in enumerate(steps):
                limit = 0.05 * data.radius_px
                balls[k, 1:] += np.clip(np.linalg.solve(inner, rest - cross.T @ vector), -limit, limit)
        if data.between:  # the lattice stays where it was given: terms that vary with the place could stretch it
            affine = np.column_stack([np.ones(len(balls)), given[:, 1:]])
            moved = balls[:, 1:] - given[:, 1:]
            balls[:, 1:] -= affine @ np.linalg.lstsq(affine, moved, rcond=None)[0]
    return balls, used, model


@dataclass(frozen=True, slots=True, eq=False)
class _Unit:
    """What is left out at once: a ball, or of few balls a sector of one."""

    ball: int
    values: FloatArray
    columns: Array
    rows: Array
    slopes: Array

    def equations(self, data: _Data, model: _Model) -> tuple[Array, Array]:
        """Terms (n, T) and slopes (n, 2), whose squares are means."""
        root = 1.0 / np.sqrt(max(len(self.columns), 1))
        return root * model.rows(data, self.values, self.columns, self.rows), root * self.slopes


def _units(data: _Data, balls: Array, used: BoolArray, model: _Model) -> list[_Unit]:
    units = []
    for k in np.flatnonzero(used):
        values, columns, rows, slopes, _ = _sampled(data, balls[k], model)
        turn = np.arctan2(rows - balls[k, 2], columns - balls[k, 1]) / (2 * np.pi) + 0.5
        parts = 1 if data.whole(used) else _SECTORS
        sector = np.minimum(turn * parts, parts - 1).astype(int)
        for part in (sector == one for one in range(parts)):
            units.append(_Unit(int(k), values[:, part], columns[part], rows[part], slopes[part]))
    return units


def _left_out(model: _Model, units: Sequence[_Unit], data: _Data) -> tuple[_Model, list[_Model]]:
    """The model fitted to all units, and for each unit the one that was fitted without its fold."""
    equations = [unit.equations(data, model) for unit in units]
    moments = [(terms.T @ terms, terms.T @ slopes) for terms, slopes in equations]
    whole = model.plane(data, len(units)) + np.sum([one[0] for one in moments], axis=0)
    whole += model.prior(whole, len(units))
    right = np.sum([one[1] for one in moments], axis=0)
    fold = np.random.default_rng(0).permutation(len(units)) % _FOLDS

    def without(part: int) -> _Model:
        out = [moments[k] for k in np.flatnonzero(fold == part)]
        left, target = whole - sum(one[0] for one in out), right - sum(one[1] for one in out)
        return replace(model, weights=np.linalg.solve(_damped(left), target))

    found = {part: without(part) for part in (-1, *range(_FOLDS))}
    return found[-1], [found[part] for part in fold]


def _cap_error(data: _Data, ball: Array, model: _Model) -> tuple[Array, float]:
    """Errors of a ball's cap (n, 3): column, row, error of the fitted height in radii, once placed; and the gain."""
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
    data: _Data, balls: Array, units: Sequence[_Unit], radius_mm: float
) -> tuple[_Model, list[_Model], tuple[dict[str, Any], ...]]:
    """The simplest polynomial that errs hardly more than the best on what was left out, and those without each unit."""
    lights, whole = len(data.stacks[0]), len({unit.ball for unit in units}) == len(units)
    varies = data.varies(balls[np.unique([unit.ball for unit in units])])
    found: list[tuple[float, int, _Model, list[_Model]]] = []
    tried: list[dict[str, Any]] = []
    for degree, place in _LADDER:
        terms = place * term_count(lights, degree)
        if terms > _LARGEST or (place > 1 and not varies):
            continue
        model, without = _left_out(_Model(not data.plane, degree, place, np.zeros((0, 2))), units, data)
        errors = []
        for unit, one in zip(units, without, strict=True):
            if whole:
                error = 1000.0 * radius_mm * _cap_error(data, balls[unit.ball], one)[0][:, 2]
            else:
                error = one.rows(data, unit.values, unit.columns, unit.rows) @ one.weights - unit.slopes
            errors.append(float(np.sqrt((error**2).mean())))
        score = float(np.mean(np.sort(errors)[: max(1, round(0.9 * len(errors)))]))
        found.append((score, terms, model, without))
        kind = "cap_um" if whole else "slope"
        tried.append({"degree": degree, "place": place, "terms": terms, kind: score})
    best = min(one[0] for one in found)
    chosen = min((one for one in found if one[0] <= _SIMPLER * best), key=lambda one: (one[1], one[0]))
    return chosen[2], chosen[3], tuple(tried)


def _errors_left_out(
    data: _Data, balls: Array, units: Sequence[_Unit], without: Sequence[_Model]
) -> tuple[Array, float]:
    """Slopes of pixels of units left out: (B, 3) slope, mean error, rms error; and the rms error in the caps."""
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
    return table, float(np.sqrt((error[inner] ** 2).mean()))


def _covariance(data: _Data, balls: Array, model: _Model, units: Sequence[_Unit]) -> tuple[_Model, Array, float]:
    """Covariance of the weights (White's sandwich, by units), and the standard deviation that it gives slopes of the
    balls. Where balls cover a part of the field, the linear variation they show counts as uncertainty alone.
    """
    equations = [unit.equations(data, model) for unit in units]
    normal = model.plane(data, len(units)) + np.sum([terms.T @ terms for terms, _ in equations], axis=0)
    prior = model.prior(normal, len(units))
    inverse = np.linalg.inv(_damped(normal + prior))
    errors = [slopes - terms @ model.weights for terms, slopes in equations]
    scores = [terms.T @ error for (terms, _), error in zip(equations, errors, strict=True)]
    spread = 0.5 * np.sum([score @ score.T for score in scores], axis=0)
    if not data.covered(balls):  # what varies is then extrapolated: it may be all that the prior allows
        spread += 0.5 * float(np.mean([(error**2).sum() for error in errors])) * prior
    covariance = inverse @ spread @ inverse
    if model.place == 1 and data.plane and len(units) > _SPREAD and not data.varies(balls):
        count = len(model.weights)
        varying, _ = _left_out(replace(model, place=3), units, data)
        column, row = balls[:, 1:].mean(axis=0)
        middle = place_terms(data.size, [column], [row], 3)[:, 0]
        covariance = np.pad(covariance, (0, 2 * count))
        for k in (1, 2):
            step = np.eye(3)[k] - middle[k] * np.eye(3)[0]
            along = np.kron(step[:, None], varying.weights[k * count : (k + 1) * count])
            covariance += 0.5 * along @ along.T
        model = replace(model, place=3, weights=np.concatenate([model.weights, np.zeros((2 * count, 2))]))
    of_balls = np.mean([((terms @ covariance) * terms).sum() for terms, _ in (u.equations(data, model) for u in units)])
    return model, np.asarray(covariance), float(np.sqrt(of_balls))


def fall_off_between(stacks: Sequence[FloatArray], outlines: Sequence[Array]) -> Array:
    """(L, 15) as :func:`fall_off_terms`, of the gel between pressed balls: a least-absolute fit to `stacks` (L, H, W)
    within two radii of the field of balls, without dust, dents and balls: `outlines` (N, 3), column, row, radius, each.
    """
    size = stacks[0].shape[1:]
    terms, light = [], []
    for images, balls in zip(stacks, outlines, strict=True):
        radius = float(np.median(balls[:, 2]))
        (left, top), (right, bottom) = balls[:, :2].min(axis=0) - 2 * radius, balls[:, :2].max(axis=0) + 2 * radius
        step = max(1, round(radius / 12))
        rows, columns = np.mgrid[
            max(int(top), 0) : min(int(bottom), size[0]) : step, max(int(left), 0) : min(int(right), size[1]) : step
        ].reshape(2, -1)
        off = np.hypot(columns[:, None] - balls[:, 0], rows[:, None] - balls[:, 1]).min(axis=1)
        rows, columns = rows[off > _APART * radius], columns[off > _APART * radius]
        require(len(rows) > 50, "the balls leave no gel between them; photograph it without them (`flat`).")
        terms.append(place_terms(size, columns, rows, FLAT_TERMS))
        light.append(np.log(np.maximum(np.stack([cv2.blur(one, (step, step))[rows, columns] for one in images]), 1e-6)))
    basis, values = np.concatenate(terms, axis=1).T.astype(np.float64), np.concatenate(light, axis=1)
    found = []
    for one in values:
        trust = np.ones(len(one))
        for _ in range(20):
            weights = np.linalg.lstsq(basis * trust[:, None], one * trust, rcond=None)[0]
            trust = 1.0 / np.sqrt(np.maximum(np.abs(one - basis @ weights), 0.01))
        found.append(weights)
    return np.array(found)


def fall_off_terms(flat: FloatArray) -> Array:
    """(L, 15) ln of the brightness of a flat surface's coarse images (L, h, w): monomials of the place to degree 4."""
    size = flat.shape[1:]
    rows, columns = np.mgrid[: size[0], : size[1]].reshape(2, -1)
    light = np.log(np.maximum(flat.reshape(len(flat), -1), 1e-6))
    return np.linalg.lstsq(place_terms(size, columns, rows, FLAT_TERMS).T, light.T, rcond=None)[0].T.astype(np.float64)


def _physics(data: _Data, units: Sequence[_Unit], pitch_mm: float) -> tuple[Array, Array]:
    """Each light's direction (3), nearness and ambient fraction (L, 5), and the rms residual (L,). Lambert's law with
    attached shadow, near light and ambient light: an image over the flat one is s (a + (1 - a) max(0, n . d) / d_z at
    the middle of the field), d the unit vector to the light.
    """
    values = np.concatenate([unit.values for unit in units], axis=1)
    columns, rows = (np.concatenate([getattr(unit, name) for unit in units]) for name in ("columns", "rows"))
    slopes = np.concatenate([unit.slopes for unit in units])
    if data.flat is not None:
        values, columns = np.concatenate([values, data.flat[0]], axis=1), np.concatenate([columns, data.flat[1]])
        rows, slopes = np.concatenate([rows, data.flat[2]]), np.concatenate([slopes, np.zeros((len(data.flat[1]), 2))])
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
        level = np.maximum(rays[:, 2], 0.05) if data.plane else max(towards[2], 0.05)
        return towards, p[4] * (p[3] + (1.0 - p[3]) * np.maximum((normals * rays).sum(axis=1), 0.0) / level)

    found, left = [], []
    for image in values:
        pull = normals[:, :2].T @ (image - image.mean())
        scale = float(np.median(image))
        start = [np.arctan2(pull[1], pull[0]), 0.6, 0.01, 0.3, scale]
        bounds = ([-10.0, 0.05, 0.0, 0.0, 0.01 * scale], [10.0, 1.57, 0.9, 0.98, 100.0 * scale])

        def left_over(p: Array, image: Array = image) -> Array:
            return light(p)[1] - image

        fit = least_squares(left_over, start, bounds=bounds, x_scale=[1, 0.3, 0.1, 0.3, scale])
        found.append([*light(fit.x)[0], fit.x[2] / width, fit.x[3]])
        left.append(float(np.sqrt((fit.fun**2).mean())) / scale)
    return np.array(found), np.array(left)
