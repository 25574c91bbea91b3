"""Small pictures for people: resampled upright, coloured, outlined, encoded.

Everything here is a preview. The data themselves are written by :mod:`splitknit.report.result`.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.model import BoolArray, FloatArray, Reconstruction

ColourArray = NDArray[np.uint8]
"""(H, W, 3) red, green, blue."""

PAPER = (255, 255, 255)
ORANGE = (213, 94, 0)
BLUE = (0, 114, 178)
SKY = (86, 180, 233)
"""Colours that stay apart for colour-blind readers (Okabe and Ito 2008)."""

_CIVIDIS = np.array(
    [
        (0, 34, 78), (8, 51, 112), (53, 69, 108), (79, 87, 108), (102, 105, 112), (125, 124, 120),
        (148, 142, 119), (174, 163, 113), (200, 184, 102), (229, 207, 82), (254, 232, 56),
    ],
    dtype=np.float64,
)  # fmt: skip
"""Eleven stops of the cividis map (Nunez, Anderton and Renslow 2018)."""

_DIVERGING = np.array([(5, 48, 97), (67, 147, 195), (247, 247, 247), (253, 174, 97), (165, 60, 10)], dtype=np.float64)
"""Blue for low, white for zero, orange for high."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A small upright frame over a part of a large input."""

    input_from_picture: NDArray[np.float64]
    """(3, 3) on (column, row, 1)."""
    size: tuple[int, int]
    """Rows, columns of the picture."""
    pitch_mm: float
    """Size of one picture pixel."""


def upright_frame(result: Reconstruction, longest: int, margin_mm: float = 0.8) -> Frame:
    """Return the upright frame that holds the mask with a margin and has at most `longest` pixels a side."""
    rows, columns = np.nonzero(_thin(result.mask, 4))
    corners = np.stack([columns * 4.0 + 1.5, rows * 4.0 + 1.5, np.ones(rows.size)])
    upright = np.linalg.inv(result.input_from_upright) @ corners
    margin = margin_mm / result.pitch_mm + 4.0
    left, right = float(upright[0].min()) - margin, float(upright[0].max()) + margin
    top, bottom = float(upright[1].min()) - margin, float(upright[1].max()) + margin
    step = max(1.0, max(right - left, bottom - top) / longest)
    size = (int((bottom - top) / step), int((right - left) / step))
    to_upright = np.array([[step, 0.0, left + (step - 1) / 2], [0.0, step, top + (step - 1) / 2], [0.0, 0.0, 1.0]])
    return Frame(result.input_from_upright @ to_upright, size, result.pitch_mm * step)


def upright_turn(result: Reconstruction) -> NDArray[np.float64]:
    """Rotation (2, 2) that takes (x, y) of the rig's frame to the upright finger's (x right, y to the tip)."""
    turn = np.linalg.inv(result.input_from_upright[:2, :2])
    turn = turn / np.sqrt(abs(np.linalg.det(turn)))
    flip = np.diag([1.0, -1.0])  # rows run down, y runs up
    return np.asarray(flip @ turn @ flip)


def to_frame(field: NDArray[np.generic], mask: BoolArray, frame: Frame) -> tuple[FloatArray, FloatArray]:
    """Average `field` (H, W) or (H, W, C) over the picture's pixels, `mask` aware.

    Returns
    -------
    values : (h, w) or (h, w, C) float32, zero where the weight is zero
    weight : (h, w) float32 in [0, 1], the fraction of the pixel inside the mask
    """
    small, fraction, input_from_small = _binned(field, mask, frame)
    small_from_picture = np.linalg.inv(input_from_small) @ frame.input_from_picture
    weight = _warp_linear(fraction, small_from_picture, frame.size)
    values = _warp_linear(small, small_from_picture, frame.size)
    divisor = np.maximum(weight, np.float32(1e-3))
    values /= divisor if values.ndim == 2 else divisor[..., None]
    values[weight <= 1e-3] = 0.0
    return values, np.clip(weight, 0.0, 1.0).astype(np.float32)


