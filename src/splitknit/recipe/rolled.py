"""The rolled-equivalent finger: photometric stereo from the front and in every mirror, fused around the finger."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.fuse import (
    Blended,
    Chart,
    Sight,
    align,
    blend,
    chart_over,
    disparity,
    read,
    ridge_band,
    sampled,
    search,
    surface_normals,
    view_weight,
    warp_field,
)
from splitknit.recipe.presets import PipelineSettings
from splitknit.recipe.rolled_light import Glass
from splitknit.recipe.rolled_relief import ViewRelief, view_relief
from splitknit.recipe.rolled_settings import RolledSettings
from splitknit.recipe.rolled_shape import Shape, first_shape
from splitknit.types import BoolArray, Capture, FloatArray

Array = NDArray[np.float64]
COARSE_PITCH_MM = 0.07
"""Of the chart on which ridges are compared."""
SEARCH_PITCH_MM = 0.1
LEAST_COSINE = 0.25
"""Views are compared where both see the skin less steeply than this."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorView:
    """What a capture with mirrors shows once."""

    name: str
    """``front``, ``left``, ``right`` or ``tip``."""
    mask: BoolArray | None
    """(H, W) where the view shows the finger; None for a mirror whose light counts, but not its view."""
    glass: Glass | None = None
    """The mirror; None for the front."""


@dataclass(frozen=True, slots=True, eq=False)
class Rolled:
    """A finger around its front, on its chart."""

    chart: Chart
    points_mm: FloatArray
    """(n, m, 3) of the skin without its ridges, rig's frame."""
    normals: FloatArray
    """(n, m, 3)."""
    blended: Blended
    names: tuple[str, ...]
    """Of the views, in the order of ``blended.shares``."""
    view_reliefs: FloatArray
    """(V, n, m) relief of each view after registration, along the skin's normal; zero where it shows nothing."""
    places: FloatArray
    """(V, n, m, 2) column and row of the image at which each view shows each point."""
    glasses: tuple[Glass, ...]
    """Mirrors where the ridges have them."""
    facts: Mapping[str, object]


