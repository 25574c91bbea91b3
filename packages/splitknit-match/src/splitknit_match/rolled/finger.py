"""The rolled-equivalent finger: photometric stereo from the front and in every mirror, fused around
the finger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy

from splitknit import Capture
from splitknit.findings import Finding, Severity, worst_first
from splitknit.imaging.geometry import smoothed
from splitknit.mirrors.body import Body
from splitknit.mirrors.mirror import SQUARENESS
from splitknit.mirrors.reflection import Glass
from splitknit.model import Array, BoolArray, FloatArray, Progress, no_progress
from splitknit.observation.observe import observe
from splitknit.skin.grid import smooth_step
from splitknit.skin.images import MetricSettings
from splitknit_match.rolled.chart import Chart, Sight, crossing, surface_normals
from splitknit_match.rolled.register import (
    MIN_CORRELATION,
    ViewRidges,
    align,
    ridges_of,
    search,
)
from splitknit_match.rolled.views import MirrorViews, ViewRelief, view_relief


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A smooth finger on a chart all around it."""

    chart: Chart
    radius_mm: Array  # (n, m)
    half_mm: float  # half its typical breadth


_SHAPE_PITCH_MM = 0.25
"""Pitch of the chart of the smooth finger. Chosen on: simulated fingers (11, 101, 102 and 201 to
204 between two mirrors)."""
_FAN_DEG = 75.0
"""How far the chart bends over the tip. Chosen on: simulated fingers (11, 101, 102 and 201 to 204
between two mirrors)."""
_BELOW_MM = 4.0
"""The chart goes on below what the outlines show: light from there matters. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_AROUND_DEG = 172.0
"""The chart of the smooth finger reaches this far to either side of the front. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_STATIONS = 60
"""Sections of a body of which the typical one is taken. Chosen on: simulated fingers (11, 101, 102
and 201 to 204 between two mirrors)."""


def _shape_of(body: Body) -> Shape:
    """A body on a chart whose axis runs through its sections' middles."""
    sections = body.sections(body.tip_mm - body.length_mm * np.linspace(0.1, 1.0, _STATIONS))
    half = float(np.median(sections.a))
    cap = min(half, 0.6 * body.length_mm)
    along = np.array([*body.axis, 0.0])
    right = np.array([*body.across, 0.0])
    centre = np.array([*body.origin_mm, float(np.median(sections.z))])
    centre = centre + (body.tip_mm - cap) * along + float(np.median(sections.t)) * right
    angles = _angles(_AROUND_DEG, cap, _SHAPE_PITCH_MM)
    lengths = _lengths(
        cap - body.length_mm - _BELOW_MM, float(cap * np.deg2rad(_FAN_DEG)), _SHAPE_PITCH_MM
    )
    chart = Chart(centre, np.stack([right, along, [0.0, 0.0, 1.0]]), angles, lengths, cap)
    radius = _radius_of(body, chart)
    return Shape(chart, radius + _rolled_pad(body, chart, radius), half)


_AROUND_SKIN_DEG = 105.0
"""The chart of the print reaches this far to either side of the front. Chosen on: simulated fingers
(11, 101, 102 and 201 to 204 between two mirrors)."""
_SEARCH_PITCH_MM = 0.1
"""Pitch of the chart on which ridges are compared. Chosen on: speed."""
_MIN_COSINE = 0.25
"""Views are compared where both see the skin less steeply than this, in cosine. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_MIN_MEETING = 0.3
"""Correlation of two views' ridges below which they do not lie on each other. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


