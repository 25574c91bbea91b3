"""A finger between its mirrors while it is put together: its views, their ridges, and what makes them meet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.body import Body
from splitknit.mirrors.rolled.body import radius_of, rolled_pad
from splitknit.mirrors.rolled.chart import Chart, Sight, chart_over, sampled, surface_normals
from splitknit.mirrors.rolled.register import Seen, align, ridge_band
from splitknit.mirrors.rolled.relief import ViewRelief, view_relief
from splitknit.mirrors.rolled.search import MIN_CORRELATION, search
from splitknit.mirrors.rolled.settings import RolledSettings
from splitknit.mirrors.rolled.view_lights import Glass
from splitknit.model import BoolArray, Capture, FloatArray

if TYPE_CHECKING:  # the pipeline lies above
    from splitknit.presets import PipelineSettings

# The finger between its mirrors as a smooth body: where it lies, and its chart.

SHAPE_PITCH_MM = 0.25
"""Of the chart on which the smooth finger is kept."""
FAN_DEG = 75.0
"""How far the chart bends over the tip."""
BELOW_MM = 4.0
"""The chart goes on below what the outlines show: light from there matters."""
AROUND_DEG = 172.0
STATIONS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A smooth finger on a chart all around it."""

    chart: Chart
    radius_mm: Array
    """(n, m)."""
    half_mm: float
    """Half its typical breadth."""


def shape_of(body: Body) -> Shape:
    """A body on a chart whose axis runs through its sections' middles."""
    u = body.tip_mm - body.length_mm * np.linspace(0.1, 1.0, STATIONS)
    sections = body.sections(u)
    half = float(np.median(sections.a))
    cap = min(half, 0.6 * body.length_mm)
    along, right = np.array([*body.axis, 0.0]), np.array([*body.across, 0.0])
    axes = np.stack([right, along, [0.0, 0.0, 1.0]])
    centre = np.array([*body.origin_mm, float(np.median(sections.z))])
    centre = centre + (body.tip_mm - cap) * along + float(np.median(sections.t)) * right
    lengths = (cap - body.length_mm - BELOW_MM, float(cap * np.deg2rad(FAN_DEG)))
    chart = chart_over(centre, axes, (-AROUND_DEG, AROUND_DEG), lengths, cap, SHAPE_PITCH_MM, cap)
    radius = radius_of(body, chart)
    return Shape(chart, radius + rolled_pad(body, chart, radius), half)


Array = NDArray[np.float64]
SEARCH_PITCH_MM = 0.1
"""Of the chart on which ridges are compared."""
MIN_COSINE = 0.25
"""Views are compared where both see the skin less steeply than this."""
MIN_MEETING = 0.3
"""Correlation of two views' ridges below which they are taken not to meet."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorView:
    """What a capture with mirrors shows once."""

    name: str
    """``front``, ``left``, ``right`` or ``tip``."""
    mask: BoolArray | None
    """(H, W) where the view shows the finger; None for a mirror whose light counts, but not its view."""
    glass: Glass | None = None
    """The mirror; None for the front."""
    cut: bool = False
    """Whether the border of picture or mirror cuts the view, so that the mirror's pose is known less well."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorViews:
    """All views of a finger, and what their outlines determine."""

    views: tuple[MirrorView, ...]
    body: Body
    """The smooth finger."""
    notes: tuple[str, ...] = ()
    """What became of views that are not used, or not whole: sentences."""

    def __iter__(self) -> Iterator[MirrorView]:
        return iter(self.views)


