"""A finger between its mirrors while it is put together: its views, their ridges (by photometric stereo on a surface
that is known but for its ridges), and what makes them meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit import Capture
from splitknit.imaging.band import Window, has_colour, linear_channels
from splitknit.imaging.geometry import (
    bounding_box,
    enlarged,
    gradients_from_normals,
    height_gradients,
    normals_from_gradients,
)
from splitknit.imaging.view import view_of
from splitknit.integration.shapelets import REFERENCE_PX_PER_MM, ShapeletSettings, shapelets
from splitknit.mirrors.body import Body
from splitknit.mirrors.reflection import Glass, Sight
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.grid import COARSE_PITCH_MM, WORKING_PITCH_MM, BandImages, Grid, coarsen, refine
from splitknit.skin.images import FACTOR, MetricSettings, coarser, finer_grid, finer_images, shipped_networks
from splitknit.skin.learned import can_learn, features, relief_by_network
from splitknit.skin.light import Lighting, fine_lighting, slant_of, trust_of
from splitknit_match.rolled.blend import RolledSettings
from splitknit_match.rolled.chart import Chart, heights, read, surface_normals
from splitknit_match.rolled.register import MIN_CORRELATION, RidgeSearchSettings, ViewRidges, align, ridges_of, search
from splitknit_match.rolled.view_lights import Skin, view_light

ROLL_OF_SHEAR, MAX_ROLL_RAD = -3.1, 0.3
"""Radians of roll to the right for each unit of a body's shear; and the maximum that is accepted."""
Array = NDArray[np.float64]

LIT, MIN_LIT, FADE_MM = 0.5, 3, 0.2
"""Trust from which a light counts, how many a slope needs, and the width over which skin with fewer fades out."""
UNKNOWN_MM = 0.02  # standard deviation of a relief that no network estimated
_ROWS = 64  # rows of the grid whose normals are computed at once


@dataclass(frozen=True, slots=True, eq=False)
class _ViewRelief:
    """Ridges in one view, on a window of the image's pixels (or blocks of them)."""

    sight: Sight
    window: Window
    binning: int
    relief_mm: FloatArray  # (h, w) along the skin's normal, NaN outside the finger
    deviation_mm: FloatArray  # (h, w) its standard deviation, NaN outside
    trust: FloatArray  # (h, w) in [0, 1]: fades out towards grazing slopes and the outline, NaN outside
    how: str

    def places(self, points_mm: Array) -> tuple[FloatArray, FloatArray]:
        """Columns and rows of the window's blocks at which points (..., 3) of the rig's frame are seen."""
        size, half = np.float32(self.binning), 0.5
        seen = zip(self.sight.pixels(points_mm), self.window[::-1], strict=True)
        blocks = (((place - np.float32(side.start) + half) / size - half) for place, side in seen)
        column, row = (block.astype(np.float32) for block in blocks)
        return column, row

    def sampled(self, points_mm: Array) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Relief, deviation and trust (...) at points (..., 3) of the rig's frame; NaN where it does not see them."""
        column, row = self.places(points_mm)
        relief = read(self.relief_mm, column, row, cubic=True)
        relief = np.where(np.isfinite(relief), relief, read(self.relief_mm, column, row))
        return relief, read(self.deviation_mm, column, row), read(self.trust, column, row)


_MAX_SLOPE = 6.0
"""Steeper slopes are shortened to this."""


@dataclass(frozen=True, slots=True)
class ReliefSettings:
    """How the relief of a view is found: grids and networks of the `metric` method, and shapelets where it has none."""

    metric: MetricSettings = field(default_factory=MetricSettings)
    shapelets: ShapeletSettings = field(default_factory=lambda: ShapeletSettings(scales=4))