class Work:
    """A finger between its mirrors while it is put together."""

    def __init__(self, capture: Capture, views: MirrorViews, settings: MetricSettings) -> None:
        """Measure the shape, and the relief of every view."""
        observation = observe(capture).without_films()
        self.camera = observation.rig.camera
        self.findings = views.findings
        self.cut = {view.name for view in views if view.cut}
        self.shape = _shape_of(views.body)
        self.correlation: dict[str, list[float]] = {}
        masks = {view.name: view.mask for view in views if view.mask is not None}
        glasses = {view.name: view.glass for view in views if view.glass is not None}
        self.glasses = {name: glass for name, glass in glasses.items() if name in masks}
        lit = sorted(glasses.values(), key=lambda glass: glass.name not in masks)
        shape = self.shape
        self.reliefs: dict[str, ViewRelief] = {
            name: view_relief(
                observation,
                sight,
                masks[name],
                shape.chart,
                shape.radius_mm,
                glasses=lit,
                settings=settings,
            )
            for name, sight in self.sights().items()
        }

    def sights(self) -> dict[str, Sight]:
        """The front and the mirrors where they are taken to be by now."""
        camera = self.camera
        mirrors = {name: Sight(name, camera, glass.plane) for name, glass in self.glasses.items()}
        return {"front": Sight("front", camera), **mirrors}

    def surface(self, pitch_mm: float) -> tuple[Chart, Array, Array, Array]:
        """The finger's chart, as far around as a print reaches; radius, points and normals on
        it."""
        whole = self.shape.chart
        angles = _angles(_AROUND_SKIN_DEG, self.shape.half_mm, pitch_mm)
        lengths = _lengths(float(whole.length_mm[-1]), float(whole.length_mm[0]), pitch_mm)
        chart = replace(whole, angle_rad=angles, length_mm=lengths)
        radius = _sampled(whole, self.shape.radius_mm, chart)
        points = chart.points(radius)
        return chart, radius, points, surface_normals(points)

    def seen(
        self, name: str, points: Array, normals: Array
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Relief, deviation and trust of a view at points; and where it shows them."""
        sight = self.sights()[name]
        fields = np.stack(self.reliefs[name].sampled(sight, points))
        known = np.isfinite(fields).all(axis=0) & (sight.cosine(normals, points) > _MIN_COSINE)
        relief, deviation, trust = np.where(known, fields, np.float32(0))
        return relief, deviation, trust, known

    def register(self, coarse: bool) -> None:
        """Bring the mirrors' ridges onto the front's: by a search first, then by what bends and
        moves."""
        chart, radius, points, normals = self.surface(_SEARCH_PITCH_MM)
        views = {}
        for name, sight in self.sights().items():
            relief, _, _, known = self.seen(name, points, normals)
            views[name] = ViewRidges(sight, ridges_of(relief, known, chart.pitch_mm), known)
        front = views.pop("front")
        mirrors = {
            name: replace(view, known=view.known & front.known) for name, view in views.items()
        }
        if coarse:
            matches = []
            for name, mirror in mirrors.items():
                match = search(chart, radius, front, mirror, cut=name in self.cut)
                # it may lie further off than it should
                if match.correlations[0] < _MIN_MEETING and name not in self.cut:
                    again = search(chart, radius, front, mirror, cut=True)
                    match = max(match, again, key=lambda each: each.correlations)
                matches.append(match)
            added = np.sum([match.radius_mm for match in matches], axis=0)
            poses = [match.poses[0] for match in matches]
            correlations = [match.correlations[0] for match in matches]
        else:
            met = {name: values[0] >= MIN_CORRELATION for name, values in self.correlation.items()}
            correction = align(
                chart,
                radius,
                front,
                [replace(view, known=view.known & met[name]) for name, view in mirrors.items()],
            )
            added = correction.radius_mm
            poses = list(correction.poses)
            correlations = list(correction.correlations)
        for name, pose, correlation in zip(mirrors, poses, correlations, strict=True):
            self.correlation.setdefault(name, []).append(round(correlation, 3))
            plane = self.glasses[name].plane.moved((pose[0], pose[1]), pose[2])
            self.glasses[name] = replace(self.glasses[name], plane=plane)
        # the correction of a part of the finger, on the chart all around it
        whole = self.shape.chart
        beyond = np.maximum(np.abs(whole.angle_rad) - float(chart.angle_rad[-1]), 0.0) / np.deg2rad(
            30.0
        )
        spread = _sampled(chart, added, whole) * np.exp(-0.5 * beyond**2)
        self.shape = replace(self.shape, radius_mm=self.shape.radius_mm + spread)


@dataclass(frozen=True, slots=True, eq=False)
class Blended:
    """One relief from all views."""

    relief_mm: FloatArray  # (n, m) along the skin's normal, zero where no view shows the finger
    known: BoolArray  # (n, m)
    fractions: FloatArray  # (V, n, m) of each view; they sum to one where known


def blend(reliefs: FloatArray, weights: FloatArray) -> Blended:
    """Mean of the views (V, n, m) by their weights (V, n, m)."""
    total = weights.sum(axis=0)
    known = total > 1e-6
    fractions = weights / np.where(known, total, 1.0)
    return Blended(
        (fractions * np.where(fractions > 0, reliefs, 0.0)).sum(axis=0),
        known,
        fractions.astype(np.float32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Rolled:
    """A finger around its front, on its chart."""

    chart: Chart
    points_mm: FloatArray  # (n, m, 3) of the skin without its ridges, rig's frame
    normals: FloatArray  # (n, m, 3)
    blended: Blended
    names: tuple[str, ...]  # names of the views, in the order of ``blended.fractions``
    # (V, n, m) relief of each view, along the skin's normal; zero where it shows nothing
    view_reliefs: FloatArray
    # (V, n, m, 2) column and row of the image at which each view shows each point
    places: FloatArray
    glasses: tuple[Glass, ...]  # mirrors where the ridges have them
    facts: Mapping[str, object]
    findings: tuple[Finding, ...]  # of its views, worst first


PITCH_MM = 0.035
"""Pitch of the chart of the print, finer than the camera resolves. Chosen on: simulated fingers
(11, 101, 102 and 201 to 204 between two mirrors)."""
_SURE_MEETING = 0.4
"""Correlation of two views' ridges below which they may not lie on each other. Chosen on: simulated
fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


def rolled_finger(
    capture: Capture,
    views: MirrorViews,
    settings: MetricSettings,
    progress: Progress = no_progress,
) -> Rolled:
    """One finger from its front and its mirrors. `capture`: with the white band; `views`: its front
    and a mirror beside the finger at least.
    """
    progress("views", 0.0)
    work = Work(capture, views, settings)
    progress("registration", 0.35)
    for coarse in (True, False, False, False):
        work.register(coarse)
    progress("fusion", 0.5)
    chart, _, points, normals = work.surface(PITCH_MM)
    sights = work.sights()
    reliefs = []
    weights = []
    for name, sight in sights.items():
        relief, deviation, trust, known = work.seen(name, points, normals)
        reliefs.append(relief)
        weights.append(
            _view_weight(sight.cosine(normals, points), known, deviation, chart.pitch_mm) * trust
        )
    weighed = np.stack(weights).astype(np.float32)
    stacked = np.stack(reliefs).astype(np.float32)
    breadth = (weighed[0] > 0).sum(axis=1)
    # all views end where the front shows less than nine tenths of its usual breadth
    if breadth.any():
        last = np.flatnonzero(breadth >= 0.9 * np.median(breadth[breadth > 0]))[-1]
        weighed[:, last + 1 :] = 0.0
    apart = [
        _apart(name, values[-1])
        for name, values in work.correlation.items()
        if values[-1] < _SURE_MEETING
    ]
    facts = {
        "views": list(sights),
        "relief_by": {name: relief.how for name, relief in work.reliefs.items()},
        "views_meet": work.correlation,
    }
    places = np.stack([np.stack(sight.pixels(points), axis=-1) for sight in sights.values()])
    return Rolled(
        chart,
        points.astype(np.float32),
        normals.astype(np.float32),
        blend(stacked, weighed),
        tuple(sights),
        stacked,
        places,
        tuple(work.glasses.values()),
        facts,
        worst_first([*work.findings, *apart]),
    )


def _apart(name: str, correlation: float) -> Finding:
    """That a mirror's ridges hardly lie on the front's."""
    sure = correlation < _MIN_MEETING
    words = (
        f"ridges of the {name} mirror's view {'do' if sure else 'may'} not lie on the front's"
        f" (correlation {correlation:.2f}), so that they may be kinked where the views meet: check"
        " the mirror's pose in rig.json, and that ridges are seen in it."
    )
    return Finding("views-do-not-meet", words, Severity.DOUBT if sure else Severity.NOTE)


STEEPEST_DEG = 72.0
"""Slant, as a view sees it, from which it counts for nothing. Chosen on: simulated fingers (11,
101, 102 and 201 to 204 between two mirrors)."""
_FADE_MM = 0.8
"""Width over which a view fades in from the outline of what it shows. Chosen on: simulated fingers
(11, 101, 102 and 201 to 204 between two mirrors)."""
_MAX_DEVIATION_MM = 0.035
"""Where the relief's standard deviation exceeds this, ridges are unknown; a view loses weight from
three quarters of it on. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two
mirrors)."""
_POWER = 8.0
"""Views weigh with this power of what their slant leaves: high hands over fast, low mixes over a
wide zone. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""
_DEVIATION_FLOOR_MM = 0.004
"""Added to the relief's standard deviation, so that no view is trusted without limit. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


def _view_weight(
    cosine: Array, known: BoolArray, deviation_mm: FloatArray, pitch_mm: float
) -> FloatArray:
    """(n, m) weight of a view on the chart, zero where it shows nothing. `cosine`: of the slant as
    the view sees it; `known`: where it shows the finger; `deviation_mm`: of its relief, along the
    skin's normal; all (n, m).
    """
    least = np.cos(np.deg2rad(STEEPEST_DEG))
    facing = np.clip((cosine - least) / (1.0 - least), 0.0, 1.0) ** _POWER
    inside = (known & (facing > 0)).astype(np.uint8)
    depth = cv2.distanceTransform(np.pad(inside, 1), cv2.DIST_L2, 5)[1:-1, 1:-1] * pitch_mm
    fade = smooth_step(depth / _FADE_MM)
    deviation = smoothed(deviation_mm, known, 0.5 / pitch_mm)
    certain = _DEVIATION_FLOOR_MM**2 / (_DEVIATION_FLOOR_MM**2 + deviation**2)
    sure = np.clip(4.0 * (1.0 - deviation / _MAX_DEVIATION_MM), 0.0, 1.0)
    return np.asarray(facing * fade * certain * sure * inside, dtype=np.float32)


def _angles(reach_deg: float, radius_mm: float, pitch_mm: float) -> Array:
    """Angles to both sides of the front, `pitch_mm` apart at `radius_mm`."""
    low, high = np.deg2rad(-reach_deg), np.deg2rad(reach_deg)
    return np.linspace(low, high, max(2, int(np.ceil((high - low) * radius_mm / pitch_mm)) + 1))


def _lengths(base_mm: float, tip_mm: float, pitch_mm: float) -> Array:
    """Lengths from the tip to the base."""
    rows = max(2, int(np.ceil((tip_mm - base_mm) / pitch_mm)) + 1)
    return np.linspace(tip_mm, tip_mm - pitch_mm * (rows - 1), rows)


def _sampled(chart: Chart, radius_mm: Array, target: Chart) -> Array:
    """(n, m) a surface of one chart on the rays of another with the same axis; held beyond the
    first's ends."""
    spline = scipy.interpolate.RectBivariateSpline(
        -chart.length_mm, chart.angle_rad, radius_mm, kx=3, ky=3
    )
    rows = np.clip(target.length_mm, chart.length_mm[-1], chart.length_mm[0])
    return spline(-rows, np.clip(target.angle_rad, chart.angle_rad[0], chart.angle_rad[-1]))


def _radius_of(body: Body, chart: Chart) -> Array:
    """(n, m) distance of the body's skin along the rays of a chart."""
    highest = 1.5 * float(np.abs(body.coefficients[2:]).max()) + chart.cap_mm
    low = np.zeros(chart.shape)
    return crossing(lambda radius: _outside(body, chart.points(radius)), low, low + highest, 24)


def _outside(body: Body, points_mm: Array) -> BoolArray:
    """Whether points (..., 3) of the rig's frame lie outside a body; beyond its base its last
    section goes on."""
    t, u, z = body.to_frame(points_mm.reshape(-1, 3), place=True).T
    sections = body.sections(u)
    rise = z - sections.z
    across = (t - sections.t - sections.shear * rise) / np.maximum(sections.a, 1e-6)
    squared = np.minimum(across * across, 1.0)
    highest = sections.b * (np.sqrt(1.0 - squared) * (1.0 + sections.squareness * squared))
    out = (np.abs(rise) > highest) | (np.abs(across) >= 1.0) | (u > body.tip_mm)
    return np.asarray(out.reshape(points_mm.shape[:-1]))


ROLL_OF_SHEAR = -3.1
"""Roll to the right for each unit of a body's shear, in rad. Chosen on: simulated fingers (11, 101,
102 and 201 to 204 between two mirrors)."""
_MAX_ROLL_RAD = 0.3
"""Largest roll that a body's shear shows. Chosen on: simulated fingers (11, 101, 102 and 201 to 204
between two mirrors)."""


def _rolled_pad(body: Body, chart: Chart, radius_mm: Array) -> Array:
    """(n, m) to be added to the skin's distance where a finger is rolled: its flat pad is rolled,
    too.

    A body's sections shear when it rolls, but their flat side stays where it faces the camera. With
    squareness k and roll phi the pad of k sin^2(2 w) / 4 of the radius turns by phi, to first order
    -phi k sin(4 w) / 2: nothing at the outlines of front and sides, all of it between them.
    """
    flat = 0.5 * (body.squareness + SQUARENESS)  # the fit takes a rolled pad for a round one
    roll = float(np.clip(ROLL_OF_SHEAR * body.shear, -_MAX_ROLL_RAD, _MAX_ROLL_RAD))
    turned = np.where(np.abs(chart.angle_rad) < 0.5 * np.pi, np.sin(4.0 * chart.angle_rad), 0.0)
    return -0.5 * flat * roll * turned[None] * radius_mm
