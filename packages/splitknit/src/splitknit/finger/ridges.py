"""The relief as a print: what ink on paper would show, seen straight from above.

The relief is brought upright (tip up), low-passed for the coarser grid, sampled at the print's
resolution, mirrored, and evened out so that ridges are equally dark from the middle to the edge.
Nothing is unrolled here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.errors import BadInput, require
from splitknit.imaging.geometry import bounding_box, gaussian_mean, warp
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.reconstruction import Reconstruction, Surface

MM_PER_INCH = 25.4
"""Millimetres in an inch. Source: definition of the inch."""
_CONTRAST_WINDOW_MM = 0.6
"""Standard deviation of the Gaussian window over which mean and contrast are made even. Chosen on:
judgement. Range: 0.3 to 1.2 (validation/parameters)."""


def relief_print(
    ridge_mm: FloatArray,
    mask: BoolArray,
    px_per_mm: float,
    input_from_upright: Array,
    upright_size: tuple[int, int],
    *,
    ppi: float = 500.0,
) -> NDArray[np.uint8]:
    """Return the relief as an upright, mirrored print: ridges dark, valleys and background white.

    Raises BadInput if shapes disagree, the mask is empty, or the scale is not positive. Returns (h,
    w) uint8: one pixel is exactly ``25.4 / ppi`` mm; the middle of the print is the middle of the
    upright frame. Column 0 shows the right edge of the upright camera image, as paper does.
    `ridge_mm`: (H, W) height of the relief, ridges up, on the input's pixel grid, ignored outside
    `mask`; `px_per_mm`: of the input; `input_from_upright`: (3, 3), takes (column, row, 1) of the
    upright frame to the input; `upright_size`: its rows and columns.

    >>> import numpy as np
    >>> relief = np.zeros((40, 60), np.float32)
    >>> relief_print(relief, np.ones((40, 60), bool), 500 / 25.4, np.eye(3), (40, 60)).shape
    (40, 60)
    """
    require(np.isfinite(px_per_mm) and px_per_mm > 0, "px_per_mm must be a positive number.")
    mask = check_mask(mask, (ridge_mm.shape[0], ridge_mm.shape[1]))
    input_per_print = px_per_mm * MM_PER_INCH / ppi
    size = (
        max(1, round(upright_size[0] / input_per_print)),
        max(1, round(upright_size[1] / input_per_print)),
    )

    rows, columns = bounding_box(mask, int(4 * input_per_print) + 2)
    inside = mask[rows, columns].astype(np.float32)
    relief = np.where(mask[rows, columns], ridge_mm[rows, columns], 0.0)
    # A Gaussian of half the print's pixel: 0.3 % of the contrast is left at the print's sampling
    # frequency.
    sigma = 0.5 * input_per_print if input_per_print > 1 else 0.0
    weight = gaussian_mean(inside, sigma)
    relief = gaussian_mean(relief, sigma) / np.maximum(weight, 1e-3) * (weight > 1e-3)

    window_from_input = np.eye(3)
    window_from_input[:2, 2] = -columns.start, -rows.start
    input_from_print = input_from_upright @ upright_from_print(size, upright_size, input_per_print)
    window_from_print = window_from_input @ input_from_print
    weight = np.clip(warp(weight, window_from_print, size), 0.0, 1.0)
    relief = warp(relief.astype(np.float32), window_from_print, size)
    centred, deviation = _centred(relief, weight, _CONTRAST_WINDOW_MM * ppi / MM_PER_INCH)
    known = deviation[weight > 0.5]
    typical = float(np.median(known)) if known.size else 0.0
    return (
        _ink(centred, deviation, typical, weight)
        if typical > 0
        else np.full(size, 255, dtype=np.uint8)
    )


def upright_from_print(size: tuple[int, int], upright_size: tuple[int, int], step: float) -> Array:
    """(3, 3) from (column, row, 1) of the print to the upright frame: centre on centre, left and
    right exchanged."""
    across = (upright_size[1] - 1) / 2
    down = (upright_size[0] - 1) / 2
    right = step * (size[1] - 1) / 2
    bottom = step * (size[0] - 1) / 2
    return np.array([[-step, 0.0, across + right], [0.0, step, down - bottom], [0.0, 0.0, 1.0]])


INK_STEEPNESS = 1.1
"""Steepness of the grey curve; 0.5 is soft, 3 is nearly black and white. Chosen on: judgement.
Range: 0.55 to 2.2 (validation/parameters)."""


def _ink(
    centred: FloatArray, deviation: FloatArray, typical: float, weight: FloatArray
) -> NDArray[np.uint8]:
    """Grey values of a relief as of :func:`_centred`; `weight` in [0, 1] is how much of a pixel is
    inked."""
    # contrast below this fraction of the finger's median is not raised further, so flat skin stays
    # flat
    score = centred / np.maximum(deviation, 0.3 * typical)
    dark = 0.5 + 0.5 * np.tanh(INK_STEEPNESS * score)
    return np.round(255.0 * (1.0 - weight * dark)).astype(np.uint8)


def _centred(values: FloatArray, weight: FloatArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Values (h, w) less their weighted Gaussian mean, zero without weight, and their standard
    deviation about it."""
    total: FloatArray = np.maximum(gaussian_mean(weight, sigma), 1e-3)
    centred: FloatArray = values
    # the second pass takes out what a one-sided window leaves of a slope near the edge
    for _ in range(2):
        centred = (centred - gaussian_mean(centred * weight, sigma) / total) * (weight > 0)
    return centred, np.sqrt(
        np.maximum(gaussian_mean(centred * centred * weight, sigma) / total, 0.0)
    )


