"""Fit of body and mirror poses to all outlines, by Gauss-Newton on the planes tangent to the
finger.

Every point of every outline implies that a plane touches the body: the support of the section where
it touches, along the plane's normal, equals the plane's offset. These equations are linear in
centre lines, nearly linear in the half axes, and hold for any pose of the mirrors; the poses, the
tip, the sections' squareness and shear are estimated with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from splitknit.errors import require
from splitknit.imaging.robust import deviation, tukey
from splitknit.mirrors.body import Body, Slopes, basis, slopes_across
from splitknit.mirrors.outline import ROW_MM
from splitknit.mirrors.reflection import Plane, Pose, Touching
from splitknit.model import Array, BoolArray

Parameter = tuple[str, str]
"""A parameter that all sections share: its name, and the mirror whose pose it is of ('': the
body)."""
_FORM: list[Parameter] = [("squareness", ""), ("shear", ""), ("shear_slope", "")]


@dataclass(frozen=True, slots=True, eq=False)
class ViewOutline:
    """Planes that touch the finger along its outline in one view."""

    touching: Touching  # as the camera sees them, not yet reflected
    plane: Plane | None = None  # nominal plane of the mirror; None: the front view
    turn_rad: float = 0.0  # turn of the mirror, by the fingertips of the views
    turn_sd_rad: float | None = None  # its standard deviation; None: the tips do not show it


Outlines = Mapping[str, ViewOutline]
"""By view: ``front`` first, then the mirrors in the order of their names."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Body and mirrors' poses between corrections."""

    body: Body
    poses: Mapping[str, Pose]

    def value(self, parameter: Parameter) -> float:
        """Value of a shared parameter."""
        kind, mirror = parameter
        return float(getattr(self.poses[mirror] if mirror else self.body, kind))

    def moved(self, parameter: Parameter, by: float) -> Estimate:
        """With one shared parameter changed."""
        kind, mirror = parameter
        change: dict[str, Any] = {kind: self.value(parameter) + by}
        if mirror:
            return Estimate(
                self.body, {**self.poses, mirror: self.poses[mirror]._replace(**change)}
            )
        return Estimate(replace(self.body, **change), self.poses)

    def planes(self, name: str, outline: ViewOutline) -> Touching:
        """Planes of one view as they touch the finger itself."""
        if outline.plane is None:
            return outline.touching
        return outline.plane.posed(*self.poses[name]).reflect(outline.touching)

    def residuals(self, outlines: Outlines) -> dict[str, Array]:
        """(n,) distance of the body beyond the planes of each view, in mm."""
        return {
            name: _contacts(self.body, self.planes(name, outline)).residual
            for name, outline in outlines.items()
        }

    def all_residuals(self, outlines: Outlines) -> Array:
        """Residuals of all views, one after the other."""
        return np.concatenate(list(self.residuals(outlines).values()))


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Estimate):
    """Body and poses after the last correction."""

    misfit_mm: Mapping[str, Array]
    """Distance (n,) of the body from each touching plane of each view, positive where too large."""
    weights: Mapping[str, Array]

    @property
    def rms_mm(self) -> dict[str, float]:
        """Weighted root mean square of each view's misfit."""
        return {
            name: float(
                np.sqrt(
                    float(np.sum(weight * self.misfit_mm[name] ** 2))
                    / max(float(weight.sum()), 1e-9)
                )
            )
            for name, weight in self.weights.items()
        }


class _Contacts(NamedTuple):
    """Where n planes of one view touch a body."""

    residual: Array  # (n,) distance of the body beyond each plane
    u: Array  # (n,) place along the body
    normal: Array  # (n, 3) of the planes, in the finger's frame
    by_a: Array  # (n,) derivatives of the support by the half axes
    by_b: Array


def _contacts(body: Body, planes: Touching) -> _Contacts:
    normal = body.to_frame(planes.normal, place=False)
    point = body.to_frame(planes.point, place=True)
    direction = body.to_frame(planes.direction, place=False)
    within = np.maximum(direction[:, 0] ** 2 + direction[:, 2] ** 2, 1e-6)
    u = point[:, 1] + 0.0
    for _ in range(3):
        t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
        far = ((t - point[:, 0]) * direction[:, 0] + (z - point[:, 2]) * direction[:, 2]) / within
        u = point[:, 1] + far * direction[:, 1]
    support, by_a, by_b = body.sections(u).support(normal[:, 0], normal[:, 2])
    offset = (normal * point).sum(axis=1)
    return _Contacts(support + normal[:, 1] * u - offset, u, normal, by_a, by_b)


