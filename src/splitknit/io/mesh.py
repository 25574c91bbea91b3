"""Triangles from a grid of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray


def surface_mesh(
    x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, mask: BoolArray | None = None
) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]:
    """Triangulate a surface given on a pixel grid; y runs up against the rows, x right along the columns.

    Four valid neighbours give two triangles, three give one. Triangles run counter-clockwise seen from +z.

    Parameters
    ----------
    x_mm, y_mm : (H, W), or broadcastable to it such as (W,) and (H, 1)
    z_mm : (H, W), NaN where there is no surface
    mask : (H, W) bool, or None for everywhere; pixels whose z is not finite are left out in any case

    Returns
    -------
    vertices : (N, 3) float32, mm, in the order of the rows
    faces : (M, 3) int32
    index : (H, W) int32, the vertex of each pixel, -1 where there is none; ``values[index >= 0]`` are in the order of
        the vertices

    Raises
    ------
    BadInput
        If the shapes do not fit.
    """
    z_mm = np.asarray(z_mm, dtype=np.float32)
    require(z_mm.ndim == 2, f"z_mm must be (H, W), but it is {z_mm.shape}.")
    valid = np.isfinite(z_mm)
    if mask is not None:
        require(np.shape(mask) == z_mm.shape, f"mask must be {z_mm.shape}, but it is {np.shape(mask)}.")
        valid &= np.asarray(mask, dtype=np.bool_)
    index = np.full(z_mm.shape, -1, dtype=np.int32)
    count = int(valid.sum())
    index[valid] = np.arange(count, dtype=np.int32)
    vertices = np.empty((count, 3), dtype=np.float32)
    for axis, values in enumerate((x_mm, y_mm, z_mm)):
        try:
            full = np.broadcast_to(np.asarray(values), z_mm.shape)
        except ValueError:
            require(False, f"{'xyz'[axis]}_mm {np.shape(values)} does not fit z_mm {z_mm.shape}.")
        vertices[:, axis] = full[valid]
    return vertices, _triangles(index), index


def _triangles(index: NDArray[np.int32]) -> NDArray[np.int32]:
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()  # a b   of each square of four pixels
    c, d = index[1:, :-1].ravel(), index[1:, 1:].ravel()  #   c d
    missing = (a < 0).view(np.uint8) + (b < 0).view(np.uint8) + (c < 0).view(np.uint8) + (d < 0).view(np.uint8)
    full = np.flatnonzero(missing == 0)
    single = np.flatnonzero(missing == 1)
    corners = np.stack([a[single], c[single], d[single], b[single]], axis=1)  # counter-clockwise
    faces = np.empty((2 * len(full) + len(single), 3), dtype=np.int32)
    quads = faces[: 2 * len(full)].reshape(-1, 2, 3)
    quads[:, 0, 0], quads[:, 0, 1] = a[full], c[full]
    quads[:, 0, 2] = quads[:, 1, 0] = b[full]
    quads[:, 1, 1], quads[:, 1, 2] = c[full], d[full]
    faces[2 * len(full) :] = corners[corners >= 0].reshape(-1, 3)
    return faces
