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
from splitknit.io.parameters import DIVERGING
from splitknit.model import BoolArray, FloatArray, Reconstruction

ColourArray = NDArray[np.uint8]
"""(H, W, 3) red, green, blue."""

PAPER = (255, 255, 255)
"""White. Source: definition."""
ORANGE = (213, 94, 0)
"""A colour that stays apart from `BLUE` and `SKY` for colour-blind readers. Source: Okabe and Ito
2008."""
BLUE = (0, 114, 178)
"""As `ORANGE`. Source: Okabe and Ito 2008."""
SKY = (86, 180, 233)
"""As `ORANGE`. Source: Okabe and Ito 2008."""
_DIVERGING = np.array(DIVERGING, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PictureFrame:
    """A small upright frame over a part of a large input."""

    input_from_picture: NDArray[np.float64]  # (3, 3) on (column, row, 1)
    size: tuple[int, int]  # rows, columns of the picture
    pitch_mm: float  # size of one picture pixel


def upright_frame(result: Reconstruction, longest: int, margin_mm: float = 0.8) -> PictureFrame:
    """Return the upright frame that holds the mask with a margin and has at most `longest` pixels a
    side."""
    margin = margin_mm / result.pitch_mm + 4.0
    (left, top), (right, bottom) = np.add(
        upright_limits(result), ((-margin, -margin), (margin, margin))
    ).tolist()
    step = max(1.0, max(right - left, bottom - top) / longest)
    size = (int((bottom - top) / step), int((right - left) / step))
    to_upright = np.array(
        [[step, 0.0, left + (step - 1) / 2], [0.0, step, top + (step - 1) / 2], [0.0, 0.0, 1.0]]
    )
    return PictureFrame(result.input_from_upright @ to_upright, size, result.pitch_mm * step)


def upright_limits(result: Reconstruction) -> NDArray[np.float64]:
    """Least and largest (column, row) of the upright frame in the mask, pixels, (2, 2)."""
    rows = np.flatnonzero(result.mask.any(axis=1))
    first = result.mask[rows].argmax(axis=1)
    last = result.mask.shape[1] - 1 - result.mask[rows, ::-1].argmax(axis=1)
    points = np.stack([np.concatenate([first, last]), np.concatenate([rows, rows])])
    from_input = np.linalg.inv(result.input_from_upright)
    upright = from_input[:2, :2] @ points + from_input[:2, 2:]
    return np.stack([upright.min(axis=1), upright.max(axis=1)])


def upright_turn(input_from_upright: NDArray[np.floating]) -> NDArray[np.float64]:
    """Rotation (2, 2) that takes (x, y) of the rig's frame to the upright finger's (x right, y to
    the tip)."""
    turn = np.linalg.inv(input_from_upright[:2, :2])
    turn = turn / np.sqrt(abs(np.linalg.det(turn)))
    flip = np.diag([1.0, -1.0])  # rows run down, y runs up
    return np.asarray(flip @ turn @ flip)


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
    factor = max(1, int(step + 0.01))  # side of whole blocks up to the picture's pixel
    rows, columns = bounding_box(mask) if mask.any() else (slice(1), slice(1))
    top, left = (part.start // factor * factor for part in (rows, columns))
    window = slice(top, rows.stop), slice(left, columns.stop)
    x, y = (start + (factor - 1) / 2 for start in (left, top))
    input_from_block = np.array([[factor, 0.0, x], [0.0, factor, y], [0.0, 0.0, 1.0]])
    block_from_picture = (np.linalg.inv(input_from_block) @ frame.input_from_picture)[:2]
    inside = mask[window].view(np.uint8)

    def averaged(field: NDArray[np.generic]) -> FloatArray:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        blocks = _block_means(field, inside, factor)
        return np.asarray(cv2.warpAffine(blocks, block_from_picture, frame.size[::-1], flags=flags))

    weight = averaged(inside)
    divisor = np.maximum(weight, 1e-3)
    averages = []
    for field in fields:
        values = averaged(field[window])
        values /= divisor if values.ndim == 2 else divisor[..., None]
        values[weight <= 1e-3] = 0.0
        averages.append(values)
    return averages, np.clip(weight, 0.0, 1.0)


def _block_means(field: NDArray[np.generic], inside: NDArray[np.uint8], factor: int) -> FloatArray:
    """Mean of a field over blocks, zero outside the mask."""
    rows, columns = inside.shape
    values = np.zeros(
        (rows + -rows % factor, columns + -columns % factor, *field.shape[2:]), dtype=np.float32
    )
    cv2.copyTo(field.astype(np.float32, copy=False), inside, values[:rows, :columns])
    small = (values.shape[1] // factor, values.shape[0] // factor)
    return np.asarray(cv2.resize(values, small, interpolation=cv2.INTER_AREA))


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
    positions = np.linspace(0.0, 255.0, len(_DIVERGING))
    table = np.stack([np.interp(index, positions, _DIVERGING[:, c]) for c in range(3)], axis=1)
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