def touched(body: Body, planes: Touching) -> Array:
    """(n, 3) points of the body, rig's frame, at which the planes of a view touch."""
    contacts = _contacts(body, planes)
    t, z = body.sections(contacts.u).contact(contacts.normal[:, 0], contacts.normal[:, 2])
    level = body.origin_mm + np.outer(t, body.across) + np.outer(contacts.u, body.axis)
    return np.column_stack([level, z])


# What is expected without outlines, what slopes of the skin add, and the weights of the outlines.


def _prefer_smooth(normal: Array, right: Array, body: Body) -> None:
    count = body.coefficients.shape[1]
    smooth = (0.4, 0.4, 0.6, 0.6)  # mm, standard deviation of third differences of t, z, A and B
    third = np.diff(np.eye(count), 3, axis=0)
    for k, spread in enumerate(smooth):
        of_line = slice(k * count, (k + 1) * count)
        normal[of_line, of_line] += third.T @ third / spread**2
        right[of_line] -= third.T @ (third @ body.coefficients[k]) / spread**2
    # B over A is even along the finger: it holds where one edge of a mirror's view is missing
    ratio = float(np.sum(body.coefficients[3]) / np.sum(body.coefficients[2]))
    of_b = np.arange(3 * count, 4 * count)
    normal[of_b, of_b] += 1.0
    right[of_b] -= body.coefficients[3] - ratio * body.coefficients[2]


_ANGLE_DEG = 1.5
"""Standard deviation of the mirrors' angles about their nominal ones. Range: none within 0.7 to 1.4
(validation/parameters)."""
_SHEAR_SD = 0.05
"""Standard deviation of the shear: a roll by 8 deg gives about 0.045. Range: none within 0.7 to 1.4
(validation/parameters)."""


def _expected(
    body: Body, outlines: Outlines, *, with_shear: bool
) -> dict[Parameter, tuple[float, float]]:
    """Expected value and standard deviation of every shared parameter."""
    expected = {
        ("tip_mm", ""): (body.tip_mm, 0.05),  # mm
        ("squareness", ""): (body.squareness, 0.08),  # slopes weigh more
    }
    if with_shear:
        expected["shear", ""] = 0.0, _SHEAR_SD
        expected["shear_slope", ""] = 0.0, 0.3 * _SHEAR_SD
    angle = 0.0, float(np.deg2rad(_ANGLE_DEG))
    for name, outline in outlines.items():
        if outline.plane is not None:
            turn_sd = outline.turn_sd_rad
            expected["turn_rad", name] = angle if turn_sd is None else (outline.turn_rad, turn_sd)
            expected["lean_rad", name] = angle
            expected["shift_mm", name] = 0.0, 1.5  # mm
    return expected


_STEP = 1e-4
"""Step of the difference quotients by shared parameters."""
_SLOPE_ERROR = 0.1
"""Standard deviation of a measured slope of the skin (scattering flattens measured slopes). Range:
none within 0.7 to 1.4 (validation/parameters)."""


def _slope_equations(estimate: Estimate, slopes: Slopes) -> tuple[Array, Array]:
    """Normal equations (3, 3) and (3,) of squareness and shear, by the skin's slopes across."""
    residual = slopes_across(estimate.body, slopes)
    jacobian = np.column_stack(
        [
            (slopes_across(estimate.moved(parameter, _STEP).body, slopes) - residual) / _STEP
            for parameter in _FORM
        ]
    )
    known = np.isfinite(residual) & np.isfinite(jacobian).all(axis=1)
    count = int(known.sum())
    if count < 20:  # fewer slopes are not used
        return np.zeros((3, 3)), np.zeros(3)
    residual = residual[known]
    jacobian = jacobian[known]
    weight = tukey(residual, 4.0 * _SLOPE_ERROR) / _SLOPE_ERROR**2
    # as 20 independent slopes: they err together at specular reflections, and where light by way
    # of a mirror ends
    weight *= 20.0 / count
    return jacobian.T @ (weight[:, None] * jacobian), -(jacobian.T @ (weight * residual))


_OUTLINE_MM = 0.05
"""Standard deviation of a point of an outline. Range: none within 0.7 to 1.4
(validation/parameters)."""


