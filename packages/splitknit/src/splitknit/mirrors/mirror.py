"""From views to a shape: outlines, a first guess, the fit, and heights on the pixels of the front view."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import brentq

from splitknit.errors import BadInput, require
from splitknit.findings import Finding
from splitknit.imaging.areas import mirror_outline
from splitknit.imaging.geometry import nearest_known
from splitknit.imaging.view import pixels_of, view_of
from splitknit.mirrors.body import Body, SeenHeights, Slopes
from splitknit.mirrors.fit import (
    APART_MM,
    ROUNDS,
    Estimate,
    Fit,
    MirrorOutline,
    Outlines,
    Pose,
    facts_of,
    fit_views,
    refuse_misfit,
    touched,
)
from splitknit.mirrors.outline import (
    OutlineRows,
    finger_axis,
    is_cut,
    medial_line,
    pad_side,
    rows_of,
    touching_planes,
)
from splitknit.mirrors.reflection import Plane, Touching, reflect_points
from splitknit.mirrors.settings import SQUARENESS_SD, MirrorShapeSettings
from splitknit.mirrors.views import Views
from splitknit.model import Array, BoolArray, Camera, FloatArray, Mirror, Rig

# A first guess: how far mirrors are turned, by the tips of two views, and a plain body.

_KNOTS = 11  # spans of the splines along the finger
_MAX_TURN_RAD = 0.12  # mirrors are not turned by more
_TIPS_APART = (
    "the views do not fit one finger: the fingertip in the {} mirror is not beside the one in front; check that the "
    "rig file's mirrors are those in the picture and that one finger alone is in view."
)


def turn_of_tips(views: Views, name: str, camera: Camera, plane: Plane, axis: Array) -> float | None:
    """Turn of mirror `name`, nominally in `plane`, about the camera's axis, by the tips of two views; None if beyond
    reason. The line that joins a point with its mirror image touches both outlines at the tip (a frontier point).
    """
    across = np.array([axis[1], -axis[0]])
    both = (rows_of(one, camera, views.binning, across, trust_ends=True) for one in (views.front, views.mirrors[name]))
    front, side = (rows.places("left")[0] for rows in both)

    def apart(turn: float) -> float:
        moved = plane.posed(turn, 0.0, 0.0)
        joint = moved.normal[:2] / np.hypot(*moved.normal[:2])
        upward = np.array([-joint[1], joint[0]])
        upward = upward if float(upward @ axis) > 0 else -upward
        epipole = moved.epipole(camera)
        if epipole is None:
            return float(np.max(side @ upward) - np.max(front @ upward))
        rays = (points - epipole for points in (side, front))
        far = [float(np.max((ray @ upward) / np.abs(ray @ joint))) for ray in rays]
        return (far[0] - far[1]) * float(np.hypot(*epipole))

    if apart(-_MAX_TURN_RAD) * apart(_MAX_TURN_RAD) > 0:
        return None
    return float(brentq(apart, -_MAX_TURN_RAD, _MAX_TURN_RAD, xtol=1e-11))


def first_body(
    front: OutlineRows,
    lateral: Mapping[str, OutlineRows],
    outlines: Mapping[str, MirrorOutline],
    poses: Mapping[str, Pose],
    settings: MirrorShapeSettings,
) -> Body:
    """Ellipses from the front view's rows, and heights from the first mirror's."""
    known = np.isfinite(front.width_mm)
    along = front.along_mm[known]
    seen_mm = max(rows.tip_mm - float(rows.along_mm[np.isfinite(rows.width_mm)][0]) for rows in lateral.values())
    length = min(front.tip_mm - float(along[0]), seen_mm) + 0.3
    origin = float(np.mean(0.5 * (front.left_mm + front.right_mm)[known]))
    body = Body(origin * front.across, front.axis, front.tip_mm, length, np.zeros((4, _KNOTS + 3)))
    name = next(iter(lateral))
    rays = poses[name].of(outlines[name].plane).reflect(outlines[name].touching)
    point, direction = body.to_frame(rays.point, place=True), body.to_frame(rays.direction, place=False)
    far = -point[:, 0] / direction[:, 0]
    heights = point[:, 2] + far * direction[:, 2]  # where the rays cross the plane through the finger's axis
    low, high = (float(v) for v in np.quantile(heights, (0.15, 0.85)))
    z, rise = 0.5 * (low + high), 0.5 * (high - low)
    width = 0.5 * float(np.nanquantile(front.width_mm, 0.8))
    coefficients = np.zeros((4, _KNOTS + 3))
    coefficients[1], coefficients[2], coefficients[3] = z, width, rise
    return replace(body, coefficients=coefficients, squareness=settings.squareness)


# The thesis's method: lateral and frontal masks aligned row by row, one ellipse a row; mirrors at exactly 45 deg.


@dataclass(frozen=True, slots=True, eq=False)
class _Ellipses:
    """One ellipse for each row that both views have."""

    axis: Array  # (2,) of the front view's medial line, towards the tip
    from_tip_mm: Array  # (n,) distance of the rows from the tip, growing
    tip_mm: float  # where the tip lies on the axis
    middle_mm: Array  # (n,) middle of the front view's row, to the right of the axis
    half_width_mm: Array  # (n,) of the front view
    half_height_mm: Array  # (n,) of the lateral view
    centre_mm: Array  # (n,) height of the lateral view's middle, beside its medial line

    def heights(self, camera: Camera, rows: slice, columns: slice, binning: int = 1) -> SeenHeights:
        """As :meth:`Body.heights`; beside the ellipses the nearest z goes on."""
        x, y = np.broadcast_arrays(*view_of(camera, rows, columns, binning=binning).on_plane())
        p = self.axis[0] * x + self.axis[1] * y
        q = self.axis[1] * x - self.axis[0] * y
        back = self.tip_mm - p

        def at(values: Array) -> Array:
            return np.asarray(np.interp(back, self.from_tip_mm, values))

        place = (q - at(self.middle_mm)) / np.maximum(at(self.half_width_mm), 1e-9)
        z = at(self.centre_mm) + at(self.half_height_mm) * np.sqrt(np.clip(1.0 - place**2, 0.0, None))
        inside = (np.abs(place) <= 1) & (back >= self.from_tip_mm[0]) & (back <= self.from_tip_mm[-1])
        return x, y, nearest_known(z.astype(np.float32), inside), inside, inside


def _ellipses(front: OutlineRows, lateral: OutlineRows, tip_is_outward: float) -> _Ellipses:
    """Align the views as the thesis does, and pair their rows.

    Medial lines are turned to one direction, tips put into one row, and each row's half-widths become half axes of an
    ellipse; a plane mirror keeps lengths. `front`, `lateral`: outlines across their medial lines; `tip_is_outward`: +1
    where the pad is on the right of the lateral view's axis, -1 on its left. Source: the thesis, section 3.3.2.3, steps
    2 to 7.
    """
    parts = []
    for rows in (front, lateral):
        known = np.isfinite(rows.width_mm)
        require(int(known.sum()) >= 8, "a view of the finger is too small to show how it lies.")
        back = (rows.tip_mm - rows.along_mm[known])[::-1]
        slope, offset = medial_line(rows)
        line = (slope * rows.along_mm + offset)[known][::-1]
        middle = 0.5 * (rows.left_mm + rows.right_mm)[known][::-1]
        parts.append((back, middle, line, 0.5 * rows.width_mm[known][::-1]))
    (back, middle, _, half), (back_side, middle_side, line_side, half_side) = parts
    common = (back <= back_side[-1]) & (back >= back_side[0])
    require(common.any(), "the views of the finger have no row in common: it does not lie along the mirror.")
    back, middle, half = back[common], middle[common], half[common]
    rise = np.interp(back, back_side, half_side)
    centre = tip_is_outward * np.interp(back, back_side, middle_side - line_side)
    return _Ellipses(front.axis, back, front.tip_mm, middle, half, rise, centre)


_TURN_DEG, _CUT_TURN_DEG = 0.2, 0.6
"""Standard deviation of a mirror's turn as the views' tips show it, and where the view is cut."""
_FEW = 20  # a view with fewer points of its outline is not used
_MAX_MISSING = 0.4  # largest fraction of the pad's outline that may be missing; the rest may be the mirror's edge
_NEAR_EDGE_MM = 3.0  # a straight outline this near to where the mirror should end is the mirror's edge
_CUT_ROUNDS = 20  # corrections of the fit where views are cut


@dataclass(frozen=True, slots=True, eq=False)
class MirrorShape:
    """A finger's shape from its outlines."""

    camera: Camera
    model: Body | _Ellipses
    facts: Mapping[str, Any]  # what was found: mirrors' poses, misfits, the sections' form
    outlines: Mapping[str, OutlineRows] = field(default_factory=dict)  # measured outlines of ``front`` and every mirror
    fit: Fit | None = None
    touching: Mapping[str, Touching] = field(default_factory=dict)
    """As the camera sees them: of ``front`` and every mirror beside the finger."""

    def plane(self, mirror: Mirror) -> Plane:
        """Where a mirror was found."""
        nominal = Plane(mirror.point_mm, mirror.normal)
        pose = None if self.fit is None else self.fit.poses.get(mirror.name)
        return nominal if pose is None else pose.of(nominal)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A note on each view that does not agree with the others."""
        return tuple(
            Finding(
                "mirror-outline",
                f"the {name} view's outline agrees with the others to {rms:.2f} mm only (usual: 0.02 to 0.07), so that "
                "the shape may be off by some tenths of a millimetre: check its outline in the report, and the light "
                "of the mirrors.",
            )
            for name, rms in (self.fit.rms_mm.items() if self.fit is not None else ())
            if rms > APART_MM
        )

    def points(self, rows: slice, columns: slice, binning: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y, z (h, w), mm, of the surface seen by a window's pixels, in blocks of `binning`; NaN beside it."""
        x, y, z, inside, _ = self.model.heights(self.camera, rows, columns, binning)
        return x, y, np.where(inside, z, np.nan)

    def continued(self, rows: slice, columns: slice) -> tuple[FloatArray, BoolArray]:
        """z (h, w) of a window's pixels, finite: beside the finger its outline's z goes on; and which are known."""
        _, _, z, _, known = self.model.heights(self.camera, rows, columns)
        return z, known

    def drawn(self, mirrors: Mapping[str, Mirror]) -> dict[str, Array]:
        """Outline (n, 2), columns and rows of the camera's image, of the fitted body in every view beside it."""
        if self.fit is None or not isinstance(self.model, Body):
            return {}
        found = {}
        for name, planes in self.touching.items():
            if name == "front":
                points = touched(self.model, planes)
            else:
                plane = self.plane(mirrors[name])
                points = reflect_points(touched(self.model, plane.reflect(planes)), plane)
            found[name] = pixels_of(self.camera, points)
        return found