class Work:
    """A finger between its mirrors while it is put together."""

    def __init__(  # noqa: D107 - the class says it
        self, capture: Capture, views: MirrorViews, settings: PipelineSettings, rolled: RolledSettings
    ) -> None:
        self.capture, self.settings, self.rolled = capture, settings, rolled
        self.notes = views.notes
        self.masks = {view.name: view.mask for view in views if view.mask is not None}
        used = {view.name: view.glass for view in views if view.glass is not None}
        self.glasses = {name: glass for name, glass in used.items() if name in self.masks}
        self.cut = {view.name for view in views if view.cut}
        self.lamps = [glass for name, glass in used.items() if name not in self.masks]
        self.shape: Shape = shape_of(views.body)
        self.reliefs: dict[str, ViewRelief] = {}
        self.correlation: dict[str, list[float]] = {}
        self.met: dict[str, bool] = {}

    def sights(self) -> dict[str, Sight]:
        """The front and the mirrors where they are taken to be by now."""
        camera = self.capture.rig.camera
        found = {"front": Sight("front", camera)}
        for name, glass in self.glasses.items():
            found[name] = Sight(name, camera, glass.plane)
        return found

    def find_ridges(self) -> None:
        """Photometric stereo of every view on the surface as it is by now."""
        glasses = (*self.glasses.values(), *self.lamps)
        for name, sight in self.sights().items():
            self.reliefs[name] = view_relief(
                self.capture,
                sight,
                self.masks[name],
                glasses,
                self.shape.chart,
                self.shape.radius_mm,
                self.settings,
                self.rolled.slope_prior,
            )

    def chart(self, pitch_mm: float) -> Chart:
        """The finger's chart, as far around as is asked for."""
        whole = self.shape.chart
        half = self.shape.half_mm
        around = (-self.rolled.around_deg, self.rolled.around_deg)
        lengths = (float(whole.length_mm[-1]), float(whole.length_mm[0]))
        return chart_over(whole.centre_mm, whole.axes, around, lengths, whole.cap_mm, pitch_mm, half)

    def radius_on(self, chart: Chart) -> Array:
        """The surface on a chart."""
        return sampled(self.shape.chart, self.shape.radius_mm, chart)

    def seen(self, name: str, points: Array, normals: Array) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Relief, deviation and weight-giving cosine of a view at points; and where it shows them."""
        view = replace(self.reliefs[name], sight=self.sights()[name])
        relief, deviation, trust = view.sampled(points)
        cosine = view.sight.cosine(normals)
        known = np.isfinite(relief) & np.isfinite(deviation) & np.isfinite(trust) & (cosine > MIN_COSINE)
        return np.where(known, relief, 0), np.where(known, deviation, 0), np.where(known, trust, 0), known

    def register(self, coarse: bool) -> None:
        """Bring the mirrors' ridges onto the front's: by a search first, then by what bends and moves."""
        chart = self.chart(SEARCH_PITCH_MM)
        radius = self.radius_on(chart)
        points = chart.points(radius)
        normals = surface_normals(points)
        first, _, _, there = self.seen("front", points, normals)
        first = ridge_band(first, there, chart.pitch_mm)
        sights = self.sights()
        given = {}
        for name in self.glasses:
            second, _, _, known = self.seen(name, points, normals)
            given[name] = Seen(sights[name], ridge_band(second, known, chart.pitch_mm), there & known)
        if coarse:
            added, poses, correlations = np.zeros(chart.shape), [], []
            for name, one in given.items():
                ranges = self.rolled.search_cut if name in self.cut else self.rolled.search
                found = search(chart, radius, sights["front"], one.sight, first, one.band, one.both, ranges)
                if found.correlation < MIN_MEETING and name not in self.cut:  # it may lie further off than it should
                    wider = self.rolled.search_cut
                    again = search(chart, radius, sights["front"], one.sight, first, one.band, one.both, wider)
                    found = max(found, again, key=lambda one: one.correlation)
                self.met[name] = found.correlation >= MIN_CORRELATION
                added += found.radius_mm
                poses.append(found.pose)
                correlations.append(found.correlation)
        else:
            none = np.zeros(chart.shape, dtype=np.bool_)
            seen = tuple(one if self.met[name] else replace(one, both=none) for name, one in given.items())
            done = align(chart, radius, sights["front"], first, seen, self.rolled.poses_free)
            added, poses, correlations = done.radius_mm, list(done.poses), list(done.after)
        for name, pose, correlation in zip(given, poses, correlations, strict=True):
            self.correlation.setdefault(name, []).append(round(correlation, 3))
            self.glasses[name] = replace(self.glasses[name], plane=self.glasses[name].plane.moved(pose[:2], pose[2]))
        self.shape = replace(self.shape, radius_mm=self.shape.radius_mm + self.spread(chart, added))

    def spread(self, chart: Chart, added: Array) -> Array:
        """A correction on a part of the finger, on the chart all around it."""
        whole = self.shape.chart
        beyond = np.maximum(np.abs(whole.angle_rad) - float(chart.angle_rad[-1]), 0.0) / np.deg2rad(30.0)
        return np.asarray(sampled(chart, added, whole) * np.exp(-0.5 * beyond**2))
