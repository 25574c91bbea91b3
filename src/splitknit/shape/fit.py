"""A body and mirrors that agree with all outlines: Gauss-Newton on planes that touch the finger.

Every point of every outline says that a plane touches the body: the support of the section where it touches, along the
plane's normal, equals the plane's offset. These equations are linear in centre lines, nearly linear in the half axes,
and hold for any pose of the mirrors; the poses, the tip, the sections' squareness and shear are found with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.shape.body import MOST_SQUARE, Body, basis
from splitknit.shape.planes import MirrorPlane, Touching
from splitknit.shape.settings import MirrorShapeSettings

Array = NDArray[np.float64]

SHEAR_SD = 0.05
"""Standard deviation of the shear: a roll by 8 deg gives about 0.045."""
INDEPENDENT_SLOPES = 20.0
"""Slopes err together: at glare, and where light by way of a mirror ends."""
TIP_TRUST = 0.1
"""Weight of a view from beyond the tip: it sees the largest sections only."""
COMMON_MM = 4.0
"""Points of an outline that are nearer to each other than this err together."""
TIP_SD_MM = 0.05
"""Standard deviation of the tip's place as the front view's outline has it."""
SURE_FROM = 4
"""Corrections before points of an outline may be left out altogether."""
STATIONS = 80
"""Places along the body at which a plane seen from the tip is tried."""


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Measured slopes of the skin at places of the front view."""

    places_mm: Array
    """(n, 2) on the finger plane."""
    x: Array
    """(n,) dz/dx."""
    y: Array
    """(n,) dz/dy."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenIn:
    """One mirror: what is seen in it, and where it nominally is."""

    touching: Touching
    """As the camera sees it, not yet reflected."""
    plane: MirrorPlane
    about_mm: Array
    """(3,) point of the mirror about which it turns."""
    from_tip: bool = False
    """Whether it looks along the finger."""
    turn_rad: float = 0.0
    """What the tips of the views say about its turn."""
    turn_sd_rad: float | None = None
    """Standard deviation of that; None: they say nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """How a mirror differs from its nominal pose."""

    turn_rad: float = 0.0
    lean_rad: float = 0.0
    shift_mm: float = 0.0

    def of(self, seen: SeenIn) -> MirrorPlane:
        """The mirror where it is."""
        return seen.plane.moved(self.turn_rad, self.lean_rad, self.shift_mm, seen.about_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The result."""

    body: Body
    poses: Mapping[str, Pose]
    misfit_mm: Mapping[str, Array]
    """Distance (n,) of the body from each touching plane of ``front`` and every mirror, positive where it is too
    large."""
    weights: Mapping[str, Array]


def fit_body(  # noqa: PLR0917
    body: Body,
    front: Touching,
    mirrors: Mapping[str, SeenIn],
    poses: Mapping[str, Pose],
    settings: MirrorShapeSettings,
    slopes: Slopes | None = None,
    shear: float = 0.0,
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
    """
    body = replace(body, shear=shear)
    ends_on = {name: seen for name, seen in mirrors.items() if seen.from_tip}
    if ends_on:
        return _with_ends(body, front, mirrors, poses, settings, slopes)
    state = _State(body, dict(poses))
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
        weight = _weights(residual, ends, settings.outline_mm, sure=turn >= SURE_FROM)
        weight *= min(1.0, 2.0 * settings.row_mm / COMMON_MM) / settings.outline_mm**2
        jacobian = np.column_stack([spline, by_global])
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        _add_priors(normal, right, state, globals_, mirrors, body.tip_mm, settings, count)
        if slopes is not None:
            _add_slopes(normal, right, state, globals_, slopes, settings, count)
        step = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal) + 1e-9), right)
        state = state.stepped(np.asarray(step, dtype=np.float64), globals_, count)
    residual = _residual(state, front, mirrors, names)
    weight = _weights(residual, ends, settings.outline_mm, sure=True)
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
    state = _State(first.body, {**first.poses, **{name: poses[name] for name in mirrors if name not in beside}})
    ends = sorted(name for name in mirrors if name not in beside)
    places = [(f"{kind} {name}", 1e-4) for name in ends for kind in ("turn_rad", "lean_rad", "shift_mm")]
    form = ["squareness"] * (settings.section == "oval") + ["shear"]
    state = _fitted_ends(state, mirrors, ends, [*((name, 1e-4) for name in form), *places], settings)
    again = replace(settings, squareness=state.body.squareness, squareness_spread=1e-3)
    poses = {name: state.poses[name] for name in beside}
    last = fit_body(state.body, front, beside, poses, again, None, state.body.shear)
    state = _fitted_ends(_State(last.body, {**state.poses, **last.poses}), mirrors, ends, places, settings)
    misfit, weights = dict(last.misfit_mm), dict(last.weights)
    for name in ends:
        misfit[name] = _of_end(state, mirrors, name)
        weights[name] = _weights(misfit[name], np.zeros(0, dtype=np.intp), settings.outline_mm, sure=True)
    return Fit(state.body, state.poses, misfit, weights)


