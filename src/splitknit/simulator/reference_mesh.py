"""The skin as triangles: what the reference's walks wander under.

A patch that fills the picture goes on beyond it: the map is mirrored over a margin, and a flat ledge leads further out.
A finger that the picture shows with its outline is closed by a mirror image of its smooth shape from below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.simulator.surface import Surface

Array = NDArray[np.float64]
LEDGE_MM = 40.0
"""Width of the flat ledge around a patch; light hardly wanders that far."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
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


def skin_mesh(surface: Surface, window: tuple[slice, slice], margin_mm: float) -> Mesh:
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
    return Mesh(vertices, _quads(index, np.ones((z.shape[0] - 1, z.shape[1] - 1), dtype=np.bool_)), closed=False)


def _quads(index: NDArray[np.intp], chosen: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Two triangles for each chosen square of four neighbouring grid points, facing up."""
    upper_left, upper_right = index[:-1, :-1][chosen], index[:-1, 1:][chosen]
    lower_left, lower_right = index[1:, :-1][chosen], index[1:, 1:][chosen]
    first = np.stack([upper_left, lower_left, upper_right], axis=1)
    second = np.stack([upper_right, lower_left, lower_right], axis=1)
    return np.concatenate([first, second]).astype(np.uint32)


def _closed(surface: Surface, x: Array, y: Array) -> Mesh:
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
    return Mesh(vertices[used], compact.reshape(-1, 3).astype(np.uint32), closed=True)
