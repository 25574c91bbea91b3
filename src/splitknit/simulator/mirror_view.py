"""What a camera sees in a mirror: the surface of the reflected finger."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, Camera, FloatArray, Mirror
from splitknit.simulator.finger_shape import FingerBody
from splitknit.simulator.lens import pixels_of_points
from splitknit.simulator.mirrors import Reflection
from splitknit.simulator.raycast import EMPTY, Placement, cast_rays, meets
from splitknit.simulator.rays import rays_of
from splitknit.simulator.skin_map import SkinMap
from splitknit.simulator.surface import Surface

Array = NDArray[np.float64]

BEYOND_MM = 3.0
"""How far beyond a mirror's outline the reflected skin is followed: light diffuses across the outline."""
PROXIMAL_MM = 32.0
"""What lies further than this from the first crease towards the palm is not shown: the hand's sleeve is there."""
_FINE = 8


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How much of each pixel something flat covers."""

    window: tuple[slice, slice]
    """Rows and columns of the frame; empty where it lies outside."""
    share: FloatArray
    """(h, w) inside the window, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One mirror and what the camera sees in it."""

    mirror: Mirror
    """As it truly is."""
    reflection: Reflection
    surface: Surface
    """The reflected finger, also a little beyond the outline; in the rig's frame, as though there were no mirror."""
    coverage: Coverage
    """The face in the picture."""

    @property
    def mask(self) -> BoolArray:
        """(H, W) pixels of the mirror's face that show the finger, if nothing stands before the mirror."""
        mask = np.zeros_like(self.surface.mask)
        window = self.coverage.window
        mask[window] = self.surface.mask[window] & (self.coverage.share >= 0.5)
        return mask


def mirror_view(
    body: FingerBody, skin: SkinMap, placement: Placement, camera: Camera, mirror: Mirror, *, workers: int = 2
) -> View:
    """Show the finger's reflection to a camera.

    Parameters
    ----------
    body, skin, placement : of the finger itself
    camera : of the rig
    mirror : as it truly is
    workers : threads; the result does not depend on them

    Raises
    ------
    BadInput
        If the mirror lies outside the picture, or no part of the finger is seen in it.
    """
    reflection = Reflection.of(mirror)
    behind = reflection.placement(placement)
    coverage = outline_coverage(camera, np.asarray(mirror.corners_mm))
    require(
        bool((coverage.share >= 0.5).any()),
        f"the {mirror.name} mirror lies outside the picture; lower px_per_mm or make image_size larger.",
    )
    margin = int(np.ceil(BEYOND_MM * camera.px_per_mm))
    box = _widened(coverage.window, margin, camera.image_size)
    surface = _surface(body, skin, behind, (camera, box), workers)
    view = View(mirror, reflection, surface, coverage)
    require(
        bool(view.mask.any()), f"the {mirror.name} mirror shows nothing of the finger; move the finger or the mirror."
    )
    return view


