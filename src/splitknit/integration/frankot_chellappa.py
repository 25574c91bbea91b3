"""Integration by projection on Fourier modes (Frankot and Chellappa 1988)."""

from __future__ import annotations

from typing import Any

from splitknit.integration.gradient_field import check_gradients, zero_mean
from splitknit.integration.spectral import integrate_spectrum
from splitknit.model import FloatArray


def frankot_chellappa(gradient_x: Any, gradient_y: Any, mask: Any = None, padding: str = "zero") -> FloatArray:
    """Height whose gradient is nearest to the given one, over a whole rectangle.

    The field outside the mask counts as flat, which bends a surface that ends steeply: use
    :func:`splitknit.integration.poisson` for shape. Frequencies are in radians per pixel, so heights have true scale.

    Parameters
    ----------
    gradient_x, gradient_y : (H, W)
        dz/dx and dz/dy, y up, dimensionless. Values outside the mask are ignored.
    mask : (H, W) bool, optional
        The surface; everything by default.
    padding : ``zero`` or ``mirror``
        ``zero`` as the thesis: the rectangle continued by zeros to a fast length, then periodic.
        ``mirror``: the height is mirrored about the borders, so that a surface cut by a border is not forced to close.

    Returns
    -------
    (H, W) float32
        Height in pixels, mean zero over the mask, NaN outside it.

    Raises
    ------
    BadInput
        If shapes differ, the mask is empty, a gradient inside the mask is not finite, or `padding` is unknown.

    References
    ----------
    R. T. Frankot and R. Chellappa, "A method for enforcing integrability in shape from shading algorithms", IEEE
    Transactions on Pattern Analysis and Machine Intelligence 10 (1988), eq. 21; the thesis, (3.40) to (3.46).

    Examples
    --------
    >>> import numpy as np
    >>> from splitknit.integration import frankot_chellappa
    >>> x = np.arange(64)
    >>> slope = np.tile(np.cos(2 * np.pi * x / 32), (64, 1))
    >>> height = frankot_chellappa(slope, np.zeros_like(slope))
    >>> round(float(height.max()), 2)  # 32 / (2 pi)
    5.09
    """
    slope_x, slope_y, inside = check_gradients(gradient_x, gradient_y, mask)
    return zero_mean(integrate_spectrum(slope_x, slope_y, None, padding), inside)
