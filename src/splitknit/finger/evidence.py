"""How much every pixel looks like skin rather than like the backdrop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.finger.regions import dilate, erode, wide_blur
from splitknit.model import BoolArray, FloatArray

SAMPLES = 8000
"""The backdrop is fitted to about so many pixels."""


def chromaticity(image: FloatArray) -> FloatArray:
    """Chromaticity of the modified specular-free image, (H, W, 3) in [0, 1].

    I_MSF = I - I_min + mean(I_min) with I_min the least channel of each pixel. Adding the mean back, as the sources of
    the dichromatic model do, also settles the colour of the unlit backdrop: where there is next to no light the three
    channels of I_MSF are alike and noise does not turn into colour.

    References
    ----------
    The thesis, eqs. 3.58-3.63, with (3.61) corrected (``I - I_min + I_min_avg``).
    """
    least = image.min(axis=2)
    average = max(float(np.maximum(least, 0.0).mean()), 1e-3 * float(np.abs(image).max()), 1e-12)
    msf = np.maximum(image - least[..., None] + np.float32(average), np.float32(1e-12))
    return np.asarray(msf / msf.sum(axis=2, keepdims=True), dtype=np.float32)


def signals(image: FloatArray) -> list[FloatArray]:
    """The two quantities that tell skin from a dark neutral backdrop: brightness, and the coloured part of the light.

    The coloured part, the sum of I - I_min, ignores neutral light: glare, white dust, leaked infra-red.
    """
    if image.ndim == 2:
        return [image]
    brightness = image.sum(axis=2)
    coloured = brightness - np.float32(3.0) * image.min(axis=2)
    return [np.asarray(brightness, dtype=np.float32), np.asarray(coloured, dtype=np.float32)]


def skin_evidence(
    image: FloatArray,
    seed: BoolArray,
    margin: float,
    share: float,
    noise_factor: float,
    *,
    local: bool = False,
    samples: int = SAMPLES,
) -> tuple[FloatArray, bool]:
    """Evidence map: above one where a pixel rises from the backdrop by enough to be skin.

    For each signal the backdrop is a quadratic surface fitted robustly outside `seed`, and the threshold is `share` of
    the rise inside `seed` nearby (at most of its median), but at least `noise_factor` times the noise outside. So a
    shadow on the finger stays finger.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) linear
    seed : (H, W) surely finger
    margin : pixels around `seed` that belong to neither side
    share, noise_factor : see above
    local : let the backdrop follow a shadow's edge beside the finger; only for a `seed` that is already complete
    samples : pixels to which the backdrop is fitted

    Returns
    -------
    evidence : (H, W) float32
    usable : whether any signal tells `seed` from the backdrop
    """
    outside = ~dilate(seed, margin)
    inside = erode(seed, 0.5 * margin)
    inside = inside if inside.any() else seed
    evidence = np.zeros(seed.shape, dtype=np.float32)
    usable = False
    if outside.sum() < 50:
        return seed.astype(np.float32) * np.float32(2.0), True
    for signal in signals(image):
        backdrop, noise = _fit_backdrop(signal, outside, samples)
        rise = signal - backdrop
        if local:
            rise = rise - _local_offset(rise, outside, noise, 2.0 * margin)
        level = float(np.median(rise[inside]))
        if level < 3.0 * noise_factor * noise or level <= 0.0:
            continue
        usable = True
        threshold = np.maximum(share * _local_level(rise, inside, level, 2.0 * margin), noise_factor * noise)
        np.maximum(evidence, rise / threshold.astype(np.float32), out=evidence)
    return evidence, usable


def _local_level(rise: FloatArray, inside: BoolArray, level: float, sigma: float) -> FloatArray:
    """Mean rise of the finger near every pixel, at most `level`: a shaded part has its own, lower one."""
    weight = inside.astype(np.float32)
    cover = wide_blur(weight, sigma)
    mean = wide_blur(np.maximum(rise, 0.0) * weight, sigma) / np.maximum(cover, np.float32(1e-3))
    return np.minimum(np.where(cover > 1e-2, mean, np.float32(level)), np.float32(level)).astype(np.float32)


def _local_offset(rise: FloatArray, outside: BoolArray, noise: float, sigma: float) -> FloatArray:
    """Mean of what the backdrop's fit leaves near every pixel; dust, which is bright, hardly counts."""
    weight = outside.astype(np.float32)
    cover = wide_blur(weight, sigma)
    offset = wide_blur(np.minimum(rise, np.float32(3.0 * noise)) * weight, sigma) / np.maximum(cover, np.float32(1e-3))
    return np.where(cover > 1e-3, offset, np.float32(0.0)).astype(np.float32)


def rise_at_edge(image: FloatArray, mask: BoolArray, reach: float) -> float:
    """Relative step of brightness or colour across the outline of `mask`: (inside - outside) / inside, the larger."""
    inside = mask & ~erode(mask, reach)
    near = dilate(mask, 0.3 * reach)
    outside = dilate(mask, 1.3 * reach) & ~near
    if not outside.any() or not inside.any():
        return 0.0
    steps = []
    for signal in signals(image):
        within, without = float(np.median(signal[inside])), float(np.median(signal[outside]))
        steps.append((within - without) / within if within > 0.0 else 0.0)
    return max(steps)


def _fit_backdrop(signal: FloatArray, outside: BoolArray, samples: int) -> tuple[FloatArray, float]:
    """Robust quadratic surface through `signal` outside the finger, and the noise about it.

    What does not belong to the backdrop (a shadowed part of the finger that the seed missed, dust) is brighter, so
    the fit starts from the darker pixels, and the noise is measured on residuals below the surface.
    """
    height, width = signal.shape
    x = np.linspace(-1.0, 1.0, width)
    y = np.linspace(-1.0, 1.0, height)
    rows, columns = np.nonzero(outside)
    step = max(1, len(rows) // samples)
    rows, columns = rows[::step], columns[::step]
    values = signal[rows, columns].astype(np.float64)
    design = _quadratic(x[columns], y[rows])
    residual = values - float(np.percentile(values, 40.0))
    keep, noise = _below(residual)
    for _ in range(6):
        part = design[keep]
        normal = np.einsum("ni,nj->ij", part, part) + 1e-6 * len(part) * np.eye(6)
        solution = np.linalg.solve(normal, np.einsum("ni,n->i", part, values[keep]))
        residual = values - np.einsum("ni,i->n", design, solution)
        keep, noise = _below(residual)
    surface = np.zeros(signal.shape, dtype=np.float64)
    terms = (np.ones((1, 1)), x[None, :], y[:, None], x[None, :] ** 2, y[:, None] ** 2, x[None, :] * y[:, None])
    for weight, term in zip(solution, terms, strict=True):
        surface += weight * term
    return surface.astype(np.float32), noise


def _below(residual: NDArray[np.float64]) -> tuple[NDArray[np.bool_], float]:
    """Residuals that belong to the backdrop, and the scatter of those below it.

    The larger of a robust and a plain standard deviation: the latter counts a shadow's edge that the fit cannot follow.
    """
    negative = -residual[residual <= 0.0]
    if negative.size == 0:
        return residual <= 1e-12, 0.0
    noise = max(1.4826 * float(np.median(negative)), float(np.sqrt(np.mean(negative * negative))))
    return residual <= max(2.5 * noise, 1e-12), noise


def _quadratic(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=1)