def mirror_shape(
    views: Views,
    rig: Rig,
    settings: MirrorShapeSettings | None = None,
    *,
    tip_direction_deg: float = 0.0,
    slopes_on: Callable[[MirrorShape], Slopes | None] | None = None,
    cut_too: bool = False,
) -> MirrorShape:
    """Find the finger's shape.

    Raises BadInput if the views do not fit one finger. Source: the thesis, section 3.3.2.3. Cipolla and Giblin 2000,
    Visual Motion of Curves and Surfaces (frontier points).

    views : masks of the front view and of the mirrors' views, see :func:`splitknit.mirrors.views.views_in`
    rig : its camera, and where its mirrors nominally are
    tip_direction_deg : where the finger's tip points, within 75 deg: 0 = row 0, counter-clockwise
    slopes_on : measures slopes of the skin in the front view, given a first shape, optional: they determine the
        sections' form and roll
    cut_too : use what views still show that the border of the picture or of their mirror cuts; else they are left out
    """
    settings = settings or MirrorShapeSettings()
    require(views.mirrors, "no mirror shows the finger; the shape needs one beside it at least.")
    turn = np.deg2rad(tip_direction_deg)
    axis, front = finger_axis(views.front, rig.camera, views.binning, np.array([-np.sin(turn), np.cos(turn)]))
    if settings.method == "thesis":
        return _by_thesis(views, rig, axis, front)
    seen = _seen_outlines(views, rig, axis, cut_too=cut_too)
    squareness = settings.squareness, SQUARENESS_SD
    rounds = _CUT_ROUNDS if seen.cut and cut_too else ROUNDS  # where it is cut, the first guess is further off
    whole_first = sorted(seen.lateral, key=lambda name: (name in seen.cut, name))
    body = first_body(front, {name: seen.lateral[name] for name in whole_first}, seen.mirrors, seen.poses, settings)
    outlines = Outlines(touching_planes(front.beyond(body.tip_mm - body.length_mm), rig.camera), seen.mirrors)
    start, slopes = Estimate(body, seen.poses), None
    fit = fit_views(start, outlines, squareness, rounds=rounds)
    refuse_misfit(fit, seen.mirrors)
    if slopes_on is not None:
        slopes = slopes_on(MirrorShape(rig.camera, fit.body, {}, {"front": front}, fit))
    if slopes is not None:
        fit = fit_views(start, outlines, squareness, slopes, rounds)
        refuse_misfit(fit, seen.mirrors)
    beside = {"front": outlines.front, **{name: seen.mirrors[name].touching for name in seen.lateral}}
    facts = {**facts_of(fit), "views_cut_off": seen.cut, "views_useless": seen.useless}
    return MirrorShape(rig.camera, fit.body, facts, {"front": front, **seen.rows}, fit, beside)