def _fitted_ends(
    state: _State,
    mirrors: Mapping[str, SeenIn],
    ends: list[str],
    names: list[tuple[str, float]],
    settings: MirrorShapeSettings,
) -> _State:
    """With those parameters fitted to the views from beyond the tip."""
    spread = {"squareness": settings.squareness_spread, "shear": 0.5 * SHEAR_SD, "shift_mm": settings.offset_mm}
    expected = {"squareness": state.body.squareness, "shear": state.body.shear}

    def misfit(state: _State) -> Array:
        return np.concatenate([_of_end(state, mirrors, name) for name in ends])

    for turn in range(8):
        residual = misfit(state)
        jacobian = np.column_stack([(misfit(state.moved(name, size)) - residual) / size for name, size in names])
        scale = max(settings.outline_mm, 1.4826 * float(np.median(np.abs(residual))))
        weight = _tukey(residual, 4.685 * scale) if turn > 2 else (np.abs(residual) < 5.0).astype(np.float64)
        weight = weight * (TIP_TRUST * 2.0 * settings.row_mm / COMMON_MM / settings.outline_mm**2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        for k, (name, _) in enumerate(names):
            kind, _, mirror = name.partition(" ")
            size = spread.get(kind, float(np.deg2rad(settings.angle_deg)))
            value = getattr(state.poses[mirror], kind) if mirror else getattr(state.body, kind)
            normal[k, k] += 1.0 / size**2
            right[k] += (expected.get(kind, 0.0) - value) / size**2
        for (name, _), by in zip(names, np.linalg.solve(normal, right), strict=True):
            state = state.moved(name, float(np.clip(by, *_LIMITS[name.partition(" ")[0]])))
        state = _State(_convex(state.body), state.poses)
    return state


def _of_end(state: _State, mirrors: Mapping[str, SeenIn], name: str) -> Array:
    """Misfit of a mirror beyond the tip."""
    planes = state.poses[name].of(mirrors[name]).reflect(mirrors[name].touching)
    return _one(state, planes, from_tip=True)[0]


def _convex(body: Body) -> Body:
    return replace(body, squareness=float(np.clip(body.squareness, -0.2, MOST_SQUARE)))


def touched(body: Body, planes: Touching) -> Array:
    """(n, 3) points of the body, rig's frame, at which planes of a view beside it touch."""
    u, normal, _ = _stations(body, planes, from_tip=False)
    t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
    level = body.origin_mm + np.outer(t, body.across) + np.outer(u, body.axis)
    return np.column_stack([level, z])


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    body: Body
    poses: dict[str, Pose]

    def moved(self, name: str, by: float) -> _State:
        """With one of the parameters that all sections share moved."""
        kind, _, mirror = name.partition(" ")
        if mirror:
            pose = self.poses[mirror]
            return _State(self.body, {**self.poses, mirror: replace(pose, **{kind: getattr(pose, kind) + by})})
        return _State(replace(self.body, **{kind: getattr(self.body, kind) + by}), self.poses)

    def stepped(self, step: Array, names: list[tuple[str, float]], count: int) -> _State:
        state = _State(self.body.grown(step[: 4 * count]), self.poses)
        for (name, _), by in zip(names, step[4 * count :], strict=True):
            state = state.moved(name, float(np.clip(by, *_LIMITS[name.partition(" ")[0]])))
        return _State(_convex(state.body), state.poses)


_LIMITS = {
    "tip_mm": (-1.0, 1.0),
    "squareness": (-0.15, 0.15),
    "shear": (-0.2, 0.2),
    "shear_slope": (-0.2, 0.2),
    "turn_rad": (-0.04, 0.04),
    "lean_rad": (-0.04, 0.04),
    "shift_mm": (-2.0, 2.0),
}


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


def _planes(state: _State, front: Touching, mirrors: Mapping[str, SeenIn], names: list[str]) -> list[Touching]:
    return [front, *(state.poses[name].of(mirrors[name]).reflect(mirrors[name].touching) for name in names)]


def _stations(body: Body, planes: Touching, *, from_tip: bool) -> tuple[Array, Array, Array]:
    """Where along the body each plane touches it: u (n,), and the planes' normals and points in the finger's frame."""
    normal = body.to_frame(planes.normal, place=False)
    point = body.to_frame(planes.point, place=True)
    if from_tip:
        u = body.tip_mm - body.length_mm * np.linspace(0.0, 1.0, STATIONS) ** 2
        sections = body.sections(u)
        reach = sections.support(normal[:, :1], normal[:, 2:])[0] + normal[:, 1:2] * u  # (n, STATIONS)
        return np.asarray(u[np.argmax(reach, axis=1)]), normal, point
    direction = body.to_frame(planes.direction, place=False)
    within = np.maximum(direction[:, 0] ** 2 + direction[:, 2] ** 2, 1e-6)
    u = point[:, 1] + 0.0
    for _ in range(3):
        t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
        far = ((t - point[:, 0]) * direction[:, 0] + (z - point[:, 2]) * direction[:, 2]) / within
        u = point[:, 1] + far * direction[:, 1]
    return u, normal, point


def _one(state: _State, planes: Touching, *, from_tip: bool) -> tuple[Array, Array, Array, Array, Array]:
    body = state.body
    u, normal, point = _stations(body, planes, from_tip=from_tip)
    support, by_a, by_b = body.sections(u).support(normal[:, 0], normal[:, 2])
    offset = (normal * point).sum(axis=1)
    residual = support + normal[:, 1] * u - offset
    if from_tip:  # what touches at the end of the model is not of the part that is modelled
        residual = np.where(u <= body.tip_mm - 0.98 * body.length_mm, 10.0, residual)
    return residual, u, normal, by_a, by_b


def _residual(state: _State, front: Touching, mirrors: Mapping[str, SeenIn], names: list[str]) -> Array:
    tips = [False, *(mirrors[name].from_tip for name in names)]
    parts = _planes(state, front, mirrors, names)
    return np.concatenate([_one(state, part, from_tip=tip)[0] for part, tip in zip(parts, tips, strict=True)])


def _change(  # noqa: PLR0917
    state: _State,
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
        return (_residual(moved, front, mirrors, names) - residual) / size
    change = np.zeros_like(residual)
    start = len(front.offset_mm)
    for other in names:
        stop = start + len(mirrors[other].touching.offset_mm)
        if other == mirror:  # a mirror's pose changes what is seen in it alone
            planes = moved.poses[mirror].of(mirrors[mirror]).reflect(mirrors[mirror].touching)
            change[start:stop] = (_one(moved, planes, from_tip=False)[0] - residual[start:stop]) / size
        start = stop
    return change


def _linearised(state: _State, front: Touching, mirrors: Mapping[str, SeenIn], names: list[str]) -> tuple[Array, Array]:
    """Residuals (n,), and their derivatives by the splines' coefficients (n, 4 K)."""
    body = state.body
    count = body.coefficients.shape[1]
    tips = [False, *(mirrors[name].from_tip for name in names)]
    residuals, rows = [], []
    for part, tip in zip(_planes(state, front, mirrors, names), tips, strict=True):
        residual, u, normal, by_a, by_b = _one(state, part, from_tip=tip)
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


def _weights(residual: Array, ends: Array, sigma: float, *, sure: bool) -> Array:
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
    return np.asarray(np.clip(1.0 - (residual / limit) ** 2, 0.0, None) ** 2)


def _add_priors(  # noqa: PLR0917
    normal: Array,
    right: Array,
    state: _State,
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
            spread = settings.offset_mm if kind == "shift_mm" else np.deg2rad(settings.angle_deg)
            away = -getattr(pose, kind)
            told = mirrors[mirror].turn_sd_rad
            if kind == "turn_rad" and told is not None:
                away, spread = away + mirrors[mirror].turn_rad, told
        else:
            away, spread = expected[kind]
        normal[4 * count + k, 4 * count + k] += 1.0 / spread**2
        right[4 * count + k] += away / spread**2


def _add_slopes(  # noqa: PLR0917
    normal: Array,
    right: Array,
    state: _State,
    names: list[tuple[str, float]],
    slopes: Slopes,
    settings: MirrorShapeSettings,
    count: int,
) -> None:
    """The skin's slopes across the finger, as far as squareness and shear answer to them."""
    chosen = [k for k, (name, _) in enumerate(names) if name in ("squareness", "shear", "shear_slope")]
    if not chosen:
        return
    from splitknit.shape.dense import slopes_across  # noqa: PLC0415 - it needs bodies, too

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
    weight = _tukey(residual[good], 4.0 * settings.slope_error) / settings.slope_error**2
    weight *= INDEPENDENT_SLOPES / max(int(good.sum()), 1)
    part = jacobian[good]
    where = 4 * count + np.asarray(chosen)
    normal[np.ix_(where, where)] += part.T @ (weight[:, None] * part)
    right[where] -= part.T @ (weight * residual[good])
