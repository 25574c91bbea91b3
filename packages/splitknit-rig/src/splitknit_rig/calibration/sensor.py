"""The sensor: whether its values are linear in the light, and its noise.

With exposure times t_j, light L_i and stored values v_ij the inverse response f obeys f(v_ij) = t_j L_i. A polynomial f
is linear in its coefficients, and so is the best L_i in f: what is left is one small linear system (Mitsunaga and Nayar
1999, with known instead of estimated ratios of the exposures). How far f is from a straight line is the answer; the
sRGB curve is tried by taking it off first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import Array, PixelArray

_DEGREE = 5  # degree of the polynomial
_LIMIT_PERCENT = 1.0  # values are linear if they depart from a line by no more than this many per cent of full scale
_INCONSISTENT_PERCENT = 1.0
"""Residuals (median over images of their rms) that no response explains: the scene moved or the light changed."""
_CLIP = 0.98  # values from here on (of full scale) are left out
MIN_EXPOSURES = 4  # different exposure times that are needed
_MIN_RATIO = 3.0  # longest over shortest exposure
_MIN_RANGE = 0.3  # part of the full scale that the values must span


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How stored values follow the light."""

    encoding: str  # ``linear`` or ``srgb``
    linear_percent: float  # largest departure of the values from a line, in per cent of full scale
    srgb_percent: float  # the same after the sRGB curve was taken off
    residual_percent: float  # rms of what no response explains, in per cent of full scale
    # least and greatest values that were seen, as parts of full scale: the answer holds between them
    span: tuple[float, float]


def fit_response(
    values: Any, exposure_s: Any, limit_percent: float = _LIMIT_PERCENT, *, name: str = "the exposure series"
) -> Response:
    """Judge the response of a camera.

    Raises BadInput if the exposures are too few or too similar, the values do not grow with them, no response explains
    them, or the response is neither linear nor sRGB. `values`: (J, N) of N unchanging places (means of small even
    patches) at J exposures, of full scale; NaN clipped; `exposure_s`: (J,) exposure times (times gain), any unit;
    `limit_percent`: values are linear if they depart from a line by no more, in per cent of full scale; `name`: of the
    series, for messages. Source: T. Mitsunaga and S. K. Nayar, "Radiometric self calibration", CVPR 1999, eq. 9; P.
    Debevec and J. Malik, "Recovering high dynamic range radiance maps from photographs", SIGGRAPH 1997, section 2.

    >>> import numpy as np
    >>> light, times = np.linspace(0.01, 0.1, 200), np.array([1.0, 2.0, 4.0, 8.0])
    >>> fit_response(0.02 + times[:, None] * light, times).encoding
    'linear'
    """
    stored, times = _checked(values, exposure_s, name)
    departure, residual = _straightness(stored, times)
    linear_light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    decoded_departure, decoded_residual = _straightness(linear_light, times)
    residual = min(residual, decoded_residual)
    require(
        residual <= 0.01 * _INCONSISTENT_PERCENT,
        f"{name} contradicts itself by {100 * residual:.1f} % of full scale: the scene moved, the light changed, or "
        f"exposure or gain were not what the file states; take the series again with everything fixed.",
    )
    srgb = departure > 0.01 * limit_percent
    require(
        not srgb or decoded_departure <= 0.01 * limit_percent,
        f"{name} is neither linear (it departs by {100 * departure:.1f} % of full scale) nor sRGB "
        f"({100 * decoded_departure:.1f} %); switch off the camera's picture processing (contrast, tone curves, local "
        "adjustments) or store RAW.",
    )
    return Response(
        encoding="srgb" if srgb else "linear",
        linear_percent=100 * departure,
        srgb_percent=100 * decoded_departure,
        residual_percent=100 * residual,
        span=(float(np.nanmin(stored)), float(np.nanmax(stored))),
    )


def _checked(values: Any, exposure_s: Any, name: str) -> tuple[Array, Array]:
    stored, times = np.array(values, dtype=np.float64), np.asarray(exposure_s, dtype=np.float64)
    different = len(np.unique(times))
    require(
        different >= MIN_EXPOSURES,
        f"{name} has {different} different exposures, but at least {MIN_EXPOSURES} are needed.",
    )
    ratio = float(times.max() / times.min())
    require(
        ratio >= _MIN_RATIO, f"{name} spans a ratio of {ratio:.1f} in exposure, but {_MIN_RATIO:g} at least is needed."
    )
    stored[~(stored < _CLIP)] = np.nan
    seen = np.isfinite(stored).sum(axis=0) >= 3
    require(
        int(seen.sum()) >= 30,
        f"{name} shows {int(seen.sum())} places that are unclipped in three exposures, but 30 are needed; expose less.",
    )
    stored = stored[:, seen]
    _check_growth(stored, times, name)
    span = float(np.nanmax(stored) - np.nanmin(stored))
    require(
        span >= _MIN_RANGE,
        f"{name} covers {100 * span:.0f} % of full scale, but {100 * _MIN_RANGE:.0f} % is needed to distinguish "
        f"a curve from a line; expose longer, or take a scene with bright and dark parts.",
    )
    return stored, times


