"""A body and mirrors that agree with all outlines: Gauss-Newton on planes that touch the finger.

Every point of every outline implies that a plane touches the body: the support of the section where it touches, along
the plane's normal, equals the plane's offset. These equations are linear in centre lines, nearly linear in the half
axes, and hold for any pose of the mirrors; the poses, the tip, the sections' squareness and shear are found with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.mirrors.body import MAX_SQUARE, Body, Slopes, basis, slopes_across
from splitknit.mirrors.reflection import Plane, Touching
from splitknit.mirrors.settings import ANGLE_DEG, OFFSET_MM, OUTLINE_MM, ROW_MM, SQUARENESS_SD
from splitknit.model import Array, BoolArray

_STATIONS = 80  # places along the body at which a plane seen from the tip is tried
_MAX_STEP = {"tip_mm": 1.0, "turn_rad": 0.04, "lean_rad": 0.04, "shift_mm": 2.0}
_MAX_STEP |= {"squareness": 0.15, "shear": 0.2, "shear_slope": 0.2}
"""Largest steps of one correction."""
_Parameters = list[tuple[str, float]]
"""Parameters that all sections share (`tip_mm`, or `turn_rad left`), each with the step of its difference quotient."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorOutline:
    """Planes that touch the finger along its outline in one mirror, and where the mirror nominally is."""

    touching: Touching  # as the camera sees them, not yet reflected
    plane: Plane
    from_tip: bool = False  # whether it looks along the finger
    turn_rad: float = 0.0  # its turn, as the tips of the views show it
    turn_sd_rad: float | None = None  # standard deviation of that; None: it is undefined


