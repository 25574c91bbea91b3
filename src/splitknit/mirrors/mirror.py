"""From views to a shape: outlines, a first guess, the fit, and heights on the pixels of the front view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.geometry import nearest_known
from splitknit.imaging.view import pixels_of, view_of
from splitknit.mirrors.body import Body, Slopes, heights_on
from splitknit.mirrors.fit import (
    Estimate,
    Fit,
    MirrorOutline,
    Outlines,
    Pose,
    facts_of,
    fit_body,
    refuse_misfit,
    touched,
)
from splitknit.mirrors.outline import (
    OutlineRows,
    finger_axis,
    front_axis,
    is_cut,
    medial_line,
    pad_side,
    rows_of,
    touching_planes,
)
from splitknit.mirrors.planes import MirrorPlane, Touching
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.views import Views
from splitknit.model import BoolArray, Camera, FloatArray, Mirror, Rig

Array = NDArray[np.float64]

# A first guess: how far mirrors are turned, by the tips of two views, and a plain body.

_KNOTS = 11
"""Spans of the splines along the finger."""
MAX_TURN_RAD = 0.12
"""Mirrors are not turned by more."""
TIPS_APART = (
    "the views do not fit one finger: the fingertip in the {} mirror is not beside the one in front; check that the "
    "rig file's mirrors are those in the picture and that one finger alone is in view."
)


def turn_of_tips(views: Views, name: str, camera: Camera, plane: MirrorPlane, axis: Array) -> float | None:
    """Turn of mirror `name`, nominally in `plane`, about the camera's axis, by the tips of two views; None if beyond
    reason. The line that joins a point with its mirror image touches both outlines at the tip (a frontier point).
    """
    across = np.array([axis[1], -axis[0]])
    front, side = (
        rows_of(mask, camera, views.binning, across, trust_ends=True).places("left")[0]
        for mask in (views.front, views.mirrors[name])
    )
    about = np.array([0.0, 0.0, 0.0])

    def apart(turn: float) -> float:
        moved = plane.moved(turn, 0.0, 0.0, about)
        joint = moved.normal[:2] / np.hypot(*moved.normal[:2])
        upward = np.array([-joint[1], joint[0]])
        upward = upward if float(upward @ axis) > 0 else -upward
        epipole = moved.epipole(camera)
        if epipole is None:
            return float(np.max(side @ upward) - np.max(front @ upward))
        rays = (points - epipole for points in (side, front))
        far = [float(np.max((ray @ upward) / np.abs(ray @ joint))) for ray in rays]
        return (far[0] - far[1]) * float(np.hypot(*epipole))

    low, high = -MAX_TURN_RAD, MAX_TURN_RAD
    values = apart(low), apart(high)
    if values[0] * values[1] > 0:
        return None
    for _ in range(30):
        middle = 0.5 * (low + high)
        if (apart(middle) > 0) == (values[0] > 0):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


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
    rays = poses[name].of(outlines[name]).reflect(outlines[name].touching)
    point, direction = body.to_frame(rays.point, place=True), body.to_frame(rays.direction, place=False)
    far = -point[:, 0] / direction[:, 0]
    heights = point[:, 2] + far * direction[:, 2]  # where the rays cross the plane through the finger's axis
    low, high = (float(v) for v in np.quantile(heights, (0.15, 0.85)))
    z, rise = 0.5 * (low + high), 0.5 * (high - low)
    width = 0.5 * float(np.nanquantile(front.width_mm, 0.8))
    coefficients = np.zeros((4, _KNOTS + 3))
    coefficients[1], coefficients[2], coefficients[3] = z, width, rise
    squareness = 0.0 if settings.section == "ellipse" else settings.squareness
    return replace(body, coefficients=coefficients, squareness=squareness)


# The thesis's method: lateral and frontal masks aligned row by row, one ellipse a row; mirrors at exactly 45 deg.


@dataclass(frozen=True, slots=True, eq=False)
class _Ellipses:
    """One ellipse for each row that both views have."""

    axis: Array
    """(2,) of the front view's medial line, towards the tip."""
    from_tip_mm: Array
    """(n,) distance of the rows from the tip, growing."""
    tip_mm: float
    """Where the tip lies on the axis."""
    middle_mm: Array
    """(n,) middle of the front view's row, to the right of the axis."""
    half_width_mm: Array
    """(n,) of the front view."""
    half_height_mm: Array
    """(n,) of the lateral view."""
    centre_mm: Array
    """(n,) height of the lateral view's middle, beside its medial line."""

    def heights(
        self, camera: Camera, rows: slice, columns: slice, binning: int = 1
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y and z (h, w) of a window's pixels, or blocks of pixels, z NaN beside the ellipses."""
        view = view_of(camera, rows, columns, binning=binning)
        x, y = view.on_plane()
        shape = np.broadcast_shapes(x.shape, y.shape)
        x, y = np.broadcast_to(x, shape), np.broadcast_to(y, shape)
        p = self.axis[0] * x + self.axis[1] * y
        q = self.axis[1] * x - self.axis[0] * y
        back = self.tip_mm - p

        def at(values: Array) -> Array:
            return np.asarray(np.interp(back, self.from_tip_mm, values))

        place = (q - at(self.middle_mm)) / np.maximum(at(self.half_width_mm), 1e-9)
        z = at(self.centre_mm) + at(self.half_height_mm) * np.sqrt(np.clip(1.0 - place**2, 0.0, None))
        outside = (np.abs(place) > 1) | (back < self.from_tip_mm[0]) | (back > self.from_tip_mm[-1])
        z = np.where(outside, np.nan, z).astype(np.float32)
        return np.asarray(x), np.asarray(y), z


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
    require(bool(common.any()), "the views of the finger have no row in common: it does not lie along the mirror.")
    back, middle, half = back[common], middle[common], half[common]
    rise = np.interp(back, back_side, half_side)
    centre = tip_is_outward * np.interp(back, back_side, middle_side - line_side)
    return _Ellipses(front.axis, back, front.tip_mm, middle, half, rise, np.asarray(centre))


TURN_DEG = 0.2
"""Standard deviation of a mirror's turn as the views' tips show it."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorShape:
    """A finger's shape from its outlines."""

    camera: Camera
    model: Body | _Ellipses
    facts: Mapping[str, Any]
    """What was found: mirrors' poses, misfits, the sections' form."""
    outlines: Mapping[str, tuple[OutlineRows, ...]] = field(default_factory=dict)
    """Measured outlines of ``front`` and every mirror."""
    fit: Fit | None = None
    touching: Mapping[str, Touching] = field(default_factory=dict)
    """As the camera sees them: of ``front`` and every mirror beside the finger."""

    def plane(self, mirror: Mirror) -> tuple[Array, float]:
        """Normal (3,) of a mirror where it was found, and its distance from the origin along it."""
        plane = MirrorPlane.nominal(mirror)
        if self.fit is not None and mirror.name in self.fit.poses:
            pose = self.fit.poses[mirror.name]
            plane = plane.moved(pose.turn_rad, pose.lean_rad, pose.shift_mm, mirror.point_mm)
        return plane.normal, plane.offset_mm

    def points(self, rows: slice, columns: slice, binning: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y and z (h, w), mm, of the surface that a window's pixels of the front view see, in blocks of `binning`
        pixels a side; NaN beside it.
        """
        if isinstance(self.model, _Ellipses):
            return self.model.heights(self.camera, rows, columns, binning)
        x, y, z, inside, _ = heights_on(self.model, self.camera, rows, columns, binning)
        return x, y, np.where(inside, z, np.float32(np.nan))

    def continued(self, rows: slice, columns: slice) -> tuple[FloatArray, BoolArray]:
        """z (h, w) of a window's pixels, finite: beside the finger its outline's z goes on; and which are known."""
        if isinstance(self.model, _Ellipses):
            _, _, z = self.model.heights(self.camera, rows, columns)
            known = np.isfinite(z)
            return nearest_known(z, known), known
        _, _, z, _, known = heights_on(self.model, self.camera, rows, columns)
        return z, known

    def drawn(self, mirrors: Mapping[str, Mirror]) -> dict[str, Array]:
        """Outline (n, 2), columns and rows of the camera's image, of the fitted body in every view beside it."""
        if self.fit is None or not isinstance(self.model, Body):
            return {}
        found = {}
        for name, planes in self.touching.items():
            plane = None if name == "front" else MirrorPlane(*self.plane(mirrors[name]))
            points = touched(self.model, planes if plane is None else plane.reflect(planes))
            if plane is not None:
                points = points - 2.0 * np.outer(points @ plane.normal - plane.offset_mm, plane.normal)
            found[name] = pixels_of(self.camera, points)
        return found


def mirror_shape(
    views: Views,
    rig: Rig,
    settings: MirrorShapeSettings | None = None,
    *,
    tip_direction_deg: float = 0.0,
    slopes: Slopes | None = None,
) -> MirrorShape:
    """Find the finger's shape.

    Raises BadInput if the views do not fit one finger. Source: the thesis, section 3.3.2.3. Cipolla and Giblin 2000,
    Visual Motion of Curves and Surfaces (frontier points).

    views : masks of the front view and of the mirrors' views, see :func:`splitknit.mirrors.views.find_views`
    rig : its camera, and where its mirrors nominally are
    tip_direction_deg : where the finger's tip points, within 75 deg: 0 = row 0, counter-clockwise
    slopes : of the skin in the front view, optional: they determine the sections' form and roll
    """
    settings = settings or MirrorShapeSettings()
    require(bool(views.mirrors), "no mirror shows the finger; the shape needs one beside it at least.")
    if settings.method == "thesis":
        return _by_thesis(views, rig, tip_direction_deg)
    return _by_outlines(views, rig, settings, tip_direction_deg, slopes)


def _mirrors_of(views: Views, rig: Rig, axis: Array) -> tuple[dict[str, Mirror], dict[str, Mirror]]:
    """Mirrors that show the finger, by name; and those of them beside it."""
    known = {mirror.name: mirror for mirror in rig.mirrors}
    used = {name: known[name] for name in sorted(views.mirrors)}
    sides = {name: mirror for name, mirror in used.items() if not _from_tip(mirror, axis)}
    require(bool(sides), "only the mirror beyond the tip shows the finger; the shape needs one beside it.")
    return used, sides


def _from_tip(mirror: Mirror, axis: Array) -> bool:
    """Whether a mirror looks along the finger rather than across it."""
    level = mirror.normal[:2] / np.hypot(*mirror.normal[:2])
    return bool(abs(float(level @ axis)) > np.sqrt(0.5))


def _by_thesis(views: Views, rig: Rig, tip_direction_deg: float) -> MirrorShape:
    """The thesis's method on the first lateral view."""
    camera = rig.camera
    axis, front = front_axis(views.front, camera, views.binning, tip_direction_deg)
    name, mirror = next(iter(_mirrors_of(views, rig, axis)[1].items()))
    _, lateral = finger_axis(views.mirrors[name], camera, views.binning, axis)
    side = pad_side(mirror, lateral)
    require(
        not is_cut(lateral, side),
        f"the view in the {name} mirror is cut off at the mirror's edge: lay the finger in "
        "the middle, so that the mirror shows all of its pad.",
    )
    outward = 1.0 if side == "right" else -1.0
    model = _ellipses(front, lateral, outward)
    facts = {"method": "thesis", "mirrors": [name], "section": "ellipse"}
    return MirrorShape(camera, model, facts, {"front": (front,), name: (lateral,)})


def _by_outlines(
    views: Views, rig: Rig, settings: MirrorShapeSettings, tip_direction_deg: float, slopes: Slopes | None
) -> MirrorShape:
    """Body and mirrors' poses together."""
    camera = rig.camera
    axis, front = front_axis(views.front, camera, views.binning, tip_direction_deg)
    rows_by_view: dict[str, tuple[OutlineRows, ...]] = {"front": (front,)}
    mirrors: dict[str, MirrorOutline] = {}
    lateral: dict[str, OutlineRows] = {}
    cut: list[str] = []
    for name, mirror in _mirrors_of(views, rig, axis)[0].items():
        plane = MirrorPlane.nominal(mirror)
        tip = _from_tip(mirror, axis)
        mask = views.mirrors[name]
        if tip:
            rows = rows_of(mask, camera, views.binning, np.array([axis[1], -axis[0]]), trust_ends=True)
            parts = touching_planes(rows, camera, ("left",))
        else:
            rows = rows_of(mask, camera, views.binning, plane.image_axis(axis))
            lateral[name] = rows
            parts = touching_planes(rows, camera)
        if is_cut(rows, pad_side(mirror, rows), from_tip=tip):
            cut.append(name)
            lateral.pop(name, None)
            continue
        rows_by_view[name] = (rows,)
        mirrors[name] = MirrorOutline(parts, plane, mirror.point_mm, tip)
    require(
        bool(lateral),
        f"the view in the {' and the '.join(cut)} mirror is cut off at the mirror's edge or the picture's: "
        "lay the finger in the middle, so that the mirror shows all of its pad.",
    )
    poses = {name: Pose() for name in mirrors}
    for name in lateral:
        turn = turn_of_tips(views, name, camera, mirrors[name].plane, axis)
        if turn is None:
            raise BadInput(TIPS_APART.format(name))
        poses[name] = Pose(turn_rad=turn)
        mirrors[name] = replace(mirrors[name], turn_rad=turn, turn_sd_rad=np.deg2rad(TURN_DEG))
    body = first_body(front, lateral, mirrors, poses, settings)
    front = front.beyond(body.tip_mm - body.length_mm)
    outlines = Outlines(touching_planes(front, camera), mirrors)
    fit = fit_body(Estimate(body, poses), outlines, settings, slopes)
    refuse_misfit(fit, mirrors)
    beside = {"front": outlines.front, **{name: mirrors[name].touching for name in lateral}}
    return MirrorShape(
        camera, fit.body, {**facts_of(fit, settings, slopes), "views_cut_off": cut}, rows_by_view, fit, beside
    )