def _view_relief(  # noqa: PLR0917
    capture: Capture,
    sight: Sight,
    mask: BoolArray,
    glasses: Sequence[Glass],
    chart: Chart,
    radius_mm: Array,
    settings: ReliefSettings,
    prior: float = 0.0,
) -> _ViewRelief:
    """Ridges of the finger as one view shows them, where `mask` (H, W) holds it, in the white band. `glasses`: all
    mirrors of the rig; `chart`, `radius_mm`: the finger without its ridges; `prior`: as of :func:`_held_normals`.
    """
    white = capture.bands["white"]
    camera = capture.rig.camera
    binning = max(1, round(WORKING_PITCH_MM / camera.pitch_mm))
    window = bounding_box(mask, round(0.5 * camera.px_per_mm))
    rows, columns = window
    view = view_of(camera, rows, columns, binning=binning)
    blocks = _blocks(mask[window], binning)
    few = (slice(None, None, 4),) * view.x_mm.ndim
    seen = heights(sight, chart, radius_mm, replace(view, x_mm=view.x_mm[few], y_mm=view.y_mm[few]))
    level = float(np.nanmean(seen)) if np.isfinite(seen).any() else 0.0
    origin, nearer, apex = np.array([view.x_mm.mean(), view.y_mm.mean(), level]), 1.0, None
    if view.apex_mm is not None:  # the plane that the pixels are on goes to the finger, or to its image in the mirror
        origin, nearer, apex = np.array([0.0, 0.0, level]), 1.0 - level / view.apex_mm, view.apex_mm - level
    cut = tuple(bool(side.any()) for side in (blocks[0], blocks[-1], blocks[:, 0], blocks[:, -1]))
    x, y, pitch = view.x_mm * nearer - origin[0], view.y_mm * nearer - origin[1], camera.pitch_mm * binning * nearer
    grid = Grid(blocks, x, y, pitch, (cut[0], cut[1], cut[2], cut[3]), apex)
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
    low = coarsen(grid, factor)
    on_plane = replace(view, x_mm=(low.x_mm + origin[0]) / nearer, y_mm=(low.y_mm + origin[1]) / nearer)
    height = low.view.along(heights(sight, chart, radius_mm, on_plane) - np.float32(level))
    known = low.mask & np.isfinite(height)
    low = replace(low, mask=known)
    filled = refine(np.where(known, height, 0).astype(np.float32), known, 1, low.shape)
    rig, inner = view_light(capture.rig.select(white.lights), glasses, Skin.of(filled, low, sight, origin))
    smooth = refine(np.where(known, height, 0).astype(np.float32), known, factor, grid.shape)
    reach = np.kron(known, np.ones((factor, factor), dtype=np.bool_))
    reach = np.pad(reach, [(0, n - m) for n, m in zip(grid.shape, reach.shape, strict=True)])
    grid = replace(grid, mask=grid.mask & reach)
    names = ("red", "green", "blue") if has_colour(white) else ("grey",)
    images = BandImages(names, linear_channels(white, capture.encoding, names, window, binning), rig)
    facing = np.cos(np.deg2rad(slant_of(smooth, grid.pitch_mm)))
    if apex is not None:  # from heights along the rays to millimetres
        facing *= np.exp(-smooth / np.float32(apex))
    inside = grid.mask
    finer = settings.metric.relief == "network" and capture.material == "skin"
    finer = finer and not can_learn(images, grid.pitch_mm) and can_learn(images, grid.pitch_mm / FACTOR)
    if finer:
        grid, images, factor = finer_grid(grid), finer_images(images), factor * FACTOR
        smooth = refine(np.where(known, height, 0).astype(np.float32), known, factor, grid.shape)
    *fields, how = _ridges(images, grid, low, filled, smooth, factor, inner, prior, capture, settings)
    relief, deviation, trust = (coarser(field) for field in fields) if finer else fields

    def placed(field: FloatArray) -> FloatArray:
        return np.where(inside, field, np.float32(np.nan)).astype(np.float32)

    return _ViewRelief(sight, window, binning, placed(relief * facing), placed(deviation * facing), placed(trust), how)


