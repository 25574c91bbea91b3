"""Shapelets: heights as a sum of correlations with a bank of Gaussian bumps (Kovesi 2003, 2005).

With z the surface, f_s = exp(-r^2 / (2 sigma_s^2)) the bump of scale s, (G, tau) and (g_s, theta) the gradient length
and direction (tan of the slant, and tilt) of each, and * the correlation, a variant's response at scale s is

* ``slant_tilt``:      (g_s cos theta) * (G cos tau) + (g_s sin theta) * (G sin tau), i.e. g G cos(theta - tau);
* ``ambiguous_tilt``:  [(g_s cos 2 theta) * (G cos 2 tau) + (g_s sin 2 theta) * (G sin 2 tau) + g_s * G] / 2, i.e.
  g G cos^2(theta - tau), which is blind to tau + pi;
* ``slant_only``:      g_s * G;
* ``tilt_only``:       cos theta * cos tau + sin theta * sin tau over the support of the bump, r <= 3 sigma_s.

The responses of all scales are summed and divided by the plateau of the bank, 4 pi / ln(factor^2).

The first is linear in the gradients and correlates with the gradient of the bank, so that all scales together are one
transfer function of the height, 2 pi sum_s x_s exp(-x_s / 2) with x_s = (sigma_s w)^2: three transforms whatever the
number of scales. The others are not linear: their heights have neither true scale nor a certain sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.integration.frankot_chellappa import (
    WORKERS,
    Transfer,
    check_fields,
    integrate_spectrum,
    sample_radially,
    zero_mean,
)
from splitknit.model import FloatArray
from splitknit.settings import Checked, Limits

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis gives its sizes in pixels."""


@dataclass(frozen=True, slots=True)
class ShapeletSettings(Checked):
    """The bank of shapelets."""

    _group = "shapelets"
    scales: Annotated[int, Limits(1, 32)] = 3
    """Number of Gaussians."""
    sigma_px: Annotated[float, Limits(0, above=True)] = 1.0
    """Standard deviation of the smallest Gaussian, in pixels (at 75.7 px/mm; scale it with the pitch)."""
    factor: Annotated[float, Limits(1, above=True)] = 2.0
    """Ratio of successive standard deviations."""
    variant: Literal["slant_tilt", "ambiguous_tilt", "slant_only", "tilt_only"] = "slant_tilt"
    """What is known: ``slant_tilt``, ``ambiguous_tilt`` (tilt up to pi), ``slant_only`` or ``tilt_only``."""
    padding: Literal["mirror", "zero"] = "mirror"
    """Beyond the rectangle the surface is mirrored (``mirror``) or flat (``zero``)."""

    @property
    def sigmas_px(self) -> tuple[float, ...]:
        """Standard deviations of the bank, smallest first."""
        return tuple(self.sigma_px * self.factor**k for k in range(self.scales))


def shapelet_response(omega: Any, settings: ShapeletSettings | None = None) -> NDArray[np.float64]:
    """Gain of the height at the radial frequency `omega` (rad/px, any shape), one in the pass band.

    (ln(m^2) / 2) sum_s x_s exp(-x_s / 2), x_s = (sigma_s omega)^2, m the factor between scales: an infinite bank has a
    mean gain of exactly one over the logarithm of the frequency (its ripple is 1 % for m = 2).

    Parameters
    ----------
    omega : array of any shape, rad/px
        Radial angular frequencies, 0 or more.
    settings : ShapeletSettings, optional
        Number of scales, the finest and the factor between them.

    Returns
    -------
    float64 of the shape of `omega`
        Height that comes out over height that went in, without a unit.

    References
    ----------
    P. Kovesi, "Shapelets correlated with surface normals produce surfaces", ICCV 2005, section 3.
    """
    chosen = settings if settings is not None else ShapeletSettings()
    square = np.asarray(omega, dtype=np.float64) ** 2
    total = np.zeros_like(square)
    for sigma in chosen.sigmas_px:
        x = sigma**2 * square
        total += x * np.exp(-x / 2)
    return np.asarray(total / (2 / np.log(chosen.factor**2)))


def shapelets(
    gradient_x: Any,
    gradient_y: Any,
    mask: Any = None,
    settings: ShapeletSettings | None = None,
    gain: Transfer | None = None,
) -> FloatArray:
    """Height inside the pass band of a bank of shapelets.

    Parameters
    ----------
    gradient_x, gradient_y, mask
        As of :func:`splitknit.integration.frankot_chellappa`.
    settings : ShapeletSettings, optional
    gain : callable, optional
        A further radial gain of the height, from frequencies in rad/px (an array) to an array of the same shape: the
        inverse of a known blur, say. It costs nothing.

    Returns
    -------
    (H, W) float32
        Height in pixels, mean zero over the mask, NaN outside it. The variants other than ``slant_tilt`` know the
        height up to a factor only, and ``ambiguous_tilt`` and ``slant_only`` take every bump for a hill.

    Raises
    ------
    BadInput
        As :func:`splitknit.integration.frankot_chellappa`.

    References
    ----------
    P. Kovesi, "Shapelets correlated with surface normals produce surfaces", ICCV 2005 (Technical Report 03-003, The
    University of Western Australia, 2003).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(256)
    >>> omega = 2 * np.pi * 16 / 256
    >>> slope = np.tile(-omega * np.sin(omega * (x + 0.5)), (64, 1))  # of cos(omega x)
    >>> height = shapelets(slope, np.zeros_like(slope), settings=ShapeletSettings(scales=4))
    >>> amplitude = float(np.sqrt(2) * height.std())
    >>> round(amplitude, 3), round(float(shapelet_response(omega, ShapeletSettings(scales=4))), 3)
    (0.96, 0.96)
    """
    chosen = settings if settings is not None else ShapeletSettings()
    slope_x, slope_y, inside = check_fields(gradient_x, gradient_y, mask)
    if chosen.variant != "slant_tilt":
        return zero_mean(_nonlinear(slope_x, slope_y, chosen, gain), inside)

    def transfer(omega: NDArray[np.float64]) -> NDArray[np.float64]:
        response = shapelet_response(omega, chosen)
        return response if gain is None else response * np.asarray(gain(omega))

    margin = int(np.ceil(4 * chosen.sigmas_px[-1]))
    return zero_mean(integrate_spectrum(slope_x, slope_y, transfer, chosen.padding, margin), inside)


