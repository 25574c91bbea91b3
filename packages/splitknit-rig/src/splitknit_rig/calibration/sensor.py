"""Linearity of the sensor's values in the light.

With exposure times t_j, light L_i and stored values v_ij the inverse response f obeys f(v_ij) = t_j
L_i. A polynomial f is linear in its coefficients, and so is the best L_i in f: all of it is one
small linear system (Mitsunaga and Nayar 1999, with known instead of estimated ratios of the
exposures). The departure of f from a straight line is the result; for sRGB the curve is first
removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.imaging.pixels import srgb_light
from splitknit.model import Array


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Relation of stored values to the light."""

    encoding: str  # ``linear`` or ``srgb``
    linear_percent: float  # largest departure of the values from a line, in per cent of full scale
    srgb_percent: float  # the same after the sRGB curve was taken off
    residual_percent: float  # rms of what no response explains, in per cent of full scale
    # least and greatest values that were seen, as parts of full scale: the answer holds between
    # them
    span: tuple[float, float]


def fit_response(
    values: Any,
    exposure_s: Any,
    limit_percent: float = 1.0,
    *,
    name: str = "the exposure series",
) -> Response:
    """Judge the response of a camera.

    Raises BadInput if the exposures are too few or too similar, no response explains them, or the
    response is neither linear nor sRGB. `values`: (J, N) of N unchanging places (means of small
    even patches) at J exposures, of full scale; NaN clipped; `exposure_s`: (J,) exposure times
    (times gain), any unit; `limit_percent`: values are linear if they depart from a line by no
    more, in per cent of full scale; `name`: of the series, for messages. Source: T. Mitsunaga and
    S. K. Nayar, "Radiometric self calibration", CVPR 1999, eq. 9; P. Debevec and J. Malik,
    "Recovering high dynamic range radiance maps from photographs", SIGGRAPH 1997, section 2.

    >>> import numpy as np
    >>> light, times = np.linspace(0.01, 0.1, 200), np.array([1.0, 2.0, 4.0, 8.0])
    >>> fit_response(0.02 + times[:, None] * light, times).encoding
    'linear'
    """
    stored, times = _checked(values, exposure_s, name)
    departure, residual = _straightness(stored, times)
    linear_light = np.asarray(srgb_light(stored), dtype=np.float64)
    decoded_departure, decoded_residual = _straightness(linear_light, times)
    residual = min(residual, decoded_residual)
    require(
        residual <= 0.01,
        f"{name} contradicts itself by {100 * residual:.1f} % of full scale: the scene moved, the"
        " light changed, automatic exposure or gain was on, or they were not what the file states;"
        " take the series again with everything fixed.",
    )
    srgb = departure > 0.01 * limit_percent
    require(
        not srgb or decoded_departure <= 0.01 * limit_percent,
        f"{name} is neither linear (it departs by {100 * departure:.1f} % of full scale) nor sRGB"
        f" ({100 * decoded_departure:.1f} %); switch off the camera's picture processing (contrast,"
        " tone curves, local adjustments) or store RAW.",
    )
    return Response(
        encoding="srgb" if srgb else "linear",
        linear_percent=100 * departure,
        srgb_percent=100 * decoded_departure,
        residual_percent=100 * residual,
        span=(float(np.nanmin(stored)), float(np.nanmax(stored))),
    )


MIN_EXPOSURES = 4
_MIN_EXPOSURE_RATIO = 3.0  # longest over shortest
_MIN_VALUE_RANGE = 0.3  # of full scale


def _checked(values: Any, exposure_s: Any, name: str) -> tuple[Array, Array]:
    stored, times = np.array(values, dtype=np.float64), np.asarray(exposure_s, dtype=np.float64)
    different = len(np.unique(times))
    require(
        different >= MIN_EXPOSURES,
        f"{name} has {different} different exposures, but at least {MIN_EXPOSURES} are needed.",
    )
    ratio = float(times.max() / times.min())
    require(
        ratio >= _MIN_EXPOSURE_RATIO,
        f"{name} spans a ratio of {ratio:.1f} in exposure, but {_MIN_EXPOSURE_RATIO:g} at least"
        " is needed.",
    )
    stored[~(stored < 0.98)] = np.nan  # clipped
    seen = np.isfinite(stored).sum(axis=0) >= 3
    require(
        int(seen.sum()) >= 30,
        f"{name} shows {int(seen.sum())} places that are unclipped in three exposures, but 30 are"
        " needed; expose less.",
    )
    stored = stored[:, seen]
    span = float(np.nanmax(stored) - np.nanmin(stored))
    require(
        span >= _MIN_VALUE_RANGE,
        f"{name} covers {100 * span:.0f} % of full scale, but {100 * _MIN_VALUE_RANGE:.0f} % is"
        " needed to distinguish a curve from a line; expose longer, or take a scene with bright and"
        " dark parts.",
    )
    return stored, times


def _straightness(stored: Array, times: Array) -> tuple[float, float]:
    """Fit f(v) t = light, of the highest degree that grows everywhere: departure from a line, and
    residual, parts of full scale.
    """
    low, high = float(np.nanmin(stored)), float(np.nanmax(stored))
    grid = np.linspace(low, high, 201)
    for degree in range(5, 0, -1):  # of the polynomial of the inverse response
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
    """Inverse response that is `span`'s end at the greatest value, and the rms of f(v_ij) - t_j
    L_i."""
    used = np.isfinite(stored)
    filled = np.where(used, stored, span[0])
    scaled = (2 * filled - span[0] - span[1]) / (span[1] - span[0])
    # (J, N, degree + 1)
    basis = np.polynomial.chebyshev.chebvander(scaled, degree) * used[..., None]
    # noise grows with the signal, and so does its weight's inverse
    weight = used / (filled + 0.05)
    time = np.where(used, times[:, None], 0.0)
    norm = (weight * time * time).sum(axis=0)
    # L_i as a linear map of the coefficients
    light = np.einsum("jn,jnd->nd", weight * time, basis) / norm[:, None]
    left = basis - time[..., None] * light[None]
    normal = np.einsum("jnd,jne,jn->de", left, left, weight)
    # f(greatest) = greatest: every Chebyshev polynomial is one there
    ones = np.ones(degree + 1)
    inverse = np.linalg.pinv(normal + 1e-12 * np.trace(normal) * np.eye(degree + 1))
    solved = inverse @ ones
    coefficients = solved / float(ones @ solved) * span[1]
    rms = float(np.sqrt(((left @ coefficients) ** 2 * used).sum() / used.sum()))
    return np.polynomial.Chebyshev(coefficients, domain=list(span)), rms
