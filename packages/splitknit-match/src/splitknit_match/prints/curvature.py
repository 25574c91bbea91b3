"""Curvature of the skin: surface fits in a small window, the Weingarten matrix, and the shape index.

A polynomial is fitted by least squares to the window around every pixel. Inside the mask that is a convolution with
fixed separable kernels (Savitzky and Golay 1964); where the window reaches beyond the mask, the fit is made to the
pixels that are there, from the same convolutions of masked monomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from splitknit.errors import check_mask
from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, FloatArray

REFERENCE_PX_PER_MM, WINDOW_PX = 75.7, 15.0
"""Scale at which the thesis gives the window, and its side there: rounded to an odd number of pixels, at least 5."""
LEAST_SHARE = 0.75
"""Fraction of the window that must lie on the finger; elsewhere nothing is known."""
_CHUNK = 20_000
_ALONG_X, _ALONG_Y = (1.0, 0.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0, 0.0)
"""Derivatives of x and y where pixels lie at their pitch."""
_POWERS = {2: [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (0, 0)]}
_POWERS[3] = [*_POWERS[2], (0, 3), (1, 2), (2, 1), (3, 0)]
"""Exponents (column, row) of the terms of a quadratic and a cubic; those of the derivatives come first."""


@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """Curvature of every pixel; NaN where it is not known."""

    k_max: FloatArray
    """(H, W) larger principal curvature, 1/mm; a dip (valley) is positive, a bump (ridge) negative."""
    k_min: FloatArray
    """(H, W) smaller principal curvature, 1/mm."""
    shape_index: FloatArray
    """(H, W) 0 to 1: a ridge 0.75, a valley 0.25, a saddle 0.5."""


def window_side(px_per_mm: float, window_px: float = WINDOW_PX) -> int:
    """Odd number of pixels of the window at this scale."""
    return 2 * max(round((window_px * px_per_mm / REFERENCE_PX_PER_MM - 1.0) / 2.0), 2) + 1


def curvature(
    height_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    xy_mm: tuple[FloatArray, FloatArray] | None = None,
    *,
    window_px: float = WINDOW_PX,
    degree: Literal[2, 3] = 2,
) -> Curvature:
    """Principal curvatures and shape index of a surface.

    `height_mm`: (H, W) float32, ridges and shape together, ignored outside `mask`; `xy_mm`: x and y (H, W) of the
    surface points, for perspective cameras; `degree`: of the fitted polynomial. Raises BadInput if shapes disagree, or
    the mask is empty. Source: the thesis, section 5.5, eq. 5.3; the Weingarten matrix is the
    first fundamental form's inverse times the second (do Carmo 1976, section 3.3).
    """
    mask = check_mask(mask, (height_mm.shape[0], height_mm.shape[1]))
    side = window_side(1.0 / pitch_mm, window_px)
    box = bounding_box(mask, side // 2 + 1)
    inside = mask[box] & np.isfinite(height_mm[box])
    one = inside.astype(np.float32)
    fractions = _blurred(one, [1.0] * side, [1.0] * side)
    known = inside & (fractions >= LEAST_SHARE * side * side)
    edge = np.flatnonzero((known & (fractions < side * side - 0.5)).ravel())
    # monomials of the offset, one at the window's edge
    offset = np.arange(-(side // 2), side // 2 + 1) / (side // 2)
    powers, orders = _POWERS[degree], 2 * degree + 1
    taps = [list(offset**k) for k in range(orders)]
    total_taps = np.array(taps).sum(axis=1)
    interior = np.linalg.inv([[total_taps[i + k] * total_taps[j + m] for k, m in powers] for i, j in powers])

    def moments(image: FloatArray, wanted: list[tuple[int, int]]) -> dict[tuple[int, int], FloatArray]:
        return {(i, j): _blurred(image, taps[i], taps[j]) for i, j in wanted}

    normal = np.empty((edge.size, len(powers), len(powers)))
    if edge.size:
        masked = moments(one, [(i, j) for i in range(orders) for j in range(orders - i)])
        for a, (i, j) in enumerate(powers):
            for b, (k, m) in enumerate(powers):
                normal[:, a, b] = masked[i + k, j + m].ravel()[edge]
        # a touch of ridge regression: what the pixels there do not determine stays small
        for a, power in enumerate(powers):
            normal[:, a, a] += (sum(power) > 1) * 1e-4 * masked[0, 0].ravel()[edge].astype(float)
    unit = pitch_mm * (side // 2)
    factors = (1 / unit, -1 / unit, 2 / unit**2, -1 / unit**2, 2 / unit**2)  # rows run downwards

    def fit(whole: FloatArray) -> list[FloatArray]:
        """First derivatives right and up, second right-right, right-up and up-up, per mm, at every pixel."""
        field = whole[box]
        # about zero, so that float32 keeps what matters
        values = np.where(inside, field - np.float32(field[inside].mean()), 0.0).astype(np.float32)
        sums = moments(values, powers)
        results = []
        for term in range(5):
            total = np.zeros(values.shape, dtype=np.float32)
            for power, weight in zip(powers, interior[term], strict=True):
                if abs(weight) > 1e-12:
                    total += np.float32(weight) * sums[power]
            results.append(total)
        right = np.stack([sums[power].ravel()[edge] for power in powers], axis=1).astype(float)
        for start in range(0, edge.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            solved = np.linalg.solve(normal[part], right[part][..., None])[..., 0]
            for term in range(5):
                results[term].ravel()[edge[part]] = solved[:, term]
        return [result * np.float32(factor) for result, factor in zip(results, factors, strict=True)]

    x, y = (_ALONG_X, _ALONG_Y) if xy_mm is None else map(fit, xy_mm)
    results = []
    for field in _principal(x, y, fit(height_mm)):
        whole = np.full(mask.shape, np.nan, dtype=np.float32)
        whole[box] = np.where(known, field, np.nan)
        results.append(whole)
    return Curvature(*results)


def _blurred(image: FloatArray, across: list[float], down: list[float]) -> FloatArray:
    """Correlation with a separable kernel, zeros beyond the border."""
    x, y = np.array(across, dtype=np.float32), np.array(down, dtype=np.float32)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, x, y, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)


def _principal(x: Sequence[Any], y: Sequence[Any], z: Sequence[Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Principal curvatures (larger, smaller) and the shape index of (5.3), of the derivatives that a fit gives."""
    e, f, g = (x[a] * x[b] + y[a] * y[b] + z[a] * z[b] for a, b in ((0, 0), (0, 1), (1, 1)))
    normal = y[0] * z[1] - z[0] * y[1], z[0] * x[1] - x[0] * z[1], x[0] * y[1] - y[0] * x[1]
    length = np.maximum(np.sqrt(sum(part * part for part in normal)), 1e-12)
    second_e, second_f, second_g = (
        (normal[0] * x[k] + normal[1] * y[k] + normal[2] * z[k]) / length for k in (2, 3, 4)
    )
    inverse = 1.0 / np.maximum(e * g - f * f, 1e-12)
    # half the trace and the determinant of the Weingarten matrix
    mean = 0.5 * (e * second_g - 2.0 * f * second_f + g * second_e) * inverse
    gauss = (second_e * second_g - second_f * second_f) * inverse
    root = np.sqrt(np.maximum(mean * mean - gauss, 0.0))
    index = 0.5 - np.arctan2(mean, root) * (1.0 / np.pi)
    return mean + root, mean - root, index
