"""A body and mirrors that agree with all outlines: Gauss-Newton on planes that touch the finger.

Every point of every outline implies that a plane touches the body: the support of the section where it touches, along
the plane's normal, equals the plane's offset. These equations are linear in centre lines, nearly linear in the half
axes, and hold for any pose of the mirrors; the poses, the tip, the sections' squareness and shear are found with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.mirrors.body import (
    LIMITS,
    Body,
    Fit,
    Pose,
    SeenIn,
    Slopes,
    State,
    all_misfits,
    all_planes,
    basis,
    convex,
    misfit_of,
)
from splitknit.mirrors.planes import Touching
from splitknit.mirrors.settings import ANGLE_DEG, OFFSET_MM, OUTLINE_MM, ROW_MM, MirrorShapeSettings

# Mirrors beyond the tip: they show the form of the largest sections.


# What is expected without any outline, what the skin's slopes add, and how far points of an outline are trusted.


Array = NDArray[np.float64]

_SLOPE_ERROR = 0.1
"""Standard deviation of a measured slope of the skin; skin that scatters light looks flatter than it is."""


SHEAR_SD = 0.05
"""Standard deviation of the shear: a roll by 8 deg gives about 0.045."""
INDEPENDENT_SLOPES = 20.0
"""Slopes err together: at specular reflections, and where light by way of a mirror ends."""
TIP_SD_MM = 0.05
"""Standard deviation of the tip's place as the front view's outline has it."""


def _add_priors(  # noqa: PLR0917
    normal: Array,
    right: Array,
    state: State,
    names: list[tuple[str, float]],
    mirrors: Mapping[str, SeenIn],
    tip_mm: float,
    settings: MirrorShapeSettings,
    count: int,
) -> None:
    """What is expected without any outline: smooth lines, sections of like form, mirrors near their nominal poses."""
    body = state.body
    smooth = (0.4, 0.4, 0.6, 0.6)  # mm, standard deviation of third differences of t, z, A and B
    third = np.diff(np.eye(count), 3, axis=0)
    for k, rough in enumerate(smooth):
        of_line = slice(k * count, (k + 1) * count)
        normal[of_line, of_line] += third.T @ third / rough**2
        right[of_line] -= third.T @ (third @ body.coefficients[k]) / rough**2
    # B over A is even along the finger: it holds where one edge of a mirror's view is missing
    ratio = float(np.sum(body.coefficients[3]) / np.sum(body.coefficients[2]))
    apart = body.coefficients[3] - ratio * body.coefficients[2]
    part = np.arange(3 * count, 4 * count)
    normal[part, part] += 1.0
    right[part] -= apart
    expected = {
        "squareness": (settings.squareness - body.squareness, settings.squareness_spread),
        "shear": (-body.shear, SHEAR_SD),
        "shear_slope": (-body.shear_slope, 0.3 * SHEAR_SD),
        "tip_mm": (tip_mm - body.tip_mm, TIP_SD_MM),
    }
    for k, (name, _) in enumerate(names):
        kind, _, mirror = name.partition(" ")
        if mirror:
            pose = state.poses[mirror]
            spread = OFFSET_MM if kind == "shift_mm" else np.deg2rad(ANGLE_DEG)
            away = -getattr(pose, kind)
            deviation = mirrors[mirror].turn_sd_rad
            if kind == "turn_rad" and deviation is not None:
                away, spread = away + mirrors[mirror].turn_rad, deviation
        else:
            away, spread = expected[kind]
        normal[4 * count + k, 4 * count + k] += 1.0 / spread**2
        right[4 * count + k] += away / spread**2


def _add_slopes(  # noqa: PLR0917
    normal: Array, right: Array, state: State, names: list[tuple[str, float]], slopes: Slopes, count: int
) -> None:
    """The skin's slopes across the finger, as far as squareness and shear answer to them."""
    chosen = [k for k, (name, _) in enumerate(names) if name in ("squareness", "shear", "shear_slope")]
    if not chosen:
        return
    from splitknit.mirrors.body import slopes_across  # it needs bodies, too

    residual = slopes_across(state.body, slopes)
    good = np.isfinite(residual)
    columns = []
    for k in chosen:
        name, size = names[k]
        columns.append((slopes_across(state.moved(name, size).body, slopes) - residual) / size)
    jacobian = np.column_stack(columns)
    good &= np.isfinite(jacobian).all(axis=1)
    if int(good.sum()) < 20:
        return
    weight = _tukey(residual[good], 4.0 * _SLOPE_ERROR) / _SLOPE_ERROR**2
    weight *= INDEPENDENT_SLOPES / max(int(good.sum()), 1)
    part = jacobian[good]
    where = 4 * count + np.asarray(chosen)
    normal[np.ix_(where, where)] += part.T @ (weight[:, None] * part)
    right[where] -= part.T @ (weight * residual[good])


