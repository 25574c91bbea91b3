"""Projection on Fourier modes (Frankot and Chellappa 1988), and the checks and mean removal that
all integrators share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray


def check_fields(
    first: Any, second: Any, mask: Any, names: tuple[str, str] = ("gradient_x", "gradient_y")
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return two fields (H, W) float32, such as dz/dx and dz/dy, zero outside the mask, and the
    mask (H, W).

    Raises BadInput if the shapes differ, the mask is empty, or a value inside the mask is NaN or
    infinite.
    """
    shape = np.shape(first)
    require(
        len(shape) == 2 and 0 not in shape and shape == np.shape(second),
        f"{names[0]} and {names[1]} must have one shape (H, W), but they have {shape} and"
        f" {np.shape(second)}.",
    )
    inside = check_mask(mask, (shape[0], shape[1]))
    fields = np.where(inside, [first, second], 0.0).astype(np.float32)
    for field, name in zip(fields, names, strict=True):
        require(
            np.isfinite(field).all(),
            f"{name} contains NaN or infinite values inside the mask; take those pixels out of it.",
        )
    return fields[0], fields[1], inside


def zero_mean(height: FloatArray, mask: BoolArray) -> FloatArray:
    """Return `height` with a zero mean over the mask, NaN outside it."""
    mean = float(np.sum(height, where=mask, dtype=np.float64)) / int(np.count_nonzero(mask))
    return np.where(mask, height - mean, np.nan)


# Least-squares integration in the frequency domain: the height whose gradient is nearest to (p, q)
# has the spectrum Z = -i (w_x P + w_y Q) / |w|^2 (Frankot and Chellappa 1988, eq. 21); a filter of
# it is one more factor, T(|w|). Outside the rectangle the gradient field is zero (``zero``), or the
# height is mirrored about the borders (``mirror``): dz/dx then changes sign at the left and right
# one and dz/dy at the top and bottom.

Transfer = Callable[[Array], Array]
"""Gain of the height as a function of the radial frequency in radians per pixel."""


def _integrate_padded(gradient_x: FloatArray, gradient_y: FloatArray) -> FloatArray:
    """Height (H, W) in pixels, mean undefined, from dz/dx and dz/dy (y up), zero outside the
    rectangle."""
    height, width = gradient_x.shape
    size = (scipy.fft.next_fast_len(height, real=True), scipy.fft.next_fast_len(width, real=True))
    row_frequency = 2 * np.pi * scipy.fft.fftfreq(size[0])
    column_frequency = 2 * np.pi * scipy.fft.rfftfreq(size[1])
    # A real signal has no derivative at the highest frequency of an even length: sine there is zero
    # at every sample.
    row_factor = np.where(np.isclose(np.abs(row_frequency), np.pi), 0.0, row_frequency)
    column_factor = np.where(np.isclose(column_frequency, np.pi), 0.0, column_frequency)
    spectrum = scipy.fft.rfft2(gradient_x, size, workers=2)
    spectrum *= column_factor.astype(np.float32)[None, :]
    of_rows = scipy.fft.rfft2(-gradient_y, size, workers=2)
    of_rows *= row_factor.astype(np.float32)[:, None]
    spectrum += of_rows
    spectrum *= _radial_factor(row_frequency, column_frequency, None) * np.complex64(-1j)
    result = scipy.fft.irfft2(spectrum, size, workers=2, overwrite_x=True)
    return result[:height, :width]


def integrate_mirrored(
    gradient_x: FloatArray, gradient_y: FloatArray, transfer: Transfer | None = None
) -> FloatArray:
    """Height (H, W) in pixels, mean undefined, from dz/dx and dz/dy (y up), zero outside the
    surface; mirrored about the borders. `transfer`: radial gain of the height, or None for one.
    """
    height, width = gradient_x.shape
    row_frequency = np.pi * np.arange(height) / height
    column_frequency = np.pi * np.arange(width) / width
    # (H, W): sine k + 1 at column k; at row k
    along_columns = scipy.fft.dct(scipy.fft.dst(gradient_x, axis=1, workers=2), axis=0, workers=2)
    along_rows = scipy.fft.dct(scipy.fft.dst(-gradient_y, axis=0, workers=2), axis=1, workers=2)
    spectrum = np.zeros((height, width), dtype=np.float32)
    spectrum[:, 1:] = along_columns[:, :-1] * column_frequency.astype(np.float32)[None, 1:]
    spectrum[1:] += along_rows[:-1] * row_frequency.astype(np.float32)[1:, None]
    spectrum *= -_radial_factor(row_frequency, column_frequency, transfer)
    return np.asarray(
        scipy.fft.idctn(spectrum, type=2, workers=2, overwrite_x=True), dtype=np.float32
    )


def _radial_factor(
    row_frequency: Array, column_frequency: Array, transfer: Transfer | None
) -> FloatArray:
    """T(|w|) / |w|^2, zero at the origin."""
    square = row_frequency[:, None] ** 2 + column_frequency[None, :] ** 2
    square[0, 0] = 1.0
    factor = 1.0 / square
    if transfer is not None:
        factor *= transfer(np.sqrt(square))
    factor[0, 0] = 0.0
    return factor.astype(np.float32)


def frankot_chellappa(
    gradient_x: Any, gradient_y: Any, mask: Any = None, padding: str = "zero"
) -> FloatArray:
    """Height whose gradient is nearest to the given one, over a whole rectangle.

    The field outside the mask counts as flat, which bends a surface that ends steeply: use
    :func:`splitknit.integration.poisson` for shape. Frequencies are in radians per pixel, so
    heights have true scale.

    Parameters
    ----------
    gradient_x, gradient_y : (H, W)
        dz/dx and dz/dy, y up, dimensionless. Values outside the mask are ignored.
    mask : (H, W) bool, optional
        The surface; everything by default.
    padding : ``zero`` or ``mirror``
        ``zero`` as the thesis: the rectangle continued by zeros to a fast length, then periodic.
        ``mirror``: the height is mirrored about the borders, so that a surface cut by a border is
        not forced to close.

    Returns
    -------
    (H, W) float32
        Height in pixels, mean zero over the mask, NaN outside it.

    Raises
    ------
    BadInput
        If shapes differ, the mask is empty, a gradient inside the mask is not finite, or `padding`
        is unknown.

    References
    ----------
    R. T. Frankot and R. Chellappa, "A method for enforcing integrability in shape from shading
    algorithms", IEEE Transactions on Pattern Analysis and Machine Intelligence 10 (1988), eq. 21;
    the thesis, (3.40) to (3.46).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(64)
    >>> slope = np.tile(np.cos(2 * np.pi * x / 32), (64, 1))
    >>> height = frankot_chellappa(slope, np.zeros_like(slope))
    >>> round(float(height.max()), 2)  # 32 / (2 pi)
    5.09
    """
    slope_x, slope_y, inside = check_fields(gradient_x, gradient_y, mask)
    require(
        padding in ("zero", "mirror"), f"padding must be zero or mirror, but it is '{padding}'."
    )
    integrate = _integrate_padded if padding == "zero" else integrate_mirrored
    return zero_mean(integrate(slope_x, slope_y), inside)
