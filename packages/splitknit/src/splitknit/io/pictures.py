"""Small pictures for people: resampled upright, coloured, outlined, encoded."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import bounding_box
from splitknit.io.images import png_bytes
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.reconstruction import Reconstruction

ColourArray = NDArray[np.uint8]
"""(H, W, 3) red, green, blue."""

PAPER = (255, 255, 255)
"""White. Source: definition."""
ORANGE = (213, 94, 0)
"""A colour that colour-blind readers can distinguish from `BLUE` and `SKY`. Source: Okabe and Ito
2008."""
BLUE = (0, 114, 178)
"""As `ORANGE`. Source: Okabe and Ito 2008."""
SKY = (86, 180, 233)
"""As `ORANGE`. Source: Okabe and Ito 2008."""


@dataclass(frozen=True, slots=True, eq=False)
class PictureFrame:
    """A small upright frame over a part of a large input."""

    input_from_picture: Array  # (3, 3) on (column, row, 1)
    size: tuple[int, int]  # rows, columns of the picture
    pitch_mm: float  # size of one picture pixel


def upright_frame(result: Reconstruction, longest: int) -> PictureFrame:
    """Return the upright frame that holds the mask with a margin of 0.8 mm and has at most
    `longest` pixels a side."""
    margin = 0.8 / result.pitch_mm + 4.0
    (left, top), (right, bottom) = np.add(
        upright_limits(result), ((-margin, -margin), (margin, margin))
    ).tolist()
    step = max(1.0, max(right - left, bottom - top) / longest)
    size = (int((bottom - top) / step), int((right - left) / step))
    to_upright = np.array(
        [[step, 0.0, left + (step - 1) / 2], [0.0, step, top + (step - 1) / 2], [0.0, 0.0, 1.0]]
    )
    return PictureFrame(result.input_from_upright @ to_upright, size, result.pitch_mm * step)


def upright_limits(result: Reconstruction) -> Array:
    """Smallest and largest (column, row), in pixels of the upright frame, that the mask reaches,
    (2, 2)."""
    rows = np.flatnonzero(result.mask.any(axis=1))
    first = result.mask[rows].argmax(axis=1)
    last = result.mask.shape[1] - 1 - result.mask[rows, ::-1].argmax(axis=1)
    points = np.stack([np.concatenate([first, last]), np.concatenate([rows, rows])])
    from_input = np.linalg.inv(result.input_from_upright)
    upright = from_input[:2, :2] @ points + from_input[:2, 2:]
    return np.stack([upright.min(axis=1), upright.max(axis=1)])


def upright_turn(input_from_upright: NDArray[np.floating]) -> Array:
    """Rotation (2, 2) that takes (x, y) of the rig's frame to the upright finger's (x right, y to
    the tip)."""
    turn = np.linalg.inv(input_from_upright[:2, :2])
    turn = turn / np.sqrt(abs(np.linalg.det(turn)))
    flip = np.diag([1.0, -1.0])  # rows run down, y runs up
    return np.asarray(flip @ turn @ flip)


def upright_places(
    shape: tuple[int, int],
    pitch_mm: float,
    input_from_upright: NDArray[np.floating],
    part: tuple[slice, slice],
    xy_mm: tuple[FloatArray, FloatArray] | None,
) -> tuple[FloatArray, FloatArray]:
    """x and y (h, w) of a part of a camera's pixel grid (H, W) in the upright finger's frame;
    `xy_mm`: those of a perspective camera in the rig's frame, (H, W)."""
    if xy_mm is None:
        height, width = shape
        columns = np.arange(width, dtype=np.float32)
        rows = np.arange(height, dtype=np.float32)
        x = ((columns - (width - 1) / 2) * pitch_mm)[None, part[1]]
        y = (((height - 1) / 2 - rows) * pitch_mm)[part[0], None]
    else:
        x, y = (field[part] for field in xy_mm)
    turn = upright_turn(input_from_upright).astype(np.float32)
    return turn[0, 0] * x + turn[0, 1] * y, turn[1, 0] * x + turn[1, 1] * y