@dataclass(frozen=True, slots=True, eq=False)
class Outlines:
    """The outlines of all views, as planes that touch the finger."""

    front: Touching
    mirrors: Mapping[str, MirrorOutline]

    @property
    def names(self) -> list[str]:
        """Names of the mirrors, in the order of their residuals; the front view's come first."""
        return sorted(self.mirrors)

    @property
    def ends(self) -> NDArray[np.intp]:
        """Where the residuals of one view end and the next ones begin."""
        sizes = [len(self.front.offset_mm), *(len(self.mirrors[name].touching.offset_mm) for name in self.names)]
        return np.cumsum(sizes)[:-1]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """How a mirror differs from its nominal pose."""

    turn_rad: float = 0.0
    lean_rad: float = 0.0
    shift_mm: float = 0.0

    def of(self, nominal: Plane) -> Plane:
        """The mirror where it is."""
        return nominal.posed(self.turn_rad, self.lean_rad, self.shift_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Body and mirrors' poses between corrections."""

    body: Body
    poses: Mapping[str, Pose]

    def value(self, name: str) -> float:
        """One of the parameters that all sections share."""
        kind, _, mirror = name.partition(" ")
        return float(getattr(self.poses[mirror] if mirror else self.body, kind))

    def moved(self, name: str, by: float) -> Estimate:
        """With one of them moved."""
        kind, _, mirror = name.partition(" ")
        changed: dict[str, Any] = {kind: self.value(name) + by}
        if mirror:
            return Estimate(self.body, {**self.poses, mirror: replace(self.poses[mirror], **changed)})
        return Estimate(replace(self.body, **changed), self.poses)

    def stepped(self, step: Array, parameters: _Parameters) -> Estimate:
        """After a correction of the splines' coefficients and `parameters`, shortened as a whole beyond a limit."""
        count = self.body.coefficients.size
        shared = [name for name, _ in parameters]
        most = [_MAX_STEP[name.partition(" ")[0]] for name in shared]
        sizes = [abs(float(by)) / one for one, by in zip(most, step[count:], strict=True)]
        step = step / max(1.0, *sizes)
        coefficients = self.body.coefficients + step[:count].reshape(self.body.coefficients.shape)
        estimate = Estimate(replace(self.body, coefficients=coefficients), self.poses)
        for name, by in zip(shared, step[count:], strict=True):
            estimate = estimate.moved(name, float(by))
        return estimate.convex()

    def convex(self) -> Estimate:
        """With a squareness at which the body's sections are convex."""
        squareness = float(np.clip(self.body.squareness, -0.2, MAX_SQUARE))
        return Estimate(replace(self.body, squareness=squareness), self.poses)

    def planes(self, outlines: Outlines) -> list[tuple[Touching, bool]]:
        """Planes of all views as they touch the finger itself, and whether the view looks along the finger."""
        return [(outlines.front, False), *(self._in_mirror(name, outlines) for name in outlines.names)]

    def residual_in(self, name: str, outlines: Outlines) -> Array:
        """(n,) how far the body reaches beyond the planes of one mirror's view."""
        planes, from_tip = self._in_mirror(name, outlines)
        return _residual(self.body, planes, from_tip=from_tip)[0]

    def residual(self, outlines: Outlines) -> Array:
        """Those of all views, one after the other."""
        return np.concatenate([_residual(self.body, part, from_tip=tip)[0] for part, tip in self.planes(outlines)])

    def _in_mirror(self, name: str, outlines: Outlines) -> tuple[Touching, bool]:
        mirror = outlines.mirrors[name]
        return self.poses[name].of(mirror.plane).reflect(mirror.touching), mirror.from_tip


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The result."""

    body: Body
    poses: Mapping[str, Pose]
    misfit_mm: Mapping[str, Array]
    """Distance (n,) of the body from each touching plane of ``front`` and every mirror, positive where too large."""
    weights: Mapping[str, Array]

    @property
    def rms_mm(self) -> dict[str, float]:
        """Weighted root mean square of each view's misfit."""
        squares = {name: float(np.sum(one * self.misfit_mm[name] ** 2)) for name, one in self.weights.items()}
        return {name: float(np.sqrt(squares[name] / max(float(one.sum()), 1e-9))) for name, one in self.weights.items()}


def _stations(body: Body, planes: Touching, *, from_tip: bool) -> tuple[Array, Array, Array]:
    """Where along the body each plane touches it: u (n,), and the planes' normals and points in the finger's frame."""
    normal = body.to_frame(planes.normal, place=False)
    point = body.to_frame(planes.point, place=True)
    if from_tip:
        u = body.tip_mm - body.length_mm * np.linspace(0.0, 1.0, _STATIONS) ** 2
        sections = body.sections(u)
        reach = sections.support(normal[:, :1], normal[:, 2:])[0] + normal[:, 1:2] * u  # (n, _STATIONS)
        return u[np.argmax(reach, axis=1)], normal, point
    direction = body.to_frame(planes.direction, place=False)
    within = np.maximum(direction[:, 0] ** 2 + direction[:, 2] ** 2, 1e-6)
    u = point[:, 1] + 0.0
    for _ in range(3):
        t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
        far = ((t - point[:, 0]) * direction[:, 0] + (z - point[:, 2]) * direction[:, 2]) / within
        u = point[:, 1] + far * direction[:, 1]
    return u, normal, point


def _residual(body: Body, planes: Touching, *, from_tip: bool) -> tuple[Array, Array, Array, Array, Array]:
    """How far (n,) the body reaches beyond each plane; where it touches, the normals, derivatives by a and b."""
    u, normal, point = _stations(body, planes, from_tip=from_tip)
    support, by_a, by_b = body.sections(u).support(normal[:, 0], normal[:, 2])
    offset = (normal * point).sum(axis=1)
    residual = support + normal[:, 1] * u - offset
    if from_tip:  # what touches at the end of the model is not of the part that is modelled
        residual = np.where(u <= body.tip_mm - 0.98 * body.length_mm, 10.0, residual)
    return residual, u, normal, by_a, by_b


def touched(body: Body, planes: Touching) -> Array:
    """(n, 3) points of the body, rig's frame, at which planes of a view beside it touch."""
    u, normal, _ = _stations(body, planes, from_tip=False)
    t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
    level = body.origin_mm + np.outer(t, body.across) + np.outer(u, body.axis)
    return np.column_stack([level, z])


# What is expected without any outline, what the skin's slopes add, and how far points of an outline are trusted.

_SLOPE_ERROR = 0.1  # standard deviation of a measured slope of the skin, which looks flatter than it is
SHEAR_SD = 0.05  # standard deviation of the shear: a roll by 8 deg gives about 0.045
INDEPENDENT_SLOPES = 20.0  # slopes err together: at specular reflections, and where light by way of a mirror ends
TIP_SD_MM = 0.05  # standard deviation of the tip's place as the front view's outline has it


_ANGLE = 0.0, float(np.deg2rad(ANGLE_DEG))
_POSE = {"turn_rad": _ANGLE, "lean_rad": _ANGLE, "shift_mm": (0.0, OFFSET_MM)}
"""Expected value of a mirror's pose, and its standard deviation."""


def _prefer_smooth(normal: Array, right: Array, body: Body) -> None:
    count = body.coefficients.shape[1]
    smooth = (0.4, 0.4, 0.6, 0.6)  # mm, standard deviation of third differences of t, z, A and B
    third = np.diff(np.eye(count), 3, axis=0)
    for k, rough in enumerate(smooth):
        of_line = slice(k * count, (k + 1) * count)
        normal[of_line, of_line] += third.T @ third / rough**2
        right[of_line] -= third.T @ (third @ body.coefficients[k]) / rough**2
    # B over A is even along the finger: it holds where one edge of a mirror's view is missing
    ratio = float(np.sum(body.coefficients[3]) / np.sum(body.coefficients[2]))
    part = np.arange(3 * count, 4 * count)
    normal[part, part] += 1.0
    right[part] -= body.coefficients[3] - ratio * body.coefficients[2]


def _prefer(
    normal: Array, right: Array, parameters: _Parameters, now: Estimate, expected: Mapping[str, tuple[float, float]]
) -> None:
    """Prefer shared parameters near what is expected: value and standard deviation, by name, or else by kind."""
    for k, (name, _) in enumerate(parameters):
        value, spread = expected.get(name) or expected[name.partition(" ")[0]]
        normal[k, k] += 1.0 / spread**2
        right[k] += (value - now.value(name)) / spread**2


def _add_slopes(normal: Array, right: Array, names: _Parameters, estimate: Estimate, slopes: Slopes) -> None:
    """Fit the skin's slopes across the finger by squareness and shear."""
    chosen = [k for k, (name, _) in enumerate(names) if name in ("squareness", "shear", "shear_slope")]
    if not chosen:
        return
    residual = slopes_across(estimate.body, slopes)
    good = np.isfinite(residual)
    columns = []
    for k in chosen:
        name, size = names[k]
        columns.append((slopes_across(estimate.moved(name, size).body, slopes) - residual) / size)
    jacobian = np.column_stack(columns)
    good &= np.isfinite(jacobian).all(axis=1)
    if int(good.sum()) < 20:
        return
    weight = _tukey(residual[good], 4.0 * _SLOPE_ERROR) / _SLOPE_ERROR**2
    weight *= INDEPENDENT_SLOPES / max(int(good.sum()), 1)
    part = jacobian[good]
    normal[np.ix_(chosen, chosen)] += part.T @ (weight[:, None] * part)
    right[chosen] -= part.T @ (weight * residual[good])


def _robust_weights(residual: Array, ends: NDArray[np.intp], *, sure: bool) -> Array:
    """Weights of the outlines' points, each view with its own scale; milder ones before the fit is `sure`."""
    parts = []
    for part in np.split(residual, ends):
        size = np.abs(part)
        scale = max(OUTLINE_MM, 1.4826 * float(np.median(size)))
        if sure:
            parts.append(_tukey(part, 4.685 * scale))
        else:  # Huber
            parts.append(np.where(size >= 5.0, 0.0, np.minimum(1.0, 1.345 * scale / np.maximum(size, 1e-9))))
    return np.concatenate(parts)


def _tukey(residual: Array, limit: float) -> Array:
    """Tukey's biweight: one at zero, nothing from `limit` on."""
    return np.clip(1.0 - (residual / limit) ** 2, 0.0, None) ** 2


TIP_TRUST = 0.1  # weight of a view from beyond the tip: it sees the largest sections only
COMMON_MM = 4.0  # points of an outline that are nearer to each other than this err together
EDGE_MM = 0.1
"""Standard deviation of the error that a whole edge of a view has in common, at its middle and from there to its end:
shading, blur and the threshold move it as a whole, which a mirror's pose would otherwise explain."""
_END_SURE = 2  # corrections before points of an outline may be left out altogether
_END_SETTLED = 2e-4  # a correction (mm, rad) below this is the last one


def _fitted_ends(estimate: Estimate, outlines: Outlines, ends: list[str], names: _Parameters) -> Estimate:
    """With those parameters fitted to the views from beyond the tip."""
    body = estimate.body
    form = {"squareness": (body.squareness, SQUARENESS_SD), "shear": (body.shear, 0.5 * SHEAR_SD)}

    def misfit(estimate: Estimate) -> Array:
        return np.concatenate([estimate.residual_in(name, outlines) for name in ends])

    for turn in range(8):
        residual = misfit(estimate)
        jacobian = np.column_stack([(misfit(estimate.moved(name, size)) - residual) / size for name, size in names])
        scale = max(OUTLINE_MM, 1.4826 * float(np.median(np.abs(residual))))
        weight = _tukey(residual, 4.685 * scale) if turn > _END_SURE else (np.abs(residual) < 5.0).astype(np.float64)
        weight = weight * (TIP_TRUST * 2.0 * ROW_MM / COMMON_MM / OUTLINE_MM**2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        _prefer(normal, right, names, estimate, {**_POSE, **form})
        step = np.linalg.solve(normal, right)
        for (name, _), by in zip(names, step, strict=True):
            most = _MAX_STEP[name.partition(" ")[0]]
            estimate = estimate.moved(name, float(np.clip(by, -most, most)))
        estimate = estimate.convex()
        if turn > _END_SURE and float(np.abs(step).max()) < _END_SETTLED:
            break
    return estimate


ROUNDS = 9  # corrections
SURE_FROM = 4  # corrections before points of an outline may be left out altogether
_HELD, _HELD_ROUNDS = {"lean_rad": (0.0, 1e-3), "shift_mm": (0.0, 0.05)}, 3
"""Mirrors stay where they nominally are for so many corrections, in which the body finds its size: under spreading rays
a wrong size is otherwise taken for another height, and mirrors follow it."""
SETTLED = 0.01  # a correction of the splines (mm) below this is the last one


def fit_body(
    start: Estimate,
    outlines: Outlines,
    squareness: tuple[float, float],
    slopes: Slopes | None = None,
    *,
    rounds: int = ROUNDS,
    sure_from: int = SURE_FROM,
) -> Fit:
    """Fit body and poses from a first guess `start`, the `outlines` of all views and, if given, `slopes` of the skin.
    `squareness`: expected, and its standard deviation; `rounds`: of corrections; `sure_from`: corrections before points
    of an outline may be left out altogether.
    """
    if any(mirror.from_tip for mirror in outlines.mirrors.values()):
        return _with_ends(start, outlines, squareness, slopes, rounds)
    estimate, names, ends = start, outlines.names, outlines.ends
    parameters = [("tip_mm", 1e-3), ("squareness", 1e-4)]
    if slopes is not None:
        parameters += [("shear", 1e-4), ("shear_slope", 1e-4)]
    for name in names:
        parameters += [(f"turn_rad {name}", 1e-5), (f"lean_rad {name}", 1e-5), (f"shift_mm {name}", 1e-3)]
    count = start.body.coefficients.size
    common = _common_errors(estimate, outlines)
    expected = {
        **_POSE,
        "squareness": squareness,
        "shear": (0.0, SHEAR_SD),
        "shear_slope": (0.0, 0.3 * SHEAR_SD),
        "tip_mm": (start.body.tip_mm, TIP_SD_MM),
    }
    for name, mirror in outlines.mirrors.items():
        if mirror.turn_sd_rad is not None:
            expected[f"turn_rad {name}"] = mirror.turn_rad, mirror.turn_sd_rad
    for turn in range(rounds):
        residual, spline = _linearised(estimate, outlines)
        moved = [(estimate.moved(name, size), size) for name, size in parameters]
        by_global = np.column_stack([(other.residual(outlines) - residual) / size for other, size in moved])
        weight = _robust_weights(residual, ends, sure=turn >= sure_from)
        weight *= min(1.0, 2.0 * ROW_MM / COMMON_MM) / OUTLINE_MM**2
        jacobian = np.column_stack([spline, by_global, common])
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        free = normal.shape[0] - common.shape[1]
        normal[free:, free:] += np.eye(common.shape[1]) / EDGE_MM**2
        _prefer_smooth(normal, right, estimate.body)
        near = {**expected, **_HELD} if turn < _HELD_ROUNDS <= sure_from else expected
        _prefer(normal[count:, count:], right[count:], parameters, estimate, near)
        if slopes is not None:
            _add_slopes(normal[count:, count:], right[count:], parameters, estimate, slopes)
        step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal) + 1e-9), right)
        estimate = estimate.stepped(np.asarray(step[:free], dtype=np.float64), parameters)
        if turn > sure_from and float(np.abs(step[:count]).max()) < SETTLED:
            break
    residual = estimate.residual(outlines)
    weight = _robust_weights(residual, ends, sure=True)
    split = dict(zip(("front", *names), np.split(residual, ends), strict=True))
    weights = dict(zip(("front", *names), np.split(weight, ends), strict=True))
    return Fit(estimate.body, estimate.poses, split, weights)