def _mirrors_of(views: Views, rig: Rig, axis: Array) -> tuple[dict[str, Mirror], dict[str, Mirror]]:
    """Mirrors that show the finger, by name; and those of them beside it."""
    known = {mirror.name: mirror for mirror in rig.mirrors}
    used = {name: known[name] for name in sorted(views.mirrors)}
    sides = {name: mirror for name, mirror in used.items() if not _from_tip(mirror, axis)}
    require(sides, "only the mirror beyond the tip shows the finger; the shape needs one beside it.")
    return used, sides


def _from_tip(mirror: Mirror, axis: Array) -> bool:
    """Whether a mirror looks along the finger rather than across it."""
    level = mirror.normal[:2] / np.hypot(*mirror.normal[:2])
    return bool(abs(float(level @ axis)) > np.sqrt(0.5))


def _by_thesis(views: Views, rig: Rig, axis: Array, front: OutlineRows) -> MirrorShape:
    """The thesis's method on the first lateral view."""
    camera = rig.camera
    name, mirror = next(iter(_mirrors_of(views, rig, axis)[1].items()))
    _, lateral = finger_axis(views.mirrors[name], camera, views.binning, axis)
    side = pad_side(mirror, lateral)
    fault = f"the view in the {name} mirror is cut off at the mirror's edge: lay the finger in the middle,"
    require(not is_cut(lateral, side), f"{fault} so that the mirror shows all of its pad.")
    outward = 1.0 if side == "right" else -1.0
    model = _ellipses(front, lateral, outward)
    facts = {"method": "thesis", "mirrors": [name]}
    return MirrorShape(camera, model, facts, {"front": front, name: lateral})


