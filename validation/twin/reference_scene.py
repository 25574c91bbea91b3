"""A crop of skin ready for the reference: triangles, pixels, and what of each light reaches each triangle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Led
from splitknit_simulator.light.skin import fresnel
from splitknit_simulator.surface import SimulatedSurface

Array = NDArray[np.float64]


# The skin as triangles: what the reference's walks wander under.
#
# A patch that fills the picture goes on beyond it: the map is mirrored over a margin, and a flat ledge leads further
# out. A finger that the picture shows with its outline is closed by a mirror image of its smooth shape from below.

LEDGE_MM = 40.0
"""Width of the flat ledge around a patch; light hardly wanders that far."""


@dataclass(frozen=True, slots=True, eq=False)
class _Mesh:
    """Triangles that face out of the skin."""

    vertices: Array
    """(V, 3) mm, in the rig's frame."""
    faces: NDArray[np.uint32]
    """(F, 3) counter-clockwise as seen from outside."""
    closed: bool
    """Whether it is a whole finger; a patch is a height field."""

    def normals(self) -> Array:
        """(F, 3) unit normals of the triangles, out of the skin."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))

    def centres(self) -> Array:
        """(F, 3) centres of the triangles."""
        return np.asarray(self.vertices[self.faces].mean(axis=1))

    def steepest(self) -> float:
        """Largest slope of a patch."""
        normals = self.normals()
        return float(np.max(np.hypot(normals[:, 0], normals[:, 1]) / np.maximum(normals[:, 2], 1e-9)))


def _skin_mesh(surface: SimulatedSurface, window: tuple[slice, slice], margin_mm: float) -> _Mesh:
    """Triangles of `surface` around the pixels of `window`; vertices are the centres of the pixels."""
    height, width = surface.mask.shape
    pitch = surface.camera.pitch_mm
    x = (np.arange(width) - (width - 1) / 2) * pitch
    y = ((height - 1) / 2 - np.arange(height)) * pitch
    if not bool(surface.mask.all()):
        return _closed(surface, x, y)
    margin = int(np.ceil(margin_mm / pitch))
    (top, bottom), (left, right) = (part.indices(size)[:2] for part, size in zip(window, (height, width), strict=True))
    pads = (
        (max(margin - top, 0), max(margin - (height - bottom), 0)),
        (max(margin - left, 0), max(margin - (width - right), 0)),
    )
    z = np.pad(surface.height_mm.astype(np.float64), pads, mode="symmetric")
    x = x[0] + (np.arange(z.shape[1]) - pads[1][0]) * pitch
    y = y[0] - (np.arange(z.shape[0]) - pads[0][0]) * pitch
    x = np.concatenate([[x[0] - LEDGE_MM], x, [x[-1] + LEDGE_MM]])
    y = np.concatenate([[y[0] + LEDGE_MM], y, [y[-1] - LEDGE_MM]])
    z = np.pad(z, 1, mode="edge")
    grid_x, grid_y = np.meshgrid(x, y)
    vertices = np.stack([grid_x, grid_y, z], axis=-1).reshape(-1, 3)
    index = np.arange(vertices.shape[0]).reshape(z.shape)
    return _Mesh(vertices, _quads(index, np.ones((z.shape[0] - 1, z.shape[1] - 1), dtype=np.bool_)), closed=False)


def _quads(index: NDArray[np.intp], chosen: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Two triangles for each chosen square of four neighbouring grid points, facing up."""
    upper_left, upper_right = index[:-1, :-1][chosen], index[:-1, 1:][chosen]
    lower_left, lower_right = index[1:, :-1][chosen], index[1:, 1:][chosen]
    first = np.stack([upper_left, lower_left, upper_right], axis=1)
    second = np.stack([upper_right, lower_left, lower_right], axis=1)
    return np.concatenate([first, second]).astype(np.uint32)


