"""Whether a camera's values are linear in the light: its response from a series of exposures of one scene.

With exposure times t_j, light L_i and stored values v_ij the inverse response f obeys f(v_ij) = t_j L_i. A polynomial f
is linear in its coefficients, and so is the best L_i in f: what is left is one small linear system (Mitsunaga and Nayar
1999, with known instead of estimated ratios of the exposures). How far f is from a straight line is the answer; the
sRGB curve is tried by taking it off first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ResponseSettings:
    """How the response is fitted and judged."""

    degree: int = 5
    """Of the polynomial."""
    limit_percent: float = 1.0
    """Values are linear if they depart from a line by no more than this many per cent of full scale."""
    inconsistent_percent: float = 1.0
    """Residuals (median over images of their rms) from where on no response explains the images: the scene moved or
    the light changed."""
    clip: float = 0.98
    """Values from here on (of full scale) are left out."""
    least_exposures: int = 4
    """Different exposure times that are needed."""
    least_ratio: float = 3.0
    """Longest over shortest exposure."""
    least_range: float = 0.3
    """Part of the full scale that the values must span."""

    def __post_init__(self) -> None:
        require(2 <= self.degree <= 9, f"response.degree must be 2 to 9, but it is {self.degree}.")
        require(self.least_exposures >= 3, "response.least_exposures must be at least 3.")
        for name in ("limit_percent", "inconsistent_percent", "least_ratio", "least_range"):
            require(getattr(self, name) > 0, f"response.{name} must be positive.")
        require(0.5 <= self.clip <= 1.0, "response.clip must lie between 0.5 and 1.")


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How stored values follow the light."""

    encoding: str
    """``linear`` or ``srgb``."""
    linear_percent: float
    """Largest departure of the values from a line, in per cent of full scale."""
    srgb_percent: float
    """The same after the sRGB curve was taken off."""
    residual_percent: float
    """rms of what no response explains, in per cent of full scale."""
    black_level: float
    """Value of no light that the series itself suggests, as a part of full scale (of the linear light)."""
    span: tuple[float, float]
    """Least and greatest values that were seen, as parts of full scale: the answer holds between them."""
    curve: tuple[Array, Array]
    """Values from the least to the greatest, and the light that each stands for, its line through the ends one."""


