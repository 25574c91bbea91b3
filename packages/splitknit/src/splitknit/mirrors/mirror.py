"""From views to a shape: outlines, a first guess, the fit, and heights on the pixels of the front
view."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import brentq

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.areas import mirror_outline
from splitknit.imaging.geometry import nearest_known
from splitknit.imaging.view import pixels_of, view_of
from splitknit.mirrors.body import Body, SeenHeights, Slopes
from splitknit.mirrors.fit import (
    DISAGREEING_MM,
    FIT_ROUNDS,
    Estimate,
    Fit,
    ViewOutline,
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
from splitknit.mirrors.reflection import Plane, Pose, Touching, reflect_points
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.views import Views
from splitknit.model import Array, BoolArray, Camera, FloatArray, Mirror, Rig

# A first guess: how far mirrors are turned, by the tips of two views, and a plain body.


_MAX_TURN_RAD = 0.12
"""Mirrors are not turned by more. Range: 0.06 to 0.24 (validation/parameters)."""


def turn_of_tips(
    views: Views, name: str, camera: Camera, plane: Plane, axis: Array
) -> float | None:
    """Turn of mirror `name`, nominally in `plane`, about the camera's axis, by the tips of two
    views; None if beyond reason. The line that joins a point with its mirror image touches both
    outlines at the tip (a frontier point).
    """
    across = np.array([axis[1], -axis[0]])
    front, side = (
        rows_of(mask, camera, views.binning, across, trust_ends=True).places("left")[0]
        for mask in (views.front, views.mirrors[name])
    )

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
    front: OutlineRows, lateral: Mapping[str, OutlineRows], rays: Touching, squareness: float
) -> Body:
    """Ellipses from the front view's rows, and heights from the `rays` that touch the finger in the
    first mirror's view."""
    known = np.isfinite(front.width_mm)
    seen_mm = max(
        rows.tip_mm - float(rows.along_mm[np.isfinite(rows.width_mm)][0])
        for rows in lateral.values()
    )
    length = min(front.tip_mm - float(front.along_mm[known][0]), seen_mm) + 0.3
    origin = float(np.mean(0.5 * (front.left_mm + front.right_mm)[known])) * front.across
    coefficients = np.zeros((4, 11 + 3))  # spans of the splines along the finger
    body = Body(origin, front.axis, front.tip_mm, length, coefficients, squareness)
    point = body.to_frame(rays.point, place=True)
    direction = body.to_frame(rays.direction, place=False)
    # where the rays cross the plane through the finger's axis
    heights = point[:, 2] - point[:, 0] / direction[:, 0] * direction[:, 2]
    low, high = (float(v) for v in np.quantile(heights, (0.15, 0.85)))
    coefficients[1] = 0.5 * (low + high)
    coefficients[2] = 0.5 * float(np.nanquantile(front.width_mm, 0.8))
    coefficients[3] = 0.5 * (high - low)
    return replace(body, coefficients=coefficients)


# The thesis's method: lateral and frontal masks aligned row by row, one ellipse a row; mirrors at
# exactly 45 deg.


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
        """As :meth:`Body.heights`; beside the ellipses the nearest z is continued."""
        x, y = np.broadcast_arrays(*view_of(camera, rows, columns, binning=binning).on_plane())
        p = self.axis[0] * x + self.axis[1] * y
        q = self.axis[1] * x - self.axis[0] * y
        back = self.tip_mm - p

        def at(values: Array) -> Array:
            return np.asarray(np.interp(back, self.from_tip_mm, values))

        place = (q - at(self.middle_mm)) / np.maximum(at(self.half_width_mm), 1e-9)
        z = at(self.centre_mm) + at(self.half_height_mm) * np.sqrt(
            np.clip(1.0 - place**2, 0.0, None)
        )
        inside = (
            (np.abs(place) <= 1) & (back >= self.from_tip_mm[0]) & (back <= self.from_tip_mm[-1])
        )
        return x, y, nearest_known(z.astype(np.float32), inside), inside, inside


def _ellipses(front: OutlineRows, lateral: OutlineRows, tip_is_outward: float) -> _Ellipses:
    """Align the views as the thesis does, and pair their rows.

    Medial lines are turned to one direction, tips put into one row, and each row's half-widths
    become half axes of an ellipse; a plane mirror keeps lengths. `front`, `lateral`: outlines
    across their medial lines; `tip_is_outward`: +1 where the pad is on the right of the lateral
    view's axis, -1 on its left. Source: the thesis, section 3.3.2.3, steps 2 to 7.
    """
    front_back, middle, _, half_width = _rows_from_tip(front)
    back, lateral_middle, line, half_height = _rows_from_tip(lateral)
    common = (front_back <= back[-1]) & (front_back >= back[0])
    require(
        common.any(),
        "the views of the finger have no row in common: it does not lie along the mirror.",
    )
    rows = front_back[common]
    return _Ellipses(
        axis=front.axis,
        from_tip_mm=rows,
        tip_mm=front.tip_mm,
        middle_mm=middle[common],
        half_width_mm=half_width[common],
        half_height_mm=np.interp(rows, back, half_height),
        centre_mm=tip_is_outward * np.interp(rows, back, lateral_middle - line),
    )


