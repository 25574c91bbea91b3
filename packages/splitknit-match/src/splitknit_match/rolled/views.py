"""Views of a finger between mirrors: where each shows it, its lights, and its ridges.

In a mirror's view everything is reflected: the LEDs light the finger by way of their images, and
the light that came by way of the mirror seems to come from the LEDs themselves. So a ring of lights
stands around every line of sight. Ridges are found by photometric stereo on a surface that is known
but for them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from splitknit import Capture, Led, Rig
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.finger.locate import BEYOND_CREASE_MM, FingerSettings, enlarged_mask
from splitknit.finger.orientation import find_upright
from splitknit.finger.phalange import find_crease
from splitknit.finger.regions import largest_component
from splitknit.imaging.geometry import (
    bounding_box,
    enlarged,
    gradients_from_normals,
    height_gradients,
    normals_from_gradients,
    sampled_at,
)
from splitknit.imaging.pixels import Window, bin_mean, pick_channel
from splitknit.imaging.view import View, view_of
from splitknit.integration.shapelets import REFERENCE_PX_PER_MM, ShapeletSettings, shapelets
from splitknit.mirrors.body import Body
from splitknit.mirrors.captured import skin_slopes
from splitknit.mirrors.mirror import mirror_shape
from splitknit.mirrors.reflection import (
    Glass,
    facing_fraction,
    glass_in,
    led_image,
    mirrored_fraction,
    shade_of,
)
from splitknit.mirrors.views import view_binning, views_in
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.observe import Observation, observe
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.grid import BandImages, Grid, coarsen, refine, smooth_step
from splitknit.skin.images import (
    FACTOR,
    WORKING_PITCH_MM,
    MetricSettings,
    finer_grid,
    finer_images,
    shipped_networks,
)
from splitknit.skin.learned import can_learn, features, relief_by_network
from splitknit.skin.light import Lighting, fine_lighting, slant_of, trust_of
from splitknit.skin.shape import COARSE_PITCH_MM
from splitknit_match.rolled.chart import Chart, Sight, heights

SIDES = ("left", "right")
NO_MIRRORS = (
    "the capture has no mirrors beside the finger, so that it shows the finger from the front only;"
    " name them in its rig.json (docs/guide/mirrors.md), or print with `method` unroll."
)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorView:
    """What a capture with mirrors shows once."""

    name: str  # ``front``, ``left``, ``right`` or ``tip``
    # (H, W) where the view shows the finger; None for a mirror whose light alone counts
    mask: BoolArray | None
    glass: Glass | None = None  # the mirror; None for the front
    # whether the border of picture or mirror cuts the view, so that the mirror's pose is less sure
    cut: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class MirrorViews:
    """All views of a finger, and what their outlines determine."""

    views: tuple[MirrorView, ...]
    body: Body  # the smooth finger
    findings: tuple[Finding, ...] = ()  # what became of views that are not used, or not whole

    def __iter__(self) -> Iterator[MirrorView]:
        return iter(self.views)


def find_mirror_views(capture: Capture, settings: FingerSettings) -> MirrorViews:
    """Views of the finger in one picture, and mirrors where the views' outlines have them. Raises
    BadInput if there are no mirrors beside the finger, or fewer than two views can be used.
    """
    mirrors = {mirror.name: mirror for mirror in capture.rig.mirrors}
    require(any(name in SIDES for name in mirrors), NO_MIRRORS)
    require("white" in capture.bands, "the capture has no band 'white', in which ridges are seen.")
    observation = observe(capture).without_films()
    binning = view_binning(observation.rig.camera.px_per_mm)
    mean, grey = observation.white.at(binning).survey()
    views = views_in(mean, observation.rig, binning)
    visible = {name: views.mirrors[name] for name in SIDES if name in views.mirrors}
    require(
        visible,
        "only the front view of the finger can be used: no mirror beside it shows it; turn the"
        " mirrors towards the finger, or print with `method` unroll.",
    )
    shape = mirror_shape(
        replace(views, mirrors=visible),
        observation.rig,
        tip_direction_deg=observation.tip_direction_deg or 0.0,
        slopes_on=partial(skin_slopes, observation.white.rig, grey, views),
        cut_too=True,
    )
    used = shape.fit.poses
    cut = [name for name in shape.facts["views_cut_off"] if name in used]
    front = enlarged_mask(views.front, observation.shape, binning)
    if settings.cut_at_crease:
        front = _above_crease(front, views.front, mean, observation, binning)
    all_views = [MirrorView("front", front)]
    for name, glass in mirrors.items():
        mask = enlarged_mask(visible[name], observation.shape, binning) if name in used else None
        all_views.append(MirrorView(name, mask, glass_in(glass, shape.plane(glass)), name in cut))
    not_found = [n for n in SIDES if n in mirrors and n not in visible]
    light_only = [n for n in mirrors if n not in SIDES]
    findings = [
        *shape.findings,
        *_of_views(
            "view-cut-off",
            "the view in the {} mirror is cut off at the picture's border or the mirror's, "
            "so that its outline shows less of where the mirror lies: lay the finger in the "
            "middle, so that the mirror shows all of its pad.",
            cut,
        ),
        *_of_views(
            "view-left-out",
            "the view in the {} mirror is cut off so much that it is left out, and that side "
            "of the finger is missing from the print: lay the finger in the middle.",
            shape.facts["views_useless"],
        ),
        *_of_views(
            "no-finger-in-mirror",
            "no finger was found in the {} mirror, so that that side of it is missing from "
            "the print: check the mirror's pose in rig.json, and the light on that side.",
            not_found,
        ),
        *_of_views(
            "light-only-mirror",
            "the {} mirror gives light only: its view is not used for the print.",
            light_only,
        ),
    ]
    return MirrorViews(tuple(all_views), shape.fit.body, tuple(findings))


def _of_views(code: str, words: str, names: Iterable[str]) -> list[Finding]:
    return [Finding(code, words.format(name)) for name in names]


def _above_crease(
    mask: BoolArray, small: BoolArray, mean: FloatArray, observation: Observation, binning: int
) -> BoolArray:
    """The front's mask without what lies beyond the finger's first crease."""
    upright = find_upright(small, observation.tip_direction_deg or 0.0)
    px_per_mm = observation.rig.camera.px_per_mm / binning
    crease = find_crease(pick_channel(mean, "grey"), small, upright, px_per_mm)
    if not crease.detected:
        return mask
    across, along, offset = upright.upright_from_input[1]
    rows, columns = (
        (np.arange(side, dtype=np.float32) + 0.5) / binning - 0.5 for side in mask.shape
    )
    beyond = np.float32(crease.row + BEYOND_CREASE_MM * px_per_mm)
    return np.asarray(mask & (columns * across + rows[:, None] * along + offset < beyond))


def view_light(  # noqa: PLR0917
    rig: Rig,
    glasses: Sequence[Glass],
    sight: Sight,
    heights_mm: FloatArray,
    grid: Grid,
    origin_mm: Array,
) -> tuple[Rig, FloatArray]:
    """The lights as one view has them: in the frame of the view, its origin moved to that of the
    skin's grid. Light that meets two mirrors one after the other is left out. `rig`: `rig.leds[k]`
    lights image k; `glasses`: all mirrors; `heights_mm` (h, w) of the skin, in perspective along
    the rays, on the view's grid moved to `origin_mm` (3,).

    Returns the rig, and (L, h, w) zero where one of an exposure's lights begins or ends at a
    mirror's edge, one elsewhere: a line of light that is not known to a tenth of a millimetre would
    look like a ridge.
    """
    slopes = height_gradients(heights_mm, grid.pitch_mm)
    normals = sight.turned(
        np.asarray(grid.view.in_rig(normals_from_gradients(*slopes)), dtype=float)
    )
    points = sight.to_view(
        np.stack(grid.view.points(heights_mm), axis=-1).astype(float) + origin_mm
    )

    def in_view(led: Led, lit: FloatArray) -> Led:
        """A light of the rig's frame in the view's moved frame, with its shade."""
        led = led if sight.plane is None else led_image(led, sight.plane)
        if led.position_mm is not None:
            x, y, z = (np.asarray(led.position_mm) - origin_mm).tolist()
            right, up, out = np.asarray(led.axis).tolist()
            led = replace(led, position_mm=(x, y, z), aim=(right, up, out))
        return replace(led, shade=shade_of(lit, grid.view), reflected=True, also=())

    ring = "" if sight.plane is None else sight.name
    leds = []
    inner = []
    for exposure in rig.leds:
        around: list[Led] = []  # the ring around the line of sight, which stands for the exposure
        beside: list[Led] = []
        edges = [np.ones(grid.shape, dtype=np.float32)]
        for led in (replace(exposure, also=()), *exposure.also):
            light = in_view(led, facing_fraction(points, normals, led))
            (beside if ring else around).append(light)
            for glass in glasses:
                image = led_image(led, glass.plane, glass.reflectance)
                facing = facing_fraction(points, normals, image)
                through = mirrored_fraction(points, image, glass.plane, glass.corners_mm)
                (around if glass.name == ring else beside).append(in_view(image, facing * through))
                edges.append(_inner(facing, through, grid.pitch_mm))
        first, *rest = [replace(light, reflected=False) for light in around]
        leds.append(replace(first, also=(*rest, *beside)))
        inner.append(np.min(edges, axis=0))
    return replace(rig, leds=tuple(leds), mirrors=()), np.stack(inner)


_EDGE_BAND_MM = 0.3
"""So near to its edge a light counts for nothing; as far again it counts in part. Chosen on:
simulated fingers (11, 101, 102 and 201 to 204 between two mirrors)."""


def _inner(facing: FloatArray, through: FloatArray, pitch_mm: float) -> FloatArray:
    """(h, w) zero beside the line where the light by way of a mirror ends; `facing`, `through`:
    fractions (h, w) of it that the skin is not turned away from, and that come within the mirror's
    outline.
    """
    if float(np.ptp(through)) < 0.5:
        return np.ones(facing.shape, dtype=np.float32)
    lit = (through > 0.5).astype(np.uint8)
    edge = cv2.morphologyEx(lit, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) * (facing > 0.5)
    away = cv2.distanceTransform(1 - edge.astype(np.uint8), cv2.DIST_L2, 5) * pitch_mm
    return smooth_step((away - _EDGE_BAND_MM) / _EDGE_BAND_MM).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class ViewRelief:
    """Ridges in one view, on a window of the image's pixels (or blocks of them)."""

    window: Window
    binning: int
    relief_mm: FloatArray  # (h, w) along the skin's normal, NaN outside the finger
    deviation_mm: FloatArray  # (h, w) its standard deviation, NaN outside
    # (h, w) in [0, 1]: fades out towards grazing slopes and the outline, NaN outside
    trust: FloatArray
    how: str

    def sampled(self, sight: Sight, points_mm: Array) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Relief, deviation and trust (...) at points (..., 3) of the rig's frame; NaN where
        `sight` lacks them."""
        size = self.binning
        column, row = (
            ((place - side.start + 0.5) / size - 0.5).astype(np.float32)
            for place, side in zip(sight.pixels(points_mm), self.window[::-1], strict=True)
        )
        linear, deviation, trust = (
            sampled_at(field, column, row, outside=np.nan)
            for field in (self.relief_mm, self.deviation_mm, self.trust)
        )
        cubic = sampled_at(self.relief_mm, column, row, cv2.INTER_CUBIC, np.nan)
        return np.where(np.isfinite(cubic), cubic, linear), deviation, trust


def _grid_of(
    observation: Observation,
    sight: Sight,
    mask: BoolArray,
    chart: Chart,
    radius_mm: Array,
    *,
    view: View,
    binning: int,
) -> tuple[Grid, Array, float]:
    """The grid of a window's blocks, on the plane of the finger, or of its image in the mirror; its
    origin (3,) in the frame of the view; and the scale of that plane over the pixels'.
    """
    height, width = (n // binning for n in mask.shape)
    whole = mask[: height * binning, : width * binning].reshape(height, binning, width, binning)
    blocks = largest_component(np.asarray(whole.all(axis=(1, 3))))
    few = (slice(None, None, 4),) * view.x_mm.ndim
    coarse = heights(
        sight, chart, radius_mm, replace(view, x_mm=view.x_mm[few], y_mm=view.y_mm[few])
    )
    level = float(np.nanmean(coarse)) if np.isfinite(coarse).any() else 0.0
    origin = np.array([view.x_mm.mean(), view.y_mm.mean(), level])
    nearer = 1.0
    apex = None
    if view.apex_mm is not None:
        origin = np.array([0.0, 0.0, level])
        nearer = 1.0 - level / view.apex_mm
        apex = view.apex_mm - level
    cut = (
        bool(blocks[0].any()),
        bool(blocks[-1].any()),
        bool(blocks[:, 0].any()),
        bool(blocks[:, -1].any()),
    )
    pitch_mm = observation.rig.camera.pitch_mm * binning * nearer
    x = view.x_mm * nearer - origin[0]
    y = view.y_mm * nearer - origin[1]
    return Grid(blocks, x, y, pitch_mm, cut, apex), origin, nearer


_LIT = 0.5
"""Trust from which a light counts. Chosen on: simulated fingers (11, 101, 102 and 201 to 204
between two mirrors)."""
_FADE_LIT_MM = 0.2
"""Width over which skin with fewer lights fades out. Chosen on: simulated fingers (11, 101, 102 and
201 to 204 between two mirrors)."""
_UNKNOWN_MM = 0.02
"""Standard deviation of a relief that no network estimated. Chosen on: simulated fingers (11, 101,
102 and 201 to 204 between two mirrors)."""
_SLOPE_PRIOR = 0.5
"""Holds slopes which the lights hardly determine to those of the shape: variance of the images'
relative error over that of the slopes. Chosen on: simulated fingers (11, 101, 102 and 201 to 204
between two mirrors)."""


def view_relief(
    observation: Observation,
    sight: Sight,
    mask: BoolArray,
    chart: Chart,
    radius_mm: Array,
    *,
    glasses: Sequence[Glass],
    settings: MetricSettings,
) -> ViewRelief:
    """Ridges of the finger as one view shows them, where `mask` (H, W) holds it, in the white band.
    `glasses`: all mirrors of the rig; `chart`, `radius_mm`: the finger without its ridges.
    """
    white = observation.white
    camera = observation.rig.camera
    binning = max(1, round(WORKING_PITCH_MM / camera.pitch_mm))
    window = bounding_box(mask, round(0.5 * camera.px_per_mm))
    view = view_of(camera, *window, binning=binning)
    grid, origin, nearer = _grid_of(
        observation, sight, mask[window], chart, radius_mm, view=view, binning=binning
    )

    # the smooth finger as the view sees it, and its lights
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
    low = coarsen(grid, factor)
    on_plane = replace(
        view, x_mm=(low.x_mm + origin[0]) / nearer, y_mm=(low.y_mm + origin[1]) / nearer
    )
    height = low.view.along(heights(sight, chart, radius_mm, on_plane) - np.float32(origin[2]))
    known = low.mask & np.isfinite(height)
    low = replace(low, mask=known)
    height = np.where(known, height, 0).astype(np.float32)
    filled = refine(height, known, 1, low.shape)
    rig, inner = view_light(white.rig, glasses, sight, filled, low, origin)
    reach = np.kron(known, np.ones((factor, factor), dtype=bool))
    reach = np.pad(reach, [(0, n - m) for n, m in zip(grid.shape, reach.shape, strict=True)])
    grid = replace(grid, mask=grid.mask & reach)
    smooth = refine(height, known, factor, grid.shape)
    facing = np.cos(np.deg2rad(slant_of(smooth, grid.pitch_mm)))
    if grid.apex_mm is not None:  # from heights along the rays to millimetres
        facing *= np.exp(-smooth / np.float32(grid.apex_mm))

    # the photographs, on a finer grid where the network needs it
    images = BandImages(white.channels, white.at(binning, window).stack, rig)
    inside = grid.mask
    skin = observation.material == "skin"
    finer = settings.relief == "network" and skin
    finer = (
        finer and not can_learn(images, grid.pitch_mm) and can_learn(images, grid.pitch_mm / FACTOR)
    )
    if finer:
        grid = finer_grid(grid)
        images = finer_images(images)
        factor = factor * FACTOR
        smooth = refine(height, known, factor, grid.shape)
    light = fine_lighting(images.rig, low, filled, factor, grid)
    # zero where fewer than three exposures light the skin, which determine no slope
    enough = ((light.trust > _LIT).sum(axis=0) >= 3).astype(np.float32)
    lit = np.clip(
        2.0 * cv2.GaussianBlur(enough, (0, 0), _FADE_LIT_MM / grid.pitch_mm) - 1.0, 0.0, 1.0
    )
    within = np.stack([enlarged(each, factor, grid.shape) for each in inner])
    light = replace(light, trust=np.maximum(light.trust * within, 1e-3))

    networks = shipped_networks(settings) if skin and can_learn(images, grid.pitch_mm) else None
    if networks is None:
        trust = trust_of(slant_of(smooth, grid.pitch_mm), grid) * lit
        relief = _by_shapelets(images, grid, smooth, light, trust, skin=skin)
        fields = relief, np.full(grid.shape, _UNKNOWN_MM, dtype=np.float32), trust
    else:
        g = _held_normals(images.stack / light.entering, light, smooth, grid, _SLOPE_PRIOR)
        estimate = relief_by_network(
            features(images, grid, smooth, light, g), grid, smooth, networks.relief
        )
        fields = estimate.relief_mm, estimate.deviation_mm, estimate.trust * lit
    relief, deviation, trust = (bin_mean(field, FACTOR) if finer else field for field in fields)
    relief, deviation, trust = (
        np.where(inside, values, np.nan).astype(np.float32)
        for values in (relief * facing, deviation * facing, trust)
    )
    return ViewRelief(
        window, binning, relief, deviation, trust, "network" if networks else "shapelets"
    )


_SHAPELET_SCALES = 4
"""Scales of the shapelets where no network estimates the relief. Chosen on: simulated fingers (11,
101, 102 and 201 to 204 between two mirrors)."""


def _by_shapelets(
    images: BandImages,
    grid: Grid,
    smooth: FloatArray,
    light: Lighting,
    trust: FloatArray,
    *,
    skin: bool,
) -> FloatArray:
    """Relief along the line of sight without a network."""
    entering = light.entering if skin else None
    stack = images.stack.mean(axis=0)
    g = pseudo_normals(
        stack, images.rig, smooth, grid.mask, light.trust, view=grid.view, entering=entering
    )
    normals = g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9)
    slopes = gradients_from_normals(normals, grid.mask, 6.0)  # steeper slopes are shortened to this
    shape = height_gradients(smooth, grid.pitch_mm)
    beyond = [(slope - base) * trust for slope, base in zip(slopes, shape, strict=True)]
    evened = [(b - grid.smooth(b, grid.mask, 0.3)).astype(np.float32) for b in beyond]
    bank = ShapeletSettings(scales=_SHAPELET_SCALES)
    bank = replace(bank, sigma_px=bank.sigma_px / (REFERENCE_PX_PER_MM * grid.pitch_mm))
    relief = np.nan_to_num(shapelets(evened[0], evened[1], grid.mask, bank), nan=0.0)
    return relief * np.float32(grid.pitch_mm) * trust


# Photometric stereo where two lights of one exposure nearly cancel: slopes that the lights hardly
# determine stay near the shape's.


def _held_normals(
    stack: FloatArray, light: Lighting, smooth_mm: FloatArray, grid: Grid, prior: float
) -> FloatArray:
    """(C, h, w, 3) brightness times normal: least squares over the lights, slopes held near the
    shape's.

    An LED and its image in a mirror give little of the slope towards the mirror. Minimises sum_k
    w_k (I_k - L_k g)^2 + prior mean(w) |t|^2, t the part of g across the shape's normal. `stack`:
    (C, L, h, w) images over the light that enters; `prior`: variance of the images' relative error
    over that of the slopes.
    """
    channels, count = stack.shape[:2]
    slopes = (grid.smooth(s, grid.mask, 0.3) for s in height_gradients(smooth_mm, grid.pitch_mm))
    normals = np.moveaxis(normals_from_gradients(*slopes), -1, 0)  # (3, h, w)
    weights = light.trust * light.entering * light.entering
    here = grid.mask
    v = light.vectors[:, :, here].astype(float)  # (L, 3, n)
    w = weights[:, here].astype(float)
    n = normals[:, here].astype(float)  # (3, n)
    across = np.eye(3)[:, :, None] - n[:, None] * n[None]
    hold = prior * np.maximum(w.sum(axis=0), 1e-3) / count
    matrix = (
        np.einsum("ln,lin,ljn->nij", w, v, v) + np.moveaxis(hold * across, -1, 0) + 1e-6 * np.eye(3)
    )
    right = np.einsum("ln,cln,lin->nic", w, stack[:, :, here].astype(float), v)
    result = np.zeros((channels, *grid.shape, 3), dtype=np.float32)
    result[:, here] = np.moveaxis(np.linalg.solve(matrix, right), 2, 0)
    return result