def _robust_weights(residual: Array, ends: Array, sigma: float, *, sure: bool) -> Array:
    """Weights of the outlines' points, each view with its own scale; milder ones before the fit is `sure`."""
    parts = []
    for part in np.split(residual, ends):
        size = np.abs(part)
        scale = max(sigma, 1.4826 * float(np.median(size)))
        if sure:
            parts.append(_tukey(part, 4.685 * scale))
        else:  # Huber
            parts.append(np.where(size >= 5.0, 0.0, np.minimum(1.0, 1.345 * scale / np.maximum(size, 1e-9))))
    return np.concatenate(parts)


def _tukey(residual: Array, limit: float) -> Array:
    """Tukey's biweight: one at zero, nothing from `limit` on."""
    return np.asarray(np.clip(1.0 - (residual / limit) ** 2, 0.0, None) ** 2)


TIP_TRUST = 0.1
"""Weight of a view from beyond the tip: it sees the largest sections only."""
COMMON_MM = 4.0
"""Points of an outline that are nearer to each other than this err together."""
_END_SURE = 2
"""Corrections before points of an outline may be left out altogether."""
_END_SETTLED = 2e-4
"""A correction (mm, rad) below this is the last one."""


def _fitted_ends(
    state: State,
    mirrors: Mapping[str, SeenIn],
    ends: list[str],
    names: list[tuple[str, float]],
    settings: MirrorShapeSettings,
) -> State:
    """With those parameters fitted to the views from beyond the tip."""
    spread = {"squareness": settings.squareness_spread, "shear": 0.5 * SHEAR_SD, "shift_mm": OFFSET_MM}
    expected = {"squareness": state.body.squareness, "shear": state.body.shear}

    def misfit(state: State) -> Array:
        return np.concatenate([_misfit_of_end(state, mirrors, name) for name in ends])

    for turn in range(8):
        residual = misfit(state)
        jacobian = np.column_stack([(misfit(state.moved(name, size)) - residual) / size for name, size in names])
        scale = max(OUTLINE_MM, 1.4826 * float(np.median(np.abs(residual))))
        weight = _tukey(residual, 4.685 * scale) if turn > _END_SURE else (np.abs(residual) < 5.0).astype(np.float64)
        weight = weight * (TIP_TRUST * 2.0 * ROW_MM / COMMON_MM / OUTLINE_MM**2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        for k, (name, _) in enumerate(names):
            kind, _, mirror = name.partition(" ")
            size = spread.get(kind, float(np.deg2rad(ANGLE_DEG)))
            value = getattr(state.poses[mirror], kind) if mirror else getattr(state.body, kind)
            normal[k, k] += 1.0 / size**2
            right[k] += (expected.get(kind, 0.0) - value) / size**2
        step = np.linalg.solve(normal, right)
        for (name, _), by in zip(names, step, strict=True):
            state = state.moved(name, float(np.clip(by, *LIMITS[name.partition(" ")[0]])))
        state = State(convex(state.body), state.poses)
        if turn > _END_SURE and float(np.abs(step).max()) < _END_SETTLED:
            break
    return state


def _misfit_of_end(state: State, mirrors: Mapping[str, SeenIn], name: str) -> Array:
    """Misfit of a mirror beyond the tip."""
    planes = state.poses[name].of(mirrors[name]).reflect(mirrors[name].touching)
    return misfit_of(state, planes, from_tip=True)[0]


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
    shear : where the slopes do not determine it
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
        weight = _robust_weights(residual, ends, OUTLINE_MM, sure=turn >= sure_from)
        weight *= min(1.0, 2.0 * ROW_MM / COMMON_MM) / OUTLINE_MM**2
        jacobian = np.column_stack([spline, by_global])
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        _add_priors(normal, right, state, globals_, mirrors, body.tip_mm, settings, count)
        if slopes is not None:
            _add_slopes(normal, right, state, globals_, slopes, count)
        step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal) + 1e-9), right)
        state = state.stepped(np.asarray(step, dtype=np.float64), globals_, count)
        if turn > sure_from and float(np.abs(step[: 4 * count]).max()) < SETTLED:
            break
    residual = all_misfits(state, front, mirrors, names)
    weight = _robust_weights(residual, ends, OUTLINE_MM, sure=True)
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

    They see the largest sections only, and those beside the tip hide the rest: so they do not constrain the lines along
    the finger.
    """
    beside = {name: seen for name, seen in mirrors.items() if not seen.from_tip}
    first = fit_body(body, front, beside, {name: poses[name] for name in beside}, settings, slopes)
    state = State(first.body, {**first.poses, **{name: poses[name] for name in mirrors if name not in beside}})
    ends = sorted(name for name in mirrors if name not in beside)
    places = [(f"{kind} {name}", 1e-4) for name in ends for kind in ("turn_rad", "lean_rad", "shift_mm")]
    form = ["squareness"] * (settings.section == "oval") + ["shear"]
    state = _fitted_ends(state, mirrors, ends, [*((name, 1e-4) for name in form), *places], settings)
    again = replace(settings, squareness=state.body.squareness, squareness_spread=1e-3)
    poses = {name: state.poses[name] for name in beside}
    last = fit_body(state.body, front, beside, poses, again, None, state.body.shear, sure_from=0)
    state = _fitted_ends(State(last.body, {**state.poses, **last.poses}), mirrors, ends, places, settings)
    misfit, weights = dict(last.misfit_mm), dict(last.weights)
    for name in ends:
        misfit[name] = _misfit_of_end(state, mirrors, name)
        weights[name] = _robust_weights(misfit[name], np.zeros(0, dtype=np.intp), OUTLINE_MM, sure=True)
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
        w = body.fraction(u)
        s = np.sqrt(w)
        along, root = basis(w, count), basis(s, count)
        rows.append(
            np.column_stack(
                [normal[:, :1] * along, normal[:, 2:] * along, (by_a * s)[:, None] * root, (by_b * s)[:, None] * root]
            )
        )
        residuals.append(residual)
    return np.concatenate(residuals), np.concatenate(rows)


# Whether views are of one finger, and what was found.


_MISFIT_MM = 0.6
"""Views that agree no better than this (rms) are not of one finger."""

THICKNESS = (0.4, 1.4)
"""Of fingers, over their breadth."""
MAX_DEG = 7.0
"""A mirror that would be further off than this is rejected."""


def refuse_misfit(fit: Fit, seen: Mapping[str, SeenIn]) -> None:
    """Refuse views that no finger explains."""
    for name, misfit in fit.misfit_mm.items():
        if name in seen and seen[name].from_tip:
            continue
        size = float(np.median(np.abs(misfit)))
        require(
            size < _MISFIT_MM,
            f"the views do not fit one finger: the {name} view's outline lies {size:.1f} mm beside the others'; check "
            "that the rig file's mirrors are the ones in the picture and that one finger alone is in view.",
        )
    thickness = float(np.median(fit.body.coefficients[3] / fit.body.coefficients[2]))
    require(
        THICKNESS[0] < thickness < THICKNESS[1],
        f"the views do not fit one finger: in the mirrors it would be {thickness:.2f} times as thick as it is broad in "
        "front; check that one finger alone is in view.",
    )
    for name, pose in fit.poses.items():
        worst = max(abs(float(np.rad2deg(angle))) for angle in (pose.turn_rad, pose.lean_rad))
        require(
            worst < MAX_DEG,
            f"the views do not fit one finger: the {name} mirror would be {worst:.0f} deg off its place in the rig "
            "file; check that one finger alone is in view, or correct the rig file.",
        )


def facts_of(fit: Fit, settings: MirrorShapeSettings, slopes: Slopes | None) -> dict[str, Any]:
    """For the report: poses, misfits, the sections' form."""
    rms = {}
    for name, misfit in fit.misfit_mm.items():
        weight = fit.weights[name]
        rms[name] = float(np.sqrt(np.sum(weight * misfit**2) / max(float(weight.sum()), 1e-9)))
    body = fit.body
    return {
        "method": "outlines",
        "mirrors": sorted(fit.poses),
        "section": settings.section,
        "section_seen_by": "slopes" if slopes is not None else "expectation",
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
        "outline_rms_mm": rms,
        "outline_used": {name: float(np.mean(weight > 0)) for name, weight in fit.weights.items()},
    }