APART_MM = 0.12  # views that agree no better than this (rms) have a wrong edge; usual are 0.02 to 0.07


def fit_views(
    start: Estimate,
    outlines: Outlines,
    squareness: tuple[float, float],
    slopes: Slopes | None = None,
    rounds: int = ROUNDS,
) -> Fit:
    """:func:`fit_body`; where the views do not agree, without the one edge of a mirror's view that explains it: a dim
    edge of the finger is sometimes taken to end at the holder behind it.
    """
    best = fit_body(start, outlines, squareness, slopes, rounds=rounds)
    if max(best.rms_mm.values()) < APART_MM:
        return best

    def off(fit: Fit) -> float:
        return float(np.minimum(np.abs(Estimate(fit.body, fit.poses).residual(outlines)), 3.0 * APART_MM).mean())

    first = best
    for name, mirror in outlines.mirrors.items():
        right = _is_right(start.body, start.poses[name].of(mirror.plane).reflect(mirror.touching))
        for kept in () if mirror.from_tip else (right, ~right):
            if not kept.any():
                continue
            fields = (getattr(mirror.touching, field)[kept] for field in Touching.__dataclass_fields__)
            part = {**outlines.mirrors, name: replace(mirror, touching=Touching(*fields))}
            fit = fit_body(start, replace(outlines, mirrors=part), squareness, slopes, rounds=rounds)
            if off(fit) < min(off(best), 0.7 * off(first)):
                best = fit
    return best


