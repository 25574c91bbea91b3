"""A body and mirrors that agree with all outlines: Gauss-Newton on planes that touch the finger.

Every point of every outline says that a plane touches the body: the support of the section where it touches, along the
plane's normal, equals the plane's offset. These equations are linear in centre lines, nearly linear in the half axes,
and hold for any pose of the mirrors; the poses, the tip, the sections' squareness and shear are found with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.body import Body, basis
from splitknit.mirrors.ends import COMMON_MM, fitted_ends, misfit_of_end
from splitknit.mirrors.planes import Touching
from splitknit.mirrors.priors import add_priors, add_slopes, robust_weights
from splitknit.mirrors.settings import OUTLINE_MM, ROW_MM, MirrorShapeSettings
from splitknit.mirrors.state import Fit, Pose, SeenIn, Slopes, State, all_misfits, all_planes, misfit_of

Array = NDArray[np.float64]

SURE_FROM = 4
"""Corrections before points of an outline may be left out altogether."""
SETTLED = 0.01
"""A correction of the splines (mm) below this is the last one."""


def fit_body(  # noqa: PLR0917
    body: Body,
    front: Touching,
    mirrors: Mapping[str, SeenIn],
    poses: Mapping[str, Pose],
    settings: MirrorShapeSettings,
    slopes: Slopes | None = None,
    shear: float = 0.0,
    sure_from: int = SURE_FROM,
) -> Fit:
    """Fit body and poses.

    Parameters
    ----------
    body : a first guess
    front : planes of the front view's outline
    mirrors : by name
    poses : a first guess
    settings : MirrorShapeSettings
    slopes : of the skin, optional
    shear : where the slopes do not say it
    sure_from : corrections before points of an outline may be left out altogether
    """
    body = replace(body, shear=shear)
    ends_on = {name: seen for name, seen in mirrors.items() if seen.from_tip}
    if ends_on:
        return _with_ends(body, front, mirrors, poses, settings, slopes)
    state = State(body, dict(poses))
    names = sorted(mirrors)
    free_section = settings.section == "oval"
    count = body.coefficients.shape[1]
    sizes = [len(front.offset_mm), *(len(mirrors[name].touching.offset_mm) for name in names)]
    ends = np.cumsum(sizes)[:-1]
    for turn in range(settings.rounds):
        residual, spline = _linearised(state, front, mirrors, names)
        globals_ = _global_names(names, slopes is not None, free_section)
        by_global = np.column_stack(
            [_change(state, name, size, front, mirrors, names, residual) for name, size in globals_]
        )
        weight = robust_weights(residual, ends, OUTLINE_MM, sure=turn >= sure_from)
        weight *= min(1.0, 2.0 * ROW_MM / COMMON_MM) / OUTLINE_MM**2
        jacobian = np.column_stack([spline, by_global])
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        add_priors(normal, right, state, globals_, mirrors, body.tip_mm, settings, count)
        if slopes is not None:
            add_slopes(normal, right, state, globals_, slopes, count)
        step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal) + 1e-9), right)
        state = state.stepped(np.asarray(step, dtype=np.float64), globals_, count)
        if turn > sure_from and float(np.abs(step[: 4 * count]).max()) < SETTLED:
            break
    residual = all_misfits(state, front, mirrors, names)
    weight = robust_weights(residual, ends, OUTLINE_MM, sure=True)
    split = dict(zip(("front", *names), np.split(residual, ends), strict=True))
    weights = dict(zip(("front", *names), np.split(weight, ends), strict=True))
    return Fit(state.body, state.poses, split, weights)


def _with_ends(  # noqa: PLR0917
    body: Body,
    front: Touching,
    mirrors: Mapping[str, SeenIn],
    poses: Mapping[str, Pose],
    settings: MirrorShapeSettings,
    slopes: Slopes | None,
) -> Fit:
    """With mirrors beyond the tip: what they show of the sections' form, the others fit with that form again.

    They see the largest sections only, and those beside the tip hide the rest: so they say nothing of the lines along
    the finger.
    """
    beside = {name: seen for name, seen in mirrors.items() if not seen.from_tip}
    first = fit_body(body, front, beside, {name: poses[name] for name in beside}, settings, slopes)
    state = State(first.body, {**first.poses, **{name: poses[name] for name in mirrors if name not in beside}})
    ends = sorted(name for name in mirrors if name not in beside)
    places = [(f"{kind} {name}", 1e-4) for name in ends for kind in ("turn_rad", "lean_rad", "shift_mm")]
    form = ["squareness"] * (settings.section == "oval") + ["shear"]
    state = fitted_ends(state, mirrors, ends, [*((name, 1e-4) for name in form), *places], settings)
    again = replace(settings, squareness=state.body.squareness, squareness_spread=1e-3)
    poses = {name: state.poses[name] for name in beside}
    last = fit_body(state.body, front, beside, poses, again, None, state.body.shear, sure_from=0)
    state = fitted_ends(State(last.body, {**state.poses, **last.poses}), mirrors, ends, places, settings)
    misfit, weights = dict(last.misfit_mm), dict(last.weights)
    for name in ends:
        misfit[name] = misfit_of_end(state, mirrors, name)
        weights[name] = robust_weights(misfit[name], np.zeros(0, dtype=np.intp), OUTLINE_MM, sure=True)
    return Fit(state.body, state.poses, misfit, weights)


def _global_names(names: list[str], section_seen: bool, free_section: bool) -> list[tuple[str, float]]:
    """Parameters that all sections share, each with the step of its difference quotient."""
    found = [("tip_mm", 1e-3)]
    if free_section:
        found.append(("squareness", 1e-4))
    if section_seen:
        found += [("shear", 1e-4), ("shear_slope", 1e-4)]
    for name in names:
        found += [(f"turn_rad {name}", 1e-5), (f"lean_rad {name}", 1e-5), (f"shift_mm {name}", 1e-3)]
    return found


def _change(  # noqa: PLR0917
    state: State,
    name: str,
    size: float,
    front: Touching,
    mirrors: Mapping[str, SeenIn],
    names: list[str],
    residual: Array,
) -> Array:
    """Derivative (n,) of the residuals by one of the parameters that all sections share."""
    moved = state.moved(name, size)
    mirror = name.partition(" ")[2]
    if not mirror:
        return (all_misfits(moved, front, mirrors, names) - residual) / size
    change = np.zeros_like(residual)
    start = len(front.offset_mm)
    for other in names:
        stop = start + len(mirrors[other].touching.offset_mm)
        if other == mirror:  # a mirror's pose changes what is seen in it alone
            planes = moved.poses[mirror].of(mirrors[mirror]).reflect(mirrors[mirror].touching)
            change[start:stop] = (misfit_of(moved, planes, from_tip=False)[0] - residual[start:stop]) / size
        start = stop
    return change


def _linearised(state: State, front: Touching, mirrors: Mapping[str, SeenIn], names: list[str]) -> tuple[Array, Array]:
    """Residuals (n,), and their derivatives by the splines' coefficients (n, 4 K)."""
    body = state.body
    count = body.coefficients.shape[1]
    tips = [False, *(mirrors[name].from_tip for name in names)]
    residuals, rows = [], []
    for part, tip in zip(all_planes(state, front, mirrors, names), tips, strict=True):
        residual, u, normal, by_a, by_b = misfit_of(state, part, from_tip=tip)
        w = body.share(u)
        s = np.sqrt(w)
        along, root = basis(w, count), basis(s, count)
        rows.append(
            np.column_stack(
                [
                    normal[:, :1] * along,
                    normal[:, 2:] * along,
                    (by_a * s)[:, None] * root,
                    (by_b * s)[:, None] * root,
                ]
            )
        )
        residuals.append(residual)
    return np.concatenate(residuals), np.concatenate(rows)
