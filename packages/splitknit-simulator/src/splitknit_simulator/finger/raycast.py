"""A camera's lines of sight against the smooth finger and its displaced skin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from splitknit import Camera
from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit_simulator.camera.lens import slopes_of_pixels
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import SkinMap
from splitknit_simulator.surface import Array, SimulatedSurface

Triple = tuple[Array, Array, Array]


# Lines of sight: parallel ones of an orthographic camera, spreading ones of a perspective camera.


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Lines of sight, parametrised by their height: at z a ray passes (x - z slope_x, y - z
    slope_y, z), in mm."""

    x: Array  # (N,) where they meet the finger plane
    y: Array
    # (N,) each: how far they move along x and y per mm downwards; None: they are parallel to z
    slopes: tuple[Array, Array] | None = None

    def some(self, which: NDArray[np.intp] | BoolArray) -> _Rays:
        """The rays with these indices."""
        slopes = None if self.slopes is None else (self.slopes[0][which], self.slopes[1][which])
        return _Rays(self.x[which], self.y[which], slopes)

    def at(self, z: Array) -> Triple:
        """(N,) x, y and z of the points at heights `z`."""
        if self.slopes is None:
            return self.x, self.y, z
        return self.x - self.slopes[0] * z, self.y - self.slopes[1] * z, z

    def rise(self, rotation: Array, gx: Array, gy: Array, gz: Array) -> Array:
        """(N,) change of a function per mm of height along the rays, from its gradient in the
        finger's frame."""
        up = gx * rotation[2, 0] + gy * rotation[2, 1] + gz * rotation[2, 2]
        if self.slopes is None:
            return np.asarray(up)
        along_x, along_y = (gx * r[0] + gy * r[1] + gz * r[2] for r in rotation[:2])
        return np.asarray(up - self.slopes[0] * along_x - self.slopes[1] * along_y)

    def along(self, vectors: Array) -> Array:
        """(N,) change per mm of height along the rays, from the gradient (N, 3) in the camera's
        frame."""
        if self.slopes is None:
            return vectors[:, 2]
        return vectors[:, 2] - self.slopes[0] * vectors[:, 0] - self.slopes[1] * vectors[:, 1]

    def length(self) -> Array | float:
        """(N,) mm of the rays per mm of height."""
        return (
            1.0 if self.slopes is None else np.sqrt(1.0 + self.slopes[0] ** 2 + self.slopes[1] ** 2)
        )

    def turn_to_view(self, normals: Array, least: float = 1e-3) -> None:
        """Turn unit vectors (N, 3) whose cosine with the direction to the viewer is below `least`,
        in place."""
        cosine = self.along(normals) / self.length()
        away = cosine < least
        if self.slopes is None:
            normals[away, 2] = least
        else:
            view = np.stack(
                [-self.slopes[0][away], -self.slopes[1][away], np.ones(np.count_nonzero(away))],
                axis=1,
            )
            view /= np.linalg.norm(view, axis=1, keepdims=True)
            normals[away] += (least - cosine[away])[:, None] * view
        normals[away] /= np.sqrt((normals[away] ** 2).sum(axis=1, keepdims=True))