def to_frame(
    field: NDArray[np.generic], mask: BoolArray, frame: PictureFrame
) -> tuple[FloatArray, FloatArray]:
    """Average `field` (H, W) or (H, W, C) over the picture's pixels inside `mask`. Returns (h, w)
    or (h, w, C) float32, zero where nothing is inside; and (h, w), the fraction of each pixel
    inside the mask.
    """
    (values,), weight = fields_to_frame([field], mask, frame)
    return values, weight


def fields_to_frame(
    fields: Sequence[NDArray[np.generic]], mask: BoolArray, frame: PictureFrame
) -> tuple[list[FloatArray], FloatArray]:
    """Several fields of one mask, as :func:`to_frame` averages them, and their weight."""
    step = float(np.sqrt(abs(np.linalg.det(frame.input_from_picture[:2, :2]))))
    box = bounding_box(mask) if mask.any() else (slice(0, 1), slice(0, 1))
    inside = mask[box].view(np.uint8)
    # first means over blocks of nearly the picture's pixel, then bilinear
    size = [max(1, round(n / max(1.0, step))) for n in inside.shape[::-1]]
    input_from_block = np.eye(3)
    for axis, part in enumerate(box[::-1]):
        side = inside.shape[1 - axis] / size[axis]
        input_from_block[axis, axis] = side
        input_from_block[axis, 2] = part.start + (side - 1) / 2
    block_from_picture = (np.linalg.inv(input_from_block) @ frame.input_from_picture)[:2]

    def averaged(field: NDArray[np.generic]) -> FloatArray:
        known = cv2.copyTo(field.astype(np.float32, copy=False), inside)
        blocks = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(blocks, block_from_picture, frame.size[::-1], flags=flags))

    weight = averaged(inside)
    divisor = np.maximum(weight, 1e-3)
    averages = []
    for field in fields:
        values = averaged(field[box])
        values /= divisor if values.ndim == 2 else divisor[..., None]
        values[weight <= 1e-3] = 0.0
        averages.append(values)
    return averages, np.clip(weight, 0.0, 1.0)


def colour(values: FloatArray, low: float, high: float, *, diverging: bool = False) -> ColourArray:
    """Colour `values` between `low` and `high`: cividis, or blue-white-orange where zero
    matters."""
    index = np.clip(np.nan_to_num((values - low) / max(high - low, 1e-12) * 255.0), 0, 255).astype(
        np.uint8
    )
    return np.asarray(_colours(diverging)[index])


@cache
def _colours(diverging: bool) -> ColourArray:
    """(256, 3) of a scale; OpenCV would compute it for every picture."""
    index = np.arange(256)
    if not diverging:
        scale = cv2.applyColorMap(index.astype(np.uint8)[None], cv2.COLORMAP_CIVIDIS)
        return np.asarray(scale[0, :, ::-1], dtype=np.uint8)
    # blue for low, white for zero, orange for high
    stops = ((5, 48, 97), (67, 147, 195), (247, 247, 247), (253, 174, 97), (165, 60, 10))
    positions = np.linspace(0.0, 255.0, len(stops))
    table = np.stack([np.interp(index, positions, c) for c in zip(*stops, strict=True)], axis=1)
    return np.round(table).astype(np.uint8)


def on_paper(picture: ColourArray, weight: FloatArray) -> ColourArray:
    """Blend `picture` into a plain background where `weight` is below one."""
    alpha = weight[..., None]
    return np.round(picture * alpha + np.asarray(PAPER, dtype=np.float32) * (1.0 - alpha)).astype(
        np.uint8
    )


def normal_colours(normals: FloatArray) -> ColourArray:
    """Colour unit normals the usual way: red = x right, green = y up, blue = z towards the
    camera."""
    return np.clip(np.round((normals + 1.0) * 127.5), 0, 255).astype(np.uint8)


def data_uri(picture: ColourArray | NDArray[np.uint8], *, photo: bool = False) -> str:
    """Encode a picture as a ``data:`` address: PNG, or JPEG for photographs and shaded views."""
    if photo:
        kind = "jpeg"
        data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
    # maps repeat few colours: without row filters they are smaller than at level 6, in a fifth of
    # the time
    else:
        kind = "png"
        data = png_bytes(picture, cv2.IMWRITE_PNG_STRATEGY_DEFAULT, cv2.IMWRITE_PNG_FILTER_NONE)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