def _closed(surface: SimulatedSurface, x: Array, y: Array) -> _Mesh:
    """The finger as the camera sees it, its smooth shape mirrored below, and a wall along the outline."""
    mask = surface.mask
    inside = mask[:-1, :-1] & mask[:-1, 1:] & mask[1:, :-1] & mask[1:, 1:]
    grid_x, grid_y = np.meshgrid(x, y)
    z = np.where(mask, surface.height_mm, 0.0).astype(np.float64)
    rim = float(np.percentile(surface.shape_mm[mask], 1))
    low = np.where(mask, np.minimum(2.0 * rim - surface.shape_mm, z - 0.05), 0.0)
    count = mask.size
    index = np.arange(count).reshape(mask.shape)
    upper = _quads(index, inside)
    lower = _quads(index + count, inside)[:, ::-1]
    # an edge that only one triangle of the upper side has lies on the outline
    edges = np.concatenate([upper[:, [0, 1]], upper[:, [1, 2]], upper[:, [2, 0]]]).astype(np.int64)
    code = edges[:, 0] * count + edges[:, 1]
    outline = edges[~np.isin(code, edges[:, 1] * count + edges[:, 0])]
    a, b = outline[:, 0], outline[:, 1]
    wall = np.concatenate([np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)])
    vertices = np.concatenate(
        [np.stack([grid_x, grid_y, side], axis=-1).reshape(-1, 3) for side in (z, low)]
    )  # both sides on the same grid
    faces = np.concatenate([upper, lower, wall.astype(np.uint32)])
    used, compact = np.unique(faces, return_inverse=True)
    return _Mesh(vertices[used], compact.reshape(-1, 3).astype(np.uint32), closed=True)


UNIT = 1e4
"""Irradiance of an LED of intensity one at 100 mm, as everywhere in the twin."""

FAR_MM = 1e5
"""Where a distant light is put."""

INSET_MM = 1e-4
"""How far from a triangle a ray starts anew, so that it does not meet the same triangle again."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceScene:
    """A crop of skin, ready for walks; made by :func:`reference.reference_scene`."""

    mi: Any
    """Mitsuba."""
    dr: Any
    """Dr.Jit."""
    scene: Any
    """Mitsuba's scene."""
    grid: tuple[int, int, float, float, float]
    """Rows, columns, left and upper edge, and pitch of the pixels in mm."""
    lowest_mm: float
    """No ray that stays below this height meets the surface."""
    lights: tuple[tuple[Array, float], ...]
    """Position in mm and intensity times UNIT of every single light."""
    images: tuple[int, ...]
    """Which image each light belongs to."""
    unshadowed: bool
    """No part of the skin can shade another."""
    strength: Any
    """(triangles x lights) irradiance of a surface that faces the light, zero in its cast and attached shadow."""
    entering: Any
    """(triangles x lights) irradiance that passes the boundary."""

    def gather(self, table: Any, triangle: Any, light: Any, active: Any) -> Any:
        """Value of `strength` or `entering` on a triangle, zero where not active."""
        return self.dr.gather(self.mi.Float, table, triangle * len(self.lights) + light, active)

    def towards(self, light: int, point: Any) -> Any:
        """Direction from a point to a light."""
        return self.dr.normalize(self.mi.Point3f(*self.lights[light][0].tolist()) - point)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Where the camera's rays meet the skin, one lane a ray."""

    point: Any
    normal: Any
    valid: Any
    lane: Any


