"""Whether stored values are linear light or sRGB code: told by how they shade, where a photograph
does not state it."""

from __future__ import annotations

import numpy as np

from splitknit.imaging.band import _srgb_light, srgb_code
from splitknit.imaging.parameters import (
    BEST_PIXELS,
    BEST_RATIO,
    CLEARLY_FREE,
    CLEARLY_LINEAR,
    CODE_NOISE,
    CURVED_UP_TO,
    FEWEST_LIGHTS,
    FEWEST_VALUES,
    FULL_DIFFERENCE,
    RESPONSE_EXPONENTS,
    RESPONSE_PIXELS,
    SURE_ERRORS,
    UNEQUAL_LOSS,
)
from splitknit.model import Array, FloatArray

_EXPONENTS = np.array(RESPONSE_EXPONENTS)
_SRGB = 2
"""Place of the exponent of sRGB code among those that are tried. Source: derived."""
_LINEAR = 6
"""Place of the exponent of linear light. Source: derived."""


def shading_is_srgb(codes: FloatArray, vectors: Array, *, known: bool) -> bool | None:
    """Whether stored values are sRGB, by their shading; None where that decides nothing.

    The model of values (L, n) in [0, 1] is (a_k v_k . g)^e: g by least squares at each pixel, over
    the vectors (L, 3) that light it without clipping, for each of some exponents e. `known`: the
    vectors' lengths are how bright the lights are; else their brightness a is estimated with each
    exponent where that explains far more than equal lights, as unequal ones look like a wrong
    curve. Cauchy's loss decides, which gloss and cast shadows bend least.

    Source: S. Lin, J. Gu, S. Yamazaki and H.-Y. Shum, "Radiometric calibration from a single
    image", CVPR 2004, for curves from what must be linear; here that is Lambert's law.
    """
    top = codes.max(axis=0)
    lit = (codes > 0.25 * top) & (codes < 0.97) & (top > 0.15) & (top - codes.min(axis=0) > 0.03)
    good = lit.sum(axis=0) >= (4 if known else 5)
    good &= good.cumsum() % max(1, int(good.sum()) // RESPONSE_PIXELS) == 0
    used = lit[:, good].any(axis=1)
    values = codes[used][:, good].astype(np.float64)
    weights = lit[used][:, good].astype(np.float64)
    vectors = vectors[used]
    if int(weights.sum()) < FEWEST_VALUES or len(vectors) < (
        FEWEST_LIGHTS if known else FEWEST_LIGHTS + 1
    ):
        return None
    costs = np.array(
        [_cost(values, weights, vectors, exponent, known=True) for exponent in _EXPONENTS]
    )
    if not known:
        free = np.array(
            [_cost(values, weights, vectors, exponent, known=False) for exponent in _EXPONENTS]
        )
        known = bool(free.sum(axis=(1, 2)).min() > UNEQUAL_LOSS * costs.sum(axis=(1, 2)).min())
        costs = costs if known else free
    apart = (costs[_SRGB] - costs[_LINEAR])[weights > 0]
    total = costs.sum(axis=(1, 2))
    if abs(float(apart.mean())) < SURE_ERRORS * float(apart.std()) / np.sqrt(apart.size):
        return None
    if _EXPONENTS[np.argmin(total)] <= CURVED_UP_TO:
        return True
    if not known:
        return False if total[_SRGB] > CLEARLY_FREE * total[_LINEAR] else None
    linear = (
        total[_SRGB] > CLEARLY_LINEAR * total[_LINEAR]
        and _ratio_where_best(values, weights, vectors) > BEST_RATIO
    )
    return False if linear else None


def _ratio_where_best(values: Array, lit: Array, vectors: Array) -> float:
    """Residual (rms) as sRGB over that as linear, of the pixels that gloss, shadows and scattering
    bend least."""
    residuals = []
    for light, code in ((values, np.asarray), (_srgb_light(values), srgb_code)):
        g = _lambertian(light, lit, vectors)
        rest = (values - code(np.clip(vectors @ g.T, 0.0, 1.0))) * lit
        residuals.append(
            np.sqrt((rest**2).sum(axis=0) / np.maximum(lit.sum(axis=0) - 3.0, 1.0)) + CODE_NOISE
        )
    linear, srgb = residuals
    best = linear * srgb <= np.quantile(linear * srgb, BEST_PIXELS)
    return float(np.exp(np.log(srgb[best] / linear[best]).mean()))


def _cost(values: Array, lit: Array, vectors: Array, exponent: float, *, known: bool) -> Array:
    """(L, n) Cauchy's loss of what light = values^(1 / exponent) leaves of the values, zero where
    no light falls."""
    light = values ** (1.0 / exponent)
    weights = lit
    scaled = vectors
    for _ in range(3):
        if not known:
            scaled = vectors * _brightness(light, weights, vectors)[:, None]
        g = _lambertian(light, weights, scaled)
        rest = values - np.clip(scaled @ g.T, 1e-4, None) ** exponent
        wide = 3.0 * max(float(np.median(np.abs(rest[lit > 0]))), 1e-3)
        weights = lit / (1.0 + (rest / wide) ** 2)
    return np.log1p((rest / FULL_DIFFERENCE) ** 2) * lit


def _lambertian(light: FloatArray, weights: Array, vectors: Array) -> Array:
    """(n, 3) normal times albedo of each pixel, by weighted least squares."""
    moments = np.einsum("ln,li,lj->nij", weights, vectors, vectors) + 1e-9 * np.eye(3)
    right = np.einsum("ln,ln,li->ni", weights, light, vectors)
    return np.asarray(np.linalg.solve(moments, right[..., None])[..., 0])


def _brightness(light: Array, weights: Array, vectors: Array) -> Array:
    """(L,) brightness of the lights, as :func:`splitknit.diagnosis.gains.light_gains` finds it, in
    one step."""
    inverse = np.linalg.inv(
        np.einsum("ln,li,lj->nij", weights, vectors, vectors) + 1e-9 * np.eye(3)
    )
    own = weights * light
    each = 1.0 / np.maximum((weights * light**2).sum(axis=0), 1e-12)
    power = (own * light * each).sum(axis=1)
    pulls = np.einsum("ki,nij,ln,lj->nkl", vectors, inverse, own, vectors, optimize=True)
    left = np.diag(power) - np.einsum("kn,nkl->kl", own * each, pulls)
    root = 1.0 / np.sqrt(np.maximum(power, 1e-12))
    inverse_gains = np.abs(np.linalg.eigh(root[:, None] * left * root)[1][:, 0] * root)
    return np.asarray(1.0 / np.maximum(inverse_gains / inverse_gains.max(), 1e-3))