@dataclass(frozen=True, slots=True, eq=False)
class _SeenOutlines:
    """The mirrors' outlines, by their names."""

    mirrors: Mapping[str, MirrorOutline]
    poses: Mapping[str, Pose]
    rows: Mapping[str, OutlineRows]
    lateral: Mapping[str, OutlineRows]  # of mirrors beside the finger, with enough of both edges
    cut: list[str]
    useless: list[str]  # cut so much that they determine nothing


def _seen_outlines(views: Views, rig: Rig, axis: Array, *, cut_too: bool) -> _SeenOutlines:
    camera = rig.camera
    mirrors: dict[str, MirrorOutline] = {}
    poses: dict[str, Pose] = {}
    all_rows: dict[str, OutlineRows] = {}
    lateral: dict[str, OutlineRows] = {}
    cut: list[str] = []
    useless: list[str] = []
    for name, mirror in _mirrors_of(views, rig, axis)[0].items():
        plane, tip, mask = Plane(mirror.point_mm, mirror.normal), _from_tip(mirror, axis), views.mirrors[name]
        along = np.array([axis[1], -axis[0]]) if tip else plane.image_axis(axis)
        rows = rows_of(mask, camera, views.binning, along, trust_ends=tip)
        side = pad_side(mirror, rows)
        if is_cut(rows, side, from_tip=tip):
            left = _still_shown(rows, side, mirror, camera) if cut_too else None
            if left is not None or not cut_too:
                cut.append(name)
            if not cut_too:
                continue
            rows = rows if left is None else left
        parts = touching_planes(rows, camera, ("left",) if tip else ("left", "right"))
        if len(parts.offset_mm) < _FEW:
            useless.append(name)
            continue
        turn = None if tip else turn_of_tips(views, name, camera, plane, axis)
        if turn is None and not tip and name not in cut:
            raise BadInput(_TIPS_APART.format(name))
        poses[name], all_rows[name] = Pose(turn_rad=turn or 0.0), rows
        spread = None if turn is None else float(np.deg2rad(_CUT_TURN_DEG if name in cut else _TURN_DEG))
        mirrors[name] = MirrorOutline(parts, plane, tip, turn or 0.0, spread)
        if not tip and int(np.isfinite(rows.width_mm).sum()) >= _FEW:
            lateral[name] = rows
    lay = "lay the finger in the middle, so that the mirror shows all of its pad."
    where = f"the view in the {' and the '.join(cut)} mirror is cut off at the mirror's edge or the picture's"
    nothing = "only the front view of the finger can be used: the mirrors cut its sides off; lay it in their middle."
    require(lateral, nothing if cut_too or not cut else f"{where}: {lay}")
    return _SeenOutlines(mirrors, poses, all_rows, lateral, cut, useless)