def rays_of(camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> _Rays:
    """The rays of all pixels in these rows and columns, row by row."""
    if camera.model == "perspective":
        across, up = slopes_of_pixels(camera, columns[None, :], rows[:, None])
        across, up = across.ravel(), up.ravel()
        return _Rays(across * camera.height_mm, up * camera.height_mm, (across, up))
    x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
    y = ((camera.image_size[0] - 1) / 2 - rows) / camera.px_per_mm
    grid_x, grid_y = np.meshgrid(x, y)
    return _Rays(grid_x.ravel(), grid_y.ravel())


Gap = Callable[[NDArray[np.intp], Array], Array]
"""Gap of the rays with the given indices at the given depths; positive outside."""


def _first_root(gap: Gap, start: Array, bound: Array, *, careful: int) -> tuple[Array, BoolArray]:
    """Find where `gap` (positive at `start`) first falls to zero with growing depth.

    `careful` steps of gap / bound come first, then secants, never shorter than a growing
    micrometre, so that a ridge that is only touched is passed. Once the sign has changed: regula
    falsi and, every third time, bisection. `gap`: function to search, for (N,) rays; `start`: (N,)
    depths outside; `bound`: (N,) how fast the gap can fall, per depth. Returns (N,) depths, and
    where a root was found.
    """
    result, met = start.copy(), np.zeros(start.size, dtype=np.bool_)
    active = np.arange(start.size)
    nowhere = np.full(start.size, np.nan)
    state = np.stack([start, gap(active, start), nowhere, nowhere, bound, bound])
    for k in range(64):
        outer, outer_gap, inner, inner_gap, slope, limit = state
        bracketed = np.isfinite(inner)
        inside = (
            0.5 * (inner - outer)
            if k % 3 == 2
            else (inner - outer) * outer_gap / (outer_gap - inner_gap)
        )
        trial = outer + np.where(
            bracketed, inside, np.clip(outer_gap / slope, np.minimum(1e-3 * 1.15**k, 0.3), 0.3)
        )
        now = gap(active, trial)
        done = np.abs(now) < 1e-6
        result[active[done]], met[active[done]] = trial[done], True
        outside = now > 0
        fall = (outer_gap - now) / np.maximum(trial - outer, 1e-12)
        slope = np.where(outside & (k >= careful), np.clip(fall, 0.3 * limit, limit), limit)
        state = np.stack(
            [
                np.where(outside, trial, outer), np.where(outside, now, outer_gap),
                np.where(outside, inner, trial), np.where(outside, inner_gap, now),
                slope, limit,
            ]
        )  # fmt: skip
        keep = ~done & (np.abs(trial) < 4.0)
        active, state = active[keep], state[:, keep]
        if active.size == 0:
            break
    return result, met


def _polish(gap: Gap, depth: Array, facing: Array, met: BoolArray) -> tuple[Array, BoolArray]:
    """Refine roots by up to three secants on `gap`; returns (N,) depths and where they settled.
    `facing`: (N,) typical slope of the gap, for the first step; `met`: (N,) which entries of
    `depth` to refine.
    """
    result, close = depth.copy(), np.zeros(depth.size, dtype=np.bool_)
    active = np.nonzero(met)[0]
    state = np.stack([depth[active], gap(active, depth[active]), np.maximum(facing[active], 0.05)])
    for _ in range(4):
        before, before_gap, slope = state
        done = np.abs(before_gap) < 2e-6
        result[active[done]], close[active[done]] = before[done], True
        active, state = active[~done], state[:, ~done]
        if active.size == 0:
            break
        before, before_gap, slope = state
        trial = before + np.clip(before_gap / slope, -0.05, 0.05)
        now = gap(active, trial)
        fall = (before_gap - now) / np.where(trial == before, 1.0, trial - before)
        state = np.stack([trial, now, np.where(fall > 0.05 * slope, fall, slope)])
    return result, close


_NOTHING_SEEN = "the camera sees nothing of the finger; change the pose or the image size."


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where the finger's frame lies in the camera's: camera = rotation @ finger + shift."""

    rotation: Array  # (3, 3)
    shift: Array  # (3,) mm

    def to_finger(self, x: Array, y: Array, z: Array) -> Triple:
        """Camera coordinates to the finger's frame."""
        r, dx, dy, dz = self.rotation, x - self.shift[0], y - self.shift[1], z - self.shift[2]
        return (
            r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz,
            r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz,
            r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz,
        )

    def normal_to_camera(self, x: Array, y: Array, z: Array) -> Array:
        """Gradient in the finger's frame to a unit normal (N, 3) in the camera's."""
        scale = 1.0 / np.sqrt(x * x + y * y + z * z)
        r = self.rotation
        return np.stack([(r[i, 0] * x + r[i, 1] * y + r[i, 2] * z) * scale for i in range(3)], -1)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFinger:
    """A finger's smooth body, the skin that it wears, and where it lies."""

    body: FingerBody
    skin: SkinMap
    placement: Placement


class CoarseHits(NamedTuple):
    """Where the finger is seen on a coarse grid of pixels."""

    step: int
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    seen: BoolArray  # (rows, columns)


def coarse_hits(
    body: FingerBody, placement: Placement, camera: Camera, box: tuple[slice, slice], top: float
) -> CoarseHits:
    """Where rays of the rows and columns `box`, 0.4 mm apart, meet the smooth finger below the
    height `top`."""
    step = max(1, int(0.4 * camera.px_per_mm))
    rows, columns = (np.arange(part.start, part.stop + step, step) for part in box)
    rays = rays_of(camera, rows, columns)
    _, hit = meet_body(body, placement, rays, np.full(rays.x.size, top))
    return CoarseHits(step, rows, columns, hit.reshape(rows.size, columns.size))


def _hits(body: FingerBody, placement: Placement, camera: Camera) -> tuple[slice, slice]:
    """Rows and columns of the image that can show the finger."""
    rows, columns = (slice(0, length) for length in camera.image_size)
    hits = coarse_hits(body, placement, camera, (rows, columns), above(body, placement))
    require(bool(hits.seen.any()), _NOTHING_SEEN)
    parts = []
    for places, seen, length in zip(
        hits[1:3], (hits.seen.any(axis=1), hits.seen.any(axis=0)), camera.image_size, strict=True
    ):
        first, last = places[seen][[0, -1]]
        parts.append(
            slice(max(0, int(first) - 2 * hits.step), min(length, int(last) + 2 * hits.step))
        )
    return parts[0], parts[1]


_SHAPES: tuple[tuple[int, ...], ...] = ((), (), (3,), (3,), (), (), (2,), (), ())
"""Shapes of the values that :func:`cast_rays` returns for a ray. Source: definition."""
_EMPTY = (np.nan, np.nan, 0.0, 0.0, 0.0, 1.0, np.nan, np.nan, np.nan)
"""The same values where a ray meets nothing. Source: definition."""
Cast = Callable[[NDArray[np.intp]], tuple[NDArray[np.intp], Sequence[Array | FloatArray]]]


def fill_surface(
    camera: Camera, box: tuple[slice, slice], cast: Cast, workers: int
) -> SimulatedSurface:
    """Show what the rays of the rows and columns `box` of the camera's pixels meet, with its chart.

    `cast` takes rows; it gives the places, among their pixels of the box, whose rays meet skin, and
    for those what :func:`cast_rays` returns. The result does not depend on `workers`, threads.
    """
    kinds = list(zip(_SHAPES, _EMPTY, strict=True))[: 9 if camera.model == "perspective" else 7]
    arrays = [
        np.full((*camera.image_size, *shape), empty, dtype=np.float32) for shape, empty in kinds
    ]
    across = _range(box[1])
    tall = 4 * max(4, 6000 // across.size)  # about 24000 pixels fit the cache

    def fill(first: int) -> None:
        down = np.arange(first, min(first + tall, box[0].stop))
        place, values = cast(down)
        if place.size:
            for array, value in zip(arrays, values, strict=True):
                array[down[place // across.size], across[place % across.size]] = value

    with ThreadPoolExecutor(max_workers=max(workers, 1)) as pool:
        list(pool.map(fill, range(box[0].start, box[0].stop, tall)))
    height, shape_height, normals, shape_normals, relief, pigment, chart, *places = arrays
    x_mm, y_mm = places or (None, None)
    return SimulatedSurface(
        camera, height, shape_height, normals, shape_normals, relief, np.isfinite(height), pigment,
        x_mm=x_mm, y_mm=y_mm, chart=chart,
    )  # fmt: skip


def finger_in_view(finger: PlacedFinger, camera: Camera, workers: int) -> SimulatedSurface:
    """The first points of a placed finger on the rays of all pixels; BadInput if the camera sees
    nothing of it."""
    body, placement = finger.body, finger.placement
    box = _hits(body, placement, camera)

    def cast(down: NDArray[np.intp]) -> tuple[NDArray[np.intp], Sequence[Array | FloatArray]]:
        rays = rays_of(camera, down, _range(box[1]))
        part = slice(int(down[0]), int(down[-1]) + 1)
        return cast_rays(finger, rays, _first_guess(body, placement, camera, (part, box[1])))

    surface = fill_surface(camera, box, cast, workers)
    require(bool(surface.mask.any()), _NOTHING_SEEN)
    return surface


def cast_rays(
    finger: PlacedFinger, rays: _Rays, start: Array, *, bottom: float | None = None
) -> tuple[NDArray[np.intp], tuple[Array | FloatArray, ...]]:
    """Which of the rays meet the skin, and for those height, shape height, normals, shape normals,
    relief (um), pigment and chart; of a perspective camera also x and y of the skin (mm), which do
    not follow from the grid.

    The search goes down from the heights `start`, which must lie above the finger. The placement
    may be left-handed: a finger behind a mirror. Rays that run along the finger, where it is not
    convex, are followed down to `bottom` where it is given.
    """
    body, placement = finger.body, finger.placement
    z_shape, hit = meet_body(body, placement, rays, start)
    if bottom is not None and not hit.all():
        _meet_along(body, placement, rays, (start, bottom), (z_shape, hit))
    hit &= body.encloses(*placement.to_finger(*rays.at(z_shape)))
    index = np.nonzero(hit)[0]
    rays, z_shape = rays.some(index), z_shape[index]
    _, gx, gy, gz = body.value_and_gradient(*placement.to_finger(*rays.at(z_shape)))
    shape_normals = placement.normal_to_camera(gx, gy, gz)
    z, valid = _meet_skin(finger, rays, z_shape, rays.along(shape_normals))
    index, rays, z = index[valid], rays.some(valid), z[valid]
    x, y, z = rays.at(z)
    normals, relief, u, v = _skin_normals(finger, (x, y, z))
    rays.turn_to_view(normals)  # a few rays that only touch a ridge: no visible skin faces away
    places = () if rays.slopes is None else (x, y)
    return index, (
        z, z_shape[valid], normals, shape_normals[valid], 1e3 * relief,
        finger.skin.pigment_at(u, v), np.stack([u, v], -1), *places,
    )  # fmt: skip


def _range(part: slice) -> NDArray[np.intp]:
    return np.arange(part.start, part.stop)


def above(body: FingerBody, placement: Placement) -> float:
    """A height over every point of the finger."""
    return float(placement.shift[2]) + 0.62 * body.shape.thickness_mm + 2.0


def _first_guess(
    body: FingerBody, placement: Placement, camera: Camera, block: tuple[slice, slice]
) -> Array:
    """Heights to start from, (N,): the body met on every fourth pixel, interpolated; from above
    near the outline."""
    step = 4
    rows, columns = _range(block[0]), _range(block[1])
    some_rows = np.arange(rows[0], rows[-1] + step + 1, step)
    some_columns = np.arange(columns[0], columns[-1] + step + 1, step)
    rays = rays_of(camera, some_rows, some_columns)
    high = above(body, placement)
    z, hit = meet_body(body, placement, rays, np.full(rays.x.size, high))
    z = np.where(hit, z, np.nan).reshape(some_rows.size, some_columns.size)
    i, fi = np.divmod(rows - rows[0], step)
    j, fj = np.divmod(columns - columns[0], step)
    down, right = (fi / step)[:, None], (fj / step)[None, :]
    corners = [z[np.ix_(i + di, j + dj)] for di in (0, 1) for dj in (0, 1)]
    guess = (1 - down) * ((1 - right) * corners[0] + right * corners[1])
    guess += down * ((1 - right) * corners[2] + right * corners[3])
    rough = ~(np.ptp(np.stack(corners), axis=0) < 4.0 * step / camera.px_per_mm)
    guess[rough] = high
    return np.asarray(guess.ravel(), dtype=np.float64)


def meet_body(
    body: FingerBody, placement: Placement, rays: _Rays, start: Array
) -> tuple[Array, BoolArray]:
    """Newton from above: heights of the front intersection with a body that is convex along every
    ray."""
    z = start.copy()
    settled = np.zeros(z.shape, dtype=np.bool_)
    active = np.arange(z.size)
    for _ in range(24):
        here = rays.some(active)
        value, *gradient = body.value_and_gradient(*placement.to_finger(*here.at(z[active])))
        slope = here.rise(placement.rotation, *gradient)
        step = value / np.maximum(slope, 1e-12)
        ahead = slope > 1e-4
        z[active] -= np.where(ahead, step, 0.0)
        done = (np.abs(step) < 2e-6) & ahead  # Newton: the step after this one is below a nanometre
        settled[active[done]] = True
        active = active[~done & ahead & (np.abs(step) < 50.0)]
        if active.size == 0:
            break
    return z, settled


def _meet_along(
    body: FingerBody,
    placement: Placement,
    rays: _Rays,
    heights: tuple[Array, float],
    hits: tuple[Array, BoolArray],
) -> None:
    """Follow the rays that Newton's steps lost, in small steps; heights and hits of `found` are
    changed in place."""
    (start, bottom), (z, settled) = heights, hits
    which = np.nonzero(~settled)[0]
    here = start[which].copy()
    while which.size:
        here = here - 0.5
        value, *_ = body.value_and_gradient(*placement.to_finger(*rays.some(which).at(here)))
        inside = value < 0
        if inside.any():
            entered = which[inside]
            low, high = here[inside], here[inside] + 0.5
            for _ in range(20):
                middle = 0.5 * (low + high)
                within = (
                    body.value_and_gradient(*placement.to_finger(*rays.some(entered).at(middle)))[0]
                    < 0
                )
                low, high = np.where(within, middle, low), np.where(within, high, middle)
            z[entered], settled[entered] = 0.5 * (low + high), True
        going = ~inside & (here > bottom)
        which, here = which[going], here[going]


def _meet_skin(
    finger: PlacedFinger, rays: _Rays, z0: Array, facing: Array
) -> tuple[Array, BoolArray]:
    """Go down every ray from the smooth skin to the displaced one: (N,) heights, and which rays met
    it.

    The search for the first intersection runs on a quadratic model of distance and chart along the
    ray; a last iteration uses the exact ones. Where the skin is steep, the first steps are too
    short to pass an intersection. `z0` are the heights of the smooth skin; `facing` is how fast the
    distance from it grows per mm of height.
    """
    body, skin, placement = finger.body, finger.skin, finger.placement
    model = _ray_model(body, placement, rays, z0, facing)
    length = rays.length()
    cosine = np.minimum(facing / length, 1.0)
    bound = np.where(cosine < 0.75, facing + 0.9 * length * np.sqrt(1.0 - cosine**2), facing)

    def along_model(which: NDArray[np.intp], depth: Array) -> Array:
        d, u, v = (c[0][which] + depth * (c[1][which] + depth * c[2][which]) for c in model)
        return d - skin.displacement(u, v)

    def exact(which: NDArray[np.intp], depth: Array) -> Array:
        d, u, v = body.distance_and_chart(
            *placement.to_finger(*rays.some(which).at(z0[which] - depth))
        )
        return d - skin.displacement(u, v)

    clearance = -0.008 / np.maximum(facing, 0.02)
    depth, met = _first_root(along_model, clearance, bound, careful=5)
    refined, close = _polish(exact, depth, facing, met)
    lost = np.nonzero(~close)[0]
    if lost.size:  # deep grooves and grazing rays, where the model is too coarse
        refined[lost], close[lost] = _first_root(
            lambda which, at: exact(lost[which], at), clearance[lost], bound[lost], careful=8
        )
    return z0 - refined, close


def _ray_model(
    body: FingerBody, placement: Placement, rays: _Rays, z0: Array, facing: Array
) -> list[tuple[Array, Array, Array]]:
    """Quadratics in the depth under the smooth skin for distance, u and v along every ray."""
    step = 0.05 / np.maximum(facing, 0.2)
    samples = [
        body.distance_and_chart(*placement.to_finger(*rays.at(z0 - k * step))) for k in range(3)
    ]
    model = []
    for first, second, third in zip(*samples, strict=True):
        curve = (0.5 * (third - 2.0 * second + first)) / (step * step)
        model.append((first, (second - first) / step - curve * step, curve))
    return model


def _skin_normals(finger: PlacedFinger, points: Triple) -> tuple[Array, Array, Array, Array]:
    """Unit normals (N, 3) in the camera's frame, displacement (mm) and chart at points of the
    displaced skin."""
    body, skin, placement = finger.body, finger.skin, finger.placement
    x, y, z = placement.to_finger(*points)
    distance, u, v = body.distance_and_chart(x, y, z)
    relief = skin.displacement(u, v)
    along_u, along_v = skin.displacement_gradient(u, v, relief)
    gradient = []
    step = 1e-4
    for dx, dy, dz in step * np.eye(3):
        there, there_u, there_v = body.distance_and_chart(x + dx, y + dy, z + dz)
        gradient.append(
            ((there - distance) - along_u * (there_u - u) - along_v * (there_v - v)) / step
        )
    return placement.normal_to_camera(*gradient), relief, u, v