def fit_response(
    values: Any, exposure_s: Any, settings: ResponseSettings | None = None, *, name: str = "the exposure series"
) -> Response:
    """Judge the response of a camera.

    Parameters
    ----------
    values : (J, N) stored values as parts of full scale
        N places of a scene that does not change, J exposures: means over small even patches. NaN where clipped.
    exposure_s : (J,) exposure times (times gain), any unit
    settings : ResponseSettings, optional
    name : of the series, for messages

    Returns
    -------
    Response

    Raises
    ------
    BadInput
        If the exposures are too few or too alike, the values do not grow with them, no response explains them, or
        the response is neither linear nor sRGB.

    References
    ----------
    T. Mitsunaga and S. K. Nayar, "Radiometric self calibration", CVPR 1999, eq. 9. P. Debevec and J. Malik,
    "Recovering high dynamic range radiance maps from photographs", SIGGRAPH 1997, section 2.

    Examples
    --------
    >>> import numpy as np
    >>> light, times = np.linspace(0.01, 0.1, 200), np.array([1.0, 2.0, 4.0, 8.0])
    >>> fit_response(0.02 + times[:, None] * light, times).encoding
    'linear'
    """
    chosen = settings or ResponseSettings()
    stored, times = _checked(values, exposure_s, chosen, name)
    line = _straightness(stored, times, chosen)
    linear_light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    decoded = _straightness(linear_light, times, chosen)
    residual = min(line.residual, decoded.residual)
    require(
        residual <= 0.01 * chosen.inconsistent_percent,
        f"{name} contradicts itself by {100 * residual:.1f} % of full scale: the scene moved, the light changed, or "
        f"exposure or gain were not what the file says; take the series again with everything fixed.",
    )
    limit = 0.01 * chosen.limit_percent
    if line.departure > limit and decoded.departure > limit:
        raise BadInput(
            f"{name} is neither linear (it departs by {100 * line.departure:.1f} % of full scale) nor sRGB "
            f"({100 * decoded.departure:.1f} %); switch off the camera's picture processing (contrast, tone curves, "
            f"local adjustments) or store RAW."
        )
    srgb = line.departure > limit
    best = decoded if srgb else line
    return Response(
        encoding="srgb" if srgb else "linear",
        linear_percent=100 * line.departure,
        srgb_percent=100 * decoded.departure,
        residual_percent=100 * residual,
        black_level=best.black,
        span=(float(np.nanmin(stored)), float(np.nanmax(stored))),
        curve=line.curve,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    departure: float
    residual: float
    black: float
    curve: tuple[Array, Array]


def _checked(values: Any, exposure_s: Any, settings: ResponseSettings, name: str) -> tuple[Array, Array]:
    stored, times = np.array(values, dtype=np.float64), np.asarray(exposure_s, dtype=np.float64)
    require(stored.ndim == 2, f"values must have the shape (J, N), but it has {stored.shape}.")
    require(
        times.shape == stored.shape[:1] and bool((times > 0).all() and np.isfinite(times).all()),
        f"exposure_s must be {stored.shape[0]} positive numbers, one for each image.",
    )
    different = len(np.unique(times))
    require(
        different >= settings.least_exposures,
        f"{name} has {different} different exposures, but at least {settings.least_exposures} are needed.",
    )
    ratio = float(times.max() / times.min())
    require(
        ratio >= settings.least_ratio,
        f"{name} spans a ratio of {ratio:.1f} in exposure, but {settings.least_ratio:g} at least is needed.",
    )
    stored[~(stored < settings.clip)] = np.nan
    seen = np.isfinite(stored).sum(axis=0) >= 3
    require(
        int(seen.sum()) >= 30,
        f"{name} shows {int(seen.sum())} places that are unclipped in three exposures, but 30 are needed; expose less.",
    )
    stored = stored[:, seen]
    _check_growth(stored, times, name)
    span = float(np.nanmax(stored) - np.nanmin(stored))
    require(
        span >= settings.least_range,
        f"{name} covers {100 * span:.0f} % of full scale, but {100 * settings.least_range:.0f} % is needed to tell "
        f"a curve from a line; expose longer, or take a scene with bright and dark parts.",
    )
    return stored, times


def _check_growth(stored: Array, times: Array, name: str) -> None:
    """Refuse values that stay the same whatever the exposure."""
    order = np.argsort(times)
    finite = np.isfinite(stored[order])
    first, last = finite.argmax(axis=0), len(times) - 1 - finite[::-1].argmax(axis=0)
    places = np.arange(stored.shape[1])
    grown = stored[order][last, places] / np.maximum(stored[order][first, places], 1e-6)
    asked = times[order][last] / times[order][first]
    share = float(np.median(np.log(np.maximum(grown, 1e-6)) / np.log(np.maximum(asked, 1.0 + 1e-9))))
    require(
        share > 0.15,
        f"{name} does not grow brighter with the exposure: the camera's automatic exposure or gain is on; lock it.",
    )


def _straightness(stored: Array, times: Array, settings: ResponseSettings) -> _Line:
    """Fit f(v) t = light, the highest degree first that grows everywhere, and compare it with a line."""
    low, high = float(np.nanmin(stored)), float(np.nanmax(stored))
    grid = np.linspace(low, high, 201)
    for degree in range(settings.degree, 0, -1):
        polynomial, residual = _polynomial(stored, times, degree, (low, high))
        light = polynomial(grid)
        if bool((np.diff(light) > 0).all()):
            break
    slope, offset = np.polyfit(grid, light, 1)
    departure = float(np.abs(light - offset - slope * grid).max() / slope)
    line = (light - light[0]) / (light[-1] - light[0]) * (high - low) + low
    black = low - float(polynomial(low)) / max(float(polynomial.deriv()(low)), 1e-9)
    return _Line(departure, residual / slope, black, (grid, line))


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
