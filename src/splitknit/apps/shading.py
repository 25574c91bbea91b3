"""Shaded pictures of a height field, by a small renderer of our own.

A height field that is tilted about a horizontal axis hides itself column by column. Walking a column from the front
to the back, a point is seen if it is projected higher than all before it (the floating horizon). The horizon rises
monotonically, so it can be inverted: every pixel of the view knows the row it shows, with sub-pixel accuracy.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.pictures import ColourArray, Frame, colour, to_frame
from splitknit.geometry import height_gradients, normals_from_gradients
from splitknit.types import FloatArray, Reconstruction

_CLAY = np.array([0.90, 0.80, 0.70], dtype=np.float32)
_KEY = np.array([-0.55, 0.55, 0.63], dtype=np.float32)
_FILL = np.array([0.70, -0.15, 0.70], dtype=np.float32)
_BACKGROUND = 0.965
_SUPERSAMPLING = 2


def upright_heights(
    result: Reconstruction, frame: Frame, exaggeration: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the height in mm, the relief in mm and the weight of the mask on a picture's frame.

    The relief is multiplied by `exaggeration` within the height, so that ridges of a few hundredths of a millimetre
    are seen on a finger of several millimetres.
    """
    both = np.stack([result.height_mm, result.ridge_mm], axis=-1)
    values, weight = to_frame(both, result.mask, frame)
    relief = np.ascontiguousarray(values[..., 1])
    height = values[..., 0] + np.float32(exaggeration - 1.0) * relief
    return np.ascontiguousarray(height, dtype=np.float32), relief, weight


def shade(
    height_mm: FloatArray, relief_mm: FloatArray, weight: FloatArray, pitch_mm: float, turn_rad: float = 0.0
) -> FloatArray:
    """Light a height field (H, W) like matt clay; valleys are slightly darker, as in a corner that light reaches less.

    The lamps stand still in front of a viewer for whom the finger is turned by `turn_rad`, counter-clockwise.

    Returns
    -------
    (H, W, 3) float32 in [0, 1], red, green, blue, for display
    """
    known = np.where(weight > 0.5, height_mm, np.float32(np.nan))
    normals = normals_from_gradients(*height_gradients(known, pitch_mm))
    key = np.clip(normals @ _lamp(_KEY, turn_rad), 0.0, 1.0)
    fill = np.clip(normals @ _lamp(_FILL, turn_rad), 0.0, 1.0)
    halfway = _KEY / np.linalg.norm(_KEY) + np.array([0.0, 0.0, 1.0], dtype=np.float32)
    gloss = np.clip(normals @ _lamp(halfway, turn_rad), 0.0, 1.0) ** 24
    deviation = float(np.sqrt(np.mean(np.square(relief_mm[weight > 0.5])))) if bool((weight > 0.5).any()) else 0.0
    depth = np.clip(relief_mm / max(2.0 * deviation, 1e-6), -1.0, 1.0)
    light = (0.10 + 0.74 * key + 0.20 * fill) * (1.0 + np.float32(0.14) * depth)
    shaded = light[..., None] * _CLAY + np.float32(0.10) * gloss[..., None]
    return np.asarray(np.clip(shaded, 0.0, 1.0) ** np.float32(0.8), dtype=np.float32)


