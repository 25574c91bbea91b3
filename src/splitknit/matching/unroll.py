"""Where a ridge band's pixels lie in the image: upright, and along the skin instead of the finger plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import height_gradients
from splitknit.model import BoolArray, FloatArray

AnyArray = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True)
class GridSettings:
    """What the grid needs of :class:`splitknit.matching.ridge_band.RidgeBandSettings`, with the same meaning."""

    pitch_mm: float
    """Side of a pixel of the band."""
    slant_deg: float
    """Slopes count as steep as this at most when distances along the skin are summed."""
    unroll: bool
    """Whether distances across the finger are measured along the skin."""


def band_places(  # noqa: PLR0917
    mask: BoolArray,
    shape_mm: FloatArray | None,
    transform: NDArray[np.float64],
    size: tuple[int, int],
    pitch_mm: float,
    settings: GridSettings,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where each pixel of the band lies in the input (columns, rows), and the cosine of the slant there."""
    step = settings.pitch_mm / pitch_mm
    grid_rows, grid_columns = (max(1, int(np.ceil(length / step))) for length in size)
    column = np.arange(grid_columns, dtype=np.float64) * step
    row = np.arange(grid_rows, dtype=np.float64) * step
    if shape_mm is None:
        flat = np.broadcast_to(column, (grid_rows, grid_columns))
        return (*_to_input(flat, row, transform), np.ones(flat.shape, dtype=np.float32))
    # slopes of the shape, on a grid of 0.25 mm and smooth: ridges must not stretch the skin
    reduced = max(1, int(0.25 / pitch_mm))
    small = (max(1, mask.shape[1] // reduced), max(1, mask.shape[0] // reduced))
    weight: AnyArray = cv2.resize(mask.astype(np.float32), small, interpolation=cv2.INTER_AREA)
    height: AnyArray = cv2.resize(np.where(mask, shape_mm, np.float32(0.0)), small, interpolation=cv2.INTER_AREA)
    factor = mask.shape[1] / small[0]
    inside = weight > 0.5
    height = np.where(inside, height / np.maximum(weight, np.float32(0.5)), np.float32(np.nan)).astype(np.float32)
    slopes = height_gradients(height, pitch_mm * factor)
    sigma = 0.6 / (pitch_mm * factor)
    total = np.maximum(blur(inside.astype(np.float32), sigma), np.float32(1e-3))
    limit = np.float32(np.tan(np.deg2rad(settings.slant_deg)))
    x, y = _to_input(np.broadcast_to(column, (grid_rows, grid_columns)), row, transform)
    there = (x + 0.5) / factor - 0.5, (y + 0.5) / factor - 0.5
    known = sample(inside.astype(np.float32), *there) > 0.5
    right, up = (sample(blur(np.clip(s, -2 * limit, 2 * limit), sigma) / total, *there) for s in slopes)
    across = np.where(known, transform[0, 0] * right - transform[1, 0] * up, 0.0)
    along = np.where(known, transform[0, 1] * right - transform[1, 1] * up, 0.0)
    slant_cos = (1.0 / np.sqrt(1.0 + across**2 + along**2)).astype(np.float32)
    if not settings.unroll:
        return x, y, slant_cos
    length = np.sqrt(1.0 + np.clip(across, -limit, limit) ** 2)
    arc = np.cumsum(length, axis=1) - 0.5 * length
    anywhere = np.flatnonzero(known.any(axis=0))
    middle = int(anywhere.mean()) if anywhere.size else grid_columns // 2
    arc -= arc[:, middle : middle + 1]
    first, last = float(arc[:, 0].min()), float(arc[:, -1].max())
    wanted = np.arange(np.floor(first), np.ceil(last) + 1.0)
    source = np.stack([np.interp(wanted, line, column, left=-1e6, right=-1e6) for line in arc])
    slant_cos = sample(
        slant_cos,
        (source / step).astype(np.float32),
        np.broadcast_to(np.arange(grid_rows, dtype=np.float32)[:, None], source.shape),
    )
    return (*_to_input(source, row, transform), slant_cos)


def sample(image: AnyArray, columns: FloatArray, rows: FloatArray) -> FloatArray:
    """Bilinear values of `image` at places; zero beyond its border."""
    result = cv2.remap(
        np.ascontiguousarray(image, dtype=np.float32),
        np.ascontiguousarray(columns, dtype=np.float32),
        np.ascontiguousarray(rows, dtype=np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=0.0,
    )
    return np.asarray(result, dtype=np.float32)


def blur(image: AnyArray, sigma: float) -> FloatArray:
    """Gaussian mean (H, W) with zeros beyond the border; `sigma` in pixels."""
    if sigma < 0.2:
        return np.asarray(image, dtype=np.float32)
    result = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(result, dtype=np.float32)


def _to_input(
    columns: NDArray[np.float64], rows: NDArray[np.float64], transform: NDArray[np.float64]
) -> tuple[FloatArray, FloatArray]:
    x = transform[0, 0] * columns + transform[0, 1] * rows[:, None] + transform[0, 2]
    y = transform[1, 0] * columns + transform[1, 1] * rows[:, None] + transform[1, 2]
    return x.astype(np.float32), y.astype(np.float32)
