"""Curvature of the skin: surface fits in a small window, the Weingarten matrix, and the shape
index.

A polynomial is fitted by least squares to the window around every pixel. Inside the mask that is a
convolution with fixed separable kernels (Savitzky and Golay 1964); where the window reaches beyond
the mask, the fit is made to the pixels that are there, from the same convolutions of masked
monomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.imaging.geometry import bounding_box
from splitknit.model import Array, BoolArray, FloatArray

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis gives the window. Source: thesis."""
WINDOW_PX = 15.0
"""Side of the window at that scale; rounded to an odd number of pixels, at least 5. Source: thesis.
"""
_AT_PITCH = ((1.0, 0.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0, 0.0))
"""Derivatives of x and y where pixels lie at their pitch. Source: definition."""
_POWERS = {2: [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (0, 0)]}
_POWERS[3] = [*_POWERS[2], (0, 3), (1, 2), (2, 1), (3, 0)]
"""Exponents (column, row) of the terms of a quadratic and a cubic; those of the derivatives come
first. Source: definition."""


@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """Curvature of every pixel; NaN where it is not known."""

    k_max: FloatArray
    """(H, W) larger principal curvature, 1/mm; a dip (valley) is positive, a bump (ridge) negative.
    """
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

    `height_mm`: (H, W) float32, ridges and shape together, ignored outside `mask`; `xy_mm`: x and y
    (H, W) of the surface points, for perspective cameras; `degree`: of the fitted polynomial.
    Raises BadInput if shapes disagree, or the mask is empty. Source: the thesis, section 5.5, eq.
    5.3; the Weingarten matrix is the first fundamental form's inverse times the second (do Carmo
    1976, section 3.3).
    """
    mask = check_mask(mask, height_mm.shape)
    side = window_side(1.0 / pitch_mm, window_px)
    box = bounding_box(mask, side // 2 + 1)
    inside = mask[box] & np.isfinite(height_mm[box])
    weight = inside.astype(np.float32)
    # monomials of the offset, one at the window's edge
    offset = np.arange(-(side // 2), side // 2 + 1) / (side // 2)
    powers = _POWERS[degree]
    taps = [offset**k for k in range(2 * degree + 1)]
    covered = windowed(weight, taps[0], taps[0])
    # fraction of the window that must lie on the finger; elsewhere the curvature is unknown
    known = inside & (covered >= 0.75 * side * side)
    edge = np.nonzero(known & (covered < side * side - 0.5))
    total = np.sum(taps, axis=1)
    interior = np.linalg.inv([[total[i + k] * total[j + m] for k, m in powers] for i, j in powers])
    normal = normal_matrices(weight, taps, powers, edge)
    # a touch of ridge regression: what the pixels there do not determine stays small
    curved = np.array([sum(power) > 1 for power in powers])
    constant = powers.index((0, 0))
    normal += 1e-4 * normal[:, [[constant]], [[constant]]] * np.diag(curved)
    unit = pitch_mm * (side // 2)
    factors = (1 / unit, -1 / unit, 2 / unit**2, -1 / unit**2, 2 / unit**2)  # rows run downwards

    def fit(whole: FloatArray) -> list[FloatArray]:
        """First derivatives right and up, second right-right, right-up and up-up, per mm, at every
        pixel."""
        field = whole[box]
        # about zero, so that float32 keeps what matters
        values = np.where(inside, field - np.float32(field[inside].mean()), 0.0).astype(np.float32)
        sums = [windowed(values, taps[i], taps[j]) for i, j in powers]
        right = np.stack([part[edge] for part in sums], axis=1)
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        results = []
        for term, factor in enumerate(factors):
            total = np.tensordot(interior[term].astype(np.float32), sums, 1)
            total[edge] = solved[:, term]
            results.append(total * np.float32(factor))
        return results

    x, y = map(fit, xy_mm) if xy_mm else _AT_PITCH
    results = []
    for field in _principal(x, y, fit(height_mm)):
        whole = np.full(mask.shape, np.nan, dtype=np.float32)
        whole[box] = np.where(known, field, np.nan)
        results.append(whole)
    return Curvature(*results)


def windowed(image: FloatArray, across: Array, down: Array) -> FloatArray:
    """Correlation (H, W) with a separable kernel, zeros beyond the border."""
    kernels = across.astype(np.float32), down.astype(np.float32)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, *kernels, borderType=cv2.BORDER_CONSTANT))


def normal_matrices(
    weight: FloatArray,
    taps: list[Array],
    powers: list[tuple[int, int]],
    at: tuple[NDArray[np.intp], ...],
) -> Array:
    """(N, P, P) normal matrices of local polynomials, fitted at pixels `at` to what has weight (H,
    W).

    `taps`: the window times powers of the offset; `powers`: exponents (column, row) of the P terms.
    """
    products = {(i + k, j + m) for i, j in powers for k, m in powers}
    sums = {(i, j): windowed(weight, taps[i], taps[j])[at] for i, j in products}
    matrices = [[sums[i + k, j + m] for k, m in powers] for i, j in powers]
    return np.moveaxis(np.array(matrices, dtype=float), 2, 0)


def _principal(
    x: Sequence[Any], y: Sequence[Any], z: Sequence[Any]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Principal curvatures (larger, smaller) and the shape index of (5.3), of the derivatives that
    a fit gives."""
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