def _ridges(  # noqa: PLR0917
    images: BandImages,
    grid: Grid,
    low: Grid,
    low_height: FloatArray,
    smooth: FloatArray,
    factor: int,
    inner: FloatArray,
    prior: float,
    capture: Capture,
    settings: ReliefSettings,
) -> tuple[FloatArray, FloatArray, FloatArray, str]:
    """Relief along the line of sight, its standard deviation, trust, and how they were found."""
    light = fine_lighting(images.rig, low, low_height, factor, grid)
    lit = _lit(light, grid)
    within = np.stack([enlarged(one, factor, grid.shape) for one in inner])
    light = replace(light, trust=np.maximum(light.trust * within, 1e-3))
    networks = shipped_networks(settings.metric) if can_learn(images, grid.pitch_mm) else None
    if capture.material == "skin" and networks is not None:
        g = _held_normals(images.stack / light.entering, light, smooth, grid, prior)
        found = relief_by_network(features(images, grid, smooth, light, g), grid, smooth, networks.relief)
        return found.relief_mm, found.deviation_mm, found.trust * lit, "network"
    trust = trust_of(slant_of(smooth, grid.pitch_mm), grid) * lit
    stack = images.stack.mean(axis=0)
    entering = light.entering if capture.material == "skin" else None
    g = pseudo_normals(stack, images.rig, smooth, grid.mask, light.trust, view=grid.view, entering=entering)
    normals = g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9)
    slopes = gradients_from_normals(normals, grid.mask, _MAX_SLOPE)
    shape = height_gradients(smooth, grid.pitch_mm)
    beyond = [(slope - base) * trust for slope, base in zip(slopes, shape, strict=True)]
    evened = [b - grid.smooth(b, grid.mask, 0.3) for b in beyond]
    bank = replace(settings.shapelets, sigma_px=settings.shapelets.sigma_px / (REFERENCE_PX_PER_MM * grid.pitch_mm))
    relief = shapelets(evened[0].astype(np.float32), evened[1].astype(np.float32), grid.mask, bank)
    relief = np.nan_to_num(relief, nan=0.0) * np.float32(grid.pitch_mm) * trust
    return relief, np.full(grid.shape, UNKNOWN_MM), trust, "shapelets"


def _lit(light: Lighting, grid: Grid) -> FloatArray:
    """(h, w) in [0, 1]: zero where fewer than three exposures light the skin, which determine no slope."""
    enough = ((light.trust > LIT).sum(axis=0) >= MIN_LIT).astype(np.float32)
    wide = cv2.GaussianBlur(enough, (0, 0), FADE_MM / grid.pitch_mm)
    return np.asarray(np.clip(2.0 * wide - 1.0, 0.0, 1.0), dtype=np.float32)


