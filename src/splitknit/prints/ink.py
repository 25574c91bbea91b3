"""Grey values of a print: ridges dark, contrast even up to the edges, paper white where there are no ridges."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray
from splitknit.prints.ridges import CONTRAST_FLOOR, MM_PER_INCH, PrintSettings

_EMPTY, _FULL = 0.1, 0.3
"""Local contrast, as a share of the finger's median, below which skin is paper and above which it is all ink."""
_NARROW = 0.4
"""The window of that contrast, as a share of the other: blank skin at the outline is paper up to the last ridge."""


def ink(values: FloatArray, weight: FloatArray, settings: PrintSettings | None = None) -> NDArray[np.uint8]:
    """Print a field that is high on ridges and low in valleys.

    The local mean is taken out twice (the second pass removes what a one-sided window leaves of a slope at the edge),
    the rest is divided by its local standard deviation and pressed into grey values by a soft step.

    Parameters
    ----------
    values : (h, w) float32
        Such as the relief; any unit.
    weight : (h, w) float32
        Share of the pixel that lies on the finger, 0 to 1.
    settings : PrintSettings, optional

    Returns
    -------
    (h, w) uint8
        Ridges dark, valleys and background white.

    Raises
    ------
    BadInput
        If the shapes disagree, nothing lies on the finger, or nothing varies: a print without ridges.

    References
    ----------
    L. Hong, Y. Wan and A. Jain 1998, Fingerprint image enhancement: algorithm and performance evaluation, section 2.3
    (mean and variance made even; here locally).
    """
    settings = settings or PrintSettings()
    if values.ndim != 2 or values.shape != weight.shape:
        raise BadInput(f"values and weight must have one shape (h, w), but they have {values.shape}, {weight.shape}.")
    inside = weight > 0.5
    require(bool(inside.any()), "nothing of the finger lies on the print.")
    sigma = settings.window_mm * settings.ppi / MM_PER_INCH
    total: FloatArray = np.maximum(_blur(weight, sigma), np.float32(1e-3))
    centred: FloatArray = (values - _blur(values * weight, sigma) / total) * (weight > 0)
    centred = (centred - _blur(centred * weight, sigma) / total) * (weight > 0)
    deviation = np.sqrt(np.maximum(_blur(centred * centred * weight, sigma) / total, np.float32(0.0)))
    typical = float(np.median(deviation[inside]))
    scale = float(np.abs(values[inside]).max())
    require(
        typical > 1e-6 * scale, "the print has no ridges: its relief is flat; check focus and light of the capture."
    )
    score = centred / np.maximum(deviation, np.float32(CONTRAST_FLOOR * typical))
    around = np.maximum(_blur(weight, _NARROW * sigma), np.float32(1e-3))
    near = np.sqrt(_blur(centred * centred * weight, _NARROW * sigma) / around)
    shown = np.clip((near / np.float32(typical) - _EMPTY) / (_FULL - _EMPTY), 0.0, 1.0) * weight
    dark = 0.5 + 0.5 * np.tanh(np.float32(settings.contrast) * score)
    return np.asarray(np.round(255.0 * (1.0 - shown * dark)).astype(np.uint8))


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)
