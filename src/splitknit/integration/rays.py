"""From heights along a perspective camera's rays to points in the rig's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.imaging.band import bin_mean
from splitknit.imaging.geometry import enlarged, height_gradients, nearest_known, normals_from_gradients
from splitknit.imaging.view import View, view_of
from splitknit.integration.poisson import poisson
from splitknit.model import BoolArray, Camera, FloatArray

COARSE_MM = 0.2
"""Pitch at which the grid's unevenness, which is smooth, is accounted for."""

TOP_SHARE = 0.998
"""Quantile of the heights that is taken for the highest point."""


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """A surface in the rig's frame, on the window's pixels."""

    height_mm: FloatArray
    """(h, w) z."""
    shape_mm: FloatArray
    """(h, w) z of the shape alone, on the same rays."""
    normals: FloatArray
    """(h, w, 3)."""
    x_mm: FloatArray | None = None
    """(h, w) of the surface points, where they are not those of the pixels on the finger plane."""
    y_mm: FloatArray | None = None


def place(  # noqa: PLR0917
    height_mm: FloatArray,
    shape_mm: FloatArray,
    mask: BoolArray,
    camera: Camera,
    window: tuple[slice, slice],
    top_mm: float,
) -> _Placed:
    """Turn heights along the rays into z, and find the points and normals.

    `height_mm`, `shape_mm`: (h, w) along the rays (:mod:`splitknit.imaging.view`), as if the pixels lay on a regular
    grid, finite inside the mask; `window`: rows and columns of `mask` in the camera's image; `top_mm`: assumed height
    of the highest point above the finger plane, as one camera does not see how far away it is.
    """
    if camera.model == "orthographic":
        seen = np.where(mask, height_mm, np.float32(np.nan)).astype(np.float32)
        normals = normals_from_gradients(*height_gradients(seen, camera.pitch_mm))
        return _Placed(height_mm, shape_mm, normals * mask[..., None])
    view = view_of(camera, *window, along_rays=True)
    shape = shape_mm + unevenness(shape_mm, mask, camera, window)
    for _ in range(4):  # lifting moves points along their rays
        top = np.quantile(view.points(shape)[2][mask], TOP_SHARE)
        shape = shape + np.float32(top_mm - top)
    whole = shape + (height_mm - shape_mm)
    x, y, z = view.points(whole)
    _, _, below = view.points(shape)
    return _Placed(z, below, _normals(whole, mask, view, camera.pitch_mm), x, y)


def unevenness(shape_mm: FloatArray, mask: BoolArray, camera: Camera, window: tuple[slice, slice]) -> FloatArray:
    """What is missing in a surface (h, w) along the rays that was integrated as if the pixels lay on a regular grid.

    A step of one pixel turns the ray by a little less towards the image's corners, and by what the lens distorts.
    """
    binning = max(1, round(COARSE_MM / camera.pitch_mm))
    rows, columns = (n // binning for n in mask.shape)
    if min(rows, columns) < 4:
        return np.zeros_like(shape_mm)

    inside = bin_mean(mask.astype(np.float32), binning) > 0.999
    if not inside.any():
        return np.zeros_like(shape_mm)
    pitch = camera.pitch_mm * binning
    view = view_of(camera, *window, binning=binning, along_rays=True)
    coarse = np.where(inside, bin_mean(np.where(mask, shape_mm, np.float32(0)), binning), np.float32(np.nan)).astype(
        np.float32
    )
    right, up = height_gradients(coarse, pitch)
    x_x, x_y, y_x, y_y = view.stretch(pitch, (rows, columns))
    residual_x, residual_y = (x_x - 1) * right + y_x * up, x_y * right + (y_y - 1) * up
    residual = poisson(
        np.where(inside, residual_x, 0).astype(np.float32), np.where(inside, residual_y, 0).astype(np.float32), inside
    ) * np.float32(pitch)
    residual = np.nan_to_num(residual, nan=0.0).astype(np.float32)
    return enlarged(nearest_known(residual, inside), binning, mask.shape)


def _normals(height_mm: FloatArray, mask: BoolArray, view: View, pitch_mm: float) -> FloatArray:
    """Unit normals (h, w, 3) in the rig's frame, zero outside the mask, of a surface along the rays."""
    seen = np.where(mask, height_mm, np.float32(np.nan)).astype(np.float32)
    right, up = height_gradients(seen, pitch_mm)
    x_x, x_y, y_x, y_y = view.stretch(pitch_mm, (mask.shape[0], mask.shape[1]))
    scale = 1 / (x_x * y_y - x_y * y_x)
    slope_x = (y_y * right - y_x * up) * scale
    slope_y = (x_x * up - x_y * right) * scale
    own = normals_from_gradients(np.asarray(slope_x, dtype=np.float32), np.asarray(slope_y, dtype=np.float32))
    return np.asarray(view.in_rig(own) * mask[..., None], dtype=np.float32)
