"""Shaded pictures of a height field, seen at an angle, by a small renderer.

A height field that is tilted about a horizontal axis hides itself column by column. Walking a
column from the front to the back, a point is seen if it is projected higher than all before it (the
floating horizon). The horizon rises monotonically, so it can be inverted: every pixel of the view
knows the row it shows, with sub-pixel accuracy.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import bounding_box, height_gradients, normals_from_gradients
from splitknit.io.pictures import ColourArray
from splitknit.model import FloatArray

_CLAY = np.array([0.90, 0.80, 0.70], dtype=np.float32)
_KEY = np.array([-0.55, 0.55, 0.63], dtype=np.float32)
_FILL = np.array([0.70, -0.15, 0.70], dtype=np.float32)
_BACKGROUND = 0.965
_SUPERSAMPLING = 2
_NOWHERE = np.float32(1e9)


def _shade(surface: Any, turn_rad: float = 0.0) -> FloatArray:
    """Light a height field like matt clay, (H, W, 3) float32 in [0, 1], RGB for display; valleys
    are slightly darker. The lamps stand still before a viewer for whom the finger is turned by
    `turn_rad`, counter-clockwise.
    """
    inside = surface.weight > 0.5
    known = np.where(inside, surface.height_mm, np.float32(np.nan))
    normals = normals_from_gradients(*height_gradients(known, surface.frame.pitch_mm))
    key = np.clip(normals @ _lamp(_KEY, turn_rad), 0.0, 1.0)
    fill = np.clip(normals @ _lamp(_FILL, turn_rad), 0.0, 1.0)
    halfway = _KEY / np.linalg.norm(_KEY) + np.array([0.0, 0.0, 1.0], dtype=np.float32)
    gloss = np.clip(normals @ _lamp(halfway, turn_rad), 0.0, 1.0) ** 24
    deviation = (
        float(np.sqrt(np.mean(np.square(surface.ridge_mm[inside])))) if bool(inside.any()) else 0.0
    )
    depth = np.clip(surface.ridge_mm / max(2.0 * deviation, 1e-6), -1.0, 1.0)
    light = (0.10 + 0.74 * key + 0.20 * fill) * (1.0 + np.float32(0.14) * depth)
    shaded = light[..., None] * _CLAY + np.float32(0.10) * gloss[..., None]
    return np.asarray(np.clip(shaded, 0.0, 1.0) ** np.float32(0.8), dtype=np.float32)


def _lamp(direction: FloatArray, turn_rad: float) -> FloatArray:
    """Unit direction of a lamp in the frame of a finger that is turned by `turn_rad`."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    x, y, z = direction / np.linalg.norm(direction)
    return np.array([cos * x + sin * y, -sin * x + cos * y, z], dtype=np.float32)


def oblique_view(surface: Any, *, turn_deg: float = 0.0, tilt_deg: float = 55.0) -> ColourArray:
    """Shaded surface seen at an angle, parallel projection, (h, w, 3) uint8, cut to the finger:
    turned about the camera's axis, counter-clockwise, then tilted (0 = from above, less than 90).
    """
    turn_rad, weight = np.deg2rad(turn_deg), surface.weight
    colours = _shade(surface, turn_rad)
    painted = _bytes(np.dstack([colours, np.ones_like(weight)]))
    # the staircase of the mask's edge is rounded, inside it: steep flanks would end in a fringe
    blurred = cv2.GaussianBlur(weight, (0, 0), 4.0, borderType=cv2.BORDER_CONSTANT)
    edge = np.asarray(np.clip((blurred - 0.65) / 0.3, 0.0, 1.0), dtype=np.float32)
    hole = (weight <= 0) & (edge > 0)
    # the picture's memory follows its width, not the heights
    deepest = max(weight.shape) * surface.frame.pitch_mm
    height = surface.height_mm * np.float32(
        min(1.0, deepest / max(float(np.ptp(surface.height_mm)), 1e-9))
    )
    if hole.any():  # of a ragged surface: its zeros would stand out of the neighbours as spikes
        around = cv2.GaussianBlur(height * weight, (0, 0), 4.0, borderType=cv2.BORDER_CONSTANT)
        height, edge[hole] = np.where(hole, around / np.maximum(blurred, 1e-6), height), 0.0
    height, painted = _turn(height, edge, painted, turn_rad)
    view = _tilt(height, painted, np.deg2rad(tilt_deg), surface.frame.pitch_mm / _SUPERSAMPLING)
    if (covered := view[..., 3] > 0).any():
        margin = 12 * _SUPERSAMPLING
        view = np.pad(view[bounding_box(covered)], ((margin, margin), (margin, margin), (0, 0)))
    return _flattened(view)