def _blocks(mask: BoolArray, binning: int) -> BoolArray:
    height, width = (n // binning for n in mask.shape)
    cut = mask[: height * binning, : width * binning].reshape(height, binning, width, binning)
    blocks = np.asarray(cut.all(axis=(1, 3)))
    labels, count = scipy.ndimage.label(blocks)
    if count > 1:
        blocks = labels == 1 + int(np.argmax(np.bincount(labels[labels > 0])[1:]))
    return np.asarray(blocks, dtype=np.bool_)


# Photometric stereo where two lights of one exposure nearly cancel: slopes that the lights hardly determine stay near
# the shape's.


def _held_normals(stack: FloatArray, light: Lighting, smooth_mm: FloatArray, grid: Grid, prior: float) -> FloatArray:
    """(C, h, w, 3) brightness times normal: least squares over the lights, slopes held near the shape's.

    An LED and its image in a mirror give little of the slope towards the mirror. Minimises
    sum_k w_k (I_k - L_k g)^2 + prior mean(w) |t|^2, t the part of g across the shape's normal. `stack`: (C, L, h, w)
    images over the light that enters; `prior`: variance of the images' relative error over that of the slopes.
    """
    channels, count = stack.shape[:2]
    slopes = (grid.smooth(s, grid.mask, 0.3) for s in height_gradients(smooth_mm, grid.pitch_mm))
    normals = np.moveaxis(normals_from_gradients(*slopes), -1, 0)  # (3, h, w)
    weights = light.trust * light.entering * light.entering
    result = np.zeros((channels, *grid.shape, 3), dtype=np.float32)
    for start in range(0, grid.shape[0], _ROWS):
        rows = slice(start, start + _ROWS)
        here = grid.mask[rows]
        if not here.any():
            continue
        v = light.vectors[:, :, rows][:, :, here].astype(np.float64)  # (L, 3, n)
        w = weights[:, rows][:, here].astype(np.float64)
        n = normals[:, rows][:, here].astype(np.float64)  # (3, n)
        across = np.eye(3)[:, :, None] - n[:, None] * n[None]
        hold = prior * np.maximum(w.sum(axis=0), 1e-3) / count
        matrix = np.einsum("ln,lin,ljn->nij", w, v, v) + np.moveaxis(hold * across, -1, 0) + 1e-6 * np.eye(3)
        right = np.einsum("ln,cln,lin->nic", w, stack[:, :, rows][:, :, here].astype(np.float64), v)
        solved = np.linalg.solve(matrix, right)  # (n, 3, C)
        for c in range(channels):
            result[c, rows][here] = solved[:, :, c]
    return result


# The finger between its mirrors as a smooth body: where it lies, and its chart.

SHAPE_PITCH_MM = 0.25  # pitch of the chart of the smooth finger
FAN_DEG = 75.0  # how far the chart bends over the tip
BELOW_MM = 4.0  # the chart goes on below what the outlines show: light from there matters
AROUND_DEG = 172.0
STATIONS = 60


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A smooth finger on a chart all around it."""

    chart: Chart
    radius_mm: Array  # (n, m)
    half_mm: float  # half its typical breadth


def _shape_of(body: Body) -> _Shape:
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
    rays = _angles(AROUND_DEG, cap, SHAPE_PITCH_MM), _lengths(*lengths, SHAPE_PITCH_MM)
    chart = Chart(centre, axes, *rays, cap)
    radius = _radius_of(body, chart)
    return _Shape(chart, radius + _rolled_pad(body, chart, radius), half)


SEARCH_PITCH_MM = 0.1  # pitch of the chart on which ridges are compared
MIN_COSINE = 0.25  # views are compared where both see the skin less steeply than this
MIN_MEETING = 0.3  # correlation of two views' ridges below which they are taken not to meet
_SEARCH_CUT = RidgeSearchSettings(across_mm=(3.0, 0.05), along_mm=(0.3, 0.05), deviations=(0.2, 0.6, 0.6))
"""For views that are cut: their mirrors' poses are known less well."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorView:
    """What a capture with mirrors shows once."""

    name: str  # ``front``, ``left``, ``right`` or ``tip``
    mask: BoolArray | None  # (H, W) where the view shows the finger; None for a mirror whose light alone counts
    glass: Glass | None = None  # the mirror; None for the front
    cut: bool = False  # whether the border of picture or mirror cuts the view, so that the mirror's pose is less sure


@dataclass(frozen=True, slots=True, eq=False)
class MirrorViews:
    """All views of a finger, and what their outlines determine."""

    views: tuple[MirrorView, ...]
    body: Body  # the smooth finger
    notes: tuple[str, ...] = ()  # what became of views that are not used, or not whole: sentences

    def __iter__(self) -> Iterator[MirrorView]:
        return iter(self.views)


class Work:
    """A finger between its mirrors while it is put together."""

    def __init__(  # noqa: D107 - the class says it
        self, capture: Capture, views: MirrorViews, settings: ReliefSettings, rolled: RolledSettings
    ) -> None:
        self.capture, self.settings, self.rolled = capture, settings, rolled
        self.notes = views.notes
        self.masks = {view.name: view.mask for view in views if view.mask is not None}
        used = {view.name: view.glass for view in views if view.glass is not None}
        self.glasses = {name: glass for name, glass in used.items() if name in self.masks}
        self.cut = {view.name for view in views if view.cut}
        self.lamps = [glass for name, glass in used.items() if name not in self.masks]
        self.shape: _Shape = _shape_of(views.body)
        self.reliefs: dict[str, _ViewRelief] = {}
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
            self.reliefs[name] = _view_relief(
                self.capture, sight, self.masks[name], glasses, self.shape.chart, self.shape.radius_mm, self.settings,
                self.rolled.slope_prior,
            )  # fmt: skip

    def chart(self, pitch_mm: float) -> Chart:
        """The finger's chart, as far around as is asked for."""
        whole = self.shape.chart
        angles = _angles(self.rolled.around_deg, self.shape.half_mm, pitch_mm)
        lengths = _lengths(float(whole.length_mm[-1]), float(whole.length_mm[0]), pitch_mm)
        return replace(whole, angle_rad=angles, length_mm=lengths)

    def radius_on(self, chart: Chart) -> Array:
        """The surface on a chart."""
        return _sampled(self.shape.chart, self.shape.radius_mm, chart)

    def seen(self, name: str, points: Array, normals: Array) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Relief, deviation and weight-giving cosine of a view at points; and where it shows them."""
        view = replace(self.reliefs[name], sight=self.sights()[name])
        relief, deviation, trust = view.sampled(points)
        cosine = view.sight.cosine(normals, points)
        known = np.isfinite(relief) & np.isfinite(deviation) & np.isfinite(trust) & (cosine > MIN_COSINE)
        return np.where(known, relief, 0), np.where(known, deviation, 0), np.where(known, trust, 0), known

    def register(self, coarse: bool) -> None:
        """Bring the mirrors' ridges onto the front's: by a search first, then by what bends and moves."""
        chart = self.chart(SEARCH_PITCH_MM)
        radius = self.radius_on(chart)
        points = chart.points(radius)
        normals = surface_normals(points)
        first, _, _, there = self.seen("front", points, normals)
        sights = self.sights()
        front = ViewRidges(sights["front"], ridges_of(first, there, chart.pitch_mm), there)
        given = {}
        for name in self.glasses:
            second, _, _, known = self.seen(name, points, normals)
            given[name] = ViewRidges(sights[name], ridges_of(second, known, chart.pitch_mm), there & known)
        if coarse:
            added, poses, correlations = np.zeros(chart.shape), [], []
            for name, one in given.items():
                ranges = _SEARCH_CUT if name in self.cut else self.rolled.search
                found = search(chart, radius, front, one, ranges)
                if found.correlation < MIN_MEETING and name not in self.cut:  # it may lie further off than it should
                    again = search(chart, radius, front, one, _SEARCH_CUT)
                    found = max(found, again, key=lambda one: one.correlation)
                self.met[name] = found.correlation >= MIN_CORRELATION
                added += found.radius_mm
                poses.append(found.pose)
                correlations.append(found.correlation)
        else:
            none = np.zeros(chart.shape, dtype=np.bool_)
            seen = tuple(one if self.met[name] else replace(one, known=none) for name, one in given.items())
            done = align(chart, radius, front, seen)
            added, poses, correlations = done.radius_mm, list(done.poses), list(done.after)
        for name, pose, correlation in zip(given, poses, correlations, strict=True):
            self.correlation.setdefault(name, []).append(round(correlation, 3))
            self.glasses[name] = replace(self.glasses[name], plane=self.glasses[name].plane.moved(pose[:2], pose[2]))
        self.shape = replace(self.shape, radius_mm=self.shape.radius_mm + self.spread(chart, added))

    def spread(self, chart: Chart, added: Array) -> Array:
        """A correction on a part of the finger, on the chart all around it."""
        whole = self.shape.chart
        beyond = np.maximum(np.abs(whole.angle_rad) - float(chart.angle_rad[-1]), 0.0) / np.deg2rad(30.0)
        return np.asarray(_sampled(chart, added, whole) * np.exp(-0.5 * beyond**2))


def _angles(reach_deg: float, radius_mm: float, pitch_mm: float) -> Array:
    """Angles to both sides of the front, `pitch_mm` apart at `radius_mm`."""
    low, high = np.deg2rad(-reach_deg), np.deg2rad(reach_deg)
    return np.linspace(low, high, max(2, int(np.ceil((high - low) * radius_mm / pitch_mm)) + 1))


def _lengths(base_mm: float, tip_mm: float, pitch_mm: float) -> Array:
    """Lengths from the tip to the base."""
    rows = max(2, int(np.ceil((tip_mm - base_mm) / pitch_mm)) + 1)
    return np.linspace(tip_mm, tip_mm - pitch_mm * (rows - 1), rows)


def _sampled(chart: Chart, radius_mm: Array, other: Chart) -> Array:
    """(n, m) a surface of one chart on the rays of another with the same axis; held beyond the first's ends."""
    spline = scipy.interpolate.RectBivariateSpline(-chart.length_mm, chart.angle_rad, radius_mm, kx=3, ky=3)
    low, high = chart.length_mm[-1], chart.length_mm[0]
    rows = -np.clip(other.length_mm, low, high)
    return np.asarray(spline(rows, np.clip(other.angle_rad, chart.angle_rad[0], chart.angle_rad[-1])))


def _radius_of(body: Body, chart: Chart) -> Array:
    """(n, m) distance of the body's skin along the rays of a chart."""
    start, directions = chart.rays()
    low = np.zeros(chart.shape)
    high = np.full(chart.shape, 1.5 * float(np.abs(body.coefficients[2:]).max()) + chart.cap_mm)
    for _ in range(24):
        middle = 0.5 * (low + high)
        out = _outside(body, start[:, None] + middle[..., None] * directions)
        high, low = np.where(out, middle, high), np.where(out, low, middle)
    return np.asarray(0.5 * (low + high))


def _outside(body: Body, points_mm: Array) -> BoolArray:
    """Whether points (..., 3) of the rig's frame lie outside a body; beyond its base its last section goes on."""
    t, u, z = body.to_frame(points_mm.reshape(-1, 3), place=True).T
    sections = body.sections(u)
    rise = z - sections.z
    across = (t - sections.t - sections.shear * rise) / np.maximum(sections.a, 1e-6)
    squared = np.minimum(across * across, 1.0)
    most = np.sqrt(1.0 - squared) * (1.0 + sections.squareness * squared)
    out = (np.abs(rise) > sections.b * most) | (np.abs(across) >= 1.0) | (u > body.tip_mm)
    return np.asarray(out.reshape(points_mm.shape[:-1]))


def _rolled_pad(body: Body, chart: Chart, radius_mm: Array) -> Array:
    """(n, m) to be added to the skin's distance where a finger is rolled: its flat pad is rolled, too.

    A body's sections shear when it rolls, but their flat side stays where it faces the camera. With squareness k and
    roll phi the pad of k sin^2(2 w) / 4 of the radius turns by phi, to first order -phi k sin(4 w) / 2: nothing at the
    outlines of front and sides, all of it between them.
    """
    expected = MirrorShapeSettings().squareness
    flat = 0.5 * (body.squareness + expected)  # the fit takes a rolled pad for a round one
    roll = float(np.clip(ROLL_OF_SHEAR * body.shear, -MAX_ROLL_RAD, MAX_ROLL_RAD))
    turned = np.where(np.abs(chart.angle_rad) < 0.5 * np.pi, np.sin(4.0 * chart.angle_rad), 0.0)
    return np.asarray(-0.5 * flat * roll * turned[None] * radius_mm)
