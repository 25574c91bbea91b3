"""Shaded pictures of a height field, by a small renderer of our own.

A height field that is tilted about a horizontal axis hides itself column by column. Walking a column from the front
to the back, a point is seen if it is projected higher than all before it (the floating horizon). The horizon rises
monotonically, so it can be inverted: every pixel of the view knows the row it shows, with sub-pixel accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.pictures import ColourArray, Frame, to_frame
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import FloatArray, Reconstruction

_CLAY = np.array([0.90, 0.80, 0.70], dtype=np.float32)
_KEY = np.array([-0.55, 0.55, 0.63], dtype=np.float32)
_FILL = np.array([0.70, -0.15, 0.70], dtype=np.float32)
_BACKGROUND = 0.965
_SUPERSAMPLING = 2
_NOWHERE = np.float32(1e9)


@dataclass(frozen=True, slots=True, eq=False)
class UprightSurface:
    """A small upright height field."""

    height_mm: FloatArray
    """(H, W), the relief in it exaggerated."""
    relief_mm: FloatArray
    """(H, W), as measured."""
    weight: FloatArray
    """(H, W) in [0, 1], share of the pixel inside the mask."""
    pitch_mm: float


def upright_surface(result: Reconstruction, frame: Frame, exaggeration: float = 1.0) -> UprightSurface:
    """Bring a reconstruction onto a picture's frame.

    The relief is multiplied by `exaggeration` within the height, so that ridges of a few hundredths of a millimetre
    are seen on a finger of several millimetres; less so on steep flanks, where they would overhang.
    """
    height, weight = to_frame(result.height_mm, result.mask, frame)
    relief, _ = to_frame(result.ridge_mm, result.mask, frame)
    facing, _ = to_frame(result.normals[..., 2], result.mask, frame)
    extra = np.float32(exaggeration - 1.0) * np.clip(2.0 * facing * facing, 0.0, 1.0)
    return UprightSurface((height + extra * relief).astype(np.float32), relief, weight, frame.pitch_mm)


def shade(surface: UprightSurface, turn_rad: float = 0.0) -> FloatArray:
    """Light a height field like matt clay; valleys are slightly darker, as in a corner that light reaches less.

    The lamps stand still in front of a viewer for whom the finger is turned by `turn_rad`, counter-clockwise.

    Returns
    -------
    (H, W, 3) float32 in [0, 1], red, green, blue, for display
    """
    inside = surface.weight > 0.5
    known = np.where(inside, surface.height_mm, np.float32(np.nan))
    normals = normals_from_gradients(*height_gradients(known, surface.pitch_mm))
    key = np.clip(normals @ _lamp(_KEY, turn_rad), 0.0, 1.0)
    fill = np.clip(normals @ _lamp(_FILL, turn_rad), 0.0, 1.0)
    halfway = _KEY / np.linalg.norm(_KEY) + np.array([0.0, 0.0, 1.0], dtype=np.float32)
    gloss = np.clip(normals @ _lamp(halfway, turn_rad), 0.0, 1.0) ** 24
    deviation = float(np.sqrt(np.mean(np.square(surface.relief_mm[inside])))) if bool(inside.any()) else 0.0
    depth = np.clip(surface.relief_mm / max(2.0 * deviation, 1e-6), -1.0, 1.0)
    light = (0.10 + 0.74 * key + 0.20 * fill) * (1.0 + np.float32(0.14) * depth)
    shaded = light[..., None] * _CLAY + np.float32(0.10) * gloss[..., None]
    return np.asarray(np.clip(shaded, 0.0, 1.0) ** np.float32(0.8), dtype=np.float32)


def _lamp(direction: FloatArray, turn_rad: float) -> FloatArray:
    """Unit direction of a lamp in the frame of a finger that is turned by `turn_rad`."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    x, y, z = direction / np.linalg.norm(direction)
    return np.array([cos * x + sin * y, -sin * x + cos * y, z], dtype=np.float32)


def top_view(surface: UprightSurface) -> ColourArray:
    """Shaded surface seen from the camera, upright."""
    alpha = surface.weight[..., None]
    return _bytes(shade(surface) * alpha + np.float32(_BACKGROUND) * (1.0 - alpha))