def _robust_weight(residual: Array) -> Array:
    """Weights (n,) of one view's points, by its own scale."""
    return tukey(residual, 4.685 * max(_OUTLINE_MM, deviation(residual)))


_EDGE_SD_MM = 0.1
"""Standard deviation of the error that a whole edge of a view has in common, at its middle and from
there to its end: shading, blur and the threshold move it as a whole, which a mirror's pose would
otherwise explain. Range: 0.05 to 0.2 (validation/parameters)."""
FIT_ROUNDS = 9
"""Maximum corrections of a fit. Chosen on: speed. Range: 6 to 18 (validation/parameters)."""
_HELD_PRIORS = {"lean_rad": (0.0, 1e-3), "shift_mm": (0.0, 0.05)}
"""Expected value and standard deviation that hold mirrors in their nominal place in the first
corrections, in which the body's size is estimated: under spreading rays a wrong size is otherwise
taken for another height, and mirrors follow it."""


def fit_body(
    start: Estimate, outlines: Outlines, slopes: Slopes | None = None, rounds: int = FIT_ROUNDS
) -> Fit:
    """Fit body and poses from a first guess `start`, the `outlines` of all views and, if given,
    `slopes` of the skin, in so many `rounds` of corrections.
    """
    estimate = start
    splines = start.body.coefficients.size
    common = _common_errors(estimate, outlines)
    expected = _expected(start.body, outlines, with_shear=slopes is not None)
    held = {key: _HELD_PRIORS.get(key[0], prior) for key, prior in expected.items()}
    free = splines + len(expected)
    for turn in range(rounds):
        views, by_splines = _linearised(estimate, outlines)
        residual = np.concatenate(views)
        by_shared = [
            (estimate.moved(key, _STEP).all_residuals(outlines) - residual) / _STEP
            for key in expected
        ]
        weight = np.concatenate([_robust_weight(view) for view in views])
        # every second row is a point; those nearer to each other than 4 mm err together
        weight *= 2.0 * ROW_MM / 4.0 / _OUTLINE_MM**2
        jacobian = np.column_stack([by_splines, np.column_stack(by_shared), common])
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        normal[free:, free:] += np.eye(common.shape[1]) / _EDGE_SD_MM**2
        _prefer_smooth(normal, right, estimate.body)
        # at first mirrors keep their nominal place
        priors = held if turn < 3 else expected
        for k, (key, (value, spread)) in enumerate(priors.items(), splines):
            normal[k, k] += 1.0 / spread**2
            right[k] += (value - estimate.value(key)) / spread**2
        if slopes is not None:
            form = slice(splines + 1, splines + 4)  # squareness and shear, see `_expected`
            form_normal, form_right = _slope_equations(estimate, slopes)
            normal[form, form] += form_normal
            right[form] += form_right
        step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal) + 1e-9), right)
        estimate = _corrected(
            estimate, step[:splines], dict(zip(expected, step[splines:free], strict=True))
        )
        if turn > 3 and float(np.abs(step[:splines]).max()) < 0.01:  # mm
            break
    misfit = estimate.residuals(outlines)
    weights = {name: _robust_weight(view) for name, view in misfit.items()}
    return Fit(estimate.body, estimate.poses, misfit, weights)


MAX_SQUARE = 0.45  # largest squareness: beyond, the oval is no longer convex


def _corrected(estimate: Estimate, splines: Array, shared: Mapping[Parameter, float]) -> Estimate:
    """After a correction, with sections that are convex."""
    coefficients = estimate.body.coefficients
    coefficients = coefficients + splines.reshape(coefficients.shape)
    estimate = Estimate(replace(estimate.body, coefficients=coefficients), estimate.poses)
    for key, by in shared.items():
        estimate = estimate.moved(key, float(by))
    squareness = float(np.clip(estimate.body.squareness, -0.2, MAX_SQUARE))
    return Estimate(replace(estimate.body, squareness=squareness), estimate.poses)


DISAGREEING_MM = 0.12
"""Rms misfit of the views above which one is taken to have a wrong edge; 0.02 to 0.07 is usual.
Chosen on: simulated fingers."""