def _still_shown(rows: OutlineRows, side: str, mirror: Mirror, camera: Camera) -> OutlineRows | None:
    """What a cut view's outline still determines; None if it is straight, but not by its mirror's edge, which takes the
    place of the pad's outline. The picture's border leaves a part of it.
    """
    edge = rows.left_mm if side == "left" else rows.right_mm
    known = np.flatnonzero(np.isfinite(rows.left_mm) | np.isfinite(rows.right_mm))
    low, high = (int(known[0] + fraction * (known[-1] - known[0])) for fraction in (0.1, 0.6))
    if float(np.isfinite(edge[low:high]).mean()) < 1.0 - _MAX_MISSING:
        return rows
    places = rows.places(side)[0]
    at = pixels_of(camera, np.column_stack([places, np.zeros(len(places))])).astype(np.float32)
    border = mirror_outline(mirror, camera).astype(np.float32)
    away = [cv2.pointPolygonTest(border, (float(x), float(y)), True) for x, y in at[:: max(1, len(at) // 20)]]
    if float(np.median(np.abs(away))) > _NEAR_EDGE_MM * camera.px_per_mm:
        return None
    nothing = np.full_like(edge, np.nan)
    return replace(rows, left_mm=nothing) if side == "left" else replace(rows, right_mm=nothing)
