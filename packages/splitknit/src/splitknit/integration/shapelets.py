"""Shapelets: heights as a sum of correlations with a bank of Gaussian bumps (Kovesi 2003, 2005).

With z the surface and f_s = exp(-r^2 / (2 sigma_s^2)) the bump of scale s, its response is the
correlation of their gradients (slant and tilt both known); the responses of all scales are summed
and divided by the plateau of the bank, 4 pi / ln(factor^2). All scales together are one transfer
function of the height, 2 pi sum_s x_s exp(-x_s / 2) with x_s = (sigma_s w)^2: three transforms
whatever the number of scales.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np

from splitknit.integration.frankot_chellappa import check_fields, integrate_mirrored, zero_mean
from splitknit.model import Array, FloatArray
from splitknit.settings import Checked, Limits

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis gives its sizes in pixels. Source: thesis (75.7 px/mm)."""


@dataclass(frozen=True, slots=True)
class ShapeletSettings(Checked):
    """The bank of shapelets."""

    _group = "shapelets"
    scales: Annotated[int, Limits(1, 32)] = 3
    """Number of Gaussians."""
    sigma_px: Annotated[float, Limits(0, above=True)] = 1.0
    """Standard deviation of the smallest Gaussian, in pixels (at 75.7 px/mm; scale it with the
    pitch)."""
    factor: Annotated[float, Limits(1, above=True)] = 2.0
    """Ratio of successive standard deviations."""

    @property
    def sigmas_px(self) -> tuple[float, ...]:
        """Standard deviations of the bank, smallest first."""
        return tuple(self.sigma_px * self.factor**k for k in range(self.scales))


def shapelet_response(omega: Any, settings: ShapeletSettings | None = None) -> Array:
    """Gain of the height at the radial frequency `omega` (rad/px, any shape), one in the pass band.

    (ln(m^2) / 2) sum_s x_s exp(-x_s / 2), x_s = (sigma_s omega)^2, m the factor between scales: an
    infinite bank has a mean gain of exactly one over the logarithm of the frequency (its ripple is
    1 % for m = 2).

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
    gradient_x: Any, gradient_y: Any, mask: Any = None, settings: ShapeletSettings | None = None
) -> FloatArray:
    """Height inside the pass band of a bank of shapelets; beyond the rectangle the surface is
    mirrored.

    Parameters
    ----------
    gradient_x, gradient_y, mask
        As of :func:`splitknit.integration.frankot_chellappa`.
    settings : ShapeletSettings, optional

    Returns
    -------
    (H, W) float32
        Height in pixels, mean zero over the mask, NaN outside it.

    Raises
    ------
    BadInput
        As :func:`splitknit.integration.frankot_chellappa`.

    References
    ----------
    P. Kovesi, "Shapelets correlated with surface normals produce surfaces", ICCV 2005 (Technical
    Report 03-003, The University of Western Australia, 2003).

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
    slope_x, slope_y, inside = check_fields(gradient_x, gradient_y, mask)
    return zero_mean(
        integrate_mirrored(slope_x, slope_y, partial(shapelet_response, settings=settings)), inside
    )