def surface_print(surface: Surface | Reconstruction, ppi: float = 500.0) -> NDArray[np.uint8]:
    """Relief of a reconstruction as ink on paper: what ``print.png`` shows."""
    return relief_print(
        surface.ridge_mm,
        surface.mask,
        1.0 / surface.pitch_mm,
        surface.input_from_upright,
        surface.upright_size,
        ppi=ppi,
    )


# Grey values of a print: ridges dark, contrast even up to the edges, paper white where there are no
# ridges.


_EMPTY_CONTRAST = 0.1
"""Local contrast, as a fraction of the finger's median, below which skin is paper."""
_NARROW_WINDOW = 0.4
"""The window of that contrast, as a fraction of the other: blank skin at the outline is paper up to
the last ridge. Chosen on: judgement. Range: 0.2 to 0.8 (validation/parameters)."""


def ink(values: FloatArray, weight: FloatArray, ppi: float = 500.0) -> NDArray[np.uint8]:
    """Print a field that is high on ridges and low in valleys.

    The local mean is taken out twice (the second pass removes what a one-sided window leaves of a
    slope at the edge), the rest is divided by its local standard deviation and pressed into grey
    values by a soft step. Raises BadInput if the shapes disagree, nothing lies on the finger, or
    nothing varies: a print without ridges. Returns (h, w) uint8: ridges dark, valleys and
    background white. `values`: (h, w) float32; such as the relief; any unit. `weight`: (h, w)
    float32; fraction of the pixel that lies on the finger, 0 to 1. Source: L. Hong, Y. Wan and A.
    Jain 1998, Fingerprint image enhancement: algorithm and performance evaluation, section 2.3
    (mean and variance made even; here locally).
    """
    if values.ndim != 2 or values.shape != weight.shape:
        raise BadInput(
            f"values and weight must have one shape (h, w), but they have {values.shape},"
            f" {weight.shape}."
        )
    inside = weight > 0.5
    require(inside.any(), "nothing of the finger lies on the print.")
    sigma = _CONTRAST_WINDOW_MM * ppi / MM_PER_INCH
    centred, deviation = _centred(values, weight, sigma)
    typical = float(np.median(deviation[inside]))
    scale = float(np.abs(values[inside]).max())
    require(
        typical > 1e-6 * scale,
        "the print has no ridges: its relief is flat; check focus and light of the capture.",
    )
    around = np.maximum(gaussian_mean(weight, _NARROW_WINDOW * sigma), 1e-3)
    near = np.sqrt(gaussian_mean(centred * centred * weight, _NARROW_WINDOW * sigma) / around)
    # local contrast, as a fraction of the finger's median, above which skin is all ink
    opacity = (
        np.clip((near / typical - _EMPTY_CONTRAST) / (0.3 - _EMPTY_CONTRAST), 0.0, 1.0) * weight
    )
    return _ink(centred, deviation, typical, opacity)