def _lamp(direction: FloatArray, turn_rad: float) -> FloatArray:
    """Unit direction of a lamp in the frame of a finger that is turned by `turn_rad`."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    x, y, z = direction / np.linalg.norm(direction)
    return np.array([cos * x + sin * y, -sin * x + cos * y, z], dtype=np.float32)


def top_view(result: Reconstruction, frame: Frame, exaggeration: float = 2.0) -> ColourArray:
    """Shaded relief seen from the camera, upright."""
    height, relief, weight = upright_heights(result, frame, exaggeration)
    picture = shade(height, relief, weight, frame.pitch_mm)
    alpha = weight[..., None]
    return _bytes(picture * alpha + np.float32(_BACKGROUND) * (1.0 - alpha))


def oblique_view(
    result: Reconstruction,
    frame: Frame,
    *,
    turn_deg: float = 0.0,
    tilt_deg: float = 55.0,
    exaggeration: float = 2.0,
    paint: tuple[float, float] | None = None,
) -> ColourArray:
    """Shaded surface seen at an angle, parallel projection.

    Parameters
    ----------
    frame : Frame
        An upright frame over the mask.
    turn_deg : float
        Turn of the finger about the camera's axis, counter-clockwise, before it is tilted.
    tilt_deg : float
        Angle between the line of sight and the camera's axis, 0 = from above, less than 90.
    exaggeration : float
        Factor on the relief (not on the shape).
    paint : (low, high), optional
        Colour by height in mm between these limits instead of clay.

    Returns
    -------
    (h, w, 3) uint8, cut to the finger
    """
    height, relief, weight = upright_heights(result, frame, exaggeration)
    colours = shade(height, relief, weight, frame.pitch_mm, np.deg2rad(turn_deg))
    if paint is not None:
        colours = colours * (0.25 + 0.75 * colour(height, *paint).astype(np.float32) / 255.0) * np.float32(1.25)
    weight = _smooth_edge(weight)
    height, weight, colours = _turn(height, weight, colours, np.deg2rad(turn_deg), zoom=_SUPERSAMPLING)
    view, alpha = _tilt(height, weight, colours, np.deg2rad(tilt_deg), frame.pitch_mm / _SUPERSAMPLING)
    picture = view + np.float32(_BACKGROUND) * (1.0 - alpha[..., None])
    picture = _cut(picture, alpha, margin=12 * _SUPERSAMPLING)
    size = (picture.shape[1] // _SUPERSAMPLING, picture.shape[0] // _SUPERSAMPLING)
    return _bytes(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.float32))


def _smooth_edge(weight: FloatArray) -> FloatArray:
    """Round the staircase of the mask's edge, staying inside it, so that steep flanks do not end in a fringe."""
    blurred = cv2.GaussianBlur(weight, (0, 0), 2.0, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(np.clip((blurred - 0.4) / 0.6, 0.0, 1.0), dtype=np.float32)


def _turn(
    height: FloatArray, weight: FloatArray, colours: FloatArray, angle_rad: float, zoom: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotate about the middle into a square frame that holds every direction, `zoom` times finer."""
    rows, columns = weight.shape
    side = int(np.ceil(np.hypot(rows, columns))) * zoom
    cos, sin = np.cos(angle_rad) / zoom, np.sin(angle_rad) / zoom
    linear = np.array([[cos, -sin], [sin, cos]])
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    shift = middle - linear @ np.array([(side - 1) / 2, (side - 1) / 2])
    matrix = np.column_stack([linear, shift])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    share = cv2.warpAffine(weight, matrix, (side, side), flags=flags)
    moved = cv2.warpAffine(height, matrix, (side, side), flags=flags)
    coloured = cv2.warpAffine(colours, matrix, (side, side), flags=flags)
    inside = share > 0.5
    filled = np.where(inside, moved, np.float32(np.nan)).astype(np.float32)
    return filled, inside.astype(np.float32), np.asarray(coloured * inside[..., None], dtype=np.float32)


def _tilt(
    height: FloatArray, weight: FloatArray, colours: FloatArray, tilt_rad: float, pitch_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Floating horizon: premultiplied colours and coverage of the tilted view."""
    rows, columns = weight.shape
    cos, sin = float(np.cos(tilt_rad)), float(np.sin(tilt_rad))
    depth = np.arange(rows, dtype=np.float32)[:, None]
    lift = np.where(np.isfinite(height), height / np.float32(pitch_mm), np.float32(-1e6))
    screen = depth * np.float32(cos) - lift * np.float32(sin)  # downwards on the screen; the front is the last row
    horizon = np.minimum.accumulate(screen[::-1], axis=0)  # (rows, columns), from the front to the back
    seen = horizon < rows * 2
    if not bool(seen.any()):
        return colours, weight
    top, bottom = int(np.floor(horizon[seen].min())) - 2, int(np.ceil(horizon[seen].max())) + 2
    lines = np.arange(top, bottom, dtype=np.float32)
    source = np.full((lines.size, columns), -10.0, dtype=np.float32)
    for column in np.flatnonzero(seen.any(axis=0)):
        front = int(np.argmax(seen[:, column]))
        line = horizon[front:, column]
        new = np.concatenate([[True], line[1:] < line[:-1]])
        places = (rows - 1 - front - np.flatnonzero(new)).astype(np.float32)
        source[:, column] = np.interp(lines, line[new][::-1], places[::-1], left=-10.0, right=-10.0)
    across = np.broadcast_to(np.arange(columns, dtype=np.float32), source.shape)
    view = cv2.remap(np.dstack([colours, weight]), np.ascontiguousarray(across), source, cv2.INTER_LINEAR)
    return np.asarray(view[..., :3], dtype=np.float32), np.asarray(view[..., 3], dtype=np.float32)


def _cut(picture: FloatArray, alpha: FloatArray, margin: int) -> FloatArray:
    rows, columns = np.flatnonzero(alpha.max(axis=1) > 0.02), np.flatnonzero(alpha.max(axis=0) > 0.02)
    if rows.size == 0:
        return picture
    padded = np.pad(
        picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1],
        ((margin, margin), (margin, margin), (0, 0)),
        constant_values=_BACKGROUND,
    )
    return np.asarray(padded, dtype=np.float32)


def _bytes(picture: FloatArray) -> NDArray[np.uint8]:
    return np.asarray(np.round(np.clip(picture, 0.0, 1.0) * 255).astype(np.uint8))
