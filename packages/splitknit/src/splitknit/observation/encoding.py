"""Whether stored values are linear light or sRGB code: told by how they shade, where a photograph
does not state it."""

from __future__ import annotations

import numpy as np

from splitknit.imaging.pixels import srgb_code, srgb_light
from splitknit.model import Array, FloatArray

_EXPONENTS = np.array([0.30, 0.36, 0.45, 0.55, 0.67, 0.82, 1.0, 1.22])
"""Exponents of the camera's response that are tried: sRGB code is about the power 1 / 2.2 of light.
"""
_SRGB, _LINEAR = 2, 6
"""Their places of sRGB code and of linear light."""
FEWEST_LIGHTS = 5
"""Lights of known brightness from which shading shows the curve; one more where it is estimated."""


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
    good &= good.cumsum() % max(1, int(good.sum()) // 1500) == 0
    used = lit[:, good].any(axis=1)
    values = codes[used][:, good].astype(np.float64)
    weights = lit[used][:, good].astype(np.float64)
    vectors = vectors[used]
    if int(weights.sum()) < 1000 or len(vectors) < (FEWEST_LIGHTS if known else FEWEST_LIGHTS + 1):
        return None
    costs = np.array(
        [_cost(values, weights, vectors, exponent, known=True) for exponent in _EXPONENTS]
    )
    if not known:
        free = np.array(
            [_cost(values, weights, vectors, exponent, known=False) for exponent in _EXPONENTS]
        )
        # lamps that differ by 15 % leave 0.18 and less, equal ones 0.36 and more; chosen on 52
        # simulated captures of objects
        known = bool(free.sum(axis=(1, 2)).min() > 0.25 * costs.sum(axis=(1, 2)).min())
        costs = costs if known else free
    apart = (costs[_SRGB] - costs[_LINEAR])[weights > 0]
    total = costs.sum(axis=(1, 2))
    if abs(float(apart.mean())) < 5.0 * float(apart.std()) / np.sqrt(apart.size):
        return None
    # 0.45 to 0.7 of sRGB photographs, 0.82 and more of linear ones; chosen on the same captures
    if _EXPONENTS[np.argmin(total)] <= 0.7:
        return True
    if not known:
        # up to 2.3 on objects stored as sRGB, but for one glossy pillow (3.6)
        return False if total[_SRGB] > 2.5 * total[_LINEAR] else None
    # 1.25 and more of linear photographs (DiLiGenT's bear, Washington's grey ball, renders by
    # others); gloss on a shallow relief hides the curve, so the pixels that fit best must agree:
    # 1.01 to 1.72 of them, 0.56 to 0.94 of the same as sRGB
    linear = (
        total[_SRGB] > 1.15 * total[_LINEAR] and _ratio_where_best(values, weights, vectors) > 0.98
    )
    return False if linear else None


def _ratio_where_best(values: Array, lit: Array, vectors: Array) -> float:
    """Residual (rms) as sRGB over that as linear, of the pixels that gloss, shadows and scattering
    bend least."""
    residuals = []
    for light, code in ((values, np.asarray), (srgb_light(values), srgb_code)):
        g = _lambertian(light, lit, vectors)
        rest = (values - code(np.clip(vectors @ g.T, 0.0, 1.0))) * lit
        residuals.append(
            np.sqrt((rest**2).sum(axis=0) / np.maximum(lit.sum(axis=0) - 3.0, 1.0))
            + 0.003  # of 8 bits
        )
    linear, srgb = residuals
    best = linear * srgb <= np.quantile(linear * srgb, 0.25)
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
    # differences of 2 % of the full scale count in full: gloss and shadow differ by more
    return np.log1p((rest / 0.02) ** 2) * lit


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