def _with_ends(
    start: Estimate, outlines: Outlines, squareness: tuple[float, float], slopes: Slopes | None, rounds: int
) -> Fit:
    """With mirrors beyond the tip: what they show of the sections' form, the others fit with that form again. They see
    the largest sections only, and those beside the tip hide the rest: they do not constrain lines along the finger.
    """
    poses = dict(start.poses)
    beside = {name: mirror for name, mirror in outlines.mirrors.items() if not mirror.from_tip}
    ends = sorted(name for name in outlines.mirrors if name not in beside)
    sides = Outlines(outlines.front, beside)
    without_ends = Estimate(start.body, {name: poses[name] for name in beside})
    first = fit_body(without_ends, sides, squareness, slopes, rounds=rounds)
    estimate = Estimate(first.body, {**first.poses, **{name: poses[name] for name in outlines.mirrors if name in ends}})
    places = [(f"{kind} {name}", 1e-4) for name in ends for kind in ("turn_rad", "lean_rad", "shift_mm")]
    form = [("squareness", 1e-4), ("shear", 1e-4)]
    estimate = _fitted_ends(estimate, outlines, ends, [*form, *places])
    poses = {name: estimate.poses[name] for name in beside}
    known = estimate.body.squareness, 1e-3
    last = fit_body(Estimate(estimate.body, poses), sides, known, rounds=rounds, sure_from=0)
    estimate = _fitted_ends(Estimate(last.body, {**estimate.poses, **last.poses}), outlines, ends, places)
    misfit, weights = dict(last.misfit_mm), dict(last.weights)
    for name in ends:
        misfit[name] = estimate.residual_in(name, outlines)
        weights[name] = _robust_weights(misfit[name], np.zeros(0, dtype=np.intp), sure=True)
    return Fit(estimate.body, estimate.poses, misfit, weights)