class _Work:
    """A finger between its mirrors while it is put together."""

    def __init__(
        self, capture: Capture, views: Sequence[MirrorView], settings: PipelineSettings, rolled: RolledSettings
    ) -> None:
        self.capture, self.settings, self.rolled = capture, settings, rolled
        self.masks = {view.name: view.mask for view in views if view.mask is not None}
        used = {view.name: view.glass for view in views if view.glass is not None}
        self.glasses = {name: glass for name, glass in used.items() if name in self.masks}
        self.lamps = [glass for name, glass in used.items() if name not in self.masks]
        self.shape: Shape = first_shape(
            {name: (sight, self.masks[name]) for name, sight in self.sights().items()},
            {name: glass.corners_mm for name, glass in self.glasses.items()},
            capture.tip_direction_deg,
            rolled.exponent,
        )
        self.reliefs: dict[str, ViewRelief] = {}
        self.correlation: dict[str, list[float]] = {}
        self.matched: dict[str, int] = {}

    def sights(self) -> dict[str, Sight]:
        camera = self.capture.rig.camera
        found = {"front": Sight("front", camera)}
        for name, glass in self.glasses.items():
            found[name] = Sight(name, camera, glass.plane)
        return found

    def find_ridges(self) -> None:
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
        whole = self.shape.chart
        half = float(np.median(self.shape.body.half_mm))
        around = (-self.rolled.around_deg, self.rolled.around_deg)
        lengths = (float(whole.length_mm[-1]), float(whole.length_mm[0]))
        return chart_over(whole.centre_mm, whole.axes, around, lengths, whole.cap_mm, pitch_mm, half)

    def radius_on(self, chart: Chart) -> Array:
        return sampled(self.shape.chart, self.shape.radius_mm, chart)

    def seen(self, name: str, points: Array, normals: Array) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Relief, deviation and weight-giving cosine of a view at points; and where it shows them."""
        view = replace(self.reliefs[name], sight=self.sights()[name])
        relief, deviation, trust = view.sampled(points)
        cosine = view.sight.cosine(normals)
        known = np.isfinite(relief) & np.isfinite(deviation) & np.isfinite(trust) & (cosine > LEAST_COSINE)
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
        added = np.zeros(chart.shape)
        for name, glass in list(self.glasses.items()):
            second, _, _, known = self.seen(name, points, normals)
            given = first, ridge_band(second, known, chart.pitch_mm), there & known
            if coarse:
                found = search(chart, radius, sights["front"], sights[name], *given, self.rolled.search)
                correlation, step, pose = found.correlation, found.radius_mm, found.pose
            else:
                done = align(chart, radius, sights["front"], sights[name], *given, self.rolled.poses_free)
                correlation, step, pose = done.after, done.radius_mm, done.pose
                if done.after <= done.before:
                    continue
            self.correlation.setdefault(name, []).append(round(correlation, 3))
            added += step
            self.glasses[name] = replace(glass, plane=glass.plane.moved(pose[:2], pose[2]))
        self.shape = replace(self.shape, radius_mm=self.shape.radius_mm + self.spread(chart, added))

    def spread(self, chart: Chart, added: Array) -> Array:
        """A correction on a part of the finger, on the chart all around it."""
        whole = self.shape.chart
        beyond = np.maximum(np.abs(whole.angle_rad) - float(chart.angle_rad[-1]), 0.0) / np.deg2rad(30.0)
        return np.asarray(sampled(chart, added, whole) * np.exp(-0.5 * beyond**2))


def rolled_finger(
    capture: Capture,
    views: Sequence[MirrorView],
    settings: PipelineSettings,
    rolled: RolledSettings | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Rolled:
    """One finger from its front and its mirrors.

    Parameters
    ----------
    capture : with the white band; the camera's rays are parallel
    views : the front and one mirror beside the finger at least, where each shows the finger and how the mirrors lie
    settings : of the pipeline
    rolled : RolledSettings

    Raises
    ------
    BadInput
        If the front or every mirror beside the finger is missing, or they do not show the same part of the finger.
    """
    chosen = rolled or RolledSettings()
    tell = progress or (lambda stage, share: None)
    names = [view.name for view in views]
    require("front" in names, "the front view of the finger is missing.")
    require("white" in capture.bands, "the capture has no band 'white', in which ridges are seen.")
    work = _Work(capture, views, settings, chosen)
    for turn in range(chosen.turns):
        tell("views", turn / (chosen.turns + 1))
        work.find_ridges()
        tell("registration", (turn + 0.7) / (chosen.turns + 1))
        for coarse in (True, False, False) if turn == 0 else (False,):
            work.register(coarse)
    tell("fusion", chosen.turns / (chosen.turns + 1))
    return _fused(work)


def _fused(work: _Work) -> Rolled:
    chosen = work.rolled
    chart = work.chart(chosen.pitch_mm)
    radius = work.radius_on(chart)
    points = chart.points(radius)
    normals = surface_normals(points)
    names = ("front", *work.glasses)
    warps = _warps(work, chart) if chosen.elastic else {}
    pitch = chart.pitch_mm
    sights = work.sights()
    weights = {}
    for name in names:
        _, deviation, trust, known = work.seen(name, points, normals)
        cosine = sights[name].cosine(normals)
        weights[name] = view_weight(cosine, known, deviation, pitch, chosen.blend) * trust
    reliefs, deviations, finals, places = [], [], [], []
    column, row = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in chart.shape[::-1]))
    for name in names:
        at = points
        if warps:
            at = _moved(points, column, row, _own_share(name, names, weights, warps))
        relief, deviation, trust, known = work.seen(name, at, normals)
        cosine = sights[name].cosine(normals)
        reliefs.append(relief)
        places.append(np.stack(sights[name].pixels(at), axis=-1))
        deviations.append(deviation)
        finals.append(view_weight(cosine, known, deviation, pitch, chosen.blend) * trust)
    stacked = np.stack(reliefs).astype(np.float32)
    blended = blend(stacked, np.stack(deviations).astype(np.float32), np.stack(finals).astype(np.float32))
    facts = {
        "views": list(names),
        "relief_by": {name: work.reliefs[name].how for name in names},
        "views_meet": dict(work.correlation),
        "squares_matched": dict(work.matched),
    }
    return Rolled(
        chart, points.astype(np.float32), normals.astype(np.float32), blended, names, stacked,
        np.stack(places), tuple(work.glasses.values()), facts,
    )  # fmt: skip


def _warps(work: _Work, chart: Chart) -> dict[str, FloatArray]:
    """(n, m, 2) of each mirror: columns and rows by which its ridges still lie further than the front's."""
    chosen = work.rolled
    coarse = work.chart(COARSE_PITCH_MM)
    points = coarse.points(work.radius_on(coarse))
    normals = surface_normals(points)
    pitch = coarse.pitch_mm
    column, row = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in coarse.shape[::-1]))
    first, _, _, there = work.seen("front", points, normals)
    first = ridge_band(first, there, pitch)
    scale = (chart.shape[1] - 1) / (coarse.shape[1] - 1), (chart.shape[0] - 1) / (coarse.shape[0] - 1)
    warps = {}
    for name in work.glasses:
        field = np.zeros((*coarse.shape, 2), dtype=np.float32)
        for window, reach, smooth in chosen.elastic_steps_mm:
            second, _, _, known = work.seen(name, _moved(points, column, row, field), normals)
            second = ridge_band(second, known, pitch)
            found = disparity(first, second, there & known, pitch, reach, replace(chosen.disparity, window_mm=window))
            work.matched[name] = int(found.peak.size)
            field += warp_field(found, coarse.shape, pitch, smooth)
        large = cv2.resize(field, chart.shape[::-1], interpolation=cv2.INTER_LINEAR)
        warps[name] = np.asarray(large * np.array(scale, dtype=np.float32), dtype=np.float32)
    return warps


def _own_share(
    name: str, names: Sequence[str], weights: Mapping[str, FloatArray], warps: Mapping[str, FloatArray]
) -> FloatArray:
    """(n, m, 2) where a view is read beside a point: views meet between them, nearer to the one that counts more."""
    total = np.maximum(sum(weights[other] for other in names), np.float32(1e-6))
    # what the blend shows lies at the mean of the views' own places
    mean = sum((weights[other] / total)[..., None] * warps[other] for other in names if other in warps)
    own = warps[name] if name in warps else np.zeros_like(mean)
    return np.asarray(own - mean, dtype=np.float32)


def _moved(points: Array, column: FloatArray, row: FloatArray, shift: FloatArray) -> Array:
    """Points (n, m, 3) of the surface, read `shift` (n, m, 2) columns and rows further."""
    x, y = column + shift[..., 0], row + shift[..., 1]
    places = [read(np.ascontiguousarray(points[..., axis], dtype=np.float32), x, y, held=True) for axis in range(3)]
    return np.stack(places, axis=-1).astype(np.float64)