def _nonlinear(
    slope_x: FloatArray, slope_y: FloatArray, settings: ShapeletSettings, gain: Transfer | None
) -> FloatArray:
    """Correlation of slant and tilt fields with those of the bank; the bank's scales are summed beforehand."""
    height, width = slope_x.shape
    margin = int(np.ceil(4 * settings.sigmas_px[-1]))
    size = (
        scipy.fft.next_fast_len(height + 2 * margin, real=True),
        scipy.fft.next_fast_len(width + 2 * margin, real=True),
    )
    fields = _fields(slope_x, slope_y, settings.variant)
    kernels = _kernels(size, settings)
    spectrum: NDArray[np.complex64] | None = None
    for (field, odd_x, odd_y), kernel in zip(fields, kernels, strict=True):
        padded = _pad(field, size, settings.padding, odd_x, odd_y)
        product = scipy.fft.rfft2(padded, workers=WORKERS) * np.conj(scipy.fft.rfft2(kernel, workers=WORKERS))
        spectrum = product if spectrum is None else spectrum + product
    assert spectrum is not None
    if gain is not None:
        rows, columns = 2 * np.pi * scipy.fft.fftfreq(size[0]), 2 * np.pi * scipy.fft.rfftfreq(size[1])
        spectrum *= sample_radially(gain, rows[:, None] ** 2 + columns[None, :] ** 2).astype(np.float32)
    top, left = (size[0] - height) // 2, (size[1] - width) // 2
    result = scipy.fft.irfft2(spectrum, size, workers=WORKERS)[top : top + height, left : left + width]
    return np.asarray(result / (4 * np.pi / np.log(settings.factor**2)), dtype=np.float32)


Field = tuple[FloatArray, bool, bool]
"""A field, and whether it changes sign under a mirror in x and in y."""


def _fields(slope_x: FloatArray, slope_y: FloatArray, variant: str) -> list[Field]:
    steepness: FloatArray = np.hypot(slope_x, slope_y).astype(np.float32)
    if variant == "slant_only":
        return [(steepness, False, False)]
    safe = np.maximum(steepness, np.float32(1e-12))
    cos: FloatArray = (slope_x / safe).astype(np.float32)
    sin: FloatArray = (slope_y / safe).astype(np.float32)
    if variant == "tilt_only":
        return [(cos, True, False), (sin, False, True)]
    cos_double: FloatArray = (slope_x * cos - slope_y * sin).astype(np.float32)
    sin_double: FloatArray = (2 * slope_x * sin).astype(np.float32)
    return [(cos_double, False, False), (sin_double, True, True), (steepness, False, False)]


def _kernels(size: tuple[int, int], settings: ShapeletSettings) -> list[FloatArray]:
    """The bank's slant and tilt fields, summed over the scales, about pixel (0, 0) of a periodic rectangle."""
    x = scipy.fft.fftfreq(size[1], 1 / size[1])[None, :]
    y = -scipy.fft.fftfreq(size[0], 1 / size[0])[:, None]
    radius = np.hypot(x, y)
    safe = np.maximum(radius, 1e-12)
    cos, sin = -x / safe, -y / safe  # a bump rises towards its centre
    weight = np.zeros(size)
    for sigma in settings.sigmas_px:
        if settings.variant == "tilt_only":
            weight += (radius > 0) & (radius <= 3 * sigma)
        else:
            weight += radius / sigma**2 * np.exp(-((radius / sigma) ** 2) / 2)
    if settings.variant == "slant_only":
        parts = [weight]
    elif settings.variant == "tilt_only":
        parts = [weight * cos, weight * sin]
    else:
        parts = [weight * (cos * cos - sin * sin) / 2, weight * cos * sin, weight / 2]
    return [part.astype(np.float32) for part in parts]


def _pad(field: FloatArray, size: tuple[int, int], padding: str, odd_x: bool, odd_y: bool) -> FloatArray:
    """Centre `field` in a rectangle of `size`; mirrored copies of an odd field change sign."""
    spare = (size[0] - field.shape[0], size[1] - field.shape[1])
    widths = [(n // 2, n - n // 2) for n in spare]
    if padding == "zero":
        return np.pad(field, widths)
    padded = np.pad(field, widths, mode="symmetric")
    if odd_y:
        padded *= _mirror_sign(field.shape[0], widths[0])[:, None]
    if odd_x:
        padded *= _mirror_sign(field.shape[1], widths[1])[None, :]
    return padded


def _mirror_sign(length: int, widths: tuple[int, int]) -> FloatArray:
    copy = np.arange(-widths[0], length + widths[1]) // length
    return np.where(copy % 2 == 0, 1.0, -1.0).astype(np.float32)