def _check_growth(stored: Array, times: Array, name: str) -> None:
    order = np.argsort(times)
    finite = np.isfinite(stored[order])
    first, last = order[finite.argmax(axis=0)], order[len(times) - 1 - finite[::-1].argmax(axis=0)]
    places = np.arange(stored.shape[1])
    grown, asked = stored[last, places] / np.maximum(stored[first, places], 1e-6), times[last] / times[first]
    fraction = float(np.median(np.log(np.maximum(grown, 1e-6)) / np.log(np.maximum(asked, 1.0 + 1e-9))))
    require(
        fraction > 0.15,
        f"{name} does not grow brighter with the exposure: the camera's automatic exposure or gain is on; lock it.",
    )


def _straightness(stored: Array, times: Array) -> tuple[float, float]:
    """Fit f(v) t = light, of the highest degree that grows everywhere: departure from a line, and residual, parts of
    full scale.
    """
    low, high = float(np.nanmin(stored)), float(np.nanmax(stored))
    grid = np.linspace(low, high, 201)
    for degree in range(_DEGREE, 0, -1):
        polynomial, residual = _polynomial(stored, times, degree, (low, high))
        light = polynomial(grid)
        if bool((np.diff(light) > 0).all()):
            break
    slope, offset = np.polyfit(grid, light, 1)
    departure = float(np.abs(light - offset - slope * grid).max() / slope)
    return departure, residual / slope


def _polynomial(
    stored: Array, times: Array, degree: int, span: tuple[float, float]
) -> tuple[np.polynomial.Chebyshev, float]:
    """Inverse response that is `span`'s end at the greatest value, and the rms of f(v_ij) - t_j L_i."""
    used = np.isfinite(stored)
    filled = np.where(used, stored, span[0])
    scaled = (2 * filled - span[0] - span[1]) / (span[1] - span[0])
    basis = np.polynomial.chebyshev.chebvander(scaled, degree) * used[..., None]  # (J, N, degree + 1)
    # noise grows with the signal, and so does its weight's inverse
    weight = used / (filled + 0.05)
    time = np.where(used, times[:, None], 0.0)
    norm = (weight * time * time).sum(axis=0)
    light = np.einsum("jn,jnd->nd", weight * time, basis) / norm[:, None]  # L_i as a linear map of the coefficients
    left = basis - time[..., None] * light[None]
    normal = np.einsum("jnd,jne,jn->de", left, left, weight)
    # f(greatest) = greatest: every Chebyshev polynomial is one there
    ones = np.ones(degree + 1)
    inverse = np.linalg.pinv(normal + 1e-12 * np.trace(normal) * np.eye(degree + 1))
    solved = inverse @ ones
    coefficients = solved / float(ones @ solved) * span[1]
    rms = float(np.sqrt(((left @ coefficients) ** 2 * used).sum() / used.sum()))
    return np.polynomial.Chebyshev(coefficients, domain=list(span)), rms


_CURVATURE = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], dtype=np.float32)
"""Zero on planes, and of variance 36 on white noise of variance one (Immerkaer 1996)."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """variance = read_noise^2 + light / electrons, light and deviations as parts of full scale."""

    electrons: float  # that fill a pixel to full scale, from the noise: with white balance, of this channel after it
    read_noise: float
    span: tuple[float, float]  # least and greatest light that was seen


def noise_samples(frame: PixelArray, channel: int, black_level: float = 0.0, side: int = 24) -> tuple[Array, Array]:
    """Mean and variance (n,) of the fine noise in squares of `side` pixels of a channel of (H, W, C), of full scale."""
    full = float(np.iinfo(frame.dtype).max)
    values = np.ascontiguousarray(frame[..., channel], dtype=np.float32) / np.float32(full)
    rough = cv2.filter2D(values, cv2.CV_32F, _CURVATURE)
    rows, columns = (n // side for n in values.shape)

    def squares(image: Any) -> Any:
        cut = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
        return cut.transpose(0, 2, 1, 3).reshape(rows * columns, -1)

    own = squares(values)
    unclipped = own.max(axis=1) < 0.98
    variance = (squares(rough) ** 2).mean(axis=1) / 36.0 - (1.0 / full) ** 2 / 12.0
    return (own.mean(axis=1) - black_level)[unclipped].astype(np.float64), variance[unclipped].astype(np.float64)


def noise_model(light: Any, variance: Any, bins: int = 12) -> NoiseModel | None:
    """Line through variances over light (n,) of :func:`noise_samples`, by medians of bins; None without variation or
    slope. Source: the photon transfer method, EMVA 1288 (2021), section 6.
    """
    x, y = np.asarray(light, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    if len(x) < 4 * bins:
        return None
    groups = np.array_split(np.argsort(x, kind="stable"), bins)
    middle = np.array([np.median(x[group]) for group in groups])
    typical = np.array([np.median(y[group]) for group in groups])
    if middle[-1] < 1.5 * max(middle[0], 0.02):
        return None
    weight = 1.0 / np.maximum(typical, 0.05 * float(np.median(typical)) + 1e-12)
    slope, offset = np.polyfit(middle, typical, 1, w=weight)
    if slope <= 0:
        return None
    return NoiseModel(
        electrons=float(1.0 / slope),
        read_noise=float(np.sqrt(max(offset, 0.0))),
        span=(float(middle[0]), float(middle[-1])),
    )