def build(
    engine: tuple[Any, Any],
    surface: SimulatedSurface,
    window: tuple[slice, slice],
    leds: Sequence[Led],
    *,
    binning: int,
    margin_mm: float,
) -> ReferenceScene:
    """Build the scene of a crop; `engine` is Mitsuba and Dr.Jit, see :func:`reference_scene` for the rest."""
    mi, dr = engine
    height, width = surface.mask.shape
    (top, bottom), (left, right) = (p.indices(n)[:2] for p, n in zip(window, (height, width), strict=True))
    size = (bottom - top, right - left)
    require(
        min(size) > 0 and size[0] % binning == 0 and size[1] % binning == 0,
        f"the crop must be a positive multiple of {binning} pixels along each side, but it is {size}.",
    )
    require(bool(surface.mask[window].all()), "the crop must lie on the skin; move or shrink it.")
    pitch = surface.camera.pitch_mm
    edges = ((left - width / 2) * pitch, (height / 2 - top) * pitch)
    mesh = _skin_mesh(surface, window, margin_mm)
    shape = mi.Mesh("skin", len(mesh.vertices), len(mesh.faces), has_vertex_normals=False)
    values = mi.traverse(shape)
    values["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    values["faces"] = mesh.faces.ravel()
    values.update()
    scene = mi.load_dict({"type": "scene", "skin": shape})
    lights, images = _single_lights(leds)
    unshadowed = not mesh.closed and mesh.steepest() < 0.8 * min(_elevation(mesh, position) for position, _ in lights)
    strength, entering = _on_triangles(engine, None if unshadowed else scene, mesh, lights)
    return ReferenceScene(
        mi, dr, scene, (size[0] // binning, size[1] // binning, *edges, pitch * binning),
        -1e6 if mesh.closed else float(mesh.vertices[:, 2].min()), lights, images, unshadowed, strength, entering,
    )  # fmt: skip


def see(crop: ReferenceScene, lanes: int, seed: int) -> Seen:
    """Send `lanes` rays down through random places of each pixel."""
    mi, dr = crop.mi, crop.dr
    rows, columns, left, top, pitch = crop.grid
    lane = dr.arange(mi.UInt32, rows * columns * lanes)
    random = mi.PCG32(initstate=mi.UInt64(seed), initseq=mi.UInt64(lane))
    pixel = lane // lanes
    x = left + (mi.Float(pixel % columns) + random.next_float32()) * pitch
    y = top - (mi.Float(pixel // columns) + random.next_float32()) * pitch
    hit = crop.scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, crop.scene.bbox().max.z + 1.0), mi.Vector3f(0, 0, -1)))
    seen = Seen(mi.Point3f(hit.p), mi.Vector3f(hit.n), hit.is_valid(), lane)
    dr.eval(seen.point, seen.normal, seen.valid)
    return seen


def _single_lights(leds: Sequence[Led]) -> tuple[tuple[tuple[Array, float], ...], tuple[int, ...]]:
    lights, images = [], []
    for image, led in enumerate(leds):
        for one in (led, *led.also):
            require(one.lobe_exponent == 0.0, "the reference knows LEDs without a lobe (lobe_exponent 0) only.")
            if one.position_mm is not None:
                lights.append((np.asarray(one.position_mm, dtype=np.float64), one.intensity * UNIT))
            else:
                direction = np.asarray(one.direction, dtype=np.float64)
                lights.append((direction / np.linalg.norm(direction) * FAR_MM, one.intensity * FAR_MM**2))
            images.append(image)
    require(len(lights) > 0, "the reference needs at least one LED.")
    return tuple(lights), tuple(images)


def _elevation(mesh: _Mesh, position: Array) -> float:
    """Tangent of the angle above the horizon at which the patch sees a light, about."""
    return float((position[2] - mesh.vertices[:, 2].max()) / (np.hypot(position[0], position[1]) + 1e-9))


def _on_triangles(
    engine: tuple[Any, Any], scene: Any, mesh: _Mesh, lights: Sequence[tuple[Array, float]]
) -> tuple[Any, Any]:
    """Irradiance at every triangle; cast shadows need the scene."""
    mi, dr = engine
    centres, normals = mesh.centres(), mesh.normals()
    strength, entering = [], []
    for position, power in lights:
        way = position - centres
        squared = np.sum(way * way, axis=1)
        way /= np.sqrt(squared)[:, None]
        cosine = np.sum(way * normals, axis=1)
        lit = cosine > 0.0
        if scene is not None:
            start = mi.Point3f(*(centres + normals * INSET_MM).astype(np.float32).T)
            lit &= ~np.asarray(scene.ray_test(mi.Ray3f(start, mi.Vector3f(*way.astype(np.float32).T))), dtype=np.bool_)
        strength.append(np.where(lit, power / squared, 0.0))
        entering.append(strength[-1] * np.clip(cosine, 0.0, 1.0) * (1.0 - fresnel(cosine)))
    tables = [mi.Float(np.stack(table, axis=1).astype(np.float32).ravel()) for table in (strength, entering)]
    dr.eval(tables)
    return tables[0], tables[1]
