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
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import approx_fprime

from splitknit.errors import require
from splitknit.imaging.robust import deviation, tukey
from splitknit.mirrors.body import Body, Slopes, slopes_across
from splitknit.mirrors.outline import ROW_MM
from splitknit.mirrors.reflection import Plane, Pose, Touching
from splitknit.model import Array, BoolArray

_OF_BODY = ("tip_mm", "squareness", "shear", "shear_slope")
"""Numbers of the body that all its sections share."""


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

    @property
    def vector(self) -> Array:
        """(n,) all that is estimated: coefficients, shared numbers of the body, poses."""
        shared = [getattr(self.body, name) for name in _OF_BODY]
        return np.concatenate([self.body.coefficients.ravel(), shared, *self.poses.values()])

    def at(self, vector: Array) -> Estimate:
        """The estimate whose :attr:`vector` is this one."""
        of_splines, shared, poses = np.split(vector, _ends(self.body))
        coefficients = of_splines.reshape(self.body.coefficients.shape)
        own = dict(zip(_OF_BODY, shared.tolist(), strict=True))
        pairs = zip(self.poses, poses.reshape(-1, 3).tolist(), strict=True)
        return Estimate(
            replace(self.body, coefficients=coefficients, **own),
            {name: Pose(*pose) for name, pose in pairs},
        )

    def planes(self, name: str, outline: ViewOutline) -> Touching:
        """Planes of one view as they touch the finger itself."""
        if outline.plane is None:
            return outline.touching
        return outline.plane.posed(*self.poses[name]).reflect(outline.touching)

    def residuals(self, outlines: Outlines) -> dict[str, Array]:
        """(n,) distance of the body beyond the planes of each view, in mm."""
        return {
            name: _contacts(self.body, self.planes(name, outline))[1]
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


def _ends(body: Body) -> tuple[int, int]:
    """Where the splines' coefficients and the body's shared numbers end in a vector."""
    return body.coefficients.size, body.coefficients.size + len(_OF_BODY)


def _contacts(body: Body, planes: Touching) -> tuple[Array, Array]:
    """(n, 3) t, u, z of the body where the planes of one view touch it, and (n,) how far it reaches
    beyond each."""
    normal = body.to_frame(planes.normal, place=False)
    point = body.to_frame(planes.point, place=True)
    direction = body.to_frame(planes.direction, place=False)
    within = np.maximum(direction[:, 0] ** 2 + direction[:, 2] ** 2, 1e-6)
    u = point[:, 1]
    for _ in range(4):
        t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
        places = np.column_stack([t, u, z])
        far = ((t - point[:, 0]) * direction[:, 0] + (z - point[:, 2]) * direction[:, 2]) / within
        u = point[:, 1] + far * direction[:, 1]
    return places, ((places - point) * normal).sum(axis=1)


def touched(body: Body, planes: Touching) -> Array:
    """(n, 3) points of the body, rig's frame, at which the planes of a view touch."""
    t, u, z = _contacts(body, planes)[0].T
    return np.column_stack([body.origin_mm + np.outer(t, body.across) + np.outer(u, body.axis), z])


# What is expected without outlines, what slopes of the skin add, and the weights of the outlines.


_SMOOTH_MM = np.array([[0.4], [0.4], [0.6], [0.6]])
"""Standard deviation of third differences of t, z, A and B."""
_ANGLE_DEG = 1.5
"""Standard deviation of the mirrors' angles about their nominal ones. Range: none within 0.7 to 1.4
(validation/parameters)."""
_SHEAR_SD = 0.05
"""Standard deviation of the shear: a roll by 8 deg gives about 0.045. Range: none within 0.7 to 1.4
(validation/parameters)."""
_HELD = (np.inf, 1e-3, 0.05)
"""Largest standard deviations of a mirror's turn, lean and shift in the first corrections, in which
the body's size is estimated: under spreading rays a wrong size is otherwise taken for another
height, and mirrors follow it."""


def _expected(start: Estimate, outlines: Outlines, *, with_shear: bool) -> tuple[Array, Array]:
    """Expected values and standard deviations of the body's shared numbers and of the poses."""
    shear_sd = _SHEAR_SD if with_shear else 1e-9
    # of the tip in mm; of the squareness, on which slopes weigh more
    expected = [(start.body.tip_mm, 0.05), (start.body.squareness, 0.08)]
    expected += [(0.0, shear_sd), (0.0, 0.3 * shear_sd)]
    angle = 0.0, float(np.deg2rad(_ANGLE_DEG))
    for name in start.poses:
        outline = outlines[name]
        known = outline.turn_sd_rad
        turn = angle if known is None else (outline.turn_rad, known)
        expected += [turn, angle, (0.0, 1.5)]  # the last of the shift, mm
    value, spread = np.transpose(expected)
    return value, spread


_SLOPE_ERROR = 0.1
"""Standard deviation of a measured slope of the skin (scattering flattens measured slopes). Range:
none within 0.7 to 1.4 (validation/parameters)."""


def _slope_weight(residual: Array) -> Array:
    """Weights (n,) of the skin's slopes: as of 20 independent ones, for they err together at
    specular reflections, and where light by way of a mirror ends; fewer are not used."""
    count = int(np.isfinite(residual).sum())
    if count < 20:
        return np.zeros_like(residual)
    weight = tukey(np.nan_to_num(residual, nan=np.inf), 4.0 * _SLOPE_ERROR) / _SLOPE_ERROR**2
    return weight * 20.0 / count


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


def fit_body(
    start: Estimate, outlines: Outlines, slopes: Slopes | None = None, rounds: int = FIT_ROUNDS
) -> Fit:
    """Fit body and poses from a first guess `start`, the `outlines` of all views and, if given,
    `slopes` of the skin, in so many `rounds` of corrections.
    """
    common = _common_errors(start, outlines)
    expected, spread = _expected(start, outlines, with_shear=slopes is not None)
    held = np.minimum(spread, [*[np.inf] * len(_OF_BODY), *_HELD * len(start.poses)])
    splines, _ = _ends(start.body)
    vector = np.concatenate([start.vector, np.zeros(common.shape[1])])
    free = vector.size - common.shape[1]

    def correction(vector: Array, sd: Array) -> Array:
        now = start.at(vector[:free])
        weight = np.concatenate([_robust_weight(view) for view in now.residuals(outlines).values()])
        # every second row is a point; those nearer to each other than 4 mm err together
        root = np.sqrt(weight * 2.0 * ROW_MM / 4.0) / _OUTLINE_MM
        _, _, a, b = now.body.coefficients
        even_b = a * b.sum() / a.sum()
        slope = np.zeros(0) if slopes is None else slopes_across(now.body, slopes)
        slope_root = np.sqrt(_slope_weight(slope))

        def rows(vector: Array) -> Array:
            """All that is to be small, over its standard deviation."""
            estimate, errors = start.at(vector[:free]), vector[free:]
            coefficients = estimate.body.coefficients
            form = replace(estimate.body, coefficients=now.body.coefficients)
            here = slope if slopes is None else slopes_across(form, slopes)
            return np.concatenate(
                [
                    root * (estimate.all_residuals(outlines) + common @ errors),
                    (np.diff(coefficients, 3) / _SMOOTH_MM).ravel(),
                    # B over A is even along the finger: it holds where one edge of a mirror's view
                    # is missing
                    coefficients[3] - even_b,
                    (vector[splines:free] - expected) / sd,
                    errors / _EDGE_SD_MM,
                    slope_root * np.nan_to_num(np.where(np.isfinite(here), here, slope)),
                ]
            )

        jacobian = approx_fprime(vector, rows, _STEP)
        return np.asarray(np.linalg.lstsq(jacobian, -rows(vector), rcond=None)[0])

    for turn in range(rounds):
        step = correction(vector, held if turn < 3 else spread)  # mirrors keep their place at first
        vector = vector + step
        vector[splines + 1] = np.clip(vector[splines + 1], -0.2, MAX_SQUARE)
        if turn > 3 and float(np.abs(step[:splines]).max()) < 0.01:  # mm
            break
    estimate = start.at(vector[:free])
    misfit = estimate.residuals(outlines)
    weights = {name: _robust_weight(view) for name, view in misfit.items()}
    return Fit(estimate.body, estimate.poses, misfit, weights)


MAX_SQUARE = 0.45  # largest squareness: beyond, the oval is no longer convex
_STEP = 1e-4
"""Step of the difference quotients."""
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
