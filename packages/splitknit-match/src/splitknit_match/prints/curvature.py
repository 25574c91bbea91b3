"""Curvature of the skin: surface fits in a small window, the Weingarten matrix, and the shape index.

A polynomial is fitted by least squares to the window around every pixel. Inside the mask that is a convolution with
fixed separable kernels (Savitzky and Golay 1964); where the window reaches beyond the mask, the fit is made to the
pixels that are there, from the same convolutions of masked monomials.

On a full, symmetric window the second derivatives at its middle are *the same* for a quadratic and a cubic: odd terms
do not enter even derivatives. The two differ in the slopes, and where the window is cut by the mask.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis gives the window."""
_CHUNK = 20_000


@dataclass(frozen=True, slots=True)
class CurvatureSettings(Checked):
    """How surfaces are fitted."""

    window_px: Annotated[float, Limits(0, above=True)] = 15.0
    """Side of the window in pixels at 75.7 px/mm; scales with px_per_mm and is rounded to an odd number, at least 5."""
    degree: Literal[2, 3] = 2
    """2 (quadratic) or 3 (cubic)."""
    least_share: Annotated[float, Limits(0.3, 1)] = 0.75
    """Fraction of the window that must lie on the finger; elsewhere nothing is known."""

    def side(self, px_per_mm: float) -> int:
        """Odd number of pixels of the window at this scale."""
        half = round((self.window_px * px_per_mm / REFERENCE_PX_PER_MM - 1.0) / 2.0)
        return 2 * max(half, 2) + 1


@dataclass(frozen=True, slots=True, eq=False)
class _Curvature:
    """Curvature of every pixel; NaN where it is not known."""

    k_max: FloatArray
    """(H, W) larger principal curvature, 1/mm; a dip (valley) is positive, a bump (ridge) negative."""
    k_min: FloatArray
    """(H, W) smaller principal curvature, 1/mm."""
    shape_index: FloatArray
    """(H, W) 0 to 1: a ridge 0.75, a valley 0.25, a saddle 0.5."""


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """The windows of the fits on a mask."""

    inside: BoolArray
    """(h, w) pixels that count."""
    edge: NDArray[np.intp]
    """(N,) pixels, counted along the rows, whose windows the mask cuts."""
    normal: NDArray[np.float64]
    """(N, T, T) their normal equations."""
    side: int
    degree: int