def _binned(
    field: NDArray[np.generic], mask: BoolArray, frame: Frame
) -> tuple[FloatArray, FloatArray, NDArray[np.float64]]:
    """Masked values and their weights, averaged over whole blocks no larger than the picture's pixel."""
    step = float(np.sqrt(abs(np.linalg.det(frame.input_from_picture[:2, :2]))))
    factor = max(1, int(step + 0.01))
    height, width = frame.size
    corners = frame.input_from_picture @ np.array(
        [[-1.0, width, -1.0, width], [-1.0, -1.0, height, height], [1.0, 1.0, 1.0, 1.0]]
    )
    low = np.maximum(np.floor(corners[:2].min(axis=1)).astype(int) - factor, 0)
    high = np.minimum(np.ceil(corners[:2].max(axis=1)).astype(int) + factor, (mask.shape[1], mask.shape[0]))
    inside = mask[low[1] : high[1], low[0] : high[0]]
    if inside.size == 0:
        raise BadInput("the picture's frame lies outside the input.")
    part = field[low[1] : high[1], low[0] : high[0]]
    values = np.where(inside if part.ndim == 2 else inside[..., None], part, 0).astype(np.float32)
    fraction = inside.astype(np.float32)
    origin = np.array(
        [[factor, 0.0, low[0] + (factor - 1) / 2], [0.0, factor, low[1] + (factor - 1) / 2], [0.0, 0.0, 1.0]]
    )
    if factor > 1:
        pad = ((0, -part.shape[0] % factor), (0, -part.shape[1] % factor), (0, 0))
        values = np.pad(values, pad[: values.ndim])
        fraction = np.pad(fraction, pad[:2])
        small = (fraction.shape[1] // factor, fraction.shape[0] // factor)
        values = np.asarray(cv2.resize(values, small, interpolation=cv2.INTER_AREA), dtype=np.float32)
        fraction = np.asarray(cv2.resize(fraction, small, interpolation=cv2.INTER_AREA), dtype=np.float32)
    return values, fraction, origin


def _warp_linear(image: FloatArray, source_from_target: NDArray[np.float64], size: tuple[int, int]) -> FloatArray:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(image, source_from_target[:2], (size[1], size[0]), flags=flags)
    return np.asarray(warped, dtype=np.float32)


def _thin(mask: BoolArray, step: int) -> BoolArray:
    """Every block of `step` pixels that the mask touches."""
    height, width = mask.shape
    padded = np.pad(mask, ((0, -height % step), (0, -width % step)))
    return np.asarray(padded.reshape(padded.shape[0] // step, step, -1, step).any(axis=(1, 3)))


def colour(values: FloatArray, low: float, high: float, *, diverging: bool = False) -> ColourArray:
    """Colour `values` between `low` and `high`: cividis, or blue-white-orange where zero matters."""
    stops = _DIVERGING if diverging else _CIVIDIS
    positions = np.linspace(0.0, 255.0, len(stops))
    table = np.stack([np.interp(np.arange(256), positions, stops[:, c]) for c in range(3)], axis=1)
    index = np.clip(np.nan_to_num((values - low) / max(high - low, 1e-12) * 255.0), 0, 255).astype(np.uint8)
    return np.asarray(np.round(table).astype(np.uint8)[index])


def on_paper(picture: ColourArray, weight: FloatArray, paper: Sequence[int] = PAPER) -> ColourArray:
    """Blend `picture` into a plain background where `weight` is below one."""
    alpha = weight[..., None]
    background = np.asarray(paper, dtype=np.float32)
    return np.round(picture * alpha + background * (1.0 - alpha)).astype(np.uint8)


def normal_colours(normals: FloatArray) -> ColourArray:
    """Colour unit normals the usual way: red = x right, green = y up, blue = z towards the camera."""
    return np.clip(np.round((normals + 1.0) * np.float32(127.5)), 0, 255).astype(np.uint8)


def grey(values: FloatArray, low: float, high: float) -> ColourArray:
    """Grey values between `low` (black) and `high` (white), as three equal channels."""
    level = np.clip((values - low) / max(high - low, 1e-12) * 255.0, 0, 255).astype(np.uint8)
    return np.repeat(level[..., None], 3, axis=2)


def data_uri(picture: ColourArray | NDArray[np.uint8], *, photo: bool = False) -> str:
    """Encode a picture as a ``data:`` address: PNG, or JPEG for photographs and shaded views."""
    image = picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., ::-1])
    parameters = [cv2.IMWRITE_JPEG_QUALITY, 88] if photo else [cv2.IMWRITE_PNG_COMPRESSION, 6]
    done, data = cv2.imencode(".jpg" if photo else ".png", image, parameters)
    if not done:
        raise RuntimeError("a preview picture could not be encoded")
    kind = "jpeg" if photo else "png"
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