def fit_views(
    start: Estimate, outlines: Outlines, slopes: Slopes | None = None, rounds: int = FIT_ROUNDS
) -> Fit:
    """As :func:`fit_body`; if the views disagree, the one edge of a mirror's view that causes it is
    left out: a dim edge of the finger is sometimes confused with the holder behind it.
    """
    first = fit_body(start, outlines, slopes, rounds)
    if max(first.rms_mm.values()) < DISAGREEING_MM:
        return first

    def misfit(fit: Fit) -> float:
        return float(np.minimum(np.abs(fit.all_residuals(outlines)), 3.0 * DISAGREEING_MM).mean())

    best = first
    for name, outline in outlines.items():
        if outline.plane is None:
            continue
        right = _is_right(start.body, start.planes(name, outline))
        for kept in (right, ~right):
            if not kept.any():
                continue
            edge = replace(outline, touching=Touching(*(part[kept] for part in outline.touching)))
            fit = fit_body(start, {**outlines, name: edge}, slopes, rounds)
            if misfit(fit) < min(misfit(best), 0.7 * misfit(first)):
                best = fit
    return best


def _common_errors(estimate: Estimate, outlines: Outlines) -> Array:
    """Effect of one error of each edge on the residuals (n, 4 a view): even, and linear along
    it."""
    body = estimate.body
    views = []
    for name, outline in outlines.items():
        planes = estimate.planes(name, outline)
        u = body.to_frame(planes.point, place=True)[:, 1]
        along = 1.0 + 2.0 * (u - body.tip_mm) / body.length_mm
        right = _is_right(body, planes)
        views.append(np.column_stack([right, ~right, right * along, ~right * along]))
    return block_diag(*views)


def _is_right(body: Body, planes: Touching) -> BoolArray:
    """(n,) which planes touch along the right edge of their view, not along its left one."""
    normal = body.to_frame(planes.normal, place=False)
    direction = body.to_frame(planes.direction, place=False)
    return normal[:, 0] * direction[:, 2] > normal[:, 2] * direction[:, 0]


def _linearised(estimate: Estimate, outlines: Outlines) -> tuple[list[Array], Array]:
    """Residuals (n,) of each view, and their derivatives by the splines' coefficients (n, 4 K)."""
    body = estimate.body
    count = body.coefficients.shape[1]
    residuals = []
    rows = []
    for name, outline in outlines.items():
        residual, u, normal, by_a, by_b = _contacts(body, estimate.planes(name, outline))
        w = body.fraction(u)
        s = np.sqrt(w)
        along = basis(w, count)
        root = basis(s, count)
        by_t = normal[:, :1] * along
        by_z = normal[:, 2:] * along
        rows.append(
            np.column_stack([by_t, by_z, (by_a * s)[:, None] * root, (by_b * s)[:, None] * root])
        )
        residuals.append(residual)
    return residuals, np.concatenate(rows)


# Whether views are of one finger.


_THICKNESS = (0.4, 1.4)  # thickness of fingers over their breadth, from and to


def refuse_misfit(fit: Fit) -> None:
    """Refuse views that no finger explains."""
    for name, misfit in fit.misfit_mm.items():
        size = float(np.median(np.abs(misfit)))
        require(
            size < 0.6,  # views that agree no better than this (median) are not of one finger
            f"the views do not fit one finger: the {name} view's outline lies {size:.1f} mm beside"
            " the others'; check that one finger alone is in view, and that the rig file's mirrors"
            " are the ones in the picture.",
        )
    thickness = float(np.median(fit.body.coefficients[3] / fit.body.coefficients[2]))
    require(
        _THICKNESS[0] < thickness < _THICKNESS[1],
        f"the views do not fit one finger: in the mirrors it would be {thickness:.2f} times as"
        " thick as it is broad in front; check that one finger alone is in view.",
    )
    for name, pose in fit.poses.items():
        off_deg = float(np.rad2deg(max(abs(pose.turn_rad), abs(pose.lean_rad))))
        # a mirror that would be further off its place in the rig file than this is rejected
        require(
            off_deg < 7.0,
            f"the views do not fit one finger: the {name} mirror would be {off_deg:.0f} deg off its"
            " place in the rig file; check that one finger alone is in view, or correct the rig"
            " file.",
        )


def facts_of(fit: Fit) -> dict[str, Any]:
    """For the report: poses, misfits, the sections' form."""
    return {
        "method": "outlines",
        "mirrors": sorted(fit.poses),
        "squareness": fit.body.squareness,
        "shear": fit.body.shear,
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
