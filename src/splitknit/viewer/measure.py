"""Where a ray meets a surface, and what lies between two points of it: always from the result's own values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.viewer.surface import ShownSurface

_RIDGE_SIGMA_MM = 0.32
_MAX_SAMPLES = 20_000
_Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A cut through the surface between two points, and its figures."""

    along_mm: _Values
    """(N,) distance in the finger plane from the first point."""
    x_mm: _Values
    y_mm: _Values
    height_mm: _Values
    """(N,), NaN where there is no surface."""
    relief_um: _Values
    """(N,), NaN likewise."""
    figures: dict[str, float | int | None]


def locate(surface: ShownSurface, x_mm: _Values, y_mm: _Values) -> _Values:
    """(2, N) column and row in the box where the surface has these x and y; iterated where the camera's rays spread."""
    place = surface.grid_of_plan(x_mm, y_mm)
    for _ in range(4):
        seen = np.stack([sample(surface.x_mm, place), sample(surface.y_mm, place)])
        error = np.nan_to_num(np.stack([x_mm, y_mm]) - seen)
        if float(np.abs(error).max(initial=0.0)) < 1e-6:
            break
        back = surface.grid_of_plan(error[0], error[1]) - surface.grid_of_plan(np.zeros(1), np.zeros(1))
        place = place + back
    return place


def pick(
    surface: ShownSurface, origin_mm: _Values, direction: _Values, exaggeration: float = 1.0
) -> tuple[float, float, float] | None:
    """Return the first point of the surface on a ray, or None where the ray misses it.

    Parameters
    ----------
    surface : Surface
    origin_mm : (3,)
    direction : (3,), of any length
    exaggeration : float
        Factor of the relief in the picture that was pointed at; the point returned is on the true surface.

    Raises
    ------
    BadInput
        If the ray is no ray.
    """
    ray = np.concatenate([origin_mm, direction])
    length = float(np.linalg.norm(direction))
    require(bool(np.isfinite(ray).all()) and length > 1e-9, "a ray needs a finite origin and a direction.")
    unit = direction / length
    span = _inside_box(surface, origin_mm, unit, abs(exaggeration - 1.0))
    if span is None:
        return None
    count = int(np.clip((span[1] - span[0]) / (0.5 * surface.pitch_mm), 16, _MAX_SAMPLES))
    t = np.linspace(span[0], span[1], count)
    points = origin_mm[:, None] + unit[:, None] * t
    place = locate(surface, points[0], points[1])
    above = points[2] - _shown(surface, place, exaggeration)
    known = np.isfinite(above)
    crossed = np.flatnonzero(known[:-1] & known[1:] & (np.sign(above[:-1]) != np.sign(above[1:])))
    if crossed.size == 0:
        return None
    k = int(crossed[0])
    fraction = float(above[k] / (above[k] - above[k + 1]))
    x, y = (float(points[axis, k] + fraction * (points[axis, k + 1] - points[axis, k])) for axis in (0, 1))
    z = float(sample(surface.height_mm, locate(surface, np.array([x]), np.array([y])))[0])
    return (x, y, z) if np.isfinite(z) else None


Reading = Callable[[_Values, _Values], tuple[_Values, _Values]]
"""Heights (N,) and relief (N,), mm, at x and y (N,)."""


def section(
    surface: ShownSurface, start_mm: tuple[float, float], end_mm: tuple[float, float], read: Reading | None = None
) -> Section:
    """Cut the surface between two points given by x and y; `read` gives the values of another one in its frame.

    Raises
    ------
    BadInput
        If the points are not finite, far away, equal, or neither lies on the surface.
    """
    ends = np.array([start_mm, end_mm], dtype=np.float64)
    sound = bool(np.isfinite(ends).all()) and float(np.abs(ends).max()) <= surface.longest_mm
    require(sound, "the two points must be finite and on the finger.")
    flat_mm = float(np.hypot(*(ends[1] - ends[0])))
    require(flat_mm >= surface.pitch_mm, "the two points are the same; choose two that are apart.")
    count = int(min(_MAX_SAMPLES, max(2.0, np.ceil(flat_mm / surface.pitch_mm)))) + 1
    fraction = np.linspace(0.0, 1.0, count)
    x, y = (ends[0, axis] + fraction * (ends[1, axis] - ends[0, axis]) for axis in (0, 1))
    height, ridge = (read or _reading(surface))(x, y)
    relief = np.where(np.isfinite(height), surface.um * ridge, np.nan)
    require(bool(np.isfinite(height).any()), "no surface lies between the two points; choose points on the finger.")
    along = fraction * flat_mm
    return Section(along, x, y, height, relief, _figures(along, height, relief, surface.scale_known))


