"""A camera's lines of sight against the smooth finger and its displaced skin."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Camera
from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_simulator.camera.lens import SightLines, sight_lines
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import SkinMap
from splitknit_simulator.surface import SimulatedSurface, Window

Triple = tuple[Array, Array, Array]


def rays_of(camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> SightLines:
    """The lines of sight of all pixels in these rows and columns, row by row."""
    lines = sight_lines(camera, columns[None, :], rows[:, None])
    return SightLines(*(part.ravel() for part in lines))


def _turned_to_view(normals: Array, rays: SightLines) -> Array:
    """Unit vectors (N, 3); those whose cosine with the direction to the viewer is below a
    thousandth are turned to it."""
    missing = np.maximum(1e-3 - rays.along(*normals.T) / rays.length, 0.0)
    turned = normals + missing[:, None] * rays.towards_camera
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


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


def _near(finger: PlacedFinger, camera: Camera, box: Window, top: float) -> BoolArray:
    """(h, w) pixels of the box near which rays meet the smooth finger below the height `top`."""
    step = max(1, int(0.4 * camera.px_per_mm))  # rays 0.4 mm apart
    rows, columns = (np.arange(part.start, part.stop + step, step) for part in box)
    _, hit = meet_body(finger.body, finger.placement, rays_of(camera, rows, columns), top)
    seen = hit.reshape(rows.size, columns.size).astype(np.uint8)
    wide = cv2.dilate(seen, np.ones((5, 5), np.uint8)) > 0
    fine = np.repeat(np.repeat(wide, step, axis=0), step, axis=1)
    return fine[: box[0].stop - box[0].start, : box[1].stop - box[1].start]


_SHAPES: tuple[tuple[int, ...], ...] = ((), (), (3,), (3,), (), (), (2,))
"""Shapes of the values that :func:`cast_rays` returns for a ray. Source: definition."""
_EMPTY = (np.nan, np.nan, 0.0, 0.0, 0.0, 1.0, np.nan)
"""The same values where a ray meets nothing. Source: definition."""


def surface_of(
    finger: PlacedFinger,
    camera: Camera,
    box: Window,
    heights: tuple[float, float | None],
    workers: int,
    *,
    reach_mm: float = np.inf,
) -> SimulatedSurface:
    """The first points of a placed finger on the rays of the rows and columns `box` of the camera's
    pixels, with its chart.

    `heights`: one above the finger, and one down to which rays that run along it are followed, see
    :func:`cast_rays`; `reach_mm`: of its skin from the first crease towards the palm. The result
    does not depend on `workers`, threads.
    """
    arrays = [
        np.full((*camera.image_size, *shape), empty, dtype=np.float32)
        for shape, empty in zip(_SHAPES, _EMPTY, strict=True)
    ]
    near = _near(finger, camera, box, heights[0])
    rows, columns = (np.arange(part.start, part.stop) for part in box)
    tall = 4 * max(4, 6000 // columns.size)  # about 24000 pixels fit the cache

    def fill(first: int) -> None:
        down, wanted = rows[first : first + tall], np.flatnonzero(near[first : first + tall])
        rays = rays_of(camera, down, columns).some(wanted)
        index, values = cast_rays(finger, rays, *heights)
        _, along, _ = finger.placement.to_finger(*rays.some(index).at(values[0]))
        bare = along > -reach_mm
        row, column = np.divmod(wanted[index[bare]], columns.size)
        for array, value in zip(arrays, values, strict=True):
            array[down[row], columns[column]] = value[bare]

    with ThreadPoolExecutor(max_workers=workers) as pool:
        list(pool.map(fill, range(0, rows.size, tall)))
    height, shape_height, normals, shape_normals, relief, pigment, chart = arrays
    return SimulatedSurface(
        camera, height, shape_height, normals, shape_normals, relief, np.isfinite(height), pigment,
        chart=chart,
    )  # fmt: skip


def finger_in_view(finger: PlacedFinger, camera: Camera, workers: int) -> SimulatedSurface:
    """The first points of a placed finger on the rays of all pixels; BadInput if the camera sees
    nothing of it."""
    rows, columns = camera.image_size
    box = slice(0, rows), slice(0, columns)
    top = above(finger.body, finger.placement)
    surface = surface_of(finger, camera, box, (top, None), workers)
    words = "the camera sees nothing of the finger; change the pose or the image size."
    require(surface.mask.any(), words)
    return surface


def cast_rays(
    finger: PlacedFinger, rays: SightLines, top: float, bottom: float | None
) -> tuple[NDArray[np.intp], tuple[Array | FloatArray, ...]]:
    """Which of the rays meet the skin, and for those height, shape height, normals, shape normals,
    relief (um), pigment and chart.

    The search goes down from the height `top`, which must lie above the finger. The placement
    may be left-handed: a finger behind a mirror. Rays that run along the finger, where it is not
    convex, are followed down to `bottom` where it is given.
    """
    body, placement = finger.body, finger.placement
    z_shape, hit = meet_body(body, placement, rays, top)
    if bottom is not None and not hit.all():
        _meet_along(body, placement, rays, (top, bottom), (z_shape, hit))
    hit &= body.encloses(*placement.to_finger(*rays.at(z_shape)))
    index = np.nonzero(hit)[0]
    rays, z_shape = rays.some(index), z_shape[index]
    _, gx, gy, gz = body.value_and_gradient(*placement.to_finger(*rays.at(z_shape)))
    shape_normals = placement.normal_to_camera(gx, gy, gz)
    z, valid = _meet_skin(finger, rays, z_shape, rays.along(*shape_normals.T))
    index, rays, z = index[valid], rays.some(valid), z[valid]
    normals, relief, u, v = _skin_normals(finger, rays.at(z))
    # a few rays only touch a ridge: no visible skin faces away
    normals = _turned_to_view(normals, rays)
    return index, (
        z, z_shape[valid], normals, shape_normals[valid], 1e3 * relief,
        finger.skin.pigment_at(u, v), np.stack([u, v], -1),
    )  # fmt: skip


def above(body: FingerBody, placement: Placement) -> float:
    """A height over every point of the finger."""
    return float(placement.shift[2]) + 0.62 * body.shape.thickness_mm + 2.0


def meet_body(
    body: FingerBody, placement: Placement, rays: SightLines, top: float
) -> tuple[Array, BoolArray]:
    """Newton from the height `top`: heights of the front intersection with a body that is convex
    along every ray."""
    z = np.full(rays.x.size, top)
    settled = np.zeros(z.shape, dtype=np.bool_)
    active = np.arange(z.size)
    for _ in range(24):
        here = rays.some(active)
        value, *gradient = body.value_and_gradient(*placement.to_finger(*here.at(z[active])))
        slope = here.along(*np.tensordot(placement.rotation, gradient, 1))
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
    rays: SightLines,
    heights: tuple[float, float],
    hits: tuple[Array, BoolArray],
) -> None:
    """Follow the rays that Newton's steps lost, in small steps; heights and hits of `found` are
    changed in place."""
    (top, bottom), (z, settled) = heights, hits
    which = np.nonzero(~settled)[0]
    here = np.full(which.size, top)
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
    finger: PlacedFinger, rays: SightLines, z0: Array, facing: Array
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
    length = rays.length
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
    body: FingerBody, placement: Placement, rays: SightLines, z0: Array, facing: Array
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
