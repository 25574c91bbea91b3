"""Rays of an orthographic camera against the smooth finger and its displaced skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.simulate.finger_shape import FingerBody
from splitknit.simulate.skin_map import SkinMap
from splitknit.types import Camera

Array = NDArray[np.float64]
Triple = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where the finger's frame lies in the camera's: camera = rotation @ finger + shift."""

    rotation: Array
    """(3, 3)."""
    shift: Array
    """(3,) mm."""

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


def hits(body: FingerBody, placement: Placement, camera: Camera) -> tuple[slice, slice]:
    """Rows and columns of the image that can show the finger."""
    rows, columns = camera.image_size
    step = max(1, int(0.4 * camera.px_per_mm))
    some_rows, some_columns = np.arange(0, rows + step, step), np.arange(0, columns + step, step)
    x, y = _pixel_grid(camera, some_rows, some_columns)
    _, hit = _meet_body(body, placement, x.ravel(), y.ravel())
    seen = hit.reshape(x.shape)
    require(bool(seen.any()), "the camera sees nothing of the finger; change the pose or the image size.")
    margin = 2 * step
    first_row, last_row = some_rows[seen.any(axis=1)][[0, -1]]
    first_column, last_column = some_columns[seen.any(axis=0)][[0, -1]]
    return (
        slice(max(0, int(first_row) - margin), min(rows, int(last_row) + margin)),
        slice(max(0, int(first_column) - margin), min(columns, int(last_column) + margin)),
    )


def cast_rows(
    body: FingerBody, skin: SkinMap, placement: Placement, camera: Camera, rows: slice, columns: slice
) -> tuple[NDArray[np.float32], ...]:
    """Height, shape height, normals, shape normals, relief (um), pigment and chart of a block of pixels."""
    x, y = _pixel_grid(camera, np.arange(rows.start, rows.stop), np.arange(columns.start, columns.stop))
    block = x.shape
    z_shape, hit = _meet_body(body, placement, x.ravel(), y.ravel())
    index = np.nonzero(hit)[0]
    x, y, z_shape = x.ravel()[index], y.ravel()[index], z_shape[index]
    _, gx, gy, gz = body.value_and_gradient(*placement.to_finger(x, y, z_shape))
    shape_normals = placement.normal_to_camera(gx, gy, gz)
    z, valid = _meet_skin(body, skin, placement, (x, y, z_shape), shape_normals[:, 2])
    index, x, y, z, z_shape, shape_normals = (part[valid] for part in (index, x, y, z, z_shape, shape_normals))
    normals, relief, u, v = _skin_normals(body, skin, placement, (x, y, z))

    def spread(values: Array | NDArray[np.float32], empty: float) -> NDArray[np.float32]:
        full = np.full((block[0] * block[1], *values.shape[1:]), empty, dtype=np.float32)
        full[index] = values
        return full.reshape(*block, *values.shape[1:])

    return (
        spread(z, np.nan), spread(z_shape, np.nan), spread(normals, 0.0), spread(shape_normals, 0.0),
        spread(1e3 * relief, 0.0), spread(skin.pigment_at(u, v), 1.0), spread(np.stack([u, v], -1), np.nan),
    )  # fmt: skip


def _pixel_grid(camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> tuple[Array, Array]:
    x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
    y = ((camera.image_size[0] - 1) / 2 - rows) / camera.px_per_mm
    grid_x, grid_y = np.meshgrid(x, y)
    return grid_x, grid_y


def _meet_body(body: FingerBody, placement: Placement, x: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Newton from above: the front intersection with a body that is convex along every ray."""
    ray = placement.rotation[2]
    z = np.full(x.shape, placement.shift[2] + 0.62 * body.shape.thickness_mm + 2.0)
    settled = np.zeros(x.shape, dtype=np.bool_)
    active = np.arange(x.size)
    for _ in range(24):
        value, gx, gy, gz = body.value_and_gradient(*placement.to_finger(x[active], y[active], z[active]))
        slope = gx * ray[0] + gy * ray[1] + gz * ray[2]
        step = value / np.maximum(slope, 1e-12)
        z[active] -= np.where(slope > 0, step, 0.0)
        done = (np.abs(step) < 1e-8) & (slope > 0)
        settled[active[done]] = True
        active = active[~done & (slope > 1e-4) & (np.abs(step) < 50.0)]
        if active.size == 0:
            break
    return z, settled


def _meet_skin(
    body: FingerBody, skin: SkinMap, placement: Placement, start: Triple, facing: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Go down every ray from the smooth skin to the displaced one.

    Careful steps that cannot pass the first intersection (the displacement's slope is bounded), then secants.
    """
    x, y, z0 = start

    def gap(which: NDArray[np.intp], z: Array) -> Array:
        distance, u, v = body.distance_and_chart(*placement.to_finger(x[which], y[which], z))
        return distance - skin.displacement(u, v)

    everything = np.arange(x.size)
    z = z0.copy()
    value = gap(everything, z)
    steep = np.nonzero(facing < 0.75)[0]
    bound = facing[steep] + 0.9 * np.sqrt(1.0 - np.minimum(facing[steep], 1.0) ** 2)
    for _ in range(5):
        z[steep] -= value[steep] / bound
        value[steep] = gap(steep, z[steep])
    before, value_before = z, value
    z = z - value / np.maximum(facing, 0.05)
    active = everything
    z_now, previous, previous_value = z, before, value_before
    final = z.copy()
    valid = np.zeros(x.size, dtype=np.bool_)
    for _ in range(10):
        now = gap(active, z_now)
        done = np.abs(now) < 2e-6
        final[active] = z_now
        valid[active[done]] = True
        slope = (now - previous_value) / np.where(z_now == previous, 1.0, z_now - previous)
        least = 0.25 * np.maximum(facing[active], 0.02)
        step = np.clip(now / np.maximum(slope, least), -0.1, 0.1)
        keep = ~done
        previous, previous_value = z_now[keep], now[keep]
        z_now = z_now[keep] - step[keep]
        active = active[keep]
        if active.size == 0:
            break
    return final, valid


def _skin_normals(
    body: FingerBody, skin: SkinMap, placement: Placement, points: Triple
) -> tuple[Array, Array, Array, Array]:
    """Unit normals (N, 3) in the camera's frame, displacement (mm) and chart at points of the displaced skin."""
    x, y, z = placement.to_finger(*points)
    distance, u, v = body.distance_and_chart(x, y, z)
    relief = skin.displacement(u, v)
    along_u, along_v = skin.displacement_gradient(u, v, relief)
    gradient = []
    step = 1e-4
    for dx, dy, dz in ((step, 0.0, 0.0), (0.0, step, 0.0), (0.0, 0.0, step)):
        there, there_u, there_v = body.distance_and_chart(x + dx, y + dy, z + dz)
        gradient.append(((there - distance) - along_u * (there_u - u) - along_v * (there_v - v)) / step)
    return placement.normal_to_camera(gradient[0], gradient[1], gradient[2]), relief, u, v