def _common_errors(estimate: Estimate, outlines: Outlines) -> Array:
    """What one error of each edge does to the residuals (n, 4 a view): even, and linear along the finger."""
    body, ends = estimate.body, [0, *outlines.ends, None]
    planes = [part for part, _ in estimate.planes(outlines)]
    errors = np.zeros((sum(len(part.offset_mm) for part in planes), 4 * len(planes)))
    for k, part in enumerate(planes):
        along = 1.0 + 2.0 * (body.to_frame(part.point, place=True)[:, 1] - body.tip_mm) / body.length_mm
        right = _is_right(body, part)
        columns = np.column_stack([right, ~right, right * along, ~right * along])
        errors[ends[k] : ends[k + 1], 4 * k : 4 * k + 4] = columns
    return errors


def _is_right(body: Body, part: Touching) -> BoolArray:
    """(n,) which planes touch along the right edge of their view, not along its left one."""
    normal, direction = (body.to_frame(of, place=False) for of in (part.normal, part.direction))
    return normal[:, 0] * direction[:, 2] > normal[:, 2] * direction[:, 0]


def _linearised(estimate: Estimate, outlines: Outlines) -> tuple[Array, Array]:
    """Residuals (n,), and their derivatives by the splines' coefficients (n, 4 K)."""
    body = estimate.body
    count = body.coefficients.shape[1]
    residuals, rows = [], []
    for part, from_tip in estimate.planes(outlines):
        residual, u, normal, by_a, by_b = _residual(body, part, from_tip=from_tip)
        w = body.fraction(u)
        s = np.sqrt(w)
        along, root = basis(w, count), basis(s, count)
        by_centre = normal[:, :1] * along, normal[:, 2:] * along
        rows.append(np.column_stack([*by_centre, (by_a * s)[:, None] * root, (by_b * s)[:, None] * root]))
        residuals.append(residual)
    return np.concatenate(residuals), np.concatenate(rows)


