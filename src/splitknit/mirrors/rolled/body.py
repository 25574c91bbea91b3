"""The smooth finger between its mirrors, and where these lie: outlines of all views, of those too that the border of
the picture or of their mirror cuts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.areas import mirror_outline
from splitknit.imaging.view import pixels_of
from splitknit.mirrors.body import Body, Slopes
from splitknit.mirrors.fit import Estimate, MirrorOutline, Outlines, Pose, fit_body, refuse_misfit
from splitknit.mirrors.mirror import TIPS_APART, TURN_DEG, MirrorShape, first_body, turn_of_tips
from splitknit.mirrors.outline import OutlineRows, front_axis, is_cut, pad_side, rows_of, touching_planes
from splitknit.mirrors.planes import MirrorPlane
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.views import Views
from splitknit.model import BoolArray, Camera, Mirror, Rig

Array = NDArray[np.float64]

FEW = 20
"""A view with fewer points of its outline left is not used."""
MAX_MISSING = 0.4
"""Of the pad's outline; what is left of it then is not the mirror's edge."""
NEAR_EDGE_MM = 3.0
"""A straight outline this near to where the mirror should end is the mirror's edge."""
CUT_ROUNDS = 20
"""Corrections of the fit where views are cut."""
CUT_TURN_DEG = 0.6
"""Standard deviation of a mirror's turn as the tips show it where the view is cut."""


@dataclass(frozen=True, slots=True, eq=False)
class _BodyBetweenMirrors:
    """What the outlines determine."""

    body: Body
    planes: Mapping[str, MirrorPlane]
    """Of the mirrors whose views are used."""
    cut: tuple[str, ...]
    """Of them, those whose view is cut."""
    useless: tuple[str, ...]
    """Mirrors whose view is cut so much that it determines nothing."""


def body_between_mirrors(
    views: Views,
    rig: Rig,
    tip_direction_deg: float = 0.0,
    settings: MirrorShapeSettings | None = None,
    slopes_on: Callable[[MirrorShape], Slopes | None] | None = None,
) -> _BodyBetweenMirrors:
    """Fit a body and the mirrors' poses to all outlines, and to the slopes of the skin in front. `slopes_on` measures
    these, given a first shape: they show how the finger is rolled. Raises BadInput if no mirror shows enough, or the
    views do not fit one finger.
    """
    chosen = settings or MirrorShapeSettings()
    camera, built = rig.camera, {mirror.name: mirror for mirror in rig.mirrors}
    axis, front = front_axis(views.front, camera, views.binning, tip_direction_deg)
    mirrors: dict[str, MirrorOutline] = {}
    rows: dict[str, OutlineRows] = {}
    poses: dict[str, Pose] = {}
    cut, useless = [], []
    for name in sorted(views.mirrors):
        mirror, mask = built[name], views.mirrors[name]
        plane = MirrorPlane.nominal(mirror)
        outline = rows_of(mask, camera, views.binning, plane.image_axis(axis))
        side = pad_side(mirror, outline)
        if is_cut(outline, side):
            left = _still_shown(outline, side, mirror, camera)
            if left is not None:
                cut.append(name)
                outline = left
        parts = touching_planes(outline, camera)
        if len(parts.offset_mm) < FEW:
            useless.append(name)
            continue
        tips = turn_of_tips(views, name, camera, plane, axis)
        if tips is None and name not in cut:
            raise BadInput(TIPS_APART.format(name))
        poses[name] = Pose(turn_rad=0.0 if tips is None else tips)
        spread = None if tips is None else float(np.deg2rad(TURN_DEG if name not in cut else CUT_TURN_DEG))
        mirrors[name] = MirrorOutline(parts, plane, mirror.point_mm, turn_rad=poses[name].turn_rad, turn_sd_rad=spread)
        if int(np.isfinite(outline.width_mm).sum()) >= FEW:
            rows[name] = outline
    require(
        bool(rows),
        "only the front view of the finger can be used: the mirrors cut its sides off; lay it in their middle.",
    )
    whole_first = sorted(rows, key=lambda name: (name in cut, name))
    body = first_body(front, {name: rows[name] for name in whole_first}, mirrors, poses, chosen)
    outlines = Outlines(touching_planes(front.beyond(body.tip_mm - body.length_mm), camera), mirrors)
    if cut:  # the first guess is further off
        chosen = replace(chosen, rounds=max(chosen.rounds, CUT_ROUNDS))
    start = Estimate(body, poses)
    fit = fit_body(start, outlines, chosen)
    if slopes_on is not None and chosen.slopes:
        slopes = slopes_on(MirrorShape(camera, fit.body, {}, {"front": (front,)}, fit))
        if slopes is not None:
            fit = fit_body(start, outlines, chosen, slopes)
    refuse_misfit(fit, mirrors)
    found = {name: fit.poses[name].of(mirror) for name, mirror in mirrors.items()}
    return _BodyBetweenMirrors(fit.body, found, tuple(name for name in cut if name in mirrors), tuple(useless))


def _still_shown(rows: OutlineRows, side: str, mirror: Mirror, camera: Camera) -> OutlineRows | None:
    """What a cut view's outline still determines; None if it is straight, but not by its mirror's edge, which takes the
    place of the pad's outline. The picture's border leaves a part of it.
    """
    edge = rows.left_mm if side == "left" else rows.right_mm
    known = np.flatnonzero(np.isfinite(rows.left_mm) | np.isfinite(rows.right_mm))
    low, high = (int(known[0] + fraction * (known[-1] - known[0])) for fraction in (0.1, 0.6))
    if float(np.isfinite(edge[low:high]).mean()) < 1.0 - MAX_MISSING:
        return rows
    places = rows.places(side)[0]
    at = pixels_of(camera, np.column_stack([places, np.zeros(len(places))])).astype(np.float32)
    border = mirror_outline(mirror, camera).astype(np.float32)
    away = [cv2.pointPolygonTest(border, (float(x), float(y)), True) for x, y in at[:: max(1, len(at) // 20)]]
    if float(np.median(np.abs(away))) > NEAR_EDGE_MM * camera.px_per_mm:
        return None
    nothing = np.full_like(edge, np.nan)
    return replace(rows, left_mm=nothing) if side == "left" else replace(rows, right_mm=nothing)


def outside(body: Body, points_mm: Array) -> BoolArray:
    """Whether points (..., 3) of the rig's frame lie outside a body; beyond its base its last section goes on."""
    t, u, z = body.to_frame(points_mm.reshape(-1, 3), place=True).T
    sections = body.sections(u)
    rise = z - sections.z
    across = (t - sections.t - sections.shear * rise) / np.maximum(sections.a, 1e-6)
    squared = np.minimum(across * across, 1.0)
    most = np.sqrt(1.0 - squared) * (1.0 + sections.squareness * squared)
    out = (np.abs(rise) > sections.b * most) | (np.abs(across) >= 1.0) | (u > body.tip_mm)
    return np.asarray(out.reshape(points_mm.shape[:-1]))
