"""Whether the camera answered in proportion to the light: colours, tone, local contrast, clipping.

Under L lights a matt pixel obeys I_k = l_k . b with its albedo times normal b (3 numbers); what is left over is the
same for all pixels where it is a gain of an image. Gains that differ between colours are the camera's white balance.
Gains that follow the stated brightness of the lights are its tone: where a light twice as bright gives 2^p times the
value, the gain of light k is (p - 1) log(brightness). Under lights of equal brightness the shading of the flanks shows
p; values that are not in proportion to the light also flatten or steepen the whole surface, as the outline shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.equations import shading, solve

Array = NDArray[np.float64]

_LIT, _WELL = 0.3, 0.5
"""Part of a pixel's brightest light from which a light counts in its fit, and from which its gain is judged: below,
attached shadows and light scattered in the skin matter more."""
_FEWEST = 100
"""Pixels, at least, of which a gain is the median."""
_SPREAD, _STATED = 0.01, 0.002
"""Sum of squares of the lights' log brightness, beside a tilt's, from which it shows the tone: 0.03 to 0.2 of LEDs that
differ by 10 %. Standard deviation of brightness as it is stated, at best, in the logarithm."""
_EXPONENTS = np.geomspace(0.55, 1.8, 9)
_FLANKS, _SOME = 0.6, 700
"""Quantile of the pixels, by how much they change with the light, from which they show the tone; how many will do."""
_DRIFT, _ALONE, _DRIFT_ERRORS = 0.03, 0.6, 3.0
"""Change of a light's brightness from which it has drifted; the part of all gains that it explains alone, and its own
standard errors, at least: gloss, shadows and scattering move the gains of several images a little."""
_AWAY = 0.9
"""Part of the half width of a finger, from its axis, on which its height is fitted."""


def image_gains(stack: Any, vectors: Any) -> Array:
    """Logarithm (C, L) of each image's gain, in each colour, over what least squares predicts of it; mean 0 by colour.

    Parameters
    ----------
    stack : (C, L, n)
        Linear light of n pixels in C colours under L lights.
    vectors : (L, 3, n)
        Direction to each light times its irradiance, at each pixel (near lights on a coarse surface will do).

    Returns
    -------
    (C, L)
        NaN where too few pixels are lit. A pattern as the lights' x and y is seen as a tilt of the surface, not here.

    References
    ----------
    Y. Queau et al., "LED-based photometric stereo", JMIV 60 (2018), eq. 2.5, for the pixel's equations.
    """
    lights = np.asarray(vectors, dtype=np.float32)
    gains = np.full((len(stack), len(lights)), np.nan)
    for own, light in zip(gains, np.asarray(stack, dtype=np.float32), strict=True):
        predicted, lit = _fitted(light, lights)
        judged = lit & (predicted > _WELL * predicted.max(axis=0)) & (light > 0)
        for k in np.flatnonzero(judged.sum(axis=1) >= _FEWEST):
            own[k] = np.median(np.log(light[k, judged[k]] / predicted[k, judged[k]]))
    return np.asarray(gains - gains.mean(axis=1, keepdims=True))


def _fitted(light: FloatArray, vectors: FloatArray) -> tuple[FloatArray, BoolArray]:
    """What least squares predicts of light (L, n), and where it counts."""
    lit = np.asarray(light > _LIT * light.max(axis=0), dtype=np.bool_)
    return shading(solve(light, vectors, lit.astype(np.float32)), vectors), lit


def colour_spread(gains: Array) -> float:
    """Standard deviation by which the gains (C, L) of :func:`image_gains` differ between colours; 0 of one colour."""
    return float(np.std(gains - gains.mean(axis=0))) if np.isfinite(gains).all() else 0.0


def tone_exponent(bands: Sequence[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Exponent p of the camera's answer to light, value = light^p, and its t value against p = 1.

    Parameters
    ----------
    bands : of (gains, directions, brightness)
        (L,) gains as of :func:`image_gains`; (L, 3) directions to the lights; (L,) brightness of their images as it is
        stated: intensity times exposure. One p is fitted to all bands.

    Returns
    -------
    p, t
        Its t value against p = 1, where brightness is stated to 0.2 % at best; NaN and 0 where the lights are
        too nearly equal.
    """
    product, square, freedom = 0.0, 0.0, -1
    pairs = []
    for gains, directions, brightness in bands:
        if len(gains) < 5 or not np.isfinite(gains).all():
            continue
        basis = np.linalg.qr(np.column_stack([np.ones(len(gains)), directions[:, :2]]))[0]
        level, gain = (values - basis @ (basis.T @ values) for values in (np.log(brightness), gains))
        pairs.append((level, gain))
        product, square, freedom = product + level @ gain, square + level @ level, freedom + len(gains) - 3
    if square < _SPREAD or freedom < 2:
        return float("nan"), 0.0
    slope = product / square
    rest = sum(float(((gain - slope * level) ** 2).sum()) for level, gain in pairs)
    return 1.0 + slope, slope / float(np.sqrt((rest / freedom + _STATED**2) / square))