def _turn(
    height: FloatArray, weight: FloatArray, painted: NDArray[np.uint8], angle_rad: float
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Rotate about the middle into a finer frame that holds all of it; NaN and no paint outside."""
    (rows, columns), zoom = weight.shape, _SUPERSAMPLING
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    cover = abs(cos) * columns + abs(sin) * rows, abs(sin) * columns + abs(cos) * rows
    size = (int(zoom * cover[0]) + 1, int(zoom * cover[1]) + 1)
    linear = np.array([[cos, -sin], [sin, cos]]) / zoom
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    matrix = np.column_stack([linear, middle - linear @ ((np.array(size) - 1) / 2)])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    inside = np.asarray(cv2.warpAffine(weight, matrix, size, flags=flags)) > 0.5
    turned = np.full(inside.shape, np.nan, dtype=np.float32)
    np.copyto(turned, cv2.warpAffine(height, matrix, size, flags=flags), where=inside)
    colours = np.asarray(cv2.warpAffine(painted, matrix, size, flags=flags), dtype=np.uint8)
    colours.view(np.uint32)[..., 0] *= inside
    return turned, colours


def _tilt(
    height: FloatArray, painted: NDArray[np.uint8], tilt_rad: float, pitch_mm: float
) -> NDArray[np.uint8]:
    """Floating horizon: the tilted view of `painted` (H, W, 4), colours premultiplied by the
    coverage."""
    known = np.isfinite(height)
    if not bool(known.any()):
        return painted
    rows, columns = bounding_box(known)
    depth = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None] * np.float32(
        np.cos(tilt_rad)
    )
    # downwards; the front is last
    screen = depth - height[rows, columns] * np.float32(np.sin(tilt_rad) / pitch_mm)
    screen[~known[rows, columns]] = _NOWHERE
    for row in range(len(screen) - 2, -1, -1):  # the horizon, from the front to the back
        np.minimum(screen[row], screen[row + 1], out=screen[row])
    new = screen < _NOWHERE
    top, bottom = int(np.floor(screen.min())) - 2, int(np.ceil(screen[new].max())) + 2
    new[:-1] = screen[:-1] < screen[1:]  # what is hidden by what is before it adds nothing
    lines = np.arange(top, bottom, dtype=np.float64)
    source = np.full((height.shape[1], lines.size), -10.0, dtype=np.float32)
    each = zip(cv2.transpose(screen), cv2.transpose(new.view(np.uint8)), strict=True)
    for column, (horizon, seen) in enumerate(each, columns.start):
        places = np.flatnonzero(seen)
        if places.size:
            line = horizon[places].astype(np.float64)
            ends = slice(math.ceil(line[0]) - top, math.floor(line[-1]) - top + 1)
            source[column, ends] = np.interp(lines[ends], line, places + float(rows.start))
    across = np.ascontiguousarray(
        np.broadcast_to(np.arange(len(source), dtype=np.float32), source.shape[::-1])
    )
    return np.asarray(
        cv2.remap(painted, across, cv2.transpose(source), cv2.INTER_LINEAR), dtype=np.uint8
    )


def _flattened(view: NDArray[np.uint8]) -> ColourArray:
    """Average the finer view over the picture's pixels and lay it on the background."""
    size = (view.shape[1] // _SUPERSAMPLING, view.shape[0] // _SUPERSAMPLING)
    small = (
        np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA), dtype=np.float32) / 255.0
    )
    return _bytes(small[..., :3] + np.float32(_BACKGROUND) * (1.0 - small[..., 3:]))


def _bytes(picture: FloatArray) -> NDArray[np.uint8]:
    return np.asarray(np.round(np.clip(picture, 0.0, 1.0) * 255).astype(np.uint8))
