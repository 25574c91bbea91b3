"""Knitting: ridge-valley relief and finger shape become one surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.errors import check_image, check_mask, require
from splitknit.model import FloatArray
from splitknit.settings import Checked


@dataclass(frozen=True, slots=True)
class KnitSettings(Checked):
    """How relief and shape are joined."""

    method: Literal["addition", "crossover", "none", "whole"] = "crossover"
    """``addition`` as the thesis; ``crossover``; ``none``: the visible surface alone, split by the shapelets;
    ``whole``: the visible surface alone, not split, whose height is what the thesis's matcher takes."""


def add(ridge_mm: Any, shape_mm: Any, mask: Any = None) -> FloatArray:
    """Sum of relief and shape, pixel by pixel; NaN outside the mask.

    Frequencies that both parts contain count twice (see :func:`crossover`). `ridge_mm`, `shape_mm`: (H, W), in the same
    unit; `mask`: (H, W) bool, optional. Source: the thesis, section 3.3.3 and figure 3.27.
    """
    ridge, shape, inside = _checked(ridge_mm, shape_mm, mask)
    return np.where(inside, ridge + shape, np.float32(np.nan)).astype(np.float32)


def crossover(
    visible_mm: Any, shape_mm: Any, response: Callable[[NDArray[np.float64]], Any], mask: Any = None
) -> FloatArray:
    """Fine detail from one surface and the rest from the other, each frequency once: H visible + (1 - H) shape.

    Computed as shape + H (visible - shape), so that only the difference of the two, which is small and smooth at the
    outline, is filtered. `visible_mm`, `shape_mm`: (H, W) of one unit, NaN is allowed outside `mask`; `response`: H,
    from angular frequencies in rad/px (an array) to gains, zero at zero and one where the detail is fine. Returns (H,
    W) float32, NaN outside the mask. Raises BadInput if shapes differ, the mask is empty, or a value inside the mask is
    not finite.

    >>> import numpy as np
    >>> flat, bumps = np.zeros((32, 32)), np.tile(np.cos(np.arange(32) * np.pi), (32, 1))
    >>> knitted = crossover(bumps + 5.0, flat, lambda omega: omega > 0.5)
    >>> bool(np.allclose(knitted, bumps, atol=1e-5))
    True
    """
    visible, shape, inside = _checked(visible_mm, shape_mm, mask)
    difference = visible - shape
    difference = np.where(inside, difference - difference[inside].mean(dtype=np.float64), 0.0).astype(np.float32)
    rows, columns = difference.shape
    mirrored = np.pad(difference, ((0, rows), (0, columns)), mode="symmetric")
    spectrum = scipy.fft.rfft2(mirrored, workers=2)
    wy = 2 * np.pi * np.fft.fftfreq(2 * rows)[:, None]
    wx = 2 * np.pi * np.fft.rfftfreq(2 * columns)[None, :]
    gain = np.asarray(response(np.hypot(wx, wy)), dtype=np.float32)
    detail = scipy.fft.irfft2(spectrum * gain, mirrored.shape, workers=2)[:rows, :columns]
    return np.where(inside, shape + detail, np.float32(np.nan)).astype(np.float32)


def _checked(first: Any, second: Any, mask: Any) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    one, two = np.asarray(first), np.asarray(second)
    require(
        one.ndim == 2 and one.shape == two.shape,
        f"relief and shape must have one shape (H, W), but they have {one.shape} and {two.shape}.",
    )
    inside = check_mask(mask, (one.shape[0], one.shape[1]))
    filled = [np.where(inside, part, 0.0) for part in (one, two)]
    return check_image(filled[0], name="the relief"), check_image(filled[1], name="the shape"), inside
