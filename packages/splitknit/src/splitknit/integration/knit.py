"""Knitting: relief and shape become one surface, and heights along a camera's rays points in the
rig's frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy

from splitknit.imaging.geometry import (
    enlarged,
    height_gradients,
    nearest_known,
    normals_from_gradients,
)
from splitknit.imaging.pixels import bin_mean
from splitknit.imaging.view import View, view_of
from splitknit.integration.frankot_chellappa import check_fields
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, Camera, FloatArray
from splitknit.settings import Checked


@dataclass(frozen=True, slots=True)
class KnitSettings(Checked):
    """How relief and shape are joined."""

    method: Literal["addition", "crossover", "none", "whole"] = "crossover"
    """``addition`` as the thesis; ``crossover``; ``none``: the visible surface alone, split by the
    shapelets; ``whole``: the visible surface alone, not split, whose height is what the thesis's
    matcher takes."""


_PARTS = "the relief", "the shape"


def add(ridge_mm: Any, shape_mm: Any, mask: Any = None) -> FloatArray:
    """Sum of relief and shape, pixel by pixel; NaN outside the mask.

    Frequencies that both parts contain count twice (see :func:`crossover`). `ridge_mm`, `shape_mm`:
    (H, W), in the same unit; `mask`: (H, W) bool, optional. Source: the thesis, section 3.3.3 and
    figure 3.27.
    """
    ridge, shape, inside = check_fields(ridge_mm, shape_mm, mask, _PARTS)
    return np.where(inside, ridge + shape, np.nan).astype(np.float32)


def crossover(
    visible_mm: Any, shape_mm: Any, response: Callable[[Array], Any], mask: Any = None
) -> FloatArray:
    """Fine detail from one surface and the rest from the other, each frequency once: H visible + (1
    - H) shape.

    Computed as shape + H (visible - shape), so that only the difference of the two, which is small
    and smooth at the outline, is filtered. `visible_mm`, `shape_mm`: (H, W) of one unit, NaN is
    allowed outside `mask`; `response`: H, from angular frequencies in rad/px (an array) to gains,
    zero at zero and one where the detail is fine. Returns (H, W) float32, NaN outside the mask.
    Raises BadInput if shapes differ, the mask is empty, or a value inside the mask is not finite.

    >>> import numpy as np
    >>> flat, bumps = np.zeros((32, 32)), np.tile(np.cos(np.arange(32) * np.pi), (32, 1))
    >>> knitted = crossover(bumps + 5.0, flat, lambda omega: omega > 0.5)
    >>> bool(np.allclose(knitted, bumps, atol=1e-5))
    True
    """
    visible, shape, inside = check_fields(visible_mm, shape_mm, mask, _PARTS)
    difference = visible - shape
    difference = np.where(
        inside, difference - difference[inside].mean(dtype=np.float64), 0.0
    ).astype(np.float32)
    rows, columns = difference.shape
    # cosines: mirrored about the borders
    wy, wx = np.ix_(*(np.pi * np.arange(n) / n for n in (rows, columns)))
    gain = np.asarray(response(np.hypot(wx, wy)), dtype=np.float32)
    detail = scipy.fft.idctn(scipy.fft.dctn(difference, workers=2) * gain, workers=2)
    return np.where(inside, shape + detail, np.nan).astype(np.float32)


def place(  # noqa: PLR0917
    height_mm: FloatArray,
    shape_mm: FloatArray,
    mask: BoolArray,
    camera: Camera,
    window: tuple[slice, slice],
    top_mm: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None, FloatArray | None]:
    """Turn heights along the rays into z: (h, w) of the surface, and of the shape alone on the same
    rays; its normals (h, w, 3) in the rig's frame; x and y (h, w) of its points, None where they
    are the pixels' on the finger plane.

    `height_mm`, `shape_mm`: (h, w) along the rays (:mod:`splitknit.imaging.view`), as if the pixels
    lay on a regular grid, finite inside the mask; `window`: rows and columns of `mask` in the
    camera's image; `top_mm`: assumed height of the highest point above the finger plane, as one
    camera does not see how far away it is.
    """
    if camera.model == "orthographic":
        seen = np.where(mask, height_mm, np.nan).astype(np.float32)
        normals = normals_from_gradients(*height_gradients(seen, camera.pitch_mm))
        return height_mm, shape_mm, normals * mask[..., None], None, None
    view = view_of(camera, *window, along_rays=True)
    shape = shape_mm + unevenness(shape_mm, mask, camera, window)
    for _ in range(4):  # lifting moves points along their rays
        # quantile of the heights that is taken for the highest point
        top = np.quantile(view.points(shape)[2][mask], 0.998)
        shape = shape + (top_mm - top)
    whole = shape + (height_mm - shape_mm)
    x, y, z = view.points(whole)
    _, _, below = view.points(shape)
    return z, below, _normals(whole, mask, view, camera.pitch_mm), x, y


def unevenness(
    shape_mm: FloatArray, mask: BoolArray, camera: Camera, window: tuple[slice, slice]
) -> FloatArray:
    """Correction of a surface (h, w) along the rays that was integrated as if the pixels lay on a
    regular grid.

    A step of one pixel turns the ray by a little less towards the image's corners, and by what the
    lens distorts.
    """
    binning = max(1, round(0.2 / camera.pitch_mm))  # the unevenness is smooth
    rows, columns = (n // binning for n in mask.shape)
    if min(rows, columns) < 4:
        return np.zeros_like(shape_mm)

    inside = bin_mean(mask.astype(np.float32), binning) > 0.999
    if not inside.any():
        return np.zeros_like(shape_mm)
    pitch = camera.pitch_mm * binning
    view = view_of(camera, *window, binning=binning, along_rays=True)
    coarse = np.where(inside, bin_mean(np.where(mask, shape_mm, 0), binning), np.nan).astype(
        np.float32
    )
    right, up = height_gradients(coarse, pitch)
    x_x, x_y, y_x, y_y = view.stretch(pitch, (rows, columns))
    residual_x, residual_y = (x_x - 1) * right + y_x * up, x_y * right + (y_y - 1) * up
    residual = poisson(residual_x, residual_y, inside) * pitch
    return enlarged(nearest_known(residual, inside), binning, mask.shape)


def _normals(height_mm: FloatArray, mask: BoolArray, view: View, pitch_mm: float) -> FloatArray:
    """Unit normals (h, w, 3) in the rig's frame, zero outside the mask, of a surface along the
    rays."""
    seen = np.where(mask, height_mm, np.nan).astype(np.float32)
    right, up = height_gradients(seen, pitch_mm)
    x_x, x_y, y_x, y_y = view.stretch(pitch_mm, (mask.shape[0], mask.shape[1]))
    scale = 1 / (x_x * y_y - x_y * y_x)
    slope_x = (y_y * right - y_x * up) * scale
    slope_y = (x_x * up - x_y * right) * scale
    own = normals_from_gradients(slope_x, slope_y)
    return view.in_rig(own) * mask[..., None]