def outline_coverage(camera: Camera, corners: Array) -> Coverage:
    """Where an outline (N, 3) appears, its edges as the lens bends them."""
    share = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None]
    edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    x, y, z = np.concatenate(edges).T
    column, row = pixels_of_points(camera, x, y, z)
    rows, columns = camera.image_size
    first = np.clip(np.floor([column.min() - 1, row.min() - 1]), 0, [columns, rows]).astype(int)
    last = np.clip(np.ceil([column.max() + 2, row.max() + 2]), first, [columns, rows]).astype(int)
    window = slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))
    width, height = (int(size) for size in last - first)
    if width == 0 or height == 0:
        return Coverage(window, np.zeros((height, width), dtype=np.float32))
    fine = np.zeros((height * _FINE, width * _FINE), dtype=np.uint8)
    # pixel centres are whole numbers; the fine grid's are at (k + 0.5) / FINE - 0.5
    points = (np.stack([column, row], axis=1) - first + 0.5) * _FINE - 0.5
    cv2.fillPoly(fine, [np.rint(points * 256).astype(np.int32)], 1, cv2.LINE_8, 8)
    covered = cv2.resize(fine.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return Coverage(window, np.asarray(covered, dtype=np.float32))


def _widened(window: tuple[slice, slice], margin: int, size: tuple[int, int]) -> tuple[slice, slice]:
    rows, columns = (
        slice(max(part.start - margin, 0), min(part.stop + margin, length))
        for part, length in zip(window, size, strict=True)
    )
    return rows, columns


def _surface(
    body: FingerBody, skin: SkinMap, placement: Placement, part: tuple[Camera, tuple[slice, slice]], workers: int
) -> Surface:
    """The first points of a placed finger on the rays of a part of the camera's pixels."""
    camera, box = part
    rows, columns = camera.image_size
    perspective = camera.model == "perspective"
    shapes: list[tuple[int, ...]] = [(), (), (3,), (3,), (), (), (2,), *([()] * (2 * perspective))]
    arrays = [
        np.full((rows, columns, *shape), empty, dtype=np.float32) for shape, empty in zip(shapes, EMPTY, strict=False)
    ]
    bottom, top = reach_in_height(body, placement)
    near = _near(body, placement, camera, box, top)
    tall = max(4, 24000 // (box[1].stop - box[1].start))
    across = np.arange(box[1].start, box[1].stop)

    def fill(first: int) -> None:
        down = np.arange(first, min(first + tall, box[0].stop))
        rays = rays_of(camera, down, across)
        wanted = np.flatnonzero(near[down[0] - box[0].start : down[-1] + 1 - box[0].start].ravel())
        if wanted.size == 0:
            return
        rays = rays.some(wanted)
        index, values = cast_rays(body, skin, placement, rays, np.full(wanted.size, top), bottom=bottom)
        _, along, _ = placement.to_finger(*rays.some(index).at(np.asarray(values[0], dtype=np.float64)))
        bare = along > -PROXIMAL_MM
        flat = wanted[index[bare]]
        i, j = down[flat // across.size], across[flat % across.size]
        for array, value in zip(arrays, values, strict=True):
            array[i, j] = value[bare]

    with ThreadPoolExecutor(max_workers=max(workers, 1)) as pool:
        list(pool.map(fill, range(box[0].start, box[0].stop, tall)))
    height, shape_height, normals, shape_normals, relief, pigment, chart, *places = arrays
    x_mm, y_mm = places or (None, None)
    return Surface(
        camera, height, shape_height, normals, shape_normals, relief, np.isfinite(height), pigment,
        x_mm=x_mm, y_mm=y_mm, chart=chart,
    )  # fmt: skip


def _near(body: FingerBody, placement: Placement, camera: Camera, box: tuple[slice, slice], top: float) -> BoolArray:
    """Pixels of the box near which the finger is seen: (h, w)."""
    step = max(1, int(0.4 * camera.px_per_mm))
    some = [np.arange(part.start, part.stop + step, step) for part in box]
    rays = rays_of(camera, *some)
    hit = meets(body, placement, rays, np.full(rays.x.size, top)).reshape(some[0].size, some[1].size)
    wide = cv2.dilate(hit.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    fine = np.repeat(np.repeat(wide, step, axis=0), step, axis=1)
    return np.asarray(fine[: box[0].stop - box[0].start, : box[1].stop - box[1].start])


def reach_in_height(body: FingerBody, placement: Placement) -> tuple[float, float]:
    """Heights below and above every point of a finger, however it is turned, that is not hidden in the sleeve."""
    shape = body.shape
    half = 0.8 * max(shape.width_mm, shape.thickness_mm)
    corners = np.array(
        [(x, y, z) for x in (-half, half) for y in (-PROXIMAL_MM, shape.length_mm + 2.0) for z in (-half, half)]
    )
    heights = corners @ placement.rotation[2] + placement.shift[2]
    return float(heights.min()) - 2.0, float(heights.max()) + 2.0