# Whether views are of one finger, and what was found.

_MISFIT_MM = 0.6  # views that agree no better than this (rms) are not of one finger

THICKNESS = (0.4, 1.4)  # thickness of fingers over their breadth, from and to
MAX_DEG = 7.0  # a mirror that would be further off than this is rejected


def refuse_misfit(fit: Fit, mirrors: Mapping[str, MirrorOutline]) -> None:
    """Refuse views that no finger explains."""
    for name, misfit in fit.misfit_mm.items():
        if name in mirrors and mirrors[name].from_tip:
            continue
        size = float(np.median(np.abs(misfit)))
        fault = f"the views do not fit one finger: the {name} view's outline lies {size:.1f} mm beside the others'"
        cure = "check that the rig file's mirrors are the ones in the picture and that one finger alone is in view."
        require(size < _MISFIT_MM, f"{fault}; {cure}")
    thickness = float(np.median(fit.body.coefficients[3] / fit.body.coefficients[2]))
    fault = "the views do not fit one finger"
    thick = f"in the mirrors it would be {thickness:.2f} times as thick as it is broad in front"
    require(THICKNESS[0] < thickness < THICKNESS[1], f"{fault}: {thick}; check that one finger alone is in view.")
    for name, pose in fit.poses.items():
        worst = max(abs(float(np.rad2deg(angle))) for angle in (pose.turn_rad, pose.lean_rad))
        off = f"the {name} mirror would be {worst:.0f} deg off its place in the rig file"
        require(worst < MAX_DEG, f"{fault}: {off}; check that one finger alone is in view, or correct the rig file.")


def facts_of(fit: Fit) -> dict[str, Any]:
    """For the report: poses, misfits, the sections' form."""
    body = fit.body
    return {
        "method": "outlines",
        "mirrors": sorted(fit.poses),
        "squareness": body.squareness,
        "shear": body.shear,
        "poses": {
            name: {
                "turn_deg": float(np.rad2deg(pose.turn_rad)),
                "lean_deg": float(np.rad2deg(pose.lean_rad)),
                "shift_mm": pose.shift_mm,
            }
            for name, pose in fit.poses.items()
        },
        "outline_rms_mm": fit.rms_mm,
    }
