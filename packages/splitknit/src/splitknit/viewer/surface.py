"""A result's surface in the upright frame, and sections between two points of it.

Places are those of ``phalange.ply``: x right, y to the fingertip, z to the camera. All lengths are in mm; where the
result's scale is unknown, of a scale of 1 px/mm, so that the same numbers are pixels (`unit`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.io.pictures import upright_turn
from splitknit.model import FloatArray, Reconstruction
from splitknit.units import LengthUnit

_FARTHEST = 40_000.0  # mm or pixels: no place of a surface is as far from the origin
_RIDGE_SIGMA_MM = 0.32
_MAX_SAMPLES = 20_000
_REMAP = 16_384  # points that OpenCV samples at once
_Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ResultSurface:
    """The part of a result around its mask; fields are (h, w), NaN outside."""

    x_mm: FloatArray
    y_mm: FloatArray
    height_mm: FloatArray
    ridge_mm: FloatArray
    pitch_mm: float
    turn: _Values
    """(2, 2): from (x, y) of the rig's frame to the upright one."""
    corner_mm: _Values
    """(2,) x and y of the first pixel if the camera's rays were parallel."""
    unit: LengthUnit

    def locate(self, x_mm: _Values, y_mm: _Values) -> _Values:
        """(2, N) column and row where the surface has these x and y; iterated where the rays spread."""
        wanted = np.stack([x_mm, y_mm])
        place = self._steps(wanted - self.corner_mm[:, None])
        for _ in range(4):
            there = np.stack([sample(self.x_mm, place), sample(self.y_mm, place)])
            place = place + self._steps(np.nan_to_num(wanted - there))
        return place

    def _steps(self, vectors_mm: _Values) -> _Values:
        """Columns and rows (2, N) of x and y (2, N)."""
        right, up = self.turn.T @ vectors_mm / self.pitch_mm
        return np.stack([right, -up])


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A cut through the surface between two points, and its figures."""

    along_mm: _Values  # (N,) distance in the finger plane from the first point
    x_mm: _Values
    y_mm: _Values
    height_mm: _Values  # (N,), NaN where there is no surface
    figures: dict[str, float | None]


def surface_in(result: Reconstruction) -> ResultSurface:
    """The surface of a result; BadInput if it holds no height."""
    known = result.mask & np.isfinite(result.height_mm)
    require(bool(known.any()), "the result holds no heights; reconstruct the capture again.")
    box, (height, width), pitch = bounding_box(known), known.shape, result.pitch_mm
    turn = upright_turn(result.input_from_upright)
    columns = np.arange(width)[None, box[1]] - (width - 1) / 2
    rows = (height - 1) / 2 - np.arange(height)[box[0], None]
    right: NDArray[Any] = columns * pitch if result.x_mm is None else result.x_mm[box]
    up: NDArray[Any] = rows * pitch if result.y_mm is None else result.y_mm[box]
    x, y = (across * right + along * up for across, along in turn)
    nan = np.float32(np.nan)
    x, y, z, ridge = (
        np.where(known[box], field, nan).astype(np.float32)
        for field in (x, y, result.height_mm[box], np.nan_to_num(result.ridge_mm[box]))
    )
    corner = turn @ np.array([columns[0, 0], rows[0, 0]]) * pitch
    return ResultSurface(x, y, z, ridge, pitch, turn, corner, result.unit)


def section(surface: ResultSurface, start_mm: tuple[float, float], end_mm: tuple[float, float]) -> Section:
    """Cut the surface between two points given by x and y. Raises BadInput if the points are not finite, far away,
    equal, or neither lies on the surface.
    """
    ends = np.array([start_mm, end_mm], dtype=np.float64)
    sound = bool(np.isfinite(ends).all()) and float(np.abs(ends).max()) <= _FARTHEST
    require(sound, "the two points must be finite and on the surface.")
    flat_mm = float(np.hypot(*(ends[1] - ends[0])))
    require(flat_mm >= surface.pitch_mm, "the two points are the same; choose two that are apart.")
    count = int(min(_MAX_SAMPLES, max(2.0, np.ceil(flat_mm / surface.pitch_mm)))) + 1
    fraction = np.linspace(0.0, 1.0, count)
    x, y = (ends[0, axis] + fraction * (ends[1, axis] - ends[0, axis]) for axis in (0, 1))
    place = surface.locate(x, y)
    height, relief = sample(surface.height_mm, place), sample(surface.ridge_mm, place)
    require(bool(np.isfinite(height).any()), "no surface lies between the two points; choose points on the surface.")
    along = fraction * flat_mm
    steps = np.hypot(np.diff(along), np.diff(height))  # NaN beside a gap
    rise = float(height[-1] - height[0])
    figures = {
        "flat_mm": flat_mm,
        "straight_mm": float(np.hypot(flat_mm, rise)),
        "along_surface_mm": float(steps.sum()),
        "height_difference_mm": rise,
        "ridge_period_mm": _ridge_period_mm(along, relief) if surface.unit.known else np.nan,
    }
    return Section(along, x, y, height, {key: value if np.isfinite(value) else None for key, value in figures.items()})


def _ridge_period_mm(along: _Values, relief: _Values) -> float:
    """Mean distance of ridges, counted where they cross the mean of their surroundings; NaN of fewer than two."""
    known, step = np.isfinite(relief), along[1] - along[0]
    weight = _blur(known.astype(np.float64), _RIDGE_SIGMA_MM / step)
    band = np.where(known, relief, 0.0)
    band = np.where(known, band - _blur(band, _RIDGE_SIGMA_MM / step) / np.maximum(weight, 1e-3), 0.0)
    level = 0.35 * float(band[known].std())
    state = np.where(band > level, 1, np.where(band < -level, -1, 0))
    signs = np.flatnonzero(state)
    rising = along[signs[1:][(state[signs[1:]] == 1) & (state[signs[:-1]] == -1)]]
    return float((rising[-1] - rising[0]) / (len(rising) - 1)) if len(rising) > 1 else np.nan


def _blur(values: _Values, sigma: float) -> _Values:
    blurred: Any = cv2.GaussianBlur(values[None], (0, 0), max(sigma, 0.3), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred[0], dtype=np.float64)


def sample(field: FloatArray, place: _Values) -> _Values:
    """Bilinear values (N,) of `field` (h, w) at columns and rows (2, N); NaN beyond its border."""
    column, row = (np.ascontiguousarray(axis[None], dtype=np.float32) for axis in place)
    pieces = [
        cv2.remap(
            field, column[:, k : k + _REMAP], row[:, k : k + _REMAP], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=(float("nan"),),
        )[0]
        for k in range(0, column.shape[1], _REMAP)
    ]  # fmt: skip
    return np.concatenate(pieces).astype(np.float64)