def drifted_light(gains: Array, directions: Array) -> tuple[int, float] | None:
    """The light (L,) whose brightness alone explains the `gains` of :func:`image_gains`, and its relative brightness.

    Beside the patterns of `directions` (L, 3) that a tilt of the surface makes; None where no single light has changed.
    """
    basis = np.linalg.qr(np.column_stack([np.ones(len(gains)), directions[:, :2]]))[0]
    beside = np.eye(len(gains)) - basis @ basis.T
    rest, own = beside @ gains, np.diag(beside)
    explained = rest**2 / own
    k = int(np.argmax(explained))
    change, total = float(rest[k] / own[k]), float(rest @ rest)
    error = np.sqrt((total - explained[k]) / max(len(gains) - 4, 1) / own[k])
    sure = explained[k] > _ALONE * total and abs(change) > _DRIFT_ERRORS * error
    return (k, float(np.exp(change))) if sure and abs(np.expm1(change)) > _DRIFT else None


def shading_exponent(stack: Any, vectors: Any) -> float:
    """The exponent p, value = light^p, at which shading fits matt surfaces best, under equal lights.

    Small errors of their brightness are taken out. Parameters as of :func:`image_gains`, in colours that scatter
    little in the skin. Light that is added to all images does not show: it looks like a surface that faces the camera.
    """
    lights = np.asarray(vectors, dtype=np.float32)
    best = []
    for light in np.maximum(np.asarray(stack, dtype=np.float32), np.float32(1e-4)):
        varied = light.std(axis=0) / light.mean(axis=0)
        some = np.flatnonzero(varied > np.quantile(varied, _FLANKS))
        some = some[:: max(1, len(some) // _SOME)]
        left = [_left(light[:, some] ** np.float32(1 / p), lights[..., some]) * p for p in _EXPONENTS]
        k = int(np.clip(np.argmin(left), 1, len(left) - 2))
        a, b, _ = np.polyfit(np.log(_EXPONENTS[k - 1 : k + 2]), left[k - 1 : k + 2], 2)
        best.append(float(np.clip(-b / (2 * a), *np.log(_EXPONENTS[[0, -1]]))) if a > 0 else 0.0)
    return float(np.exp(np.mean(best)))


def _left(light: FloatArray, vectors: FloatArray) -> float:
    """Median of what each pixel leaves of its light, relative, once every image has its own gain."""
    gains = np.nan_to_num(image_gains(light[None], vectors)[0])
    even = light / np.exp(gains).astype(np.float32)[:, None]
    predicted, lit = _fitted(even, vectors)
    rest = (even - predicted) * lit / np.maximum(predicted.mean(axis=0), np.float32(1e-6))
    return float(np.median(np.sqrt((rest**2).sum(axis=0) / np.maximum(lit.sum(axis=0) - 3, 1))))


def height_over_half_width(height_mm: FloatArray, mask: BoolArray, pitch_mm: float) -> float:
    """How high a finger's surface (h, w) rises over half its width, as half an ellipse across: median over its rows.

    NaN where it has no ten rows that are nearly as wide as the widest and end inside the image.
    """
    width = mask.sum(axis=1)
    rows = np.flatnonzero((width > 0.8 * width.max()) & ~mask[:, 0] & ~mask[:, -1])
    ratios = []
    for row in rows[len(rows) // 4 : len(rows) - len(rows) // 4]:
        columns = np.flatnonzero(mask[row])
        half = 0.5 * (columns[-1] - columns[0] + 1)
        across = (columns - 0.5 * (columns[0] + columns[-1])) / half
        some = np.abs(across) < _AWAY
        terms = np.column_stack([np.ones(some.sum()), across[some], np.sqrt(1 - across[some] ** 2)])
        fit = np.linalg.lstsq(terms, height_mm[row, columns[some]].astype(np.float64), rcond=None)[0]
        ratios.append(fit[2] / (half * pitch_mm))
    return float(np.median(ratios)) if len(ratios) >= 10 else float("nan")


def blue_over_red(stack: Any) -> float:
    """Median of blue over red light of n pixels, of the light (3, L, n) of all lights together."""
    light = np.asarray(stack, dtype=np.float32).sum(axis=1)
    return float(np.median(light[2]) / max(float(np.median(light[0])), 1e-12))


def clipped_part(pixels: Any) -> tuple[float, int, int]:
    """Largest part of n pixels at the highest stored value of its colour, in an image; the image, and the colour.

    `pixels`: (L, n, C) as stored. The highest value is that of all images of a colour: clipped images may have been
    darkened later.
    """
    values = np.asarray(pixels)
    top = values.max(axis=(0, 1))
    part = (values >= top - top // 100).mean(axis=1)
    image, colour = np.unravel_index(int(np.argmax(part)), part.shape)
    return float(part.max()), int(image), int(colour)
