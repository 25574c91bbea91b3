"""From views to a shape: outlines, a first guess, the fit, and heights on the pixels of the front
view."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import brentq

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.areas import mirror_outline
from splitknit.imaging.view import pixels_of
from splitknit.mirrors.body import Body, Slopes
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
    pad_side,
    rows_of,
    touching_planes,
)
from splitknit.mirrors.reflection import Plane, Pose, Touching, reflect_points
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


SQUARENESS = 0.16
"""Prior mean of the pad's flatness (kappa), which the fit refines; 0 is an ellipse."""


def first_body(front: OutlineRows, lateral: Mapping[str, OutlineRows], rays: Touching) -> Body:
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
    body = Body(origin, front.axis, front.tip_mm, length, coefficients, SQUARENESS)
    point = body.to_frame(rays.point, place=True)
    direction = body.to_frame(rays.direction, place=False)
    # where the rays cross the plane through the finger's axis
    heights = point[:, 2] - point[:, 0] / direction[:, 0] * direction[:, 2]
    low, high = (float(v) for v in np.quantile(heights, (0.15, 0.85)))
    coefficients[1] = 0.5 * (low + high)
    coefficients[2] = 0.5 * float(np.nanquantile(front.width_mm, 0.8))
    coefficients[3] = 0.5 * (high - low)
    return replace(body, coefficients=coefficients)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorShape:
    """A finger's shape from its outlines."""

    camera: Camera
    fit: Fit
    facts: Mapping[str, Any]  # mirrors' poses, misfits, the sections' form
    rows: Mapping[str, OutlineRows]  # of ``front`` and every mirror
    outlines: Mapping[str, ViewOutline]  # that were fitted

    def plane(self, mirror: Mirror) -> Plane:
        """Plane of a mirror, as fitted."""
        nominal = Plane(mirror.point_mm, mirror.normal)
        pose = self.fit.poses.get(mirror.name)
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
            for name, rms in self.fit.rms_mm.items()
            if rms > DISAGREEING_MM
        )

    def points(
        self, rows: slice, columns: slice, binning: int = 1
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y, z (h, w), mm, of the surface that a window's pixels see, in blocks of `binning`;
        NaN beside it."""
        x, y, z, inside, _ = self.fit.body.heights(self.camera, rows, columns, binning)
        return x, y, np.where(inside, z, np.nan)

    def continued(self, rows: slice, columns: slice) -> tuple[FloatArray, BoolArray]:
        """z (h, w) of a window's pixels, finite: beside the finger its outline's z goes on; and
        which are known."""
        _, _, z, _, known = self.fit.body.heights(self.camera, rows, columns)
        return z, known

    def drawn(self) -> dict[str, Array]:
        """Outline (n, 2) of the fitted body in each view, columns and rows of the camera's
        image."""
        lines = {}
        for name, outline in self.outlines.items():
            points = touched(self.fit.body, self.fit.planes(name, outline))
            if outline.plane is not None:
                points = reflect_points(points, outline.plane.posed(*self.fit.poses[name]))
            lines[name] = pixels_of(self.camera, points)
        return lines


_MIN_POINTS = 20  # a view with fewer points of its outline is not used


def mirror_shape(
    views: Views,
    rig: Rig,
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
    rows, outlines, cut = _mirror_outlines(views, camera, mirrors, axis, cut_too=cut_too)
    lateral = {
        name: rows[name]
        for name in sorted(outlines, key=lambda name: (name in cut, name))  # whole views first
        if int(np.isfinite(rows[name].width_mm).sum()) >= _MIN_POINTS
    }
    require(
        lateral,
        f"the view in the {' and the '.join(known)} mirror is cut off at the mirror's edge or the"
        " picture's: lay the finger in the middle, so that the mirror shows all of its pad.",
    )
    first = next(iter(lateral))
    poses = {name: Pose(outline.turn_rad) for name, outline in outlines.items()}
    nominal = Plane(known[first].point_mm, known[first].normal)
    rays = nominal.posed(*poses[first]).reflect(outlines[first].touching)
    start = Estimate(first_body(front, lateral, rays), poses)
    whole_front = front.beyond(start.body.tip_mm - start.body.length_mm)
    outlines = {"front": ViewOutline(touching_planes(whole_front, camera)), **outlines}
    rounds = 20 if cut and cut_too else FIT_ROUNDS  # the first guess is further off
    fit = fit_views(start, outlines, rounds=rounds)
    refuse_misfit(fit)
    if slopes_on is not None:
        slopes = slopes_on(MirrorShape(camera, fit, {}, {}, {}))
        if slopes is not None:
            fit = fit_views(start, outlines, slopes, rounds)
            refuse_misfit(fit)
    useless = [name for name in rows if name not in poses]
    facts = {**facts_of(fit), "views_cut_off": cut, "views_useless": useless}
    return MirrorShape(camera, fit, facts, {"front": front, **rows}, outlines)


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
