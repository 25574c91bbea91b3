"""The shadow of a blunt cone as a shape: the hull of two circles, softened by the size of the light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from splitknit.model import BoolArray, FloatArray

Points = NDArray[np.float64]
_RING = 2.0 * np.pi * np.arange(8) / 8
_LIGHT = np.concatenate([np.zeros((1, 2)), 0.75 * np.stack([np.cos(_RING), np.sin(_RING)], axis=1)])
"""(9, 2) points that stand for equal parts of a disc of radius one and have its spread."""
_EDGE_PX = 0.5
"""Softness of an edge by pixels and lens, as a standard deviation."""


@dataclass(frozen=True, slots=True)
class Scale:
    """How large the picture is."""

    px_per_mm: float
    max_pixels: int
    """So many pixels about one outline are looked at, evenly spread."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Everything in pixels."""

    tip: Points
    """(2,) column and row: where the light's middle throws the middle of the nail's tip."""
    tip_radius: float
    """Of the blunt tip's shadow."""
    penumbra: float
    """Radius of the light's image about the tip."""
    base: Points
    """(2,) middle of the cone's base."""
    base_radius: float
    depth: float
    """How much of the light is missing in the full shadow."""

    def darkness(self, places: Points) -> Points:
        """Share of the light that is missing at places (N, 2), column and row."""
        total = np.zeros(len(places))
        for offset in _LIGHT:
            tip = self.tip + self.penumbra * offset
            total += ndtr(
                -hull_distance(places - self.base, tip - self.base, self.base_radius, self.tip_radius) / _EDGE_PX
            )
        return np.asarray(self.depth * total / len(_LIGHT))


def hull_distance(places: Points, other: Points, radius: float, other_radius: float) -> Points:
    """Distance (N,), negative inside, to the hull of a circle about the origin and one about `other` (2,)."""
    length = max(float(np.linalg.norm(other)), 1e-9)
    along = places @ other / length
    beside = np.abs(places[:, 0] * other[1] - places[:, 1] * other[0]) / length
    slope = float(np.clip((radius - other_radius) / length, -0.999, 0.999))
    across = float(np.sqrt(1.0 - slope * slope))
    foot = across * along - slope * beside
    square = beside * beside  # and no hypot, which is slow
    near = np.sqrt(along * along + square) - radius
    far = np.sqrt((along - length) ** 2 + square) - other_radius
    side = across * beside + slope * along - radius
    return np.asarray(np.where(foot < 0, near, np.where(foot > across * length, far, side)))


def fit_shape(
    darkness: FloatArray,
    usable: BoolArray,
    start: Shape,
    scale: Scale,
    common: tuple[float, float] | None = None,
) -> Shape:
    """Fit the shape to the darkness (H, W) about its outer part, by least squares.

    Parameters
    ----------
    darkness : (H, W) share of the light that is missing, about zero outside the shadow
    usable : (H, W), false on the nail
    start : near the truth
    scale : of the picture
    common : radius of the tip's shadow and of the penumbra, where they are known
    """
    shape = start
    for _ in range(2 if common is None else 1):  # the pixels are chosen again once the outline is better known
        places, values = _pixels_about(darkness, usable, shape, scale)
        if len(places) < 20:
            return shape
        shape = _fit((places, values), shape, start, scale.px_per_mm, common)
    return shape


def _fit(
    seen: tuple[Points, Points], first: Shape, start: Shape, px_per_mm: float, common: tuple[float, float] | None
) -> Shape:
    places, values = seen

    def shape_of(v: Points) -> Shape:
        radius, penumbra = common if common is not None else (abs(v[6]), abs(v[7]))
        return Shape(v[0:2], radius, penumbra, v[2:4], abs(v[4]), v[5])

    def residuals(v: Points) -> Points:
        # the base is seldom seen; its place is known from the nail, loosely
        known = [(v[2] - start.base[0]) / px_per_mm, (v[3] - start.base[1]) / px_per_mm]
        known += [(v[4] - start.base_radius) / px_per_mm, (v[5] - 0.97) / 0.05]
        if common is None:
            known += [(v[6] / px_per_mm - 0.15) / 0.15, (v[7] / px_per_mm - 0.15) / 0.15]
        return np.concatenate([shape_of(v).darkness(places) - values, 0.3 * np.array(known)])

    x = np.array([*first.tip, *first.base, first.base_radius, first.depth, first.tip_radius, first.penumbra])
    sizes = np.array([1.0, 1.0, 5.0, 5.0, 5.0, 0.05, 1.0, 1.0])
    size = 8 if common is None else 6
    fit = least_squares(residuals, x[:size], x_scale=sizes[:size], loss="soft_l1", f_scale=0.15, max_nfev=20)
    return shape_of(np.asarray(fit.x))


def _pixels_about(darkness: FloatArray, usable: BoolArray, shape: Shape, scale: Scale) -> tuple[Points, Points]:
    """Columns and rows (N, 2) of pixels near the outline of the outer shadow, and their darkness (N,)."""
    px_per_mm, most = scale.px_per_mm, scale.max_pixels
    arm = shape.tip - shape.base
    length = float(np.linalg.norm(arm))
    margin = 0.7 * px_per_mm + shape.penumbra
    box = np.stack([shape.tip, shape.base + 0.25 * arm])
    reach = margin + shape.base_radius
    low = np.maximum(np.floor(box.min(axis=0) - reach).astype(int), 0)
    high = np.minimum(np.ceil(box.max(axis=0) + reach).astype(int) + 1, np.array(darkness.shape[::-1]))
    if np.any(high - low < 2):
        return np.empty((0, 2)), np.empty(0)
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    places = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
    distance = hull_distance(places - shape.base, arm, shape.base_radius, shape.tip_radius)
    along = (places - shape.base) @ arm / length
    chosen = (np.abs(distance) < margin) & (along > 0.25 * length) & usable[rows.ravel(), columns.ravel()]
    index = np.flatnonzero(chosen)
    # near the tip all pixels count, along the sides as many as there is room for
    near = np.linalg.norm(places[index] - shape.tip, axis=1) < 1.5 * px_per_mm
    index = np.concatenate([_thin(index[near], most), _thin(index[~near], most // 2)])
    values = darkness[rows.ravel()[index], columns.ravel()[index]].astype(np.float64)
    return places[index], np.clip(values, -0.5, 1.2)


def _thin(index: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    return index[:: max(1, -(-index.size // most))]