def _reading(surface: ShownSurface) -> Reading:
    """The surface's own values."""

    def read(x_mm: _Values, y_mm: _Values) -> tuple[_Values, _Values]:
        place = locate(surface, x_mm, y_mm)
        return sample(surface.height_mm, place), sample(surface.ridge_mm, place)

    return read


def _figures(along: _Values, height: _Values, relief: _Values, scale_known: bool) -> dict[str, float | int | None]:
    known = np.isfinite(height)
    whole = bool(known[0] and known[-1])
    steps = np.hypot(np.diff(along), np.diff(height))
    both = known[:-1] & known[1:]
    r = relief[known]
    ridges, period = _ridges(along, relief) if scale_known else (None, None)
    rise = float(height[-1] - height[0]) if whole else None
    return {
        "flat_mm": float(along[-1]),
        "straight_mm": None if rise is None else float(np.hypot(along[-1], rise)),
        "along_surface_mm": float(steps.sum()) if bool(both.all()) else None,
        "height_difference_mm": rise,
        "relief_um": float(np.subtract(*np.percentile(r, (95, 5)))),
        "relief_rms_um": float(r.std()),
        "ridges": ridges,
        "ridge_period_mm": period,
        "missing_share": float(1.0 - known.mean()),
    }


def _ridges(along: _Values, relief: _Values) -> tuple[int, float | None]:
    """Count ridges by the crossings of the mean of their surroundings; their mean distance."""
    known = np.isfinite(relief)
    step = along[1] - along[0]
    weight = _blur(known.astype(np.float64), _RIDGE_SIGMA_MM / step)
    band = np.where(known, relief, 0.0)
    band = np.where(known, band - _blur(band, _RIDGE_SIGMA_MM / step) / np.maximum(weight, 1e-3), 0.0)
    level = 0.35 * float(band[known].std())
    if level <= 0:
        return 0, None
    state = np.where(band > level, 1, np.where(band < -level, -1, 0))
    known = np.flatnonzero(state)
    rising = known[1:][(state[known[1:]] == 1) & (state[known[:-1]] == -1)]
    places = along[rising]
    if len(places) < 2:
        return len(places), None
    return len(places), float((places[-1] - places[0]) / (len(places) - 1))


def _blur(values: _Values, sigma: float) -> _Values:
    blurred: Any = cv2.GaussianBlur(values[None], (0, 0), max(sigma, 0.3), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred[0], dtype=np.float64)


def sample(field: FloatArray, place: _Values) -> _Values:
    """Bilinear values (N,) of `field` (h, w) at columns and rows (2, N); NaN beyond its border."""
    column, row = (np.ascontiguousarray(axis[None], dtype=np.float32) for axis in place)
    pieces = [
        cv2.remap(
            field, column[:, k : k + 16_384], row[:, k : k + 16_384], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=(float("nan"),),
        )[0]
        for k in range(0, column.shape[1], 16_384)
    ]  # fmt: skip
    return np.concatenate(pieces).astype(np.float64)


def _shown(surface: ShownSurface, place: _Values, exaggeration: float) -> _Values:
    """Height (N,) in a picture whose relief is exaggerated, less so on steep flanks (as the page's shader does)."""
    height = sample(surface.height_mm, place)
    if exaggeration == 1.0:
        return height
    step = np.array([[1.0], [0.0]])
    slopes = [
        (sample(surface.height_mm, place + d) - sample(surface.height_mm, place - d)) / (2 * surface.pitch_mm)
        for d in (step, step[::-1])
    ]
    facing = 1.0 / (1.0 + np.nan_to_num(slopes[0]) ** 2 + np.nan_to_num(slopes[1]) ** 2)
    fade = np.clip(2.0 * facing, 0.0, 1.0)
    return np.asarray(height + (exaggeration - 1.0) * fade * sample(surface.ridge_mm, place))


def _inside_box(surface: ShownSurface, origin: _Values, unit: _Values, extra: float) -> tuple[float, float] | None:
    """Where a ray enters and leaves the box around the surface."""
    margin = surface.pitch_mm + extra * surface.highest_relief_mm
    near, far = -np.inf, np.inf
    for axis in range(3):
        low, high = surface.low_mm[axis] - margin, surface.high_mm[axis] + margin
        if abs(unit[axis]) < 1e-12:
            if not low <= origin[axis] <= high:
                return None
            continue
        a, b = (low - origin[axis]) / unit[axis], (high - origin[axis]) / unit[axis]
        near, far = max(near, min(a, b)), min(far, max(a, b))
    near = max(near, 0.0)
    return (near, far) if far > near else None