def _rows_from_tip(rows: OutlineRows) -> tuple[Array, Array, Array, Array]:
    """Of whole rows, from the tip on: distance from it, middle, medial line and half width."""
    known = np.isfinite(rows.width_mm)
    require(int(known.sum()) >= 8, "a view of the finger is too small to show how it lies.")
    slope, offset = medial_line(rows)
    back = rows.tip_mm - rows.along_mm
    middle = 0.5 * (rows.left_mm + rows.right_mm)
    line = slope * rows.along_mm + offset
    half = 0.5 * rows.width_mm
    return back[known][::-1], middle[known][::-1], line[known][::-1], half[known][::-1]


_CUT = (
    "cut off at the mirror's edge or the picture's: lay the finger in the middle, so that the"
    " mirror shows all of its pad."
)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorShape:
    """A finger's shape from its outlines."""

    camera: Camera
    model: Body | _Ellipses
    facts: Mapping[str, Any]  # mirrors' poses, misfits, the sections' form
    rows: Mapping[str, OutlineRows] = field(default_factory=dict)  # of ``front`` and every mirror
    fit: Fit | None = None
    outlines: Mapping[str, ViewOutline] = field(default_factory=dict)  # that were fitted

    def plane(self, mirror: Mirror) -> Plane:
        """Plane of a mirror, as fitted."""
        nominal = Plane(mirror.point_mm, mirror.normal)
        pose = None if self.fit is None else self.fit.poses.get(mirror.name)
        return nominal if pose is None else nominal.posed(*pose)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A note on each view that does not agree with the others."""
        return tuple(
            Finding(
                "mirror-outline",
                f"the {name} view's outline agrees with the others to {rms:.2f} mm only (usual: "
                "0.02 to 0.07), so that the shape may be off by some tenths of a millimetre: check "
                "its outline in the report, and the light of the mirrors.",
            )
            for name, rms in (self.fit.rms_mm.items() if self.fit is not None else ())
            if rms > DISAGREEING_MM
        )

    def points(
        self, rows: slice, columns: slice, binning: int = 1
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y, z (h, w), mm, of the surface that a window's pixels see, in blocks of `binning`;
        NaN beside it."""
        x, y, z, inside, _ = self.model.heights(self.camera, rows, columns, binning)
        return x, y, np.where(inside, z, np.nan)

    def continued(self, rows: slice, columns: slice) -> tuple[FloatArray, BoolArray]:
        """z (h, w) of a window's pixels, finite: beside the finger its outline's z goes on; and
        which are known."""
        _, _, z, _, known = self.model.heights(self.camera, rows, columns)
        return z, known

    def drawn(self) -> dict[str, Array]:
        """Outline (n, 2) of the fitted body in each view, columns and rows of the camera's
        image."""
        lines = {}
        for name, outline in self.outlines.items():
            assert self.fit is not None
            points = touched(self.fit.body, self.fit.planes(name, outline))
            if outline.plane is not None:
                points = reflect_points(points, outline.plane.posed(*self.fit.poses[name]))
            lines[name] = pixels_of(self.camera, points)
        return lines


_MIN_POINTS = 20  # a view with fewer points of its outline is not used