def oblique_view(surface: UprightSurface, *, turn_deg: float = 0.0, tilt_deg: float = 55.0) -> ColourArray:
    """Shaded surface seen at an angle, parallel projection.

    Parameters
    ----------
    surface : UprightSurface
    turn_deg : float
        Turn of the finger about the camera's axis, counter-clockwise, before it is tilted.
    tilt_deg : float
        Angle between the line of sight and the camera's axis, 0 = from above, less than 90.

    Returns
    -------
    (h, w, 3) uint8, cut to the finger
    """
    turn_rad, weight = np.deg2rad(turn_deg), surface.weight
    colours = shade(surface, turn_rad)
    painted = _bytes(np.dstack([colours, np.ones_like(weight)]))
    height, painted = _turn(surface.height_mm, _smooth_edge(weight), painted, turn_rad, zoom=_SUPERSAMPLING)
    view = _tilt(height, painted, np.deg2rad(tilt_deg), surface.pitch_mm / _SUPERSAMPLING)
    return _flattened(_cut(view, margin=12 * _SUPERSAMPLING))


def _smooth_edge(weight: FloatArray) -> FloatArray:
    """Round the staircase of the mask's edge, staying inside it, so that steep flanks do not end in a fringe."""
    blurred = cv2.GaussianBlur(weight, (0, 0), 4.0, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(np.clip((blurred - 0.65) / 0.3, 0.0, 1.0), dtype=np.float32)


def _turn(
    height: FloatArray, weight: FloatArray, painted: NDArray[np.uint8], angle_rad: float, zoom: int
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Rotate about the middle into a frame that holds all of it, `zoom` times finer; NaN and no paint outside."""
    rows, columns = weight.shape
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    size = (
        int(zoom * (abs(cos) * columns + abs(sin) * rows)) + 1,
        int(zoom * (abs(sin) * columns + abs(cos) * rows)) + 1,
    )
    linear = np.array([[cos, -sin], [sin, cos]]) / zoom
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    matrix = np.column_stack([linear, middle - linear @ ((np.array(size) - 1) / 2)])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    outside = cv2.warpAffine(weight, matrix, size, flags=flags) <= 0.5
    turned = np.asarray(cv2.warpAffine(height, matrix, size, flags=flags), dtype=np.float32)
    colours = np.asarray(cv2.warpAffine(painted, matrix, size, flags=flags), dtype=np.uint8)
    turned[outside] = np.nan
    colours[outside] = 0
    return turned, colours


def _tilt(height: FloatArray, painted: NDArray[np.uint8], tilt_rad: float, pitch_mm: float) -> NDArray[np.uint8]:
    """Floating horizon: the tilted view of `painted` (H, W, 4), colours premultiplied by the coverage."""
    rows, columns = height.shape
    depth = np.arange(rows, dtype=np.float32)[:, None] * np.float32(np.cos(tilt_rad))
    screen = depth - height * np.float32(np.sin(tilt_rad) / pitch_mm)  # downwards; the front is the last row
    np.nan_to_num(screen, copy=False, nan=float(_NOWHERE))
    horizon = np.minimum.accumulate(screen[::-1], axis=0)  # (rows, columns), from the front to the back
    seen = horizon < _NOWHERE
    if not bool(seen.any()):
        return painted
    top, bottom = int(np.floor(horizon.min())) - 2, int(np.ceil(horizon[seen].max())) + 2
    lines = np.arange(top, bottom, dtype=np.float32)
    source = np.full((lines.size, columns), -10.0, dtype=np.float32)
    for column in np.flatnonzero(seen[-1]):
        front = int(np.argmax(seen[:, column]))
        line = horizon[front:, column]
        new = np.concatenate([[True], line[1:] < line[:-1]])
        places = (rows - 1 - front - np.flatnonzero(new)).astype(np.float32)
        source[:, column] = np.interp(lines, line[new][::-1], places[::-1], left=-10.0, right=-10.0)
    across = np.ascontiguousarray(np.broadcast_to(np.arange(columns, dtype=np.float32), source.shape))
    return np.asarray(cv2.remap(painted, across, source, cv2.INTER_LINEAR), dtype=np.uint8)


def _cut(view: NDArray[np.uint8], margin: int) -> NDArray[np.uint8]:
    alpha = view[..., 3]
    rows, columns = np.flatnonzero(alpha.max(axis=1)), np.flatnonzero(alpha.max(axis=0))
    if rows.size == 0:
        return view
    part = view[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return np.pad(part, ((margin, margin), (margin, margin), (0, 0)))


def _flattened(view: NDArray[np.uint8]) -> ColourArray:
    """Average the finer view over the picture's pixels and lay it on the background."""
    size = (view.shape[1] // _SUPERSAMPLING, view.shape[0] // _SUPERSAMPLING)
    small = np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA), dtype=np.float32) / 255.0
    return _bytes(small[..., :3] + np.float32(_BACKGROUND) * (1.0 - small[..., 3:]))


def _bytes(picture: FloatArray) -> NDArray[np.uint8]:
    return np.asarray(np.round(np.clip(picture, 0.0, 1.0) * 255).astype(np.uint8))