def curvature(
    height_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    settings: CurvatureSettings | None = None,
    xy_mm: tuple[FloatArray, FloatArray] | None = None,
) -> _Curvature:
    """Principal curvatures and shape index of a surface.

    `height_mm`: (H, W) float32, ridges and shape together, ignored outside `mask`; `xy_mm`: x and y (H, W) of the
    surface points, for perspective cameras. Raises BadInput if shapes disagree, the mask is empty, or the pitch is not
    positive. Source: the thesis, section 5.5, eq. 5.3; the Weingarten matrix is the first fundamental form's inverse
    times the second (do Carmo 1976, section 3.3).
    """
    settings = settings or CurvatureSettings()
    require(bool(np.isfinite(pitch_mm)) and pitch_mm > 0, f"pitch_mm must be a positive number, not {pitch_mm}.")
    mask = check_mask(mask, (height_mm.shape[0], height_mm.shape[1]))
    side = settings.side(1.0 / pitch_mm)
    box = bounding_box(mask, side // 2 + 1)
    inside = mask[box] & np.isfinite(height_mm[box])
    fractions = _blurred(inside.astype(np.float32), [1.0] * side, [1.0] * side)
    cut = inside & (fractions < side * side - 0.5)
    edge = np.flatnonzero((cut & (fractions >= settings.least_share * side * side)).ravel())
    known = inside & (fractions >= settings.least_share * side * side)
    normal = _edge_normals(inside, edge, side, settings.degree)
    windows = _Windows(inside, edge, normal, side, settings.degree)

    def fit(field: FloatArray) -> list[FloatArray]:
        return _derivatives(field[box], windows, pitch_mm)

    if xy_mm is None:
        forms = _forms_of_height(*fit(height_mm))
    else:
        with ThreadPoolExecutor(2) as pool:
            forms = _forms_of_points(*pool.map(fit, (*xy_mm, height_mm)))
    fields = _principal(forms[:3], forms[3:])
    results = []
    for field in fields:
        whole = np.full(mask.shape, np.nan, dtype=np.float32)
        whole[box] = np.where(known, field, np.float32(np.nan))
        results.append(whole)
    return _Curvature(*results)


def _powers(degree: int) -> list[tuple[int, int]]:
    """Exponents (column, row) of the polynomial's terms; those of the derivatives that are wanted come first."""
    wanted = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    rest = [(i, k - i) for k in range(degree + 1) for i in range(k + 1) if (i, k - i) not in wanted]
    return wanted + rest


def _derivatives(field: FloatArray, windows: _Windows, pitch_mm: float) -> list[FloatArray]:
    """First derivatives right and up, second right-right, right-up and up-up, per mm, of fits at every pixel."""
    inside, edge, side, degree = windows.inside, windows.edge, windows.side, windows.degree
    powers = _powers(degree)
    taps = _taps(side, degree)
    # about zero, so that float32 keeps what matters
    middle = np.float32(field[inside].mean())
    values = np.where(inside, field - middle, 0.0).astype(np.float32)
    # cubic terms enter the middles of full windows through the slopes alone
    total_taps = np.array(taps).sum(axis=1)
    interior = np.linalg.inv([[total_taps[i + k] * total_taps[j + m] for k, m in powers] for i, j in powers])

    def moment(power: tuple[int, int]) -> FloatArray:
        return _blurred(values, taps[power[0]], taps[power[1]])

    with ThreadPoolExecutor(2) as pool:
        sums = dict(zip(powers, pool.map(moment, powers), strict=True))
    scale = side // 2
    results = []
    for term in range(5):
        total = np.zeros(values.shape, dtype=np.float32)
        for other, weight in zip(powers, interior[term], strict=True):
            if abs(weight) > 1e-12:
                total += np.float32(weight) * sums[other]
        results.append(total)
    if edge.size:
        right = np.stack([sums[power].ravel()[edge] for power in powers], axis=1).astype(np.float64)
        for start in range(0, edge.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            solved = np.linalg.solve(windows.normal[part], right[part][..., None])[..., 0]
            for term in range(5):
                results[term].ravel()[edge[part]] = solved[:, term]
    unit = pitch_mm * scale
    factors = (1 / unit, -1 / unit, 2 / unit**2, -1 / unit**2, 2 / unit**2)  # rows run downwards
    return [result * np.float32(factor) for result, factor in zip(results, factors, strict=True)]


def _taps(side: int, degree: int) -> list[list[float]]:
    """Monomials of the offset, one at the window's edge."""
    offset = np.arange(-(side // 2), side // 2 + 1) / (side // 2)
    return [list(offset**k) for k in range(2 * degree + 1)]


def _edge_normals(inside: BoolArray, edge: NDArray[np.intp], side: int, degree: int) -> NDArray[np.float64]:
    """(N, T, T) normal equations of the fits whose windows the mask cuts."""
    powers = _powers(degree)
    if edge.size == 0:
        return np.zeros((0, len(powers), len(powers)))
    taps = _taps(side, degree)
    one = inside.astype(np.float32)
    wanted = sorted({(i + k, j + m) for i, j in powers for k, m in powers})

    def moment(power: tuple[int, int]) -> NDArray[np.float64]:
        return _blurred(one, taps[power[0]], taps[power[1]]).ravel()[edge].astype(np.float64)

    with ThreadPoolExecutor(2) as pool:
        moments = dict(zip(wanted, pool.map(moment, wanted), strict=True))
    normal = np.empty((edge.size, len(powers), len(powers)))
    for a, (i, j) in enumerate(powers):
        for b, (k, m) in enumerate(powers):
            normal[:, a, b] = moments[i + k, j + m]
    # a touch of ridge regression: what the pixels there do not determine stays small
    penalised = np.diag([float(sum(power) > 1) for power in powers])
    return normal + 1e-4 * moments[0, 0][:, None, None] * penalised


def _blurred(image: FloatArray, across: list[float], down: list[float]) -> FloatArray:
    """Correlation with a separable kernel, zeros beyond the border."""
    x, y = np.array(across, dtype=np.float32), np.array(down, dtype=np.float32)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, x, y, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)


def _forms_of_height(
    zx: FloatArray, zy: FloatArray, zxx: FloatArray, zxy: FloatArray, zyy: FloatArray
) -> tuple[FloatArray, ...]:
    """First (E, F, G) and second (L, M, N) fundamental form of a height field."""
    one = np.float32(1.0)
    inverse = np.asarray(one / np.sqrt(one + zx * zx + zy * zy), dtype=np.float32)
    return one + zx * zx, zx * zy, one + zy * zy, zxx * inverse, zxy * inverse, zyy * inverse


def _forms_of_points(x: list[FloatArray], y: list[FloatArray], z: list[FloatArray]) -> tuple[FloatArray, ...]:
    """First and second fundamental form of a surface given by its points."""
    parts = (x, y, z)
    e, f, g = (sum(p[a] * p[b] for p in parts) for a, b in ((0, 0), (0, 1), (1, 1)))
    nx = y[0] * z[1] - z[0] * y[1]
    ny = z[0] * x[1] - x[0] * z[1]
    nz = x[0] * y[1] - y[0] * x[1]
    length = np.maximum(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
    second = ((nx * x[k] + ny * y[k] + nz * z[k]) / length for k in (2, 3, 4))
    return (np.asarray(e), np.asarray(f), np.asarray(g), *second)


def _principal(
    first: tuple[FloatArray, ...], second: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Principal curvatures (larger, smaller) and the shape index of (5.3), of the two fundamental forms."""
    (e, f, g), (second_e, second_f, second_g) = first, second
    half = np.float32(0.5)
    inverse = np.float32(1.0) / np.maximum(e * g - f * f, 1e-12)
    # half the trace and the determinant of the Weingarten matrix
    mean = half * (e * second_g - 2.0 * f * second_f + g * second_e) * inverse
    gauss = (second_e * second_g - second_f * second_f) * inverse
    root = np.sqrt(np.maximum(mean * mean - gauss, 0.0))
    index = half - np.arctan2(mean, root) * (1.0 / np.pi)
    return mean + root, mean - root, index