def mirror_shape(
    views: Views,
    rig: Rig,
    settings: MirrorShapeSettings | None = None,
    *,
    tip_direction_deg: float = 0.0,
    slopes_on: Callable[[MirrorShape], Slopes | None] | None = None,
    cut_too: bool = False,
) -> MirrorShape:
    """Estimate the finger's shape.

    Raises BadInput if the views do not fit one finger. Source: the thesis, section 3.3.2.3. Cipolla
    and Giblin 2000, Visual Motion of Curves and Surfaces (frontier points).

    views : masks of the front view and of the mirrors' views, see
        :func:`splitknit.mirrors.views.views_in`
    rig : its camera, and its mirrors' nominal planes; a mirror beyond the tip gives light only
    tip_direction_deg : direction of the fingertip, within 75 deg: 0 = row 0, counter-clockwise
    slopes_on : measures slopes of the skin in the front view, given a first shape, optional: they
        determine the sections' form and roll
    cut_too : use the visible part of views that the border of the picture or of their mirror cuts;
        else they are left out
    """
    settings = settings or MirrorShapeSettings()
    camera = rig.camera
    turn = np.deg2rad(tip_direction_deg)
    hint = np.array([-np.sin(turn), np.cos(turn)])
    axis, front = finger_axis(views.front, camera, views.binning, hint)
    known = {
        mirror.name: mirror
        for mirror in sorted(rig.mirrors, key=lambda mirror: mirror.name)
        if mirror.name in views.mirrors
        and abs(float(mirror.normal[:2] @ axis)) <= np.sqrt(0.5) * np.hypot(*mirror.normal[:2])
    }
    mirrors = list(known.values())
    require(mirrors, "no mirror beside the finger shows it; the shape needs one at least.")
    if settings.method == "thesis":
        return _by_thesis(views, camera, mirrors[0], axis, front)

    rows, outlines, cut = _mirror_outlines(views, camera, mirrors, axis, cut_too=cut_too)
    lateral = {
        name: rows[name]
        for name in sorted(outlines, key=lambda name: (name in cut, name))  # whole views first
        if int(np.isfinite(rows[name].width_mm).sum()) >= _MIN_POINTS
    }
    require(
        lateral,
        f"the view in the {' and the '.join(known)} mirror is {_CUT}",
    )
    first = next(iter(lateral))
    poses = {name: Pose(outline.turn_rad) for name, outline in outlines.items()}
    nominal = Plane(known[first].point_mm, known[first].normal)
    rays = nominal.posed(*poses[first]).reflect(outlines[first].touching)
    start = Estimate(first_body(front, lateral, rays, settings.squareness), poses)
    whole_front = front.beyond(start.body.tip_mm - start.body.length_mm)
    outlines = {"front": ViewOutline(touching_planes(whole_front, camera)), **outlines}
    rounds = 20 if cut and cut_too else FIT_ROUNDS  # the first guess is further off
    fit = fit_views(start, outlines, rounds=rounds)
    refuse_misfit(fit)
    if slopes_on is not None:
        slopes = slopes_on(MirrorShape(camera, fit.body, {}, {"front": front}, fit))
        if slopes is not None:
            fit = fit_views(start, outlines, slopes, rounds)
            refuse_misfit(fit)
    useless = [name for name in rows if name not in poses]
    facts = {**facts_of(fit), "views_cut_off": cut, "views_useless": useless}
    return MirrorShape(camera, fit.body, facts, {"front": front, **rows}, fit, outlines)


def _by_thesis(
    views: Views, camera: Camera, mirror: Mirror, axis: Array, front: OutlineRows
) -> MirrorShape:
    """The thesis's method on one lateral view."""
    name = mirror.name
    _, lateral = finger_axis(views.mirrors[name], camera, views.binning, axis)
    side = pad_side(mirror, lateral)
    require(not is_cut(lateral, side), f"the view in the {name} mirror is {_CUT}")
    model = _ellipses(front, lateral, 1.0 if side == "right" else -1.0)
    facts = {"method": "thesis", "mirrors": [name]}
    return MirrorShape(camera, model, facts, {"front": front, name: lateral})


def _mirror_outlines(
    views: Views, camera: Camera, mirrors: Sequence[Mirror], axis: Array, *, cut_too: bool
) -> tuple[dict[str, OutlineRows], dict[str, ViewOutline], list[str]]:
    """Rows of the mirrors' views; of those that determine anything, the planes that touch the
    finger; and the names of the views that are cut off."""
    all_rows = {}
    outlines = {}
    cut = []
    for mirror in mirrors:
        name = mirror.name
        plane = Plane(mirror.point_mm, mirror.normal)
        rows = rows_of(views.mirrors[name], camera, views.binning, plane.image_axis(axis))
        side = pad_side(mirror, rows)
        if is_cut(rows, side):
            visible = _visible_part(rows, side, mirror, camera) if cut_too else rows
            if visible is not None:
                cut.append(name)
                rows = visible
            if not cut_too:
                continue
        all_rows[name] = rows
        touching = touching_planes(rows, camera)
        if len(touching.point) < _MIN_POINTS:
            continue
        turn = turn_of_tips(views, name, camera, plane, axis)
        require(
            turn is not None or name in cut,
            f"the views do not fit one finger: the fingertip in the {name} mirror is not beside the"
            " one in front; check that the rig file's mirrors are those in the picture and that"
            " one finger alone is in view.",
        )
        # the same where the view is cut
        turn_sd = float(np.deg2rad(0.6 if name in cut else 0.2))  # deg
        outlines[name] = (
            ViewOutline(touching, plane)
            if turn is None
            else ViewOutline(touching, plane, turn, turn_sd)
        )
    return all_rows, outlines, cut


def _visible_part(
    rows: OutlineRows, side: str, mirror: Mirror, camera: Camera
) -> OutlineRows | None:
    """Outline of a view that a mirror's edge or the picture's border cuts, without the cut; None if
    the pad's outline is straight for another reason.
    """
    edge = rows.edge(side)
    # largest missing fraction of the pad's outline; the rest may be the mirror's edge
    if float(np.isfinite(edge[rows.lower_part()]).mean()) < 1.0 - 0.4:
        return rows
    places = rows.places(side)[0]
    pixels = pixels_of(camera, places).astype(np.float32)
    border = mirror_outline(mirror, camera).astype(np.float32)
    away = [
        cv2.pointPolygonTest(border, (float(x), float(y)), True)
        for x, y in pixels[:: max(1, len(pixels) // 20)]
    ]
    # a straight outline this near to the mirror's nominal edge is that edge
    if float(np.median(np.abs(away))) > 3.0 * camera.px_per_mm:
        return None
    return replace(rows, **{f"{side}_mm": np.full_like(edge, np.nan)})
